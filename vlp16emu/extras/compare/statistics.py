"""Statistics of a unit, from its packets alone; most depend little on the scene around it.

Pulses on smooth surfaces show noise and beat of ranges, noise and texture of reflectivity, and the gain of
the lasers.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.extras.compare.sequences import Sequences
from vlp16emu.packets.layout import AZIMUTH_CODES, BLOCK_PERIOD_NS, DISTANCE_LSB_M
from vlp16emu.sensor.settings import set_rpm
from vlp16emu.types import F8, I8, AnyArray
from vlp16emu.units import US_NS

_PULSES = 15
_SMOOTHEST_MM = 14.0  # root mean square about a cubic at which a surface is no longer smooth
_POWERS = np.vander(np.arange(_PULSES) - _PULSES // 2, 4).astype(float)
_Q = np.eye(_PULSES) - _POWERS @ np.linalg.pinv(_POWERS)  # (15, 15) removes the cubic of least squares
_FREE = _PULSES - 4
_SLOTS = 5
_MIDDLE_LEVEL = 20.0
_LEAST = 500
_LEAST_STRETCHES = 30
"""Least number of pairs of neighbours or codes of a laser, and of stretches, for a statistic."""
_MOST_COUNTS = 15
_COMB_CODES = (50, 100)
_COMB_RANGES_MM = 500 * 1.4 ** np.arange(14)
_LEAST_COMB = 200
"""Codes, edges of the range classes from half a metre to 40 m, and the least number of codes in a class."""
_SCATTERED = 0.4
_NOT_CUT = 90
"""Scatter in counts above which reflectivity is more than its rounding, and level up to which it is not
clipped at 100."""
_GAIN_CODES = (10, 90)
_SECTOR_CDEG = 4500
_LEAST_GAIN = 100

Statistics = dict[str, float]


@dataclass(frozen=True, slots=True)
class Stretches:
    """s stretches of 15 pulses of one laser on a smooth surface."""

    residual_mm: F8  # (s, 15) ranges minus the cubic
    first_slot: I8
    """(s,) slot of the beat, 0 to 4, of the first pulse; it falls by one from each pulse to the next."""
    codes: I8  # (s, 15) reflectivities

    @property
    def level(self) -> F8:
        """Mean reflectivity (s,)."""
        return np.asarray(self.codes.mean(axis=1))

    @property
    def code_residual(self) -> F8:
        """Reflectivities (s, 15) minus their cubic."""
        return np.asarray(self.codes @ _Q)

    @property
    def beat_mm(self) -> F8:
        """Error of range (5,) by slot, with a mean of zero: least squares over all stretches."""
        square = np.zeros((_SLOTS, _SLOTS))
        product = np.zeros(_SLOTS)
        for first in range(_SLOTS):
            residual_mm = self.residual_mm[self.first_slot == first]
            square += len(residual_mm) * _slot_residuals(first).T @ _slot_residuals(first)
            product += _slot_residuals(first).T @ residual_mm.sum(axis=0)
        return np.asarray(np.linalg.lstsq(square, product, rcond=1e-9)[0])

    @property
    def white_mm(self) -> F8:
        """Residuals (s, 15) without the beat."""
        beats_mm = np.stack([_slot_residuals(first) @ self.beat_mm for first in range(_SLOTS)])
        return np.asarray(self.residual_mm - beats_mm[self.first_slot])


def _slot_residuals(first: int) -> F8:
    """Return the residual (15, 5) of a unit error of each slot after removal of the cubic."""
    return np.asarray(_Q @ np.eye(_SLOTS)[(first - np.arange(_PULSES)) % _SLOTS])


def stretches_of(sequences: Sequences) -> Stretches | None:
    """Return the stretches of a capture; None if it has too few smooth surfaces."""
    count = len(sequences.number) // _PULSES
    number = sequences.number[: count * _PULSES].reshape(count, _PULSES)
    lasers = sequences.distance_lsb.shape[1]
    shape = (count, _PULSES, lasers)
    range_mm = sequences.range_mm[: count * _PULSES].reshape(shape).transpose(0, 2, 1)
    codes = sequences.reflectivity[: count * _PULSES].reshape(shape).transpose(0, 2, 1)
    residual_mm = range_mm @ _Q
    is_gapless = number[:, -1] - number[:, 0] == _PULSES - 1
    is_smooth = (residual_mm**2).mean(axis=2) < _SMOOTHEST_MM**2
    is_smooth &= (range_mm > 0).all(axis=2) & is_gapless[:, None]
    slot = (24 * number[:, :1] + np.arange(lasers)) % _SLOTS
    found = Stretches(residual_mm[is_smooth], slot[is_smooth], codes[is_smooth])
    return found if len(found.first_slot) >= _LEAST_STRETCHES else None


def beat_of(stretches: Stretches) -> NDArray[np.complex128]:
    """Return the complex amplitudes of the sine of period five and of its overtone, (2,) mm."""
    return np.asarray(np.fft.fft(stretches.beat_mm)[1:3] * 2.0 / _SLOTS)


def range_noise(stretches: Stretches) -> Statistics:
    """Return the beat of ranges, and their white noise at a reflectivity of 20 (`range_sigma_m`).

    The white noise also has its kurtosis and its correlation with reflectivity.
    """
    white_mm = stretches.white_mm
    level = stretches.level
    codes = stretches.code_residual
    at_middle_mm = white_mm * (level.clip(1, 100) / _MIDDLE_LEVEL)[:, None] ** 0.25
    scattered = ((codes**2).sum(axis=1) > _FREE * _SCATTERED**2) & (level < _NOT_CUT)
    correlation = math.nan
    if scattered.sum() >= _LEAST_STRETCHES:
        correlation = float(np.corrcoef(white_mm[scattered].ravel(), codes[scattered].ravel())[0, 1])
    return {
        "range.beat_mm": float(abs(beat_of(stretches)[0])),
        "range.white_at_20_mm": math.sqrt((at_middle_mm**2).sum() / (_FREE * len(level))),
        "range.kurtosis": float((white_mm**4 / (white_mm**2).mean(axis=1, keepdims=True) ** 2).mean()) - 3.0,
        "range.with_reflectivity": correlation,
    }


def reflectivity_noise(stretches: Stretches) -> Statistics:
    """Return the noise between neighbours, and the scatter within stretches as a share of their level."""
    out = {}
    level = stretches.level
    for name, low, high in (("1_4", 1, 4), ("60_99", 60, 99)):
        first_code = stretches.codes[:, :-1]
        change = np.diff(stretches.codes, axis=1)[(first_code >= low) & (first_code <= high)]
        if len(change) >= _LEAST:
            scatter = float(change[np.abs(change) <= _MOST_COUNTS].std())
            out[f"reflectivity.equal_{name}"] = float((change == 0).mean())
            out[f"reflectivity.scatter_{name}"] = scatter / math.sqrt(2.0)
    share = np.sqrt((stretches.code_residual**2).sum(axis=1) / _FREE) / level.clip(1)
    dark = (level >= 4) & (level <= 15)
    if dark.sum() >= _LEAST_STRETCHES:
        out["reflectivity.texture_4_15"] = float(np.median(share[dark]))
    middle = (level >= 30) & (level <= 60)
    if middle.sum() >= _LEAST_STRETCHES:
        low, high = np.quantile(share[middle], (0.25, 0.9))
        out["reflectivity.texture_spread"] = float(high / low)
    return out


def codes(sequences: Sequences) -> Statistics:
    """Return the share of codes at the top of the diffuse scale, and the ruggedness of bright codes.

    Ruggedness is the second difference of a histogram over its counts, for each laser in each class of range.
    A class spans 40 % of range, in which steps of codes change little.
    """
    seen = sequences.distance_lsb > 0
    r = sequences.reflectivity
    far = np.searchsorted(_COMB_RANGES_MM, sequences.range_mm)
    histogram = far * far.shape[1] + np.arange(far.shape[1])
    low, high = _COMB_CODES
    bright = seen & (r >= low) & (r < high)
    counts = np.zeros((histogram.max() + 1, high - low))
    np.add.at(counts, (histogram[bright], r[bright] - low), 1)
    counts = counts[counts.sum(axis=1) >= _LEAST_COMB]
    out = {"reflectivity.top_codes": float(((r >= 90) & (r <= 100))[seen].mean())} if seen.any() else {}
    if counts.sum() >= 10 * _LEAST:
        out["reflectivity.comb"] = float(np.abs(np.diff(counts, 2, axis=1)).sum() / counts[:, 1:-1].sum())
    return out


def gains(sequences: Sequences) -> Statistics:
    """Return the spread of the gain over lasers.

    Each laser is compared with its neighbours above and below on the same surface. Gains count as far as both
    of two sets of alternate sectors of 45 deg show them, so the scene does not.
    """
    upwards = np.argsort(sequences.layout.model.beams.ring)
    d = sequences.distance_lsb[:, upwards]
    r = sequences.reflectivity[:, upwards]
    mid, low, high = d[:, 1:-1], *_GAIN_CODES
    usable = (d > 0) & (r >= low) & (r < high)
    same = usable[:, :-2] & usable[:, 1:-1] & usable[:, 2:]
    for other in (d[:, :-2], d[:, 2:]):
        same &= np.abs(other - mid) < 0.1 * mid
    level = np.log(r.clip(1))
    ratio = level[:, 1:-1] - (level[:, :-2] + level[:, 2:]) / 2
    same &= np.abs(ratio) < 0.5
    per_block = len(d) // len(sequences.azimuth_cdeg)
    half = np.repeat(sequences.azimuth_cdeg // _SECTOR_CDEG % 2, per_block)[:, None]
    counts = []
    means = []
    for number in (0, 1):
        in_half = same & (half == number)
        counts.append(in_half.sum(axis=0))
        means.append(np.where(in_half, ratio, 0.0).sum(axis=0) / in_half.sum(axis=0).clip(1))
    enough = np.min(counts, axis=0) >= _LEAST_GAIN
    if enough.sum() < _SLOTS:
        return {}
    # A second difference of independent gains has 1.5 times their variance.
    common = np.cov(means[0][enough], means[1][enough])[0, 1]
    return {"reflectivity.gain_spread": math.sqrt(max(common, 0.0) / 1.5)}


# least number of records at edges and of packets for a statistic
_LEAST_EDGES = 15
_LEAST_PACKETS = 250
_ALIKE_LSB = 12
_FLAT_MM = 40
_EQUAL_MM = 30
_STEPS_MM = (300, 1400)
"""Greatest change of range between neighbours whose parity counts, beside a record, and across it, on one
surface; least near and far steps."""
_CODE_STEP = 20
_RAISED = 1.5  # code of a no-return over the commonest of its laser at which it is raised
# codes of returns beside which raised no-returns are counted
_DARK = (0, 5)
_BRIGHT = (40, 100)
_TICK_US = 1.2
_PHASES = 48
"""Period of the clock at whose ticks the encoder is read, measured on four units; phases that are tried."""
_LEAST_STEP_CDEG = 38  # least step between two blocks on real units at 600 rpm
_AT_RPM = (590.0, 610.0)


def statistics_of(sequences: Sequences) -> Statistics:
    """Return all statistics of a capture by name; statistics with too few data are left out."""
    stretches = stretches_of(sequences)
    found = {} if stretches is None else range_noise(stretches) | reflectivity_noise(stretches)
    for measure in (codes, gains, lost_records, no_returns, dual_returns, rotation, _residues, _clocks):
        found |= measure(sequences)
    return {name: float(value) for name, value in found.items() if math.isfinite(value)}


def lost_records(sequences: Sequences) -> Statistics:
    """Return the shares of records without a return between two pairs of returns of one laser.

    There is one for each change across the pairs: none of range; steps of 0.3 to 1.4 m, and larger; 20 codes
    of reflectivity and more on one surface.
    """
    d = sequences.range_mm
    r = sequences.reflectivity
    before, a, middle, c, after = (d[i : len(d) - 4 + i] for i in range(5))
    in_row = (sequences.number[4:] - sequences.number[:-4] == 4)[:, None]
    is_edge = in_row & (np.minimum(np.minimum(before, a), np.minimum(c, after)) > 0)
    is_edge &= (np.abs(a - before) < _FLAT_MM) & (np.abs(c - after) < _FLAT_MM)
    step_mm = np.abs(c - a)
    (near, far) = _STEPS_MM
    same = is_edge & (step_mm < _EQUAL_MM)
    places = {
        "lost.on_a_surface": same,
        "lost.at_steps_below_1.4_m": is_edge & (step_mm >= near) & (step_mm < far),
        "lost.at_steps_above_1.4_m": is_edge & (step_mm >= far),
        "lost.at_code_steps": same & (np.abs(r[3:-1] - r[1:-3]) >= _CODE_STEP),
    }
    return {name: float((middle[at] == 0).mean()) for name, at in places.items() if at.sum() >= _LEAST_EDGES}


def no_returns(sequences: Sequences) -> Statistics:
    """Return levels of the codes of records without a return, and shares above the level of their laser."""
    silent = sequences.distance_lsb == 0
    r = sequences.reflectivity
    both = silent[1:] & silent[:-1]
    if both.sum() < _LEAST:
        return {}
    out = {
        "no_return.above_0": (r[silent] > 0).mean(),
        "no_return.equal": (r[1:] == r[:-1])[both].mean(),
        "no_return.mean": r[silent].mean(),
    }
    return out | _raised_codes(silent, r)


def commonest(silent: NDArray[np.bool_], r: I8) -> I8:
    """Return the commonest code (L,) of each laser's records without a return, 0 if there are too few."""
    laser_codes = [column[is_silent] for column, is_silent in zip(r.T, silent.T, strict=True)]
    return np.array([np.bincount(c).argmax() if len(c) >= _LEAST_EDGES else 0 for c in laser_codes])


def _raised_codes(silent: NDArray[np.bool_], r: I8) -> Statistics:
    """Return how much more codes are raised beside bright returns than beside dark ones.

    The share of raised runs that have one record comes with it.
    """
    mode = commonest(silent, r)
    raised = silent & (r > _RAISED * mode) & (mode > 0)
    before = np.where(silent[:-2], -1, r[:-2])
    after = np.where(silent[2:], -1, r[2:])
    neighbour = np.maximum(before, after)
    beside = silent[1:-1] & (neighbour >= 0)
    shares = []
    for low, high in (_DARK, _BRIGHT):
        at = silent[1:-1] & (neighbour >= low) & (neighbour < high) & (mode > 0)
        shares.append(raised[1:-1][at].mean() if at.sum() >= _LEAST_EDGES else np.nan)
    begins = ~silent[:-2] & raised[1:-1]
    return {
        "no_return.above_100": (r[1:-1][beside] > 100).mean() if beside.sum() >= _LEAST_EDGES else np.nan,
        "no_return.raised_beside_bright": shares[1] - shares[0],
        "no_return.raised_once": (~raised[2:])[begins].mean() if begins.sum() >= _LEAST_EDGES else np.nan,
    }


def dual_returns(sequences: Sequences) -> Statistics:
    """Return the share of pairs with a return in one block, and of unequal codes among pairs without any."""
    if sequences.last is None:
        return {}
    (d_last, r_last) = sequences.last
    d = sequences.distance_lsb
    r = sequences.reflectivity
    none = (d == 0) & (d_last == 0)
    unequal = (r != r_last)[none].mean() if none.any() else np.nan
    return {"dual.one_without": ((d == 0) ^ (d_last == 0)).mean(), "dual.unequal_no_returns": unequal}


class Turning(NamedTuple):
    """Errors of the encoder against a rotation whose speed changes linearly."""

    once_cdeg: complex  # amplitudes of the sine (imaginary) and the cosine (real) of the azimuth
    twice_cdeg: complex
    rest_cdeg: F8  # (b,) residuals


def turning_of(sequences: Sequences) -> Turning:
    """Return the speed and the errors that repeat with each revolution."""
    azimuth = sequences.azimuth_cdeg
    block = sequences.block
    span = block / block[-1]
    turn = 2.0 * np.pi * azimuth / AZIMUTH_CODES
    waves = [wave(k * turn) for k in (1, 2) for wave in (np.cos, np.sin)]
    basis = np.stack([np.ones(len(block)), span, span**2, *waves], axis=1)
    found, *_ = np.linalg.lstsq(basis, azimuth.astype(float), rcond=None)
    return Turning(complex(*found[3:5]), complex(*found[5:7]), azimuth - basis @ found)


def local(series: AnyArray) -> AnyArray:
    """Return a series without its ends, minus the running mean of nine values."""
    return np.asarray(series[9:-9] - np.convolve(series, np.ones(9) / 9, "same")[9:-9])


def tick_of(sequences: Sequences, rest_cdeg: F8) -> float:
    """Return the height in us of the sawtooth of encoder readings that are taken at the last tick of a clock.

    It explains most of the residuals of the azimuth, by least squares for each of its phases.
    """
    since_us = (sequences.clock_ns - sequences.clock_ns[0]) / US_NS
    packet = sequences.packet
    per_packet_us, first_us = np.polyfit(packet, since_us, 1)
    # Stamps are truncated to whole microseconds: half a microsecond is missing in the mean.
    per_block_us = per_packet_us * len(packet) / len(sequences.block)
    clock_us = sequences.clock_ns[0] / US_NS + first_us + 0.5 + sequences.block * per_block_us
    rest = local(rest_cdeg)
    speed_cdeg_us = sequences.rpm * AZIMUTH_CODES / 60e6
    best = 0.0, 0.0
    for at_us in np.arange(_PHASES) * (_TICK_US / _PHASES):
        wave = local(-(((clock_us - at_us) / _TICK_US) % 1.0))
        product = wave @ rest
        square = wave @ wave
        if (explained := product**2 / square) > best[0]:
            best = explained, float(product / square / speed_cdeg_us)
    return best[1]


def rotation(sequences: Sequences) -> Statistics:
    """Return speed, errors that repeat with each revolution, the tick, and the noise of readings."""
    azimuth = sequences.azimuth_cdeg
    block = sequences.block
    rpm = sequences.rpm
    (once, twice, rest) = turning_of(sequences)
    step = np.diff(azimuth)[np.diff(block) == 1]
    part = step.mean() % 1.0
    out = {
        "rotation.speed_off_percent": abs(rpm / set_rpm(rpm) - 1) * 100,
        "rotation.once_cdeg": abs(once),
        "rotation.twice_cdeg": abs(twice),
        "rotation.tick_us": tick_of(sequences, rest),
        "rotation.reading_cdeg": local(rest).std(),
        "rotation.excess_variance": step.var() - part * (1 - part),
        "rotation.rarest_of_five": (np.bincount(azimuth % 5, minlength=5) / len(azimuth)).min(),
        "rotation.uneven_of_twenty": (20.0 * np.bincount(azimuth % 20, minlength=20) / len(azimuth)).std(),
    }
    if _AT_RPM[0] < rpm < _AT_RPM[1] and sequences.layout.reading_ns == BLOCK_PERIOD_NS:
        out["rotation.short_steps"] = (step < _LEAST_STEP_CDEG).mean()
    turns = (azimuth - azimuth[0]) // AZIMUTH_CODES
    if turns[-1] >= 3:
        starts = np.unique(np.searchsorted(turns, np.arange(turns[-1] + 1)))  # a gap may hide whole turns
        each = np.diff(azimuth[starts]) / np.diff(block[starts])
        out["rotation.speed_sd_percent"] = (each / each.mean()).std() * 100
    return out


def _residues(sequences: Sequences) -> Statistics:
    """Return the spread over lasers of the share of odd distances, and how uneven remainders of four are.

    Also the share of even changes between neighbours of a laser that have one code and nearly one range. None
    for models with another unit of distance, whose remainders say something else.
    """
    if sequences.layout.model.distance_lsb_m != DISTANCE_LSB_M:
        return {}
    d = sequences.distance_lsb
    odd = [(codes[codes > 0] % 2).mean() for codes in d.T if (codes > 0).sum() >= _LEAST]
    if len(odd) < 5:
        return {}
    by_four = np.bincount(d[d > 0] % 4, minlength=4) / (d > 0).sum()
    out = {"residue.odd_spread": float(np.std(odd)), "residue.mod_4": float(np.abs(by_four - 0.25).max())}
    step_lsb = np.abs(np.diff(d, axis=0))
    alike = (np.minimum(d[1:], d[:-1]) > 0) & (step_lsb < _ALIKE_LSB)
    alike &= np.diff(sequences.reflectivity, axis=0) == 0
    if alike.sum() >= _LEAST:
        out["residue.even_at_equal_codes"] = float((step_lsb[alike] % 2 == 0).mean())
    return out


def _clocks(sequences: Sequences) -> Statistics:
    """Return the rates of the sensor's and of the host's clock, and the jitter of arrivals.

    The sensor's rate is against its firings, the host's against the sensor's.
    """
    clock_us = (sequences.clock_ns - sequences.clock_ns[0]) / US_NS
    stamp_us = (sequences.stamp_ns - sequences.stamp_ns[0]) / US_NS
    arrival_us = (np.diff(stamp_us) - np.diff(clock_us)).std()
    if len(clock_us) < _LEAST_PACKETS:
        return {"clock.arrival_us": arrival_us}
    host = {
        "clock.host_ppm": (np.polyfit(clock_us, stamp_us, 1)[0] - 1) * 1e6,
        "clock.arrival_us": arrival_us,
    }
    if sequences.layout.model.period_us is not None:  # the period of a unit is not known beside its clock
        return host
    error_ppm = (np.polyfit(sequences.packet, clock_us, 1)[0] / sequences.packet_us - 1) * 1e6
    return {"clock.error_ppm": error_ppm} | host
