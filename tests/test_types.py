"""The types that travel refuse wrong shapes and keep right ones."""

import numpy as np
import pytest

from vlp16emu.types import SURFACE, Firings, Hits, Mesh, Poses, Returns, Window

K, L = 3, 16


GOOD = {
    Poses: {"t_ns": np.zeros(2, np.int64), "world_R_body": np.zeros((2, 3, 3)), "world_p_body_m": np.zeros((2, 3))},
    Firings: {
        "index": 0,
        "t_ns": np.zeros((K, L), np.int64),
        "clock_ns": np.zeros(K, np.int64),
        "azimuth_deg": np.zeros((K, L)),
        "reading_deg": np.zeros(K),
        "origin_m": np.zeros((K, L, 3)),
        "direction": np.zeros((K, L, 3)),
        "beam_axis": None,
    },
    Hits: {
        "count": np.ones((K, L), np.uint16),
        "range_m": np.zeros(K * L, np.float32),
        "surface": np.zeros(K * L, np.uint32),
        "cos_incidence": np.zeros(K * L, np.float32),
    },
    Window: {
        "origin_m": np.zeros(3),
        "shapes": ("a",),
        "shape": np.zeros(2, np.int32),
        "world_T_shape": np.zeros((2, 3, 4)),
        "first_surface": np.zeros(2, np.uint32),
        "surfaces": np.zeros(2, SURFACE),
    },
    Mesh: {"vertices_m": np.zeros((5, 3), np.float32), "faces": np.zeros((1, 4), np.uint32)},
}
GOOD[Returns] = {
    "firings": Firings(**GOOD[Firings]),
    "distance_m": np.zeros((K, L, 3), np.float32),
    "reflectivity": np.zeros((K, L, 3), np.uint8),
}


BAD = [
    (Poses, "world_p_body_m", np.zeros((3, 3)), "(3, 3) float64, expected (2, 3) float64"),
    (Firings, "clock_ns", np.zeros(K), "(3,) float64, expected (3) int64"),
    (Firings, "beam_axis", np.zeros((K, L, 2)), "(3, 16, 2) float64, expected (3, 16, 3) float64"),
    (Hits, "surface", np.zeros(K * L + 1, np.uint32), "(49,) uint32, expected (48) uint32"),
    (Returns, "reflectivity", np.zeros((K, L, 2), np.uint8), "(3, 16, 2) uint8, expected (3, 16, 3) uint8"),
    (Returns, "distance_m", [1.0], "list, expected (3, 16, 3) float32"),
    (Window, "shape", np.zeros(2), "(2,) float64, expected (2) int32"),
    (Mesh, "faces", np.zeros((1, 5), np.uint32), "(1, 5) uint32, expected (n, 3) uint32"),
]


@pytest.mark.parametrize(("kind", "name", "array", "found"), BAD)
def test_a_wrong_shape_is_refused(kind, name, array, found):
    """An array of the wrong shape or dtype is refused by name, with what was found and expected."""
    with pytest.raises(ValueError, match=r": found ") as caught:
        kind(**GOOD[kind] | {name: array})
    assert str(caught.value) == f"{kind.__name__}.{name}: found {found}"
