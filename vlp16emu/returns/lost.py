"""Records that a real unit loses, and what it sends in place of a range.

The receiver sets its power by the pulses before: one of 8 levels on the HDL-64E S3, whose manual recommends the full one for last
returns ("Laser Output Power Level Management"), of 11 on the HDL-32E (software version 2.0). So a record is lost where the light of a
laser steps up, for it is then too strong, or down, beside what it was on average. A pulse that meets two surfaces gives the strongest or
the last return as the manual says, and seldom nothing; and a dark record is lost now and then. The laws are those of mrpt, einride, nebula
and the unit of 2014, whose records between returns are there or not; how units differ is the span of these four.

Where the ranges of neighbours differ by more than 0.1 m on either side, as in trees at 35 to 48 m before the unit of 2014 and in the
clutter of offices, these lose 0.02 to 0.08 of the records; a step between two smooth surfaces of like brightness costs 0.05 to 0.14,
and one of brightness, by 8 or more, up to 0.95.
"""

import numpy as np

from vlp16emu.elementary import power
from vlp16emu.kernels.compiler import numba
from vlp16emu.random import Purpose, uniform, uniform_pair
from vlp16emu.returns.echoes import SubRays
from vlp16emu.returns.settings import LossRates
from vlp16emu.trig import ZERO
from vlp16emu.types import F4, F8, U1, U4

_EDGE = ZERO + Purpose.NO_RETURN
_SPANS = (0.12, 0.5), (0.06, 1.0), (0.2, 1.0), (0.005, 0.025), (0.0004, 0.0025), (35.0, 120.0)
"""Spans of the rates over units. Of pulses that meet two surfaces, half of the light each; up and down by far; of black pulses nearer than
4 m: 1.1 % at codes 0 and 1, 0.2 to 1.1 % at 1 to 3, 0.4 to 2.9 % at 3 to 6, 0.1 to 0.4 % at 6 to 10; of all: 0.03 to 0.12 % at codes from
50 on; and the code of a return beside which half of the no-returns are raised. On one surface, up by factors of 2 to 4, 4 to 8 and 8 to 16
of code, are lost: einride 0.013, 0.22, 0.68; mrpt 0.022, 0.019, 0.036; nebula 0.005, 0.007, 0.028; down by 4 to 8, 8 to 16 and 16 to 32:
einride 0.06, 0.15, 0.42; nebula 0.03, 0.06, 0.18; mrpt 0.05, 0.21 of the first two."""
_UP_AT, _DOWN_AT = 0.7, 30.0
"""Fourth power and square of half the factor less one at which half of that is reached. At an edge the code climbs over two or three pulses
(12.7 mm and 3 mrad of beam, 3.5 mrad from pulse to pulse), so that its factor from one to the next is less than across the edge: einride's
0.04, 0.41 and 0.81 across are 0.09, 0.37 and 0.84 by this law."""
_BRIGHT = 0.045
"""Of a step up by 100 codes, whatever the factor, on a unit that loses all that are up by far, and the more the fewer of these it loses: steps up
by 20 codes and factors below 2 cost mrpt, nebula, einride and 2014 0.017, 0.008, 0 and 0 of their records."""
_FLOOR, _SETTLES = 1.0, 0.5
"""Code that is added to both sides of a factor, as codes are whole numbers; and how much of a step the power follows in one pulse (assumption:
two pulses in a row are lost a fifth as often as one, at steps on einride)."""
_ROUGH_M, _MOST_ROUGH_M = 0.1, 1.0
"""Mean change of range from pulse to pulse at which steps cost half as many records, and the greatest that counts."""
_STEP_M = 0.25
"""Difference of ranges from which on two surfaces of one pulse are a step: 0.3 to 1.2 % of records are lost at 0.04 to 0.3 m and like codes."""
_BLACK, _NEAR_M = 14.0, 4.0  # code at which the loss of dark records ends, and range beyond which it falls
_ODD_ALONE, _EVEN_ALONE = 0.33, 0.37
"""Of dual return: lost in the odd block alone are 0.46 % of the records of nebula, in the even one 0.05 %, in both 0.9 %."""
_REACH, _ON = 3, 0.4
"""Most no-returns in a row that are raised beside a return, and the share of those that go on: 56 to 78 % are alone on real units."""
_PLACE, _OF_ALL = 8, 1 << 12
"""Firing sequences that are a place, and the lane of the chance that all lasers share there: of two lasers beside each other, both beside a
return, raised ones correlate by 0.50, 0.72, 0.39 and 0.66 (mrpt, einride, nebula, 2014)."""
_TWICE = 12.0
"""Code of a return beside which half of the raised no-returns are twice the code of their laser: 0.63, 0.14, 0.38 and 0.47 at codes 15 to 40,
0.25, 0.06, 0.11 and 0.07 at 40 to 100 (the same units)."""
_UNEQUAL = 0.03
"""Share of raised pairs of dual return in which only one block is raised: 0.065 % of all pairs without range."""
_NEARLY_WHITE, _FULL = 88.0, 255.0
"""Code from which on too much light shows as more than 100, and the greatest there is: beside returns of 60 to 90 codes over 100 are 0.39, 0.08, 0.04
and 0 of the no-returns on mrpt, einride, nebula and 2014, beside such of 90 to 100 0.67, 0.43, 0.08 and 0.07."""
_DIGITS = 1048576.0
"""Of a normal number, what is left behind its first 20 binary digits is even, and nobody sees it in what that number moves."""


def loss_rates(seed: int, share: float, *, raised: bool) -> LossRates:
    """Draw the rates of a unit, evenly in their logarithm.

    Parameters
    ----------
    share : of the records that real units lose
    raised : whether no-returns beside returns are raised
    """
    drawn = uniform(seed, Purpose.LOSS, 0, len(_SPANS), 1 << 16).tolist()
    *rates, code = (low * power(high / low, z) for (low, high), z in zip(_SPANS, drawn, strict=True))
    step, up, *others = (share * rate for rate in rates)
    return LossRates._make([step, share * _BRIGHT / rates[1], up, *others, code if raised else 0.0])


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False, forceinline=True)
def two_surfaces(rays: SubRays, sheet: U4, start: int, stop: int) -> float:
    """Return the share of the light of sub-rays start .. stop - 1 from another surface than that of the brightest, a step away.

    A sheet without gaps, such as the ground (`sheet`, by surface; 0 for none), has no step however slanted it is.
    """
    _, range_m, met, cosine, reflectance = rays
    most = at_m = total = other = 0.0
    surface = met[start]
    for ray in range(np.uint64(start), np.uint64(stop)):  # signed indices might count from the end
        if range_m[ray] < np.inf:
            light = np.float64(reflectance[met[ray]]) * cosine[ray] / (np.float64(range_m[ray]) * range_m[ray])
            if light > most:
                most, at_m, surface = light, np.float64(range_m[ray]), met[ray]
    if most == 0.0:  # an echo of the air alone: what no sub-ray has met has no number
        return 0.0
    own = sheet[surface]
    for ray in range(np.uint64(start), np.uint64(stop)):
        if range_m[ray] < np.inf:
            light = np.float64(reflectance[met[ray]]) * cosine[ray] / (np.float64(range_m[ray]) * range_m[ray])
            total += light
            if abs(range_m[ray] - at_m) > _STEP_M and (own == 0 or sheet[met[ray]] != own):
                other += light
    return other / total if total > 0.0 else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False, forceinline=True)
def lose(
    rates: LossRates,
    noise: tuple[float, float],
    pulse: tuple[SubRays, U4, int, int],
    before: F8,
    laser: int,
    no_return: float,
    dual: bool,
    distance_m: F4,
    reflectivity: U1,
) -> None:
    """Take away the returns (3,) of a pulse that is lost, and note what its laser sees on average.

    Parameters
    ----------
    noise : normal numbers of the pulse, whose last digits decide
    pulse : its sub-rays, as in `two_surfaces`
    before : (3, L) of the pulses before: mean code, -1 for none, range, and mean change of range
    no_return : code of a record without range
    """
    if distance_m[0] <= 0.0:
        before[0, laser] = -1.0
        return
    code, level, range_m = min(np.float64(reflectivity[0]), 100.0), before[0, laser], np.float64(distance_m[0])
    calm = _ROUGH_M / (_ROUGH_M + before[2, laser])  # where ranges jump, as in trees, steps cost fewer records
    change_m = min(abs(range_m - before[1, laser]), _MOST_ROUGH_M)
    before[2, laser] += _SETTLES * (change_m - before[2, laser])
    before[1, laser] = range_m
    before[0, laser] = code if level < 0.0 else level + _SETTLES * (code - level)
    jump = 0.0
    is_up = code > level
    if level >= 0.0:
        y = 0.5 * (code + _FLOOR) / (level + _FLOOR) - 1.0 if is_up else 0.5 * (level + _FLOOR) / (code + _FLOOR) - 1.0
        y = max(y, 0.0) * max(y, 0.0)
        jump = rates.up * y * y / (y * y + _UP_AT) if is_up else rates.down * y / (y + _DOWN_AT)
        if is_up:
            jump += rates.bright * (0.01 * (code - level)) * (0.01 * (code - level))
        jump *= calm
    black, near = max(0.0, 1.0 - code / _BLACK), min(1.0, _NEAR_M / range_m)
    sure = jump + rates.any + rates.dark * black * near * near
    lost = noise[0] * _DIGITS - np.floor(noise[0] * _DIGITS)  # no further number is drawn
    if lost >= sure:
        if lost >= sure + calm * rates.step or pulse[3] - pulse[2] < 2:
            return
        share = two_surfaces(*pulse)
        if lost >= sure + calm * rates.step * 4.0 * share * (1.0 - share):
            return
    how = noise[1] * _DIGITS - np.floor(noise[1] * _DIGITS)
    if dual and how < _EVEN_ALONE and lost >= jump:
        column = 1 if how >= _ODD_ALONE else 2 if distance_m[0] == distance_m[1] and distance_m[2] > 0.0 else 0
        distance_m[column], reflectivity[column] = 0.0, np.uint8(no_return)
        return
    shown = 0.0
    if lost < jump and is_up:  # too bright: the height of the peak is seen, its place is not
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
    """Return the code of a no-return that a return beside it raises, 0 for none and -1 where no return is near.

    And whether in dual return one block has it alone.

    Parameters
    ----------
    key : seed of the unit, firing sequence of row 0, and laser
    rows : the record, and the first and the one past the last row that may be looked at
    distance_m, reflectivity : (k, L, 3)
    """
    (seed, first, laser), (row, begin, stop) = key, rows
    most, alone = -1.0, False
    for side in range(2):
        share = 1.0
        for away in range(1, _REACH + 1):
            at = row - away if side == 0 else row + away
            if at < begin or at >= stop:
                break
            column = 0 if distance_m[at, laser, 0] > 0.0 else 1
            if distance_m[at, laser, column] > 0.0:
                code, most = np.float64(reflectivity[at, laser, column]), max(most, 0.0)
                y = code / rates.raise_code
                y *= np.sqrt(y)
                drawn, how = uniform_pair(seed, _EDGE, first + at, laser | (side + 2) << 12)
                of_place, _ = uniform_pair(seed, _EDGE, (first + at) // _PLACE, _OF_ALL)
                if of_place < share * y / (1.0 + y):
                    power6 = how * how * how
                    ratio = (0.4 + 0.95 * how + 1.6 * power6 * power6) * (1.0 if away == 1 else 0.7)
                    if drawn * (_TWICE + code) < _TWICE:
                        ratio = 0.0
                    most = max(most, code * ratio, 2.0 * no_return)
                    alone = (64.0 * how) % 1.0 < _UNEQUAL
                break
            share *= _ON  # what is farther off is raised only behind one that is
    return _multiple(most, no_return) if most > 0.0 else most, alone
