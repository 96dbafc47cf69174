"""Circles along the branches that leave stems."""

import numpy as np
import pytest

from vlp16emu.forest.plants.crown import CROWN_PARTS, CrownKey, crown_branches, crown_meshes, crown_placements
from vlp16emu.forest.plants.flora import species_table
from vlp16emu.forest.stand.inventory import branch_circles
from vlp16emu.forest.stand.stand import TREE
from vlp16emu.types import PlantPart

NAMES = ["norway_spruce", "european_beech", "snag"]
SIDES, RINGS = 6, 8
FIRST, DEAD = PlantPart.BRANCH_FIRST_ORDER, PlantPart.DEAD_BRANCH


@pytest.fixture(scope="module")
def trees():
    trees = np.zeros(len(NAMES), TREE)
    trees["id"] = 70 + np.arange(len(NAMES))
    trees["species"] = [species_table()[name].number for name in NAMES]
    trees["x_m"], trees["y_m"], trees["z_m"] = 6.0 * np.arange(len(NAMES)), -3.0, 2.0
    trees["dbh_m"], trees["height_m"] = 0.3, [24.0, 22.0, 12.0]
    trees["crown_base_m"], trees["crown_width_m"] = [13.0, 11.0, 6.0], [4.8, 7.0, 2.0]
    trees["crown_azimuth_deg"] = [0.0, 30.0, 100.0]
    trees["lean_deg"], trees["lean_towards_deg"] = [0.0, 3.0, 2.0], 70.0
    return trees


@pytest.fixture(scope="module")
def crowns():
    """Prototypes of other sizes than the trees."""
    keys = ((0.27, 26.0, 13.0, 4.0, 90.0), (0.33, 20.0, 10.5, 8.0, 120.0), (0.3, 13.0, 6.0, 2.2, 0.0))
    return [CrownKey(name, 1, *key, dead_branches=True) for name, key in zip(NAMES, keys, strict=True)]


@pytest.fixture(scope="module")
def circles(trees, crowns):
    return branch_circles(trees, crowns, seed=6)


def test_circles_are_the_rings_of_the_scanned_branches(trees, crowns, circles):
    """Their middles are those of the mesh's rings, to 0.1 mm, and areas across the axis are as of the tube, within 0.1 %."""
    half = np.pi / SIDES
    # The tube has the girth of the round branch.
    tube_over_circle = SIDES / 2 * np.sin(2 * half) * (half / np.sin(half)) ** 2 / np.pi
    for i in (0, 1):
        mesh = crown_meshes(6, crowns[i])[CROWN_PARTS.index(FIRST)]
        world_T = crown_placements(trees, crowns)[i]
        corners_m = (mesh.vertices_m @ world_T[:, :3].T + world_T[:, 3]).reshape(-1, SIDES * RINGS + 1, 3)
        ring_m = corners_m[:, :-1].reshape(-1, RINGS, SIDES, 3)
        own = circles[(circles["tree"] == 70 + i) & (circles["part"] == FIRST)].reshape(-1, RINGS + 1)
        middle_m = np.stack([own[f"{axis}_m"] for axis in "xyz"], axis=-1)
        assert middle_m[:, :-1] == pytest.approx(ring_m.mean(axis=2), abs=1e-4)
        assert middle_m[:, -1] == pytest.approx(corners_m[:, -1], abs=1e-4)
        prototype = crown_branches(6, crowns[i])[0]
        along = np.gradient(prototype.nodes_m, axis=1)[:, :-1] @ world_T[:, :3].T
        along /= np.linalg.norm(along, axis=-1, keepdims=True)
        away_m = ring_m - ring_m.mean(axis=2, keepdims=True)
        area_m2 = np.cross(away_m, np.roll(away_m, -1, axis=2)).sum(axis=2) / 2
        across_m2 = np.abs((area_m2 * along).sum(axis=-1))
        thick = own["radius_m"][:, :-1] > 0.005
        ratio = across_m2[thick] / (np.pi * own["radius_m"][:, :-1][thick] ** 2)
        assert ratio == pytest.approx(tube_over_circle, rel=1e-3)


def test_branches_begin_on_the_axis_and_thin_to_a_tip(trees, circles):
    """Each branch has a number of its own on the tree, begins on the line from foot to tip and ends with radius 0."""
    for tree in trees:
        own = circles[circles["tree"] == tree["id"]].reshape(-1, RINGS + 1)
        assert (own["branch"] == 1 + np.arange(len(own))[:, None]).all()
        assert (own["leader"] == 1).all()
        slope = np.tan(np.radians(tree["lean_deg"]))
        towards = np.radians(tree["lean_towards_deg"])
        up_m = own["above_foot_m"][:, 0]
        assert own["x_m"][:, 0] == pytest.approx(tree["x_m"] + slope * np.cos(towards) * up_m, abs=1e-6)
        assert own["y_m"][:, 0] == pytest.approx(tree["y_m"] + slope * np.sin(towards) * up_m, abs=1e-6)
        assert (np.diff(own["radius_m"], axis=1) < 0.002).all()
        assert (own["radius_m"][:, -1] == 0).all()


def test_a_dead_tree_has_dead_branches_alone(circles):
    """A snag's branches are all dead; a spruce has living and dead ones, whose parts say so."""
    assert set(circles["part"][circles["tree"] == 72]) == {DEAD}
    assert set(circles["part"][circles["tree"] == 70]) == {FIRST, DEAD}


def test_without_dead_branches_there_are_none(trees, crowns):
    """Of crowns without dead branches below, the living ones alone are listed."""
    bare = [CrownKey(*(getattr(key, name) for name in CrownKey.__slots__[:-1])) for key in crowns[:2]]
    assert set(branch_circles(trees[:2], bare, seed=6)["part"]) == {FIRST}
