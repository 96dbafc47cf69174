"""Leaves and shoots as planar quads.

They stand along the twigs of a crown with a given total area, or are ivy on stems.
"""

from dataclasses import dataclass

import numpy as np

from vlp16emu.elementary import cos, exp, power, sin
from vlp16emu.forest.plants.branches import Branches, points_along, quads
from vlp16emu.forest.plants.species import Foliage, Table, Trees
from vlp16emu.forest.plants.stem import Stems
from vlp16emu.forest.purpose import Growth
from vlp16emu.forest.tiles import TileKey
from vlp16emu.random import generator, uniform
from vlp16emu.types import F8, Mesh
from vlp16emu.world.vectors import places_m, unit

_WIDEST_AT = 0.4  # position of a blade's greatest width, from its base; assumption
_SIZE_SIGMA = 0.15  # standard deviation of the logarithm of leaf length; assumption
_MOST_LEAVES = 120_000
"""Greatest number of quads; beyond, quads become larger instead: limits the memory of very large crowns."""
_HANG_SIGMA = np.radians(40.0)
"""One sigma of a blade's tip about the direction of steepest descent in its plane; assumption."""
_SHOOT_ANGLE = np.radians(15.0), np.radians(65.0)
"""Range of angles between a shoot and its twig; assumption."""


def foliage_mesh(rng: np.random.Generator, foliage: Foliage, twigs: Branches, leaf_area_m2: float) -> Mesh:
    """Quads spread evenly along the leafy part of twigs.

    Their total is one-sided leaf area over the species' clumping.
    """
    area_m2 = leaf_area_m2 / foliage.clumping
    per_item = foliage.length_m * foliage.width_m * (2.0 if foliage.kind == "shoot" else 0.5)
    n = max(1, round(min(area_m2 / per_item, _MOST_LEAVES)))
    size = exp(rng.normal(0.0, _SIZE_SIGMA, n))
    size *= np.sqrt(area_m2 / (per_item * (np.square(size)).sum()))
    ends_m = np.cumsum(twigs.length_m)
    position = (np.arange(n) + rng.random(n)) / n * ends_m[-1]
    twig = np.minimum(np.searchsorted(ends_m, position, side="right"), len(ends_m) - 1)
    share = np.clip(1 - (ends_m[twig] - position) / twigs.length_m[twig], 0.0, 1.0)
    share = foliage.bare_share + (1 - foliage.bare_share) * share
    place, tangent = points_along(twigs.nodes_m, twig, share)
    length = foliage.length_m * size[:, None]
    width = foliage.width_m * size[:, None]
    if foliage.kind == "leaf":
        mu, nu = foliage.inclination
        in_ball = unit(rng.standard_normal((n, 3))) * power(rng.random((n, 1)), 1 / 3)
        place = place + in_ball * foliage.spread_m
        corners = _blades(rng, place, (mu, nu), length, width)
    else:
        corners = _shoots(rng, place, tangent, length, width)
    return quads(corners)


def _blades(rng: np.random.Generator, base: F8, mu_nu: tuple[float, float], length: F8, width: F8) -> F8:
    """Kites (n, 4, 3) whose normals have the measured inclinations and whose tips hang."""
    n = len(base)
    (mu, nu) = mu_nu
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


def _shoots(rng: np.random.Generator, base: F8, tangent: F8, length: F8, width: F8) -> F8:
    """Pairs of crossed rectangles (2n, 4, 3) that point forwards from their twig."""
    n = len(base)
    first = unit(np.cross(tangent, [0.0, 0.0, 1.0]))
    second = np.cross(tangent, first)
    roll = rng.uniform(0, 2 * np.pi, n)[:, None]
    angle = rng.uniform(*_SHOOT_ANGLE, n)[:, None]
    outward = cos(roll) * first + sin(roll) * second
    along = cos(angle) * tangent + sin(angle) * outward
    across = cos(roll) * second - sin(roll) * first  # at right angles to both tangent and outward
    third = np.cross(along, across)
    tip = base + length * along
    halves = across * width / 2, third * width / 2
    return np.concatenate([np.stack([base - h, base + h, tip + h, tip - h], axis=1) for h in halves])


_LEAF_PER_BARK = 2.0  # one-sided leaf area over the covered bark area; assumption
_LEAF_M = (0.04, 0.1)  # range of leaf length (Stace, New Flora of the British Isles: 4 to 10 cm)
_LEAF_WIDTH = 0.9  # width over length; assumption
_AWAY_M = (0.02, 0.12)  # range of the distance of a leaf's base from the bark; assumption
_TILT_DEG = (10.0, 60.0)  # range of the angle between a hanging blade and the stem; assumption
_UPWARDS = 1.3  # power of a uniform number for a leaf's relative height: fewer leaves higher up; assumption
_TONGUES = 3
_SHORTER = 0.35
"""Number of waves of the upper edge around the stem, and their relative depth; assumptions."""


@dataclass(frozen=True, slots=True)
class IvyKey:
    """Name of the shape of the ivy on a stem, in the frame of its tile."""

    tile: TileKey
    number: int  # among the trees of the tile


def ivy_tops_m(trees: Trees, share: float, height_m: tuple[float, float], *, seed: int) -> F8:
    """Height over the foot (n,) up to which ivy covers a stem, no higher than the crown base.

    Stems without ivy have 0. A `share` of the stems has ivy; the height is within the range `height_m` and
    depends on the tree's position alone.
    """
    places_mm = np.round(1000 * places_m(trees, "xy")).astype(np.int64) & 0xFFFFFFFF
    counters = [(x & 0x7FFFFFFF) << 32 | y for x, y in places_mm.tolist()]
    draws = np.array([uniform(seed, Growth.IVY, first, 1, lane) for first in counters for lane in (0, 1)])
    chance, height_share = draws.reshape(-1, 2).T
    low_m, high_m = height_m
    top_m = np.minimum(low_m + (high_m - low_m) * height_share, trees["crown_base_m"])
    return np.where(chance < share, top_m, 0.0)


def ivy_meshes(
    trees: Trees, tops_m: F8, origin_m: F8, *, seed: int, tile: TileKey, table: Table | None = None
) -> list[Mesh]:
    """Leaves (quads) of the ivy on stems (n,) up to heights (n,), relative to an origin (3,).

    Height 0 has none.
    """
    stems = Stems(trees, table=table)
    small_m, large_m = _LEAF_M
    mean_m2 = _LEAF_WIDTH / 2 * (small_m * small_m + small_m * large_m + large_m * large_m) / 3
    meshes = []
    for i, top_m in enumerate(tops_m.tolist()):
        rng = generator(seed, Growth.IVY, tile.ix, tile.iy, 1 + i)
        bark_m2 = np.pi * float(trees["dbh_m"][i]) * top_m
        count = round(_LEAF_PER_BARK * bark_m2 / mean_m2)
        turn = rng.uniform(0, 2 * np.pi, count)
        share = power(rng.random(count), _UPWARDS)
        edge = 1 - _SHORTER * (0.5 + 0.5 * sin(_TONGUES * turn + rng.uniform(0, 2 * np.pi)))
        up_m = top_m * edge * share
        middle_m = stems.axis_m(up_m[None], np.array([i]))[0]
        away_m = np.interp(up_m, stems.above_ground_m[i], stems.radius_m[i]) + rng.uniform(*_AWAY_M, count)
        foot_m = places_m(trees[i : i + 1])[0] - origin_m
        outward = np.column_stack([cos(turn), sin(turn), np.zeros(count)])
        corners = _leaves(rng, foot_m + middle_m + away_m[:, None] * outward, outward)
        meshes.append(quads(corners))
    return meshes


def _leaves(rng: np.random.Generator, base: F8, outward: F8) -> F8:
    n = len(base)
    tilt = np.radians(rng.uniform(*_TILT_DEG, n))[:, None]
    aside = rng.normal(0.0, 0.4, n)[:, None]
    across = np.cross([0.0, 0.0, 1.0], outward)
    along = sin(tilt) * outward - cos(tilt) * np.array([0.0, 0.0, 1.0])
    along, across = (cos(aside) * along + sin(aside) * across, cos(aside) * across - sin(aside) * along)
    length = rng.uniform(*_LEAF_M, n)[:, None]
    middle = base + 0.4 * length * along
    half = _LEAF_WIDTH / 2 * length * across
    return np.stack([base, middle + half, base + length * along, middle - half], axis=1)
