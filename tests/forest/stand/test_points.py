"""Where plants stand and stones lie."""

from functools import cache, partial
from itertools import product

import numpy as np
import pytest
from scipy import stats
from scipy.spatial import cKDTree

from vlp16emu.forest.purpose import Growth
from vlp16emu.forest.settings import Clusters, Plantation
from vlp16emu.forest.stand import points as module
from vlp16emu.forest.tiles import TILE_M

ACROSS = 16
ROWS = Plantation(kind="plantation", row_spacing_m=2.5, tree_spacing_m=2.25, azimuth_deg=20.0)
CLUMPS = Clusters(kind="clusters", per_cluster=8.0, sigma_m=3.0)


scattered = partial(module.poisson_pattern, purpose=Growth.STONES, per_ha=700.0, seed=9)
hard_core = partial(module.hard_core_pattern, purpose=Growth.STAND, per_ha=700.0, seed=9)
clusters = partial(module.cluster_pattern, section=CLUMPS, purpose=Growth.SHRUBS, per_ha=700.0, seed=9)
rows = partial(module.plantation_pattern, section=ROWS, purpose=Growth.STAND, per_ha=1600.0, seed=9)


def patchy(per_ha=700.0, seed=9):
    return module.cox_pattern(
        seed=seed, purpose=Growth.HERBS, even_per_ha=0.2 * per_ha, patchy_per_ha=0.8 * per_ha
    )


def points_of(pattern, across=ACROSS):
    tiles = product(range(-across // 2, across - across // 2), range(across))
    return np.concatenate([pattern.points(*tile) for tile in tiles])


@cache
def field(make, per_ha):
    """Points of a pattern, which several tests look at."""
    return points_of(make(per_ha=per_ha))


def clark_evans(points, per_ha):
    """Mean distance to the nearest neighbour over that of scattered points, border left out (Clark, Evans
    1954)."""
    nearest = cKDTree(points).query(points, k=2)[0][:, 1]
    low, high = points.min(axis=0) + 20, points.max(axis=0) - 20
    inner = ((points > low) & (points < high)).all(axis=1)
    return nearest[inner].mean() * 2 * np.sqrt(per_ha / 10_000)


def matern_index(per_ha, distance_m):
    """Clark-Evans index of Matern's second process from its own definition, on one large torus."""
    rng = np.random.default_rng(3)
    side, area = 400.0, np.pi * distance_m**2
    intensity = -np.log1p(-per_ha / 10_000 * area) / area
    field, priority = (rng.random((n := rng.poisson(intensity * side**2), 2)) * side), rng.random(n)
    pairs = cKDTree(field, boxsize=side).query_pairs(distance_m, output_type="ndarray")
    beaten = np.unique(np.where(priority[pairs[:, 0]] < priority[pairs[:, 1]], pairs[:, 1], pairs[:, 0]))
    alive = np.delete(field, beaten, axis=0)
    nearest = cKDTree(alive, boxsize=side).query(alive, k=2)[0][:, 1]
    return nearest.mean() * 2 * np.sqrt(len(alive) / side**2)


@pytest.mark.parametrize(
    ("make", "per_ha"),
    [
        (hard_core, 30.0),
        (hard_core, 700.0),
        (hard_core, 4000.0),
        (scattered, 700.0),
        (clusters, 700.0),
        (rows, 1600.0),
    ],
)
def test_density_is_as_set(make, per_ha):
    """Over ten hectares the number is right within 3 sigma: of a Poisson count, or of clumps of eight on
    average."""
    expected = per_ha * (ACROSS * TILE_M) ** 2 / 10_000
    sigma = np.sqrt(expected * (9 if make is clusters else 1))
    assert abs(len(field(make, per_ha)) - expected) < 3 * sigma


@pytest.mark.parametrize("make", [scattered, patchy, hard_core, clusters, rows])
def test_points_lie_on_the_tile_that_was_asked_for(make):
    """All points of a tile are within its edges, and asking again, by another object, gives the same ones."""
    pattern = make()
    for ix, iy in [(0, 0), (-7, 3), (40_000, -2)]:
        points = pattern.points(ix, iy)
        assert ((np.floor(points / TILE_M)) == (ix, iy)).all()
        assert np.array_equal(points, make().points(ix, iy))


@pytest.mark.parametrize("per_ha", [30.0, 700.0, 4000.0])
def test_no_two_are_nearer_than_the_hard_core(per_ha):
    """The hard core, 0.4 of the mean spacing up to 5 m, holds across the edges of tiles, and closely."""
    points, distance_m = field(hard_core, per_ha), min(0.4 / np.sqrt(per_ha / 10_000), 5.0)
    assert distance_m <= cKDTree(points).query(points, k=2)[0][:, 1].min() < 1.1 * distance_m


def test_clark_evans_of_trees_that_keep_apart():
    """The index is that of Matern's second process, simulated anew on a torus, within 0.02."""
    expected = matern_index(700.0, 0.4 / np.sqrt(0.07))
    assert clark_evans(points_of(hard_core(seed=10)), 700.0) == pytest.approx(expected, abs=0.02)


def test_nearest_neighbours_of_scattered_points_are_rayleigh():
    """Distances from random places to the nearest point follow 1 - exp(-density pi r^2), by Kolmogorov and
    Smirnov."""
    places = np.random.default_rng(1).uniform(-140, 140, (400, 2)) + (0, 160)
    reach = cKDTree(points_of(scattered())).query(places)[0]
    assert stats.kstest(reach, stats.rayleigh(scale=1 / np.sqrt(2 * np.pi * 0.07)).cdf).pvalue > 0.01


def test_clumps_have_the_pair_correlation_of_a_thomas_process():
    """Pairs within r are as many as Ripley's K of a Thomas process says, within 5 %, and the index is
    under 1."""
    points = points_of(clusters(), 30)
    density, sigma, clumps = 0.07, 3.0, 0.07 / 8.0
    low, high = points.min(axis=0) + 12, points.max(axis=0) - 12
    inner = points[((points > low) & (points < high)).all(axis=1)]
    tree = cKDTree(points)
    for r in (2.0, 5.0, 10.0):
        found = np.mean(tree.query_ball_point(inner, r, return_length=True) - 1) / density
        ripley = np.pi * r**2 + (1 - np.exp(-(r**2) / (4 * sigma**2))) / clumps
        assert found == pytest.approx(ripley, rel=0.05)
    assert clark_evans(points, 700.0) < 0.85


def test_patches_have_the_density_that_was_asked_for_and_that_of_squared_noise():
    """Over ten hectares the number is right within 3 %; counts in squares of 0.5 m have the variance of a Cox
    process, within 5 %.

    With a share q of points in patches, mean m of a square and squared normal noise, whose variance is 2,
    that is m + 2 (q m)^2.
    """
    both, side_m = [points_of(patchy(8000.0, seed)) for seed in (9, 10)], ACROSS * TILE_M
    assert sum(map(len, both)) == pytest.approx(2 * 8000 * side_m**2 / 10_000, rel=0.03)
    edges = [np.arange(low_m, low_m + side_m + 0.1, 0.5) for low_m in (-side_m / 2, 0.0)]
    counts = [np.histogram2d(*points.T, bins=edges)[0] for points in both]
    mean = np.mean(counts)
    assert np.var(counts) == pytest.approx(mean + 2 * (0.8 * mean) ** 2, rel=0.05)


def test_planted_rows_are_rows():
    """Every plant is within the jitter of a place of the planted grid, one to a place, and nine in ten are
    left."""
    points = points_of(rows(), 10)
    towards = np.radians(20.0)
    along = points @ [np.cos(towards), np.sin(towards)] / 2.25
    across = points @ [-np.sin(towards), np.cos(towards)] / 2.5
    assert np.abs(along - np.round(along)).max() * 2.25 <= 0.15 + 1e-9
    assert np.abs(across - np.round(across)).max() * 2.5 <= 0.15 + 1e-9
    places = np.column_stack([np.round(along), np.round(across)])
    assert len(np.unique(places, axis=0)) == len(points)
    assert len(points) * 2.25 * 2.5 / (10 * TILE_M) ** 2 == pytest.approx(0.9, abs=0.02)
    assert clark_evans(points, 1600.0) > 1.5
