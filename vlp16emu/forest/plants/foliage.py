"""Leaves and shoots as planar quads along the twigs of a crown, with a given total area."""

import numpy as np

from vlp16emu.elementary import cos, exp, power, sin
from vlp16emu.forest.plants.branches import Branches, points_along
from vlp16emu.forest.plants.meshes import quads
from vlp16emu.forest.plants.species import Foliage
from vlp16emu.types import Array, Mesh
from vlp16emu.world.vectors import unit

_WIDEST_AT = 0.4  # where a blade is widest, from its base; assumption
_SIZE_SIGMA = 0.15  # spread of the logarithm of leaf length about its mean; assumption

_MOST_LEAVES = 120_000
"""Beyond that many leaves quads grow larger instead: memory of a very large crown, seen from far below."""

_HANG_SIGMA = np.radians(40.0)
"""One sigma of a blade's tip about the direction of steepest descent in its plane; assumption."""

_SHOOT_ANGLE = (np.radians(15.0), np.radians(65.0))  # range of angles between a shoot and its twig; assumption


def foliage_mesh(rng: np.random.Generator, foliage: Foliage, twigs: Branches, leaf_area_m2: float) -> Mesh:
    """Quads that sit evenly along the leafy part of twigs, and have the one-sided leaf area over the species' clumping."""
    area_m2 = leaf_area_m2 / foliage.clumping
    per_item = foliage.length_m * foliage.width_m * (2.0 if foliage.kind == "shoot" else 0.5)
    n = max(1, round(min(area_m2 / per_item, _MOST_LEAVES)))
    size = exp(rng.normal(0.0, _SIZE_SIGMA, n))
    size *= np.sqrt(area_m2 / (per_item * (np.square(size)).sum()))
    ends_m = np.cumsum(twigs.length_m)
    position = (np.arange(n) + rng.random(n)) / n * ends_m[-1]
    twig = np.minimum(np.searchsorted(ends_m, position, side="right"), len(ends_m) - 1)
    way = np.clip(1 - (ends_m[twig] - position) / twigs.length_m[twig], 0.0, 1.0)
    way = foliage.bare_share + (1 - foliage.bare_share) * way
    place, tangent = points_along(twigs.nodes_m, twig, way)
    length, width = foliage.length_m * size[:, None], foliage.width_m * size[:, None]
    if foliage.kind == "leaf":
        mu, nu = foliage.inclination
        place = place + _in_ball(rng, n) * foliage.spread_m
        corners = _blades(rng, place, (mu, nu), length, width)
    else:
        corners = _shoots(rng, place, tangent, length, width)
    return quads(corners)


def _blades(rng: np.random.Generator, base: Array, mu_nu: tuple[float, float], length: Array, width: Array) -> Array:
    """Kites (n, 4, 3) whose normals are inclined as measured and whose tips hang."""
    n, (mu, nu) = len(base), mu_nu
    tilt = rng.beta(nu, mu, n) * (np.pi / 2)
    towards = rng.uniform(0, 2 * np.pi, n)
    down = np.column_stack([cos(tilt) * cos(towards), cos(tilt) * sin(towards), -sin(tilt)])
    level = np.column_stack([-sin(towards), cos(towards), np.zeros(n)])
    turn = rng.normal(0.0, _HANG_SIGMA, n)[:, None]
    along = cos(turn) * down + sin(turn) * level
    across = cos(turn) * level - sin(turn) * down
    middle = base + _WIDEST_AT * length * along
    half = across * width / 2
    return np.stack([base, middle + half, base + length * along, middle - half], axis=1)


def _shoots(rng: np.random.Generator, base: Array, tangent: Array, length: Array, width: Array) -> Array:
    """Pairs of crossed rectangles (2n, 4, 3) that leave their twig forwards."""
    n = len(base)
    first = unit(np.cross(tangent, [0.0, 0.0, 1.0]))
    second = np.cross(tangent, first)
    roll = rng.uniform(0, 2 * np.pi, n)[:, None]
    angle = rng.uniform(*_SHOOT_ANGLE, n)[:, None]
    outward = cos(roll) * first + sin(roll) * second
    along = cos(angle) * tangent + sin(angle) * outward
    across = cos(roll) * second - sin(roll) * first  # at right angles to both tangent and outward
    other = np.cross(along, across)
    tip = base + length * along
    pair = [
        np.stack([base - half, base + half, tip + half, tip - half], axis=1)
        for half in (across * width / 2, other * width / 2)
    ]
    return np.concatenate(pair)


def _in_ball(rng: np.random.Generator, n: int) -> Array:
    return unit(rng.standard_normal((n, 3))) * power(rng.random((n, 1)), 1 / 3)
