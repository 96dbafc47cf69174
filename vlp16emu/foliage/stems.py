"""Stems seen from the sensor, and their intersection with lanes.

From 15 m on, stems move slowly across the view, and the pulses of eight firing sequences look into a narrow
sector. So the stems of a sector are listed once for all its pulses, nearest first, and a pulse is intersected
with stems before it passes foliage.

In wind a stem's sections move level by the curve of its beam, as near stems do (`types.Sway`), to where they
are at the time of the pulse.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import hypot
from vlp16emu.foliage.lanes import AT, FACING, HEIGHT, Pulse, Stems
from vlp16emu.kernels.compiler import inline_kernel, kernel
from vlp16emu.kernels.eight import lowest_bit
from vlp16emu.raycast.build import knot_at
from vlp16emu.raycast.kernel import AXES_TIME, COSINE, DIRECTION, LANES, ORIGIN, RANGE
from vlp16emu.types import F4, F8, I4, I8, U1, U4

f4 = np.float32
_BLOCK = 8  # stems that are tested together
_ROWS = 9  # rows of a block: foot, unit axis, lowest and highest end along the axis, reach beside it
_X, _Y, _Z, _SX, _SY, _SZ, _LOW, _HIGH, _REACH = (np.uint64(_BLOCK * row) for row in range(_ROWS))
"""Offsets of these rows; unsigned, as signed indices might count from the end, and are read one by one."""
_ROUNDING_M = f4(0.01)  # more than the rounding of float32 within 200 m
_WIDE = 0.7  # sine and cosine of the half-width beyond which a sector lists all stems of the window


class StemsAhead(NamedTuple):
    """Stems that a group of pulses may meet, nearest first; with room for all stems of a window."""

    row: F4  # (blocks * 72,) `_ROWS` rows for each block of eight
    stem: I4  # (8 * blocks,) stem numbers
    from_m: F4  # (8 * blocks,) least range at which each can be hit
    is_seen: U1  # (8 * blocks,) scratch
    total: I8  # (1,) number of listed stems


class _Sector(NamedTuple):
    """Directions of pulses as seen from above; a middle of (0, 0) means all directions."""

    x_m: float
    y_m: float  # a point; the pulses begin within `away_m` of it
    away_m: float
    mx: float
    my: float  # unit vector along the middle
    right: tuple[float, float]  # cosine and sine of the right edge from the middle; `left` likewise
    left: tuple[float, float]
    level: float  # least horizontal length of a pulse's unit direction


def stem_lines(stems: NDArray[np.void], origin_m: F8) -> F8:
    """Return axes (n, 7): lower end relative to an origin, slope in x and y, height, widest reach."""
    axis = stems["axis"]
    low_m, high_m = stems["along_m"][:, 0] * axis[:, 2], stems["along_m"][:, -1] * axis[:, 2]
    slope = axis[:, :2] / axis[:, 2:]
    foot_m = stems["foot_m"] - origin_m
    lower = foot_m + np.column_stack([slope * low_m[:, None], low_m])
    reach_m = stems["radius_m"] + hypot(stems["aside_m"][:, 0], stems["aside_m"][:, 1])
    return np.column_stack([lower, slope, high_m - low_m, reach_m.max(axis=1)])


def stems_of(line: F8, profile: F4, surface: U4, flare_m: F4, sway: tuple[F4, F4] | None = None) -> Stems:
    """Return stems, with their circles as seen from above; parameters as in `Stems`.

    `sway` are the shares and the movement of the tops, None for stems at rest. The widest bend in `line` is
    that of stems at rest.
    """
    share, top_m = sway or (np.zeros((0, profile.shape[2]), np.float32), np.zeros((0, 0, 2), np.float32))
    if sway:
        line = line.copy()
        line[:, 7] += hypot(top_m[..., 0], top_m[..., 1]).max(axis=0) * share.max(axis=1)
    along_m = profile[:, 0].astype(np.float64)
    middle_m = (along_m[:, -1] + along_m[:, 0]) / 2
    half_m = (along_m[:, -1] - along_m[:, 0]) / 2
    x_m, y_m = (line[:, axis] + middle_m * line[:, 3 + axis] for axis in range(2))
    lean = hypot(line[:, 3], line[:, 4])
    plan = np.stack([x_m, y_m, half_m * lean + line[:, 6] + line[:, 7]]).astype(np.float32)
    ends_m = profile[:, 0, [0, -1]]
    bounds = np.column_stack([line[:, :6], ends_m, line[:, 6] + line[:, 7] + _ROUNDING_M]).astype(np.float32)
    return Stems(line, profile, plan, bounds, share, top_m, surface, flare_m)


def room_for_stems(stems: Stems) -> StemsAhead:
    """Make an empty `StemsAhead` with room for all `stems`."""
    blocks = -(-len(stems.line) // _BLOCK)
    return StemsAhead(
        np.zeros(blocks * _ROWS * _BLOCK, np.float32),
        np.zeros(blocks * _BLOCK, np.int32),
        np.zeros(blocks * _BLOCK, np.float32),
        np.zeros(blocks * _BLOCK, np.uint8),
        np.zeros(1, np.int64),
    )


@kernel
def find_stems_ahead(
    stems: Stems, out: StemsAhead, axes: F4, near_m: float, far_m: float, aside_m: float, spread: float
) -> None:
    """List the stems that pulses may meet, nearest first.

    Parameters
    ----------
    axes : (n, 6 or more) origins and directions of the pulses' centre rays
    near_m, far_m : range at which the medium begins, and farthest range
    aside_m, spread : as in `Pulse`
    """
    sector = _sector(axes, spread)
    count = 0
    plan = stems.plan
    is_seen = out.is_seen
    x_m = f4(sector.x_m)
    y_m = f4(sector.y_m)
    mx = f4(sector.mx)
    my = f4(sector.my)
    cos_right = f4(sector.right[0])
    sin_right = f4(sector.right[1])
    cos_left = f4(sector.left[0])
    sin_left = f4(sector.left[1])
    margin_m = f4(sector.away_m + aside_m) + _ROUNDING_M
    begin_m = f4(near_m * sector.level)
    end_m = f4(far_m)
    for i in range(plan.shape[1]):
        x = plan[0, i] - x_m
        y = plan[1, i] - y_m
        reach_m = plan[2, i] + margin_m
        along = mx * x + my * y
        across = mx * y - my * x
        distance_m = np.sqrt(x * x + y * y)
        inside = (cos_left * across - sin_left * along <= reach_m) & (
            cos_right * across - sin_right * along >= -reach_m
        )
        is_seen[i] = (
            inside & (along >= -reach_m) & (distance_m + reach_m >= begin_m) & (distance_m - reach_m <= end_m)
        )
    is_narrow = mx != f4(0.0) or my != f4(0.0)
    for i in range(plan.shape[1]):
        if is_seen[i]:
            x, y = plan[0, i] - x_m, plan[1, i] - y_m
            from_m = np.sqrt(x * x + y * y) - plan[2, i] - margin_m if is_narrow else f4(0.0)
            a = count
            while is_narrow and a > 0 and out.from_m[a - 1] > from_m:
                out.from_m[a] = out.from_m[a - 1]
                out.stem[a] = out.stem[a - 1]
                a -= 1
            out.from_m[a] = from_m
            out.stem[a] = i
            count += 1
    for a in range(count):
        stem = out.stem[a]
        at = (a // _BLOCK) * _ROWS * _BLOCK + a % _BLOCK
        for row in range(_ROWS):  # of one cache line
            out.row[at + _BLOCK * row] = stems.bounds[stem, row]
    out.total[0] = count


@inline_kernel
def _sector(axes: F4, spread: float) -> _Sector:
    """Return the sector that contains the pulses."""
    x_m = y_m = mx = my = 0.0
    level2 = 1.0
    for q in range(axes.shape[0]):
        x_m = axes[q, 0]
        y_m = axes[q, 1]
        dx = axes[q, 3]
        dy = axes[q, 4]
        mx = mx + dx
        my = my + dy
        level2 = min(level2, dx * dx + dy * dy)
    length = math.sqrt(mx * mx + my * my)
    everywhere = _Sector(x_m, y_m, np.inf, 0.0, 0.0, (0.0, 0.0), (0.0, 0.0), 0.0)
    if length == 0.0 or level2 < 0.25:
        return everywhere
    mx = mx / length
    my = my / length
    level = math.sqrt(level2)
    right = left = away_m = 0.0
    for q in range(axes.shape[0]):
        dx, dy = axes[q, 3], axes[q, 4]
        size = math.sqrt(dx * dx + dy * dy)
        if mx * dx + my * dy < _WIDE * size:
            return everywhere
        across = (mx * dy - my * dx) / size
        right, left = min(right, across), max(left, across)
        away_m = max(away_m, abs(axes[q, 0] - x_m) + abs(axes[q, 1] - y_m))
    wider = 1.1 * spread / level + 1e-3
    right, left = right - wider, left + wider
    if max(-right, left) > _WIDE:
        return everywhere
    edges = (math.sqrt(1.0 - right * right), right), (math.sqrt(1.0 - left * left), left)
    return _Sector(x_m, y_m, away_m, mx, my, edges[0], edges[1], level)


class StemsLeft(NamedTuple):
    """Stems ahead that a pulse has not been intersected with."""

    begin: int  # first stem of the next block
    close: np.uint64  # bits of the stems of the block before it that may be hit


@inline_kernel
def meet_stems(
    stems: Stems, ahead: StemsAhead, pulse: Pulse, left: StemsLeft, until_m: np.float32
) -> tuple[StemsLeft, bool]:
    """Intersect the lanes with the stems that can be hit up to a range, until all lanes have ended.

    Return the stems that are left, and True if any of the others is hit.
    """
    row = pulse.lanes.row
    from_m = ahead.from_m
    count = ahead.total[0]
    (begin, close) = left
    met = False
    last_m = _farthest(row, pulse.n)
    while True:
        if close:
            at = begin - _BLOCK + int(lowest_bit(close))
            if from_m[at] > min(last_m, until_m):
                break
            close &= close - np.uint64(1)
            if meet_stem(stems, pulse, ahead.stem[at]):
                met = True
                last_m = _farthest(row, pulse.n)
        else:
            if begin >= count or from_m[begin] > min(last_m, until_m):
                break
            close = _near_stems(ahead.row, np.uint64(begin * _ROWS), pulse, last_m)
            close &= (np.uint64(1) << np.uint64(min(count - begin, _BLOCK))) - np.uint64(1)
            begin += _BLOCK
    return StemsLeft(begin, close), met


@inline_kernel
def _farthest(row: F4, n: int) -> np.float32:
    last_m = row[RANGE]
    for lane in range(1, n):
        last_m = max(last_m, row[RANGE + lane])
    return last_m


@inline_kernel
def _near_stems(row: F4, at: np.uint64, pulse: Pulse, last_m: np.float32) -> np.uint64:
    """Return bits of the stems of a block, whose rows begin at `at`, that the pulse may hit.

    It excludes only stems for which the exact `meet_stem` has no hit.
    """
    axis = pulse.axis
    near_m = pulse.near_m
    aside_m = pulse.aside_m
    spread = pulse.spread
    ox = axis[0]
    oy = axis[1]
    oz = axis[2]
    dx = axis[3]
    dy = axis[4]
    dz = axis[5]
    close = np.uint64(0)
    for i in range(np.uint64(_BLOCK)):
        sx = row[at + _SX + i]
        sy = row[at + _SY + i]
        sz = row[at + _SZ + i]
        qx, qy, qz = ox - row[at + _X + i], oy - row[at + _Y + i], oz - row[at + _Z + i]
        up = dx * sx + dy * sy + dz * sz
        lift = qx * sx + qy * sy + qz * sz
        wx = dx - up * sx
        wy = dy - up * sy
        wz = dz - up * sz
        square = wx * wx + wy * wy + wz * wz
        nearest_m = -(qx * wx + qy * wy + qz * wz) / square
        px = qx - lift * sx + nearest_m * wx
        py = qy - lift * sy + nearest_m * wy
        pz = qz - lift * sz + nearest_m * wz
        margin_m = spread * abs(nearest_m) + aside_m
        within_m = row[at + _REACH + i] + margin_m
        # Intervals along the pulse and along the axis in which the pulse is within this distance of the axis.
        around_m = within_m / square
        height_m = lift + nearest_m * up
        over_m = around_m * abs(up) + within_m
        is_close = (px * px + py * py + pz * pz <= within_m * within_m) & (
            (height_m + over_m >= row[at + _LOW + i]) & (height_m - over_m <= row[at + _HIGH + i])
        )
        is_close &= (nearest_m + around_m >= near_m) & (nearest_m - around_m <= last_m)
        is_close |= square < f4(1e-3)  # nearly along the axis: rounding is large
        close |= np.uint64(is_close) << np.uint64(i)
    return close


@inline_kernel
def meet_stem(stems: Stems, pulse: Pulse, stem: int) -> bool:
    """Intersect the lanes with a stem: a cone with its bend and width at the height of the hit."""
    axis = pulse.axis
    s = stems.line[stem]
    profile = stems.profile[stem]
    sx = s[3]
    sy = s[4]
    sz = s[5]
    up = axis[3] * sx + axis[4] * sy + axis[5] * sz
    wx = axis[3] - up * sx
    wy = axis[4] - up * sy
    wz = axis[5] - up * sz
    square = wx * wx + wy * wy + wz * wz
    if square < 1e-9:
        return False
    # Range and height at which the centre ray is nearest to the axis, and the squared distance there.
    q = axis[0] - s[0], axis[1] - s[1], axis[2] - s[2]
    nearest_m, height_m, off2 = _nearest(q, (sx, sy, sz), (wx, wy, wz), up, square)
    margin_m = pulse.spread * abs(nearest_m) + pulse.aside_m
    within_m = s[6] + s[7] + margin_m
    if off2 > within_m * within_m:
        return False
    # The same for the bent axis at that height; what moves may bend so far that the height there is another.
    for _ in range(2 if stems.top_m.shape[0] else 1):
        bent_x, bent_y = _bend(stems, pulse, stem, height_m)
        from_bent = q[0] - bent_x, q[1] - bent_y, q[2]
        nearest_m, height_m, off2 = _nearest(from_bent, (sx, sy, sz), (wx, wy, wz), up, square)
    widest_m = profile[2, _knot(profile, height_m - margin_m - s[6] * abs(up))]
    within_m = widest_m + margin_m
    if off2 > within_m * within_m:
        return False
    # The local cone of the stem where the centre ray meets it; the beam is narrow enough to stay on it.
    knot = _knot(profile, height_m - up * math.sqrt(max(widest_m * widest_m - off2, 0.0) / square))
    taper = (profile[1, knot + 1] - profile[1, knot]) / (profile[0, knot + 1] - profile[0, knot])
    cone = (
        (f4(s[0] + bent_x + height_m * sx), f4(s[1] + bent_y + height_m * sy), f4(s[2] + height_m * sz)),
        (f4(sx), f4(sy), f4(sz)),
        f4(nearest_m),
        f4(height_m),
        f4(profile[1, knot] + taper * (height_m - profile[0, knot])),
        taper,
    )
    if pulse.n == 1:
        _cut_cone(pulse.lanes.row, 1, *cone)
    else:
        _cut_cone(pulse.lanes.row, LANES, *cone)
    return _keep_nearest(stems, pulse, stem)


@inline_kernel
def _bend(stems: Stems, pulse: Pulse, stem: int, height_m: float) -> tuple[float, float]:
    """Return the offset in x and y of a stem's section from the axis, at the time of the pulse."""
    profile = stems.profile[stem]
    knot = _knot(profile, height_m)
    part = (height_m - profile[0, knot]) / (profile[0, knot + 1] - profile[0, knot])
    part = min(max(part, 0.0), 1.0)
    x_m = profile[3, knot] + part * (profile[3, knot + 1] - profile[3, knot])
    y_m = profile[4, knot] + part * (profile[4, knot + 1] - profile[4, knot])
    if stems.top_m.shape[0]:
        share = stems.share[stem, knot] + part * (stems.share[stem, knot + 1] - stems.share[stem, knot])
        time, since = knot_at(stems.top_m.shape[0], pulse.axis[AXES_TIME])
        before_m = stems.top_m[time, stem]
        after_m = stems.top_m[time + 1, stem]
        x_m += share * (before_m[0] + since * (after_m[0] - before_m[0]))
        y_m += share * (before_m[1] + since * (after_m[1] - before_m[1]))
    return x_m, y_m


@inline_kernel
def _nearest(
    q: tuple[float, float, float],
    s: tuple[float, float, float],
    w: tuple[float, float, float],
    up: float,
    square: float,
) -> tuple[float, float, float]:
    """Return range, height along the axis and squared distance where ray and axis are nearest.

    The ray's direction is `up` along the axis and `w` across it; `square` is the squared length of `w`.
    """
    lift = q[0] * s[0] + q[1] * s[1] + q[2] * s[2]
    nearest_m = -(q[0] * w[0] + q[1] * w[1] + q[2] * w[2]) / square
    px = q[0] - lift * s[0] + nearest_m * w[0]
    py = q[1] - lift * s[1] + nearest_m * w[1]
    pz = q[2] - lift * s[2] + nearest_m * w[2]
    return nearest_m, lift + nearest_m * up, px * px + py * py + pz * pz


@inline_kernel
def _keep_nearest(stems: Stems, pulse: Pulse, stem: int) -> bool:
    """Keep hits of a stem's cone that are nearest and within the stem; return True if there is any."""
    L = pulse.lanes
    near_m = pulse.near_m
    met = False
    row = L.row
    flare_m = stems.flare_m[stem]
    along_m = stems.profile[stem, 0]
    for lane in range(pulse.n):
        at_m = row[AT + lane]
        height_m = row[HEIGHT + lane]
        if near_m <= at_m < row[RANGE + lane] and along_m[0] <= height_m <= along_m[-1]:
            row[COSINE + lane] = row[FACING + lane]
            row[RANGE + lane] = at_m
            L.surface[lane] = stems.surface[stem, 0 if height_m < flare_m else 1]
            met = True
    return met


@inline_kernel
def _cut_cone(
    row: F4,
    lanes: int,
    middle_m: tuple[np.float32, np.float32, np.float32],
    axis: tuple[np.float32, np.float32, np.float32],
    from_m: np.float32,
    height_m: np.float32,
    radius_m: np.float32,
    taper: np.float32,
) -> None:
    """Intersect lanes with a cone, relative to its circle's centre; `from_m` is the range there."""
    sx, sy, sz = axis
    for lane in range(lanes):
        dx, dy, dz = (row[DIRECTION + lane], row[DIRECTION + LANES + lane], row[DIRECTION + 2 * LANES + lane])
        x = row[ORIGIN + lane] + from_m * dx - middle_m[0]
        y = row[ORIGIN + LANES + lane] + from_m * dy - middle_m[1]
        z = row[ORIGIN + 2 * LANES + lane] + from_m * dz - middle_m[2]
        lift = x * sx + y * sy + z * sz
        up = dx * sx + dy * sy + dz * sz
        x, y, z = x - lift * sx, y - lift * sy, z - lift * sz
        dx, dy, dz = dx - up * sx, dy - up * sy, dz - up * sz
        # Linear change of the radius along the ray; solve for where its square equals the squared distance
        # from the axis.
        begin_m = radius_m + taper * lift
        change = taper * up
        along = x * dx + y * dy + z * dz
        square = dx * dx + dy * dy + dz * dz
        a, b = square - change * change, begin_m * change - along
        inside = b * b - a * (x * x + y * y + z * z - begin_m * begin_m)
        on_m = (b - np.sqrt(max(inside, f4(0.0)))) / a
        there_m = begin_m + change * on_m
        met = (inside > f4(0.0)) & (a > f4(0.0)) & (there_m > f4(0.0))
        row[AT + lane] = from_m + on_m if met else f4(np.inf)
        row[HEIGHT + lane] = height_m + lift + up * on_m
        row[FACING + lane] = min(max(-(along + square * on_m) / there_m, f4(0.0)), f4(1.0))


@inline_kernel
def _knot(profile: F4, height_m: float) -> int:
    """Find the knot of a profile at or below a height, at least the first and at most the last but one."""
    knot = 0
    at_m = f4(height_m)
    for i in range(1, profile.shape[1] - 1):
        knot += profile[0, i] <= at_m
    return knot
