"""Positions, unit vectors, determinants and closed bodies of rings.

They are computed by sums, products, quotients and square roots.
"""

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import norm
from vlp16emu.types import F8, Mesh


def places_m(rows: NDArray[np.void], axes: str = "xyz") -> F8:
    """Return positions (n, 3), or selected axes, of rows with fields x_m, y_m and z_m."""
    return np.column_stack([rows[f"{axis}_m"] for axis in axes])


def unit(vectors: F8) -> F8:
    """Return vectors (..., k) scaled to a length of 1."""
    return vectors / norm(vectors)[..., None]


def determinant(matrices: F8) -> F8:
    """Return the determinants (...) of matrices (..., 3, 3): the triple product of their rows."""
    a, b, c = np.moveaxis(matrices, -2, 0)
    return (a * np.cross(b, c)).sum(axis=-1)


def closed_body(rings: F8, ends: F8) -> Mesh:
    """Make a closed body from rings (r, sides, 3) and the centres (2, 3) of its ends.

    Rings are counter-clockwise seen from the last.
    """
    count, sides, _ = rings.shape
    vertices = np.concatenate([rings.reshape(-1, 3), ends])
    corner = np.arange(sides)
    after = np.roll(corner, -1)
    bottom = np.full(sides, len(vertices) - 2)
    top = np.full(sides, len(vertices) - 1)
    last = (count - 1) * sides
    triangles = [(after, corner, bottom), (last + corner, last + after, top)]
    for low in range(0, last, sides):
        high = low + sides
        triangles += [(low + corner, low + after, high + after), (low + corner, high + after, high + corner)]
    faces = np.concatenate([np.column_stack(triple) for triple in triangles])
    return Mesh(vertices.astype(np.float32), faces.astype(np.uint32))
