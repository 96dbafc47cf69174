"""Strength of an echo as an integer of the receiver: steps of reflectivity codes, and parity of ranges.

A code is the strength times an integer of eighths that depends on the laser and the range, without its
fraction: at 9/8 the codes 8, 17, 26 ... are missing, at 20/8 only 2, 5, 7, 10 ... are sent. The least
strength is 1, so code 0 is sent only where the factor is below one. Lasers receive about the same strength
from one surface, so the gain of a laser follows this factor. A range is twice a count of 4 mm, plus a
correction in steps of 2 mm from a table by laser and count of the receiver. Some lasers change it as a whole:
each firing sequence corrects one laser anew, in turn. Sources: the laws `strength` and `range` of
`vlp16emu/sensor/laws.toml`.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from vlp16emu.elementary import cos, exp, log, power
from vlp16emu.kernels.compiler import inline_kernel
from vlp16emu.random import Purpose, normal, uniform, uniform_pair
from vlp16emu.sensor.laws import law, span
from vlp16emu.trig import ZERO
from vlp16emu.types import F8, U1

_BINS_PER_M = 16
_BINS = 1024  # up to 64 m, beyond which factors no longer change
EIGHTHS = 0  # columns of `Strength.by_range`
GAIN = 1
_KNOTS = 32  # of a laser's gain
_OF_UNIT = 1 << 16  # number of a draw of the unit that no laser has
_UNEVEN_LANE = 1 << 15  # lane of the unevenness of the factors of the first laser
_PER_CODE = 8.0  # parts of a code in which its factor is an integer
_MOST_EIGHTHS = round(_PER_CODE * span("strength.limits")[1])
_FACTORS = np.append(_PER_CODE, np.arange(1.0, _MOST_EIGHTHS + 2))  # eighths; every code is sent for none
_STRENGTH_PER_CODE = _PER_CODE / _FACTORS
_TRUNCATED = (0.5 - 0.5 * np.gcd(_FACTORS.astype(int), int(_PER_CODE)) / _PER_CODE) * _STRENGTH_PER_CODE
"""Strengths of a code by the factor in eighths, and those that truncation takes on average."""
NEXT = np.uint64(1)  # on an unsigned index; signed ones might count from the end
_DIFFUSE = 100.0
_FULL = 255.0
_COUNTS_OF_CODE = np.interp(
    np.arange(_FULL + 1.0) + 0.5, span("strength.counts_at"), span("strength.counts")
)  # of a unit with factor 1; codes end at 100
PARITIES = 1 + int(max(span("strength.counts_of_units")) * _COUNTS_OF_CODE.sum())
"""Counts of the receiver with a correction of their own: those of all codes on all units."""
_PARITY = ZERO + Purpose.DISTANCE_PARITY
_KEPT_ROUNDS = int(law("strength.kept_rounds"))
_SLOTS = 5  # of the beat of ranges, by (24 sequence + laser) mod 5
_CHANGES_LANE = 1 << 12  # lane of the random numbers of changes, beside the laser
_FAINT_M = 1e-3 * law("range.faint_mm")
_FAINT_UNTIL_M, _FAINT_FROM_M = span("range.faint_near_m")
_RANGE_LSB_PER_M = 500.0  # of a packet: 2 mm
_M_PER_RANGE_LSB = 0.002


class Strength(NamedTuple):
    """Properties of a unit; L lasers."""

    by_range: F8
    """(L, bins, 2) factor of a strength in eighths of a code before it is rounded, 0 for none, and gain,
    every 1/16 m; no bins if a unit has neither."""
    top: F8  # (L,) greatest code of a matt surface
    parity: U1  # (L, PARITIES) correction of the range by count of the receiver, modulo 2; empty for none
    counts: F8  # (257,) count of the receiver of each code up to 255, before it is rounded
    changed: F8
    """(L, 5) share of the time in which the corrections of a laser have the other parity, by (24 sequence +
    laser) mod 5 of the sequence in which it was drawn."""


def strength_of(
    seed: int,
    lasers: int,
    *,
    far_step: float,
    unit_spread: float,
    gain_spread: float,
    has_counts: bool,
    is_real: bool,
) -> Strength:
    """Draw the tables of a unit.

    Parameters
    ----------
    far_step : median factor of a strength beyond 8 m; 0 to send all codes
    unit_spread : above 0, units differ in that factor, and in the counts of a code
    gain_spread : spread of the logarithm of a laser's gain over ranges, beside what follows the factor
    has_counts : True if ranges are counts of 4 mm and a correction
    is_real : True if lasers of some units do not clip at code 100
    """
    has_ranges = far_step > 0.0 or gain_spread > 0.0
    by_range = np.zeros((lasers, _BINS if has_ranges else 0, 2))
    at = np.maximum(np.arange(by_range.shape[1]), 1) / _BINS_PER_M
    waves = [_wave(seed, 1 + laser, at) for laser in range(lasers)]
    by_range[..., GAIN] = exp(gain_spread * np.stack(waves))
    if far_step > 0.0:
        factors = np.stack([_factors(seed, laser, far_step, unit_spread, at) for laser in range(lasers)])
        least, most = span("strength.limits")
        factors = np.clip(factors * _unevenness(seed, lasers, unit_spread, at), least, most)
        by_range[..., EIGHTHS] = _PER_CODE * factors
        by_range[..., GAIN] *= _gains(seed, factors, unit_spread)
    counts = _counts(seed, unit_spread)
    parity = np.zeros((lasers, 0), np.uint8)
    changed = np.zeros((lasers, _SLOTS))
    if has_counts:
        changed = _changed(seed, lasers)
        parity = _parities(seed, counts, changed)
    top = _tops(seed, lasers) if is_real else np.full(lasers, _DIFFUSE)
    return Strength(by_range, top, parity, counts, changed)


def _tops(seed: int, lasers: int) -> F8:
    """Draw the greatest code of a matt surface of each laser, (lasers,)."""
    of_unit = uniform(seed, Purpose.STRENGTH, 2, 1)[0]
    of_laser = uniform(seed, Purpose.STRENGTH, 3, lasers)
    is_open = (of_unit < law("strength.open_units")) & (of_laser < law("strength.open_lasers"))
    return np.where(is_open, _FULL, _DIFFUSE)


def _counts(seed: int, unit_spread: float) -> F8:
    """Draw the count of the receiver of each code, (257,), before it is rounded."""
    least, most = span("strength.counts_of_units")
    drawn = float(uniform(seed, Purpose.STRENGTH, 0, 1)[0]) if unit_spread > 0.0 else 0.5
    return np.concatenate([[0.0], np.cumsum((least + (most - least) * drawn) * _COUNTS_OF_CODE)])


def _changed(seed: int, lasers: int) -> F8:
    """Draw the shares of the time in which the parity of each laser is changed, (lasers, 5); 0 for most."""
    low, high = span("strength.changed")
    share = low + (high - low) * uniform(seed, Purpose.STRENGTH, 5, lasers, _OF_UNIT)
    changes = uniform(seed, Purpose.STRENGTH, 5 + lasers, lasers, _OF_UNIT) < law("strength.changing_lasers")
    low, high = span("strength.changed_by_beat")
    swing = low + (high - low) * uniform(seed, Purpose.STRENGTH, 7 + 2 * lasers, lasers, _OF_UNIT)
    phase = uniform(seed, Purpose.STRENGTH, 7 + 3 * lasers, lasers, _OF_UNIT)
    wave = cos(2.0 * math.pi * (np.arange(_SLOTS) / _SLOTS + phase[:, None]))
    return np.where(changes, share, 0.0)[:, None] * (1.0 + swing[:, None] * wave)


def _unevenness(seed: int, lasers: int, unit_spread: float, at_m: F8) -> F8:
    """Draw the factors by which those of a unit's lasers deviate from smooth ones, (lasers, n), by range."""
    least, most = span("strength.uneven")
    drawn = 0.5
    if unit_spread > 0.0:
        drawn = float(uniform(seed, Purpose.STRENGTH, 6 + 2 * lasers, 1, _OF_UNIT)[0])
    waves = [_wave(seed, _UNEVEN_LANE + laser, at_m) for laser in range(lasers)]
    return exp((least + (most - least) * drawn) * np.stack(waves))


def _wave(seed: int, lane: int, at_m: F8) -> F8:
    """Return a smooth random function, of variance one, of the logarithm of ranges (n,).

    It is interpolated between knots.
    """
    knots = normal(seed, Purpose.STRENGTH, 0, _KNOTS, lane)
    place = log(at_m * _BINS_PER_M) / law("strength.knot_e_folds")
    knot = np.minimum(place.astype(np.int64), len(knots) - 2)
    fraction = place - knot
    value = (1.0 - fraction) * knots[knot] + fraction * knots[knot + 1]
    even = (1.0 - fraction) * (1.0 - fraction) + fraction * fraction
    return np.asarray(value / np.sqrt(even))


def _factors(seed: int, laser: int, far_step: float, unit_spread: float, at_m: F8) -> F8:
    """Return the factor of a laser's strengths at ranges (n,): about 1 at 1 to 3 m, more beyond and below."""
    spread_of_units = law("strength.far_of_units") if unit_spread > 0.0 else 0.0
    far_of_unit = far_step * float(exp(spread_of_units * normal(seed, Purpose.STRENGTH, 1, 1))[0])
    near_z, far_z = normal(seed, Purpose.STRENGTH, _KNOTS, 2, 1 + laser).tolist()
    low, high = span("strength.fine")
    fine = low + (high - low) * float(uniform(seed, Purpose.STRENGTH, _KNOTS + 2, 1, 1 + laser)[0])
    low, high = span("strength.near_until_m")
    fine_m = low * power(high / low, float(uniform(seed, Purpose.STRENGTH, _OF_UNIT, 1)[0]))
    near = law("strength.near") * float(exp(np.array(law("strength.near_of_lasers") * near_z)))
    far = far_of_unit * float(exp(np.array(law("strength.far_of_lasers") * far_z)))
    near_m, coarse_m, far_m = span("strength.ranges_m")
    below = np.clip(log(fine_m / at_m) / log(np.array(fine_m / near_m)), 0.0, 1.0)
    beyond = np.clip(log(at_m / coarse_m) / log(np.array(far_m / coarse_m)), 0.0, 1.0)
    near = max(near, fine)
    far = min(max(far, fine), law("strength.most_far"))
    return np.asarray(fine * exp(below * log(np.array(near / fine)) + beyond * log(np.array(far / fine))))


def _gains(seed: int, factors: F8, unit_spread: float) -> F8:
    """Return the gains (lasers, n) of a unit's lasers with these factors of their strengths."""
    least, most = span("strength.gain_by_factor")
    drawn = float(uniform(seed, Purpose.STRENGTH, 4, 1, _OF_UNIT)[0]) if unit_spread > 0.0 else 0.5
    logarithm = log(factors)
    away = logarithm - logarithm.sum(axis=0) / len(factors)
    return exp((least + (most - least) * drawn) * away)


def _parities(seed: int, counts: F8, changed: F8) -> U1:
    """Draw whether the correction of each laser and count of the receiver is odd, (lasers, PARITIES).

    Lasers have their other parity as a whole where that balances odd and even ranges of all of them: from the
    most unequal laser to the least, each takes the sign against the sum of those before it.

    Parameters
    ----------
    counts : counts of the unit's codes, as in `Strength`
    changed : shares (lasers, 5) of the time in which a laser has its other parity, which count against it
    """
    changes = 0.5 - 0.5 * law("strength.parity_correlation")
    limits = counts[np.array(span("strength.balanced_codes"), int)].astype(int)
    out = np.zeros((len(changed), PARITIES), np.uint8)
    excess = np.zeros(len(changed))
    for laser, shares in enumerate(changed):
        drawn = uniform(seed, Purpose.DISTANCE_PARITY, 0, PARITIES, laser)
        drawn[0] = np.where(drawn[0] < 0.5, 0.0, 1.0)
        out[laser] = np.cumsum(drawn < changes) % 2
        of_classes = [out[laser, low : max(high, low + 1)].mean() - 0.5 for low, high in pairwise(limits)]
        excess[laser] = sum(of_classes) * (1.0 - 2.0 * shares.mean())
    total = 0.0
    for laser in np.argsort(-np.abs(excess), kind="stable"):
        if total * excess[laser] > 0.0:
            out[laser] ^= 1
            excess[laser] = -excess[laser]
        total += excess[laser]
    return out


@inline_kernel
def at_range(table: F8, range_m: float) -> tuple[float, float]:
    """Return factor and gain of a laser from its table (bins, 2) at a range, interpolated.

    The factor is an integer of eighths of a code; 0 for none.
    """
    if table.shape[0] == 0:
        return 0.0, 1.0
    place = min(range_m * _BINS_PER_M, _BINS - 1.001)
    knot = np.uint32(place)
    above = knot + NEXT
    fraction = place - knot
    eighths = table[knot, EIGHTHS] + fraction * (table[above, EIGHTHS] - table[knot, EIGHTHS])
    gain = table[knot, GAIN] + fraction * (table[above, GAIN] - table[knot, GAIN])
    return np.floor(eighths + 0.5), gain


@inline_kernel
def strength(code: float, eighths: float) -> float:
    """Return the strength, before rounding, whose code has the mean `code`; that of 8 eighths for none."""
    which = np.uint32(eighths)
    return code * _STRENGTH_PER_CODE[which] + _TRUNCATED[which]


@inline_kernel
def in_steps(code: float, exact: float, eighths: float) -> float:
    """Return the code of the strength nearest to `exact`, that of `code`; the brightest code has no step.

    What is received has a strength of at least 1.
    """
    if eighths < 1.0 or code >= _DIFFUSE:
        return code
    return min(np.floor(max(np.floor(exact + 0.5), 1.0) * eighths * (1.0 / _PER_CODE)), _DIFFUSE)


@inline_kernel
def excess_m(range_m: float, exact: float) -> float:
    """Return by how much a faint echo is measured too far, from its strength as in `strength`."""
    near = max(_FAINT_FROM_M / max(range_m, _FAINT_UNTIL_M), 1.0)
    close = near / max(np.floor(exact + 0.5), 1.0)
    return _FAINT_M * close * close


@inline_kernel
def count_of(counts: F8, code: float) -> float:
    """Return the count of the receiver, before rounding, of a code before it is rounded and clipped."""
    place = min(code, _FULL) + 0.5
    below = np.uint32(place)
    return counts[below] + (place - below) * (counts[below + NEXT] - counts[below])


@inline_kernel
def change_parities(seed: int, n: int, is_first: bool, shares: F8, changed: F8) -> None:
    """Update which lasers have changed parities, 1 or 0 in `changed` (L,), at firing sequence n.

    Each sequence updates one laser, in turn: its parity changes with the share of the slot of that pulse. A
    draw holds for `_KEPT_ROUNDS` of its turns. `is_first` to update all lasers, whatever came before.
    """
    lasers = shares.shape[0]
    begin = 0 if is_first else n % lasers
    for laser in range(begin, lasers, 1 if is_first else lasers):
        at = n - (n - laser) % lasers  # sequence of the laser's last turn
        share = shares[laser, (24 * at + laser) % _SLOTS]
        changed[laser] = 0.0
        if share > 0.0:
            turn = at // lasers // _KEPT_ROUNDS
            drawn, _ = uniform_pair(seed, _PARITY, turn, _CHANGES_LANE | laser)
            changed[laser] = 1.0 if drawn < share else 0.0


@inline_kernel
def with_parity(parity: U1, changed: float, count: float, range_m: float, most_m: float) -> float:
    """Return a range as a count of 4 mm and the correction of a receiver's count.

    Parameters
    ----------
    parity, changed : corrections of the laser modulo 2, and 1 if they are changed, else 0
    most_m : limit of the range
    """
    odd = np.abs(np.float64(parity[np.uint32(count)]) - changed)
    counts = 2.0 * np.floor(0.5 * (range_m * _RANGE_LSB_PER_M - odd) + 0.5) + odd
    if counts > most_m * _RANGE_LSB_PER_M:
        counts -= 2.0
    return counts * _M_PER_RANGE_LSB
