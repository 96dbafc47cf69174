"""Roots on the ground."""

import numpy as np
import pytest
import trimesh

from vlp16emu.forest.plants.flora import species_table
from vlp16emu.forest.plants.stem import ROOT_RINGS, ROOT_SIDES, root_points, stem_meshes
from vlp16emu.forest.plants.stem_rings import stem_rings
from vlp16emu.forest.stand.stand import TREE

N = 400


def slope(x, y):
    """Ground that rises by 30 degrees to the east."""
    return 0.577 * x + 0.0 * y


@pytest.fixture(scope="module")
def trees():
    """Beeches and spruces of 0.32 m to 0.8 m on a slope."""
    rng, trees = np.random.default_rng(3), np.zeros(N, TREE)
    trees["species"] = [species_table()[n].number for n in ("european_beech", "norway_spruce")] * (N // 2)
    trees["x_m"], trees["y_m"] = rng.uniform(-500, 500, (2, N))
    trees["z_m"] = slope(trees["x_m"], trees["y_m"])
    trees["dbh_m"], trees["height_m"], trees["crown_base_m"] = rng.uniform(0.32, 0.8, N), 30.0, 12.0
    trees["crown_width_m"], trees["form"] = 6.0, rng.integers(1, 2**63, N)
    trees["crown_azimuth_deg"] = rng.uniform(0, 360, N)
    return trees


def roots_of(trees, height_m=slope):
    return root_points(trees, stem_rings(trees), height_m)


def test_old_spruces_and_beeches_have_roots_and_no_others(trees):
    """Of 3 to 6 lobes three quarters have a root on spruces and 55 % on beeches; thin trees, pines and straight stems have none."""
    stem, _ = roots_of(trees)
    for first, share in ((0, 0.55), (1, 0.75)):
        assert (stem % 2 == first).sum() / (N / 2) == pytest.approx(4.5 * share, rel=0.1)
    for changes in ({"dbh_m": 0.29}, {"species": species_table()["scots_pine"].number}, {"form": 0}):
        others = trees.copy()
        for name, value in changes.items():
            others[name] = value
        assert len(roots_of(others)[0]) == 0


def test_roots_run_along_the_ground_half_buried_and_dive(trees):
    """They reach 0.5 m to 2 m from the butt, rise over the ground by less than half a DBH, and end in it."""
    stem, points_m = roots_of(trees)
    rings_m = points_m[:, 1:-1].reshape(len(stem), ROOT_RINGS, ROOT_SIDES, 3)
    away_m = np.hypot(*np.moveaxis(points_m[:, -1, :2], -1, 0)) - 0.8 * stem_rings(trees).radius_m[stem, 1]
    assert (away_m > 0.5).all()
    assert away_m.max() < 2.2
    x, y, z = np.moveaxis(rings_m, -1, 0)
    foot = trees[stem][:, None, None]
    over_m = z + foot["z_m"] - slope(x + foot["x_m"], y + foot["y_m"])
    downhill = points_m[:, -1, 0] < 0
    assert (over_m.max(axis=2)[downhill, :4] > 0).mean() > 0.95
    assert (over_m.min(axis=2) < 0).all()
    assert (over_m.max(axis=(1, 2)) < 0.5 * trees["dbh_m"][stem]).all()
    level = roots_of(trees, lambda x, y: trees["z_m"][stem][:, None] + 0 * x)[1]
    assert (level[:, -1, 2] < 0).all()


def test_no_root_reaches_breast_height(trees):
    """On a slope of 30 degrees no vertex of a root is higher than 0.3 m over the foot of its tree."""
    _, points_m = roots_of(trees)
    assert points_m[..., 2].max() <= 0.3 + 1e-12


def test_stems_are_the_same_with_roots_and_without(trees, rootless):
    """Roots are closed pieces of the mesh of the root flare, whose other vertices, like all of the stem's mesh, stay as they are."""
    few = trees[:40]
    mine, plain = stem_meshes(few, np.zeros(3), slope), stem_meshes(few, np.zeros(3), slope, table=rootless)
    numbers = np.bincount(roots_of(few)[0], minlength=len(few))
    for i, count in enumerate(numbers.tolist()):
        assert mine[2 * i + 1].vertices_m.tobytes() == plain[2 * i + 1].vertices_m.tobytes()
        own, base = mine[2 * i], plain[2 * i]
        assert np.array_equal(own.vertices_m[: len(base.vertices_m)], base.vertices_m)
        assert np.array_equal(own.faces[: len(base.faces)], base.faces)
        pieces = np.split(own.faces[len(base.faces) :], count) if count else []
        assert count or len(own.faces) == len(base.faces)
        for faces in pieces:
            root = trimesh.Trimesh(own.vertices_m, faces, process=False)
            assert root.is_watertight
            assert root.volume > 0


def test_the_roots_of_a_tree_are_its_own(trees):
    """A tree alone has the roots that it has among others."""
    stem, points_m = roots_of(trees)
    for i in (0, 7, 200):
        assert np.array_equal(roots_of(trees[i : i + 1])[1], points_m[stem == i])
