"""Factor of a unit on the loss of records at steps, from records that it lost and from those that it did not.

A lost record has no code, so the probabilities by which the others were at risk decide: if a unit loses the
share x h of records like one that arrived, then x h / (1 - x h) records of its kind were lost beside it.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.extras.compare.sequences import Sequences
from vlp16emu.kernels.compiler import array_kernel
from vlp16emu.raycast.settings import Beam
from vlp16emu.returns import Noise
from vlp16emu.returns.lost import loss_at_step, loss_rates
from vlp16emu.returns.settings import LossRates
from vlp16emu.sensor.laws import law
from vlp16emu.types import F8
from vlp16emu.units import S_NS

_BEFORE = 4  # records before one, all with returns, from which the mean change of range follows
_WEIGHTS = 0.5 ** np.array([3.0, 2.0, 1.0])  # of their changes, the eldest first, as a step halves each time
_LONGEST = 3  # run of lost records
_FLAT_MM = 40.0
_EQUAL_MM = 30.0
_STEP_MM = 300.0
"""Greatest change of range on either side of a record, and across it on one surface; least step of range."""
_EVEN = 0.3  # greatest span of the codes before a record over their level
_LEAST_RATE = 0.02  # share of records lost at a step of brightness that counts
_MOST_RATE = 0.98
_LEAST_EXPECTED = 2.0  # lost records of a median unit
_HALVINGS = 30
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
    rough_m = 1e-3 * np.tensordot(_WEIGHTS, change_mm, axes=1)
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
