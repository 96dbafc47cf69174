"""The slow twin: every ray against every triangle in float64, with nothing clever."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from vlp16emu.raycast.flat import flatten
from vlp16emu.raycast.placement import frozen
from vlp16emu.raycast.slow import Met, SlowScene
from vlp16emu.types import NO_SURFACE, Mesh, ShapeKey, Window

__all__ = ["ReferenceCaster", "ReferenceScene"]


class ReferenceScene(SlowScene):
    """A window as one soup of triangles, (t, 3, 3) float64; a new one for each instant where something moves."""

    def __init__(self, window: Window, shape: Callable[[ShapeKey], tuple[Mesh, ...]]) -> None:
        super().__init__(window)
        self._moves = window.sway is not None
        self._at = lru_cache(1)(lambda t_ns: flatten(frozen(window, t_ns), shape))

    def _rays(
        self,
        origin_m: NDArray[np.float64],
        direction: NDArray[np.float64],
        near: NDArray[np.float64],
        far_m: float,
        t_ns: NDArray[np.int64],
    ) -> Met:
        """Cast rays (n, 3) from origins relative to the window's."""
        n = len(origin_m)
        range_m, cos_incidence = np.full(n, np.inf, np.float32), np.zeros(n, np.float32)
        surface = np.full(n, NO_SURFACE, np.uint32)
        for i in range(n):
            triangles_m, surfaces = self._at(int(t_ns[i]) if self._moves else 0)
            t_m = _ranges_m(triangles_m, origin_m[i], direction[i])
            t_m[(t_m < near[i]) | (t_m > far_m)] = np.inf
            nearest = int(np.argmin(t_m)) if len(t_m) else -1
            if nearest >= 0 and np.isfinite(t_m[nearest]):
                a, b, c = triangles_m[nearest]
                normal = np.cross(b - a, c - a)
                cos_incidence[i] = abs(normal @ direction[i]) / np.linalg.norm(normal)
                range_m[i], surface[i] = t_m[nearest], surfaces[nearest]
        return range_m, surface, cos_incidence


class ReferenceCaster:
    """Opens windows for the slow twin; for tests and for judging errors of rounding."""

    def __init__(self, shape: Callable[[ShapeKey], tuple[Mesh, ...]]) -> None:
        self._shape = shape

    def open(self, window: Window) -> ReferenceScene:
        """Make a window ready for casting."""
        return ReferenceScene(window, self._shape)


def _ranges_m(
    triangles_m: NDArray[np.float64], origin_m: NDArray[np.float64], direction: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distance along one ray to every triangle, inf where missed (Moeller and Trumbore, 1997)."""
    a, b, c = triangles_m[:, 0], triangles_m[:, 1], triangles_m[:, 2]
    ab, ac, to_ray = b - a, c - a, origin_m - a
    p = np.cross(direction, ac)
    determinant = np.einsum("ij,ij->i", ab, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("ij,ij->i", to_ray, p) / determinant
        q = np.cross(to_ray, ab)
        v = q @ direction / determinant
        t_m = np.einsum("ij,ij->i", ac, q) / determinant
        inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (determinant != 0)
    return np.where(inside, t_m, np.inf)
