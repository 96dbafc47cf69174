"""What stands near a way, and pieces cut out of a window."""

import numpy as np
import pytest

from vlp16emu.forest.stand.nearby import cut_out, things_near
from vlp16emu.forest.stand.stand import REGENERATION
from vlp16emu.forest.tiles import TileKey
from vlp16emu.types import NO_SURFACE, PlantPart, Semantic
from vlp16emu.world.hall import HallWorld
from vlp16emu.world.polyline import Polyline
from vlp16emu.world.settings import Hall, HallPole

RADIUS_M = 12.0


@pytest.fixture(scope="module")
def window(full_forest, track_m):
    return full_forest.window(track_m)


@pytest.fixture(scope="module")
def trees(full_forest, track_m):
    trees = full_forest.trees(track_m)
    return trees[trees["storey"] != REGENERATION]


@pytest.fixture(scope="module")
def things(full_forest, window, trees, track_m):
    way = Polyline(track_m[:, :2])
    return things_near(window, full_forest.shape, trees=trees["id"], path=way, radius_m=RADIUS_M)


def test_things_are_all_that_is_near_and_no_tree(window, things, trees, track_m):
    """Things are exactly the placed instances within the radius that are neither ground nor trees of the stand."""
    first = window.surfaces[window.first_surface]
    gap_m = Polyline(track_m[:, :2]).distance_m(window.world_T_shape[:, :2, 3])
    is_thing = (first["semantic"] != Semantic.GROUND) & ~np.isin(first["instance"], trees["id"])
    assert {one.instance for one in things} == set(first["instance"][is_thing & (gap_m <= RADIUS_M)].tolist())
    assert {one.kind for one in things} >= {"sapling", "shrub", "stone", "log", "stump", "tuft"}


def test_an_outline_holds_the_whole_thing(full_forest, window, things):
    """No vertex of a placed thing lies outside its outline by more than rounding."""
    for kind in ("log", "stone", "sapling", "shrub"):
        thing = next(one for one in things if one.kind == kind)
        meshes = full_forest.shape(window.shapes[window.shape[thing.placement]])
        T = window.world_T_shape[thing.placement]
        xy_m = (np.concatenate([m.vertices_m for m in meshes]) @ T[:, :3].T + T[:, 3])[:, :2]
        edge = np.roll(thing.outline_m, -1, axis=0) - thing.outline_m
        to = xy_m[:, None] - thing.outline_m
        left = edge[:, 0] * to[..., 1] - edge[:, 1] * to[..., 0]
        assert (left / np.linalg.norm(edge, axis=1)).min() > -1e-6


def test_sizes_are_those_of_the_thing(things):
    """A log is as long as its outline, and no stone is longer than stones can be."""
    logs = [one for one in things if one.kind == "log"]
    for log in logs:
        spans_m = np.linalg.norm(log.outline_m[:, None] - log.outline_m, axis=-1)
        assert spans_m.max() == pytest.approx(log.size_m[0], rel=0.15)
        assert 0.2 <= log.size_m[1] <= 0.5
    assert all(0.1 <= one.size_m[0] <= 1.5 for one in things if one.kind == "stone")


def test_a_hall_keeps_its_sizes():
    """A pole in a hall is told with its place, diameter and height."""
    pole = HallPole(name="pole", foot_m=(2.0, 1.0, 0.0), diameter_m=0.35, height_m=3.0)
    hall = HallWorld(Hall(kind="hall", length_m=10, width_m=8, height_m=4, poles=[pole]))
    track_m = np.array([[0.0, 0.0, 1.0]])
    things = things_near(
        hall.window(track_m), hall.shape, trees=np.zeros(0, np.uint32), path=Polyline(track_m[:, :2]), radius_m=np.inf
    )
    assert [one.kind for one in things] == ["ground", "other"]
    assert things[1].place_m.tolist() == [2.0, 1.0, 0.0]
    assert things[1].size_m == pytest.approx((0.35, 0.35, 3.0), abs=1e-4)
    assert hall.size_m == (10, 8, 4)


def test_a_piece_holds_what_is_wanted_and_ground_inside(full_forest, window, trees):
    """In a cut-out every face belongs to a wanted instance, or to ground inside the place; all else is as before."""
    wanted = trees["id"][:5]

    def inside(xy_m):
        return np.hypot(*(xy_m - [5.0, 1.0]).T) < 9.0

    piece, grow = cut_out(window, full_forest.shape, instances=wanted, inside=inside)
    assert piece.surfaces is window.surfaces
    seen, parts = set(), set()
    ground_m2 = 0.0
    for which, first, T in zip(piece.shape, piece.first_surface, piece.world_T_shape, strict=True):
        key = piece.shapes[which]
        for number, mesh in enumerate(grow(key)):
            row = piece.surfaces[int(first) + number]
            if not len(mesh.faces):
                continue
            if isinstance(key, TileKey) and row["semantic"] == Semantic.GROUND:
                corners = mesh.vertices_m[mesh.faces].astype(np.float64)
                assert inside(corners.mean(axis=1)[:, :2] + T[:2, 3]).all()
                ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
                ground_m2 += abs(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]).sum() / 2
            else:
                seen.add(int(row["instance"]))
                parts.add(int(row["part"]))
                original = full_forest.shape(key)[number]
                assert mesh.faces.tobytes() == original.faces.tobytes()
    assert ground_m2 == pytest.approx(np.pi * 81, rel=0.02)
    assert seen == {int(i) for i in wanted if np.isin(i, window.surfaces["instance"][window.first_surface])}
    assert PlantPart.STEM in parts


def test_a_piece_can_be_without_any_thing(full_forest, window):
    """With nothing wanted only ground is left, and no surface number is the one that means nothing."""
    piece, grow = cut_out(
        window, full_forest.shape, instances=np.zeros(0, np.uint32), inside=lambda xy_m: np.ones(len(xy_m), np.bool_)
    )
    assert all(isinstance(key, TileKey) for key in piece.shapes)
    assert (piece.first_surface != NO_SURFACE).all()
    assert all(not len(mesh.faces) for mesh in grow(piece.shapes[0])[1:])
