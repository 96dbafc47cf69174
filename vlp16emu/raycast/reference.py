"""The slow twin: every ray against every triangle in float64, with nothing clever."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from vlp16emu.raycast.flat import flatten
from vlp16emu.types import NO_SURFACE, Firings, Hits, Mesh, ShapeKey, Window

__all__ = ["ReferenceCaster", "ReferenceScene"]


class ReferenceScene:
    """A window as one soup of triangles, (t, 3, 3) float64."""

    def __init__(self, window: Window, shape: Callable[[ShapeKey], tuple[Mesh, ...]]) -> None:
        self._triangles_m, self._surface = flatten(window, shape)
        self._origin_m = window.origin_m
        self.surfaces = window.surfaces

    def cast(self, firings: Firings, near_m: NDArray[np.float64], far_m: float) -> Hits:
        """Cast one ray per pulse; the arguments are those of `EmbreeScene.cast`."""
        shape = firings.t_ns.shape
        range_m = np.full(shape, np.inf, np.float32)
        surface = np.full(shape, NO_SURFACE, np.uint32)
        cos_incidence = np.zeros(shape, np.float32)
        for i, j in np.ndindex(shape):
            origin_m = firings.origin_m[i, j] - self._origin_m
            t_m = self._ranges(origin_m, firings.direction[i, j])
            t_m[(t_m < near_m[j]) | (t_m > far_m)] = np.inf
            nearest = int(np.argmin(t_m)) if len(t_m) else -1
            if nearest >= 0 and np.isfinite(t_m[nearest]):
                a, b, c = self._triangles_m[nearest]
                normal = np.cross(b - a, c - a)
                cosine = abs(normal @ firings.direction[i, j]) / np.linalg.norm(normal)
                range_m[i, j], surface[i, j], cos_incidence[i, j] = (
                    t_m[nearest],
                    self._surface[nearest],
                    cosine,
                )
        return Hits.one_ray_each(range_m, surface, cos_incidence)

    def _ranges(self, origin_m: NDArray[np.float64], direction: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance along one ray to every triangle, inf where missed (Moeller and Trumbore, 1997)."""
        a, b, c = self._triangles_m[:, 0], self._triangles_m[:, 1], self._triangles_m[:, 2]
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


class ReferenceCaster:
    """Opens windows for the slow twin; for tests and for judging errors of rounding."""

    def __init__(self, shape: Callable[[ShapeKey], tuple[Mesh, ...]]) -> None:
        self._shape = shape

    def open(self, window: Window) -> ReferenceScene:
        """Make a window ready for casting."""
        return ReferenceScene(window, self._shape)
