"""Raw windows of a capture for `tools/unmask`: features that presume little, and patches of records as they are."""

import dataclasses
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from vlp16emu.extras.compare import Sequences

SEQUENCES = 600
"""Firing sequences of a window: 25 packets of single return."""
PATCH, PATCHES = 12, 128
"""Records of a patch, all of one laser, and patches taken of a window."""
FLAT_LSB = 20
"""Most change of range between neighbours on one surface: 40 mm."""
LEVELS = (0, 5, 20, 60, 101)
CODES = (0, 1, 2, 4, 8, 15, 30, 45, 60, 75, 90, 100, 101, 256)
CHANGES = (0, 1, 2, 3, 6, 13, 256)
RUNS = (1, 2, 3, 4, 8, 601)
LAGS = (1, 2, 3, 4)
LEAST = 30
"""Values from which on a feature is worth its name."""

Features = dict[str, float]
Array = np.ndarray


def windows(whole: Sequences) -> Iterator[Sequences]:
    """Cut a capture into windows side by side, without those that have a gap."""
    per_packet = len(whole.number) // len(whole.packet)
    packets = SEQUENCES // per_packet
    for first in range(0, len(whole.packet) - packets + 1, packets):
        of_packet = slice(first, first + packets)
        sequences, blocks = slice(first * per_packet, (first + packets) * per_packet), per_packet // 2
        of_block = slice(first * blocks, (first + packets) * blocks)
        if whole.packet[first + packets - 1] - whole.packet[first] == packets - 1:
            yield dataclasses.replace(
                whole,
                number=whole.number[sequences],
                distance_lsb=whole.distance_lsb[sequences],
                reflectivity=whole.reflectivity[sequences],
                azimuth_cdeg=whole.azimuth_cdeg[of_block],
                block=whole.block[of_block],
                clock_ns=whole.clock_ns[of_packet],
                stamp_ns=whole.stamp_ns[of_packet],
                packet=whole.packet[of_packet],
            )


def features_of(window: Sequences) -> Features:
    """Return features of a window by name; those of which it has too little are NaN."""
    d, r = window.distance_lsb, window.reflectivity
    return (
        _ranges(d, r, window.number)
        | _codes(d, r)
        | _losses(d, r)
        | _no_returns(d, r)
        | _azimuths(window)
        | _stamps(window)
        | {"scene.returns": float((d > 0).mean()), "scene.range": float(np.median(d[d > 0])) if d.any() else np.nan}
    )


def patches_of(window: Sequences, draw: np.random.Generator) -> tuple[Array, Array]:
    """Take patches of records of one laser as they are (PATCHES, channels), NaN where there is none, with their strata.

    Changes of range, codes of returns less their median, codes of no-returns over the commonest of the laser, codes of the
    lasers before and after, and steps of the azimuth. A stratum says what stood there: level, range, returns and edges.
    """
    d, r = window.distance_lsb, window.reflectivity
    first, laser = draw.integers(0, len(d) - PATCH, PATCHES), draw.integers(0, 16, PATCHES)
    row = first[:, None] + np.arange(PATCH)
    distance, code = (of[row, laser[:, None]].astype(float) for of in (d, r))
    seen = distance > 0
    returned, silent = np.where(seen, code, np.nan), np.where(seen, np.nan, code)
    level = np.nan_to_num(_row_median(returned), nan=0.0)
    change = np.diff(np.where(seen, distance, np.nan), axis=1)
    beside = [_beside(d, r, row, (laser + by) % 16)[:, 5:7] - level[:, None] for by in (1, -1)]
    steps = np.diff(window.azimuth_cdeg)[np.minimum(row[:, ::2] // 2, len(window.azimuth_cdeg) - 2)]
    silent /= np.maximum(commonest(d, r)[laser], 1)[:, None]
    raw = np.concatenate([change, returned - level[:, None], silent, *beside, steps, level[:, None]], axis=1)
    edges = np.nan_to_num(np.abs(change), nan=0.0).max(axis=1)
    far = _row_median(np.where(seen, distance, np.nan))
    parts = (
        np.digitize(level, (2, 4, 8, 15, 30, 60)),
        np.digitize(seen.sum(axis=1), (1, 9, 11, 12)),
        np.digitize(edges, (FLAT_LSB, 150, 700)),
        np.digitize(np.nan_to_num(far), (1, 1000, 3000)),
    )
    stratum = np.zeros(PATCHES, int)
    for part in parts:
        stratum = 10 * stratum + part
    return raw.astype(np.float32), stratum


def _row_median(of: Array) -> Array:
    """Return the median of what is no NaN in each row, NaN where there is nothing."""
    order, count = np.sort(of, axis=1), np.isfinite(of).sum(axis=1)
    return np.where(count > 0, order[np.arange(len(of)), np.maximum(count - 1, 0) // 2], np.nan)


def _beside(d: Array, r: Array, row: Array, laser: Array) -> Array:
    return np.where(d[row, laser[:, None]] > 0, r[row, laser[:, None]], np.nan)


def commonest(d: Array, r: Array) -> Array:
    """Return the commonest code of each laser's no-returns (16,), 0 where there is none."""
    return np.array(
        [np.bincount(codes[of == 0]).argmax() if (of == 0).any() else 0 for codes, of in zip(r.T, d.T, strict=True)]
    )


def _shape(name: str, of: Array) -> Features:
    """Width and shape of a distribution."""
    if len(of) < LEAST or not of.std():
        return dict.fromkeys((f"{name}.sd", f"{name}.kurtosis", f"{name}.skew", f"{name}.tail"), np.nan)
    z = (of - of.mean()) / of.std()
    low, high = np.quantile(z, (0.25, 0.75))
    return {
        f"{name}.sd": float(of.std()),
        f"{name}.kurtosis": float((z**4).mean()),
        f"{name}.skew": float((z**3).mean()),
        f"{name}.tail": float(high - low),
    }


def _shares(name: str, of: Array, edges: tuple[int, ...]) -> Features:
    """Histogram with named classes."""
    counts = np.histogram(of, (*edges,))[0]
    total = counts.sum()
    return {
        f"{name}.{low}": float(count / total) if total >= LEAST else np.nan
        for low, count in zip(edges, counts, strict=False)
    }


def _lags(name: str, of: Array, valid: Array) -> Features:
    """Autocorrelation along the first axis, of what is valid."""
    out = {}
    for lag in LAGS:
        both = valid[lag:] & valid[:-lag]
        a, b = of[lag:][both], of[:-lag][both]
        out[f"{name}.lag_{lag}"] = (
            float((a * b).mean() / np.sqrt((a * a).mean() * (b * b).mean()))
            if both.sum() >= LEAST and a.any() and b.any()
            else np.nan
        )
    return out


def _unevenness(name: str, of: Array, moduli: tuple[int, ...]) -> Features:
    """Variance of the counts of residues as a share of their mean, less what chance gives."""
    out = {}
    for modulus in moduli:
        counts = np.bincount(of % modulus, minlength=modulus)
        mean = counts.mean()
        out[f"{name}.mod_{modulus}"] = float((counts.var() - mean) / mean**2) if mean >= LEAST else np.nan
    return out


def _flat(d: Array) -> Array:
    """Where (n - 2, 16) three records in a row are on one surface."""
    step = np.abs(np.diff(d, axis=0)) < FLAT_LSB
    return (d[:-2] > 0) & (d[1:-1] > 0) & (d[2:] > 0) & step[:-1] & step[1:]


def _ranges(d: Array, r: Array, number: Array) -> Features:
    flat, bend, level = _flat(d), np.diff(d, 2, axis=0).astype(float), r[1:-1]
    out = _shape("range.bend", bend[flat]) | _lags("range.bend", bend, flat)
    for low, high in pairwise(LEVELS):
        at = flat & (level >= low) & (level < high)
        out |= {key: value for key, value in _shape(f"range.at_{low}", bend[at]).items() if "skew" not in key}
    slot = (24 * number[1:-1, None] + np.arange(16)) % 5
    means = [
        bend[flat & (slot == which)].mean() if (flat & (slot == which)).sum() >= LEAST else np.nan for which in range(5)
    ]
    out["range.beat"] = float(np.std(means))
    out["range.overtone"] = float(abs(np.fft.fft(means)[2]))
    out |= _unevenness("range", d[d > 0], (2, 4, 5, 8, 10))
    code_bend = np.diff(r, 2, axis=0).astype(float)
    both = flat & (code_bend != 0)
    out["range.with_code"] = float(np.corrcoef(bend[both], code_bend[both])[0, 1]) if both.sum() >= LEAST else np.nan
    return out


def _codes(d: Array, r: Array) -> Features:
    flat, level = _flat(d), r[1:-1]
    change, bend = np.abs(r[2:] - r[1:-1]), np.diff(r, 2, axis=0).astype(float)
    out = _shares("scene.code", r[d > 0], CODES) | _unevenness("code", r[d > 0], (2, 3, 5))
    for low, high in pairwise(LEVELS):
        at = flat & (level >= low) & (level < high)
        out |= _shares(f"code.change_at_{low}", change[at], CHANGES)
        out |= _lags(f"code.at_{low}", bend, at) | _shape(f"code.at_{low}", bend[at] / level[at].clip(1))
    upwards = np.r_[0:16:2, 1:16:2]
    bright, log = (d > 0) & (r >= 5) & (r < 90), np.log(r.clip(1))[:, upwards]
    bright = bright[:, upwards]
    same = bright[:, :-2] & bright[:, 1:-1] & bright[:, 2:]
    ratio = log[:, 1:-1] - (log[:, 2:] + log[:, :-2]) / 2
    own = [column[of].mean() if of.sum() >= LEAST else np.nan for column, of in zip(ratio.T, same.T, strict=True)]
    out["code.between_lasers"] = float(np.nanstd(own)) if np.isfinite(own).sum() > 4 else np.nan
    return out


def _losses(d: Array, r: Array) -> Features:
    out, silent = {}, d == 0
    for name, of in (("silent_run", silent), ("run", ~silent)):
        edge = np.diff(np.pad(of, ((1, 1), (0, 0))).astype(int), axis=0).T
        begin, end = np.nonzero(edge == 1), np.nonzero(edge == -1)
        out |= _shares(f"loss.{name}", end[1] - begin[1], RUNS)
    a, middle, c = d[:-2], d[1:-1], d[2:]
    step, code_step = np.abs(c - a), np.abs(r[2:] - r[:-2])
    both = (a > 0) & (c > 0)
    places = {
        "flat": (step < 15) & (code_step < 10),
        "bright_step": (step < 15) & (code_step >= 20),
        "step": (step >= 150) & (step < 700),
        "far_step": step >= 700,
        "small_step": (step >= 20) & (step < 150),
    }
    for name, at in places.items():
        out[f"loss.at_{name}"] = float((middle[both & at] == 0).mean()) if (both & at).sum() >= LEAST / 3 else np.nan
    for low, high in pairwise(LEVELS):
        at = (a > 0) & (r[:-2] >= low) & (r[:-2] < high)
        out[f"loss.after_{low}"] = float((middle[at] == 0).mean()) if at.sum() >= LEAST else np.nan
    return out


def _no_returns(d: Array, r: Array) -> Features:
    silent, mode = d == 0, commonest(d, r)
    share = r / np.maximum(mode, 1)
    usable = silent & (mode > 0)
    before, after = ~silent[:-2] & usable[1:-1], ~silent[2:] & usable[1:-1]
    beside, apart = before | after, usable[1:-1] & silent[:-2] & silent[2:]
    out = {}
    for name, at in (("beside", beside), ("apart", apart)):
        counts = np.histogram(share[1:-1][at], (0, 0.01, 0.9, 1.1, 1.9, 2.9, 256))[0]
        out |= {
            f"no_return.{name}_{i}": float(count / at.sum()) if at.sum() >= LEAST else np.nan
            for i, count in enumerate(counts)
        }
    code = np.maximum(np.where(silent[:-2], 0, r[:-2]), np.where(silent[2:], 0, r[2:]))
    pair = np.log(np.stack([share[1:-1][beside].clip(0.1), code[beside].clip(1)]))
    out["no_return.with_neighbour"] = (
        float(np.corrcoef(pair)[0, 1]) if beside.sum() >= LEAST and pair.std(axis=1).all() else np.nan
    )
    out["no_return.above_100"] = float((r[silent] > 100).mean()) if silent.sum() >= LEAST else np.nan
    both = silent[1:] & silent[:-1]
    out["no_return.equal"] = float((r[1:] == r[:-1])[both].mean()) if both.sum() >= LEAST else np.nan
    return out


def _azimuths(window: Sequences) -> Features:
    azimuth = window.azimuth_cdeg
    step = np.diff(azimuth)
    line = np.polyfit(np.arange(len(azimuth)), azimuth, 3)
    rest = azimuth - np.polyval(line, np.arange(len(azimuth)))
    speed = step.mean()
    out = {f"azimuth.step_{by:+d}": float((np.rint(step - speed) == by).mean()) for by in range(-3, 4)}
    out |= (
        _shape("azimuth", rest)
        | _lags("azimuth", step - speed, np.ones(len(step), bool))
        | _unevenness("azimuth", azimuth, (2, 5))
    )
    counts = np.bincount(azimuth % 20, minlength=20) / len(azimuth)
    out |= {"azimuth.mod_20": float(counts.std()), "azimuth.mod_20_least": float(counts.min())}
    out["azimuth.variance"] = float(step.var() - speed % 1 * (1 - speed % 1))
    power = np.abs(np.fft.rfft(rest * np.hanning(len(rest)))) ** 2
    power /= power.sum()
    out |= {f"azimuth.band_{i}": float(band.sum()) for i, band in enumerate(np.array_split(power[3:], 12))}
    out["azimuth.line"] = float(np.abs(np.exp(2j * np.pi * 0.16 * np.arange(len(rest))) @ rest) * 2 / len(rest))
    return out


def _stamps(window: Sequences) -> Features:
    clock_us, arrival_us = window.clock_ns / 1e3, window.stamp_ns / 1e3
    period_us = window.packet_us
    late_us = (arrival_us - arrival_us[0]) - (clock_us - clock_us[0])
    return {
        "stamp.long": float((np.diff(clock_us) > period_us).mean()),
        "stamp.rest": float((clock_us - np.polyval(np.polyfit(window.packet, clock_us, 1), window.packet)).std()),
        "stamp.drift": float(np.polyfit(window.packet, clock_us, 1)[0] / period_us - 1),
        "arrival.least_us": float(np.diff(late_us).min()),
        "arrival.median_us": float(np.median(np.abs(np.diff(late_us)))),
        "arrival.sd_us": float(np.diff(late_us).std()),
        "arrival.late": float((np.abs(np.diff(late_us)) > 10).mean()),
        "arrival.lag_s": float((arrival_us[0] - clock_us[0]) % 3.6e9 / 1e6),
        "arrival.lag_periods": float((arrival_us[0] - clock_us[0]) % 3.6e9 / period_us < 2),
    }
