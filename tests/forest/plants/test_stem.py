"""Stems and the exactness of their diameter."""

import numpy as np
import pytest

from vlp16emu.forest.plants.stem import STEM_PARTS, lean_rotation, stem_meshes
from vlp16emu.forest.stand.stand import TREE
from vlp16emu.types import PlantPart

DBH_CM = [5.0, 12.0, 18.0, 35.0, 49.9, 50.1, 80.0, 120.0]


def slope(x, y):
    return 0.2 * x - 0.1 * y + 3.0


def make_trees(lean_deg, species=1):
    trees = np.zeros(len(DBH_CM), TREE)
    trees["species"] = species
    trees["x_m"], trees["y_m"] = 500_000.0 + 2.5 * np.arange(len(DBH_CM)), 7.0
    trees["z_m"] = slope(trees["x_m"], trees["y_m"])
    trees["dbh_m"] = np.array(DBH_CM) / 100
    trees["height_m"] = 3.0 + 0.4 * np.array(DBH_CM)
    trees["lean_deg"], trees["lean_towards_deg"] = lean_deg, 40.0 * np.arange(len(DBH_CM))
    trees["crown_azimuth_deg"] = 17.0
    return trees


def grow(trees):
    """Origin of the tile, and of each tree its flare and its stem."""
    origin_m = np.array([500_000.0, 0.0, np.round(slope(500_000.0, 0.0))])
    meshes = stem_meshes(trees, origin_m, slope)
    assert len(meshes) == len(STEM_PARTS) * len(trees)
    return origin_m, list(zip(meshes[::2], meshes[1::2], strict=True))


def sides_of(tree):
    """How many sides a section has."""
    return 16 + 8 * int(np.searchsorted([0.16, 0.3, 0.45], tree["dbh_m"]))


def test_the_root_flare_ends_half_a_metre_up():
    """The flare's highest vertices and the stem's lowest are the same ring, 0.5 m above the foot."""
    assert STEM_PARTS == (PlantPart.ROOT_FLARE, PlantPart.STEM)
    trees = make_trees(0.0)
    origin_m, stems = grow(trees)
    for tree, (flare, stem) in zip(trees, stems, strict=True):
        sides = sides_of(tree)
        assert np.array_equal(flare.vertices_m[-sides:], stem.vertices_m[:sides])
        above = stem.vertices_m[:sides, 2] + origin_m[2] - tree["z_m"]
        assert above == pytest.approx(np.full(sides, 0.5), abs=5e-6)


def test_tip_is_at_the_height_and_leans():
    """The tip is `height_m` above the foot, aside by height times the tangent of the lean."""
    trees = make_trees(8.0)
    origin_m, stems = grow(trees)
    for tree, (_, stem) in zip(trees, stems, strict=True):
        tip = stem.vertices_m[-1].astype(np.float64) + origin_m - [tree["x_m"], tree["y_m"], tree["z_m"]]
        assert tip[2] == pytest.approx(tree["height_m"], abs=1e-5)
        assert np.hypot(*tip[:2]) == pytest.approx(tree["height_m"] * np.tan(np.radians(8.0)), abs=1e-5)


def test_a_snag_breaks_off_at_full_width():
    """A dead tree's highest ring is over 0.4 of breast height, and its tip stands off the axis."""
    trees = make_trees(0.0, 12)
    origin_m, stems = grow(trees)
    for tree, (_, stem) in zip(trees, stems, strict=True):
        foot = np.array([tree["x_m"], tree["y_m"], tree["z_m"]]) - origin_m
        sides = sides_of(tree)
        ring, tip = stem.vertices_m[-1 - sides : -1] - foot, stem.vertices_m[-1] - foot
        width_m = 2 * np.hypot(*ring[:, :2].T).mean()
        assert width_m > 0.4 * tree["dbh_m"]
        assert np.hypot(*tip[:2]) == pytest.approx(0.4 * width_m, rel=0.02)
        assert tip[2] == pytest.approx(tree["height_m"], abs=1e-4)


def test_lean_rotation_tips_the_vertical_without_twist():
    """The rotation is proper, tips z towards its direction, and leaves the level axis across it alone."""
    lean, towards = np.array([0.0, 5.0, 30.0]), np.array([10.0, 200.0, 75.0])
    for R, tilt, angle in zip(lean_rotation(lean, towards), np.radians(lean), np.radians(towards), strict=True):
        assert np.allclose(R @ R.T, np.eye(3))
        expected = [np.sin(tilt) * np.cos(angle), np.sin(tilt) * np.sin(angle), np.cos(tilt)]
        assert np.allclose(R[:, 2], expected)
        across = np.array([-np.sin(angle), np.cos(angle), 0.0])
        assert np.allclose(R @ across, across)
