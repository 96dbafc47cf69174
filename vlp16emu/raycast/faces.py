"""Triangles of meshes, and transforms relative to the window."""

import numpy as np

from vlp16emu.types import F4, F8, U4, Mesh, Window

Faces = tuple[F4, U4]
"""Vertices (v, 3) in metres, and triangles (t, 3)."""


def faces_of(mesh: Mesh) -> Faces:
    """Return the vertices of a mesh and its triangles in rows of memory; a quad (a, b, c, d) is (a, b, d) and (c, d, b)."""
    quads = mesh.faces.shape[1] == 4
    triangles = mesh.faces[:, [0, 1, 3, 2, 3, 1]].reshape(-1, 3) if quads else mesh.faces
    return np.ascontiguousarray(mesh.vertices_m), np.ascontiguousarray(triangles)  # read by their addresses


def relative_to_window(window: Window) -> F8:
    """Return window_T_shape (n, 3, 4): placements relative to the window's origin, in float64."""
    transforms = window.world_T_shape.copy()
    transforms[:, :, 3] -= window.origin_m
    return transforms


def inverses(transforms: F8) -> F8:
    """Invert affine transforms (n, 3, 4), by cofactors in a stated order: no library rounds them in its own way."""
    (a, b, c, x), (d, e, f, y), (g, h, i, z) = transforms.transpose(1, 2, 0)
    rows = (
        (e * i - f * h, c * h - b * i, b * f - c * e),
        (f * g - d * i, a * i - c * g, c * d - a * f),
        (d * h - e * g, b * g - a * h, a * e - b * d),
    )
    determinant = a * rows[0][0] + b * rows[1][0] + c * rows[2][0]
    out = np.empty_like(transforms)
    for k, (p, q, r) in enumerate(rows):
        out[:, k, 0], out[:, k, 1], out[:, k, 2] = p / determinant, q / determinant, r / determinant
        out[:, k, 3] = -(out[:, k, 0] * x + out[:, k, 1] * y + out[:, k, 2] * z)
    return out


def sheared(world_T_shape: F8, foot_z_m: F8, shear: F8) -> F8:
    """Move placements (m, 3, 4) level by `shear` (..., m, 2) per metre over a foot (m,): (..., m, 3, 4)."""
    over_foot = world_T_shape[:, 2].copy()
    over_foot[:, 3] -= foot_z_m
    moved = np.broadcast_to(world_T_shape, (*shear.shape[:-1], 3, 4)).copy()
    moved[..., :2, :] += shear[..., None] * over_foot[:, None]
    return moved
