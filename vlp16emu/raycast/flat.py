"""A window without instances: every placement written out as triangles."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from vlp16emu.raycast.placement import relative_to_window
from vlp16emu.types import Mesh, ShapeKey, Window

__all__ = ["flatten"]


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
