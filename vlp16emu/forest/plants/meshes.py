"""Meshes of pipes, of leaves, and of several put together."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from vlp16emu.types import Array, Mesh


def quads(corners: Array) -> Mesh:
    """Quads of corners (..., 4, 3), each with vertices of its own."""
    vertices = corners.reshape(-1, 3).astype(np.float32)
    return Mesh(vertices, np.arange(len(vertices), dtype=np.uint32).reshape(-1, 4))


NO_LEAVES = quads(np.zeros((0, 4, 3)))  # in the place of leaves that have fallen


def merged(*parts: Mesh) -> Mesh:
    """Triangle meshes as one, in order."""
    if len(parts) == 1:
        return parts[0]
    first = np.cumsum([0, *(len(part.vertices_m) for part in parts)])
    faces = [part.faces + np.uint32(start) for part, start in zip(parts, first[:-1], strict=True)]
    return Mesh(np.concatenate([part.vertices_m for part in parts]), np.concatenate(faces))


@cache
def pipe_faces(sides: int, rings: int, *, bottom: bool = True, top: bool = True) -> NDArray[np.uint32]:
    """Triangles, not to be written to, of a pipe whose first vertex is the middle of its bottom and whose last is its tip, if it has them."""
    here = np.arange(sides)
    after = np.roll(here, -1)
    low = int(bottom) + (np.arange(rings - 1) * sides)[:, None]
    high, last = low + sides, int(bottom) + (rings - 1) * sides
    walls = [(low + here, low + after, high + after), (low + here, high + after, high + here)]
    triangles = [np.stack(corners, axis=-1).reshape(-1, 3) for corners in walls]
    if bottom:
        triangles.insert(0, np.column_stack([after + 1, here + 1, np.zeros(sides, np.int64)]))
    if top:
        triangles.append(np.column_stack([last + here, last + after, np.full(sides, last + sides)]))
    faces = np.concatenate(triangles).astype(np.uint32)
    faces.flags.writeable = False
    return faces
