"""Triangles, wider ones, and shapes in pieces: what is in them, and that light meets what it meets of the
whole."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from raycast import lab
from raycast.reference import ReferenceScene, frozen

from vlp16emu.foliage import far
from vlp16emu.foliage.far import STRAY_M, FarCaster, within_reach
from vlp16emu.raycast.build import _SHARPEST, _WIDER_M, motion_of, widen
from vlp16emu.raycast.packet import LEVEL
from vlp16emu.raycast.pieces import faces_of, split_into_pieces
from vlp16emu.types import SURFACE, Mesh, Window


def triangles(n, *, sharp=1.0):
    """Corners (n, 3, 3) of random triangles of 1 cm to 1 m, as wide as they are long times `sharp`."""
    rng = np.random.default_rng(4)
    size_m = 10.0 ** rng.uniform(-2, 0, (n, 1))
    a, along = rng.uniform(-20, 20, (n, 3)), rng.normal(size=(n, 3))
    along *= size_m / np.linalg.norm(along, axis=1)[:, None]
    aside = np.cross(along, rng.normal(size=(n, 3)))
    aside *= sharp * size_m / np.linalg.norm(aside, axis=1)[:, None]
    return np.stack([a, a + along, a + rng.uniform(0, 1, (n, 1)) * along + aside], axis=1).astype("f4")


def test_wider_triangles_hold_the_triangle_and_a_margin():
    """Edges of wider triangles lie `_WIDER_M` outside of their own, within rounding, in their planes; at
    sharp corners less, as the sine."""
    for sharp in (1.0, 0.02):
        corners_m = triangles(2000, sharp=sharp)
        wider_m = widen(corners_m.reshape(-1, 3), np.arange(6000, dtype="u4").reshape(-1, 3))
        assert wider_m.shape == (6001, 3)
        wider_m = wider_m[:-1].reshape(-1, 3, 3).astype(float)
        corners_m = corners_m.astype(float)
        normal = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        for k in range(3):
            a_m, b_m = corners_m[:, k], corners_m[:, (k + 1) % 3]
            outwards = np.cross(b_m - a_m, normal)
            outwards /= np.linalg.norm(outwards, axis=1)[:, None]
            for corner in (k, (k + 1) % 3):
                off_m = ((wider_m[:, corner] - a_m) * outwards).sum(axis=1)
                first_m, second_m = (corners_m[:, (corner + i) % 3] - corners_m[:, corner] for i in (1, 2))
                sine = np.linalg.norm(np.cross(first_m, second_m), axis=1)
                sine /= np.linalg.norm(first_m, axis=1) * np.linalg.norm(second_m, axis=1)
                expected_m = _WIDER_M * np.minimum(sine / _SHARPEST, 1.0)
                assert np.abs(off_m - expected_m).max() < 0.02 * _WIDER_M
                assert np.abs(((wider_m[:, corner] - a_m) * normal).sum(axis=1)).max() < 0.05 * _WIDER_M


def test_triangles_of_no_area_stay_where_they_are():
    """A triangle whose corners are one point is left as it is, and one that is a line grows by no more
    than sharp ones do."""
    point, line = np.ones((3, 3), "f4"), np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]], "f4")
    both = np.concatenate([point, line])
    wider_m = widen(both, np.arange(6, dtype="u4").reshape(-1, 3))
    assert np.array_equal(wider_m[:3], point)
    assert np.isfinite(wider_m).all()
    assert np.abs(wider_m[3:6] - line).max() <= 2 * _WIDER_M / _SHARPEST


def drum(radii_m, *, at_m=(0.0, 0.0), height_m=6.0):
    """Wall of 12 sides, 1 m from ring to ring, between rings of radii."""
    z, angle = np.linspace(0.0, height_m, len(radii_m)), np.linspace(0, 2 * np.pi, 12, endpoint=False)
    rings = np.array(radii_m)[:, None, None] * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    rings = rings + np.array([*at_m, 0.0]) + z[:, None, None] * [0.0, 0.0, 1.0]
    here = np.arange(12) + 12 * np.arange(len(radii_m) - 1)[:, None]
    after = np.roll(here, -1, axis=1)
    quads = np.stack([here, after, after + 12, here + 12], axis=-1).reshape(-1, 4)
    return Mesh(rings.reshape(-1, 3).astype("f4"), quads.astype("u4"))


def ground():
    """Square of 20 m, 1 m from its lowest to its highest corner."""
    corners_m = np.array([[-10, -10, 0], [10, -10, 0.5], [10, 10, 1], [-10, 10, 0.5]], "f4")
    return Mesh(corners_m, np.array([[0, 1, 2, 3]], "u4"))


CONE = drum([3.0, 2.5, 2.0, 1.5, 1.0, 0.5, 0.1])
STEMS = [drum([0.2] * 7, at_m=(x, 3.0)) for x in (-6.0, 0.0, 6.0)]


def test_pieces_hold_each_face_once():
    """Faces of each mesh are those of before, in another order, and those of a piece are of one slab."""
    faces = faces_of(CONE)
    ((vertices_m, triangles),), begin, _ = split_into_pieces([faces])
    assert vertices_m is faces[0]
    assert sorted(triangles.tolist()) == sorted(faces[1].tolist())
    heights = [set(vertices_m[triangles[a:b], 2].min(axis=1) // 1.5) for (a,), (b,) in pairwise(begin)]
    assert heights == [{0.0}, {1.0}, {2.0}, {3.0}]


def test_light_meets_pieces_as_it_meets_the_whole(workers):
    """Ranges, surfaces and incidence of stems and a cone on a slope are those of the slow twin, which
    knows no pieces."""
    meshes, place = (ground(), *STEMS, CONE), np.zeros((2, 3, 4))
    place[:, :, :3] = np.eye(3), [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.8]]
    place[:, :, 3] = lab.UTM_M + [[8.0, 0.0, -1.0], [4.0, -12.0, -1.0]]
    surfaces = np.zeros(2 * len(meshes), SURFACE)
    window = Window(lab.UTM_M, ("all",), np.zeros(2, "i4"), place, np.array([0, 5], "u4"), surfaces)
    direction = np.random.default_rng(7).normal(0, [1, 1, 0.2], (2048, 3))
    firings = lab.rays(
        np.tile(lab.UTM_M + [0, 0, 0.1], (2048, 1)), direction / np.linalg.norm(direction, axis=1)[:, None]
    )
    scenes = lab.opened(workers, window, lambda _: meshes), ReferenceScene(window, lambda _: meshes)
    fast, slow = (scene.cast(firings, np.zeros(1), lab.FAR_M) for scene in scenes)
    same = fast.surface == slow.surface
    assert same.mean() > 0.999
    hit = np.isfinite(fast.range_m) & same
    assert set(fast.surface[hit]) == set(range(10))
    assert np.quantile(np.abs(fast.range_m[hit] - slow.range_m[hit]), 0.999) < 1e-4
    assert np.quantile(np.abs(fast.cos_incidence[hit] - slow.cos_incidence[hit]), 0.999) < 1e-3


def test_boxes_hold_the_faces_of_their_pieces():
    """Each piece has the least box around the corners of its faces, whatever else the mesh has."""
    faces = [faces_of(mesh) for mesh in (ground(), CONE)]
    ordered, begin, boxes_m = split_into_pieces(faces)
    assert len(boxes_m) == len(begin) - 1
    for (first, stop), box_m in zip(pairwise(begin), boxes_m, strict=True):
        parts = zip(ordered, first, stop, strict=True)
        corners_m = np.concatenate(
            [vertices_m[triangles[a:b]].reshape(-1, 3) for (vertices_m, triangles), a, b in parts]
        )
        assert np.array_equal(box_m, [corners_m.min(axis=0), corners_m.max(axis=0)])


@pytest.mark.parametrize("moves", [False, True])
def test_no_piece_that_light_may_meet_is_left_out(moves):
    """Places in boxes that are within range of a sensor near the track are in pieces that are kept, and if
    seen level also in those for level rays."""
    rng = np.random.default_rng(5)
    window, reach_m, n = lab.placed(300), 6.0, 300
    window.world_T_shape[:, :, 3] = window.origin_m + rng.uniform(-12, 12, (n, 3))
    track_m = window.origin_m + rng.uniform(-1, 1, (20, 3)).cumsum(axis=0)
    if moves:
        shear = rng.uniform(-3, 3, (3, n, 2))
        foot_z_m = window.world_T_shape[:, 2, 3] - 8.0
        window = replace(window, sway=lab.straight(0, 1000, np.arange(n), foot_z_m, shear))
    low_m = rng.uniform(-1, 0, (n, 3))
    boxes_m = np.stack([low_m, low_m + rng.uniform(0, 2, (n, 3))], axis=1)
    motion = motion_of(window, np.arange(n), boxes_m)
    pieces = SimpleNamespace(window=window, placement=np.arange(n), boxes_m=boxes_m, motion=motion)
    met, level = within_reach(pieces, track_m, reach_m)
    assert 0.05 < level.mean() < met.mean() - 0.05 < 0.9
    stray_m = rng.normal(size=(200, 3))
    stray_m *= STRAY_M * rng.uniform(0, 1, (200, 1)) / np.linalg.norm(stray_m, axis=1)[:, None]
    for t_ns in (0, 700, 2000):
        world_T_shape = frozen(window, t_ns).world_T_shape
        for at_m in track_m[rng.integers(0, 20, 200)] + stray_m:
            inside_m = boxes_m[:, 0] + rng.uniform(0, 1, (n, 3)) * np.diff(boxes_m, axis=1)[:, 0]
            there_m = np.einsum("nij,nj->ni", world_T_shape[..., :3], inside_m) + world_T_shape[..., 3] - at_m
            range_m = np.linalg.norm(there_m, axis=1)
            assert met[range_m <= reach_m].all()
            assert level[(range_m <= reach_m) & (np.abs(there_m[:, 2]) <= LEVEL * range_m)].all()


@pytest.mark.parametrize("model", ["none", "adaptive"])
def test_pieces_are_left_out_without_loss(workers, monkeypatch, model):
    """Level pulses, steep ones and both in turn meet what they meet where each piece is built, in every
    bit."""
    world, track_m = lab.Tiles(near_m=9.0), np.array([[10.0, 10.0, 6.0], [12.0, 11.0, 6.0]])
    rng = np.random.default_rng(6)
    beam, mixed = [] if model == "none" else [lab.beam(model)], rng.uniform(-1.5, 1.5, 512)
    scene = FarCaster(world, workers).open(world.window(track_m))
    built = scene._near
    monkeypatch.setattr(far, "within_reach", lambda near, *_: 2 * (np.ones(len(near.placement), np.bool_),))
    whole = FarCaster(world, workers).open(world.window(track_m))
    for rise in (0.2 * mixed, 0.4 * mixed, mixed):
        azimuth = np.sort(rng.uniform(0, 2 * np.pi, len(rise)))
        direction = np.column_stack(
            [np.cos(azimuth) * np.cos(rise), np.sin(azimuth) * np.cos(rise), np.sin(rise)]
        )
        firings = lab.rays(np.broadcast_to(track_m[0] + 0.3, direction.shape), direction)
        hits, of_whole = (each.cast(firings, np.zeros(1), 60.0, *beam) for each in (scene, whole))
        assert np.isfinite(hits.range_m).mean() > 0.25
        lab.assert_same_bits(hits, of_whole)
        assert (scene._near is built) == (np.abs(rise).max() < 0.31)
    assert not built.steep
    assert scene._near.steep
