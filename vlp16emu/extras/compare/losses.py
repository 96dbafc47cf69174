"""Factors of a unit on the loss of records at steps and in spots, from those it lost and those it did not.

A lost record has no code, so the probabilities by which the others were at risk decide: if a unit loses the
share x h of records like one that arrived, then x h / (1 - x h) records of its kind were lost beside it. They
are those of a beam with a width: a ray without one (`beam.model = "none"`) loses none between two surfaces.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.extras.compare.sequences import Sequences
from vlp16emu.kernels.compiler import array_kernel
from vlp16emu.raycast.settings import Beam
from vlp16emu.returns import Noise
from vlp16emu.returns.lost import loss_at_step, loss_rates, spot_rate
from vlp16emu.returns.settings import LossRates
from vlp16emu.sensor.laws import law, span
from vlp16emu.types import F8
from vlp16emu.units import S_NS

_BEFORE = 4  # records before one, all with returns, from which the mean change of range follows
_GAIN = law("loss.rough_gain")
_WEIGHTS = _GAIN * (1.0 - _GAIN) ** np.array([2.0, 1.0, 0.0])  # of their changes, the eldest first
_LONGEST = 3  # run of lost records at a step
_LONGEST_IN_SPOT = 10
_NEAREST_M = 0.6  # nearer records may be below the least range of a unit
_EVEN_CODES = 5  # greatest change of code across a spot
_FLAT_MM = 40.0
_EQUAL_MM = 30.0
_STEP_MM = 300.0
"""Greatest change of range on either side of a record, and across it on one surface; least step of range."""
_EVEN = 0.3  # greatest span of the codes before a record over their level
_LEAST_RATE = 0.02  # share of records lost at a step of brightness that counts
_MOST_RATE = 0.98
_LEAST_EXPECTED = 2.0  # lost records of a median unit
_HALVINGS = 30
_MEAN_NEAR = float(np.sqrt(np.prod(span("spot.near"))))  # loss of near records of a median unit
_PARTS = (np.arange(8) + 0.5) / 8.0  # of the way from pulse to pulse


class _Windows(NamedTuple):
    """Records between two pairs of returns of their laser, (n, L)."""

    before_mm: F8  # ranges before a record, and after it or after the run of lost ones that it begins
    after_mm: F8
    level: F8  # last code of the laser before it
    code: F8  # codes of the record and of the one after it
    after_code: F8
    calm: F8  # factor on losses where ranges change from record to record
    is_lost: NDArray[np.bool_]
    is_calm: NDArray[np.bool_]  # ranges on both sides and codes before the record change little


def records_lost(sequences: Sequences, most: float) -> float | None:
    """Return the factor on the rates of a median unit by which a unit loses records at steps, up to `most`.

    Steps of brightness are on one surface, and steps of range between two, beyond the range within which
    records are lost in spots. None if a median unit would lose hardly any in the capture.
    """
    windows = _windows_of(sequences)
    rates = loss_rates(0, Noise(preset="unit", unit_spread=0.0))
    step_mm = np.abs(windows.after_mm - windows.before_mm)
    nearest_m = 1e-3 * np.minimum(windows.before_mm, windows.after_mm)
    is_far = windows.is_calm & (nearest_m > law("spot.calm_from_m"))
    expected = windows.calm * _at_steps(rates, windows.level, windows.after_code)
    is_same = (step_mm < _EQUAL_MM) & (expected >= _LEAST_RATE)
    is_same &= np.minimum(windows.level, windows.after_code) >= law("loss.black_code")
    is_edge = step_mm >= _STEP_MM
    rate = windows.calm * _at_steps(rates, windows.level, windows.code)
    rate += np.where(is_edge, windows.calm * rates.step * _shared(sequences, nearest_m), 0.0)
    is_counted = is_far & (is_same | is_edge)
    at_risk = rate[is_counted & ~windows.is_lost]
    if at_risk.sum() < _LEAST_EXPECTED:
        return None
    return _factor(at_risk, int((is_counted & windows.is_lost).sum()), most)


def spots_lost(sequences: Sequences, most: float) -> float | None:
    """Return the factor on a median unit's rates by which a unit loses dark and near records, up to `most`.

    Lost ones are between returns of nearly one range and code. None if a median unit would lose hardly any.
    """
    rates = loss_rates(0, Noise(preset="unit", unit_spread=0.0))
    code = np.minimum(sequences.reflectivity, 100).astype(float)
    range_m = 1e-3 * sequences.range_mm
    expected = _in_spots(rates, code, np.where(range_m > _NEAREST_M, range_m, 0.0), _MEAN_NEAR).sum()
    if expected < _LEAST_EXPECTED:
        return None
    lost = _lost_between_alike(sequences.range_mm, code)
    return float(min(lost / expected, most))


def _lost_between_alike(range_mm: F8, code: F8) -> int:
    """Return the number of dark or near records that are lost between two returns alike."""
    at = np.arange(len(range_mm))[:, None]
    returned = range_mm > 0.0
    before = np.maximum.accumulate(np.where(returned, at, -1), axis=0)
    after = np.minimum.accumulate(np.where(returned, at, len(at))[::-1], axis=0)[::-1]
    is_short = ~returned & (before >= 0) & (after < len(at)) & (after - before <= _LONGEST_IN_SPOT + 1)
    row, laser = np.nonzero(is_short)
    first = before[row, laser], laser
    last = after[row, laser], laser
    alike = np.abs(range_mm[first] - range_mm[last]) < _EQUAL_MM
    alike &= np.abs(code[first] - code[last]) < _EVEN_CODES
    alike &= range_mm[first] > 1e3 * _NEAREST_M
    is_dark = np.minimum(code[first], code[last]) < law("loss.black_code")
    is_near = range_mm[first] < 1e3 * law("spot.calm_from_m")
    return int((alike & (is_dark | is_near)).sum())


def _windows_of(sequences: Sequences) -> _Windows:
    """Return the records of a capture that have returns of their laser on both sides."""
    range_mm = sequences.range_mm
    code = np.minimum(sequences.reflectivity, 100).astype(float)
    size = _BEFORE + _LONGEST + 2
    count = len(range_mm) - size + 1
    ranges = [range_mm[i : count + i] for i in range(size)]
    codes = [code[i : count + i] for i in range(size)]
    is_usable = (sequences.number[size - 1 :] - sequences.number[:count] == size - 1)[:, None]
    is_usable = is_usable & (np.min(ranges[:_BEFORE], axis=0) > 0.0)
    after_mm, next_mm, after_code = (np.zeros_like(ranges[0]) for _ in range(3))
    for run in range(_LONGEST, -1, -1):
        first = _BEFORE + max(run, 1)
        fits = (ranges[_BEFORE] > 0.0) if run == 0 else np.max(ranges[_BEFORE:first], axis=0) == 0.0
        fits = fits & (ranges[first] > 0.0) & (ranges[first + 1] > 0.0)
        after_mm = np.where(fits, ranges[first], after_mm)
        next_mm = np.where(fits, ranges[first + 1], next_mm)
        after_code = np.where(fits, codes[first], after_code)
    level = codes[_BEFORE - 1]
    change_mm = np.minimum(np.abs(np.diff(ranges[:_BEFORE], axis=0)), 1e3 * law("loss.most_rough_m"))
    elder_mm = (1.0 - _WEIGHTS.sum()) * change_mm.mean(axis=0)  # those before are taken for alike
    rough_m = 1e-3 * (np.tensordot(_WEIGHTS, change_mm, axes=1) + elder_mm)
    is_calm = is_usable & (after_mm > 0.0) & (np.abs(after_mm - next_mm) < _FLAT_MM)
    is_calm &= change_mm[-1] < _FLAT_MM
    is_calm &= np.ptp(codes[:_BEFORE], axis=0) <= _EVEN * np.maximum(level, law("spot.bright_code"))
    return _Windows(
        before_mm=ranges[_BEFORE - 1],
        after_mm=after_mm,
        level=level,
        code=codes[_BEFORE],
        after_code=after_code,
        calm=law("loss.rough_m") / (law("loss.rough_m") + rough_m),
        is_lost=ranges[_BEFORE] == 0.0,
        is_calm=is_calm,
    )


@array_kernel
def _at_steps(rates: LossRates, level: F8, code: F8) -> F8:
    """Return the share of records (n, L) that steps of brightness cost."""
    out = np.empty_like(level)
    for i in range(level.shape[0]):
        for j in range(level.shape[1]):
            out[i, j] = loss_at_step(rates, level[i, j], code[i, j])
    return out


@array_kernel
def _in_spots(rates: LossRates, code: F8, range_m: F8, near_rate: float) -> F8:
    """Return the share of records (n, L) that dark and near spots cost; 0 for records without a return."""
    out = np.zeros_like(code)
    for i in range(code.shape[0]):
        for j in range(code.shape[1]):
            if range_m[i, j] > 0.0:
                out[i, j] = spot_rate(rates, code[i, j], range_m[i, j], 0.0, near_rate)
    return out


def _shared(sequences: Sequences, range_m: F8) -> F8:
    """Return the mean of 4 s (1 - s) over the pulses on both sides of an edge; s is the share of one side.

    The edge is anywhere between their centres. The light is Gaussian across the beam, whose width is four
    sigmas; at u sigmas beside the edge 4 s (1 - s) is exp(-2 u**2 / pi) within 0.02.
    """
    beam = Beam()
    turned_rad = 2.0 * np.pi / 60.0 * sequences.rpm * sequences.layout.model.beams.sequence_ns / S_NS
    sigma_m = 1e-3 * (beam.spot_mm[0] + beam.divergence_mrad[0] * range_m) / 4.0
    sigmas = turned_rad * range_m / sigma_m  # from pulse to pulse
    return np.asarray(np.mean([np.exp(-2.0 / np.pi * (part * sigmas) ** 2) for part in _PARTS], axis=0))


def _factor(rate: F8, lost: int, most: float) -> float:
    """Return x, up to `most`, for which x rate / (1 - x rate) add up to the number of lost records."""
    low, high = 0.0, most
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        share = np.minimum(middle * rate, _MOST_RATE)
        if (share / (1.0 - share)).sum() < lost:
            low = middle
        else:
            high = middle
    return high if lost else 0.0
