"""Two captures side by side: each statistic, how far apart they are, and the picture."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import IO, TYPE_CHECKING, NamedTuple

import numpy as np

from vlp16emu.extras.compare.sequences import Sequences
from vlp16emu.extras.compare.statistics import local, smooth_of, statistics_of, turning_of
from vlp16emu.extras.plots import plotted

if TYPE_CHECKING:
    from matplotlib.axes import Axes


REAL: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "range.beat_mm": (3.796, 7.152),
        "range.sigma_at_20_mm": (7.984, 8.958),
        "range.white_at_20_mm": (6.178, 8.513),
        "reflectivity.equal_1_4": (0.6376, 0.7845),
        "reflectivity.scatter_1_4": (0.4935, 1.085),
        "reflectivity.equal_20_59": (0.166, 0.3156),
        "reflectivity.scatter_20_59": (2.575, 3.377),
        "reflectivity.equal_60_99": (0.217, 0.3793),
        "reflectivity.scatter_60_99": (2.795, 3.359),
        "reflectivity.comb": (2.173, 2.675),
        "no_return.above_0": (0.7794, 1),
        "no_return.equal": (0.7814, 0.9935),
        "no_return.mean": (3.0, 57.0),
        "rotation.speed_off_percent": (0.003427, 0.1559),
        "rotation.once_cdeg": (3.313, 9.478),
        "rotation.twice_cdeg": (0.5751, 0.965),
        "rotation.hum_cdeg": (0.01416, 0.2371),
        "rotation.reading_cdeg": (0.5642, 0.6016),
        "rotation.commonest_step": (0.53, 0.5599),
        "rotation.rarest_of_five": (0.136, 0.154),
        "rotation.uneven_of_twenty": (0.2474, 0.3132),
        "rotation.speed_sd_percent": (0.002295, 0.01741),
        "residue.odd_spread": (0.07482, 0.1666),
        "residue.mod_4": (0.005477, 0.01426),
        "stamp.spacing_us": (14.08, 161.8),
    }
)
"""Least and greatest value of each statistic on real units: mrpt, nebula, einride and a unit of 2014, before release;
protocol/README.md, "The character of a unit". The mean of no-returns is that of nine units."""

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

    name: str
    """Name with the unit of the values, if they have one."""
    first: float
    second: float
    distance: float
    """Difference as a multiple of the spread of real units."""
    apart: bool
    """Real units do not differ so much."""
    unlike: tuple[bool, bool]
    """True for each that is outside what real units show by more than half of their spread."""


def compared(first: Sequences, second: Sequences) -> list[Compared]:
    """Compare two captures by the statistics that both of them have."""
    one, other = statistics_of(first), statistics_of(second)
    rows = []
    for name in (name for name in one if name in other and name in REAL):
        low, high = REAL[name]
        spread, values = max(high - low, _LEAST_SPREAD * high), (one[name], other[name])
        distance = abs(values[0] - values[1]) / spread
        unlike = [not low - 0.5 * spread <= value <= high + 0.5 * spread for value in values]
        rows.append(Compared(name, *values, distance, distance > 1.0, (unlike[0], unlike[1])))
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
    if (smooth := smooth_of(sequences)) is not None:
        beat.plot(smooth.means_mm, "o-", label=name)
    rest = local(turning_of(sequences).rest_cdeg)
    lines = np.abs(np.fft.rfft(rest))[1:] * 2 / len(rest)
    spectrum.semilogy(np.fft.rfftfreq(len(rest))[1:], lines, label=name)
    step, share = np.unique(np.diff(sequences.azimuth_cdeg), return_counts=True)
    steps.plot(step, share / share.sum(), "o-", label=name)
    codes = np.bincount(sequences.reflectivity[sequences.distance_lsb > 0], minlength=101)[:101]
    reflectivity.step(range(101), codes / max(codes.sum(), 1), label=name)
