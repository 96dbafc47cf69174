"""Two captures side by side: each statistic, how far apart they are, and the picture."""

import math
import tomllib
from collections.abc import Mapping
from importlib.resources import files
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


_TABLE = files(__package__).joinpath("real_units.toml").read_text(encoding="utf-8")
REAL: Mapping[str, Known] = MappingProxyType({name: Known(*row) for name, row in tomllib.loads(_TABLE).items()})

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
