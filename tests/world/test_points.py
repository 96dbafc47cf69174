"""Where stems stand."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from vlp16emu.world.points import HardCore
from vlp16emu.world.tiles import TILE_M

ACROSS = 24


def points_of(pattern, across=ACROSS):
    tiles = [(ix, iy) for ix in range(-across // 2, across // 2) for iy in range(across)]
    return np.concatenate([pattern.candidates(*t)[pattern.survive(*t), :2] for t in tiles])


@pytest.mark.parametrize("per_ha", [30.0, 700.0, 4000.0])
def test_density_is_as_set_and_no_two_are_too_near(per_ha):
    """Over 23 hectares the density is right within 3 sigma of a Poisson count, and the hard core holds across tiles."""
    pattern = HardCore(seed=9, per_ha=per_ha)
    points = points_of(pattern)
    expected = per_ha * (ACROSS * TILE_M) ** 2 / 10_000
    assert abs(len(points) - expected) < 3 * np.sqrt(expected)
    nearest = cKDTree(points).query(points, k=2)[0][:, 1]
    assert nearest.min() >= pattern.distance_m


def test_pattern_is_more_regular_than_chance():
    """The Clark-Evans index, with the border left out, is that of a stand whose trees keep apart: 1.15 to 1.35."""
    points = points_of(HardCore(seed=10, per_ha=700.0))
    nearest = cKDTree(points).query(points, k=2)[0][:, 1]
    low, high = points.min(axis=0) + 20, points.max(axis=0) - 20
    inner = ((points > low) & (points < high)).all(axis=1)
    assert 1.15 < nearest[inner].mean() * 2 * np.sqrt(0.07) < 1.35


def test_survivors_are_those_of_one_great_field():
    """Tile by tile and all at once the same candidates survive: a tile has no edge."""
    pattern = HardCore(seed=11, per_ha=1500.0)
    field = np.concatenate([pattern.candidates(ix, iy) for ix in range(5) for iy in range(5)])
    beaten = [
        any(np.hypot(*(a[:2] - b[:2])) < pattern.distance_m and b[2] < a[2] for b in field)
        for a in pattern.candidates(2, 2)
    ]
    assert 0 < sum(beaten) < len(beaten)
    assert np.array_equal(pattern.survive(2, 2), np.logical_not(beaten))


def test_no_stems_at_density_zero():
    """Zero stems per hectare leave bare ground."""
    assert len(points_of(HardCore(seed=1, per_ha=0.0), 4)) == 0
