"""The converged answer.

The same pulses with many more sub-rays, detected by a receiver without chance; which pulses are drawn, and
how they are timed.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vlp16emu.accuracy.compare import Detections
from vlp16emu.accuracy.settings import PosesAt
from vlp16emu.engine import Unit
from vlp16emu.engine.windows import Batching
from vlp16emu.random import Purpose, generator
from vlp16emu.raycast.beam import Footprint
from vlp16emu.raycast.caster import Geometry
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


def detections_of(
    firings: Firings, hits: Hits, surfaces: NDArray[np.void], exact: UnitDetector
) -> Detections:
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
        np.concatenate([part.distance_m for part in parts]),
        np.concatenate([part.reflectivity for part in parts]),
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


GROUP = 8
"""Sequences of a group: an adaptive beam is judged among so many, and no others."""
_MOST_SEGMENTS = 8
"""Of a long walk: each needs a window of the world of its own."""


@dataclass(frozen=True, slots=True)
class Group:
    """Consecutive firing sequences, cast as in a run: of a block, from a multiple of eight on."""

    first: int
    """Number of the first one."""
    count: int


def draw_groups(
    batching: Batching, blocks: int, pulses: int, seed: int, *, moves: bool
) -> Iterator[tuple[int, list[Group]]]:
    """Draw groups of the first blocks of a run, by segments that share a window of the world.

    Parameters
    ----------
    batching : of the run
    blocks : in the run
    pulses : looked at in all, rounded up
    moves : whether each segment has a window of its own; else one serves all

    Yields
    ------
    Number of a segment, and its groups in order of time.
    """
    draw = generator(seed, Purpose.AUDIT, -1)
    per_block, segment = batching.block // GROUP, batching.segment if moves else blocks
    segments = -(-blocks // segment)
    chosen = _one_of_each(draw, segments, min(_MOST_SEGMENTS, segments))
    most = -(-pulses // (GROUP * batching.lasers * len(chosen)))
    for number in chosen.tolist():
        first, stop = number * segment * per_block, min((number + 1) * segment, blocks) * per_block
        places = first + _one_of_each(draw, stop - first, min(most, stop - first))
        yield number, [Group(place * GROUP, GROUP) for place in places.tolist()]


def _one_of_each(draw: np.random.Generator, things: int, strata: int) -> NDArray[np.int64]:
    """Draw one of the numbers below `things` from each of some strata of nearly equal size."""
    edges = np.arange(strata + 1) * things // strata
    return draw.integers(edges[:-1], edges[1:])


@dataclass(frozen=True, slots=True)
class Bench:
    """Detects pulses of a unit."""

    unit: Unit
    rays: int
    """Sub-rays of an answer."""

    @property
    def limits_m(self) -> tuple[NDArray[np.float64], float]:
        """Where each laser's light begins, (L,), and where it is given up."""
        return self.unit.head.beams.near_m, self.unit.section.max_range_m

    def aimed(self, group: Group, poses_at: PosesAt) -> Firings:
        """Aim the sequences of a group."""
        return self.unit.head.aim(group.first, group.count, poses_at, beam_axis=True)

    def detections(self, geometry: Geometry, firings: Firings, beam: Footprint) -> Detections:
        """Cast pulses, and detect them with an exact receiver."""
        hits = geometry.cast(firings, *self.limits_m, beam)
        return detections_of(firings, hits, geometry.surfaces, self.unit.detector.without_chance())

    def answer(self, geometry: Geometry, firings: Firings, beam: Footprint, number: int = 0) -> Detections:
        """Compute the answer for some pulses.

        Parameters
        ----------
        beam : says how wide light is
        number : distinguishes answers with different sub-rays
        """
        return self.detections(geometry, firings, answer_beam(beam, self.rays, self.unit.seed, number))

    def timed(self, geometry: Geometry, firings: Firings, beam: Footprint) -> tuple[float, float]:
        """Cast and detect as a run does: microseconds per pulse on one core, and rays per pulse."""
        began_s = time.thread_time()
        hits = geometry.cast(firings, *self.limits_m, beam)
        detect(firings, hits, geometry.surfaces, self.unit.detector, truth=False)
        return 1e6 * (time.thread_time() - began_s) / firings.t_ns.size, float(hits.count.mean())

    def timed_aim(self, block: Group, poses_at: PosesAt) -> float:
        """Pose and aim as a run does: microseconds per pulse on one core."""
        began_s = time.thread_time()
        firings = self.unit.head.aim(block.first, block.count, poses_at, beam_axis=self.unit.beam.has_width)
        return 1e6 * (time.thread_time() - began_s) / firings.t_ns.size
