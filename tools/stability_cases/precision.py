"""Functions and sums at their limits: elementary functions, angles of kernels, gusts after days."""

import math
from collections.abc import Callable, Iterator

import numpy as np
from mpmath import mp, mpf

from stability_cases.case import Row, case
from vlp16emu import elementary
from vlp16emu.forest.settings import Wind
from vlp16emu.forest.stand.wind import ALONG, Lines, Trees, gust_lines, swings
from vlp16emu.rotation import rotations

_TINY = 2.0**-1022
_NEAR_ONE = [1.0 - 2.0**-k for k in range(1, 54)]
_SMALL = [2.0**-k for k in range(1, 1075, 13)]  # to the smallest subnormal
_RIGHT_ANGLES = [float(k) * math.pi / 2 for k in (1, 2, 3, 1001, 10**6, 10**8, 267_000_001)]
_ANGLES = [*_SMALL, *_RIGHT_ANGLES, 3.0e8, 4.1e8, 22.0, 355.0, 710.0, 103_993.0]
_ARGUMENTS: dict[str, tuple[list[float], float]] = {
    # arguments, and the error in units in the last place that the function states
    "sin": (_ANGLES, 1.6),
    "cos": (_ANGLES, 1.6),
    "tan": (_ANGLES, 3.5),
    "asin": ([*_SMALL, *_NEAR_ONE, 1.0], 2.5),
    "acos": ([*_SMALL, *_NEAR_ONE], 2.5),
    "exp": ([-745.0, -720.5, -708.4, -1e-300, 1e-17, 709.7, *_SMALL], 1.0),
    "expm1": ([-745.0, -40.0, -1.0, 0.999999, 1.0, 700.0, *_SMALL], 3.0),
    "log": ([*_SMALL, *_NEAR_ONE, 1.0 + 2.0**-52, 1.7e308, _TINY], 1.0),
    "log1p": ([*_SMALL, *[-x for x in _NEAR_ONE], 1e15, 1e300], 2.0),
    "tanh": ([*_SMALL, 0.3, 18.0, 22.0, 700.0], 4.5),
}
_NEXT_TO = 2.0**-52


def _ulps(found: float, true: mpf) -> float:
    """Return the error in units in the last place of the true value."""
    return abs(float((mpf(found) - true) / math.ulp(float(true))))


@case("mpmath, 340 digits")
def elementary_functions() -> Iterator[Row]:
    """Functions beside zeros and poles, of subnormal numbers, at right angles to 4e8 rad, before overflow."""
    with mp.workdps(340):
        for name, (arguments, bound) in _ARGUMENTS.items():
            beside = [a * (1 + _NEXT_TO) for a in arguments if abs(a) != 1.0 and abs(a) < 1e308]
            x = np.array([*arguments, *beside])
            if name in ("asin", "acos", "log1p"):
                x = x[np.abs(x) <= 1.0] if name != "log1p" else x[x > -1.0]
            found = getattr(elementary, name)(x)
            exact: Callable[[mpf], mpf] = getattr(mp, name)
            worst = max(_ulps(y, exact(mpf(a))) for a, y in zip(x.tolist(), found.tolist(), strict=True))
            yield Row(f"{name}, ulp", worst, bound)
        y, x = np.meshgrid([1e-300, 1e-5, 1.0, 1e5, 1e300, -1e-300], [1e-300, -1.0, 1.0, -1e300])
        found = elementary.atan2(y.ravel(), x.ravel()).tolist()
        pairs = zip(y.ravel().tolist(), x.ravel().tolist(), found, strict=True)
        # What underflows has no unit in the last place to count in.
        worst = max(_ulps(z, mp.atan2(mpf(a), mpf(b))) for a, b, z in pairs if abs(z) > _TINY)
        yield Row("atan2, ulp", worst, 1.5)


@case("mpmath, 40 digits")
def angles_of_poses() -> Iterator[Row]:
    """Headings up to a million radians, as after 160 000 laps, with a pitch of 90 degrees."""
    headings = np.array([0.0, math.pi, 1e3 + 1e-9, 123_456.789, 1e6])
    pitch = math.pi / 2
    found = rotations(headings, pitch, 0.3)
    with mp.workdps(40):
        worst = 0.0
        for heading, turn in zip(headings.tolist(), found, strict=True):
            cy, sy = mp.cos(mpf(heading)), mp.sin(mpf(heading))
            cp, sp = mp.cos(mpf(pitch)), mp.sin(mpf(pitch))
            cr, sr = mp.cos(mpf(0.3)), mp.sin(mpf(0.3))
            exact = [
                [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
                [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
                [-sp, cp * sr, cp * cr],
            ]
            off = [abs(float(exact[i][j] - mpf(float(turn[i, j])))) for i in range(3) for j in range(3)]
            worst = max(worst, *off)
        yield Row("rotation", worst, 1e-15)


def _exact_swing(lines: Lines, speed_m_s: float, trees: Trees, tree: int, t_s: float) -> float:
    """Return the response of one tree at one time, a sum of steady-state responses with 40 digits."""
    total = mpf(0)
    w = mpf(float(trees.omega_rad_s[tree]))
    z = mpf(trees.damping_ratio)
    downwind = mpf(float(trees.downwind_m[tree]))
    aside = mpf(float(trees.aside_m[tree]))
    for omega, speed, phase, across in zip(*(of.tolist() for of in lines), strict=True):
        s = mp.mpc(0, omega)
        answer = w * w / (s * s + 2 * z * w * s + w * w)
        travel_s = mpf(t_s) - downwind / mpf(speed_m_s)
        turn = mpf(omega) * travel_s + mpf(phase) + mpf(across) * aside
        total += mpf(speed) * (answer * mp.expj(turn)).real
    return float(total)


@case("mpmath, 40 digits: the transfer function of each line")
def gusts_after_days() -> Iterator[Row]:
    """Gusts of 256 frequencies, at once and after seven days, on trees of 0.01 to 1000 Hz, 1e6 m downwind."""
    at_s = np.array([0.0, 1.0, 36_000.25, 604_800.0])
    omega = 2 * np.pi * np.array([0.01, 0.25, 1000.0])
    trees = Trees(omega, 0.02, np.array([0.0, -3.0, 1e6]), np.array([0.0, 20.0, -1e6]))
    for section in (Wind(speed_m_s=0.1, gust_length_m=500.0), Wind(speed_m_s=12.0)):
        name = f"{section.speed_m_s:g} m/s"
        lines = gust_lines(section, 1, ALONG)
        found = swings(lines, section.speed_m_s, trees, at_s)
        with mp.workdps(40):
            for tree, place in enumerate(("0.01 Hz", "0.25 Hz", "1000 Hz, 1e6 m away")):
                exact = [_exact_swing(lines, section.speed_m_s, trees, tree, t) for t in at_s.tolist()]
                # The phase of a gust of 5 Hz 1e6 m away at 0.1 m/s has a step of 6e-8 rad in float64.
                bound = 1e-6 if tree == 2 else 1e-8
                off = float(np.abs(found[:, tree] - exact).max())
                yield Row(f"{name}, tree of {place}: response over the speed", off / section.speed_m_s, bound)
