"""Statistics for `tools/unmask` that explain what its trees find: one row each, with what they say.

They come from packets alone: losses and their places, steps of codes, gain by sector, noise with texture,
ends of the scale, parity, clock. Each is explained by a known trait of the sensor; the trees are the measure.
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from unmask_windows import UPWARDS, Array, turn_later

from vlp16emu.extras.compare import Sequences
from vlp16emu.extras.compare.statistics import stretches_of
from vlp16emu.packets.layout import AZIMUTH_CODES

M_LSB = 500
"""Codes of range in a metre."""
CALM = 3
"""Records on each side of one that are on its surface."""
LEAST, LEAST_RARE, LEAST_OF_RINGS = 60, 8, 6
"""Least number of records or pairs for a share, of losses or classes for one of them, and of stretches for
the middle of a ratio of rings."""
SURFACE_LSB = 12
RUN_BETWEEN_LSB, LONGEST_RUN = 15, 10
PULSES, SMOOTH_MM = 15, 14.0
POWERS = np.vander(np.arange(PULSES) - PULSES // 2, 4).astype(float)
WITHOUT_CUBIC = np.eye(PULSES) - POWERS @ np.linalg.pinv(POWERS)


class Capture(NamedTuple):
    """Columns of a capture from which the rows are computed."""

    sequences: Sequences
    found: Mapping[str, float]
    """Statistics of `vlp16emu compare`."""

    @property
    def d(self) -> Array:
        """Ranges (n, 16) in codes of 2 mm."""
        return self.sequences.distance_lsb

    @property
    def r(self) -> Array:
        """Reflectivities (n, 16)."""
        return self.sequences.reflectivity


def share(of: Array, least: int = LEAST) -> float:
    """Return the share of True, or NaN for too few."""
    return float(of.mean()) if of.size >= least else math.nan


def calm(one: Capture, codes: tuple[int, int], nearest_lsb: int) -> tuple[Array, Array]:
    """Return masks (n - 6, 16) of records between calm ones, by mean code and range, and of those lost."""
    count = len(one.d) - 2 * CALM
    of_d, of_r = (np.stack([v[i : count + i] for i in range(2 * CALM + 1)]) for v in (one.d, one.r))
    around = np.arange(2 * CALM + 1) != CALM
    level = of_r[around].mean(axis=0)
    still = (of_d[around] > 0).all(axis=0) & (np.ptp(of_d[around], axis=0) < 25)
    still &= np.ptp(of_r[around], axis=0) <= np.maximum(4, 0.2 * level)
    still &= (level >= codes[0]) & (level < codes[1]) & (of_d[around].mean(axis=0) >= nearest_lsb)
    return still, still & (of_d[CALM] == 0)


def calm_lost(low: int, high: int) -> Callable[[Capture], float]:
    """Return the row of losses per thousand calm records from 1 m on."""

    def row(one: Capture) -> float:
        still, lost = calm(one, (low, high), M_LSB)
        return 1e3 * share(lost[still])

    return row


def lost_places(one: Capture) -> tuple[Array, Array]:
    """Return sequence and laser (m,) of records that are lost between calm ones, of any code."""
    at, laser = np.nonzero(calm(one, (0, 256), 0)[1])
    return at + CALM, laser


def lost_again(away: int) -> Callable[[Capture], float]:
    """Return the row of losses that recur a turn later within two records; or so many records away."""

    def row(one: Capture) -> float:
        at, laser = lost_places(one)
        later = turn_later(one.sequences)[at] + away
        inside = (later >= 2) & (later < len(one.d) - 2)
        near = later[inside, None] + np.arange(-2, 3)
        lost = (one.d[near, laser[inside, None]] == 0).sum(axis=1)
        return share((lost >= 1) & (lost <= 4), LEAST_RARE)

    return row


def lost_near(one: Capture) -> float:
    """Return the share of losses between calm records with another of that laser within 30."""
    at, laser = lost_places(one)
    near = (at[:, None] + np.arange(-30, 31)).clip(0, len(one.d) - 1)
    others = (one.d[near, laser[:, None]] == 0) & (near != at[:, None])
    return share(others.any(axis=1), LEAST_RARE)


def lost_runs(one: Capture) -> float:
    """Return the ratio of runs of 2 to 10 lost records to single ones, between equal ranges."""
    single = several = 0
    for ranges in one.d.T:
        edge = np.diff(np.pad(ranges == 0, 1).astype(int))
        start, stop = np.nonzero(edge == 1)[0], np.nonzero(edge == -1)[0]
        inside = (start > 0) & (stop < len(ranges))
        start, stop = start[inside], stop[inside]
        length = (stop - start)[np.abs(ranges[stop] - ranges[start - 1]) < RUN_BETWEEN_LSB]
        single += int((length == 1).sum())
        several += int(((length > 1) & (length <= LONGEST_RUN)).sum())
    return several / single if single >= LEAST_RARE else math.nan


def neighbours(one: Capture, codes: tuple[int, int], ranges_m: tuple[int, int]) -> Array:
    """Return changes of code between neighbours on a surface, from codes and ranges within limits."""
    a, b, code = one.d[:-1], one.d[1:], one.r[:-1]
    on = (a > 0) & (b > 0) & (np.abs(b - a) < SURFACE_LSB)
    on &= (code >= codes[0]) & (code <= codes[1])
    on &= (a >= ranges_m[0] * M_LSB) & (a < ranges_m[1] * M_LSB)
    return np.abs(np.diff(one.r, axis=0))[on]


def equal_codes(one: Capture) -> float:
    """Return the share of neighbours of equal code, codes 12 to 29 at 8 to 16 m."""
    return share(neighbours(one, (12, 29), (8, 16)) == 0)


def by_one(codes: tuple[int, int], ranges_m: tuple[int, int]) -> Callable[[Capture], float]:
    """Return the row of changes by 1 among those by 1 to 3."""

    def row(one: Capture) -> float:
        change = neighbours(one, codes, ranges_m)
        return share(change[(change >= 1) & (change <= 3)] == 1)

    return row


def change_on_smooth(low: int, high: int) -> Callable[[Capture], float]:
    """Return the row of changes of code within limits, on smooth surfaces of codes 15 to 29."""

    def row(one: Capture) -> float:
        stretches = stretches_of(one.sequences)
        if stretches is None:
            return math.nan
        first = stretches.codes[:, :-1]
        change = np.abs(np.diff(stretches.codes, axis=1))[(first >= 15) & (first <= 29)]
        return share((change >= low) & (change <= high))

    return row


def equal_on_smooth(one: Capture) -> float:
    """Return the share of neighbours of equal code, codes 12 to 29, on smooth surfaces from 4 to 16 m."""
    d, r = in_stretches(one)
    far = (d[:, 0] >= 4 * M_LSB) & (d[:, 0] < 16 * M_LSB)
    code = r[:, :-1]
    chosen = (smooth_stretches(d) & far)[:, None] & (code >= 12) & (code <= 29)
    return share((np.diff(r, axis=1) == 0)[chosen])


def in_stretches(one: Capture) -> tuple[Array, Array]:
    """Return ranges and codes (s, 15, 16) in stretches of pulses, lasers upwards."""
    count = len(one.d) // PULSES
    shape = (count, PULSES, 16)
    d, r = (v[: count * PULSES].reshape(shape)[:, :, UPWARDS] for v in (one.d, one.r))
    return d, r


def smooth_stretches(d: Array) -> Array:
    """Return a mask (s, 16) of the stretches (s, 15, 16) in codes of range that are on one smooth surface."""
    rest = np.einsum("ij,njl->nil", 2.0 * WITHOUT_CUBIC, d)
    return np.asarray(((rest**2).mean(axis=1) < SMOOTH_MM**2) & (d > 0).all(axis=1))


def ring_ratios(one: Capture) -> tuple[Array, Array, Array]:
    """Return mask, range in codes, and logarithm of the ratio of codes of rings (s, 15) on one plane."""
    d, r = in_stretches(one)
    smooth = smooth_stretches(d) & (r.min(axis=1) > 12) & (r.max(axis=1) < 100)
    range_lsb, level = d.mean(axis=1), r.mean(axis=1).clip(1)
    low, high = slice(None, -1), slice(1, None)
    same = smooth[:, low] & smooth[:, high]
    same &= np.abs(range_lsb[:, low] / range_lsb[:, high].clip(1) - 1) < 0.04
    return same, range_lsb[:, low], np.log(level[:, low] / level[:, high])


def ratio_by_range(low_m: float, high_m: float) -> Callable[[Capture], float]:
    """Return the row of the spread of that ratio over pairs of rings and classes of 0.25 e-folds of range."""

    def row(one: Capture) -> float:
        same, range_lsb, ratio = ring_ratios(one)
        at_m = range_lsb.clip(1) / M_LSB
        same &= (at_m >= low_m) & (at_m < high_m)
        place = np.floor(4.0 * np.log(at_m)).astype(int)
        middles = [
            np.median(ratio[chosen, pair])
            for pair in range(15)
            for which in np.unique(place[same[:, pair], pair])
            if (chosen := same[:, pair] & (place[:, pair] == which)).sum() >= LEAST_OF_RINGS
        ]
        return float(np.std(middles)) if len(middles) >= LEAST_RARE else math.nan

    return row


def ring_ratio(one: Capture) -> float:
    """Return the spread over sectors of 45 degrees of the logarithm of the ratio of neighbouring rings."""
    same, _, ratio = ring_ratios(one)
    count = len(one.d) // PULSES
    azimuth = azimuths(one.sequences)[: count * PULSES : PULSES]
    sector = azimuth % AZIMUTH_CODES * 8 // AZIMUTH_CODES
    spreads = []
    for pair in range(15):
        middles = [
            np.median(ratio[chosen, pair])
            for which in range(8)
            if (chosen := same[:, pair] & (sector == which)).sum() >= LEAST_OF_RINGS
        ]
        if len(middles) >= 2:
            spreads.append(np.var(middles, ddof=1))
    return float(np.sqrt(np.mean(spreads))) if len(spreads) >= 3 else math.nan


def azimuths(sequences: Sequences) -> Array:
    """Return the unwrapped azimuth of each sequence (n,)."""
    return np.interp(sequences.number, 2 * sequences.block, sequences.azimuth_cdeg)


def noise_with_texture(one: Capture) -> float:
    """Return the correlation of the logarithms of range noise and scatter of code, over stretches."""
    stretches = stretches_of(one.sequences)
    if stretches is None:
        return math.nan
    level = stretches.level
    scatter = np.sqrt((stretches.code_residual**2).mean(axis=1)) / level.clip(1)
    sigma = np.sqrt((stretches.residual_mm**2).mean(axis=1))
    chosen = (level >= 10) & (level < 90) & (scatter > 0) & (sigma > 0)
    if chosen.sum() < LEAST:
        return math.nan
    return float(np.corrcoef(np.log(sigma[chosen]), np.log(scatter[chosen]))[0, 1])


def codes_between(low: int, high: int) -> Callable[[Capture], float]:
    """Return the row of returns with codes within limits, in percent."""

    def row(one: Capture) -> float:
        codes = one.r[one.d > 0]
        return 100.0 * share((codes >= low) & (codes <= high))

    return row


def above_100(low: int, high: int) -> Callable[[Capture], float]:
    """Return the row of no-returns above 100 beside a return whose code is within limits, or the brighter."""

    def row(one: Capture) -> float:
        code = np.where(one.d > 0, one.r, -1)
        beside = np.maximum(code[2:], code[:-2])
        chosen = (one.d[1:-1] == 0) & (beside >= low) & (beside <= high)
        return 100.0 * share(one.r[1:-1][chosen] > 100, LEAST_RARE)

    return row


def even_differences(one: Capture) -> float:
    """Return the share of even differences of neighbouring ranges of equal code."""
    apart, change = (np.abs(np.diff(v, axis=0)) for v in (one.d, one.r))
    on = (one.d[1:] > 0) & (one.d[:-1] > 0) & (apart < SURFACE_LSB) & (change == 0)
    return share(apart[on] % 2 == 0)


def odd_ranges(one: Capture) -> float:
    """Return the share of odd ranges of all lasers."""
    return share(one.d[one.d > 0] % 2 == 1)


def even_scatter(one: Capture) -> float:
    """Return the lower quartile of the scatter of codes over their level, on smooth surfaces of 30 to 60."""
    stretches = stretches_of(one.sequences)
    if stretches is None:
        return math.nan
    chosen = (stretches.level >= 30) & (stretches.level <= 60)
    rest = stretches.code_residual[chosen]
    scatter = np.sqrt((rest**2).sum(axis=1) / (PULSES - 4)) / stretches.level[chosen]
    return float(np.quantile(scatter, 0.25)) if len(scatter) >= LEAST else math.nan


ROWS: Mapping[str, Callable[[Capture], float]] = {
    "1. lost between calm records of codes from 20, from 1 m, per 1000": calm_lost(20, 256),
    "the same below code 4": calm_lost(0, 4),
    "the same at codes 4 to 19": calm_lost(4, 20),
    "2. the place lost again a turn later (at rest)": lost_again(0),
    "the same 25 records beside it": lost_again(25),
    "3. another loss of that laser within 30 records": lost_near,
    "4. runs of 2 to 10 lost over single ones, between equal ranges": lost_runs,
    "5. neighbours of equal code, codes 12 to 29, 8 to 16 m": equal_codes,
    "the same on smooth surfaces, 4 to 16 m": equal_on_smooth,
    "6. changes by 1 of those by 1 to 3: the same": by_one((12, 29), (8, 16)),
    "the same, codes 4 to 11, 4 to 8 m": by_one((4, 11), (4, 8)),
    "7. changes of code by 1, smooth surfaces, codes 15 to 29": change_on_smooth(1, 1),
    "the same by 4 and more": change_on_smooth(4, 256),
    "scatter over level at 30 to 60, P25": even_scatter,
    "8. ln of the ratio of neighbouring rings, sd over sectors": ring_ratio,
    "the same over pairs and ranges, 0.7 to 2.5 m": ratio_by_range(0.7, 2.5),
    "the same, 2.5 to 5 m": ratio_by_range(2.5, 5.0),
    "the same, from 5 m": ratio_by_range(5.0, 100.0),
    "9. correlation of range noise and scatter of code": noise_with_texture,
    "10. codes 1 and 2, %": codes_between(1, 2),
    "code 0, %": codes_between(0, 0),
    "11. codes above 100, %": codes_between(101, 255),
    "no-returns above 100 beside codes 5 to 39, %": above_100(5, 39),
    "the same beside 40 to 79": above_100(40, 79),
    "the same beside 80 to 100": above_100(80, 100),
    "12. even differences of neighbouring ranges, equal code": even_differences,
    "odd ranges of all lasers": odd_ranges,
    "13. sensor's clock against its firings, ppm": lambda one: one.found.get("clock.error_ppm", math.nan),
}
"""Rows by name, in the order of what they explain."""
