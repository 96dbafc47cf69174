"""The plain `embreex` class: one flat mesh, single rays. Fallback where the library cannot be driven."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import RunError
from vlp16emu.raycast.flat import flatten
from vlp16emu.raycast.slow import Met, SlowScene
from vlp16emu.types import NO_SURFACE, Mesh, ShapeKey, Window

__all__ = ["PlainCaster", "PlainScene"]


class PlainScene(SlowScene):
    """A window as one flat Embree mesh."""

    def __init__(self, window: Window, shape: Callable[[ShapeKey], tuple[Mesh, ...]]) -> None:
        super().__init__(window)
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        triangles_m, self._surface = flatten(window, shape)
        self._scene = EmbreeScene(robust=True)
        if len(triangles_m):
            TriangleMesh(self._scene, triangles_m.astype(np.float32))

    def _rays(
        self,
        origin_m: NDArray[np.float64],
        direction: NDArray[np.float64],
        near: NDArray[np.float64],
        far_m: float,
        _t_ns: NDArray[np.int64],
    ) -> Met:
        """Cast rays (n, 3) from origins relative to the window's."""
        # This class has no near limit: rays begin at the lens instead.
        out = self._scene.run(
            (origin_m + direction * near[:, None]).astype(np.float32),
            direction.astype(np.float32),
            dists=np.asarray(far_m - near, np.float32),
            query="INTERSECT",
            output=True,
        )
        hit = out["geomID"] >= 0
        normal = out["Ng"].astype(np.float64)
        length = np.linalg.norm(normal, axis=1)
        cosine = np.abs(np.einsum("ij,ij->i", normal, direction)) / np.where(length > 0, length, 1.0)
        surface = np.full(len(hit), NO_SURFACE, np.uint32)
        surface[hit] = self._surface[out["primID"][hit]]
        return (
            np.where(hit, out["tfar"] + near, np.inf).astype(np.float32),
            surface,
            np.where(hit, np.minimum(cosine, 1.0), 0.0).astype(np.float32),
        )


class PlainCaster:
    """Opens windows for the plain class. Needs about 70 bytes per placed triangle, and builds each window anew."""

    def __init__(self, shape: Callable[[ShapeKey], tuple[Mesh, ...]]) -> None:
        self._shape = shape

    def open(self, window: Window) -> PlainScene:
        """Make a window ready for casting.

        Raises
        ------
        RunError
            where something moves in it
        """
        if window.sway is not None:
            raise RunError("wind: the plain embreex class casts against what stands still only")
        return PlainScene(window, self._shape)
