"""Shapes as a medium takes them: their projected area in cells of 0.25 m, or face by face where there are few.

A shape is measured once, and its cloud put down wherever it stands (`vlp16emu.raycast.medium`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.raycast.voxel import KNOTS, QUANTILES, VOXEL_M
from vlp16emu.types import Mesh, PlantPart

__all__ = ["PROJECTION", "TILTS", "Cloud", "Library", "cloud_of"]

TILTS = 64
"""Classes of faces by the sine of their normal's elevation."""

_CELL_M = 0.25
_FEW_FACES = 2000
"""Shapes of no more faces are taken face by face: stones, logs and tufts, which are stretched where they are placed."""
_PIXELS = 32
"""Of a voxel's edge, 16 mm each, in which faces are drawn to see how much they hide of each other."""

Array = NDArray[np.float64]


def _projection() -> Array:
    """Mean over all azimuths of the projected share of a face, (knots, tilts), by the sine of the normal's elevation."""
    level, up = np.sqrt(1.0 - KNOTS**2)[:, None], KNOTS[:, None]
    sine = (np.arange(TILTS) + 0.5) / TILTS
    azimuth = (np.arange(256) + 0.5) * (np.pi / 256)
    a, b = level * np.sqrt(1.0 - sine**2), up * sine
    mean: Array = np.abs(a[..., None] * np.cos(azimuth) + b[..., None]).mean(axis=-1)
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
    parts : (meshes,) `PlantPart` of each
    """
    share = np.where(parts == PlantPart.LEAF, 1.0, 0.5).astype(np.float32)
    faces = [_corners(mesh) for mesh in meshes]
    corners_m, of = (
        np.concatenate(faces),
        np.repeat(np.arange(len(meshes), dtype=np.uint8), [len(f) for f in faces]),
    )
    normal = 0.5 * np.cross(corners_m[:, 2] - corners_m[:, 0], corners_m[:, 3] - corners_m[:, 1])
    area_m2 = np.linalg.norm(normal, axis=1)
    sine = np.abs(normal[:, 2]) / np.maximum(area_m2, 1e-12)
    projection, cosine = np.zeros((len(meshes), len(KNOTS))), np.ones((len(meshes), len(KNOTS), QUANTILES))
    for mesh in range(len(meshes)):
        own = of == mesh
        if area_m2[own].sum() > 0:
            projection[mesh], cosine[mesh] = _law(area_m2[own], sine[own])
    radius_m = float(np.linalg.norm(corners_m, axis=-1).max(initial=0.0))
    none = np.zeros((0, 4, 3), np.float32), np.zeros(0, np.uint8)
    if len(corners_m) <= _FEW_FACES:
        cells = np.zeros((0, 3), np.float32), np.zeros(0, np.float32), np.zeros(0, np.uint8)
        kept = corners_m.astype(np.float32), of
    else:
        middle_m = corners_m.mean(axis=1)
        box = np.floor(corners_m.reshape(-1, 3).min(axis=0) / VOXEL_M)
        size = np.ceil(corners_m.reshape(-1, 3).max(axis=0) / VOXEL_M) - box + 1
        kept_share = _kept(corners_m / VOXEL_M - box, of, share, tuple(size.astype(int).tolist()))
        cells, kept = _cells(middle_m, area_m2 * share[of] * kept_share, of), none
    return Cloud(*cells, *kept, share, projection.astype(np.float32), cosine.astype(np.float32), radius_m)


def _corners(mesh: Mesh) -> Array:
    """Corners of faces (f, 4, 3)."""
    corners = mesh.vertices_m[mesh.faces].astype(np.float64)
    return corners if corners.shape[1] == 4 else corners[:, [0, 1, 2, 2]]


def _law(area_m2: Array, sine: Array) -> tuple[Array, Array]:
    """Mean projected share of faces (knots,), and quantiles (knots, QUANTILES) of the cosine of incidence."""
    tilt = np.minimum((sine * TILTS).astype(np.int64), TILTS - 1)
    weight = np.bincount(tilt, area_m2, TILTS)
    projection = PROJECTION @ weight / weight.sum()
    at = (np.arange(TILTS) + 0.5) / TILTS
    azimuth = (np.arange(64) + 0.5) * (np.pi / 64)
    cosine = np.empty((len(KNOTS), QUANTILES))
    for knot, up in enumerate(KNOTS):
        level = math.sqrt(1.0 - up * up)
        met = np.abs(level * np.sqrt(1.0 - at**2)[:, None] * np.cos(azimuth) + up * at[:, None])
        mass = weight[:, None] * met
        order = np.argsort(met, axis=None)
        so_far = np.cumsum(mass.ravel()[order])
        wanted = (np.arange(QUANTILES) + 0.5) / QUANTILES * so_far[-1]
        cosine[knot] = met.ravel()[order][np.searchsorted(so_far, wanted)]
    return projection, cosine


@numba.njit(cache=True, nogil=True)
def _kept(
    corners: Array, of: NDArray[np.uint8], share: NDArray[np.float32], size: tuple[int, int, int]
) -> Array:
    """Share of each face's area (f,) that is left where leaves that hide each other are taken for leaves at random.

    The faces of each mesh are drawn as seen along x and along y, voxel by voxel. Leaves at random that hide as much of a
    voxel's face have -log(1 - hidden) of its area (Beer's law); the sum of areas is more where leaves grow in clumps.

    Parameters
    ----------
    corners : (f, 4, 3) in voxels from the lowest corner of `size` voxels
    """
    drawn = np.zeros((*size, _PIXELS), np.uint32)
    factor, total = np.zeros((len(share), *size)), np.zeros((len(share), *size))
    for mesh in range(len(share)):
        for axis in (0, 1):
            drawn[:] = 0
            for f in range(len(corners)):
                if of[f] == mesh:
                    _draw(corners[f], axis, drawn, total[mesh])
            for i, j, k in np.ndindex(size):
                bits = 0
                for pixels in drawn[i, j, k]:
                    line = pixels
                    while line:
                        line &= line - np.uint32(1)
                        bits += 1
                hidden = min(bits / _PIXELS**2, 1.0 - 0.5 / _PIXELS**2)
                factor[mesh, i, j, k] -= math.log(1.0 - hidden) * _PIXELS**2
    out = np.ones(len(corners))
    for f in range(len(corners)):
        mesh = of[f]
        i, j, k = _middle(corners[f])
        if total[mesh, i, j, k] > 0:
            out[f] = factor[mesh, i, j, k] / (total[mesh, i, j, k] * share[mesh])
    return out


@numba.njit(cache=True, nogil=True)
def _middle(corners: Array) -> tuple[int, int, int]:
    """Voxel of a face's middle."""
    return (
        int(0.25 * (corners[0, 0] + corners[1, 0] + corners[2, 0] + corners[3, 0])),
        int(0.25 * (corners[0, 1] + corners[1, 1] + corners[2, 1] + corners[3, 1])),
        int(0.25 * (corners[0, 2] + corners[1, 2] + corners[2, 2] + corners[3, 2])),
    )


@numba.njit(cache=True, nogil=True)
def _draw(corners: Array, axis: int, drawn: NDArray[np.uint32], total: Array) -> None:
    """Draw a face as seen along an axis, into the voxels of its own depth; count its pixels, drawn before or not."""
    other = 1 - axis
    depth = _middle(corners)[axis]
    u, v = corners[:, other] * _PIXELS, corners[:, 2] * _PIXELS
    turn = 0.0
    for c in range(4):
        n = (c + 1) % 4
        turn += u[c] * v[n] - u[n] * v[c]
    side = 1.0 if turn > 0 else -1.0
    for p in range(math.floor(u.min()), math.floor(u.max()) + 1):
        for q in range(math.floor(v.min()), math.floor(v.max()) + 1):
            inside = True
            for c in range(4):
                n = (c + 1) % 4
                across = (u[n] - u[c]) * (q + 0.5 - v[c]) - (v[n] - v[c]) * (p + 0.5 - u[c])
                if side * across < 0.0:
                    inside = False
                    break
            if inside:
                a, b = p // _PIXELS, q // _PIXELS
                i, j = (depth, a) if axis == 0 else (a, depth)
                drawn[i, j, b, q % _PIXELS] |= np.uint32(1) << np.uint32(p % _PIXELS)
                total[i, j, b] += 1.0


def _cells(
    middle_m: Array, area_m2: Array, mesh: NDArray[np.uint8]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]:
    """Gather faces in cells of `_CELL_M`: where their area lies, how much it is, and whose."""
    cell = np.floor(middle_m / _CELL_M).astype(np.int64) + (1 << 15)
    name = ((mesh.astype(np.int64) << 16 | cell[:, 0]) << 16 | cell[:, 1]) << 16 | cell[:, 2]
    name, of = np.unique(name, return_inverse=True)
    total = np.bincount(of, area_m2)
    weighted = np.stack([np.bincount(of, area_m2 * axis) for axis in middle_m.T], axis=1)
    place_m = weighted / np.maximum(total, 1e-12)[:, None]
    return place_m.astype(np.float32), total.astype(np.float32), (name >> 48).astype(np.uint8)


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
            """Where each begins."""
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
