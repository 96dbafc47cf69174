"""Triangles in pairs: Embree walks one tree of quads faster than a tree of quads and another of triangles.

Measured on `scenes/reference_forest`: a quarter to a third more rays per second, of which a half comes from branches
and stems as half as many faces, the rest from crowns whose leaves and branches share a tree.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.types import Mesh

__all__ = ["Faces", "faces_of"]

Faces = tuple[NDArray[np.float32], NDArray[np.uint32]]
"""Vertices (v, 3) in metres, the last of them unused, and quads (q, 4).

Embree reads 16 bytes at a vertex of 12, so the last one that is used must have one behind it.
"""


def faces_of(mesh: Mesh) -> Faces:
    """Quads that Embree cuts into the very triangles of a mesh.

    Embree cuts a quad (a, b, c, d) into (a, b, d) and (c, d, b), and takes one with c = d for a triangle
    (Embree 4 API, RTC_GEOMETRY_TYPE_QUAD). Triangles need not lie in one plane to be a pair.
    """
    vertices_m = np.zeros((len(mesh.vertices_m) + 1, 3), np.float32)
    vertices_m[:-1] = mesh.vertices_m
    if mesh.faces.shape[1] == 4:
        return vertices_m, np.ascontiguousarray(mesh.faces)
    quads = np.empty((len(mesh.faces), 4), np.uint32)
    return vertices_m, quads[: _pair(np.ascontiguousarray(mesh.faces), vertices_m, quads)].copy()


@numba.njit(cache=True, nogil=True)
def _pair(faces: NDArray[np.uint32], vertices_m: NDArray[np.float32], quads: NDArray[np.uint32]) -> int:
    """Join each triangle, in order, to a free one across its longest edge that has one; return how many quads."""
    first, after = np.full(len(vertices_m), -1), np.empty(3 * len(faces), np.int64)
    for edge in range(3 * len(faces)):  # chains of the edges that leave a vertex
        start = faces[edge // 3, edge % 3]
        after[edge], first[start] = first[start], edge
    taken, n = np.zeros(len(faces), np.bool_), 0
    for i in range(len(faces)):
        if taken[i]:
            continue
        taken[i], partner, longest = True, -1, np.float32(0.0)
        quads[n, :3], quads[n, 3] = faces[i], faces[i, 2]
        for side in range(3):
            a, b, d = faces[i, side - 1], faces[i, side], faces[i, (side + 1) % 3]
            square = np.float32(0.0)
            for axis in range(3):
                square += (vertices_m[d, axis] - vertices_m[b, axis]) ** 2
            edge = first[d]
            while edge >= 0 and (taken[edge // 3] or faces[edge // 3, (edge + 1) % 3] != b):
                edge = after[edge]
            if edge >= 0 and square > longest:
                partner, longest = edge // 3, square
                quads[n, 0], quads[n, 1], quads[n, 3] = a, b, d
                quads[n, 2] = faces[partner, (edge + 2) % 3]
        if partner >= 0:
            taken[partner] = True
        n += 1
    return n
