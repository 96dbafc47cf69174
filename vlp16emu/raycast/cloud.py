"""Shapes as a medium takes them: their projected area in cells of 0.25 m, or face by face where there are few.

A shape is measured once, and its cloud put down wherever it stands (`vlp16emu.raycast.medium`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import cos
from vlp16emu.raycast.voxel import KNOTS, QUANTILES, VOXEL_M, kept_share
from vlp16emu.types import Mesh, PlantPart
from vlp16emu.world.tiles import EXACT

TILTS = 64
"""Classes of faces by the sine of their normal's elevation."""

_CELL_M = 0.25
_FEW_FACES = 2000
"""Shapes of no more faces are taken face by face: stones, logs and tufts, which are stretched where they are placed."""

Array = NDArray[np.float64]


def _projection() -> Array:
    """Mean over all azimuths of the projected share of a face, (knots, tilts), by the sine of the normal's elevation."""
    level, up = np.sqrt(1.0 - np.square(KNOTS))[:, None], KNOTS[:, None]
    sine = (np.arange(TILTS) + 0.5) / TILTS
    azimuth = (np.arange(256) + 0.5) * (np.pi / 256)
    a, b = level * np.sqrt(1.0 - np.square(sine)), up * sine
    mean: Array = np.abs(a[..., None] * cos(azimuth) + b[..., None]).mean(axis=-1)
    return mean


PROJECTION = _projection()
"""(knots, tilts) mean projected share of a face over all azimuths."""


@dataclass(frozen=True, slots=True)
class Cloud:
    """A shape, as a medium takes it."""

    place_m: NDArray[np.float32]
    """(n, 3) where its area lies, in the shape's own frame; none of shapes with few faces."""
    area_m2: NDArray[np.float32]
    """(n,) that a ray can meet: one side of leaves, half the surface of closed bodies."""
    mesh: NDArray[np.uint8]
    """(n,) to which of the shape's meshes it belongs."""
    corners_m: NDArray[np.float32]
    """(f, 4, 3) faces of a shape with few of them, triangles with their last corner twice; none of other shapes."""
    corner_mesh: NDArray[np.uint8]
    """(f,) to which of the shape's meshes they belong."""
    share: NDArray[np.float32]
    """(meshes,) of a face's area that counts: 1 of leaves, 0.5 of closed bodies."""
    projection: NDArray[np.float32]
    """(meshes, knots) projected area over area, for light of any azimuth: the angular law of the shape's parts."""
    cosine: NDArray[np.float32]
    """(meshes, knots, QUANTILES) of the cosine of incidence where light meets them."""
    radius_m: float
    """Greatest distance of a corner from the shape's origin."""


def cloud_of(meshes: Sequence[Mesh], parts: NDArray[np.uint8]) -> Cloud:
    """Measure a shape.

    Parameters
    ----------
    parts : (meshes,) `PlantPart` of each; what is `EXACT` is left out
    """
    exact = (parts == EXACT).tolist()
    meshes = [
        Mesh(mesh.vertices_m, mesh.faces[: 0 if out else None])
        for mesh, out in zip(meshes, exact, strict=True)
    ]
    share = np.where(parts == PlantPart.LEAF, 1.0, 0.5).astype(np.float32)
    first = np.cumsum([0, *(len(mesh.faces) for mesh in meshes)])
    corners_m = np.empty((first[-1], 4, 3))
    for mesh, begin, stop in zip(meshes, first, first[1:], strict=False):
        own = corners_m[begin:stop]
        own[:, : mesh.faces.shape[1]] = mesh.vertices_m.take(mesh.faces, axis=0)
        if mesh.faces.shape[1] == 3:
            own[:, 3] = own[:, 2]
    area_m2, weight = np.empty(len(corners_m)), np.zeros((len(meshes), TILTS))
    bounds_m = np.array([[np.inf] * 3, [-np.inf] * 3])
    radius_m = _measure(corners_m, first, area_m2, weight, bounds_m) if len(corners_m) else 0.0
    projection, cosine = np.zeros((len(meshes), len(KNOTS))), np.ones((len(meshes), len(KNOTS), QUANTILES))
    for number in np.flatnonzero(weight.any(axis=1)).tolist():
        projection[number], cosine[number] = _law(weight[number])
    if len(corners_m) <= _FEW_FACES:
        of = np.repeat(np.arange(len(meshes), dtype=np.uint8), np.diff(first))
        cells = np.zeros((0, 3), np.float32), np.zeros(0, np.float32), np.zeros(0, np.uint8)
        kept = corners_m.astype(np.float32), of
    else:
        low, high = np.floor(bounds_m[0] / VOXEL_M), np.ceil(bounds_m[1] / VOXEL_M)
        left = share.repeat(np.diff(first)) * kept_share(
            corners_m, first, share, low, (high - low + 1).astype(int)
        )
        cells = _cells(corners_m, first, area_m2, left, bounds_m)
        kept = np.zeros((0, 4, 3), np.float32), np.zeros(0, np.uint8)
    return Cloud(*cells, *kept, share, projection.astype(np.float32), cosine.astype(np.float32), radius_m)


@numba.njit(cache=True, nogil=True, _nrt=False)
def _measure(
    corners_m: Array, first: NDArray[np.int64], area_m2: Array, weight: Array, bounds_m: Array
) -> float:
    """Measure faces (f, 4, 3), those of each mesh beginning at its first; return their greatest distance.

    Parameters
    ----------
    area_m2, weight : output, areas (f,), and area of each mesh (meshes, `TILTS`) by the sine of the normals' elevation
    bounds_m : (2, 3) lowest and highest coordinates so far
    """
    radius2 = 0.0
    for mesh in range(len(first) - 1):
        for f in range(first[mesh], first[mesh + 1]):
            own = corners_m[f]
            ax, ay, az = own[2, 0] - own[0, 0], own[2, 1] - own[0, 1], own[2, 2] - own[0, 2]
            bx, by, bz = own[3, 0] - own[1, 0], own[3, 1] - own[1, 1], own[3, 2] - own[1, 2]
            nx, ny, nz = 0.5 * (ay * bz - az * by), 0.5 * (az * bx - ax * bz), 0.5 * (ax * by - ay * bx)
            area_m2[f] = math.sqrt(nx * nx + ny * ny + nz * nz)
            sine = abs(nz) / max(area_m2[f], 1e-12)
            weight[mesh, min(int(sine * TILTS), TILTS - 1)] += area_m2[f]
            for c in range(4):
                x, y, z = own[c, 0], own[c, 1], own[c, 2]
                radius2 = max(radius2, x * x + y * y + z * z)
                for a in range(3):
                    bounds_m[0, a] = min(bounds_m[0, a], own[c, a])
                    bounds_m[1, a] = max(bounds_m[1, a], own[c, a])
    return math.sqrt(radius2)


@cache
def _met() -> list[tuple[NDArray[np.intp], Array]]:
    """For each knot the cosines (`TILTS` x 64) with which light meets faces all around: their order, and in that order."""
    at = (np.arange(TILTS) + 0.5) / TILTS
    azimuth = (np.arange(64) + 0.5) * (np.pi / 64)
    found = []
    for up in KNOTS:
        level = math.sqrt(1.0 - up * up)
        met = np.abs(level * np.sqrt(1.0 - np.square(at))[:, None] * cos(azimuth) + up * at[:, None])
        order = np.argsort(met, axis=None, kind="stable")
        found.append((order, met.ravel()[order]))
    return found


def _law(weight: Array) -> tuple[Array, Array]:
    """Mean projected share of faces (knots,), and quantiles (knots, QUANTILES) of the cosine of incidence.

    Parameters
    ----------
    weight : (`TILTS`,) their area
    """
    cosine = np.empty((len(KNOTS), QUANTILES))
    for knot, (order, met) in enumerate(_met()):
        so_far = np.cumsum(weight[order // 64] * met)
        wanted = (np.arange(QUANTILES) + 0.5) / QUANTILES * so_far[-1]
        cosine[knot] = met[np.searchsorted(so_far, wanted)]
    return (PROJECTION * weight).sum(axis=1) / weight.sum(), cosine


def _cells(
    corners_m: Array, first: NDArray[np.int64], area_m2: Array, left: Array, bounds_m: Array
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]:
    """Gather faces in cells of `_CELL_M`: where their area lies, how much it is, and whose."""
    low = np.floor(bounds_m[0] / _CELL_M) - 1.0  # a middle may lie beyond its corners by what is rounded
    size = (np.floor(bounds_m[1] / _CELL_M) + 2.0 - low).astype(int)
    number, cell, area_m2 = (
        np.empty(size.prod(), np.int32),
        np.empty(len(corners_m), np.int64),
        area_m2 * left,
    )
    total, weighted, whose = np.zeros(len(cell)), np.zeros((len(cell), 3)), np.empty(len(cell), np.uint8)
    cells = _gather(corners_m, first, area_m2, low, size, number, cell, total, weighted, whose)
    place_m = weighted[:cells] / np.maximum(total[:cells], 1e-12)[:, None]
    return place_m.astype(np.float32), total[:cells].astype(np.float32), whose[:cells].copy()


@numba.njit(cache=True, nogil=True, _nrt=False)
def _gather(
    corners_m: Array,
    first: NDArray[np.int64],
    area_m2: Array,
    low: Array,
    size: NDArray[np.int64],
    number: NDArray[np.int32],
    cell: NDArray[np.int64],
    total: Array,
    weighted: Array,
    whose: NDArray[np.uint8],
) -> int:
    """Add up the area of the faces in each cell, and their middles by it; return how many cells there are.

    Parameters
    ----------
    low, size : (3,) of the box of cells in which the middles are
    number, cell : scratch, for each cell of the box and for each face
    total, weighted, whose : output, (f,), (f, 3) and (f,), by mesh and place
    """
    cells = 0
    for mesh in range(len(first) - 1):
        for c in range(len(number)):
            number[c] = -1
        for f in range(first[mesh], first[mesh + 1]):
            at = 0
            for a in range(3):
                at = at * size[a] + int(math.floor(_middle(corners_m[f], a) / _CELL_M) - low[a])
            cell[f], number[at] = at, 0
        for c in range(len(number)):
            if number[c] == 0:
                number[c], whose[cells] = cells, mesh
                cells += 1
        for f in range(first[mesh], first[mesh + 1]):
            own = number[cell[f]]
            total[own] += area_m2[f]
            for a in range(3):
                weighted[own, a] += area_m2[f] * _middle(corners_m[f], a)
    return cells


@numba.njit(cache=True, nogil=True, forceinline=True, _nrt=False)
def _middle(corners_m: Array, axis: int) -> float:
    return 0.25 * (corners_m[0, axis] + corners_m[1, axis] + corners_m[2, axis] + corners_m[3, axis])


class Library(NamedTuple):
    """Clouds of several shapes, one after the other."""

    first_cell: NDArray[np.int64]
    """(shapes + 1,)."""
    place_m: NDArray[np.float32]
    area_m2: NDArray[np.float32]
    mesh: NDArray[np.uint8]
    first_face: NDArray[np.int64]
    """(shapes + 1,)."""
    corners_m: NDArray[np.float32]
    corner_mesh: NDArray[np.uint8]
    first_law: NDArray[np.int64]
    """(shapes + 1,) law of each shape's first mesh."""
    share: NDArray[np.float32]
    projection: NDArray[np.float32]
    radius_m: NDArray[np.float64]
    """(shapes,)."""

    @classmethod
    def of(cls, clouds: Sequence[Cloud]) -> "Library":
        """Put clouds together."""

        def first(arrays: Sequence[NDArray[np.float32]]) -> NDArray[np.int64]:
            return np.cumsum([0, *(len(array) for array in arrays)])

        return cls(
            first([c.place_m for c in clouds]),
            np.concatenate([c.place_m for c in clouds]),
            np.concatenate([c.area_m2 for c in clouds]),
            np.concatenate([c.mesh for c in clouds]),
            first([c.corners_m for c in clouds]),
            np.concatenate([c.corners_m for c in clouds]),
            np.concatenate([c.corner_mesh for c in clouds]),
            first([c.share for c in clouds]),
            np.concatenate([c.share for c in clouds]),
            np.concatenate([c.projection for c in clouds]),
            np.array([c.radius_m for c in clouds]),
        )
