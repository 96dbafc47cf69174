"""Places, directions of vectors and determinants, by sums, products, quotients and square roots."""

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import norm
from vlp16emu.types import Array


def places_m(rows: NDArray[np.void], axes: str = "xyz") -> Array:
    """Return the places (n, 3), or along some axes, of rows that have them as x_m, y_m and z_m."""
    return np.column_stack([rows[f"{axis}_m"] for axis in axes])


def unit(vectors: Array) -> Array:
    """Return vectors (..., k) scaled to a length of 1."""
    scaled: Array = vectors / norm(vectors)[..., None]
    return scaled


def determinant(matrices: Array) -> Array:
    """Return the determinants (...) of matrices (..., 3, 3): the triple product of their rows."""
    a, b, c = np.moveaxis(matrices, -2, 0)
    triple: Array = (a * np.cross(b, c)).sum(axis=-1)
    return triple
