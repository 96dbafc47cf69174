"""Records that a real unit loses, and what it sends instead of a range.

The receiver sets the laser power from previous pulses: one of 8 levels on the HDL-64E S3, whose manual
recommends full power for last returns ("Laser Output Power Level Management"), one of 11 on the HDL-32E
(software version 2.0). Thus a record is lost if the light of a laser steps up from its average, because it is
then too strong, or down. A pulse that hits two surfaces gives the strongest or the last return as the manual
says, and rarely nothing; and a dark record is lost occasionally. The laws are fitted to mrpt, einride, nebula
and the unit of 2014, by which records between returns are missing; the spread over units is the span of these
four.

Where the ranges of neighbours differ by more than 0.1 m on either side, as in trees at 35 to 48 m in front of
the unit of 2014 and in the
clutter of offices, these units lose 0.02 to 0.08 of the records; a step between two smooth surfaces of
similar brightness loses 0.05 to
0.14, and a step of brightness by a factor of 8 or more up to 0.95.
"""

import numpy as np

from vlp16emu.elementary import power
from vlp16emu.kernels.compiler import inline_kernel
from vlp16emu.random import Purpose, uniform, uniform_pair
from vlp16emu.returns.echoes import SubRays
from vlp16emu.returns.settings import LossRates
from vlp16emu.trig import ZERO
from vlp16emu.types import F4, F8, U1, U4

_EDGE = ZERO + Purpose.NO_RETURN
_SPANS = (0.12, 0.5), (0.06, 1.0), (0.2, 1.0), (0.005, 0.025), (0.0004, 0.0025), (35.0, 120.0), (0.5, 0.9)
"""Spans of the rates over units, in the order of `LossRates`: pulses that hit two surfaces with half of the
light each; large steps up; large
steps down; black pulses nearer than 4 m: 1.1 % at codes 0 and 1, 0.2 to 1.1 % at 1 to 3, 0.4 to 2.9 % at 3 to
6, 0.1 to 0.4 % at 6 to 10; all
pulses: 0.03 to 0.12 % at codes from 50; the code of a return near which half of the no-returns are raised;
and steps up by 100 codes, for any
factor. Measured losses on one surface, up by factors of 2 to 4, 4 to 8 and 8 to 16 of code: einride 0.013,
0.22, 0.68; mrpt 0.022, 0.019,
0.036; nebula 0.005, 0.007, 0.028; down by 4 to 8, 8 to 16 and 16 to 32: einride 0.06, 0.15, 0.42; nebula
0.03, 0.06, 0.18; mrpt 0.05, 0.21
for the first two. By height, at factors below 4: up by 20 to 30, 30 to 45 and more codes 0.007, 0.029 and
0.070 on mrpt, 0.009, 0.004 and
0.008 on nebula, 2 of 49, 1 of 19 and 0 of 12 on the unit of 2014, and with factors below 3 on einride 0.001,
0 and 0.016. Units are drawn like
mrpt and 2014; on einride and nebula a step by texture alone loses less."""
_UP_AT = 0.7
_DOWN_AT = 30.0
"""With x = half the factor minus one: x**4 for steps up, x**2 for steps down, at which half of the rate is
reached. At an edge the code changes over two or three pulses (beam of 12.7 mm and 3 mrad, 3.5 mrad from pulse
to pulse), so its factor between two pulses is less than across the edge: einride's 0.04, 0.41 and 0.81 across
the edge become 0.09, 0.37 and 0.84 by this law."""
_FLOOR = 1.0
_POWER_GAIN = 0.5
"""Code that is added to both sides of a factor, as codes are integers; and the share of a step that the power
follows in one pulse (assumption: two pulses in a row are lost a fifth as often as one, at steps on
einride)."""
_ROUGH_M = 0.1
_MOST_ROUGH_M = 1.0
"""Mean change of range from pulse to pulse at which steps lose half as many records, and the largest change
that counts."""
_STEP_M = 0.25
"""Least difference of ranges of two surfaces in one pulse that is a step: 0.3 to 1.2 % of records are lost at
0.04 to 0.3 m and similar codes."""
# code at which the loss of dark records ends, and range beyond which it decreases
_BLACK = 14.0
_NEAR_M = 4.0
_ODD_ALONE = 0.33
_EVEN_ALONE = 0.37
"""Dual return: nebula loses 0.46 % of the records in the odd block only, 0.05 % in the even block only, 0.9 %
in both."""
_REACH = 3
_CONTINUES = 0.4
"""Most consecutive no-returns that are raised next to a return, and the share that continue to the next: 56
to 78 % are single on real units."""
_PLACE_SEQUENCES = 8
_SHARED_LANE = 1 << 12
"""Firing sequences of one place, and the lane of the random number that all lasers share there: for two
neighbouring lasers, both next to a return, raised no-returns correlate by 0.50, 0.72, 0.39 and 0.66 (mrpt,
einride, nebula, 2014)."""
_TWICE = 12.0
"""Code of a return next to which half of the raised no-returns are twice the code of their laser: 0.63, 0.14,
0.38 and 0.47 at codes 15 to 40,
0.25, 0.06, 0.11 and 0.07 at 40 to 100 (the same units)."""
_UNEQUAL_AT = 212.0
_SECOND_SHARE = 1.1
"""Code at which all records of dual return that are too bright would differ between blocks, and the code of
the last return over that of the strongest, plus one step: of nebula's raised records between two returns,
0.03 of 203 below 60, 0.21 of 62 below 100 and 0.36 of 22 above are unequal, the last one always higher; of
those that follow a return without another behind, 0 of 237, 2 of 116 and 6 of 12; elsewhere 1 of 53 000."""
_DIFFUSE = 100.0
_FULL = 255.0
_GLARE = 0.2
_GLARE_BESIDE = 0.0079
"""Largest code of a matt surface, largest of all, and shares of lost records above the first: of those too
bright on a retroreflector (24 of 25
beside codes above 100 on mrpt, 3 of 20 on the others), and of no-returns with a return on one side only,
whatever its code: 0.0128, 0.0113,
0.0042 and 0.0133 on mrpt, einride, nebula and 2014. Lost records between two returns exceed 100 at glossy
places, which no scene of ours has."""
_DIGITS = 1048576.0
"""Scale of a normal number; the fraction behind its first 20 binary digits is uniform, and has no visible
effect on the value."""
_ANEW = 64.0  # the fraction of a uniform number times this is uniform too, and as good as independent


def loss_rates(seed: int, share: float, *, raised: bool) -> LossRates:
    """Draw the rates of a unit, uniform in their logarithm.

    Parameters
    ----------
    share : factor on the rates of real units
    raised : True if no-returns next to returns are raised
    """
    drawn = uniform(seed, Purpose.LOSS, 0, len(_SPANS), 1 << 16).tolist()
    *rates, code, bright = (low * power(high / low, z) for (low, high), z in zip(_SPANS, drawn, strict=True))
    return LossRates._make([*(share * rate for rate in rates), code if raised else 0.0, share * bright])


@inline_kernel
def two_surfaces(rays: SubRays, sheet: U4, start: int, stop: int) -> float:
    """Return the share of the light of sub-rays start .. stop - 1 that is a range step away from the brightest sub-ray.

    A sheet without gaps, such as the ground (`sheet`, by surface; 0 for none), has no step at any slope.
    """
    _, range_m, met, cosine, reflectance = rays
    most = at_m = total = other = 0.0
    surface = met[start]
    for ray in range(np.uint64(start), np.uint64(stop)):  # signed indices might count from the end
        if range_m[ray] < np.inf:
            light = (
                np.float64(reflectance[met[ray]]) * cosine[ray] / (np.float64(range_m[ray]) * range_m[ray])
            )
            if light > most:
                most = light
                at_m = np.float64(range_m[ray])
                surface = met[ray]
    if most == 0.0:  # an echo of the air alone has no surface
        return 0.0
    own = sheet[surface]
    for ray in range(np.uint64(start), np.uint64(stop)):
        if range_m[ray] < np.inf:
            light = (
                np.float64(reflectance[met[ray]]) * cosine[ray] / (np.float64(range_m[ray]) * range_m[ray])
            )
            total += light
            if abs(range_m[ray] - at_m) > _STEP_M and (own == 0 or sheet[met[ray]] != own):
                other += light
    return other / total if total > 0.0 else 0.0


@inline_kernel
def _fraction(x: float) -> float:
    return x - np.floor(x)


@inline_kernel
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
    """Remove the returns (3,) of a pulse if it is lost, and update the averages of its laser.

    Parameters
    ----------
    noise : normal numbers of the pulse, whose last digits decide
    pulse : its sub-rays, as in `two_surfaces`
    before : (3, L) state of each laser: mean code, -1 for none, last range, and mean change of range
    no_return : code of a record without range
    """
    if distance_m[0] <= 0.0:
        before[0, laser] = -1.0
        return
    code = min(np.float64(reflectivity[0]), 100.0)
    level = before[0, laser]
    range_m = np.float64(distance_m[0])
    calm = _ROUGH_M / (
        _ROUGH_M + before[2, laser]
    )  # where ranges jump, as in trees, steps lose fewer records
    change_m = min(abs(range_m - before[1, laser]), _MOST_ROUGH_M)
    before[2, laser] += _POWER_GAIN * (change_m - before[2, laser])
    before[1, laser] = range_m
    before[0, laser] = code if level < 0.0 else level + _POWER_GAIN * (code - level)
    jump = 0.0
    is_up = code > level
    if level >= 0.0:
        y = (
            0.5 * (code + _FLOOR) / (level + _FLOOR) - 1.0
            if is_up
            else 0.5 * (level + _FLOOR) / (code + _FLOOR) - 1.0
        )
        y = max(y, 0.0) * max(y, 0.0)
        jump = rates.up * y * y / (y * y + _UP_AT) if is_up else rates.down * y / (y + _DOWN_AT)
        if is_up:
            jump += rates.bright * (0.01 * (code - level)) * (0.01 * (code - level))
        jump *= calm
    black = max(0.0, 1.0 - code / _BLACK)
    near = min(1.0, _NEAR_M / range_m)
    sure = jump + rates.any + rates.dark * black * near * near
    lost = _fraction(noise[0] * _DIGITS)  # no further number is drawn
    if lost >= sure:
        if lost >= sure + calm * rates.step or pulse[3] - pulse[2] < 2:
            return
        share = two_surfaces(*pulse)
        if lost >= sure + calm * rates.step * 4.0 * share * (1.0 - share):
            return
    how = _fraction(noise[1] * _DIGITS)
    if dual and how < _EVEN_ALONE and lost >= jump:
        column = (
            1 if how >= _ODD_ALONE else 2 if distance_m[0] == distance_m[1] and distance_m[2] > 0.0 else 0
        )
        distance_m[column] = 0.0
        reflectivity[column] = np.uint8(no_return)
        return
    shown = 0.0
    if lost < jump and is_up:  # too bright: the height of the peak is measured, its range is not
        most = _FULL if reflectivity[0] > _DIFFUSE and lost < _GLARE * jump else _DIFFUSE
        shown = _multiple(np.float64(reflectivity[0]) * (0.7 + 1.6 * how), no_return, most)
    for column in range(3):
        distance_m[column] = 0.0
        reflectivity[column] = np.uint8(shown if column < 2 else 0.0)
    if shown > 0.0 and dual and np.sqrt(_fraction(_ANEW * how)) * _UNEQUAL_AT < shown:
        reflectivity[1] = np.uint8(_multiple(_SECOND_SHARE * shown + no_return, no_return, _FULL))


@inline_kernel
def _multiple(code: float, no_return: float, most: float) -> float:
    """Return the integer multiple of the laser's no-return code that is nearest to `code`, at most `most`."""
    return min(np.floor(np.rint(code / no_return) * no_return) if no_return > 0.0 else code, most)


@inline_kernel
def raised(
    rates: LossRates,
    key: tuple[int, int, int],
    rows: tuple[int, int, int],
    no_return: float,
    distance_m: F4,
    reflectivity: U1,
) -> float:
    """Return the raised code of a no-return next to a return, 0 if not raised, -1 if no return is near.

    Parameters
    ----------
    key : seed of the unit, firing sequence of row 0, and laser
    rows : row of the record, first row that may be read, and one past the last
    distance_m, reflectivity : (k, L, 3)
    """
    (seed, first, laser) = key
    (row, begin, stop) = rows
    most = -1.0
    sides = 0
    glare = 0.0
    for side in range(2):
        share = 1.0
        for away in range(1, _REACH + 1):
            at = row - away if side == 0 else row + away
            if at < begin or at >= stop:
                break
            column = 0 if distance_m[at, laser, 0] > 0.0 else 1
            if distance_m[at, laser, column] > 0.0:
                code = np.float64(reflectivity[at, laser, column])
                most = max(most, 0.0)
                y = code / rates.raise_code
                y *= np.sqrt(y)
                drawn, how = uniform_pair(seed, _EDGE, first + at, laser | (side + 2) << 12)
                of_place, _ = uniform_pair(seed, _EDGE, (first + at) // _PLACE_SEQUENCES, _SHARED_LANE)
                if of_place < share * y / (1.0 + y):
                    power6 = how * how * how
                    ratio = (0.4 + 0.95 * how + 1.6 * power6 * power6) * (1.0 if away == 1 else 0.7)
                    if drawn * (_TWICE + code) < _TWICE:
                        ratio = 0.0
                    most = max(most, code * ratio, 2.0 * no_return)
                if away == 1:
                    sides = sides + 1
                    glare = _fraction(_ANEW * how)
                break
            share *= _CONTINUES  # a farther record is raised only if the nearer one is
    if sides == 1 and glare < _GLARE_BESIDE:
        return _multiple(_DIFFUSE + (_FULL - _DIFFUSE) * glare / _GLARE_BESIDE, no_return, _FULL)
    return _multiple(most, no_return, _DIFFUSE) if most > 0.0 else most
