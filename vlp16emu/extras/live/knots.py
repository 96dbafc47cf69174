"""A trajectory of knots that grows at its end: each knot has a pose and its rates, and decides no more than the pieces beside it."""

import math

import numpy as np

from vlp16emu.elementary import atan2, exp
from vlp16emu.extras.recorded.motion import Pieces
from vlp16emu.kernels.compiler import numba
from vlp16emu.trig import cos_sin
from vlp16emu.types import F8
from vlp16emu.units import S_NS

STEP_NS = 5_308_416  # from knot to knot: 96 firing sequences of a VLP-16, four packets of single return
STATE = 13
"""Numbers of a knot: position (3,) and quaternion x, y, z, w (4,) in the world, velocity (3,) in the world, angular rate
(3,) in body axes."""

_MOST = 8192  # knots of a live run that are kept, 43 s; nobody asks for poses that are older than 12 s
_COAST_S = 0.15
"""For how long after a pose the body is taken to go on as it did, and then the time constant with which it comes to
rest: poses at 10 Hz are followed without a hitch, and 3 m/s end after 0.9 m."""
GAP_M, GAP_RAD = 0.1, 0.2  # off by more than that, the body is led back more slowly, with a speed that stays bounded
_SMALL = 1e-6  # angle in rad, below which series are exact to float64


class Knots(Pieces):
    """Poses between two knots or more: cubic Hermite pieces of position and quaternion, with velocity and rate without jumps.

    Parameters
    ----------
    start_ns : UTC of the first knot
    states : (n, 13) the first knots, at least one
    """

    def __init__(self, start_ns: int, states: F8) -> None:
        self._first = self._count = 0
        room = max(_MOST, len(states))
        self._knots_ns = np.arange(room, dtype=np.int64) * STEP_NS
        self._states, self._pieces = np.empty((room, STATE)), np.empty((4, room, 7))
        super().__init__(start_ns, self._knots_ns[:0], self._pieces)
        self.last_state = states[0]  # (13,)
        for state in states:
            self.append(state)

    @property
    def last(self) -> int:
        """Number of the last knot, from 0."""
        return self._first + self._count - 1

    @property
    def last_ns(self) -> int:
        """Time of the last knot since the first one."""
        return self.last * STEP_NS

    def states(self, first: int, stop: int) -> F8:
        """Knots (n, 13) from number `first` until before `stop`, not older than 20 s."""
        return self._states[first - self._first : stop - self._first]

    def append(self, state: F8) -> None:
        """Add a knot (13,), a step after the last one."""
        if self._count == len(self._states):  # drop the older half, in new arrays: others may be reading these
            half = self._count // 2
            self._first, self._count = self._first + half, self._count - half
            self._knots_ns = self._knots_ns + half * STEP_NS
            self._states, self._pieces = np.roll(self._states, -half, 0), np.roll(self._pieces, -half, 1)
        if self._count:
            _fill_piece(self._states[self._count - 1], state, STEP_NS / S_NS, self._pieces[:, self._count - 1])
        self._states[self._count] = self.last_state = state
        self._count += 1
        # In one piece, as other threads read it.
        self._arrays = self._knots_ns[: self._count], self._pieces


@numba.njit(cache=True, nogil=True)
def _product(a: F8, b: F8) -> F8:
    """Multiply two quaternions x, y, z, w."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    x = aw * bx + ax * bw + ay * bz - az * by
    y = aw * by - ax * bz + ay * bw + az * bx
    z = aw * bz + ax * by - ay * bx + az * bw
    return np.array([x, y, z, aw * bw - ax * bx - ay * by - az * bz])


@numba.njit(cache=True, nogil=True)
def _fill_piece(begin: F8, end: F8, step_s: float, out: F8) -> None:
    """Fill powers of the time into a piece (4, 7), highest first, from the knots (13,) at both ends."""
    value, rate = np.empty((2, 7)), np.empty((2, 7))
    turning = np.zeros(4)
    for side, knot in enumerate((begin, end)):
        value[side] = knot[:7]
        rate[side, :3] = knot[7:10]
        turning[:3] = 0.5 * knot[10:]
        rate[side, 3:] = _product(knot[3:7], turning)
    if (value[0, 3:] * value[1, 3:]).sum() < 0.0:
        value[1, 3:], rate[1, 3:] = -value[1, 3:], -rate[1, 3:]
    for a in range(7):
        slope = (value[1, a] - value[0, a]) / step_s
        out[0, a] = (rate[0, a] + rate[1, a] - 2.0 * slope) / (step_s * step_s)
        out[1, a] = (3.0 * slope - 2.0 * rate[0, a] - rate[1, a]) / step_s
        out[2, a], out[3, a] = rate[0, a], value[0, a]


@numba.njit(cache=True, nogil=True)
def _exp(vector: F8) -> F8:
    """Return the quaternion of a rotation vector (3,)."""
    angle = math.sqrt((vector * vector).sum())
    cosine, sine = cos_sin(0.5 * angle)
    share = 0.5 - angle * angle / 48.0 if angle < _SMALL else sine / angle
    return np.append(share * vector, cosine)


@numba.njit(cache=True, nogil=True)
def turn_between(old: F8, new: F8) -> F8:
    """Rotation vector (3,), in body axes, from one quaternion (4,) to another, the short way round."""
    q = _product(np.append(-old[:3], old[3]), new)
    sine = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
    sign = -1.0 if q[3] < 0.0 else 1.0
    angle = 2.0 * atan2(sine, abs(q[3]))
    return q[:3] * (sign * (2.0 if sine < _SMALL else angle / sine))


@numba.njit(cache=True, nogil=True)
def _cross(a: F8, b: F8) -> F8:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@numba.njit(cache=True, nogil=True)
def _turned_back(by: F8, vector: F8) -> F8:
    """Apply the inverse of the rotation by a vector (3,) to a vector (3,)."""
    angle = math.sqrt((by * by).sum())
    if angle < _SMALL:
        return vector - _cross(by, vector)
    across, (cosine, sine) = _cross(by, vector), cos_sin(angle)
    return vector - sine / angle * across + (1.0 - cosine) / (angle * angle) * _cross(by, across)


@numba.njit(cache=True, nogil=True)
def _rate_of(phi: F8, change: F8) -> F8:
    """Body rate (3,) of exp(phi) from the change of phi: the right Jacobian (Sola et al., arXiv:1812.01537, eq. 143)."""
    angle = math.sqrt((phi * phi).sum())
    across = _cross(phi, change)
    if angle < 1e-4:
        return change - 0.5 * across + _cross(phi, across) / 6.0
    cosine, sine = cos_sin(angle)
    far = (angle - sine) / (angle * angle * angle)
    return change - (1.0 - cosine) / (angle * angle) * across + far * _cross(phi, across)


@numba.njit(cache=True, nogil=True)
def _change_of(phi: F8, rate: F8) -> F8:
    """Change of phi from the body rate (3,) of exp(phi): the inverse of `_rate_of` (eq. 144)."""
    angle = math.sqrt((phi * phi).sum())
    across = _cross(phi, rate)
    cosine, sine = cos_sin(0.5 * angle)
    share = 1.0 / 12.0 if angle < 1e-4 else (1.0 - 0.5 * angle * cosine / sine) / (angle * angle)
    return rate + 0.5 * across + share * _cross(phi, across)


@numba.njit(cache=True, nogil=True)
def _coast(since_s: float) -> tuple[float, float]:
    """Seconds of motion at the speed of the last pose, and share of that speed, some time after it."""
    late_s = since_s - _COAST_S
    if late_s <= 0.0:
        return since_s, 1.0
    left = exp(-late_s / _COAST_S)
    return _COAST_S + _COAST_S * (1.0 - left), left


@numba.njit(cache=True, nogil=True)
def _settle(error: F8, change: F8, per_s: float, step_s: float) -> tuple[F8, F8]:
    """Solve e'' + 2 w e' + w^2 e = 0, critically damped, over a step: the error (3,) and its change."""
    push = change + per_s * error
    fade = exp(-per_s * step_s)
    return (error + push * step_s) * fade, (change - per_s * push * step_s) * fade


@numba.njit(cache=True, nogil=True)
def follow(state: F8, seen: F8, since_s: float, step_s: float, smoothing_s: float) -> F8:
    """Return the next knot (13,): predicted from the last pose, and corrected towards it without a jump of pose or rate.

    The last pose goes on as it did, and comes to rest where no other follows. What the body is off from it dies away as a
    critically damped oscillator, which is solved exactly over the step.

    Parameters
    ----------
    state : (13,) the knot before
    seen : (13,) the last pose with its rates
    since_s : time from that pose to the knot before
    step_s : from knot to knot
    smoothing_s : time constant of the correction
    """
    (begin_s, begin), (end_s, end) = _coast(since_s), _coast(since_s + step_s)
    error, change = state[:3] - seen[:3] - begin_s * seen[7:10], state[7:10] - begin * seen[7:10]
    off = math.sqrt((error * error).sum()) / GAP_M
    error, change = _settle(error, change, 1.0 / (smoothing_s * max(1.0, off)), step_s)
    out = np.empty(STATE)
    out[:3], out[7:10] = seen[:3] + end_s * seen[7:10] + error, end * seen[7:10] + change
    phi = turn_between(_product(seen[3:7], _exp(begin_s * seen[10:])), state[3:7])
    change = _change_of(phi, state[10:] - _turned_back(phi, begin * seen[10:]))
    off = math.sqrt((phi * phi).sum()) / GAP_RAD
    phi, change = _settle(phi, change, 1.0 / (smoothing_s * max(1.0, off)), step_s)
    both = _product(_product(seen[3:7], _exp(end_s * seen[10:])), _exp(phi))
    out[3:7] = both / math.sqrt((both * both).sum())
    out[10:] = _rate_of(phi, change) + _turned_back(phi, end * seen[10:])
    return out
