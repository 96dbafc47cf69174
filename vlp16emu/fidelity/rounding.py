"""What float32 does to ranges: places that were met found anew in float64, on the mesh as it was grown."""

from collections.abc import Callable
from functools import lru_cache

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.raycast import Scene
from vlp16emu.report.accuracy import Rounding
from vlp16emu.types import Firings, Mesh, ShapeKey, Window

__all__ = ["NOTHING_MET", "rounding_of"]

_ELSEWHERE_M = 1e-3
_KEPT_SHAPES = 64

NOTHING_MET = Rounding(0, float("nan"), 0.0, float("nan"))
"""What is known of no rays at all."""

Array = NDArray[np.float64]


def rounding_of(
    scene: Scene,
    window: Window,
    shape: Callable[[ShapeKey], tuple[Mesh, ...]],
    firings: Firings,
    near_m: Array,
    far_m: float,
) -> Rounding:
    """Cast one ray along the middle of each pulse, and cut it in float64 with the mesh that it met.

    Things that sway are left out, and so are rays that meet nothing.

    Parameters
    ----------
    window : of which the scene was made
    shape : grows the meshes of a shape
    """
    hits = scene.cast(firings, near_m, far_m)
    grown = lru_cache(_KEPT_SHAPES)(shape)
    met = np.flatnonzero(np.isfinite(hits.range_m))
    origin_m, direction = firings.origin_m.reshape(-1, 3)[met], firings.direction.reshape(-1, 3)[met]
    at_m = hits.range_m[met].astype(np.float64)
    off_m = [
        _nearest(window, grown, ray, int(hits.surface[met[number]])) - ray[2]
        for number, ray in enumerate(zip(origin_m, direction, at_m, strict=True))
    ]
    known = np.abs(np.array([off for off in off_m if not np.isnan(off)]))
    same = known[known <= _ELSEWHERE_M]
    return Rounding(
        rays=len(known),
        range_rmse_m=float(np.sqrt(np.mean(same**2))) if len(same) else np.nan,
        range_max_m=float(same.max(initial=0.0)),
        elsewhere=1.0 - len(same) / len(known) if len(known) else np.nan,
    )


def _nearest(
    window: Window,
    grown: Callable[[ShapeKey], tuple[Mesh, ...]],
    ray: tuple[Array, Array, float],
    surface: int,
) -> float:
    """Range nearest to the ray's at which it cuts a surface; inf where it misses, NaN where the surface sways."""
    origin_m, direction, range_m = ray
    # Placements of one kind may share their surfaces: the last one at or before it, and its like.
    begins = window.first_surface.astype(np.int64)
    first = begins[begins <= surface].max()
    best_m = np.inf
    for number in np.flatnonzero(begins == first).tolist():
        if window.sway is not None and number in window.sway.placement:
            return np.nan
        world_T_shape = window.world_T_shape[number]
        mesh = grown(window.shapes[window.shape[number]])[surface - int(first)]
        to_shape = np.linalg.inv(world_T_shape[:, :3])
        cut_m = _cut(
            mesh.vertices_m,
            mesh.faces,
            to_shape @ (origin_m - world_T_shape[:, 3]),
            to_shape @ direction,
            range_m,
        )
        if abs(cut_m - range_m) < abs(best_m - range_m):
            best_m = cut_m
    return best_m


@numba.njit(cache=True, nogil=True)
def _cut(
    vertices_m: NDArray[np.float32],
    faces: NDArray[np.uint32],
    origin_m: Array,
    direction: Array,
    range_m: float,
) -> float:
    """Range nearest to `range_m` at which a ray cuts a mesh, inf where it misses (Moeller and Trumbore, 1997)."""
    best_m = np.inf
    for face in range(faces.shape[0]):
        a = vertices_m[faces[face, 0]].astype(np.float64)
        for corner in range(1, faces.shape[1] - 1):
            ab = vertices_m[faces[face, corner]] - a
            ac = vertices_m[faces[face, corner + 1]] - a
            p = np.cross(direction, ac)
            determinant = ab[0] * p[0] + ab[1] * p[1] + ab[2] * p[2]
            if determinant == 0.0:
                continue
            to = origin_m - a
            u = (to[0] * p[0] + to[1] * p[1] + to[2] * p[2]) / determinant
            if not 0.0 <= u <= 1.0:
                continue
            q = np.cross(to, ab)
            v = (direction[0] * q[0] + direction[1] * q[1] + direction[2] * q[2]) / determinant
            if v < 0.0 or u + v > 1.0:
                continue
            at_m = (ac[0] * q[0] + ac[1] * q[1] + ac[2] * q[2]) / determinant
            if abs(at_m - range_m) < abs(best_m - range_m):
                best_m = at_m
    return best_m
