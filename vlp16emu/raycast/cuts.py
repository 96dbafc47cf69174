"""Lanes cut with stems and with the ground."""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.raycast.grid import Ground, Stems
from vlp16emu.raycast.lanes import FAST, Lanes
from vlp16emu.raycast.voxel import BRICK, VOXEL_M

__all__ = ["meet_ground", "meet_stem"]

f4 = np.float32


@numba.njit(cache=True, nogil=True, _nrt=False, fastmath=FAST, error_model="numpy", inline="always")
def meet_stem(
    stems: Stems,
    L: Lanes,
    n: int,
    near_m: float,
    axis: NDArray[np.float32],
    stem: int,
    spread: float,
    aside_m: float,
) -> bool:
    """Cut the lanes with a stem: across its axis a circle whose radius is that of the height at which it is met."""
    s, profile = stems.line[stem], stems.profile[stem]
    up, lift, square, ahead, aside2 = _beside(s, axis[0], axis[1], axis[2], axis[3], axis[4], axis[5])
    if square < 1e-9:
        return False
    nearest_m = ahead / square
    off2 = aside2 - nearest_m * nearest_m * square
    within = s[6] + aside_m + spread * nearest_m
    if off2 > within * within:  # the middle of the pulse is too far from the axis
        return False
    # The cone that the stem is where the middle meets it; the beam is too narrow to leave it by more than a little.
    low_m, low_radius_m, taper = _cone(profile, nearest_m * up - lift)
    radius_m = low_radius_m + taper * (nearest_m * up - lift - low_m)
    ahead_m = math.sqrt(max(radius_m * radius_m - off2, 0.0) / square)
    low_m, low_radius_m, taper = _cone(profile, (nearest_m - ahead_m) * up - lift)
    met = False
    for lane in range(n):
        dx, dy, dz = L.direction[0, lane], L.direction[1, lane], L.direction[2, lane]
        x, y, z = L.origin_m[0, lane], L.origin_m[1, lane], L.origin_m[2, lane]
        up, lift, square, ahead, aside2 = _beside(s, x, y, z, dx, dy, dz)
        # Radius as it changes along the ray, and where its square is that of the distance from the axis.
        begin, change = low_radius_m - taper * (lift + low_m), taper * up
        a, b, c = square - change * change, ahead + begin * change, aside2 - begin * begin
        inside = b * b - a * c
        at_m = (b - math.sqrt(max(inside, 0.0))) / a
        radius_m, height_m = begin + change * at_m, at_m * up - lift
        is_stem = inside > 0.0 and a > 0.0 and radius_m > 0.0 and profile[0, 0] <= height_m <= profile[0, -1]
        if is_stem and near_m <= at_m < L.range_m[lane]:
            L.range_m[lane] = at_m
            L.surface[lane] = stems.surface[stem, 0 if height_m < stems.flare_m[stem] else 1]
            L.cosine[lane] = min(max((ahead - at_m * square) / radius_m, 0.0), 1.0)
            met = True
    return met


@numba.njit(cache=True, nogil=True, _nrt=False, fastmath=FAST, error_model="numpy", inline="always")
def _beside(
    line: NDArray[np.float64], x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> tuple[float, float, float, float, float]:
    """Look at a ray across the axis of a stem.

    Returns
    -------
    Rise along the axis per metre of range, and height of the foot over the origin; in the plane across the axis the square
    of the direction, its product with the way to the axis, and the square of that.
    """
    qx, qy, qz = line[0] - x, line[1] - y, line[2] - z
    up = dx * line[3] + dy * line[4] + dz * line[5]
    lift = qx * line[3] + qy * line[4] + qz * line[5]
    wx, wy, wz = dx - up * line[3], dy - up * line[4], dz - up * line[5]
    ux, uy, uz = qx - lift * line[3], qy - lift * line[4], qz - lift * line[5]
    return up, lift, wx * wx + wy * wy + wz * wz, ux * wx + uy * wy + uz * wz, ux * ux + uy * uy + uz * uz


@numba.njit(cache=True, nogil=True, _nrt=False, fastmath=FAST, error_model="numpy", inline="always")
def _cone(profile: NDArray[np.float32], at: float) -> tuple[np.float32, np.float32, np.float32]:
    """Find the cone that a stem is at a height: its lower end, the radius there, and how that changes."""
    lower, upper = 0, profile.shape[1] - 1
    while upper - lower > 1:
        middle = (lower + upper) >> 1
        if profile[0, middle] <= at:
            lower = middle
        else:
            upper = middle
    low_m, low_radius_m = profile[0, lower], profile[1, lower]
    taper = (profile[1, upper] - low_radius_m) / (profile[0, upper] - low_m)
    return low_m, low_radius_m, taper


@numba.njit(cache=True, nogil=True, _nrt=False, fastmath=FAST, error_model="numpy", inline="always")
def meet_ground(
    ground: Ground,
    L: Lanes,
    n: int,
    near_m: float,
    axis: NDArray[np.float32],
    middle_m: float,
    length: float,
    spread: float,
    aside_m: float,
) -> bool:
    """Cut the lanes with the ground within a slab; whether any meets it."""
    last_m = middle_m + f4(0.5) * length
    clear_m = _over_ground(ground, axis[0], axis[1], axis[2], axis[3], axis[4], axis[5], last_m)[0]
    steepest = f4(1.0 + ground.steepest)
    if clear_m > steepest * (spread * last_m + aside_m):
        return False
    met, range_m = False, L.range_m
    first_m = max(middle_m - f4(0.5) * length, near_m)
    for lane in range(n):
        if range_m[lane] <= first_m:
            continue
        x, y, z = L.origin_m[0, lane], L.origin_m[1, lane], L.origin_m[2, lane]
        dx, dy, dz = L.direction[0, lane], L.direction[1, lane], L.direction[2, lane]
        below = _over_ground(ground, x, y, z, dx, dy, dz, last_m)
        if not below[0] <= 0:
            continue
        at_m, gx, gy = _ground_at(ground, x, y, z, dx, dy, dz, first_m, last_m, below)
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
            met = True
    return met


@numba.njit(cache=True, nogil=True, _nrt=False, fastmath=FAST, error_model="numpy", inline="always")
def _ground_at(
    ground: Ground,
    x: np.float32,
    y: np.float32,
    z: np.float32,
    dx: np.float32,
    dy: np.float32,
    dz: np.float32,
    first_m: np.float32,
    last_m: np.float32,
    below: tuple[np.float32, np.float32, np.float32],
) -> tuple[np.float32, np.float32, np.float32]:
    """Find the range at which a ray meets the ground, at the end of a slab being `below` it; with the slope there."""
    at_m, slope = last_m, below
    low_m, c_low = first_m, f4(0.0)
    for _ in range(4):  # flat but for the edges of its triangles: along the slope, and then by secants
        falls = dz - slope[1] * dx - slope[2] * dy
        if slope[0] <= 0 and falls < f4(-1e-4) and c_low == 0:
            at_m = max(at_m - slope[0] / falls, first_m)
        else:
            at_m = low_m + (at_m - low_m) * c_low / (c_low - slope[0])
        slope = _over_ground(ground, x, y, z, dx, dy, dz, at_m)
        if abs(slope[0]) < f4(5e-4) or at_m <= first_m:
            break
        if slope[0] > 0:
            low_m, c_low, at_m, slope = at_m, slope[0], last_m, below
    falls = dz - slope[1] * dx - slope[2] * dy
    if abs(falls) > f4(1e-4):  # where light grazes, what is left in height is long in range
        at_m = min(max(at_m - slope[0] / falls, low_m), last_m)
    return at_m, slope[1], slope[2]


@numba.njit(cache=True, nogil=True, _nrt=False, fastmath=FAST, error_model="numpy", inline="always")
def _over_ground(
    ground: Ground, x: float, y: float, z: float, dx: float, dy: float, dz: float, at_m: float
) -> tuple[np.float32, np.float32, np.float32]:
    """Height of a ray over the ground at a range, and the slope of the triangle there; no ground is infinitely deep."""
    ground_m = ground.height_m
    u = (x + dx * at_m - f4(ground.corner_x_m)) * f4(1.0 / VOXEL_M)
    v = (y + dy * at_m - f4(ground.corner_y_m)) * f4(1.0 / VOXEL_M)
    i = min(max(int(u), 0), ground_m.shape[0] - 2)
    j = min(max(int(v), 0), ground_m.shape[1] - 2)
    s, t = u - f4(i), v - f4(j)
    h00, h11 = ground_m[i, j], ground_m[i + 1, j + 1]
    if s >= t:
        h10 = ground_m[i + 1, j]
        gx, gy = h10 - h00, h11 - h10
    else:
        h01 = ground_m[i, j + 1]
        gx, gy = h11 - h01, h01 - h00
    height = h00 + gx * s + gy * t
    return z + dz * at_m - height, gx * f4(1.0 / VOXEL_M), gy * f4(1.0 / VOXEL_M)
