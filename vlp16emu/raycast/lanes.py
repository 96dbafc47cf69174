"""Lanes: sub-rays of a pulse on their way through a medium, side by side."""

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["AHEAD", "FAST", "LANES", "Lanes", "lanes"]

LANES = 8
AHEAD = 16
"""Slabs that are looked at before the voxels in them: without branches that nobody can foretell."""
FAST = {"contract", "arcp", "nsz"}
"""What the compiler may do with sums and products of lanes."""


class Lanes(NamedTuple):
    """Up to eight sub-rays of a pulse."""

    origin_m: NDArray[np.float32]
    """(3, 8)."""
    direction: NDArray[np.float32]
    """(3, 8)."""
    range_m: NDArray[np.float32]
    """(8,) in: what each has met, or where its light is given up. Out: what it meets first."""
    surface: NDArray[np.uint32]
    """(8,) likewise."""
    cosine: NDArray[np.float32]
    """(8,) likewise."""
    line: NDArray[np.float32]
    """(6, 8) scratch: place across at the grid's corner and its change per metre, in 8ths of voxels, on both axes; then
    place along and its inverse change per metre of range."""
    column: NDArray[np.uint64]
    """(8,) scratch."""
    place: NDArray[np.int32]
    """(AHEAD,) scratch: brick and bit of the voxel of each slab."""
    found: NDArray[np.int32]
    """(AHEAD,) scratch: slabs whose voxels are not empty."""


@numba.njit(cache=True, nogil=True)
def lanes() -> Lanes:
    """Make room for lanes."""
    three = np.zeros((3, LANES), np.float32), np.zeros((3, LANES), np.float32)
    return Lanes(
        *three,
        np.zeros(LANES, np.float32),
        np.zeros(LANES, np.uint32),
        np.zeros(LANES, np.float32),
        np.zeros((6, LANES), np.float32),
        np.zeros(LANES, np.uint64),
        np.zeros(AHEAD, np.int32),
        np.zeros(AHEAD, np.int32),
    )
