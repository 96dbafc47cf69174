"""The types that travel refuse wrong shapes and keep right ones."""

import numpy as np
import pytest

from vlp16emu.types import Hits, Mesh, Poses

GOOD = {
    Poses: {
        "t_ns": np.zeros(2, np.int64),
        "world_R_body": np.zeros((2, 3, 3)),
        "world_p_body_m": np.zeros((2, 3)),
    },
    Hits: {
        "count": np.ones((3, 16), np.uint16),
        "range_m": np.zeros(48, np.float32),
        "surface": np.zeros(48, np.uint32),
        "cos_incidence": np.zeros(48, np.float32),
    },
    Mesh: {"vertices_m": np.zeros((5, 3), np.float32), "faces": np.zeros((1, 4), np.uint32)},
}
BAD = [
    (Poses, "world_p_body_m", np.zeros((3, 3)), "(3, 3) float64, expected (2, 3) float64"),
    (Hits, "surface", np.zeros(49, np.uint32), "(49,) uint32, expected (48) uint32"),
    (Hits, "cos_incidence", [1.0], "list, expected (48) float32"),
    (Mesh, "faces", np.zeros((1, 5), np.uint32), "(1, 5) uint32, expected (n, 3) uint32"),
]


@pytest.mark.parametrize(("kind", "name", "array", "found"), BAD)
def test_a_wrong_shape_is_refused(kind, name, array, found):
    """An array of the wrong shape or dtype is refused by name, with what was found and expected."""
    with pytest.raises(ValueError, match=r": found ") as caught:
        kind(**GOOD[kind] | {name: array})
    assert str(caught.value) == f"{kind.__name__}.{name}: found {found}"
