"""Ivy: leaves that cover the bark of some stems, from the ground up."""

from dataclasses import dataclass

import numpy as np

from vlp16emu.elementary import cos, power, sin
from vlp16emu.forest.plants.flora import Table, Trees
from vlp16emu.forest.plants.meshes import quads
from vlp16emu.forest.plants.stem_rings import axis_m, stem_rings
from vlp16emu.forest.purpose import Growth
from vlp16emu.forest.tiles import TileKey
from vlp16emu.random import generator, uniform
from vlp16emu.types import Array, Mesh
from vlp16emu.world.vectors import places_m

_LEAF_PER_BARK = 2.0  # one-sided leaf area over the area of the bark that it covers; assumption
_LEAF_M = (0.04, 0.1)  # length of a leaf, least and most (Stace, New Flora of the British Isles: 4 to 10 cm)
_LEAF_WIDTH = 0.9  # over its length; assumption
_AWAY_M = (0.02, 0.12)  # how far leaves stand off the bark at their base, least and most; assumption
_TILT_DEG = (10.0, 60.0)  # range of the angle between a hanging blade and the stem; assumption
_UPWARDS = 1.3  # power of an even number that gives a leaf's place on the way up: fewer the higher; assumption

_TONGUES, _SHORTER = 3, 0.35
"""Waves of the upper edge around the stem, and by what share of its height it is lower between them; assumptions."""


@dataclass(frozen=True, slots=True)
class IvyKey:
    """Name of the shape of the ivy on a stem, in the frame of its tile."""

    tile: TileKey
    number: int  # among the trees of the tile


def ivy_tops_m(trees: Trees, share: float, height_m: tuple[float, float], *, seed: int) -> Array:
    """Height over the foot (n,) up to which ivy covers a share of the stems, no higher than the crown base; 0 where none grows.

    A tree's depends on its place alone, and is within a range.
    """
    places_mm = np.round(1000 * places_m(trees, "xy")).astype(np.int64) & 0xFFFFFFFF
    counters = [(x & 0x7FFFFFFF) << 32 | y for x, y in places_mm.tolist()]
    draws = np.array([uniform(seed, Growth.IVY, first, 1, lane) for first in counters for lane in (0, 1)])
    chance, way = draws.reshape(-1, 2).T
    low_m, high_m = height_m
    top_m = np.minimum(low_m + (high_m - low_m) * way, trees["crown_base_m"])
    return np.where(chance < share, top_m, 0.0)


def ivy_meshes(
    trees: Trees, tops_m: Array, origin_m: Array, *, seed: int, tile: TileKey, table: Table | None = None
) -> list[Mesh]:
    """Leaves (quads) of the ivy on stems (n,) up to heights (n,), relative to an origin (3,); none where that is 0."""
    rings = stem_rings(trees, table=table)
    small_m, large_m = _LEAF_M
    mean_m2 = _LEAF_WIDTH / 2 * (small_m * small_m + small_m * large_m + large_m * large_m) / 3
    meshes = []
    for i, top_m in enumerate(tops_m.tolist()):
        rng = generator(seed, Growth.IVY, tile.ix, tile.iy, 1 + i)
        bark_m2 = np.pi * float(trees["dbh_m"][i]) * top_m
        count = round(_LEAF_PER_BARK * bark_m2 / mean_m2)
        turn, way = rng.uniform(0, 2 * np.pi, count), power(rng.random(count), _UPWARDS)
        edge = 1 - _SHORTER * (0.5 + 0.5 * sin(_TONGUES * turn + rng.uniform(0, 2 * np.pi)))
        up_m = top_m * edge * way
        one = trees[i : i + 1]
        middle_m = axis_m(one, rings.forms.of(np.array([i])), up_m[None])[0]
        away_m = np.interp(up_m, rings.above_ground_m[i], rings.radius_m[i]) + rng.uniform(*_AWAY_M, count)
        foot_m = places_m(one)[0] - origin_m
        outward = np.column_stack([cos(turn), sin(turn), np.zeros(count)])
        corners = _leaves(rng, foot_m + middle_m + away_m[:, None] * outward, outward)
        meshes.append(quads(corners))
    return meshes


def _leaves(rng: np.random.Generator, base: Array, outward: Array) -> Array:
    """Kites (n, 4, 3) that hang from bases (n, 3), their tips away from the stem."""
    n = len(base)
    tilt, aside = np.radians(rng.uniform(*_TILT_DEG, n))[:, None], rng.normal(0.0, 0.4, n)[:, None]
    across = np.cross([0.0, 0.0, 1.0], outward)
    along = sin(tilt) * outward - cos(tilt) * np.array([0.0, 0.0, 1.0])
    along, across = (cos(aside) * along + sin(aside) * across, cos(aside) * across - sin(aside) * along)
    length = rng.uniform(*_LEAF_M, n)[:, None]
    middle, half = base + 0.4 * length * along, _LEAF_WIDTH / 2 * length * across
    return np.stack([base, middle + half, base + length * along, middle - half], axis=1)
