"""Lanes cut with stems and with the ground."""

import math

import numba
import numpy as np

from vlp16emu.foliage.lanes import AT, FACING, HEIGHT, Ground, Pulse, Stems
from vlp16emu.foliage.voxel import BRICK, FINER, VOXEL_M
from vlp16emu.raycast.batch import COSINE, DIRECTION, LANES, ORIGIN, RANGE
from vlp16emu.types import F4

f4 = np.float32
_Ray = tuple[np.float32, np.float32, np.float32, np.float32, np.float32, np.float32]
_Slope = tuple[np.float32, np.float32, np.float32]
"""Height over the ground, and how the ground rises along x and y."""


@numba.njit(cache=True, nogil=True, _nrt=False, error_model="numpy", forceinline=True)
def meet_stem(stems: Stems, pulse: Pulse, stem: int) -> bool:
    """Cut the lanes with a stem: a circle about its axis, bent and as wide as at the height where it is met."""
    axis = pulse.axis
    s, profile = stems.line[stem], stems.profile[stem]
    sx, sy, sz = s[3], s[4], s[5]
    up = axis[3] * sx + axis[4] * sy + axis[5] * sz
    wx, wy, wz = axis[3] - up * sx, axis[4] - up * sy, axis[5] - up * sz
    square = wx * wx + wy * wy + wz * wz
    if square < 1e-9:
        return False
    # Range and height at which the middle of the pulse is nearest to the axis, and how far it is from it there.
    q = axis[0] - s[0], axis[1] - s[1], axis[2] - s[2]
    nearest_m, height_m, off2 = _nearest(q, (sx, sy, sz), (wx, wy, wz), up, square)
    margin_m = pulse.spread * abs(nearest_m) + pulse.aside_m
    within_m = s[6] + s[7] + margin_m
    if off2 > within_m * within_m:
        return False
    # The same of the axis as it runs at that height.
    knot = _knot(profile, height_m)
    share = (height_m - profile[0, knot]) / (profile[0, knot + 1] - profile[0, knot])
    share = min(max(share, 0.0), 1.0)
    bent_x = profile[3, knot] + share * (profile[3, knot + 1] - profile[3, knot])
    bent_y = profile[4, knot] + share * (profile[4, knot + 1] - profile[4, knot])
    q = q[0] - bent_x, q[1] - bent_y, q[2]
    nearest_m, height_m, off2 = _nearest(q, (sx, sy, sz), (wx, wy, wz), up, square)
    widest_m = profile[2, _knot(profile, height_m - margin_m - s[6] * abs(up))]
    within_m = widest_m + margin_m
    if off2 > within_m * within_m:
        return False
    # The cone that the stem is where the middle meets it; the beam is too narrow to leave it by more than a little.
    knot = _knot(profile, height_m - up * math.sqrt(max(widest_m * widest_m - off2, 0.0) / square))
    taper = (profile[1, knot + 1] - profile[1, knot]) / (profile[0, knot + 1] - profile[0, knot])
    _cut_cone(
        pulse.lanes.row,
        (f4(s[0] + bent_x + height_m * sx), f4(s[1] + bent_y + height_m * sy), f4(s[2] + height_m * sz)),
        (f4(sx), f4(sy), f4(sz)),
        f4(nearest_m),
        f4(height_m),
        f4(profile[1, knot] + taper * (height_m - profile[0, knot])),
        taper,
    )
    return _keep_nearest(stems, pulse, stem)


@numba.njit(cache=True, nogil=True, _nrt=False, error_model="numpy", forceinline=True)
def _nearest(
    q: tuple[float, float, float],
    s: tuple[float, float, float],
    w: tuple[float, float, float],
    up: float,
    square: float,
) -> tuple[float, float, float]:
    """Return range, height along the axis and squared distance where a ray from `q` is nearest to an axis along `s`.

    The ray's direction is `up` along the axis and `w` across it, whose length squared is `square`.
    """
    lift = q[0] * s[0] + q[1] * s[1] + q[2] * s[2]
    nearest_m = -(q[0] * w[0] + q[1] * w[1] + q[2] * w[2]) / square
    px, py, pz = (
        q[0] - lift * s[0] + nearest_m * w[0],
        q[1] - lift * s[1] + nearest_m * w[1],
        q[2] - lift * s[2] + nearest_m * w[2],
    )
    return nearest_m, lift + nearest_m * up, px * px + py * py + pz * pz


@numba.njit(cache=True, nogil=True, _nrt=False, error_model="numpy", forceinline=True)
def _keep_nearest(stems: Stems, pulse: Pulse, stem: int) -> bool:
    """Keep hits of a stem's cone that are nearest, and within the stem; return True if there is any."""
    L, near_m = pulse.lanes, pulse.near_m
    met, row, flare_m, along_m = False, L.row, stems.flare_m[stem], stems.profile[stem, 0]
    for lane in range(pulse.n):
        at_m, height_m = row[AT + lane], row[HEIGHT + lane]
        if near_m <= at_m < row[RANGE + lane] and along_m[0] <= height_m <= along_m[-1]:
            row[RANGE + lane], row[COSINE + lane] = at_m, row[FACING + lane]
            L.surface[lane] = stems.surface[stem, 0 if height_m < flare_m else 1]
            met = True
    return met


@numba.njit(cache=True, nogil=True, _nrt=False, error_model="numpy", forceinline=True)
def _cut_cone(
    row: F4,
    middle_m: tuple[np.float32, np.float32, np.float32],
    axis: tuple[np.float32, np.float32, np.float32],
    from_m: np.float32,
    height_m: np.float32,
    radius_m: np.float32,
    taper: np.float32,
) -> None:
    """Cut all lanes with a cone, looked at from the middle of its circle at a height; `from_m` is the range there."""
    sx, sy, sz = axis
    for lane in range(LANES):
        dx, dy, dz = (row[DIRECTION + lane], row[DIRECTION + LANES + lane], row[DIRECTION + 2 * LANES + lane])
        x = row[ORIGIN + lane] + from_m * dx - middle_m[0]
        y = row[ORIGIN + LANES + lane] + from_m * dy - middle_m[1]
        z = row[ORIGIN + 2 * LANES + lane] + from_m * dz - middle_m[2]
        lift, up = x * sx + y * sy + z * sz, dx * sx + dy * sy + dz * sz
        x, y, z = x - lift * sx, y - lift * sy, z - lift * sz
        dx, dy, dz = dx - up * sx, dy - up * sy, dz - up * sz
        # Radius as it changes along the ray, and where its square is that of the distance from the axis.
        begin_m, change = radius_m + taper * lift, taper * up
        along, square = x * dx + y * dy + z * dz, dx * dx + dy * dy + dz * dz
        a, b = square - change * change, begin_m * change - along
        inside = b * b - a * (x * x + y * y + z * z - begin_m * begin_m)
        on_m = (b - np.sqrt(max(inside, f4(0.0)))) / a
        there_m = begin_m + change * on_m
        met = (inside > f4(0.0)) & (a > f4(0.0)) & (there_m > f4(0.0))
        row[AT + lane] = from_m + on_m if met else f4(np.inf)
        row[HEIGHT + lane] = height_m + lift + up * on_m
        row[FACING + lane] = min(max(-(along + square * on_m) / there_m, f4(0.0)), f4(1.0))


@numba.njit(cache=True, nogil=True, _nrt=False, error_model="numpy", forceinline=True)
def _knot(profile: F4, height_m: float) -> int:
    """Find the knot of a profile at or below a height; the last but one from there on, the first below all."""
    knot, at_m = 0, f4(height_m)
    for i in range(1, profile.shape[1] - 1):
        knot += profile[0, i] <= at_m
    return knot


@numba.njit(cache=True, nogil=True, _nrt=False, error_model="numpy", forceinline=True)
def meet_ground(ground: Ground, pulse: Pulse, middle_m: float, length: float) -> bool:
    """Cut the lanes with the ground within a slab; return True if any meets it."""
    L, axis = pulse.lanes, pulse.axis
    last_m = middle_m + f4(0.5) * length
    clear_m = _over_ground(ground, (axis[0], axis[1], axis[2], axis[3], axis[4], axis[5]), last_m)[0]
    steepest = f4(1.0 + ground.steepest)
    if clear_m > steepest * (pulse.spread * last_m + pulse.aside_m):
        return False
    met, range_m = False, L.range_m
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
            L.cosine[lane] = min(abs(dz - gx * dx - gy * dy) / f4(math.sqrt(gx * gx + gy * gy + f4(1.0))), f4(1.0))
            across = f4(1.0 / (BRICK * VOXEL_M))
            i = min(max(int((x + dx * at_m - f4(ground.corner_x_m)) * across), 0), ground.surface.shape[0] - 1)
            j = min(max(int((y + dy * at_m - f4(ground.corner_y_m)) * across), 0), ground.surface.shape[1] - 1)
            L.surface[lane] = ground.surface[i, j]
            met = True
    return met


@numba.njit(cache=True, nogil=True, _nrt=False, error_model="numpy", forceinline=True)
def _ground_at(ground: Ground, ray: _Ray, first_m: np.float32, last_m: np.float32, below: _Slope) -> _Slope:
    """Return range and slope where a ray meets the ground in a slab, at whose end it is `below` it."""
    (_, _, _, dx, dy, dz), at_m, slope = ray, last_m, below
    low_m, c_low = first_m, f4(0.0)
    for _ in range(4):  # flat but for the edges of its triangles: along the slope, and then by secants
        falls = dz - slope[1] * dx - slope[2] * dy
        if slope[0] <= 0 and falls < f4(-1e-4) and c_low == 0:
            at_m = max(at_m - slope[0] / falls, first_m)
        else:
            at_m = low_m + (at_m - low_m) * c_low / (c_low - slope[0])
        slope = _over_ground(ground, ray, at_m)
        if abs(slope[0]) < f4(5e-4) or at_m <= first_m:
            break
        if slope[0] > 0:
            low_m, c_low, at_m, slope = at_m, slope[0], last_m, below
    falls = dz - slope[1] * dx - slope[2] * dy
    if abs(falls) > f4(1e-4):  # where light grazes, what is left in height is long in range
        at_m = min(max(at_m - slope[0] / falls, low_m), last_m)
    return at_m, slope[1], slope[2]


@numba.njit(cache=True, nogil=True, _nrt=False, error_model="numpy", forceinline=True)
def _over_ground(ground: Ground, ray: _Ray, at_m: float) -> _Slope:
    """Return the height of a ray over the ground at a range, and the slope there; no ground is infinitely deep."""
    (x, y, z, dx, dy, dz), ground_m = ray, ground.height_m
    u = (x + dx * at_m - f4(ground.corner_x_m)) * f4(FINER / VOXEL_M)
    v = (y + dy * at_m - f4(ground.corner_y_m)) * f4(FINER / VOXEL_M)
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
    return z + dz * at_m - height, gx * f4(FINER / VOXEL_M), gy * f4(FINER / VOXEL_M)
