"""Triangles, wider ones and transforms as casters want them."""

import numpy as np
from raycast.reference import flatten

from vlp16emu.raycast.build import _SHARPEST, _WIDER_M, widened
from vlp16emu.raycast.pieces import faces_of
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


def test_a_quad_is_two_triangles():
    """A quad (a, b, c, d) is (a, b, d) and (c, d, b), turned as it is, and triangles are left as they are."""
    corners_m = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "f4")
    quads = Mesh(corners_m, np.array([[0, 1, 2, 3]], "u4"))
    assert faces_of(quads)[1].tolist() == [[0, 1, 3], [2, 3, 1]]
    three = Mesh(corners_m, np.array([[0, 1, 2]], "u4"))
    assert faces_of(three)[1].tolist() == [[0, 1, 2]]
    place = np.eye(4)[None, :3]
    window = Window(np.zeros(3), ("one",), np.zeros(1, "i4"), place, np.zeros(1, "u4"), np.zeros(1, SURFACE))
    flat_m, _ = flatten(window, lambda _: (quads,))
    assert np.array_equal(flat_m, corners_m[[[0, 1, 3], [2, 3, 1]]])


def test_wider_triangles_hold_the_triangle_and_a_margin():
    """Edges of wider triangles lie `_WIDER_M` outside of their own, within rounding, in their planes; at sharp corners less, as the sine."""
    for sharp in (1.0, 0.02):
        corners_m = triangles(2000, sharp=sharp)
        wider_m = widened(corners_m.reshape(-1, 3), np.arange(6000, dtype="u4").reshape(-1, 3))
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
    """A triangle whose corners are one point is left as it is, and one that is a line grows by no more than sharp ones do."""
    point, line = np.ones((3, 3), "f4"), np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]], "f4")
    both = np.concatenate([point, line])
    wider_m = widened(both, np.arange(6, dtype="u4").reshape(-1, 3))
    assert np.array_equal(wider_m[:3], point)
    assert np.isfinite(wider_m).all()
    assert np.abs(wider_m[3:6] - line).max() <= 2 * _WIDER_M / _SHARPEST
