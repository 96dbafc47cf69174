"""Statistics of a unit, from its packets alone, which depend little on what stood before it.

Ranges are held against a cubic through fifteen pulses of the same laser, where all of them met a smooth surface. Each
statistic is absent if the capture has too little for it.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from vlp16emu.extras.compare.sequences import Sequences
from vlp16emu.units import US_NS

_WINDOW = 15
_SMOOTHEST_MM, _FARTHEST_MM = 20.0, 35.0
"""Least scatter and residual in a window from which on a surface is no smooth one."""
_SLOTS = 5
_MIDDLE_LEVEL = 20.0
_LEAST = 500
"""Records, from which on a statistic is worth its name."""
_COMB_CODES, _COMB_RANGES_LSB, _LEAST_COMB = (50, 100), 250 * 1.4 ** np.arange(14), 200
"""Codes, edges of the range classes from half a metre to 40 m, and the least number of codes in a class."""
_HUM_CYCLES_PER_BLOCK = 0.16
_MOST_COUNTS = 15

Statistics = dict[str, float]


class Smooth:
    """Residuals of the ranges of pulses on smooth surfaces, with their slot of the beat, and their reflectivities."""

    def __init__(self, sequences: Sequences) -> None:
        powers = np.vander(np.arange(_WINDOW) - _WINDOW // 2, 4).astype(float)
        own, centre = np.eye(_WINDOW) - powers @ np.linalg.pinv(powers), _WINDOW // 2
        span = sliding_window_view(sequences.number, _WINDOW)
        gapless = np.flatnonzero(span[:, -1] - span[:, 0] == _WINDOW - 1)
        found = []
        for laser, (codes, level) in enumerate(zip(sequences.distance_lsb.T, sequences.reflectivity.T, strict=True)):
            windows = sliding_window_view(codes, _WINDOW)[gapless]
            seen = (windows > 0).all(axis=1)
            rest_mm = 2.0 * (windows[seen] @ own)
            smooth = (rest_mm.std(axis=1) < _SMOOTHEST_MM) & (np.abs(rest_mm).max(axis=1) < _FARTHEST_MM)
            rows = gapless[seen][smooth] + centre
            slot = (24 * sequences.number[rows] + laser) % _SLOTS
            found.append((rest_mm[smooth, centre], slot, level[rows], level[rows + 1] - level[rows]))
        self.residual_mm, self.slot, self.level, self.change = map(np.concatenate, zip(*found, strict=True))
        """(r,) residuals; slots of the beat, 0 to 4, from the first pulse of the capture; reflectivities, and their change to
        the next pulse of the laser, on the same surface."""
        self.own = own[centre]
        """(15,) weight of each pulse of a window in the residual of its middle."""
        self.white_gain = math.sqrt(float((self.own**2).sum()))
        """Share of white noise that is left in a residual."""

    @property
    def means_mm(self) -> NDArray[np.float64]:
        """(5,) of the residuals, by slot."""
        counts = np.bincount(self.slot, minlength=_SLOTS)
        return np.bincount(self.slot, self.residual_mm, _SLOTS) / counts


def smooth_of(sequences: Sequences) -> Smooth | None:
    """Take the residuals of a capture; None where it shows too little of smooth surfaces."""
    smooth = Smooth(sequences)
    return smooth if len(smooth.slot) >= _LEAST else None


def beat_of(smooth: Smooth) -> NDArray[np.complex128]:
    """Find the beat of period five: the complex amplitudes of the sine and of its overtone, (2,) mm."""
    seen = np.fft.fft(smooth.means_mm)[1:3] * 2.0 / _SLOTS
    # From one sequence to the next the slot falls by one: by so much the smoothing has taken of each.
    steps = np.arange(_WINDOW) - _WINDOW // 2
    left = [abs(np.sum(smooth.own * np.exp(2j * np.pi * k * steps / _SLOTS))) for k in (1, 2)]
    return np.asarray(seen / left)


def statistics_of(sequences: Sequences) -> Statistics:
    """Find all statistics that a capture has, by name."""
    smooth = smooth_of(sequences)
    every = (
        ({} if smooth is None else _range_noise(smooth) | _reflectivity(smooth))
        | _comb(sequences)
        | _silence(sequences)
        | _rotation(sequences)
        | _residues(sequences)
        | _stamps(sequences)
    )
    return {name: float(value) for name, value in every.items() if math.isfinite(value)}


def white_mm(smooth: Smooth) -> NDArray[np.float64]:
    """Residuals (r,) without the beat, as they would be at a reflectivity of 20 (`range_sigma_m`)."""
    rest_mm = smooth.residual_mm - smooth.means_mm[smooth.slot]
    return np.asarray(rest_mm * (smooth.level.clip(1, 100) / _MIDDLE_LEVEL) ** 0.25)


def _range_noise(smooth: Smooth) -> Statistics:
    """Beat and noise of ranges at a reflectivity of 20, with and without the beat: what else a scene has does not count."""
    beat_mm, white = abs(beat_of(smooth)[0]), white_mm(smooth).std() / smooth.white_gain
    return {
        "range.beat_mm": beat_mm,
        "range.sigma_at_20_mm": math.hypot(white, beat_mm / math.sqrt(2.0)),
        "range.white_at_20_mm": white,
    }


def _reflectivity(smooth: Smooth) -> Statistics:
    out = {}
    for name, low, high in (("1_4", 1, 4), ("20_59", 20, 59), ("60_99", 60, 99)):
        of = smooth.change[(smooth.level >= low) & (smooth.level <= high)]
        if len(of) >= _LEAST:
            out[f"reflectivity.equal_{name}"] = (of == 0).mean()
            out[f"reflectivity.scatter_{name}"] = of[np.abs(of) <= _MOST_COUNTS].std() / math.sqrt(2.0)
    return out


def _comb(sequences: Sequences) -> Statistics:
    """Find how rugged the histograms of bright codes are: second differences over counts, of each laser at each range.

    Ranges are taken together within 40 %, where steps of codes change little.
    """
    far = np.searchsorted(_COMB_RANGES_LSB, sequences.distance_lsb)
    of = far * far.shape[1] + np.arange(far.shape[1])
    low, high = _COMB_CODES
    bright = (sequences.distance_lsb > 0) & (sequences.reflectivity >= low) & (sequences.reflectivity < high)
    counts = np.zeros((of.max() + 1, high - low))
    np.add.at(counts, (of[bright], sequences.reflectivity[bright].astype(int) - low), 1)
    counts = counts[counts.sum(axis=1) >= _LEAST_COMB]
    if counts.sum() < 10 * _LEAST:
        return {}
    return {"reflectivity.comb": np.abs(np.diff(counts, 2, axis=1)).sum() / counts[:, 1:-1].sum()}


def _silence(sequences: Sequences) -> Statistics:
    silent, r = sequences.distance_lsb == 0, sequences.reflectivity
    both = silent[1:] & silent[:-1]
    if both.sum() < _LEAST:
        return {}
    return {
        "no_return.above_0": (r[silent] > 0).mean(),
        "no_return.equal": (r[1:] == r[:-1])[both].mean(),
        "no_return.mean": r[silent].mean(),
    }


class Turning(NamedTuple):
    """Errors of the encoder against an even turn that changes its speed evenly."""

    once_cdeg: complex
    """Amplitudes of the sine (imaginary) and the cosine (real) of the azimuth."""
    twice_cdeg: complex
    rest_cdeg: NDArray[np.float64]
    """(b,) what is left."""


def turning_of(sequences: Sequences) -> Turning:
    """Find speed and errors that repeat with the turn."""
    azimuth, block = sequences.azimuth_cdeg, sequences.block
    span = block / block[-1]
    turn = 2.0 * np.pi * azimuth / 36_000
    waves = [wave(k * turn) for k in (1, 2) for wave in (np.cos, np.sin)]
    basis = np.stack([np.ones(len(block)), span, span**2, *waves], axis=1)
    found, *_ = np.linalg.lstsq(basis, azimuth.astype(float), rcond=None)
    return Turning(complex(*found[3:5]), complex(*found[5:7]), azimuth - basis @ found)


def hum_cdeg(sequences: Sequences, rest_cdeg: NDArray[np.float64]) -> float:
    """Find the amplitude of the line at 1447 Hz in the residuals of the azimuth."""
    wave = np.exp(2j * np.pi * _HUM_CYCLES_PER_BLOCK * sequences.block)
    return float(2.0 * abs(np.mean(local(rest_cdeg) * local(wave))))


def local(series: NDArray[Any]) -> NDArray[Any]:
    """Take a series without its ends, less the mean of nine around each value."""
    return np.asarray(series[9:-9] - np.convolve(series, np.ones(9) / 9, "same")[9:-9])


def _rotation(sequences: Sequences) -> Statistics:
    """Speed, errors that repeat with the turn, the hum, and the noise of readings."""
    azimuth, block = sequences.azimuth_cdeg, sequences.block
    rpm, (once, twice, rest) = sequences.rpm, turning_of(sequences)
    step = np.diff(azimuth)[np.diff(block) == 1]
    mode = int(np.bincount(np.clip(step, 0, None)).argmax())
    out = {
        "rotation.speed_off_percent": abs(rpm / (60 * round(rpm / 60)) - 1) * 100,
        "rotation.once_cdeg": abs(once),
        "rotation.twice_cdeg": abs(twice),
        "rotation.hum_cdeg": hum_cdeg(sequences, rest),
        "rotation.reading_cdeg": local(rest).std(),
        "rotation.commonest_step": (step == mode).mean(),
        "rotation.rarest_of_five": (np.bincount(azimuth % 5, minlength=5) / len(azimuth)).min(),
        "rotation.uneven_of_twenty": (20.0 * np.bincount(azimuth % 20, minlength=20) / len(azimuth)).std(),
    }
    turns = (azimuth - azimuth[0]) // 36_000
    if turns[-1] >= 3:
        starts = np.searchsorted(turns, np.arange(turns[-1] + 1))
        each = np.diff(azimuth[starts]) / np.diff(block[starts])
        out["rotation.speed_sd_percent"] = (each / each.mean()).std() * 100
    return out


def _residues(sequences: Sequences) -> Statistics:
    """Evenness of the codes of distance."""
    d = sequences.distance_lsb
    odd = [(codes[codes > 0] % 2).mean() for codes in d.T if (codes > 0).sum() >= _LEAST]
    if len(odd) < _SLOTS:
        return {}
    by_four = np.bincount(d[d > 0] % 4, minlength=4) / (d > 0).sum()
    return {"residue.odd_spread": np.std(odd), "residue.mod_4": np.abs(by_four - 0.25).max()}


def _stamps(sequences: Sequences) -> Statistics:
    clock, stamp = sequences.clock_ns - sequences.clock_ns[0], sequences.stamp_ns - sequences.stamp_ns[0]
    return {"stamp.spacing_us": (np.diff(stamp) - np.diff(clock)).std() / US_NS}
