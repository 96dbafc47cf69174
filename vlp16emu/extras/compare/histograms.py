"""Histograms of two captures over the same bins."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from vlp16emu.extras.compare.sequences import Sequences
from vlp16emu.extras.compare.statistics import stretches_of
from vlp16emu.types import F8
from vlp16emu.units import US_NS


@dataclass(frozen=True, slots=True)
class Histogram:
    """Shares of a quantity of two captures in the same bins, relative to all values, also those outside."""

    name: str
    unit: str  # of the bins, and what is counted
    edges: list[float]  # (n + 1,) of the bins
    first: list[float] | None  # (n,) shares; None if the capture does not have the quantity
    second: list[float] | None
    first_values: int
    second_values: int


def _white_mm(sequences: Sequences) -> F8:
    stretches = stretches_of(sequences)
    return np.zeros(0) if stretches is None else stretches.white_mm.ravel()


def _steps_cdeg(sequences: Sequences) -> F8:
    return np.asarray(np.diff(sequences.azimuth_cdeg)[np.diff(sequences.block) == 1], np.float64)


def _reflectivity_of_returns(sequences: Sequences) -> F8:
    return np.asarray(sequences.reflectivity[sequences.distance_lsb > 0], np.float64)


def _reflectivity_of_no_returns(sequences: Sequences) -> F8:
    return np.asarray(sequences.reflectivity[sequences.distance_lsb == 0], np.float64)


def _ranges_m(sequences: Sequences) -> F8:
    return np.asarray(sequences.range_mm[sequences.distance_lsb > 0] / 1000)


def _arrivals_us(sequences: Sequences) -> F8:
    """Return the delay between packets (p - 1,) by the host's clock minus that by the sensor's."""
    return np.asarray((np.diff(sequences.stamp_ns) - np.diff(sequences.clock_ns)) / US_NS)


_QUANTITIES: Mapping[str, tuple[str, Callable[[Sequences], F8], tuple[float, float, float]]] = (
    MappingProxyType(
        {
            "range noise": ("mm on smooth surfaces", _white_mm, (-30.0, 30.0, 1.5)),
            "azimuth step": ("0.01 deg between blocks", _steps_cdeg, (-9.5, 10.5, 1.0)),
            "reflectivity": ("code of returns", _reflectivity_of_returns, (-0.5, 110.5, 1.0)),
            "no-returns": (
                "code of records without a return",
                _reflectivity_of_no_returns,
                (-0.5, 110.5, 1.0),
            ),
            "range": ("m, of returns", _ranges_m, (0.0, 100.0, 2.0)),
            "packet arrival": ("us later than the packet's period", _arrivals_us, (-300.0, 300.0, 10.0)),
        }
    )
)
"""Unit, values, and the ends and width of the bins by name."""


def histograms_of(first: Sequences, second: Sequences) -> list[Histogram]:
    """Return the histograms of two captures; bins of azimuth steps lie around the median step."""
    found = list[Histogram]()
    for name, (unit, values_of, (low, high, width)) in _QUANTITIES.items():
        first_values = values_of(first)
        second_values = values_of(second)
        edges = np.linspace(low, high, round((high - low) / width) + 1)
        if values_of is _steps_cdeg:
            edges += round(float(np.median(np.concatenate([first_values, second_values]))))
        histogram = Histogram(
            name,
            unit,
            edges=edges.tolist(),
            first=_shares(first_values, edges),
            second=_shares(second_values, edges),
            first_values=len(first_values),
            second_values=len(second_values),
        )
        found.append(histogram)
    return found


def _shares(values: F8, edges: F8) -> list[float] | None:
    if not len(values):
        return None
    return [round(float(share), 6) for share in np.histogram(values, edges)[0] / len(values)]
