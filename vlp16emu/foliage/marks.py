"""Voxels in which ground and stems may be met."""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import hypot
from vlp16emu.foliage.voxel import BRICK, FINER, GROUND, VOXEL_M
from vlp16emu.types import F4, F8, U4, U8

ASIDE_M = 0.26 + 0.16
"""Greatest distance beside a voxel of a stem that is looked for in it: half a voxel, for a ray is looked at in the middle of
each voxel that it passes, and the half width of a beam of 3 mrad at 100 m."""
_ABOVE_M = 0.26 + 0.16
"""Greatest distance above and below: rays rise by no more than they go along."""


def stem_lines(stems: NDArray[np.void], origin_m: F8) -> F8:
    """Axes of stems: (n, 7) lower end relative to an origin, rise per metre of height in x and y, height, widest reach."""
    axis = stems["axis"]
    low_m, high_m = stems["along_m"][:, 0] * axis[:, 2], stems["along_m"][:, -1] * axis[:, 2]
    slope = axis[:, :2] / axis[:, 2:]
    foot_m = stems["foot_m"] - origin_m
    lower = foot_m + np.column_stack([slope * low_m[:, None], low_m])
    return np.column_stack([lower, slope, high_m - low_m, _reach_m(stems).max(axis=1)])


def _reach_m(stems: NDArray[np.void]) -> F8:
    reach_m: F8 = stems["radius_m"] + hypot(stems["aside_m"][:, 0], stems["aside_m"][:, 1])
    return reach_m


def stem_radii(stems: NDArray[np.void]) -> F4:
    """Reach of stems, (n, 2, knots): heights over the lower end, and how far they are from the axis from there upwards."""
    height_m = (stems["along_m"] - stems["along_m"][:, :1]) * stems["axis"][:, 2:]
    widest_m = np.maximum.accumulate(_reach_m(stems)[:, ::-1], axis=1)[:, ::-1]
    return np.stack([height_m, widest_m], axis=1).astype(np.float32)


@numba.njit(cache=True, nogil=True)
def stem_columns(line: F8, aside_m: float, from_m: float, to_m: float) -> tuple[int, int, int, int]:
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
def stem_beside(line: F8, aside_m: float, from_m: float, to_m: float, x: int, y: int) -> bool:
    """Return True if a stem between two heights comes within `aside_m` of a column of voxels."""
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
def mark_stem(mask: U8, line: F8, radii: F4, low_m: float) -> None:
    """Mark the voxels, bits of bricks, in which a stem is looked for."""
    nx, ny, nz = mask.shape[0] * BRICK, mask.shape[1] * BRICK, mask.shape[2] * BRICK
    foot_m = line[2] - low_m
    first, last = (math.floor((foot_m - _ABOVE_M) / VOXEL_M), math.floor((foot_m + line[5] + _ABOVE_M) / VOXEL_M))
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
def _widest_m(radii: F4, height_m: float) -> np.float64:
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
def mark_ground(flags: U4, ground_m: F4, low_m: float) -> None:
    """Flag the voxels in which the ground is looked for; heights (85, 85) begin one voxel outside the tile."""
    for i in range(flags.shape[0]):
        for j in range(flags.shape[1]):
            around = ground_m[FINER * i : FINER * (i + 3) + 1, FINER * j : FINER * (j + 3) + 1]
            low, high = around.min(), around.max()
            first, last = (math.floor((low - low_m - 0.6) / VOXEL_M), math.floor((high - low_m + 0.16) / VOXEL_M))
            for k in range(max(first, 0), min(last, flags.shape[2] - 1) + 1):
                flags[i, j, k] |= GROUND
