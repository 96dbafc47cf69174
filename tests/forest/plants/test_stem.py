"""Stems and the exactness of their diameter."""

from itertools import product

import numpy as np
import pytest
import trimesh

from vlp16emu.forest.plants.flora import species_table
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


def joined(flare, stem):
    """One solid of both meshes, whose shared ring becomes one."""
    vertices = np.concatenate([flare.vertices_m, stem.vertices_m])
    faces = np.concatenate([flare.faces, stem.faces + len(flare.vertices_m)])
    unique, index = np.unique(vertices, axis=0, return_inverse=True)
    return trimesh.Trimesh(unique.astype(np.float64), index.ravel()[faces], process=False)


def area_diameter_m(solid, middle, axis):
    """Diameter of the circle with the area of a solid's cross-section around a point of its axis."""
    cut = trimesh.intersections.mesh_plane(solid, plane_normal=axis, plane_origin=middle) - middle
    area_m2 = np.linalg.norm(np.cross(cut[:, 0], cut[:, 1]), axis=1).sum() / 2
    return 2 * np.sqrt(area_m2 / np.pi)


def test_area_at_breast_height_is_that_of_the_dbh():
    """Cut across the axis where it is 1.3 m above the foot, a stem has the area of its DBH within 0.1 mm, DBH 5 to 120 cm."""
    for lean_deg, (name, species) in product((0.0, 8.0), species_table().items()):
        trees = make_trees(lean_deg, species.number)
        origin_m, stems = grow(trees)
        axes = lean_rotation(trees["lean_deg"], trees["lean_towards_deg"])[:, :, 2]
        for tree, (_, stem), axis in zip(trees, stems, axes, strict=True):
            solid = trimesh.Trimesh(stem.vertices_m.astype(np.float64), stem.faces, process=False)
            foot = np.array([tree["x_m"], tree["y_m"], tree["z_m"]]) - origin_m
            for above in (1.3 - 1e-4, 1.3 + 1e-4):  # on either side of the ring, where cuts are well defined
                middle = foot + axis * above / axis[2]
                assert area_diameter_m(solid, middle, axis) == pytest.approx(tree["dbh_m"], abs=1e-4), (name, lean_deg)


@pytest.mark.parametrize("species", [1, 4, 12])
def test_flare_and_stem_are_closed_together(species):
    """Joined at their shared ring, both meshes are one watertight solid that shows its outside, broken top or not."""
    for meshes in grow(make_trees(3.0, species))[1]:
        solid = joined(*meshes)
        assert solid.is_watertight
        assert solid.is_winding_consistent
        assert solid.volume > 0


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


def test_a_ring_lies_exactly_at_breast_height():
    """Of an upright stem a whole ring of vertices is 1.3 m above the terrain at the foot."""
    trees = make_trees(0.0)
    origin_m, stems = grow(trees)
    for tree, (_, stem) in zip(trees, stems, strict=True):
        above = stem.vertices_m[:, 2] + origin_m[2] - tree["z_m"]
        assert (np.abs(above - 1.3) < 5e-6).sum() == sides_of(tree)


def test_foot_is_buried_all_around():
    """On a slope the lowest ring lies under the ground on every side."""
    trees = make_trees(3.0)
    origin_m, stems = grow(trees)
    for tree, (flare, _) in zip(trees, stems, strict=True):
        sides = sides_of(tree)
        ring = flare.vertices_m[1 : 1 + sides].astype(np.float64) + origin_m
        assert (ring[:, 2] < slope(ring[:, 0], ring[:, 1])).all()


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
