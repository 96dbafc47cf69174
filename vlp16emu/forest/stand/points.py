"""Positions of plants and stones: point patterns that fill the plane tile by tile.

The points of a tile depend only on the seed and the tile's surroundings, so no pattern has an
edge, and tiles can be requested in any order. Source of the processes: Chiu, Stoyan, Kendall, Mecke,
Stochastic Geometry and its Applications, 3rd ed., sections 5.3 and 5.4.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from vlp16emu.elementary import cos, log1p, matvec, sin
from vlp16emu.errors import GeometryError
from vlp16emu.foliage.polyline import Corridor
from vlp16emu.forest.ground.terrain import Trails, sum_of_waves, waves
from vlp16emu.forest.plants.species import Flora, flora
from vlp16emu.forest.purpose import Growth
from vlp16emu.forest.settings import Clusters, Pattern, Plantation, Scattered
from vlp16emu.forest.tiles import TILE_M, around
from vlp16emu.random import generator, uniform
from vlp16emu.trees import Tree
from vlp16emu.types import F8, I8, HeightField

TilePoints = Callable[[int, int], F8]


@dataclass(frozen=True, slots=True)
class Land:
    """Ground, path and plants on which a forest grows."""

    seed: int
    height_m: HeightField  # ground
    path: Corridor  # whole path of the sensor, with chords short enough to represent it
    plants: Flora = field(default_factory=flora)  # trees and shrubs, by default the program's
    trails: Trails | None = None  # trails without trees and shrubs


_SPACING_SHARE = 0.4
"""Hard-core distance over 1 / sqrt(density); assumption, gives a Clark-Evans index near 1.25."""
_JITTER_M = 0.15  # half-range of the error of planting along and across a row; assumption
_LARGEST_DISTANCE_M = 5.0  # upper limit of the hard-core distance; assumption
_TILES_KEPT = 1024  # tiles whose points are kept for their neighbours: more than a window with its border has
_PATCH_WAVELENGTHS_M = (6.0, 20.0)
"""Scale of patches: herbs under oaks are most uneven at about 10 m (Plant Biosystems 133(3), 1999,
10.1080/11263509909381559), patches of a spring flower are 7.5 to 10 m apart (Huh 2023, Erythronium at Mt.
Geumjeong)."""
_DENSEST_PATCH = 9.0
"""Limit of the density over its mean; it cuts 0.3 % of the ground and lowers the mean by 0.5 %."""


@dataclass(frozen=True, slots=True)
class PointPattern:
    """Reproducible points in the plane, independent of the points for other purposes."""

    per_ha: float  # mean density
    points: TilePoints  # points (n, 2) of a tile (ix, iy), x and y in m


def poisson_pattern(*, seed: int, purpose: Growth, per_ha: float) -> PointPattern:
    """Return a pattern of independent points (Poisson process)."""
    mean = per_ha * TILE_M * TILE_M / 10_000
    return PointPattern(
        per_ha, lambda ix, iy: _poisson_points(generator(seed, purpose, ix, iy), ix, iy, mean)
    )


def cox_pattern(*, seed: int, purpose: Growth, even_per_ha: float, patchy_per_ha: float) -> PointPattern:
    """Return a pattern of points, a part of them in patches (Cox process).

    Plants that spread by runners or follow light stand like that. The density in patches follows the square
    of normal noise: a quarter of the ground has less than a tenth of the mean, and a twelfth more than three
    times the mean. `even_per_ha` points are independent of patches, `patchy_per_ha` are in them.
    """
    band = waves(generator(seed, purpose, 0, 0, 2), _PATCH_WAVELENGTHS_M, 1.0)
    most_per_ha = even_per_ha + _DENSEST_PATCH * patchy_per_ha

    def points(ix: int, iy: int) -> F8:
        # A Poisson process as dense as the densest patch, thinned to the density at each point.
        mean = most_per_ha * TILE_M * TILE_M / 10_000
        draws = _poisson_points(generator(seed, purpose, ix, iy), ix, iy, mean, columns=3)
        x, y = np.ascontiguousarray(draws[:, :2].T)
        noise = np.empty(len(x))
        sum_of_waves(noise, x, y, band, 0.0, 0.0)
        there_per_ha = even_per_ha + patchy_per_ha * np.minimum(np.square(noise), _DENSEST_PATCH)
        return draws[draws[:, 2] * most_per_ha < there_per_ha, :2]

    return PointPattern(even_per_ha + patchy_per_ha, points)


def hard_core_pattern(*, seed: int, purpose: Growth, per_ha: float) -> PointPattern:
    """Return a pattern of Poisson candidates with random priorities, thinned by a hard-core distance.

    This is Matern's second process (Matern 1960). A candidate survives if no candidate of higher priority is
    within the hard-core distance.
    """
    density = per_ha / 10_000
    distance_m = min(_SPACING_SHARE / math.sqrt(density), _LARGEST_DISTANCE_M) if density else 0.0
    area = math.pi * distance_m * distance_m
    # Density after thinning is (1 - exp(-intensity * area)) / area; solved for the intensity.
    intensity = -log1p(-density * area) / area if density else 0.0

    @lru_cache(maxsize=_TILES_KEPT)
    def candidates(ix: int, iy: int) -> F8:
        """Return points (n, 3) of a tile before rivals thin them."""
        found = _poisson_points(
            generator(seed, purpose, ix, iy), ix, iy, intensity * TILE_M * TILE_M, columns=3
        )
        found.flags.writeable = False
        return found

    def points(ix: int, iy: int) -> F8:
        points_here = candidates(ix, iy)
        rivals = around(ix, iy, candidates)
        dx, dy = (points_here[:, None, axis] - rivals[:, axis] for axis in (0, 1))
        beaten = (dx * dx + dy * dy < distance_m * distance_m) & (rivals[:, 2] < points_here[:, None, 2])
        return points_here[~beaten.any(axis=1), :2]

    return PointPattern(per_ha, points)


def cluster_pattern(section: Clusters, *, seed: int, purpose: Growth, per_ha: float) -> PointPattern:
    """Return a pattern of clumps (Thomas process): centres of a Poisson process, members around each.

    Members beyond the neighbouring tile, at most one in 1e4, are lost.
    """

    @lru_cache(maxsize=_TILES_KEPT)
    def members(ix: int, iy: int) -> F8:
        """Return the members (n, 2) of clusters whose middles are in a tile."""
        rng = generator(seed, purpose, ix, iy)
        middles = _poisson_points(rng, ix, iy, per_ha / section.per_cluster * TILE_M * TILE_M / 10_000)
        counts = rng.poisson(section.per_cluster, len(middles))
        return np.repeat(middles, counts, axis=0) + rng.normal(0.0, section.sigma_m, (counts.sum(), 2))

    # Members in a tile, of clumps in this and other tiles.
    return PointPattern(per_ha, lambda ix, iy: _inside(around(ix, iy, members), ix, iy))


def plantation_pattern(
    section: Plantation, *, seed: int, purpose: Growth, per_ha: float, free_share: float = 1.0
) -> PointPattern:
    """Return a pattern of planted rows, thinned at random; `free_share` of the ground is off trails.

    Raises GeometryError if the density off trails exceeds the planted density.
    """
    row_spacing_m = section.row_spacing_m
    tree_spacing_m = section.tree_spacing_m
    whole_per_ha = 10_000 / (row_spacing_m * tree_spacing_m)
    if per_ha > whole_per_ha:
        rows = (
            f"{whole_per_ha * free_share:.0f}, which rows of {row_spacing_m:g} m x {tree_spacing_m:g} m hold"
        )
        where = " off the trails" if free_share < 1 else ""
        raise GeometryError("stems_per_ha", f"found {per_ha * free_share:g}", f"at most {rows}{where}")
    spacing_m = np.array([tree_spacing_m, row_spacing_m])
    towards = math.radians(section.azimuth_deg)
    # Rows of the matrix: along and across the planted rows.
    row_R_world = np.array([[cos(towards), sin(towards)], [-sin(towards), cos(towards)]])

    def row(number: int, plants: I8) -> F8:
        """Positions of plants along and across one row; each plant has its own draws."""
        lane = number & 0xFFFFFFFF
        draws = uniform(seed, purpose, 4 * int(plants[0]), 4 * len(plants), lane).reshape(-1, 4)
        places = np.column_stack([plants, np.full(len(plants), number)]) * spacing_m
        return (places + _JITTER_M * (2 * draws[:, :2] - 1))[draws[:, 2] < per_ha / whole_per_ha]

    def points(ix: int, iy: int) -> F8:
        corners = matvec(row_R_world, TILE_M * np.array([(x, y) for x in (ix, ix + 1) for y in (iy, iy + 1)]))
        low = np.floor((corners.min(axis=0) - _JITTER_M) / spacing_m).astype(int)
        high = np.ceil((corners.max(axis=0) + _JITTER_M) / spacing_m).astype(int)
        plants = np.arange(low[0], high[0] + 1)
        rows = [row(number, plants) for number in range(int(low[1]), int(high[1]) + 1)]
        return _inside(matvec(row_R_world.T, np.concatenate(rows)), ix, iy)

    return PointPattern(per_ha, points)


def pattern_of(section: Pattern, land: Land, *, purpose: Growth, per_ha: float) -> PointPattern:
    """Make a point pattern; the density refers to all the ground, but points are only off the trails."""
    share = land.trails.free_share if land.trails else 1.0
    options: Tree = {"seed": land.seed, "purpose": purpose, "per_ha": per_ha / share}
    match section:
        case Clusters():
            pattern = cluster_pattern(section, **options)
        case Plantation():
            pattern = plantation_pattern(section, free_share=share, **options)
        case Scattered(kind=kind):
            pattern = hard_core_pattern(**options) if kind == "hard_core" else poisson_pattern(**options)
    if (trails := land.trails) is None or share == 1:
        return pattern
    off_trails = pattern.per_ha * share
    return PointPattern(off_trails, lambda ix, iy: (xy_m := pattern.points(ix, iy))[trails.are_free(xy_m)])


def _poisson_points(rng: np.random.Generator, ix: int, iy: int, mean: float, columns: int = 2) -> F8:
    """Random numbers (n, columns) in [0, 1), the first two scaled to positions on a tile.

    The mean of n is `mean`.
    """
    draws = rng.random((rng.poisson(mean), columns))
    draws[:, :2] = (draws[:, :2] + np.array([ix, iy])) * TILE_M
    return draws


def _inside(points: F8, ix: int, iy: int) -> F8:
    low = np.array([ix, iy]) * TILE_M
    return points[((points >= low) & (points < low + TILE_M)).all(axis=1)]
