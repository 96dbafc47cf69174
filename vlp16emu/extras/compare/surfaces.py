"""What pulses on smooth surfaces show: noise and beat of ranges, noise and texture of reflectivity, gain of the lasers."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlp16emu.extras.compare.sequences import Sequences

_PULSES = 15
_SMOOTHEST_MM = 14.0  # root mean square about a cubic, from which on a surface is no smooth one
_POWERS = np.vander(np.arange(_PULSES) - _PULSES // 2, 4).astype(float)
_Q = np.eye(_PULSES) - _POWERS @ np.linalg.pinv(_POWERS)  # (15, 15) removes the cubic of least squares
_FREE = _PULSES - 4
_SLOTS = 5
_MIDDLE_LEVEL = 20.0
_LEAST, _LEAST_STRETCHES = 500, 30  # pairs of neighbours and stretches, from which on a statistic is worth its name
_MOST_COUNTS = 15
_COMB_CODES, _COMB_RANGES_LSB, _LEAST_COMB = (50, 100), 250 * 1.4 ** np.arange(14), 200
"""Codes, edges of the range classes from half a metre to 40 m, and the least number of codes in a class."""
_SCATTERED, _BRIGHT = 0.4, 90
"""Scatter in counts from which on reflectivity is more than its rounding, and level up to which it is not cut at 100."""
_GAIN_CODES, _SECTOR_CDEG, _LEAST_GAIN = (10, 90), 4500, 100
_UPWARDS = np.r_[0:16:2, 1:16:2]  # lasers by elevation (63-9243 Rev D, table 9-1)

Statistics = dict[str, float]


@dataclass(frozen=True, slots=True)
class Stretches:
    """s stretches of 15 pulses of one laser on a smooth surface."""

    residual_mm: NDArray[np.float64]  # (s, 15) ranges less the cubic
    first_slot: NDArray[np.int64]
    """(s,) slot of the beat, 0 to 4, of the first pulse; it falls by one from pulse to pulse."""
    codes: NDArray[np.int64]  # (s, 15) reflectivities

    @property
    def level(self) -> NDArray[np.float64]:
        """Mean reflectivity (s,)."""
        return np.asarray(self.codes.mean(axis=1))

    @property
    def code_residual(self) -> NDArray[np.float64]:
        """Reflectivities (s, 15) less their cubic."""
        return np.asarray(self.codes @ _Q)

    @property
    def beat_mm(self) -> NDArray[np.float64]:
        """Error of range (5,) by slot, with a mean of zero: least squares over all stretches."""
        square, product = np.zeros((_SLOTS, _SLOTS)), np.zeros(_SLOTS)
        for first in range(_SLOTS):
            own = self.residual_mm[self.first_slot == first]
            square += len(own) * _of_slots(first).T @ _of_slots(first)
            product += _of_slots(first).T @ own.sum(axis=0)
        return np.asarray(np.linalg.lstsq(square, product, rcond=1e-9)[0])

    @property
    def white_mm(self) -> NDArray[np.float64]:
        """Residuals (s, 15) without the beat."""
        of_first = np.stack([_of_slots(first) @ self.beat_mm for first in range(_SLOTS)])
        return np.asarray(self.residual_mm - of_first[self.first_slot])


def _of_slots(first: int) -> NDArray[np.float64]:
    """Return what is left (15, 5) of a unit error of each slot when the cubic is removed."""
    return np.asarray(_Q @ np.eye(_SLOTS)[(first - np.arange(_PULSES)) % _SLOTS])


def stretches_of(sequences: Sequences) -> Stretches | None:
    """Find the stretches of a capture; None if it shows too little of smooth surfaces."""
    count = len(sequences.number) // _PULSES
    number, lasers = sequences.number[: count * _PULSES].reshape(count, _PULSES), sequences.distance_lsb.shape[1]
    distance, codes = (
        of[: count * _PULSES].reshape(count, _PULSES, lasers).transpose(0, 2, 1)
        for of in (sequences.distance_lsb, sequences.reflectivity)
    )
    residual_mm = 2.0 * distance @ _Q
    is_gapless = number[:, -1] - number[:, 0] == _PULSES - 1
    is_smooth = (distance > 0).all(axis=2) & ((residual_mm**2).mean(axis=2) < _SMOOTHEST_MM**2) & is_gapless[:, None]
    slot = (24 * number[:, :1] + np.arange(lasers)) % _SLOTS
    found = Stretches(residual_mm[is_smooth], slot[is_smooth], codes[is_smooth])
    return found if len(found.first_slot) >= _LEAST_STRETCHES else None


def beat_of(stretches: Stretches) -> NDArray[np.complex128]:
    """Return the complex amplitudes of the sine of period five and of its overtone, (2,) mm."""
    return np.asarray(np.fft.fft(stretches.beat_mm)[1:3] * 2.0 / _SLOTS)


def range_noise(stretches: Stretches) -> Statistics:
    """Beat, white noise at a reflectivity of 20 (`range_sigma_m`), its kurtosis, and its correlation with reflectivity."""
    white_mm, level, codes = stretches.white_mm, stretches.level, stretches.code_residual
    at_middle_mm = white_mm * (level.clip(1, 100) / _MIDDLE_LEVEL)[:, None] ** 0.25
    scattered = ((codes**2).sum(axis=1) > _FREE * _SCATTERED**2) & (level < _BRIGHT)
    return {
        "range.beat_mm": float(abs(beat_of(stretches)[0])),
        "range.white_at_20_mm": math.sqrt((at_middle_mm**2).sum() / (_FREE * len(level))),
        "range.kurtosis": float((white_mm**4 / (white_mm**2).mean(axis=1, keepdims=True) ** 2).mean()) - 3.0,
        "range.with_reflectivity": float(np.corrcoef(white_mm[scattered].ravel(), codes[scattered].ravel())[0, 1])
        if scattered.sum() >= _LEAST_STRETCHES
        else math.nan,
    }


def reflectivity_noise(stretches: Stretches) -> Statistics:
    """Noise of neighbours, and the scatter within stretches as a share of their level: texture and noise."""
    out, level = {}, stretches.level
    for name, low, high in (("1_4", 1, 4), ("60_99", 60, 99)):
        change = np.diff(stretches.codes, axis=1)[(stretches.codes >= low)[:, :-1] & (stretches.codes <= high)[:, :-1]]
        if len(change) >= _LEAST:
            out[f"reflectivity.equal_{name}"] = float((change == 0).mean())
            out[f"reflectivity.scatter_{name}"] = float(change[np.abs(change) <= _MOST_COUNTS].std()) / math.sqrt(2.0)
    share = np.sqrt((stretches.code_residual**2).sum(axis=1) / _FREE) / level.clip(1)
    if ((dark := (level >= 4) & (level <= 15)).sum()) >= _LEAST_STRETCHES:
        out["reflectivity.texture_4_15"] = float(np.median(share[dark]))
    if ((middle := (level >= 30) & (level <= 60)).sum()) >= _LEAST_STRETCHES:
        low, high = np.quantile(share[middle], (0.25, 0.9))
        out["reflectivity.texture_spread"] = float(high / low)
    return out


def codes(sequences: Sequences) -> Statistics:
    """Share of codes at the top of the diffuse scale, and how rugged the histograms of bright codes are.

    The latter are second differences over counts, of each laser at each range; ranges are taken together within 40 %, where
    steps of codes change little.
    """
    seen, r = sequences.distance_lsb > 0, sequences.reflectivity
    far = np.searchsorted(_COMB_RANGES_LSB, sequences.distance_lsb)
    of = far * far.shape[1] + np.arange(far.shape[1])
    low, high = _COMB_CODES
    bright = seen & (r >= low) & (r < high)
    counts = np.zeros((of.max() + 1, high - low))
    np.add.at(counts, (of[bright], r[bright] - low), 1)
    counts = counts[counts.sum(axis=1) >= _LEAST_COMB]
    out = {"reflectivity.top_codes": float(((r >= 90) & (r <= 100))[seen].mean())} if seen.any() else {}
    if counts.sum() >= 10 * _LEAST:
        out["reflectivity.comb"] = float(np.abs(np.diff(counts, 2, axis=1)).sum() / counts[:, 1:-1].sum())
    return out


def gains(sequences: Sequences) -> Statistics:
    """Spread of the gain over lasers: each laser against those above and below it, where the surface is the same.

    What lasers show in both halves of the alternate sectors of 45 deg counts, and not what stands there.
    """
    d, r = sequences.distance_lsb[:, _UPWARDS], sequences.reflectivity[:, _UPWARDS]
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
    counts, means = [], []
    for which in (0, 1):
        own = same & (half == which)
        counts.append(own.sum(axis=0))
        means.append(np.where(own, ratio, 0.0).sum(axis=0) / own.sum(axis=0).clip(1))
    enough = np.min(counts, axis=0) >= _LEAST_GAIN
    if enough.sum() < _SLOTS:
        return {}
    # A second difference of independent gains has 1.5 times their variance.
    common = np.cov(means[0][enough], means[1][enough])[0, 1]
    return {"reflectivity.gain_spread": math.sqrt(max(common, 0.0) / 1.5)}
