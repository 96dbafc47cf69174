"""Pulses drawn from all over a run, their converged answer, and how they are timed.

The converged answer is that of the same pulses with many more sub-rays, by a receiver without noise.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vlp16emu.engine import Parts, Unit, window_of
from vlp16emu.engine.windows import Batching
from vlp16emu.extras.accuracy.compare import Detections
from vlp16emu.random import Purpose, generator
from vlp16emu.raycast.beam import Footprint
from vlp16emu.raycast.caster import Geometry, caster
from vlp16emu.returns.detect import detect
from vlp16emu.returns.detector import UnitDetector
from vlp16emu.returns.settings import Detector
from vlp16emu.scenario import Scenario
from vlp16emu.types import I8, Firings, Hits, Poses
from vlp16emu.units import seconds_to_ns

PosesAt = Callable[[I8], Poses]

GROUP = 8
"""Firing sequences of a group, from a multiple of eight on: an adaptive beam is judged among so many, and no others."""
TIMED_SEQUENCES = 96
"""Firing sequences on which run time is measured in each window: then a call costs below a tenth of a ray each."""
_MOST_SEGMENTS = 8  # most segments of a long walk: each needs a window of the world
_HALF_LIGHT_M_PER_NS = 0.299792458 / 2.0


def apart_m(detector: Detector) -> float:
    """Return the range between echoes that are surely two: the resolution, or a pulse's full width if that is more."""
    return max(detector.resolution_m, _HALF_LIGHT_M_PER_NS * detector.pulse_ns)


def answer_beam(beam: Footprint, rays: int, seed: int, number: int = 0) -> Footprint:
    """Return the beam of an answer; its sub-rays must not be those that it judges, so each number has a seed of its own."""
    own = int(generator(seed, Purpose.AUDIT, number).integers(2**63))
    return replace(beam.changed(model="fixed", rays=rays), seed=own)


def detections_of(firings: Firings, hits: Hits, surfaces: NDArray[np.void], exact: UnitDetector) -> Detections:
    """Detect all echoes of some pulses with a detector without noise, in order of sequence, then of laser."""
    returns = detect(firings, hits, surfaces, exact, truth=False)
    return Detections(returns.distance_m.reshape(-1, 3), returns.reflectivity.reshape(-1, 3))


def joined(parts: Sequence[Detections]) -> Detections:
    """Join the detections of several batches."""
    distances, reflectivities = zip(*((part.distance_m, part.reflectivity) for part in parts), strict=True)
    return Detections(np.concatenate(distances), np.concatenate(reflectivities))


def draw_groups(
    batching: Batching, blocks: int, pulses: int, seed: int, *, moves: bool
) -> Iterator[tuple[int, list[range]]]:
    """Draw groups of firing sequences of the first blocks of a run, of so many pulses at least, by segments that share a window.

    Yields the number of a segment, 0 alone if nothing moves, and its groups in order of time.
    """
    draw = generator(seed, Purpose.AUDIT, -1)
    per_block, segment = batching.block // GROUP, batching.segment if moves else blocks
    segments = -(-blocks // segment)
    chosen = _one_of_each(draw, segments, min(_MOST_SEGMENTS, segments))
    most = -(-pulses // (GROUP * batching.lasers * len(chosen)))
    for number in chosen.tolist():
        first, stop = number * segment * per_block, min((number + 1) * segment, blocks) * per_block
        places = first + _one_of_each(draw, stop - first, min(most, stop - first))
        yield number, [range(place, place + GROUP) for place in (GROUP * places).tolist()]


def _one_of_each(draw: np.random.Generator, things: int, strata: int) -> I8:
    """Draw one of the numbers below `things` from each of some strata of nearly equal size."""
    edges = np.arange(strata + 1) * things // strata
    return draw.integers(edges[:-1], edges[1:])


def opened_windows(
    scenario: Scenario, parts: Parts, pulses: int, pool: Executor
) -> Iterator[tuple[Geometry, list[range], float]]:
    """Open the windows of a sample of the pulses of a run's first unit, one after the other; `pool` grows shapes.

    Yields a window, groups in it, and the share of the run that ends with them.
    """
    unit = parts.units[0]
    batching = Batching(len(unit.head.beams.elevation_deg), unit.head.beams.sequence_ns)
    run_ns = seconds_to_ns(min(scenario.duration_s, unit.motion.run_time_s))
    built, blocks = caster(parts.world, pool), len(batching.blocks(0, run_ns))
    for segment, groups in draw_groups(batching, blocks, pulses, unit.seed, moves=parts.moves):
        geometry = built.open(window_of(parts, scenario.start_ns, batching, segment))
        yield geometry, groups, min(groups[-1].stop * batching.sequence_ns / run_ns, 1.0)


@dataclass(frozen=True, slots=True)
class Bench:
    """Casts and detects pulses of a unit."""

    unit: Unit
    rays: int  # sub-rays of an answer

    def aimed(self, group: range, poses_at: PosesAt) -> Firings:
        """Aim the sequences of a group."""
        return self.unit.head.aim(group.start, len(group), poses_at, beam_axis=True)

    def cast(self, geometry: Geometry, firings: Firings, beam: Footprint) -> Hits:
        """Cast pulses between the unit's limits of range."""
        return geometry.cast(firings, self.unit.head.beams.near_m, self.unit.section.max_range_m, beam)

    def detections(self, geometry: Geometry, firings: Firings, beam: Footprint) -> Detections:
        """Cast pulses, and detect them with an exact receiver."""
        hits = self.cast(geometry, firings, beam)
        return detections_of(firings, hits, geometry.surfaces, self.unit.detector.without_chance())

    def answer(self, geometry: Geometry, firings: Firings, beam: Footprint, number: int = 0) -> Detections:
        """Return the answer for some pulses; its number distinguishes answers with different sub-rays."""
        return self.detections(geometry, firings, answer_beam(beam, self.rays, self.unit.seed, number))

    def timed(self, geometry: Geometry, firings: Firings, beam: Footprint) -> tuple[float, float]:
        """Cast and detect as a run does; return microseconds per pulse on one core, and rays per pulse."""
        began_s = time.thread_time()
        hits = self.cast(geometry, firings, beam)
        detect(firings, hits, geometry.surfaces, self.unit.detector, truth=False)
        return 1e6 * (time.thread_time() - began_s) / firings.t_ns.size, float(hits.count.mean())

    def timed_aim(self, block: range, poses_at: PosesAt) -> float:
        """Pose and aim as a run does; return microseconds per pulse on one core."""
        began_s = time.thread_time()
        firings = self.unit.head.aim(block.start, len(block), poses_at, beam_axis=self.unit.beam.has_width)
        return 1e6 * (time.thread_time() - began_s) / firings.t_ns.size
