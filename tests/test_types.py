"""The types that travel refuse wrong shapes and keep right ones."""

import dataclasses

import numpy as np
import pytest

from vlp16emu import types
from vlp16emu.types import SURFACE, Firings, Hits, Mesh, PacketKind, Poses, PpsState, ReturnMode, Returns, Window

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
}
GOOD[Returns] = {
    "firings": Firings(**GOOD[Firings]),
    "distance_m": np.zeros((K, L, 3), np.float32),
    "reflectivity": np.zeros((K, L, 3), np.uint8),
}


BAD = [
    (Poses, "world_p_body_m", np.zeros((3, 3)), "(3, 3) float64, expected (2, 3) float64"),
    (Poses, "t_ns", np.zeros(2), "(2,) float64, expected (n) int64"),
    (Firings, "clock_ns", np.zeros(K), "(3,) float64, expected (3) int64"),
    (Firings, "direction", np.zeros((K, L)), "(3, 16) float64, expected (3, 16, 3) float64"),
    (Firings, "beam_axis", np.zeros((K, L, 2)), "(3, 16, 2) float64, expected (3, 16, 3) float64"),
    (Hits, "surface", np.zeros(K * L + 1, np.uint32), "(49,) uint32, expected (48) uint32"),
    (Hits, "range_m", np.zeros(K * L), "(48,) float64, expected (n) float32"),
    (Returns, "reflectivity", np.zeros((K, L, 2), np.uint8), "(3, 16, 2) uint8, expected (3, 16, 3) uint8"),
    (Returns, "distance_m", [1.0], "list, expected (3, 16, 3) float32"),
    (Window, "shape", np.zeros(2), "(2,) float64, expected (2) int32"),
]


@pytest.mark.parametrize(("kind", "name", "array", "found"), BAD)
def test_a_wrong_shape_is_refused(kind, name, array, found):
    """An array of the wrong shape or dtype is refused by name, with what was found and expected."""
    with pytest.raises(ValueError, match=r": found ") as caught:
        kind(**GOOD[kind] | {name: array})
    assert str(caught.value) == f"{kind.__name__}.{name}: found {found}"


def test_right_shapes_are_kept_and_frozen():
    """An object of right shapes is made, and cannot be changed after."""
    for kind, fields in GOOD.items():
        made = kind(**fields)
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(made, dataclasses.fields(made)[0].name, None)


@pytest.mark.parametrize("corners", [3, 4])
def test_a_mesh_has_triangles_or_quads(corners):
    """Faces have three or four corners."""
    assert Mesh(np.zeros((4, 3), np.float32), np.zeros((1, corners), np.uint32)).faces.shape == (1, corners)


def test_a_mesh_of_pentagons_is_refused():
    """Faces of five corners are no mesh."""
    with pytest.raises(ValueError, match=r"Mesh\.faces: found \(1, 5\)"):
        Mesh(np.zeros((5, 3), np.float32), np.zeros((1, 5), np.uint32))


def test_names_that_users_write_are_the_wires_own():
    """Return modes, packet kinds and PPS states keep the words and numbers that files and packets use."""
    assert [mode.value for mode in ReturnMode] == ["strongest", "last", "dual"]
    assert [kind.value for kind in PacketKind] == ["data", "position", "nmea", "pps", "imu"]
    assert [state.value for state in PpsState] == [0, 1, 2, 3]


def test_a_surface_row_is_packed():
    """A row of the surface table is 22 bytes without padding."""
    assert types.SURFACE.itemsize == 22
    assert sum(types.SURFACE[name].itemsize for name in types.SURFACE.names or ()) == 22
