"""Geometry of windows as casters want it: faces in pairs, transforms relative to the window, and all of it as triangles."""

from collections.abc import Callable
from dataclasses import replace

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.types import Mesh, ShapeKey, Window

__all__ = ["Faces", "faces_of", "flatten", "frozen", "normal_matrices", "relative_to_window", "sheared"]

Faces = tuple[NDArray[np.float32], NDArray[np.uint32]]
"""Vertices (v, 3) in metres, the last of them unused, and quads (q, 4).

Embree reads 16 bytes at a vertex of 12, so the last one that is used must have one behind it.
"""


def faces_of(mesh: Mesh) -> Faces:
    """Quads that Embree cuts into the very triangles of a mesh.

    It walks one tree of quads faster than a tree of quads and another of triangles: in `scenes/reference_forest` a quarter
    to a third more rays per second, half of that comes from branches and stems as half as many faces.

    Embree cuts a quad (a, b, c, d) into (a, b, d) and (c, d, b), and takes one with c = d for a triangle
    (Embree 4 API, RTC_GEOMETRY_TYPE_QUAD). Triangles need not lie in one plane to be a pair.
    """
    vertices_m = np.zeros((len(mesh.vertices_m) + 1, 3), np.float32)
    vertices_m[:-1] = mesh.vertices_m
    if mesh.faces.shape[1] == 4:
        return vertices_m, np.ascontiguousarray(mesh.faces)
    quads = np.empty((len(mesh.faces), 4), np.uint32)
    return vertices_m, quads[: _pair(np.array(mesh.faces, order="C"), vertices_m, quads)].copy()


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
        for corner in range(4):
            quads[n, corner] = faces[i, min(corner, 2)]
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


def relative_to_window(window: Window) -> NDArray[np.float64]:
    """window_T_shape (n, 3, 4): placements relative to the window's origin, still in float64."""
    transforms = window.world_T_shape.copy()
    transforms[:, :, 3] -= window.origin_m
    return transforms


def normal_matrices(window: Window) -> NDArray[np.float32]:
    """(n, 3, 3) inverse transposes, which take a shape's normals to the world also where it is scaled."""
    return np.ascontiguousarray(np.linalg.inv(window.world_T_shape[:, :, :3]).transpose(0, 2, 1), np.float32)


def sheared(
    world_T_shape: NDArray[np.float64], foot_z_m: NDArray[np.float64], shear: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Move placements (m, 3, 4) level by `shear` (..., m, 2) per metre over a foot (m,): (..., m, 3, 4)."""
    over_foot = world_T_shape[:, 2].copy()
    over_foot[:, 3] -= foot_z_m
    moved = np.broadcast_to(world_T_shape, (*shear.shape[:-1], 3, 4)).copy()
    moved[..., :2, :] += shear[..., None] * over_foot[:, None]
    return moved


def frozen(window: Window, t_ns: int) -> Window:
    """Still window that a moving one is at a time, or at its first or last where that is outside."""
    if (sway := window.sway) is None:
        return window
    steps = len(sway.shear) - 1
    at = min(max((t_ns - sway.start_ns) / sway.step_ns, 0.0), float(steps))
    knot = min(int(at), steps - 1)
    shear = sway.shear[knot] + (at - knot) * (sway.shear[knot + 1] - sway.shear[knot])
    transforms = window.world_T_shape.copy()
    transforms[sway.placement] = sheared(transforms[sway.placement], sway.foot_z_m, shear)
    return replace(window, world_T_shape=transforms, sway=None)


def flatten(
    window: Window, shape: Callable[[ShapeKey], tuple[Mesh, ...]]
) -> tuple[NDArray[np.float64], NDArray[np.uint32]]:
    """Triangles (t, 3, 3) float64 in metres from the window's origin, and their surfaces (t,) uint32."""
    transforms = relative_to_window(window)
    meshes = [shape(key) for key in window.shapes]
    corners, surfaces = [np.empty((0, 3, 3))], [np.empty(0, np.uint32)]
    for transform, which, first in zip(transforms, window.shape, window.first_surface, strict=True):
        for number, mesh in enumerate(meshes[which]):
            vertices_m = mesh.vertices_m.astype(np.float64) @ transform[:, :3].T + transform[:, 3]
            triangles = _triangles(mesh.faces)
            corners.append(vertices_m[triangles])
            surfaces.append(np.full(len(triangles), first + number, np.uint32))
    return np.concatenate(corners), np.concatenate(surfaces)


def _triangles(faces: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Cut quads (a, b, c, d) into (a, b, d) and (c, d, b), as Embree does."""
    if faces.shape[1] == 3:
        return faces
    return np.concatenate([faces[:, [0, 1, 3]], faces[:, [2, 3, 1]]])
