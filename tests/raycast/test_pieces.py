"""Shapes in pieces: what is in them, and that light meets what it meets of the whole."""

from itertools import pairwise

import numpy as np

from vlp16emu.raycast.near import EmbreeCaster
from vlp16emu.raycast.pieces import in_pieces
from vlp16emu.raycast.quads import faces_of
from vlp16emu.raycast.slow import PlainCaster
from vlp16emu.types import SURFACE, Mesh, Window


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
WALL = drum([3.0] * 7)
STEMS = [drum([0.2] * 7, at_m=(x, 3.0)) for x in (-6.0, 0.0, 6.0)]
EMPTY = Mesh(np.zeros((0, 3), "f4"), np.zeros((0, 4), "u4"))


def counts(*meshes):
    """How many faces of each mesh are in each piece."""
    return np.diff(in_pieces([faces_of(mesh) for mesh in meshes])[1], axis=0).tolist()


def test_ground_and_stems_are_pieces_of_their_own():
    """What stands apart is in boxes of its own, and what has no faces is in none."""
    assert counts(ground(), EMPTY, *STEMS) == [[1, 0, 0, 0, 0], *np.diag([72] * 5)[2:].tolist()]


def test_what_tapers_is_cut_into_slabs():
    """A cone of 6 m has pieces of 1.5 m height, and a wall of one width, whose slabs are as wide as it is, has one."""
    assert counts(CONE) == [[24], [12], [24], [12]]
    assert counts(WALL) == [[72]]


def test_meshes_inside_each_other_share_pieces():
    """Leaves and branches of a crown are one piece to each slab, not one each."""
    assert counts(CONE, drum([2.5, 2.0, 1.5, 1.0, 0.5, 0.25, 0.05])) == [
        [24] * 2,
        [12] * 2,
        [24] * 2,
        [12] * 2,
    ]


def test_pieces_hold_each_face_once():
    """Faces of each mesh are those of before, in another order, and those of a piece are of one slab."""
    faces = faces_of(CONE)
    ((vertices_m, quads),), begin = in_pieces([faces])
    assert vertices_m is faces[0]
    assert sorted(quads.tolist()) == sorted(faces[1].tolist())
    heights = [set(vertices_m[quads[a:b, 0], 2] // 1.5) for (a,), (b,) in pairwise(begin)]
    assert heights == [{0.0}, {1.0}, {2.0}, {3.0}]


def test_light_meets_pieces_as_it_meets_the_whole(lab, workers):
    """Ranges, surfaces and incidence of stems and a cone on a slope are those of the plain class, which knows no pieces."""
    meshes, place = (ground(), *STEMS, CONE), np.zeros((2, 3, 4))
    place[:, :, :3] = np.eye(3), [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.8]]
    place[:, :, 3] = lab.utm_m + [[8.0, 0.0, -1.0], [4.0, -12.0, -1.0]]
    surfaces = np.zeros(2 * len(meshes), SURFACE)
    window = Window(lab.utm_m, ("all",), np.zeros(2, "i4"), place, np.array([0, 5], "u4"), surfaces)
    firings = lab.pulses(2048)
    fast, slow = (
        caster.open(window).cast(firings, lab.near_m, lab.far_m)
        for caster in (EmbreeCaster(lab.world(lambda _: meshes), workers), PlainCaster(lambda _: meshes))
    )
    same = fast.surface == slow.surface
    assert same.mean() > 0.999
    hit = np.isfinite(fast.range_m) & same
    assert set(fast.surface[hit]) == set(range(10))
    assert np.quantile(np.abs(fast.range_m[hit] - slow.range_m[hit]), 0.999) < 1e-4
    assert np.quantile(np.abs(fast.cos_incidence[hit] - slow.cos_incidence[hit]), 0.999) < 1e-3
