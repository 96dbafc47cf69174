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
    """Make the light of an answer; its sub-rays must not be those of what it judges, so each has a seed of its own."""
    own = int(generator(seed, Purpose.AUDIT, number).integers(2**63))
    return replace(beam.changed(model="fixed", rays=rays), seed=own)


def detections_of(firings: Firings, hits: Hits, surfaces: NDArray[np.void], exact: UnitDetector) -> Detections:
    """Detect all echoes of some pulses by a detector without chance, in order of sequence, then of laser."""
    returns = detect(firings, hits, surfaces, exact, truth=False)
    return Detections(returns.distance_m.reshape(-1, 3), returns.reflectivity.reshape(-1, 3))


def joined(parts: Sequence[Detections]) -> Detections:
    """Join the detections of several batches."""
    distances, reflectivities = zip(*((part.distance_m, part.reflectivity) for part in parts), strict=True)
    return Detections(np.concatenate(distances), np.concatenate(reflectivities))


def some_firings(firings: Firings, rows: slice, lasers: NDArray[np.int64]) -> Firings:
    """Take some lasers of some consecutive sequences."""
    arrays = {name: getattr(firings, name)[rows] for name in ("clock_ns", "reading_deg")}
    for name in ("t_ns", "azimuth_deg", "origin_m", "direction", "beam_axis"):
        of = getattr(firings, name)
        arrays[name] = None if of is None else np.ascontiguousarray(of[rows][:, lasers])
    return Firings(index=firings.index + rows.start, **arrays)


def some_hits(hits: Hits, rows: slice, lasers: NDArray[np.int64]) -> Hits:
    """Take the hits of some lasers of some consecutive sequences."""
    own, before = hits.count[rows], int(hits.count[: rows.start].sum())
    stop = before + np.cumsum(own, dtype=np.int64).reshape(own.shape)
    count = np.ascontiguousarray(own[:, lasers])
    last = stop[:, lasers].reshape(-1)
    first = last - count.reshape(-1)
    rays = np.concatenate([np.arange(a, b) for a, b in zip(first.tolist(), last.tolist(), strict=True)])
    return Hits(count, hits.range_m[rays], hits.surface[rays], hits.cos_incidence[rays])
