"""Records that a real unit loses, and the codes that it sends instead of a range.

The receiver sets the laser power from previous pulses, so a record is lost at a step of brightness. A pulse
that hits two surfaces gives the strongest or the last return as the manual says, and rarely nothing; a dark
record is lost occasionally. What a sensor at rest loses at a step it loses in each revolution, about as wide
as a record. Where a surface is dark, near, or changes its brightness, it has spots: places at
which a laser loses its records in each revolution, in runs, with other spots beside them. On calm surfaces
with codes of 20 and more, from 1 m on, nothing is lost. Rates and their sources are the laws `loss`, `spot`
and `raised` of `vlp16emu/sensor/laws.toml`.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vlp16emu.elementary import exp, power
from vlp16emu.kernels.compiler import inline_kernel, kernel
from vlp16emu.random import Purpose, normal, uniform, uniform_pair
from vlp16emu.returns.echoes import SubRays
from vlp16emu.returns.settings import LossRates, Noise
from vlp16emu.sensor.laws import law, span
from vlp16emu.trig import ZERO, fold
from vlp16emu.types import F4, F8, NO_SURFACE, U1, U4

STATE = 11
MEAN_CODE, _RANGE_M, _ROUGH, _CHANGE, _WAS_LOST, UNEVENNESS, _CODE, AREA, _AREA_V, _AREA_W, _AREA_DRAWN = (
    range(STATE)
)
"""Columns of the state of a laser, as in `lose`; range noise follows the unevenness."""
_EDGE = ZERO + Purpose.NO_RETURN
_SPOT = ZERO + Purpose.LOSS_SPOT
# Steps of brightness, and of range.
_UP_HALF = law("loss.up_half")
_DOWN_HALF = law("loss.down_half")
_FLOOR_CODE = law("loss.floor_code")
_STEP_FROM = law("loss.step_from")
_POWER_GAIN = law("loss.power_gain")
_ROUGH_GAIN = law("loss.rough_gain")
_ROUGH_M = law("loss.rough_m")
_MOST_ROUGH_M = law("loss.most_rough_m")
_RANGE_STEP_M = law("loss.range_step_m")
_LEAST_STEP_M = law("loss.least_step_m")
_BLACK_CODE = law("loss.black_code")
_NEAR_M = law("loss.near_m")
_ODD_ALONE = law("loss.odd_alone")
_EITHER_ALONE = law("loss.either_alone")

_NOISE_GAIN = law("range.change_gain")
_MOST_CHANGE = law("range.most_change")

# Spots of surfaces.
_BRIGHT_CODE = law("spot.bright_code")
_CALM_FROM_M = law("spot.calm_from_m")
_UNEVEN_FROM = law("spot.uneven_from")
_SPOT_RAD = law("spot.least_rad")
_SPOTS_ACROSS_BITS = int(law("spot.across_bits"))
_DENSITY = law("spot.density")
_NEAREST_SPOT_M = 0.5  # range below which spots no longer become smaller: no unit has a return there
_MANTISSA = (1 << 52) - 1
_CELLS_PER_M = law("loss.views_per_m")
_PRIMES = np.array(
    [0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0xD6E8FEB86659FD93], np.uint64
)
_MIX = np.array([0xBF58476D1CE4E5B9, 0x94D049BB133111EB], np.uint64)
"""Odd multipliers of a cell's number, and those that mix its bits: the finaliser of splitmix64 (Steele, Lea
and Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014)."""
_LASER_BITS = 24  # bits of a cell's number beside which the laser is written

# Raised codes of records without a range.
_REACH = int(law("raised.reach"))
_CONTINUES = law("raised.continues")
_PLACE_SEQUENCES = int(law("raised.place_sequences"))
_TWICE_CODE = law("raised.twice_code")
_UNEQUAL_CODE = law("raised.unequal_code")
_LAST_FACTOR = law("raised.last_factor")
_GLARE = law("raised.glare")
_GLARE_DARK, _GLARE_PER_CODE, _GLARE_BRIGHT = span("raised.glare_beside")

_DIFFUSE = 100.0  # largest code of a matt surface
_FULL = 255.0
_SHARED_LANE = 1 << 12  # lane of the random number that all lasers share at one place
_DIGITS = 1048576.0
"""Scale of a normal number; the fraction behind its first 20 binary digits is uniform, and has no visible
effect on the value."""
_ANEW = 64.0  # the fraction of a uniform number times this is uniform too, and as good as independent


class Sight(NamedTuple):
    """Origins and directions (k, L, 3) of pulses, as in `Firings`."""

    origin_m: F8
    direction: F8


_OF_SPOTS = ("dark", "gloss")  # rates that belong to spots


def near_rates(seed: int, lasers: int, noise: Noise) -> F8:
    """Draw the share of records (lasers,) that each laser of a unit loses nearer than `spot.calm_from_m`."""
    drawn = float(uniform(seed, Purpose.LOSS_SPOT, 0, 1, 1 << 16)[0])
    of_unit = _between(span("spot.near"), _of_unit(noise, drawn))
    spread = law("spot.near_lasers")
    of_laser = exp(spread * normal(seed, Purpose.LOSS_SPOT, 1, lasers, 1 << 16) - 0.5 * spread * spread)
    return np.asarray(noise.in_spots * of_unit * of_laser)


def loss_rates(seed: int, noise: Noise) -> LossRates:
    """Draw the rates of a unit, uniform in their logarithm; those of a median unit without a spread."""
    draws = uniform(seed, Purpose.LOSS, 0, len(LossRates._fields), 1 << 16).tolist()
    rates = {}
    for name, draw in zip(LossRates._fields, draws, strict=True):
        factor = noise.in_spots if name in _OF_SPOTS else noise.records_lost
        if name == "raise_code":  # 0: no-returns next to returns are as others
            factor = float(noise.records_lost > 0.0 and noise.no_return_reflectivity)
        rates[name] = factor * _between(span(f"loss.{name}"), _of_unit(noise, draw))
    return LossRates(**rates)


def _of_unit(noise: Noise, draw: float) -> float:
    """Return a number that is drawn for a unit, or that of a median unit."""
    return draw if noise.unit_spread > 0.0 else 0.5


def _between(limits: Sequence[float], draw: float) -> float:
    """Return the value between two limits at a uniform number, by the logarithm."""
    low, high = limits
    return float(low * power(high / low, draw))


@inline_kernel
def step_share(rays: SubRays, sheet: U4, start: int, stop: int, blank_m: float) -> float:
    """Return the rate of loss of a pulse that meets a step of range, over the greatest one.

    With half of its light from each of two surfaces it is 1, and 4 s (1 - s) with the share s from the
    fainter one; less, in proportion, where their ranges differ by less than `loss.range_step_m`. Sub-rays are
    start .. stop - 1. A sheet without gaps, such as the ground (`sheet`, by surface; 0 for none), has no step
    at any slope. What is nearer than `blank_m` gives no light.
    """
    _, range_m, met, cosine, reflectance = rays
    if _is_one_surface(rays, sheet, start, stop):
        return 0.0
    brightest = at_m = total = beyond_step = weighted = 0.0
    surface = met[start]
    for ray in range(np.uint64(start), np.uint64(stop)):
        if blank_m <= range_m[ray] < np.inf:
            light = (
                np.float64(reflectance[met[ray]]) * cosine[ray] / (np.float64(range_m[ray]) * range_m[ray])
            )
            if light > brightest:
                brightest = light
                at_m = np.float64(range_m[ray])
                surface = met[ray]
    if brightest == 0.0:  # an echo of the air alone has no surface
        return 0.0
    sheet_met = sheet[surface]
    for ray in range(np.uint64(start), np.uint64(stop)):
        if blank_m <= range_m[ray] < np.inf:
            light = (
                np.float64(reflectance[met[ray]]) * cosine[ray] / (np.float64(range_m[ray]) * range_m[ray])
            )
            total += light
            step_m = abs(range_m[ray] - at_m)
            if step_m > _LEAST_STEP_M and (sheet_met == 0 or sheet[met[ray]] != sheet_met):
                beyond_step += light
                weighted += light * min(step_m * (1.0 / _RANGE_STEP_M), 1.0)
    return 4.0 * weighted / total * (1.0 - beyond_step / total) if total > 0.0 else 0.0


@inline_kernel
def _is_one_surface(rays: SubRays, sheet: U4, start: int, stop: int) -> bool:
    """Return True if all sub-rays meet one surface without gaps, or nothing, as in `step_share`."""
    met = rays.surface
    surface = met[start]
    is_one = surface == NO_SURFACE or sheet[surface] != 0
    for ray in range(np.uint64(start), np.uint64(stop)):  # signed indices might count from the end
        is_one &= met[ray] == surface
    return is_one


@inline_kernel
def _fraction(x: float) -> float:
    return x - np.floor(x)


@kernel
def lose(
    rates: LossRates,
    unit: tuple[int, bool, U4, F8, F8, float],
    pulses: tuple[SubRays, Sight],
    row: int,
    first_ray: int,
    met: F8,
    before: F8,
    distance_m: F4,
    reflectivity: U1,
) -> None:
    """Remove the returns (L, 3) of lost pulses of a firing sequence, and update the averages of lasers.

    It is compiled apart from its caller: both loops together need more registers than a processor has.

    Parameters
    ----------
    unit : seed of the unit, whether it sends two returns, sheets as in `step_share`, share of near
        records that each laser loses, its code of a record without range, and the unit's least range
    row, first_ray : number of the sequence among the pulses, and of its first sub-ray
    met : (3, L) two normal numbers of each pulse, and its range before errors; the last digits of the second
        number decide what a lost record shows
    before : (L, STATE) state of each laser: mean code, -1 for none, last range, mean change of range, mean
        change of code over the last code, at most 1, 1 if its last pulse was lost, mean change of code over
        the mean code in more pulses, at most `range.most_change`, the last code, and the last area whose
        spots were drawn, infinity for none, with its number
    """
    (seed, dual, sheet, near_lost, no_return, blank_m) = unit
    rays, sight = pulses
    stop = first_ray
    for laser in range(distance_m.shape[0]):
        start, stop = stop, stop + int(rays.counts[row, laser])
        noise = met[1, laser]
        pulse = stop - start < 2, rays, sheet, start, stop, blank_m
        place = seed, sight, row, met[2, laser], near_lost[laser]
        _lose_pulse(
            rates,
            noise,
            pulse,
            place,
            before[laser],
            laser,
            no_return[laser],
            dual,
            distance_m[laser],
            reflectivity[laser],
        )


@inline_kernel
def _lose_pulse(
    rates: LossRates,
    noise: float,
    pulse: tuple[bool, SubRays, U4, int, int, float],
    place: tuple[int, Sight, int, float, float],
    before: F8,
    laser: int,
    no_return: float,
    dual: bool,
    distance_m: F4,
    reflectivity: U1,
) -> None:
    """Remove the returns (3,) of a pulse if it is lost.

    Parameters
    ----------
    pulse : True for a single ray, which has no step, and its sub-rays as in `step_share`
    place : seed of the unit, pulses and row of this one, its range before errors, and the share of near
        records that its laser loses
    before : (STATE,) state of the laser
    """
    if distance_m[0] <= 0.0:
        before[MEAN_CODE] = -1.0
        return
    code = min(np.float64(reflectivity[0]), 100.0)
    range_m = np.float64(distance_m[0])
    rough_m = before[_ROUGH]
    is_uneven = before[_CHANGE] > _UNEVEN_FROM
    follows = before[_WAS_LOST]
    last = before[_CODE] if before[MEAN_CODE] >= 0.0 else -1.0
    change = _change_of(last, code)
    _follow(before, code, range_m, change)
    is_calm = change <= _STEP_FROM and follows == 0.0 and not is_uneven
    has_spots = code < _BLACK_CODE or range_m < _CALM_FROM_M
    (is_single, rays, sheet, start, stop, _) = pulse
    if is_calm and not has_spots and (is_single or _is_one_surface(rays, sheet, start, stop)):  # most pulses
        return
    lost = _draw_of_view(place, laser)
    if is_calm and not has_spots and lost >= rates.step:
        return
    before[_WAS_LOST] = 0.0
    # Where ranges jump, as in trees, steps and spots lose fewer records.
    calm = _ROUGH_M / (_ROUGH_M + rough_m)
    jump = calm * loss_at_step(rates, last, code)
    sure = jump + calm * follows * rates.again
    gloss = calm * rates.gloss if is_uneven else 0.0
    rate = spot_rate(rates, code, range_m, gloss, place[4])
    arrives = lost >= sure and not _is_in_spot(rate, place, laser, before)
    if arrives and _has_no_step(pulse, lost, sure, calm * rates.step):
        return
    before[_WAS_LOST] = 1.0
    choice = _fraction(noise * _DIGITS)  # no further number is drawn
    if dual and choice < _EITHER_ALONE and lost >= jump:
        column = (
            1 if choice >= _ODD_ALONE else 2 if distance_m[0] == distance_m[1] and distance_m[2] > 0.0 else 0
        )
        distance_m[column] = 0.0
        reflectivity[column] = np.uint8(no_return)
        return
    shown_code = 0.0
    if lost < jump and code > last:  # too bright: the height of the peak is measured, its range is not
        shown_code = _too_bright(np.float64(reflectivity[0]), lost / jump, choice, no_return)
    for column in range(3):
        distance_m[column] = 0.0
        reflectivity[column] = np.uint8(shown_code if column < 2 else 0.0)
    if shown_code > 0.0 and dual and np.sqrt(_fraction(_ANEW * choice)) * _UNEQUAL_CODE < shown_code:
        reflectivity[1] = np.uint8(_multiple(_LAST_FACTOR * shown_code + no_return, no_return, _FULL))


@inline_kernel
def _has_no_step(
    pulse: tuple[bool, SubRays, U4, int, int, float], lost: float, sure: float, most: float
) -> bool:
    """Return True if a record is not lost at a step within its pulse.

    Parameters
    ----------
    pulse : as in `_lose_pulse`
    lost, sure : number that decides, and share of the records that are lost for other reasons
    most : share of the records that are lost at the greatest step
    """
    if pulse[0] or lost >= sure + most:
        return True
    return bool(lost >= sure + most * step_share(*pulse[1:]))


@inline_kernel
def _follow(before: F8, code: float, range_m: float, change: float) -> None:
    """Update the state of a laser, as in `lose`, by a code with its change over the last one."""
    level = before[MEAN_CODE]
    change_m = min(abs(range_m - before[_RANGE_M]), _MOST_ROUGH_M)
    before[_ROUGH] += _ROUGH_GAIN * (change_m - before[_ROUGH])
    before[_RANGE_M] = range_m
    before[MEAN_CODE] = code if level < 0.0 else level + _POWER_GAIN * (code - level)
    before[_CHANGE] += _POWER_GAIN * (change - before[_CHANGE])
    unevenness = min(_change_of(level, code), _MOST_CHANGE)
    before[UNEVENNESS] += _NOISE_GAIN * (unevenness - before[UNEVENNESS])
    before[_CODE] = code


@inline_kernel
def _change_of(level: float, code: float) -> float:
    """Return the change of code over the level of a laser, at most 1; 0 without a level."""
    return min(abs(code - level) / max(level, _BRIGHT_CODE), 1.0) if level >= 0.0 else 0.0


@inline_kernel
def loss_at_step(rates: LossRates, last: float, code: float) -> float:
    """Return the share of records that a step of brightness costs, from the last code of a laser."""
    if _change_of(last, code) <= _STEP_FROM:
        return 0.0
    if code > last:
        y = max(0.5 * (code + _FLOOR_CODE) / (last + _FLOOR_CODE) - 1.0, 0.0)
        y *= y
        height = 0.01 * (code - last)
        return rates.up * y * y / (y * y + _UP_HALF) + rates.bright * height * height
    y = max(0.5 * (last + _FLOOR_CODE) / (code + _FLOOR_CODE) - 1.0, 0.0)
    y *= y
    return rates.down * y * y / (y * y + _DOWN_HALF)


@inline_kernel
def spot_rate(rates: LossRates, code: float, range_m: float, gloss: float, near_rate: float) -> float:
    """Return the share of records that spots cost: dark ones, near ones, and where brightness is uneven.

    It is 0 on a calm surface that is neither dark nor near. `gloss` is the share of bright records.
    """
    rate = 0.0
    if code < _BLACK_CODE:
        far = min(1.0, _NEAR_M / range_m)
        rate = rates.dark * (1.0 - code * (1.0 / _BLACK_CODE)) * far * far
    if range_m < _CALM_FROM_M:
        rate += near_rate
    if code >= _BRIGHT_CODE:
        rate += gloss
    return rate


@inline_kernel
def _is_in_spot(rate: float, place: tuple[int, Sight, int, float, float], laser: int, before: F8) -> bool:
    """Return True if a laser loses its records at the place of a pulse, for a share of lost records.

    Cells of the world have the size of some records at their range. A few areas, of many cells, have spots;
    there a cell has one with the probability `spot.density`. Folds make the borders of cells irregular. Most
    pulses are in the area of the one before, whose number is in the state of the laser.
    """
    if rate <= 0.0:
        return False
    (seed, sight, row, at_m, _) = place
    size_m = _spot_m(at_m)
    x = (sight.origin_m[row, laser, 0] + at_m * sight.direction[row, laser, 0]) / size_m
    y = (sight.origin_m[row, laser, 1] + at_m * sight.direction[row, laser, 1]) / size_m
    z = (sight.origin_m[row, laser, 2] + at_m * sight.direction[row, laser, 2]) / size_m
    u = np.int64(math.floor(x + fold(0.37 * y + 0.61 * z)))
    v = np.int64(math.floor(y + fold(0.53 * z - 0.41 * x)))
    w = np.int64(math.floor(z + fold(0.43 * x + 0.57 * y)))
    across = _SPOTS_ACROSS_BITS
    area_u, area_v, area_w = u >> across, v >> across, w >> across
    if before[AREA] != area_u or before[_AREA_V] != area_v or before[_AREA_W] != area_w:
        before[AREA] = area_u
        before[_AREA_V] = area_v
        before[_AREA_W] = area_w
        before[_AREA_DRAWN] = _draw_cell(seed, area_u, area_v, area_w << 1 | 1, laser)
    return before[_AREA_DRAWN] * _DENSITY < rate and _draw_cell(seed, u, v, w << 1, laser) < _DENSITY


@inline_kernel
def _draw_of_view(place: tuple[int, Sight, int, float, float], laser: int) -> float:
    """Draw the number of a laser's view in the direction of a pulse: what it sees there, from there, stays.

    Cells of 1 m over `_CELLS_PER_M`, a metre before the lens, are about as wide as a record. A step that lies
    between two surfaces has no place of its own on either.
    """
    (seed, sight, row, _, _) = place
    x = (sight.origin_m[row, laser, 0] + sight.direction[row, laser, 0]) * _CELLS_PER_M
    y = (sight.origin_m[row, laser, 1] + sight.direction[row, laser, 1]) * _CELLS_PER_M
    z = (sight.origin_m[row, laser, 2] + sight.direction[row, laser, 2]) * _CELLS_PER_M
    cell = np.uint64(seed) + np.uint64(laser) * _PRIMES[3]
    cell += np.uint64(np.int64(math.floor(x))) * _PRIMES[0]
    cell ^= np.uint64(np.int64(math.floor(y))) * _PRIMES[1]
    cell += np.uint64(np.int64(math.floor(z))) * _PRIMES[2]
    cell = (cell ^ (cell >> np.uint64(30))) * _MIX[0]
    cell = (cell ^ (cell >> np.uint64(27))) * _MIX[1]
    cell ^= cell >> np.uint64(31)
    return np.float64(cell >> np.uint64(11)) * 2.0**-53


@inline_kernel
def _spot_m(range_m: float) -> float:
    """Return the size of a spot: the least one doubled until it is that of `_SPOT_RAD`, without a loop."""
    least = np.float64(_SPOT_RAD * _NEAREST_SPOT_M).view(np.int64)
    doublings = max(np.float64(_SPOT_RAD * range_m).view(np.int64) - least + _MANTISSA >> 52, np.int64(0))
    return np.int64(least + (doublings << 52)).view(np.float64)


@inline_kernel
def _draw_cell(seed: int, u: np.int64, v: np.int64, w: np.int64, laser: int) -> float:
    """Draw the number of a cell for a laser."""
    of_laser = (u & ((1 << _LASER_BITS) - 1)) | (laser << _LASER_BITS)
    drawn, _ = uniform_pair(seed, _SPOT, of_laser | (v << 32), w & 0xFFFFFFFF)
    return drawn


@inline_kernel
def _glare_beside(code: float) -> float:
    """Return the share of records without a range whose code is above 100, beside a return of some code."""
    x = 0.01 * min(code, _DIFFUSE)
    cube = x * x * x
    return _GLARE_DARK + _GLARE_PER_CODE * x + _GLARE_BRIGHT * cube * cube


@inline_kernel
def _too_bright(code: float, draw: float, choice: float, no_return: float) -> float:
    """Return what a record sends that is lost because a return of some code is too bright, from two draws."""
    glare = _GLARE if code > _DIFFUSE else _glare_beside(code)
    if draw >= glare:
        return _multiple(code * (0.7 + 1.6 * choice), no_return, _DIFFUSE)
    if code > _DIFFUSE:
        return _multiple(code * (0.7 + 1.6 * choice), no_return, _FULL)
    return _multiple(_DIFFUSE + (_FULL - _DIFFUSE) * draw / glare, no_return, _FULL)


@inline_kernel
def _multiple(code: float, no_return: float, limit: float) -> float:
    """Return the multiple of the laser's no-return code nearest to `code`, at most `limit`."""
    return min(np.floor(np.rint(code / no_return) * no_return) if no_return > 0.0 else code, limit)


@inline_kernel
def raised_code(
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
    highest = -1.0
    beside = -1.0
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
                highest = max(highest, 0.0)
                y = code / rates.raise_code
                y *= np.sqrt(y)
                draw, choice = uniform_pair(seed, _EDGE, first + at, laser | (side + 2) << 12)
                place_draw, _ = uniform_pair(seed, _EDGE, (first + at) // _PLACE_SEQUENCES, _SHARED_LANE)
                if place_draw < share * y / (1.0 + y):
                    power6 = choice * choice * choice
                    ratio = (0.4 + 0.95 * choice + 1.6 * power6 * power6) * (1.0 if away == 1 else 0.7)
                    if draw * (_TWICE_CODE + code) < _TWICE_CODE:
                        ratio = 0.0
                    highest = max(highest, code * ratio, 2.0 * no_return)
                if away == 1:
                    beside = max(beside, code)
                    glare = _fraction(_ANEW * choice)
                break
            share *= _CONTINUES  # a farther record is raised only if the nearer one is
    limit = _glare_beside(beside)
    if beside >= 0.0 and glare < limit:
        return _multiple(_DIFFUSE + (_FULL - _DIFFUSE) * glare / limit, no_return, _FULL)
    return _multiple(highest, no_return, _DIFFUSE) if highest > 0.0 else highest
