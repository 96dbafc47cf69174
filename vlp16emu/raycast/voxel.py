"""Voxels of a medium: their size, and the codes of how much is in them.

Also where ground and stems may be met, and how much of the faces in a voxel is hidden by others.
"""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import hypot, log

VOXEL_M = 0.5
BRICK = 4
"""Voxels along the edge of a brick."""
COLUMNS = 40
"""Voxels along the edge of a tile of 20 m."""

FINER = 2
"""Squares of the ground along the edge of a voxel."""

KNOTS = np.array([0.0, 0.3, 1.0])
"""Sines of the elevations at which projected areas are known: level, 17 degrees, and upright."""
QUANTILES = 16
"""Of the cosine of incidence, at middles of equal shares of the projected area."""

CODES, MOST_PER_M = 127, 24.0
"""Greatest code, and its projected area per volume."""
TAU_PER_M = (MOST_PER_M * np.square(np.arange(CODES + 1) / CODES)).astype(np.float32)
"""Projected area per volume of each of the codes that voxels have."""

LAW_BIT, TILE_BIT, SHARE_BIT = np.uint64(32), np.uint64(52), np.uint64(56)
"""Where the parts of an owner begin, its row being the first."""
LAW_MASK = np.uint64((1 << 20) - 1)

GROUND = np.uint32(1 << 21)
"""Flag of a voxel, above its three codes of seven bits: the ground may be met in or beside it."""


ASIDE_M = 0.26 + 0.16
"""How far beside a voxel a stem may be that is looked for in it: half a voxel, for a ray is looked at in the middle of
each voxel that it passes, and the half width of a beam of 3 mrad at 100 m."""
_ABOVE_M = 0.26 + 0.16
"""The same above and below: rays rise by no more than they go along."""

Array = NDArray[np.float64]


def stem_lines(stems: NDArray[np.void], origin_m: Array) -> Array:
    """Axes of stems: (n, 7) lower end relative to an origin, rise per metre of height in x and y, height, widest reach."""
    axis = stems["axis"]
    low_m, high_m = stems["along_m"][:, 0] * axis[:, 2], stems["along_m"][:, -1] * axis[:, 2]
    slope = axis[:, :2] / axis[:, 2:]
    foot_m = stems["foot_m"] - origin_m
    lower = foot_m + np.column_stack([slope * low_m[:, None], low_m])
    return np.column_stack([lower, slope, high_m - low_m, _reach_m(stems).max(axis=1)])


def _reach_m(stems: NDArray[np.void]) -> Array:
    """How far stems reach from their axes at the knots, (n, knots), bent as they are."""
    reach_m: Array = stems["radius_m"] + hypot(stems["aside_m"][:, 0], stems["aside_m"][:, 1])
    return reach_m


def stem_radii(stems: NDArray[np.void]) -> NDArray[np.float32]:
    """Reach of stems, (n, 2, knots): heights over the lower end, and how far they are from the axis from there upwards."""
    height_m = (stems["along_m"] - stems["along_m"][:, :1]) * stems["axis"][:, 2:]
    widest_m = np.maximum.accumulate(_reach_m(stems)[:, ::-1], axis=1)[:, ::-1]
    return np.stack([height_m, widest_m], axis=1).astype(np.float32)


@numba.njit(cache=True, nogil=True)
def stem_columns(line: Array, aside_m: float, from_m: float, to_m: float) -> tuple[int, int, int, int]:
    """First and last column of voxels, in x and y, that come so near to a stem between two heights over its lower end."""
    x0, x1, y0, y1 = (
        line[0] + line[3] * from_m,
        line[0] + line[3] * to_m,
        line[1] + line[4] * from_m,
        line[1] + line[4] * to_m,
    )
    return (
        math.floor((min(x0, x1) - aside_m) / VOXEL_M),
        math.floor((max(x0, x1) + aside_m) / VOXEL_M),
        math.floor((min(y0, y1) - aside_m) / VOXEL_M),
        math.floor((max(y0, y1) + aside_m) / VOXEL_M),
    )


@numba.njit(cache=True, nogil=True)
def stem_beside(line: Array, aside_m: float, from_m: float, to_m: float, x: int, y: int) -> bool:
    """Whether a stem between two heights comes so near to a column of voxels."""
    # From the middle of the column to the axis as seen from above, which is a piece of a straight line.
    a = (x + 0.5) * VOXEL_M - line[0] - line[3] * from_m
    b = (y + 0.5) * VOXEL_M - line[1] - line[4] * from_m
    u, v = line[3] * (to_m - from_m), line[4] * (to_m - from_m)
    square = u * u + v * v
    share = min(max((a * u + b * v) / square, 0.0), 1.0) if square > 0.0 else 0.0
    dx, dy = abs(a - share * u) - VOXEL_M / 2, abs(b - share * v) - VOXEL_M / 2
    dx, dy = max(dx, 0.0), max(dy, 0.0)
    return dx * dx + dy * dy <= aside_m * aside_m


@numba.njit(cache=True, nogil=True)
def mark_stem(mask: NDArray[np.uint64], line: Array, radii: NDArray[np.float32], low_m: float) -> None:
    """Mark the voxels, bits of bricks, in which a stem is looked for."""
    nx, ny, nz = mask.shape[0] * BRICK, mask.shape[1] * BRICK, mask.shape[2] * BRICK
    foot_m = line[2] - low_m
    first, last = (
        math.floor((foot_m - _ABOVE_M) / VOXEL_M),
        math.floor((foot_m + line[5] + _ABOVE_M) / VOXEL_M),
    )
    for k in range(max(first, 0), min(last, nz - 1) + 1):
        below_m = max(k * VOXEL_M - foot_m - _ABOVE_M, 0.0)
        above_m = min((k + 1) * VOXEL_M - foot_m + _ABOVE_M, line[5])
        aside_m = _widest_m(radii, below_m) + ASIDE_M
        x0, x1, y0, y1 = stem_columns(line, aside_m, below_m, above_m)
        for i in range(max(x0, 0), min(x1, nx - 1) + 1):
            for j in range(max(y0, 0), min(y1, ny - 1) + 1):
                if stem_beside(line, aside_m, below_m, above_m, i, j):
                    bit = 16 * (i & 3) + 4 * (j & 3) + (k & 3)
                    mask[i >> 2, j >> 2, k >> 2] |= np.uint64(1) << np.uint64(bit)


@numba.njit(cache=True, nogil=True)
def _widest_m(radii: NDArray[np.float32], height_m: float) -> np.float64:
    """Interpolate the greatest radius of a stem from a height upwards."""
    last = radii.shape[1] - 1
    if height_m >= radii[0, last]:
        return np.float64(radii[1, last])
    knot = 0
    while knot < last - 1 and radii[0, knot + 1] <= height_m:
        knot += 1
    low_m, wide_m = np.float64(radii[0, knot]), np.float64(radii[1, knot])
    taper = (np.float64(radii[1, knot + 1]) - wide_m) / (np.float64(radii[0, knot + 1]) - low_m)
    return taper * max(height_m - low_m, 0.0) + wide_m


@numba.njit(cache=True, nogil=True)
def mark_ground(flags: NDArray[np.uint32], ground_m: NDArray[np.float32], low_m: float) -> None:
    """Flag the voxels in which the ground is looked for; heights (85, 85) begin one voxel outside the tile."""
    for i in range(flags.shape[0]):
        for j in range(flags.shape[1]):
            around = ground_m[FINER * i : FINER * (i + 3) + 1, FINER * j : FINER * (j + 3) + 1]
            low, high = around.min(), around.max()
            first, last = (
                math.floor((low - low_m - 0.6) / VOXEL_M),
                math.floor((high - low_m + 0.16) / VOXEL_M),
            )
            for k in range(max(first, 0), min(last, flags.shape[2] - 1) + 1):
                flags[i, j, k] |= GROUND


_PIXELS = 32
"""Of a voxel's edge, 16 mm each, in which faces are drawn."""


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
                    hidden = min(bits / (_PIXELS * _PIXELS), 1.0 - 0.5 / (_PIXELS * _PIXELS))
                    factor[i, j, k] -= log(1.0 - hidden) * (_PIXELS * _PIXELS)


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
