"""What the pulses of a cluster show, counted, so that any statistic of any set of clusters follows from sums."""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["BANDS_M", "FINE_M", "GAP_M", "HEIGHTS_M", "Counts", "Echoes", "counted"]

Array = NDArray[np.float64]

BANDS_M: Final = (0.0, 15.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 100.0)
"""Edges of bands of range; the last one has all that is farther too."""
FINE_M, GAP_M = 0.5, 0.1
"""Widths of bins of range and of gaps between echoes."""
HEIGHTS_M: Final = tuple(float(height) for height in range(-2, 42, 2))
"""Edges of bins of height over the ground; the outermost bins have all beyond too."""
_FARTHEST_M, _WIDEST_GAP_M = 250.0, 100.0
_SPECIES = 256
_LEAF = 4  # PlantPart


@dataclass(frozen=True, slots=True)
class Echoes:
    """The two returns of n pulses in dual return, the nearer one first; 0 where there is none."""

    laser: NDArray[np.int64]
    """(n,)."""
    distance_m: NDArray[np.float64]
    """(n, 2)."""
    reflectivity: NDArray[np.uint8]
    """(n, 2)."""
    part: NDArray[np.uint8]
    """(n, 2) `PlantPart`."""
    species: NDArray[np.uint16]
    """(n, 2)."""
    height_m: NDArray[np.float64]
    """(n,) of the nearer one over the ground."""


class Counts(NamedTuple):
    """Counts of one cluster, (bins,) each; of several, (clusters, bins)."""

    pulses: Array
    """By laser."""
    seen: Array
    """Pulses with a return, by laser."""
    two: Array
    """Pulses with two returns, by band of the nearer one."""
    first: Array
    """Pulses with a return, likewise."""
    returns: Array
    """By band, likewise what follows up to `bright`."""
    plant: Array
    leaf: Array
    bright: Array
    """Sum of reflectivity."""
    fine: Array
    """Returns by range, in bins of `FINE_M`."""
    gap: Array
    """Pulses with two returns by the gap between them, in bins of `GAP_M`."""
    reflectivity: Array
    """Returns by reflectivity, 0 to 255."""
    height: Array
    """First returns by height over the ground."""
    species: Array
    """Returns by species."""
    again: Array
    """Pulses that are cast once more a revolution later, and those whose first return then lies elsewhere, (2,)."""


def counted(echoes: Echoes, lasers: int, again: tuple[int, int] = (0, 0)) -> Counts:
    """Count what the pulses of a cluster show.

    Parameters
    ----------
    lasers : of the sensor
    again : as in `Counts`
    """
    there = echoes.distance_m > 0
    seen, both = there[:, 0], there[:, 1]
    range_m, counts = echoes.distance_m[there], echoes.reflectivity[there]
    part, species = echoes.part[there], echoes.species[there]
    band, first_band = _band(range_m), _band(echoes.distance_m[:, 0])
    gap_m = np.minimum(np.diff(echoes.distance_m, axis=1)[both, 0], _WIDEST_GAP_M)
    step_m = HEIGHTS_M[1] - HEIGHTS_M[0]
    storey = ((echoes.height_m[seen] - HEIGHTS_M[0]) / step_m).clip(0, len(HEIGHTS_M) - 2).astype(np.int64)
    bands = len(BANDS_M) - 1

    def histogram(of: NDArray[np.generic], bins: int, weights: NDArray[np.uint8] | None = None) -> Array:
        """Count whole numbers."""
        return np.bincount(of, weights, minlength=bins)[:bins].astype(np.float64)

    return Counts(
        pulses=histogram(echoes.laser, lasers),
        seen=histogram(echoes.laser[seen], lasers),
        two=histogram(first_band[both], bands),
        first=histogram(first_band[seen], bands),
        returns=histogram(band, bands),
        plant=histogram(band[part > 0], bands),
        leaf=histogram(band[part == _LEAF], bands),
        bright=histogram(band, bands, counts),
        fine=histogram(
            (np.minimum(range_m, _FARTHEST_M) / FINE_M).astype(np.int64), round(_FARTHEST_M / FINE_M) + 1
        ),
        gap=histogram((gap_m / GAP_M).astype(np.int64), round(_WIDEST_GAP_M / GAP_M) + 1),
        reflectivity=histogram(counts, 256),
        height=histogram(storey, len(HEIGHTS_M) - 1),
        species=histogram(np.minimum(species, _SPECIES - 1), _SPECIES),
        again=np.array(again, np.float64),
    )


def _band(range_m: NDArray[np.float64]) -> NDArray[np.int64]:
    """Bands of ranges."""
    return np.searchsorted(BANDS_M[1:-1], range_m, side="right")
