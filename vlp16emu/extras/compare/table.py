"""Two captures side by side: each statistic, and the distance between them."""

import math
import tomllib
from collections.abc import Mapping
from importlib.resources import files
from types import MappingProxyType
from typing import NamedTuple

from vlp16emu.extras.compare.sequences import Sequences
from vlp16emu.extras.compare.statistics import statistics_of
from vlp16emu.packets.layout import LASERS

_ONE_UNIT_FACTOR = 2.0  # of the limits of a statistic that is known of one unit


class Known(NamedTuple):
    """A statistic, and its values on real units."""

    low: float
    high: float
    text: str  # its name in reports, with the unit of its values

    @property
    def limits(self) -> tuple[float, float]:
        """Least and greatest value, widened by half of the range.

        Values above 0 are widened by the root of their ratio; those of one unit by a factor of two.
        """
        low, high, _ = self
        if low > 0.0:
            factor = math.sqrt(high / low) if high > low else _ONE_UNIT_FACTOR
            return low / factor, high * factor
        return low - (high - low) / 2, high + (high - low) / 2

    def is_like(self, value: float) -> bool:
        """Return True if the value is plausible for a real unit."""
        low, high = self.limits
        return low <= value <= high


_TABLE = files(__package__).joinpath("real_units.toml").read_text(encoding="utf-8")
REAL: Mapping[str, Known] = MappingProxyType(
    {name: Known(*row) for name, row in tomllib.loads(_TABLE).items()}
)

_LEAST_SPREAD = 0.25
"""Least spread as a share of the greatest value: if four units agree more closely, a fifth may still
differ."""


class Compared(NamedTuple):
    """One statistic of two captures."""

    name: str  # name with the unit of the values, if they have one
    text: str  # its name in reports
    first: float
    second: float
    distance: float  # difference as a multiple of the spread of real units
    apart: bool  # True if real units do not differ this much
    unlike: tuple[
        bool, bool
    ]  # True for each Puck that is outside the limits of real units, which are VLP-16s


def compare_statistics(first: Sequences, second: Sequences) -> list[Compared]:
    """Compare two captures by the statistics that both have."""
    first_values = statistics_of(first)
    second_values = statistics_of(second)
    is_puck = [sequences.layout.model.lasers == LASERS for sequences in (first, second)]
    rows = []
    for name in first_values:
        if name not in second_values or name not in REAL:
            continue
        known = REAL[name]
        values = (first_values[name], second_values[name])
        spread = max(known.high - known.low, _LEAST_SPREAD * abs(known.high), 1e-9)
        distance = abs(values[0] - values[1]) / spread
        unlike = [puck and not known.is_like(value) for puck, value in zip(is_puck, values, strict=True)]
        rows.append(Compared(name, known.text, *values, distance, distance > 1.0, (unlike[0], unlike[1])))
    return rows
