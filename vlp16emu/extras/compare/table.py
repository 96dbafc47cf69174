"""Two captures side by side: each statistic, how far apart they are, and the picture."""

import math
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import IO, TYPE_CHECKING, NamedTuple

import numpy as np

from vlp16emu.extras.compare.sequences import Sequences
from vlp16emu.extras.compare.statistics import local, statistics_of, stretches_of, turning_of
from vlp16emu.extras.plots import plotted

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_OF_ONE_UNIT = 2.0


class Known(NamedTuple):
    """A statistic, and what real units show of it."""

    low: float
    high: float
    text: str  # its name in reports, with the unit of its values

    @property
    def limits(self) -> tuple[float, float]:
        """Least and greatest value widened by half of the range; where both are above 0 by ratios, and of one unit by a factor of two."""
        low, high, _ = self
        if low > 0.0:
            factor = math.sqrt(high / low) if high > low else _OF_ONE_UNIT
            return low / factor, high * factor
        return low - (high - low) / 2, high + (high - low) / 2

    def is_like(self, value: float) -> bool:
        """Return whether real units may show a value."""
        low, high = self.limits
        return low <= value <= high

    def with_values(self, values: Iterable[float]) -> "Known":
        """Return the same with what more units show."""
        every = [self.low, self.high, *values]
        return self._replace(low=min(every), high=max(every))


REAL: Mapping[str, Known] = MappingProxyType(
    {
        "range.beat_mm": Known(3.813, 7.112, "beat of the ranges, mm"),
        "range.white_at_20_mm": Known(5.841, 8.016, "white noise of range at code 20, mm"),
        "range.kurtosis": Known(-0.2951, -0.2583, "its excess kurtosis within 15 pulses"),
        "range.with_reflectivity": Known(-0.0146, 0.1577, "correlation of the noises of range and code"),
        "reflectivity.equal_1_4": Known(0.6129, 0.7742, "equal neighbours at codes 1 to 4"),
        "reflectivity.scatter_1_4": Known(0.5513, 1.228, "scatter of codes 1 to 4"),
        "reflectivity.equal_60_99": Known(0.2145, 0.3542, "equal neighbours at codes 60 to 99"),
        "reflectivity.scatter_60_99": Known(2.796, 3.355, "scatter of codes 60 to 99"),
        "reflectivity.comb": Known(2.173, 2.675, "ruggedness of bright codes"),
        "reflectivity.top_codes": Known(0.01113, 0.1743, "share of codes 90 to 100"),
        "reflectivity.texture_4_15": Known(0.0861, 0.1668, "scatter over level at codes 4 to 15"),
        "reflectivity.texture_spread": Known(4.69, 6.154, "the same at 30 to 60, P90 over P25"),
        "reflectivity.gain_spread": Known(0.05659, 0.09672, "spread of the gain over lasers"),
        "lost.on_a_surface": Known(0.0008893, 0.004449, "records lost on a surface"),
        "lost.at_code_steps": Known(0.01231, 0.05153, "records lost at 20 codes and more"),
        "lost.at_steps_below_1.4_m": Known(0.08108, 0.2859, "records lost at steps of 0.3 to 1.4 m"),
        "lost.at_steps_above_1.4_m": Known(0.1512, 0.6111, "records lost at steps of more"),
        "no_return.above_0": Known(0.7794, 1, "no-returns of code above 0"),
        "no_return.above_100": Known(0.008562, 0.03873, "no-returns beside returns, above 100"),
        "no_return.equal": Known(0.7814, 0.9935, "equal neighbours among no-returns"),
        "no_return.mean": Known(3.0, 57.0, "mean code of no-returns"),
        "no_return.raised_beside_bright": Known(0.3272, 0.8882, "no-returns raised beside bright returns"),
        "no_return.raised_once": Known(0.7246, 0.8522, "raised runs that are one record long"),
        "rotation.speed_off_percent": Known(0.003427, 0.1559, "mean speed off, percent"),
        "rotation.once_cdeg": Known(3.313, 9.478, "azimuth once per turn, cdeg"),
        "rotation.twice_cdeg": Known(0.5751, 0.965, "azimuth twice per turn, cdeg"),
        "rotation.tick_us": Known(0.9391, 1.325, "sawtooth of the reading, us"),
        "rotation.reading_cdeg": Known(0.5642, 0.6016, "noise of the reading, cdeg"),
        "rotation.excess_variance": Known(0.5184, 0.5673, "variance of steps over an even ruler's"),
        "rotation.rarest_of_five": Known(0.1362, 0.154, "rarest azimuth modulo 5"),
        "rotation.uneven_of_twenty": Known(0.2474, 0.3132, "unevenness of azimuths modulo 20"),
        "rotation.short_steps": Known(0.0, 1.2e-4, "steps below 38 cdeg at 600 rpm"),
        "rotation.speed_sd_percent": Known(0.002295, 0.01741, "scatter of the speed of turns, percent"),
        "residue.odd_spread": Known(0.07482, 0.1666, "odd ranges, spread over lasers"),
        "residue.mod_4": Known(0.005477, 0.01426, "unevenness of ranges modulo 4"),
        "dual.one_without": Known(0.005053, 0.005053, "pairs with one return of two"),
        "dual.unequal_no_returns": Known(0.0006483, 0.0006483, "no-returns of unequal code in a pair"),
        "clock.error_ppm": Known(-0.9034, 140, "sensor's clock against its firings, ppm"),
        "clock.host_ppm": Known(-15, 20.51, "host's clock against the sensor's, ppm"),
        "clock.arrival_us": Known(14.08, 161.8, "unevenness of arrivals, us"),
    }
)
"""Statistics of real units: mrpt, nebula, einride and a unit of 2014, before release; protocol/README.md, "The character of
a unit". The mean of no-returns and the rates of both clocks are those of nine units; no step is below 38 cdeg in 24 500."""

_SIZE_PX = 1100, 750
_TITLES = (
    "range error, mm, by pulse modulo 5",
    "azimuth, cdeg, by cycles per block",
    "step of the azimuth, cdeg",
    "reflectivity of returns",
)
_LEAST_SPREAD = 0.25
"""Least spread as a share of the greatest value: four units that agree more closely do not show what a fifth does."""


class Compared(NamedTuple):
    """One statistic of two captures."""

    name: str  # name with the unit of the values, if they have one
    text: str  # its name in reports
    first: float
    second: float
    distance: float  # difference as a multiple of the spread of real units
    apart: bool  # real units do not differ so much
    unlike: tuple[bool, bool]  # true for each that is outside what real units show, widened by half


def compared(first: Sequences, second: Sequences) -> list[Compared]:
    """Compare two captures by the statistics that both of them have."""
    one, other = statistics_of(first), statistics_of(second)
    rows = []
    for name in (name for name in one if name in other and name in REAL):
        known, values = REAL[name], (one[name], other[name])
        distance = abs(values[0] - values[1]) / max(known.high - known.low, _LEAST_SPREAD * abs(known.high), 1e-9)
        unlike = not known.is_like(values[0]), not known.is_like(values[1])
        rows.append(Compared(name, known.text, *values, distance, distance > 1.0, unlike))
    return rows


def draw(file: IO[bytes], first: Sequences, second: Sequences, names: tuple[str, str]) -> None:
    """Draw beat of the ranges, spectrum of the azimuth, its steps, and histogram of reflectivity as a PNG; `names` in its legend."""
    with plotted(file, _SIZE_PX) as figure:
        axes = figure.subplots(2, 2).ravel()
        for sequences, name in zip((first, second), names, strict=True):
            _draw_one(axes, sequences, name)
        for axis, title in zip(axes, _TITLES, strict=True):
            axis.set_title(title)
            axis.legend(frameon=False)


def _draw_one(axes: "list[Axes]", sequences: Sequences, name: str) -> None:
    beat, spectrum, steps, reflectivity = axes
    if (stretches := stretches_of(sequences)) is not None:
        beat.plot(stretches.beat_mm, "o-", label=name)
    rest = local(turning_of(sequences).rest_cdeg)
    lines = np.abs(np.fft.rfft(rest))[1:] * 2 / len(rest)
    spectrum.semilogy(np.fft.rfftfreq(len(rest))[1:], lines, label=name)
    step, share = np.unique(np.diff(sequences.azimuth_cdeg), return_counts=True)
    steps.plot(step, share / share.sum(), "o-", label=name)
    codes = np.bincount(sequences.reflectivity[sequences.distance_lsb > 0], minlength=101)[:101]
    reflectivity.step(range(101), codes / max(codes.sum(), 1), label=name)
