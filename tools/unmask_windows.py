"""Windows of a capture for `tools/unmask`, and features of them that were chosen by hand."""

import dataclasses
from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from vlp16emu.extras.compare import Sequences
from vlp16emu.extras.compare.statistics import commonest
from vlp16emu.packets.layout import AZIMUTH_CODES

SEQUENCES = 600
"""Firing sequences of a window: 25 packets of single return."""
MOST_WINDOWS = 14
"""Most windows of a capture: all units count equally, and neighbouring windows hold the same information."""
FLAT_LSB = 20
"""Largest change of range between neighbours on one surface: 40 mm."""
LEVELS = tuple(pairwise((0, 5, 20, 60, 101)))
CODES, CHANGES, RUNS = (
    (0, 1, 2, 4, 8, 15, 30, 45, 60, 75, 90, 100, 101, 256),
    (0, 1, 2, 3, 6, 13, 256),
    (1, 2, 3, 4, 8, 601),
)
MULTIPLES = (0, 0.01, 0.9, 1.1, 1.9, 2.9, 256)
LEAST = 30
"""Least number of values of a feature."""
UPWARDS = np.r_[0:16:2, 1:16:2]
"""Lasers by elevation (63-9243 Rev D, table 9-1)."""
Array = np.ndarray


class Features(dict[str, float]):
    """Features of a window by name; a feature with too few values is NaN."""

    def rate(self, name: str, of: Array) -> None:
        """Add a mean."""
        self[name] = float(of.mean()) if of.size >= LEAST else np.nan

    def shares(self, name: str, of: Array, edges: tuple[float, ...]) -> None:
        """Add a histogram with named classes."""
        counts = np.histogram(of, edges)[0]
        total = counts.sum() if counts.sum() >= LEAST else np.nan
        self.update(
            {f"{name}.{low}": float(count / total) for low, count in zip(edges, counts, strict=False)}
        )

    def shape(self, name: str, of: Array) -> None:
        """Add width and shape of a distribution."""
        sd = of.std() if len(of) >= LEAST and of.any() else np.nan
        z = (of - of.mean()) / sd if len(of) else np.array([np.nan])
        quarter = np.quantile(z, (0.25, 0.75))
        found = {
            "sd": sd,
            "kurtosis": (z**4).mean(),
            "skew": (z**3).mean(),
            "quarters": quarter[1] - quarter[0],
        }
        self.update({f"{name}.{of}": float(value) for of, value in found.items()})

    def lags(self, name: str, of: Array, valid: Array) -> None:
        """Add the autocorrelation of valid values along the first axis."""
        for lag in (1, 2, 3, 4):
            both = valid[lag:] & valid[:-lag]
            self.correlation(f"{name}.lag_{lag}", of[lag:][both], of[:-lag][both])

    def correlation(self, name: str, a: Array, b: Array) -> None:
        """Add a correlation."""
        usable = len(a) >= LEAST and a.std() > 0 and b.std() > 0
        self[name] = float(np.corrcoef(a, b)[0, 1]) if usable else np.nan

    def unevenness(self, name: str, of: Array, *moduli: int) -> None:
        """Add the variance of the counts of residues over their squared mean.

        The value expected by chance is subtracted.
        """
        for modulus in moduli:
            counts = np.bincount(of % modulus, minlength=modulus)
            mean = counts.mean()
            self[f"{name}.mod_{modulus}"] = (
                float((counts.var() - mean) / mean**2) if mean >= LEAST else np.nan
            )


class Window(NamedTuple):
    """Adjacent packets of a capture."""

    sequences: Sequences
    whole: Sequences
    later: Array
    """Index in the whole capture of the sequence one turn after each of the window (n,)."""


def turn_later(whole: Sequences) -> Array:
    """Return the index (n,) of the sequence that is nearest to a turn after each one; n beyond the end."""
    azimuth = np.interp(whole.number, 2 * whole.block, whole.azimuth_cdeg)
    half_step = 0.5 * (azimuth[-1] - azimuth[0]) / max(len(azimuth) - 1, 1)
    return np.searchsorted(azimuth, azimuth + AZIMUTH_CODES - half_step)


def windows(whole: Sequences) -> Iterator[Window]:
    """Yield windows of a capture that do not overlap, evenly spread, without windows that have a gap."""
    per_packet = len(whole.number) // len(whole.packet)
    packets, per_block = SEQUENCES // per_packet, per_packet // 2
    later = turn_later(whole)
    every = range(0, len(whole.packet) - packets + 1, packets)
    for first in every[:: -(-len(every) // MOST_WINDOWS) or 1]:
        stop = first + packets
        of_packet, of_block = slice(first, stop), slice(first * per_block, stop * per_block)
        of_sequence = slice(first * per_packet, stop * per_packet)
        if whole.packet[stop - 1] - whole.packet[first] == packets - 1:
            cut = {
                **dict.fromkeys(("number", "distance_lsb", "reflectivity"), of_sequence),
                **dict.fromkeys(("azimuth_cdeg", "block"), of_block),
                **dict.fromkeys(("clock_ns", "stamp_ns", "packet"), of_packet),
            }
            own = dataclasses.replace(whole, **{name: getattr(whole, name)[at] for name, at in cut.items()})
            yield Window(own, whole, later[of_sequence])


def features_of(window: Sequences) -> Features:
    """Return the features of a window; names that begin with `scene` describe the surroundings."""
    out, d, r = Features(), window.distance_lsb, window.reflectivity
    step = np.abs(np.diff(d, axis=0)) < FLAT_LSB
    flat = (d[:-2] > 0) & (d[1:-1] > 0) & (d[2:] > 0) & step[:-1] & step[1:]
    out.rate("scene.returns", d > 0)
    out.shares("scene.range", d[d > 0], (0, 1000, 3000, 10_000, 65_536))
    out.shares("scene.code", r[d > 0], CODES)
    _surfaces(out, d, r, flat, (24 * window.number[1:-1, None] + np.arange(16)) % 5)
    _losses(out, d, r)
    _no_returns(out, d, r)
    _azimuths(out, window.azimuth_cdeg)
    _stamps(out, window)
    return out


def _surfaces(out: Features, d: Array, r: Array, flat: Array, slot: Array) -> None:
    """Add second differences of ranges and codes along a laser, and differences between lasers."""
    level, change = r[1:-1], np.abs(r[2:] - r[1:-1])
    bend, code_bend = (np.diff(of, 2, axis=0).astype(float) for of in (d, r))
    out.shape("range", bend[flat])
    out.lags("range", bend, flat)
    out.unevenness("range", d[d > 0], 2, 4, 5, 8, 10)
    out.unevenness("code", r[(d > 0) & (r < 100)], 2, 3, 5)  # bright surfaces are cut at 100
    for low, high in LEVELS:
        at = flat & (level >= low) & (level < high)
        out.shape(f"range.at_{low}", bend[at])
        out.shape(f"code.at_{low}", code_bend[at] / level[at].clip(1))
        out.lags(f"code.at_{low}", code_bend, at)
        out.shares(f"code.change_at_{low}", change[at], CHANGES)
    means = [
        bend[flat & (slot == which)].mean() if (flat & (slot == which)).any() else np.nan
        for which in range(5)
    ]
    out |= {"range.beat": float(np.std(means)), "range.overtone": float(abs(np.fft.fft(means)[2]))}
    both = flat & (code_bend != 0)
    out.correlation("range.with_code", bend[both], code_bend[both])


def _losses(out: Features, d: Array, r: Array) -> None:
    """Add lengths of runs with and without returns.

    Also rates of missing returns by the neighbours before and after.
    """
    for name, of in (("silent_run", d == 0), ("run", d > 0)):
        edge = np.diff(np.pad(of, ((1, 1), (0, 0))).astype(int), axis=0).T
        out.shares(f"loss.{name}", np.nonzero(edge == -1)[1] - np.nonzero(edge == 1)[1], RUNS)
    a, lost, c = d[:-2], d[1:-1] == 0, d[2:]
    step, code_step, both = np.abs(c - a), np.abs(r[2:] - r[:-2]), (a > 0) & (c > 0)
    for low, high in pairwise((0, 15, 50, 150, 700, 65_536)):
        out.rate(f"loss.at_step_{low}", lost[both & (step >= low) & (step < high)])
    for low, high in pairwise((0, 5, 20, 50, 101)):
        out.rate(
            f"loss.at_code_step_{low}", lost[both & (step < 15) & (code_step >= low) & (code_step < high)]
        )
    for low, high in LEVELS:
        out.rate(f"loss.after_{low}", lost[(a > 0) & (r[:-2] >= low) & (r[:-2] < high)])


def _no_returns(out: Features, d: Array, r: Array) -> None:
    """Add codes of no-returns over the most common code of their laser.

    Next to returns and apart from them.
    """
    silent, mode = d == 0, commonest(d == 0, r)
    share, usable = (r / np.maximum(mode, 1))[1:-1], (silent & (mode > 0))[1:-1]
    beside = usable & ~(silent[:-2] & silent[2:])
    out.shares("no_return.beside", share[beside], MULTIPLES)
    out.shares("no_return.apart", share[usable & ~beside], MULTIPLES)
    code = np.maximum(np.where(silent[:-2], 0, r[:-2]), np.where(silent[2:], 0, r[2:]))
    out.correlation("no_return.with_neighbour", np.log(share[beside].clip(0.1)), np.log(code[beside].clip(1)))
    raised = (share > 1.5).astype(float)
    out.correlation(
        "no_return.with_next_laser", raised[:, :-2][usable[:, :-2]], raised[:, 2:][usable[:, :-2]]
    )
    out.rate("no_return.above_100", r[silent] > 100)
    out.rate("no_return.equal", (r[1:] == r[:-1])[silent[1:] & silent[:-1]])


def _azimuths(out: Features, azimuth: Array) -> None:
    """Add steps, residues and spectrum of the readings."""
    step, at = np.diff(azimuth), np.arange(len(azimuth))
    speed, rest = step.mean(), azimuth - np.polyval(np.polyfit(at, azimuth, 3), at)
    out.shares("azimuth.step", step - speed, (-9, -2.5, -1.5, -0.5, 0.5, 1.5, 2.5, 9))
    out.shape("azimuth", rest)
    out.lags("azimuth", step - speed, np.ones(len(step), bool))
    out.unevenness("azimuth", azimuth, 2, 5)
    out["azimuth.variance"] = float(step.var() - speed % 1 * (1 - speed % 1))
    power = np.abs(np.fft.rfft(rest * np.hanning(len(rest)))[3:]) ** 2
    out |= {
        f"azimuth.band_{i}": float(band.sum() / power.sum())
        for i, band in enumerate(np.array_split(power, 12))
    }


def _stamps(out: Features, window: Sequences) -> None:
    """Add the spacing of the stamps."""
    since_us = (window.clock_ns - window.clock_ns[0]) / 1e3
    line = np.polyfit(window.packet, since_us, 1)
    out.shape("stamp", since_us - np.polyval(line, window.packet))
    out["stamp.rate"] = float(line[0] / window.packet_us - 1)
