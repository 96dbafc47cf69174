"""A trajectory that grows at its end, knot by knot; a knot (pose and rates) sets only adjacent pieces."""

import math

import numpy as np

from vlp16emu.elementary import atan2, exp
from vlp16emu.engine.windows import STEP_NS
from vlp16emu.kernels.compiler import array_kernel
from vlp16emu.motion.piecewise import POWERS, KnotMotion
from vlp16emu.trig import cos_sin
from vlp16emu.types import F8
from vlp16emu.units import S_NS

STATE = 13
"""Numbers of a knot: position (3,) and quaternion x, y, z, w (4,) in the world, velocity (3,) in the world,
angular rate (3,) in body axes."""

_KEPT_NS = 44 * S_NS
"""Time over which the knots of a live run are kept; the older half goes at once. Poses older than 12 s are
never requested."""
_MOST = _KEPT_NS // STEP_NS  # knots that are kept
_COAST_S = 0.15
"""Time after a pose for which its velocity is extrapolated, and then the time constant with which the body
comes to rest: poses at 10 Hz are followed smoothly, and a body at 3 m/s stops after 0.9 m."""
# above these errors the correction is slower, with bounded speed
GAP_M = 0.1
GAP_RAD = 0.2
_SMALL = 1e-6  # angle in rad below which series are exact to float64


class Knots(KnotMotion):
    """Cubic Hermite motion between knots, with continuous velocity and angular rate.

    Parameters
    ----------
    start_ns : UTC of the first knot
    states : (n, 13) the first knots, at least one
    """

    def __init__(self, start_ns: int, states: F8) -> None:
        self._first = self._count = 0
        room = max(_MOST, len(states))
        self._knots_ns = np.arange(room, dtype=np.int64) * STEP_NS
        self._states = np.empty((room, STATE))
        self._pieces = np.zeros((room, 7, POWERS))
        super().__init__(start_ns, self._knots_ns[:0], self._pieces)
        self.last_state = states[0]  # (13,)
        for state in states:
            self.append(state)

    @property
    def last(self) -> int:
        """Index of the last knot."""
        return self._first + self._count - 1

    @property
    def last_ns(self) -> int:
        """Time of the last knot since the first one, in nanoseconds."""
        return self.last * STEP_NS

    def states(self, first: int, stop: int) -> F8:
        """Return knots (n, 13) from index `first` to before `stop`, not older than 20 s."""
        return self._states[first - self._first : stop - self._first]

    def append(self, state: F8) -> None:
        """Append a knot (13,), one step after the last one."""
        if self._count == len(self._states):
            # Drop the older half, in new arrays: other threads may be reading these.
            half = self._count // 2
            self._first = self._first + half
            self._count = self._count - half
            self._knots_ns = self._knots_ns + half * STEP_NS
            self._states = np.roll(self._states, -half, 0)
            self._pieces = np.roll(self._pieces, -half, 0)
        if self._count:
            _fill_piece(self._states[self._count - 1], state, STEP_NS / S_NS, self._pieces[self._count - 1])
        self._states[self._count] = self.last_state = state
        self._count += 1
        # One assignment, because other threads read it.
        self._arrays = self._knots_ns[: self._count], self._pieces


@array_kernel
def _product(a: F8, b: F8) -> F8:
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    x = aw * bx + ax * bw + ay * bz - az * by
    y = aw * by - ax * bz + ay * bw + az * bx
    z = aw * bz + ax * by - ay * bx + az * bw
    return np.array([x, y, z, aw * bw - ax * bx - ay * by - az * bz])


@array_kernel
def _dot(a: F8, b: F8, first: int, stop: int) -> float:
    total = 0.0
    for n in range(first, stop):
        total += a[n] * b[n]
    return total


@array_kernel
def _pose_and_rates(knot: F8) -> tuple[F8, F8]:
    """Position and quaternion (7,) of a knot, and their change per second."""
    value = np.empty(7)
    rate = np.empty(7)
    turning = np.zeros(4)
    for a in range(7):  # operations on whole arrays compile for seconds
        value[a] = knot[a]
    for a in range(3):
        rate[a] = knot[7 + a]
        turning[a] = 0.5 * knot[10 + a]
    change = _product(knot[3:7], turning)
    for a in range(4):
        rate[3 + a] = change[a]
    return value, rate


@array_kernel
def _fill_piece(begin: F8, end: F8, step_s: float, out: F8) -> None:
    """Fill powers of the time into a piece (7, 6), lowest first, from the knots (13,) at both ends."""
    (value, rate) = _pose_and_rates(begin)
    (end_value, end_rate) = _pose_and_rates(end)
    if _dot(value, end_value, 3, 7) < 0.0:
        for a in range(3, 7):
            end_value[a] = -end_value[a]
            end_rate[a] = -end_rate[a]
    for a in range(7):
        slope = (end_value[a] - value[a]) / step_s
        out[a, 0] = value[a]
        out[a, 1] = rate[a]
        out[a, 2] = (3.0 * slope - 2.0 * rate[a] - end_rate[a]) / step_s
        out[a, 3] = (rate[a] + end_rate[a] - 2.0 * slope) / (step_s * step_s)


@array_kernel
def turn_between(old: F8, new: F8) -> F8:
    """Return the shortest rotation vector (3,), in body axes, from one quaternion (4,) to another."""
    q = _product(np.array([-old[0], -old[1], -old[2], old[3]]), new)
    sine = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
    sign = -1.0 if q[3] < 0.0 else 1.0
    angle = 2.0 * atan2(sine, abs(q[3]))
    scale = sign * (2.0 if sine < _SMALL else angle / sine)
    return np.array([q[0] * scale, q[1] * scale, q[2] * scale])


@array_kernel
def _extrapolate(seen: F8, since_s: float) -> F8:
    """Extrapolate a pose (13,) in time: with constant rates at first, then gradually to rest."""
    moving_s = since_s
    share = 1.0
    late_s = since_s - _COAST_S
    if late_s > 0.0:
        share = exp(-late_s / _COAST_S)
        moving_s = _COAST_S + _COAST_S * (1.0 - share)
    out = np.empty(STATE)
    turn = np.zeros(4)
    square = 0.0
    for a in range(3):
        out[a] = seen[a] + moving_s * seen[7 + a]
        turn[a] = moving_s * seen[10 + a]
        square += turn[a] * turn[a]
    angle = math.sqrt(square)
    turn[3], sine = cos_sin(0.5 * angle)
    scale = 0.5 - angle * angle / 48.0 if angle < _SMALL else sine / angle
    for a in range(3):
        turn[a] *= scale
    turned = _product(seen[3:7], turn)
    for a in range(4):
        out[3 + a] = turned[a]
    for a in range(7, STATE):
        out[a] = share * seen[a]
    return out


@array_kernel
def follow(state: F8, seen: F8, since_s: float, step_s: float, smoothing_s: float) -> F8:
    """Return the next knot (13,), which approaches the extrapolated pose without a jump of pose or rate.

    The error of position and quaternion against the prediction decays as a critically damped oscillator,
    which is solved exactly over the step; then the quaternion is scaled to unit length.

    Parameters
    ----------
    state : (13,) the knot before
    seen : (13,) the last pose with its rates
    since_s : time from that pose to the knot before
    step_s : time between knots
    smoothing_s : time constant of the correction
    """
    value, rate = _pose_and_rates(state)
    wanted, wanted_rate = _pose_and_rates(_extrapolate(seen, since_s))
    target, target_rate = _pose_and_rates(_extrapolate(seen, since_s + step_s))
    sign = 1.0 if _dot(value, wanted, 3, 7) >= 0.0 else -1.0
    error = np.empty(7)
    change = np.empty(7)
    for a in range(7):
        flip = sign if a > 2 else 1.0
        error[a] = flip * value[a] - wanted[a]
        change[a] = flip * rate[a] - wanted_rate[a]
    off_m = math.sqrt(_dot(error, error, 0, 3))
    off_rad = 2.0 * math.sqrt(_dot(error, error, 3, 7))
    # e'' + 2 w e' + w^2 e = 0
    for a in range(7):
        per_s = 1.0 / (smoothing_s * max(1.0, off_m / GAP_M if a < 3 else off_rad / GAP_RAD))
        push = change[a] + per_s * error[a]
        fade = exp(-per_s * step_s)
        target[a] += (error[a] + push * step_s) * fade
        target_rate[a] += (change[a] - per_s * push * step_s) * fade
    length = math.sqrt(_dot(target, target, 3, 7))
    out = np.empty(STATE)
    back = np.empty(4)
    for a in range(3):
        out[a] = target[a]
        out[7 + a] = target_rate[a]
    for a in range(3, 7):
        out[a] = target[a] / length
        back[a - 3] = out[a] if a == 6 else -out[a]
    # The rate of the unit quaternion in body axes; its last component changes only the length.
    turning = _product(back, target_rate[3:])
    for a in range(3):
        out[10 + a] = 2.0 / length * turning[a]
    return out
