"""Faces drawn into pixels, to see how much of their area is hidden by others of the same voxel."""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.raycast.voxel import VOXEL_M

__all__ = ["kept_share"]

_PIXELS = 32
"""Of a voxel's edge, 16 mm each, in which faces are drawn."""

Array = NDArray[np.float64]


def kept_share(
    corners_m: Array,
    first: NDArray[np.int64],
    share: NDArray[np.float32],
    low: Array,
    size: NDArray[np.int64],
) -> Array:
    """Share of each face's area (f,) that is left where leaves that hide each other are taken for leaves at random.

    The faces of each mesh are drawn as seen along x and along y, voxel by voxel. Leaves at random that hide as much of a
    voxel's face have -log(1 - hidden) of its area (Beer's law); the sum of areas is more where leaves grow in clumps.

    Parameters
    ----------
    corners_m, first : (f, 4, 3) faces, and where those of each mesh begin
    low, size : (3,) the lowest of the voxels in which they are, and how many there are
    """
    out, drawn, edges = np.ones(len(corners_m)), np.zeros((*size, _PIXELS), np.uint32), np.empty((4, 4))
    for mesh in range(len(share)):
        begin, stop, factor, total = first[mesh], first[mesh + 1], np.zeros(size), np.zeros(size, np.int64)
        for axis in (0, 1):
            _draw(corners_m, begin, stop, low, axis, edges, drawn, total)
            _count(drawn, total, factor)
        _share(corners_m, begin, stop, low, size, factor.ravel(), total.ravel(), float(share[mesh]), out)
    return out


@numba.njit(cache=True, nogil=True, _nrt=False)
def _count(drawn: NDArray[np.uint32], total: NDArray[np.int64], factor: Array) -> None:
    """Add the area of leaves at random that hide as many pixels of each voxel, and take the pixels away."""
    nx, ny, nz = total.shape
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if total[i, j, k]:
                    bits = 0
                    for line in range(_PIXELS):
                        left = drawn[i, j, k, line]
                        drawn[i, j, k, line] = 0
                        while left:
                            left &= left - np.uint32(1)
                            bits += 1
                    hidden = min(bits / _PIXELS**2, 1.0 - 0.5 / _PIXELS**2)
                    factor[i, j, k] -= math.log(1.0 - hidden) * _PIXELS**2


@numba.njit(cache=True, nogil=True, _nrt=False)
def _share(
    corners_m: Array,
    begin: int,
    stop: int,
    low: Array,
    size: NDArray[np.int64],
    factor: Array,
    total: NDArray[np.int64],
    share: float,
    out: Array,
) -> None:
    """Give each face the share of the voxel of its middle."""
    for f in range(begin, stop):
        at = 0
        for axis in range(3):
            at = at * size[axis] + _voxel(corners_m[f], low, axis)
        if total[at] > 0:
            out[f] = factor[at] / (total[at] * share)


@numba.njit(cache=True, nogil=True, forceinline=True, _nrt=False)
def _voxel(corners_m: Array, low: Array, axis: int) -> int:
    """Voxel of a face's middle along an axis."""
    at = low[axis]
    first_two = (corners_m[0, axis] / VOXEL_M - at) + (corners_m[1, axis] / VOXEL_M - at)
    return int(0.25 * (first_two + (corners_m[2, axis] / VOXEL_M - at) + (corners_m[3, axis] / VOXEL_M - at)))


@numba.njit(cache=True, nogil=True, _nrt=False)
def _draw(
    corners_m: Array,
    begin: int,
    stop: int,
    low: Array,
    axis: int,
    edges: Array,
    drawn: NDArray[np.uint32],
    total: NDArray[np.int64],
) -> None:
    """Draw faces as seen along an axis, into the voxels of their own depth; count their pixels, drawn before or not.

    Parameters
    ----------
    edges : (4, 4) scratch
    """
    u, v = edges[0], edges[1]
    for f in range(begin, stop):
        depth = _voxel(corners_m[f], low, axis)
        _turn_edges(corners_m[f], low, 1 - axis, edges)
        left, right = math.floor(min(u[0], u[1], u[2], u[3])), math.floor(max(u[0], u[1], u[2], u[3]))
        lower, upper = math.floor(min(v[0], v[1], v[2], v[3])), math.floor(max(v[0], v[1], v[2], v[3]))
        for q in range(lower, upper + 1):
            first, last = _row(edges, q + 0.5, left, right)
            for p in range(first, last + 1):
                a, b = p // _PIXELS, q // _PIXELS
                i, j = (depth, a) if axis == 0 else (a, depth)
                drawn[i, j, b, q % _PIXELS] |= np.uint32(1) << np.uint32(p % _PIXELS)
                total[i, j, b] += 1


@numba.njit(cache=True, nogil=True, forceinline=True, _nrt=False)
def _turn_edges(corners_m: Array, low: Array, other: int, edges: Array) -> None:
    """Find where the edges of a face begin, and how they go on, the face on their left; in pixels, (4, 4)."""
    u, v, du, dv = edges[0], edges[1], edges[2], edges[3]
    for c in range(4):
        u[c] = (corners_m[c, other] / VOXEL_M - low[other]) * _PIXELS
        v[c] = (corners_m[c, 2] / VOXEL_M - low[2]) * _PIXELS
    turn = 0.0
    for c in range(4):
        n = (c + 1) & 3
        turn += u[c] * v[n] - u[n] * v[c]
        du[c], dv[c] = u[n] - u[c], v[n] - v[c]
    if not turn > 0:
        for c in range(4):
            du[c], dv[c] = -du[c], -dv[c]


@numba.njit(cache=True, nogil=True, forceinline=True, _nrt=False)
def _row(edges: Array, y: float, first: int, last: int) -> tuple[int, int]:
    """First and last of the pixels of a row whose middles are on the left of all edges."""
    u, v, du, dv = edges[0], edges[1], edges[2], edges[3]
    for c in range(4):
        across, slope, from_u = du[c] * (y - v[c]), dv[c], u[c]
        if slope > 0.0:
            while last >= first and across < slope * (last + 0.5 - from_u):
                last -= 1
        else:
            while last >= first and across < slope * (first + 0.5 - from_u):
                first += 1
    return first, last
