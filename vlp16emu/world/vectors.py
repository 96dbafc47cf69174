"""Lengths and directions of vectors, by products, sums and square roots."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["determinant", "lengths", "unit"]

Array = NDArray[np.float64]


def lengths(vectors: Array) -> Array:
    """Return the Euclidean lengths (...) of vectors (..., k)."""
    length: Array = np.sqrt((vectors * vectors).sum(axis=-1))
    return length


def unit(vectors: Array) -> Array:
    """Return vectors (..., k) scaled to a length of 1."""
    scaled: Array = vectors / lengths(vectors)[..., None]
    return scaled


def determinant(matrices: Array) -> Array:
    """Return the determinants (...) of matrices (..., 3, 3): the triple product of their rows."""
    a, b, c = np.moveaxis(matrices, -2, 0)
    triple: Array = (a * np.cross(b, c)).sum(axis=-1)
    return triple
