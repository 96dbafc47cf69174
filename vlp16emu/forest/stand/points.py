"""Places of plants and stones: point patterns that fill the plane tile by tile.

What falls into a tile depends on the seed and on the tile's surroundings only, so no pattern has an
edge, and tiles can be asked for in any order. Source of the processes: Chiu, Stoyan, Kendall, Mecke,
Stochastic Geometry and its Applications, 3rd ed., sections 5.3 and 5.4.
"""

import math
from functools import lru_cache

import numpy as np

from vlp16emu.elementary import cos, log1p, matvec, sin
from vlp16emu.errors import GeometryError
from vlp16emu.forest.ground.terrain import Trails, sum_of_waves, waves
from vlp16emu.forest.purpose import Growth
from vlp16emu.forest.settings import Clusters, HardCore, Pattern, Plantation, Scattered
from vlp16emu.forest.tiles import TILE_M, around
from vlp16emu.random import generator, uniform
from vlp16emu.types import Array, IntArray

_SPACING_SHARE = 0.4  # hard-core distance over 1 / sqrt(density); assumption, gives a Clark-Evans index near 1.25
_LARGEST_DISTANCE_M = 5.0  # trees farther apart than this do not keep each other away; assumption
_TILES_KEPT = 1024  # tiles whose points are kept for their neighbours: more than one window and its border hold
_PATCH_WAVELENGTHS_M = (6.0, 20.0)
"""Herbs under oaks are most uneven at some 10 m (Plant Biosystems 133(3), 1999, 10.1080/11263509909381559), patches of a spring
flower lie 7.5 to 10 m apart (Huh 2023, Erythronium at Mt. Geumjeong)."""
_DENSEST_PATCH = 9.0
"""Density over its mean, which would be greater on 0.3 % of the ground; so the mean is too low by 0.5 %."""


class PointPattern:
    """Points in the plane, the same ones however often asked: so many per hectare on average, independent of those for other purposes."""

    def __init__(self, *, seed: int, purpose: Growth, per_ha: float) -> None:
        self.per_ha, self._seed, self._purpose = per_ha, seed, purpose

    def points(self, ix: int, iy: int) -> Array:
        """Points of a tile, (n, 2) x and y in m."""
        raise NotImplementedError

    def _rng(self, ix: int, iy: int) -> np.random.Generator:
        return generator(self._seed, self._purpose, ix, iy)


class ScatteredPattern(PointPattern):
    """Points that know nothing of each other (Poisson process)."""

    def points(self, ix: int, iy: int) -> Array:
        """Points of a tile, (n, 2)."""
        rng = self._rng(ix, iy)
        count = rng.poisson(self.per_ha * TILE_M * TILE_M / 10_000)
        return (rng.random((count, 2)) + np.array([ix, iy])) * TILE_M


class PatchyPattern(PointPattern):
    """Points, a part of them in patches (Cox process), as plants stand that spread by runners or find light.

    The density in patches follows the square of normal noise: a quarter of the ground has less than a tenth of the mean, and
    a twelfth more than three times as much. `even_per_ha` points know nothing of patches, `patchy_per_ha` are in them.
    """

    def __init__(self, *, seed: int, purpose: Growth, even_per_ha: float, patchy_per_ha: float) -> None:
        super().__init__(seed=seed, purpose=purpose, per_ha=even_per_ha + patchy_per_ha)
        self._even_per_ha, self._patchy_per_ha = even_per_ha, patchy_per_ha
        self._waves = waves(generator(seed, purpose, 0, 0, 2), _PATCH_WAVELENGTHS_M, 1.0)

    def points(self, ix: int, iy: int) -> Array:
        """Points of a tile, (n, 2): those of a Poisson process as dense as the densest patch, thinned to the density at each."""
        rng = self._rng(ix, iy)
        most_per_ha = self._even_per_ha + _DENSEST_PATCH * self._patchy_per_ha
        draws = rng.random((rng.poisson(most_per_ha * TILE_M * TILE_M / 10_000), 3))
        xy_m = (draws[:, :2] + np.array([ix, iy])) * TILE_M
        there_per_ha = self._even_per_ha + self._patchy_per_ha * self._density(xy_m)
        return xy_m[draws[:, 2] * most_per_ha < there_per_ha]

    def _density(self, xy_m: Array) -> Array:
        x, y = np.ascontiguousarray(xy_m.T)
        noise = np.empty(len(x))
        sum_of_waves(noise, x, y, self._waves, 0.0, 0.0)
        return np.minimum(np.square(noise), _DENSEST_PATCH)


class HardCorePattern(PointPattern):
    """Points that keep apart.

    Matern's second process: candidates fall like rain (Poisson), each with a random priority, and a
    candidate survives if none of higher priority lies within the hard-core distance (Matern 1960).
    """

    def __init__(self, *, seed: int, purpose: Growth, per_ha: float) -> None:
        super().__init__(seed=seed, purpose=purpose, per_ha=per_ha)
        density = per_ha / 10_000
        self.distance_m = min(_SPACING_SHARE / math.sqrt(density), _LARGEST_DISTANCE_M) if density else 0.0
        area = math.pi * self.distance_m * self.distance_m
        # Density after thinning is (1 - exp(-intensity * area)) / area; solved for the intensity.
        intensity = -log1p(-density * area) / area if density else 0.0
        self._per_tile = intensity * TILE_M * TILE_M
        self.candidates = lru_cache(maxsize=_TILES_KEPT)(self._candidates)
        """Candidates of tile (ix, iy): (n, 3) with x and y in m, and a priority in [0, 1), low is high."""

    def points(self, ix: int, iy: int) -> Array:
        """Survivors of a tile, (n, 2)."""
        own, rivals = self.candidates(ix, iy), around(ix, iy, self.candidates)
        dx, dy = (own[:, None, axis] - rivals[:, axis] for axis in (0, 1))
        beaten = (dx * dx + dy * dy < self.distance_m * self.distance_m) & (rivals[:, 2] < own[:, None, 2])
        return own[~beaten.any(axis=1), :2]

    def _candidates(self, ix: int, iy: int) -> Array:
        rng = self._rng(ix, iy)
        candidates = rng.random((rng.poisson(self._per_tile), 3))
        candidates[:, :2] = (candidates[:, :2] + (ix, iy)) * TILE_M
        candidates.flags.writeable = False
        return candidates


class ClusterPattern(PointPattern):
    """Points in clumps (Thomas process): clumps fall like rain, their members normally about the middle.

    Members that fall beyond the neighbouring tile, one in 1e4 at the very most, are lost.
    """

    def __init__(self, section: Clusters, *, seed: int, purpose: Growth, per_ha: float) -> None:
        super().__init__(seed=seed, purpose=purpose, per_ha=per_ha)
        self._section = section
        self._members = lru_cache(maxsize=_TILES_KEPT)(self._grow_members)

    def points(self, ix: int, iy: int) -> Array:
        """Members of a tile, whatever tile their clump belongs to, (n, 2)."""
        return _inside(around(ix, iy, self._members), ix, iy)

    def _grow_members(self, ix: int, iy: int) -> Array:
        rng = self._rng(ix, iy)
        clumps = rng.poisson(self.per_ha / self._section.per_cluster * TILE_M * TILE_M / 10_000)
        middles = (rng.random((clumps, 2)) + np.array([ix, iy])) * TILE_M
        each = rng.poisson(self._section.per_cluster, clumps)
        return np.repeat(middles, each, axis=0) + rng.normal(0.0, self._section.sigma_m, (each.sum(), 2))


class RowPattern(PointPattern):
    """Points in planted rows; a random share of them is still there, and `free_share` of the ground is off trails.

    Raises GeometryError where more are to be left, with those on trails gone, than were planted.
    """

    def __init__(
        self, section: Plantation, *, seed: int, purpose: Growth, per_ha: float, free_share: float = 1.0
    ) -> None:
        row_spacing_m, tree_spacing_m = section.row_spacing_m, section.tree_spacing_m
        planted = 10_000 / (row_spacing_m * tree_spacing_m)
        if per_ha > planted:
            rows = f"{planted * free_share:.0f}, which rows of {row_spacing_m:g} m x {tree_spacing_m:g} m hold"
            where = " off the trails" if free_share < 1 else ""
            raise GeometryError("stems_per_ha", f"found {per_ha * free_share:g}", f"at most {rows}{where}")
        super().__init__(seed=seed, purpose=purpose, per_ha=per_ha)
        self._left = per_ha / planted
        self._spacing_m = np.array([tree_spacing_m, row_spacing_m])
        towards = math.radians(section.azimuth_deg)
        # Rows of the matrix: along and across the planted rows.
        self._row_R_world = np.array([[cos(towards), sin(towards)], [-sin(towards), cos(towards)]])
        self._jitter_m = section.jitter_m

    def points(self, ix: int, iy: int) -> Array:
        """Plants of a tile that are left, (n, 2)."""
        corners = matvec(self._row_R_world, TILE_M * np.array([(x, y) for x in (ix, ix + 1) for y in (iy, iy + 1)]))
        low = np.floor((corners.min(axis=0) - self._jitter_m) / self._spacing_m).astype(int)
        high = np.ceil((corners.max(axis=0) + self._jitter_m) / self._spacing_m).astype(int)
        plants = np.arange(low[0], high[0] + 1)
        rows = [self._row(int(row), plants) for row in range(low[1], high[1] + 1)]
        return _inside(matvec(self._row_R_world.T, np.concatenate(rows)), ix, iy)

    def _row(self, row: int, plants: IntArray) -> Array:
        """Places of the plants of a stretch of one row, along and across it; each plant draws alone."""
        lane = row & 0xFFFFFFFF
        draws = uniform(self._seed, self._purpose, 4 * int(plants[0]), 4 * len(plants), lane).reshape(-1, 4)
        planted = np.column_stack([plants, np.full(len(plants), row)]) * self._spacing_m
        return (planted + self._jitter_m * (2 * draws[:, :2] - 1))[draws[:, 2] < self._left]


class OffTrailPattern(PointPattern):
    """Points of a pattern, which is as dense as it is to be off the trails, that are on none of them."""

    def __init__(self, pattern: PointPattern, trails: Trails) -> None:
        self.per_ha = pattern.per_ha * trails.free_share
        self._pattern, self._trails = pattern, trails

    def points(self, ix: int, iy: int) -> Array:
        """Points of a tile, (n, 2)."""
        xy_m = self._pattern.points(ix, iy)
        return xy_m[self._trails.are_free(xy_m)]


def pattern_of(
    section: Pattern, *, seed: int, purpose: Growth, per_ha: float, trails: Trails | None = None
) -> PointPattern:
    """Make a point pattern of some density, all of it off trails if there are any; else arguments are those of `PointPattern`."""
    share = trails.free_share if trails else 1.0
    per_ha = per_ha / share
    match section:
        case Clusters():
            pattern: PointPattern = ClusterPattern(section, seed=seed, purpose=purpose, per_ha=per_ha)
        case Plantation():
            pattern = RowPattern(section, seed=seed, purpose=purpose, per_ha=per_ha, free_share=share)
        case HardCore():
            pattern = HardCorePattern(seed=seed, purpose=purpose, per_ha=per_ha)
        case Scattered():
            pattern = ScatteredPattern(seed=seed, purpose=purpose, per_ha=per_ha)
    return OffTrailPattern(pattern, trails) if trails and share < 1 else pattern


def _inside(points: Array, ix: int, iy: int) -> Array:
    low = np.array([ix, iy]) * TILE_M
    return points[((points >= low) & (points < low + TILE_M)).all(axis=1)]
