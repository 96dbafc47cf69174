"""Intersection of lanes with the ground."""

import math

import numpy as np

from vlp16emu.elementary import exp
from vlp16emu.foliage.lanes import Ground, Pulse
from vlp16emu.foliage.tiles import SIDE_CODES, SIDE_ROW_BIT
from vlp16emu.foliage.voxel import BRICK, FINER, QUANTILES, VOXEL_M
from vlp16emu.kernels.compiler import inline_kernel, kernel
from vlp16emu.types import F4

f4 = np.float32
u4 = np.uint32
_Ray = tuple[np.float32, np.float32, np.float32, np.float32, np.float32, np.float32]
_Slope = tuple[np.float32, np.float32, np.float32]
"""Height over the ground, and the slope of the ground along x and y."""


@inline_kernel
def meet_ground(ground: Ground, pulse: Pulse, middle_m: np.float32, length: np.float32) -> bool:
    """Intersect the lanes with the ground within a slab; return True if any hits it."""
    L = pulse.lanes
    axis = pulse.axis
    last_m = middle_m + f4(0.5) * length
    clear_m = _over_ground(ground, (axis[0], axis[1], axis[2], axis[3], axis[4], axis[5]), last_m)[0]
    steepest = f4(1.0 + ground.steepest)
    if clear_m > steepest * (pulse.spread * last_m + pulse.aside_m):
        return False
    met = False
    range_m = L.range_m
    first_m = max(middle_m - f4(0.5) * length, pulse.near_m)
    for lane in range(pulse.n):
        if range_m[lane] <= first_m:
            continue
        x, y, z = L.origin_m[0, lane], L.origin_m[1, lane], L.origin_m[2, lane]
        dx, dy, dz = L.direction[0, lane], L.direction[1, lane], L.direction[2, lane]
        ray = x, y, z, dx, dy, dz
        below = _over_ground(ground, ray, last_m)
        if not below[0] <= 0:
            continue
        at_m, gx, gy = _ground_at(ground, ray, first_m, last_m, below)
        if at_m < range_m[lane]:
            range_m[lane] = at_m
            L.cosine[lane] = min(
                abs(dz - gx * dx - gy * dy) / f4(math.sqrt(gx * gx + gy * gy + f4(1.0))), f4(1.0)
            )
            across = f4(1.0 / (BRICK * VOXEL_M))
            i = min(
                max(int((x + dx * at_m - f4(ground.corner_x_m)) * across), 0), ground.surface.shape[0] - 1
            )
            j = min(
                max(int((y + dy * at_m - f4(ground.corner_y_m)) * across), 0), ground.surface.shape[1] - 1
            )
            L.surface[lane] = ground.surface[i, j]
            _meet_side(ground, pulse, lane, (x + dx * at_m, y + dy * at_m))
            met = True
    return met


@inline_kernel
def _meet_side(ground: Ground, pulse: Pulse, lane: int, at_m: tuple[np.float32, np.float32]) -> None:
    """Replace the ground that a lane meets by the side of a low thing in front of it, if there is one.

    The lower the light, the more of the ground is behind such sides: where they have the projected area a per
    area of ground, light that meets the ground at the sine s meets a side first in 1 - exp(-a / s) of all
    cases (Beer's law).
    """
    (x, y) = at_m
    sides = ground.sides
    i = min(max(int((x - f4(ground.corner_x_m)) * f4(FINER / VOXEL_M)), 0), sides.shape[0] - 1)
    j = min(max(int((y - f4(ground.corner_y_m)) * f4(FINER / VOXEL_M)), 0), sides.shape[1] - 1)
    word = sides[i, j]
    if not word:
        return
    L = pulse.lanes
    row = word >> u4(SIDE_ROW_BIT)
    # Squares of a tile keep their draws from window to window: tiles have an even number of them.
    drawn = u4(u4(row * u4(4) + u4(2 * (i & 1) + (j & 1))) * u4(0x9E3779B1))
    drawn = u4(u4(drawn ^ u4(drawn >> u4(15))) * u4(0x85EBCA77))
    drawn = u4(drawn ^ u4(drawn >> u4(13)))
    side = float(word & u4(SIDE_CODES)) / SIDE_CODES
    if float(drawn >> u4(16)) < 65536.0 * (1.0 - exp(-side / max(float(L.cosine[lane]), 1e-3))):
        L.cosine[lane] = ground.facing[int(drawn & u4(0xFFFF)) % QUANTILES]
        L.surface[lane] += row


@inline_kernel
def _ground_at(ground: Ground, ray: _Ray, first_m: np.float32, last_m: np.float32, below: _Slope) -> _Slope:
    """Return range and slope where a ray meets the ground in a slab; `below` is taken at its end."""
    (_, _, _, dx, dy, dz) = ray
    at_m = last_m
    slope = below
    low_m = first_m
    c_low = f4(0.0)
    for _ in range(4):  # piecewise flat: a step along the slope, then secants
        falls = dz - slope[1] * dx - slope[2] * dy
        if slope[0] <= 0 and falls < f4(-1e-4) and c_low == 0:
            at_m = max(at_m - slope[0] / falls, first_m)
        else:
            at_m = low_m + (at_m - low_m) * c_low / (c_low - slope[0])
        slope = _over_ground(ground, ray, at_m)
        if abs(slope[0]) < f4(5e-4) or at_m <= first_m:
            break
        if slope[0] > 0:
            low_m = at_m
            c_low = slope[0]
            at_m = last_m
            slope = below
    falls = dz - slope[1] * dx - slope[2] * dy
    if abs(falls) > f4(1e-4):  # at grazing incidence a small height is a long range
        at_m = min(max(at_m - slope[0] / falls, low_m), last_m)
    return at_m, slope[1], slope[2]


@inline_kernel
def _over_ground(ground: Ground, ray: _Ray, at_m: np.float32) -> _Slope:
    """Return height over the ground (infinite without ground) and slope of a ray at a range."""
    (x, y, z, dx, dy, dz) = ray
    ground_m = ground.height_m
    u = (x + dx * at_m - f4(ground.corner_x_m)) * f4(FINER / VOXEL_M)
    v = (y + dy * at_m - f4(ground.corner_y_m)) * f4(FINER / VOXEL_M)
    i = min(max(int(u), 0), ground_m.shape[0] - 2)
    j = min(max(int(v), 0), ground_m.shape[1] - 2)
    s = u - f4(i)
    t = v - f4(j)
    h00 = ground_m[i, j]
    h11 = ground_m[i + 1, j + 1]
    if s >= t:
        h10 = ground_m[i + 1, j]
        gx = h10 - h00
        gy = h11 - h10
    else:
        h01 = ground_m[i, j + 1]
        gx = h11 - h01
        gy = h01 - h00
    height = h00 + gx * s + gy * t
    return z + dz * at_m - height, gx * f4(FINER / VOXEL_M), gy * f4(FINER / VOXEL_M)


@kernel
def greatest_steps_m(height_m: F4, lowest_m: float) -> tuple[float, float]:
    """Return the greatest steps along x and y between neighbours of heights (m, n), 0 if there is none.

    Heights below `lowest_m` are unknown.
    """
    along_x = along_y = 0.0
    rows = np.uint64(height_m.shape[0])
    columns = np.uint64(height_m.shape[1])
    one = np.uint64(1)
    for i in range(rows):
        for j in range(columns):
            here = height_m[i, j]
            if here > lowest_m:
                if i + one < rows and height_m[i + one, j] > lowest_m:
                    along_x = max(along_x, np.float64(abs(height_m[i + one, j] - here)))
                if j + one < columns and height_m[i, j + one] > lowest_m:
                    along_y = max(along_y, np.float64(abs(height_m[i, j + one] - here)))
    return along_x, along_y
