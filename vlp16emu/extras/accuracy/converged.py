"""The converged answer: the same pulses with many more sub-rays, detected by a receiver without chance."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vlp16emu.extras.accuracy.compare import Detections
from vlp16emu.random import Purpose, generator
from vlp16emu.raycast.beam import Footprint
from vlp16emu.returns.detect import detect
from vlp16emu.returns.detector import UnitDetector
from vlp16emu.returns.settings import Detector
from vlp16emu.types import Firings, Hits

_HALF_LIGHT_M_PER_NS = 0.299792458 / 2.0


def apart_m(detector: Detector) -> float:
    """Range between echoes that are surely two: the resolution, or a pulse's full width where that is more."""
    return max(detector.resolution_m, _HALF_LIGHT_M_PER_NS * detector.pulse_ns)


def answer_beam(beam: Footprint, rays: int, seed: int, number: int = 0) -> Footprint:
    """Make the light of an answer; its sub-rays must not be those of what it judges, so it has a seed of its own.

    Parameters
    ----------
    seed : of the unit
    number : distinguishes several answers
    """
    own = int(generator(seed, Purpose.AUDIT, number).integers(2**63))
    return replace(beam.changed(model="fixed", rays=rays), seed=own)


def detections_of(firings: Firings, hits: Hits, surfaces: NDArray[np.void], exact: UnitDetector) -> Detections:
    """Detect all echoes of some pulses, in order of sequence, then of laser.

    Parameters
    ----------
    exact : by `UnitDetector.without_chance`
    """
    returns = detect(firings, hits, surfaces, exact, truth=False)
    return Detections(returns.distance_m.reshape(-1, 3), returns.reflectivity.reshape(-1, 3))


def joined(parts: Sequence[Detections]) -> Detections:
    """Join the detections of several batches."""
    return Detections(
        np.concatenate([part.distance_m for part in parts]), np.concatenate([part.reflectivity for part in parts])
    )


def some_firings(firings: Firings, rows: slice, lasers: NDArray[np.int64]) -> Firings:
    """Take some lasers of some consecutive sequences."""

    def part(of: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.ascontiguousarray(of[rows][:, lasers])

    return Firings(
        index=firings.index + rows.start,
        t_ns=np.ascontiguousarray(firings.t_ns[rows][:, lasers]),
        clock_ns=firings.clock_ns[rows],
        azimuth_deg=part(firings.azimuth_deg),
        reading_deg=firings.reading_deg[rows],
        origin_m=part(firings.origin_m),
        direction=part(firings.direction),
        beam_axis=None if firings.beam_axis is None else part(firings.beam_axis),
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
