"""The converged answer: the same pulses by many more sub-rays, told by a receiver that leaves nothing to chance."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vlp16emu.random import Purpose, generator
from vlp16emu.raycast import BeamModel, Footprint
from vlp16emu.report.accuracy import Told
from vlp16emu.returns import Detector, detect
from vlp16emu.scenario.detector import Detector as DetectorSection
from vlp16emu.types import Firings, Hits

__all__ = ["answer_beam", "apart_m", "joined", "some_firings", "some_hits", "told"]

_HALF_LIGHT_M_PER_NS = 0.299792458 / 2.0


def apart_m(detector: DetectorSection) -> float:
    """Range between echoes that are surely two: the resolution, or a pulse's full width where that is more."""
    return max(detector.resolution_m, _HALF_LIGHT_M_PER_NS * detector.pulse_ns)


def answer_beam(beam: Footprint, rays: int, seed: int, number: int = 0) -> Footprint:
    """Make the light of an answer; its sub-rays must not be those of what it judges, so it has a seed of its own.

    Parameters
    ----------
    seed : of the unit
    number : tells several answers apart
    """
    own = int(generator(seed, Purpose.AUDIT, number).integers(2**63))
    return replace(beam, model=BeamModel.FIXED, rays=rays, seed=own)


def told(firings: Firings, hits: Hits, surfaces: NDArray[np.void], exact: Detector) -> Told:
    """Tell all echoes of some pulses, in order of sequence, then of laser.

    Parameters
    ----------
    exact : by `Detector.without_chance`
    """
    returns = detect(firings, hits, surfaces, exact, truth=False)
    return Told(returns.distance_m.reshape(-1, 3), returns.reflectivity.reshape(-1, 3))


def joined(parts: Sequence[Told]) -> Told:
    """Put what was told of several batches into one."""
    return Told(
        np.concatenate([part.distance_m for part in parts]),
        np.concatenate([part.reflectivity for part in parts]),
    )


def some_firings(firings: Firings, rows: slice, lasers: NDArray[np.int64]) -> Firings:
    """Take some lasers of some consecutive sequences."""

    def part(of: NDArray[np.float64]) -> NDArray[np.float64]:
        """Pulses that were drawn."""
        return np.ascontiguousarray(of[rows][:, lasers])

    return Firings(
        index=firings.index + rows.start,
        t_ns=np.ascontiguousarray(firings.t_ns[rows][:, lasers]),
        clock_ns=firings.clock_ns[rows],
        azimuth_deg=part(firings.azimuth_deg),
        reading_deg=firings.reading_deg[rows],
        origin_m=part(firings.origin_m),
        direction=part(firings.direction),
        across=None if firings.across is None else part(firings.across),
    )


def some_hits(hits: Hits, rows: slice, lasers: NDArray[np.int64]) -> Hits:
    """Take the hits of some lasers of some consecutive sequences."""
    own, before = hits.count[rows], int(hits.count[: rows.start].sum())
    stop = before + np.cumsum(own, dtype=np.int64).reshape(own.shape)
    count = np.ascontiguousarray(own[:, lasers])
    last = stop[:, lasers].reshape(-1)
    first = last - count.reshape(-1)
    rays = np.concatenate([np.arange(a, b) for a, b in zip(first.tolist(), last.tolist(), strict=True)])
    return Hits(count, hits.range_m[rays], hits.surface[rays], hits.cos_incidence[rays])
