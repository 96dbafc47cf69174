"""Records that a real unit loses, and what it sends in place of a range.

The receiver sets its power by the pulse before (on the HDL-32E one of 11 powers: its software version 2.0). So a record is lost where the
light of a laser steps up, for it is then too strong, or down; where one pulse meets two surfaces; and now and then where it is dark. The
laws are those of mrpt, einride, nebula and the unit of 2014, whose records between equal ranges, or at a step of range, are there
or not; how units differ is the span of these four.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import power
from vlp16emu.random import Purpose, uniform, uniform_pair
from vlp16emu.returns.settings import LossRates
from vlp16emu.trig import ZERO
from vlp16emu.types import F4, F8, U1, U4

_LOSS, _EDGE = ZERO + Purpose.LOSS, ZERO + Purpose.NO_RETURN
# Of pulses that meet two surfaces, half of the light each: 8 to 29 % of records at a step of 0.3 to 1.4 m on real units; up and down by
# 100 codes: 1.2 to 5.2 % at 20 codes or more on one surface; of black pulses nearer than 4 m: 0.2 to 1.2 % at codes 1 to 3; of all: 0.03 to
# 0.12 % at codes from 50 on; and the code of a return beside which half of the no-returns are raised.
_SPANS = (0.2, 0.6), (0.25, 2.0), (0.01, 0.2), (0.003, 0.03), (0.0002, 0.001), (35.0, 120.0)
_STEP_M = 0.25
"""Difference of ranges from which on two surfaces of one pulse are a step: 0 to 12 % of records are lost at 0.12 to 0.2 m."""
_BLACK, _NEAR_M = 9.0, 4.0
"""Code at which the loss of dark records ends, and range beyond which it falls."""
_ODD_ALONE, _EVEN_ALONE = 0.33, 0.37
"""Of dual return: lost in the odd block alone are 0.46 % of the records of nebula, in the even one 0.05 %, in both 0.9 %."""
_REACH, _ON = 3, 0.4
"""Most no-returns in a row that are raised beside a return, and the share of those that go on: 56 to 78 % are alone on real units."""
_UNEQUAL = 0.03
"""Share of raised pairs of dual return in which only one block is raised: 0.065 % of all pairs without range."""
_NEARLY_WHITE, _FULL = 80.0, 255.0
"""Code from which on too much light shows as more than 100, and the greatest there is."""


def loss_rates(seed: int, share: float, *, raised: bool) -> LossRates:
    """Draw the rates of a unit, evenly in their logarithm.

    Parameters
    ----------
    share : of the records that real units lose
    raised : whether no-returns beside returns are raised
    """
    drawn = uniform(seed, Purpose.LOSS, 0, len(_SPANS), 1 << 16).tolist()
    *rates, code = (low * power(high / low, z) for (low, high), z in zip(_SPANS, drawn, strict=True))
    return LossRates._make([*(share * rate for rate in rates), code if raised else 0.0])


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False, forceinline=True)
def two_surfaces(
    range_m: F4, met: U4, cosine: F4, reflectance: F4, smooth: NDArray[np.bool_], start: int, stop: int
) -> float:
    """Return the share of the light of sub-rays start .. stop - 1 from another surface than that of the brightest, a step away.

    One surface without gaps, such as the ground (`smooth`, by surface), has no step however slanted it is.
    """
    most = at_m = total = other = 0.0
    surface = met[start]
    for ray in range(np.uint64(start), np.uint64(stop)):  # signed indices might count from the end
        if range_m[ray] < np.inf:
            light = np.float64(reflectance[met[ray]]) * cosine[ray] / (np.float64(range_m[ray]) * range_m[ray])
            if light > most:
                most, at_m, surface = light, np.float64(range_m[ray]), met[ray]
    for ray in range(np.uint64(start), np.uint64(stop)):
        if range_m[ray] < np.inf:
            light = np.float64(reflectance[met[ray]]) * cosine[ray] / (np.float64(range_m[ray]) * range_m[ray])
            total += light
            if abs(range_m[ray] - at_m) > _STEP_M and (met[ray] != surface or not smooth[surface]):
                other += light
    return other / total if total > 0.0 else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False, forceinline=True)
def lose(
    rates: LossRates,
    key: tuple[int, int, int],
    share: float,
    before: F8,
    no_return: float,
    dual: bool,
    distance_m: F4,
    reflectivity: U1,
) -> None:
    """Take away the returns (3,) of a pulse that is lost, and note the code of the pulse for the next one of its laser.

    Parameters
    ----------
    key : seed of the unit, firing sequence and laser
    share : of the light from another surface
    before : (L,) codes of the pulses before, -1 for none
    no_return : code of a record without range
    """
    seed, n, laser = key
    if distance_m[0] <= 0.0:
        before[laser] = -1.0
        return
    code = min(np.float64(reflectivity[0]), 100.0)
    rise = 0.01 * (code - before[laser]) if before[laser] >= 0.0 else 0.0
    before[laser] = code
    jump = (rates.up if rise > 0.0 else rates.down) * rise * rise
    black, near = max(0.0, 1.0 - code / _BLACK), min(1.0, _NEAR_M / distance_m[0])
    lost, how = uniform_pair(seed, _LOSS, n, laser)
    if lost >= jump + rates.any + rates.step * 4.0 * share * (1.0 - share) + rates.dark * black * near * near:
        return
    if dual and how < _EVEN_ALONE and lost >= jump:
        column = 1 if how >= _ODD_ALONE else 2 if distance_m[0] == distance_m[1] and distance_m[2] > 0.0 else 0
        distance_m[column], reflectivity[column] = 0.0, np.uint8(no_return)
        return
    shown = 0.0
    if lost < jump and rise > 0.0:  # too bright: the height of the peak is seen, its place is not
        shown = np.float64(reflectivity[0]) * (0.7 + 1.6 * how)
        shown = _multiple(min(shown, 100.0 if code < _NEARLY_WHITE else _FULL), no_return)
    for column in range(3):
        distance_m[column], reflectivity[column] = 0.0, np.uint8(shown if column < 2 else 0.0)


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False, forceinline=True)
def _multiple(code: float, no_return: float) -> float:
    """Return the code of a no-return nearest to one: a whole multiple of that of its laser."""
    return min(np.floor(np.rint(code / no_return) * no_return), _FULL) if no_return > 0.0 else code


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False, forceinline=True)
def raised(
    rates: LossRates,
    key: tuple[int, int, int],
    rows: tuple[int, int, int],
    no_return: float,
    distance_m: F4,
    reflectivity: U1,
) -> tuple[float, bool]:
    """Return the code of a no-return that a return beside it raises, 0 for none, and whether in dual return one block has it alone.

    Parameters
    ----------
    key : seed of the unit, firing sequence of row 0, and laser
    rows : the record, and the first and the one past the last row that may be looked at
    distance_m, reflectivity : (k, L, 3)
    """
    (seed, first, laser), (row, begin, stop) = key, rows
    most, alone = 0.0, False
    for side in range(2):
        share = 1.0
        for away in range(1, _REACH + 1):
            at = row - away if side == 0 else row + away
            if at < begin or at >= stop:
                break
            column = 0 if distance_m[at, laser, 0] > 0.0 else 1
            if distance_m[at, laser, column] > 0.0:
                code = np.float64(reflectivity[at, laser, column])
                y = code / rates.raise_code
                y *= np.sqrt(y)
                drawn, how = uniform_pair(seed, _EDGE, first + at, laser | (side + 2) << 12)
                if drawn < share * y / (1.0 + y):
                    power6 = how * how * how
                    ratio = (0.3 + 0.95 * how + 1.6 * power6 * power6) * (1.0 if away == 1 else 0.7)
                    most = max(most, code * ratio, 2.0 * no_return)
                    alone = (64.0 * how) % 1.0 < _UNEQUAL
                break
            share *= _ON
    return _multiple(most, no_return) if most > 0.0 else 0.0, alone
