"""Worlds with a medium from some distance on, held against the explicit one as distributions.

All worlds meet the same pulses, drawn in groups. Pulses of a group see the same trees and are not independent, so groups
are what is drawn anew by the bootstrap, and the same draws serve all worlds: an interval is that of a difference over the
pulses of the run, in this one forest. Tests take their law under the null hypothesis from the same draws, centred on what
was found (Efron and Tibshirani, "An Introduction to the Bootstrap", 1993, section 16.4), which is what an effective sample
size stands for; the chi-square is scaled to the mean of that law, as Rao and Scott do (JASA 76, 1981).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from vlp16emu.accuracy.compare import BANDS_M, FINE_M, GAP_M, HEIGHTS_M, Counts

Array = NDArray[np.float64]
Values = dict[tuple[str, str], Array]

_DRAWS, _OUTSIDE = 1000, (0.025, 0.975)
_SEAM_M = 3.0
RETURNS, HEIGHTS = "returns per 1000 pulses, by range", "first returns, % by height over the ground"


@dataclass(frozen=True, slots=True)
class Statistic:
    """One statistic in all worlds, the explicit one last."""

    section: str
    name: str
    values: tuple[float, ...]
    low: tuple[float, ...]
    """Where the difference from the explicit world lies with 95 % confidence; of that world itself, its value."""
    high: tuple[float, ...]

    def departs(self, world: int) -> bool:
        """Whether a world differs from the explicit one by more than chance."""
        return not self.low[world] <= 0.0 <= self.high[world]


@dataclass(frozen=True, slots=True)
class Test:
    """A distribution in all worlds but the explicit one, held against that one."""

    name: str
    kind: str
    """`KS` or `chi2`."""
    distance: tuple[float, ...]
    """Greatest difference of cumulative shares, or chi-square by Rao and Scott."""
    p: tuple[float, ...]
    """How often chance alone gives more."""


@dataclass(frozen=True, slots=True)
class Distributions:
    """Worlds with a medium held against the explicit one."""

    names: tuple[str, ...]
    """Of worlds, the explicit one last."""
    in_use: tuple[bool, ...]
    pulses: int
    groups: int
    rays: int
    """Sub-rays of a pulse."""
    us_per_pulse: tuple[float, ...]
    """Run time of casting with those, on one core."""
    statistics: tuple[Statistic, ...]
    tests: tuple[Test, ...]


def distributions_of(
    worlds: Mapping[float, Counts],
    *,
    seed: int,
    lasers: Sequence[str],
    species: Mapping[int, str],
) -> tuple[tuple[Statistic, ...], tuple[Test, ...]]:
    """Hold worlds against the explicit one.

    Parameters
    ----------
    worlds : counts by clusters, (clusters, bins), of each `near_m`, ascending; the last one is explicit
    seed : of what is drawn
    lasers, species : their names
    """
    clusters = len(next(iter(worlds.values())).pulses)
    draws = np.random.default_rng(seed).multinomial(clusters, np.full(clusters, 1 / clusters), _DRAWS)
    weights = np.vstack([np.ones(clusters), draws])
    drawn = [Counts(*(weights @ of for of in counts)) for counts in worlds.values()]
    with np.errstate(invalid="ignore", divide="ignore"):
        values = [_values(counts, lasers, species) for counts in drawn]
        rows = [
            _statistic(*key, [one[key] for one in values])
            for key, explicit in values[-1].items()
            if np.isfinite(explicit[0]) and any(one[key][0] for one in values)
        ]
        seams = [_seam(counts, drawn[-1], near_m) for near_m, counts in zip(worlds, drawn, strict=True)]
        return (*rows, _seam_row(seams)), tuple(_tests(drawn))


def _values(c: Counts, lasers: Sequence[str], species: Mapping[int, str]) -> Values:
    """Give all statistics of counts (draws, bins), each (draws,)."""
    pulses = c.pulses.sum(axis=1)
    out: Values = {
        ("pulses", "with a return, %"): 100 * c.seen.sum(axis=1) / pulses,
        ("pulses", "with two returns, %"): 100 * c.two.sum(axis=1) / pulses,
        ("pulses", "another first return a revolution on, %"): 100 * c.again[:, 1] / c.again[:, 0],
    }
    bands = [f"{low:g}-{high:g} m" for low, high in pairwise(BANDS_M)]
    sections = (
        (RETURNS, c.returns, pulses[:, None] / 1000),
        ("pulses with two returns, % by range of the first", c.two, c.first / 100),
        ("leaf, % of plant returns, by range", c.leaf, c.plant / 100),
        ("reflectivity, mean by range", c.bright, c.returns),
    )
    for section, top, bottom in sections:
        out |= {(section, band): one for band, one in zip(bands, (top / bottom).T, strict=True)}
    out["leaf, % of plant returns", "all"] = 100 * c.leaf.sum(axis=1) / c.plant.sum(axis=1)
    out["reflectivity", "mean"] = c.bright.sum(axis=1) / c.returns.sum(axis=1)
    for share in (0.1, 0.5, 0.9):
        out["reflectivity", f"{share:.0%} are below"] = _quantile(c.reflectivity, share) - 0.5
    for share in (0.1, 0.25, 0.5, 0.75, 0.9):
        out["gap between two returns, m", f"{share:.0%} are below"] = GAP_M * _quantile(c.gap, share)
    for number, low in enumerate(HEIGHTS_M[:-1]):
        out[HEIGHTS, f"{low:g} to {low + 2:g} m"] = 100 * c.height[:, number] / c.height.sum(axis=1)
    for number, name in ((n, name) for n, name in species.items() if n < c.species.shape[1] - 1):
        out["species, % of plant returns", name] = 100 * c.species[:, number] / c.species[:, 1:].sum(axis=1)
    for number, name in enumerate(lasers):
        out["pulses with a return, % by laser", name] = 100 * c.seen[:, number] / c.pulses[:, number]
    return out


def _quantile(counts: Array, share: float) -> Array:
    """Quantiles of histograms (draws, bins), in bins; even within one."""
    cumulative = np.cumsum(counts, axis=1)
    wanted = share * cumulative[:, -1]
    at = (cumulative < wanted[:, None]).sum(axis=1).clip(0, counts.shape[1] - 1)
    rows = np.arange(len(counts))
    inside: Array = at + 1 - (cumulative[rows, at] - wanted) / counts[rows, at]
    return inside


def _statistic(section: str, name: str, values: Sequence[Array]) -> Statistic:
    """Sum up one statistic, (draws,) of each world; the first draw is what was found."""
    apart = [one - values[-1] for one in values[:-1]] + [values[-1]]
    draws = np.array([one[1:] for one in apart])
    known = ~np.isnan(draws).all(axis=1)  # a world may have nothing to take a statistic of
    low, high = interval = np.full((2, len(draws)), np.nan)
    interval[:, known] = np.nanquantile(draws[known], _OUTSIDE, axis=1)
    return Statistic(
        section, name, tuple(float(one[0]) for one in values), tuple(low.tolist()), tuple(high.tolist())
    )


def _seam(counts: Counts, explicit: Counts, near_m: float) -> Array:
    """By how many percent more returns there are 3 m beyond `near_m`, against 3 m before, than in the explicit world."""
    if not np.isfinite(near_m):
        return np.zeros(len(counts.fine))
    edge, wide = round(near_m / FINE_M), round(_SEAM_M / FINE_M)

    def step(fine: Array) -> Array:
        beyond: Array = fine[:, edge : edge + wide].sum(axis=1)
        before: Array = fine[:, max(edge - wide, 0) : edge].sum(axis=1)
        return beyond / before

    return 100 * (step(counts.fine) / step(explicit.fine) - 1)


def _seam_row(seams: Sequence[Array]) -> Statistic:
    """Make the row of steps at `near_m`."""
    return _statistic("seam", "step of the number of returns at near_m, %", seams)


def _tests(drawn: Sequence[Counts]) -> list[Test]:

    def test(
        name: str,
        kind: str,
        distance: Callable[[Array, Array], tuple[float, float]],
        of: Callable[[Counts], Array],
    ) -> Test:
        explicit = of(drawn[-1])
        pairs = [distance(of(counts), explicit) for counts in drawn[:-1]]
        return Test(name, kind, tuple(pair[0] for pair in pairs), tuple(pair[1] for pair in pairs))

    return [
        test("returns over bands of range", "chi2", _chi_square, lambda c: c.returns),
        test("returns over range", "KS", _ks, lambda c: c.fine),
        test("pulses with a return over lasers", "chi2", _chi_square, lambda c: c.seen),
        test("gaps between two returns", "KS", _ks, lambda c: c.gap),
        test("reflectivity", "KS", _ks, lambda c: c.reflectivity),
        test("height of first returns", "KS", _ks, lambda c: c.height),
        test("species, or none", "chi2", _chi_square, lambda c: c.species),
        test("leaf or wood", "chi2", _chi_square, _leaf_and_wood),
    ]


def _leaf_and_wood(c: Counts) -> Array:
    """Plant returns that are leaf, and others, (draws, 2)."""
    leaf, plant = c.leaf.sum(axis=1), c.plant.sum(axis=1)
    return np.stack([leaf, plant - leaf], axis=1)


def _ks(one: Array, other: Array) -> tuple[float, float]:
    """Kolmogorov and Smirnov's distance of histograms (draws, bins), and its p."""
    apart = np.cumsum(_shares(one) - _shares(other), axis=1)
    null = np.abs(apart[1:] - apart[0]).max(axis=1)
    return _with_p(float(np.abs(apart[0]).max()), null)


def _chi_square(one: Array, other: Array) -> tuple[float, float]:
    """Chi-square of classes (draws, classes), scaled so that chance gives the degrees of freedom, and its p."""
    known = (one[0] + other[0]) > 0
    both = (_shares(one) + _shares(other))[0, known] / 2
    apart = (_shares(one) - _shares(other))[:, known]
    null = ((apart[1:] - apart[0]) ** 2 / both).sum(axis=1)
    scale = (known.sum() - 1) / null.mean() if null.any() else 1.0
    return _with_p(float((apart[0] ** 2 / both).sum() * scale), null * scale)


def _shares(counts: Array) -> Array:
    """Histograms (draws, bins) that sum to 1."""
    shares: Array = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    return shares


def _with_p(distance: float, null: Array) -> tuple[float, float]:
    return distance, float((1 + (null >= distance).sum()) / (1 + len(null)))
