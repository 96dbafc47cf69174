"""Level sections of meshes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlp16emu.types import Array, IntArray

Faces = NDArray[np.uint32]


@dataclass(frozen=True, slots=True)
class Outline:
    """A closed section."""

    middle_m: Array  # (2,).
    diameter_m: float  # of the circle of its area
    tape_m: float  # what a taut tape around it shows


class Cutter:
    """Sections of a mesh made of several.

    Parameters
    ----------
    vertices_m, faces : of each
    """

    def __init__(self, vertices_m: Sequence[Array], faces: Sequence[Faces]) -> None:
        first = np.cumsum([0, *map(len, vertices_m)])
        self.vertices_m = np.concatenate(vertices_m)
        corners = np.concatenate([own.astype(np.int64) + begin for own, begin in zip(faces, first, strict=False)])
        number = _welded(self.vertices_m)
        self.faces = number[corners]
        self.vertices_m = self.vertices_m[np.unique(number, return_index=True)[1]]
        z_m = self.vertices_m[self.faces, 2]
        self.faces = self.faces[np.argsort(z_m.min(axis=1), kind="stable")]
        self._low_m = np.sort(z_m.min(axis=1))

    def cut(self, at_m: float) -> Outline | None:
        """Give the largest closed outline at a height; None where there is none."""
        from scipy.sparse import coo_array  # here: only models of trees need it
        from scipy.sparse.csgraph import connected_components, depth_first_order

        faces = self.faces[: np.searchsorted(self._low_m, at_m)]
        above = self.vertices_m[faces, 2] > at_m
        met = above.any(axis=1)
        faces, above = faces[met], above[met]
        start, end = faces, np.roll(faces, -1, axis=1)
        crosses = above != np.roll(above, -1, axis=1)  # two edges of each face
        low, high = np.minimum(start, end)[crosses], np.maximum(start, end)[crosses]
        edges, of = np.unique(low * len(self.vertices_m) + high, return_inverse=True)
        if not len(edges):
            return None
        ends_m = self.vertices_m[np.column_stack(np.divmod(edges, len(self.vertices_m)))]
        share = (at_m - ends_m[:, 0, 2]) / (ends_m[:, 1, 2] - ends_m[:, 0, 2])
        points_m = ends_m[:, 0, :2] + share[:, None] * (ends_m[:, 1, :2] - ends_m[:, 0, :2])
        a, b = of.reshape(-1, 2).T
        graph = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(len(edges),) * 2).tocsr()
        _, loop = connected_components(graph, directed=False)
        shared = np.bincount(of, minlength=len(edges))
        closed = np.setdiff1d(loop, loop[shared != 2])
        rings = [
            points_m[depth_first_order(graph, int(np.argmax(loop == which)), directed=False)[0]]
            for which in closed.tolist()
        ]
        return max(map(_measured, rings), key=lambda outline: outline.diameter_m, default=None)


def _welded(vertices: Array) -> IntArray:
    """Give vertices numbers (n,) from 0 on, the same to those at the same place."""
    order = np.lexsort(vertices.T)
    apart = (vertices[order[1:]] != vertices[order[:-1]]).any(axis=1)
    number = np.empty(len(vertices), np.int64)
    number[order] = np.concatenate([[0], np.cumsum(apart)])
    return number


def _measured(ring_m: Array) -> Outline:
    from scipy.spatial import ConvexHull, QhullError

    at_m = ring_m - ring_m.mean(axis=0)
    twice = at_m[:, 0] * np.roll(at_m[:, 1], -1) - at_m[:, 1] * np.roll(at_m[:, 0], -1)
    middle_m = (at_m + np.roll(at_m, -1, axis=0)) * twice[:, None]
    try:
        girth_m = float(ConvexHull(ring_m).area)  # in the plane, its length
    except QhullError:
        return Outline(ring_m.mean(axis=0), 0.0, 0.0)
    return Outline(
        ring_m.mean(axis=0) + middle_m.sum(axis=0) / (3.0 * twice.sum()),
        float(np.sqrt(2.0 * abs(twice.sum()) / np.pi)),
        girth_m / np.pi,
    )
