"""Straps from slack to rigid: a stiff oscillator, driven by the steps of the person who carries it."""

from collections.abc import Iterator
from functools import partial

import numpy as np
from mpmath import expm, matrix, mp, mpf, pi

from stability_cases.case import Row, case, refusal
from vlp16emu.extras.walk.pack import KNOTS_PER_S, Pack, decay_per_s, response
from vlp16emu.extras.walk.settings import Harness
from vlp16emu.types import F8

_STEP_HZ = 1.8
_SWAY_M = 0.02
_FORGET = 39.15  # logarithm of 1e17, to which the start must have decayed
_LONGEST_S = 600  # straps that remember longer are refused
_NODES_S = np.arange(1001) / 1000
DAMPINGS = 0.001, 0.01, 0.1, 1.0, 10.0


def harness(hz: float, damping: float) -> Harness:
    """Return straps with one frequency on all axes."""
    axes = ("fore_aft_hz", "sideways_hz", "vertical_hz", "roll_hz", "pitch_hz", "yaw_hz")
    return Harness(**dict.fromkeys(axes, hz), damping_ratio=damping)


def _sway(first: int, count: int) -> F8:
    """Sine on all axes from knot 0 on."""
    t_s = np.maximum(np.arange(first, first + count), 0) / KNOTS_PER_S
    return np.repeat((_SWAY_M * np.sin(2 * np.pi * _STEP_HZ * t_s))[:, None], 6, axis=1)


def slackest_hz(damping: float) -> float:
    """Return the least frequency, at least 0.5 Hz, whose swing is forgotten within ten minutes."""
    return max(0.5, 1.0001 * _FORGET / _LONGEST_S / decay_per_s(1.0, damping))


def sway_errors(hz: float, damping: float, at_s: int = _LONGEST_S) -> tuple[float, float]:
    """Return the largest errors of sway, in m, and of its rate, in m/s, against the transfer function."""
    s = 2j * np.pi * _STEP_HZ
    w = 2 * np.pi * hz
    answer = (2 * damping * w * s + w * w) / (s * s + 2 * damping * w * s + w * w)
    nodes = Pack(_sway, harness(hz, damping)).nodes(at_s)[:, 0]
    # Whole turns of a step rate of 1.8 Hz after multiples of 5 s, so no digits are lost to the time.
    exact = [_SWAY_M * np.imag(answer * s**d * np.exp(s * (at_s % 5 + _NODES_S))) for d in range(2)]
    return float(np.abs(nodes[:, 0] - exact[0]).max()), float(np.abs(nodes[:, 1] - exact[1]).max())


def _sway_rows(frequencies: int) -> Iterator[Row]:
    for damping in DAMPINGS:
        slackest = slackest_hz(damping)
        errors = [sway_errors(hz, damping) for hz in np.geomspace(slackest, 1e9, frequencies)]
        worst_m, worst_m_s = np.max(errors, axis=0)
        # Light damping amplifies what the spline of the drive is off.
        amplified = max(1.0, 0.1 / damping)
        name = f"damping {damping:g}, from {slackest:.3g} Hz"
        yield Row(f"{name}: sway, m", float(worst_m), 1e-10 * amplified)
        yield Row(f"{name}: rate, m/s", float(worst_m_s), 1e-9 * amplified)


@case("closed form: the transfer function")
def stiff_straps() -> Iterator[Row]:
    """Straps of 0.5 Hz to 1 GHz, whose stiffness spans 18 decades, with 0.001 to 10 of critical damping."""
    yield from _sway_rows(4)
    for hz, damping, says in ((0.5, 0.001, "more damping"), (2.0, 0.0, "swings for ever")):
        name = f"a harness of {hz:g} Hz with damping {damping:g}"
        yield refusal(name, partial(Pack, _sway, harness(hz, damping)), says)


@case("closed form: the transfer function", is_slow=True)
def stiff_straps_in_steps() -> Iterator[Row]:
    """The same straps at 28 frequencies for each damping."""
    yield from _sway_rows(28)


def _exact_response(hz: float, damping: float, time_s: float) -> F8:
    """Return what `response` computes, the exponential of a matrix, with enough digits."""
    with mp.workdps(60 + int(2 * np.log10(hz + 1))):
        omega = 2 * pi * mpf(hz)
        system = matrix(6, 6)
        system[0, 1] = 1
        system[1, 0], system[1, 1], system[1, 2] = -omega * omega, -2 * mpf(damping) * omega, 1
        for i in range(3):
            system[2 + i, 3 + i] = 1 + i
        whole = expm(system * mpf(time_s))
        return np.array([[float(whole[i, j]) for j in range(6)] for i in range(2)])


@case("mpmath, 60 digits: the exponential of the matrix")
def strap_response() -> Iterator[Row]:
    """One step of 1 and 5 ms and of 1 s of straps that swing up to 1e6 times within it, with any damping."""
    for time_s in (0.001, 0.005, 1.0):
        worst = 0.0
        for damping in (0.001, 1.0, 10.0):
            for hz in (0.5, 30.0, 1e4, 1e6):
                omega = 2 * np.pi * hz
                # Stretch and rate in units that a unit push gives them.
                scale = np.array([[1, 1 / omega, *4 * [1 / omega**2]], [omega, 1, *4 * [1 / omega]]])
                off = np.abs(response(hz, damping, time_s) - _exact_response(hz, damping, time_s)) / scale
                # The matrix is squared that often: each time its error doubles.
                worst = max(worst, float(off.max() / max(1.0, 2 * damping) / max(1.0, omega * time_s)))
        yield Row(f"{time_s:g} s: stretch and rate, relative, over the system's norm", worst, 1e-14)
