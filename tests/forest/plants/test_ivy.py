"""Ivy on stems."""

import numpy as np
import pytest
from forest.kit import areas_m2, corners, trees_of
from scipy import stats

from vlp16emu.forest.plants.foliage import IvyKey, ivy_meshes, ivy_tops_m
from vlp16emu.forest.plants.stem import Stems
from vlp16emu.forest.settings import Ivy
from vlp16emu.forest.tiles import TileKey
from vlp16emu.types import PlantPart, Semantic

SECTION = Ivy(share=0.3, height_m=(2.0, 6.0))


@pytest.fixture(scope="module")
def trees():
    """Trees with bent stems, anywhere."""
    rng, n = np.random.default_rng(3), 3000
    x_m, y_m = rng.uniform(-500, 500, (2, n))
    size = {"dbh_m": 0.35, "height_m": 24.0, "crown_base_m": 9.0, "crown_width_m": 6.0, "lean_deg": 2.0}
    return trees_of(["european_beech"] * n, x_m=x_m, y_m=y_m, form=rng.integers(1, 2**63, n), **size)


def test_a_share_of_stems_has_ivy_up_to_heights_in_the_range(trees):
    """Three in ten have some, within 3 sigma, with even heights, and a tree's does not depend on which
    others stand."""
    tops_m = ivy_tops_m(trees, SECTION.share, SECTION.height_m, seed=6)
    has = tops_m > 0
    assert has.mean() == pytest.approx(0.3, abs=3 * np.sqrt(0.21 / len(trees)))
    assert stats.kstest(tops_m[has], stats.uniform(2, 4).cdf).pvalue > 0.01
    assert np.array_equal(ivy_tops_m(trees[7::11], SECTION.share, SECTION.height_m, seed=6), tops_m[7::11])
    assert not np.array_equal(ivy_tops_m(trees, SECTION.share, SECTION.height_m, seed=7), tops_m)
    low = trees.copy()
    low["crown_base_m"] = 1.5
    assert ivy_tops_m(low, SECTION.share, SECTION.height_m, seed=6).max() == 1.5


def test_leaves_hang_on_the_bark(trees):
    """Quads of twice the area of the bark, by the DBH, start 2 to 12 cm off it, from the ground to the
    top; without ivy there are none."""
    few = trees[:3]
    meshes = ivy_meshes(few, np.array([5.0, 0.0, 3.0]), np.zeros(3), seed=6, tile=TileKey(0, 0))
    stems = Stems(few)
    assert len(meshes[1].faces) == 0
    for i, top_m in ((0, 5.0), (2, 3.0)):
        leaves = corners(meshes[i])
        assert areas_m2(leaves).sum() == pytest.approx(2 * np.pi * 0.35 * top_m, rel=0.05)
        base = leaves[:, 0] - [few["x_m"][i], few["y_m"][i], 0.0]
        axis = stems.axis_m(base[None, :, 2], np.array([i]))[0]
        away = np.hypot(*(base - axis)[:, :2].T)
        off = away - np.interp(base[:, 2], stems.above_ground_m[i], stems.radius_m[i])
        assert 0.019 < off.min() < 0.03
        assert 0.11 < off.max() < 0.121
        assert 0 <= base[:, 2].min() < 0.05
        assert 0.85 * top_m < base[:, 2].max() <= top_m


def test_ivy_is_leaf_of_its_tree_and_in_the_medium(make_forest, forest, track_m):
    """Surfaces of ivy have class tree, part leaf and the number of a tree, in the far medium too; all else
    stands as without ivy, the default."""
    bare, forest = forest.window(track_m), make_forest(ivy=SECTION)
    window = forest.window(track_m)
    is_ivy = np.array([isinstance(window.shapes[i], IvyKey) for i in window.shape])
    assert np.array_equal(window.world_T_shape[~is_ivy], bare.world_T_shape)
    own = np.flatnonzero(is_ivy)
    rows, trees = window.surfaces[window.first_surface[own]], forest.trees(track_m)
    assert 0.2 * len(trees) < len(own) < 0.4 * len(trees)
    assert set(rows["part"]) == {PlantPart.LEAF}
    assert set(rows["semantic"]) == {Semantic.TREE}
    assert set(rows["instance"].tolist()) <= set(trees["id"].tolist())
    assert len(set(rows["instance"].tolist())) == len(rows)
    key = window.shapes[window.shape[own[0]]]
    assert any(isinstance(one, IvyKey) for one in forest.far_tile(key.tile.ix, key.tile.iy).keys)
    (mesh,) = forest.shape(key)
    tree = trees[trees["id"] == rows["instance"][0]][0]
    at_m = mesh.vertices_m @ window.world_T_shape[own[0], :, :3].T + window.world_T_shape[own[0], :, 3]
    assert np.hypot(*(at_m[:, :2].mean(axis=0) - [tree["x_m"], tree["y_m"]])) < 1.0
