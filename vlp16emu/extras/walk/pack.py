"""A pack that hangs on the trunk by its straps: exact response to the trunk's motion.

The trunk's motion u is by definition the quintic spline through its samples at knots 5 ms apart. Each axis
of the pack swings about it: x'' + 2 z w (x' - u') + w^2 (x - u) = 0. In the stretch y = x - u of the straps
this is y'' + 2 z w y' + w^2 y = -u'', and -u'' is a cubic between knots. Its exact response is a linear map
of the state at the knot and the cubic's four coefficients, computed once. So there is no step size, and a
strap of 1 GHz costs as much and is as exact as a strap of 1 Hz.
"""

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from vlp16emu.elementary import matmul, matvec
from vlp16emu.errors import TrajectoryError
from vlp16emu.extras.walk.gait import AXES
from vlp16emu.extras.walk.settings import Harness, Mast
from vlp16emu.kernels.compiler import array_kernel
from vlp16emu.motion.piecewise import derivatives
from vlp16emu.types import F8

KNOTS_PER_S = 200
"""The spline follows heel strikes, which last 40 ms, to 1 % of their depth, and all else to a nanometre."""
NODES_PER_KNOT = 5  # instants per knot at which the pack's motion is returned: one per millisecond
_REACH = 4  # samples needed before the first knot and after the last one of a second
_FORGOTTEN = 39.14394658089878
"""Logarithm of 1e17. A swing that has decayed by this factor is below its last bit."""
_LONGEST_S = 600
"""Straps that swing longer than this after a push are refused: the gait would drive them without bound."""
_QUASI = np.array([13.0, -112.0, 438.0, -112.0, 13.0]) / 240.0
"""Filter from samples to spline coefficients, with which the spline reproduces every quintic."""
_QUINTIC = (
    np.array(
        [
            [1.0, 26.0, 66.0, 26.0, 1.0, 0.0],
            [-5.0, -50.0, 0.0, 50.0, 5.0, 0.0],
            [10.0, 20.0, -60.0, 20.0, 10.0, 0.0],
            [-10.0, 20.0, 0.0, -20.0, 10.0, 0.0],
            [5.0, -20.0, 30.0, -20.0, 5.0, 0.0],
            [-1.0, 5.0, -10.0, 10.0, -5.0, 1.0],
        ]
    )
    / 120.0
)
"""Uniform quintic B-spline (de Boor, A Practical Guide to Splines, chapter IX): row p gives the coefficient
of tau^p between two knots from the six spline coefficients around."""
_SHORT = 3  # halvings of a time until less than an eighth of a radian passes in it
_TERMS = 14  # of the series, whose fourteenth term is below the last bit in such a time


class Pack:
    """Motion of the pack about the smooth path: the trunk's motion, filtered by the straps if there are any.

    Raises TrajectoryError if the pack would swing for more than ten minutes after a push.

    Parameters
    ----------
    trunk : samples (n, 6) of the trunk's motion at knots first .. first + n - 1, knot 0 at the first step
    harness : None if the pack is strapped tight
    """

    def __init__(self, trunk: Callable[[int, int], F8], harness: Harness | Mast | None) -> None:
        self._trunk = trunk
        self._harness = harness
        if harness is None:
            return
        frequency_hz = harness.frequency_hz
        z = harness.damping_ratio
        slowest = min(decay_per_s(hz, z) for hz in frequency_hz)
        if slowest * _LONGEST_S < _FORGOTTEN:
            swing = f"swings for {_FORGOTTEN / slowest:.0f} s after a push" if slowest else "swings for ever"
            raise TrajectoryError("harness", swing, f"at most {_LONGEST_S} s: more damping or stiffer straps")
        self._memory_s = math.ceil(_FORGOTTEN / slowest)
        offsets_s = np.arange(1, NODES_PER_KNOT + 1) / (NODES_PER_KNOT * KNOTS_PER_S)
        # (6, 5, 2, 6): by axis and node, the map from stretch and rate at the knot, and the forcing, to
        # stretch and rate.
        self._steps = np.array([[response(hz, z, s) for s in offsets_s] for hz in frequency_hz])
        # (6, 2, 2): free swing over a second.
        self._second = np.array([response(hz, z, 1.0)[:, :2] for hz in frequency_hz])
        omega = 2.0 * math.pi * np.array(frequency_hz)
        self._stiffness = omega * omega
        self._drag = 2.0 * z * omega
        self._pushed = lru_cache(self._memory_s + 8)(self._push)

    def nodes(self, second: int) -> F8:
        """Return displacement, velocity and acceleration (1001, 6, 3) at a second's nodes, ends included.

        The second of the first step is 0. The result does not depend on earlier calls.
        """
        pieces = self._pieces(second)
        node = np.arange(NODES_PER_KNOT * KNOTS_PER_S + 1)
        k = np.minimum(node // NODES_PER_KNOT, KNOTS_PER_S - 1)  # the last node ends the last piece
        since_s = (node - k * NODES_PER_KNOT) * (1.0 / (NODES_PER_KNOT * KNOTS_PER_S))
        out = derivatives(pieces, k, since_s)
        if self._harness is not None:
            _swing(pieces, self._steps, self._state(second), self._stiffness, self._drag, out)
        return out

    def _pieces(self, second: int) -> F8:
        """Return quintics (200, 6, 6) of the trunk's motion by seconds from each knot, lowest power first."""
        samples = self._trunk(second * KNOTS_PER_S - _REACH, KNOTS_PER_S + 2 * _REACH + 1)
        n = KNOTS_PER_S
        spline = sum(share * samples[j : j + n + 5] for j, share in enumerate(_QUASI))
        powers = [sum(share * spline[j : j + n] for j, share in enumerate(row)) for row in _QUINTIC]
        return np.stack([KNOTS_PER_S**power * each for power, each in enumerate(powers)], axis=-1)

    def _state(self, second: int) -> F8:
        """Return the stretch and its rate (6, 2) at the start of a second, at rest until the first step.

        It is the sum of the responses to each second within memory, so it does not depend on where a run
        begins.
        """
        state = np.zeros((AXES, 2))
        first = max(0, second - self._memory_s)  # older swings have decayed below the last bit
        for past in range(first, second):
            state = matvec(self._second, state) + self._pushed(past)
        return state

    def _push(self, second: int) -> F8:
        """Return the stretch and its rate (6, 2) that a second leaves behind, from rest at its start."""
        state = np.zeros((AXES, 2))
        out = np.zeros((KNOTS_PER_S + 1, AXES, 3))
        per_knot = np.ascontiguousarray(self._steps[:, -1:])  # from knot to knot
        _swing(self._pieces(second), per_knot, state, self._stiffness, self._drag, out)
        return state


@array_kernel
def _stretch(step: F8, state: F8, a: F8, row: int) -> float:
    """Return the stretch (row 0) or its rate (row 1) a step after a state, under -u'' of the piece a."""
    forced = (
        step[row, 2] * a[2] * 2
        + step[row, 3] * a[3] * 6
        + step[row, 4] * a[4] * 12
        + step[row, 5] * a[5] * 20
    )
    return step[row, 0] * state[0] + step[row, 1] * state[1] - forced


@array_kernel
def _swing(pieces: F8, steps: F8, state: F8, stiffness: F8, drag: F8, out: F8) -> None:
    """Add the stretch to the trunk's motion (m, 6, 3) at nodes, and advance its state to the last."""
    per_knot = steps.shape[1]
    for axis in range(AXES):
        for n in range(len(out)):
            y, v = state[axis]
            if n:
                k, j = (n - 1) // per_knot, (n - 1) % per_knot
                y = _stretch(steps[axis, j], state[axis], pieces[k, axis], 0)
                v = _stretch(steps[axis, j], state[axis], pieces[k, axis], 1)
                if j == per_knot - 1:
                    state[axis, 0] = y
                    state[axis, 1] = v
            pull = out[n, axis, 2]
            out[n, axis, 0] += y
            out[n, axis, 1] += v
            out[n, axis, 2] += -pull - drag[axis] * v - stiffness[axis] * y


def decay_per_s(frequency_hz: float, damping_ratio: float) -> float:
    """Return the rate, per second, at which the slowest part of a free swing decays."""
    omega = 2.0 * math.pi * frequency_hz
    z = damping_ratio
    return z * omega if z < 1.0 else omega / (z + math.sqrt((z - 1.0) * (z + 1.0)))


def response(frequency_hz: float, damping_ratio: float, s: float) -> F8:
    """Return the linear map (2, 6) from (y, y', f0 to f3) at 0 to (y, y') after s seconds; f = sum of fi t^i.

    It is the matrix exponential of the oscillator and its forcing: a power series over a short time, doubled
    until the time is s (Moler and Van Loan, "Nineteen dubious ways to compute the exponential of a matrix",
    SIAM Review 45, 2003, method 3).
    """
    omega = 2.0 * math.pi * frequency_hz
    system = np.zeros((6, 6))
    system[0, 1] = omega  # rates in units of omega, so that stiff straps lose no digits
    system[1, :3] = -omega, -2.0 * damping_ratio * omega, 1.0 / omega
    for i in range(3):
        system[2 + i, 3 + i] = 1.0 + i
    doublings = max(0, math.frexp(max(1.0, 2.0 * damping_ratio) * omega * s)[1] + _SHORT)
    step = system * (s / 2.0**doublings)
    term = np.eye(6)
    total = np.eye(6)
    for n in range(1, _TERMS):
        term = matmul(term, step) / n
        total = total + term
    for _ in range(doublings):
        total = matmul(total, total)
    total[1] *= omega
    total[:, 1] /= omega
    return total[:2]
