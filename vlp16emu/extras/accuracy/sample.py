"""Pulses drawn from all over a run, cast in its windows, and how they are timed."""

import time
from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlp16emu.engine import Parts, Unit, window_of
from vlp16emu.engine.windows import Batching
from vlp16emu.extras.accuracy.compare import Detections
from vlp16emu.extras.accuracy.converged import answer_beam, detections_of
from vlp16emu.extras.accuracy.settings import PosesAt
from vlp16emu.random import Purpose, generator
from vlp16emu.raycast.beam import Footprint
from vlp16emu.raycast.caster import Geometry, caster
from vlp16emu.returns.detect import detect
from vlp16emu.scenario import Scenario
from vlp16emu.types import Firings
from vlp16emu.units import seconds_to_ns

GROUP = 8
"""Sequences of a group: an adaptive beam is judged among so many, and no others."""
TIMED_SEQUENCES = 96
"""On which run time is measured in each window: then calls cost below a tenth of a ray each."""
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
    """Draw groups of the first blocks of a run, for so many pulses at least, by segments that share a window of the world.

    Yields the number of a segment, 0 alone where nothing moves, and its groups in order of time.
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


def opened_windows(
    scenario: Scenario, parts: Parts, pulses: int, pool: Executor
) -> Iterator[tuple[Geometry, list[Group], float]]:
    """Open the windows of a sample of the pulses of a run's first unit, one after the other; shapes are grown in `pool`.

    Yields a window, groups in it, and the share of the run that ends with them.
    """
    unit = parts.units[0]
    batching = Batching(len(unit.head.beams.elevation_deg), unit.head.beams.sequence_ns)
    run_ns = seconds_to_ns(min(scenario.duration_s, unit.motion.run_time_s))
    built, blocks = caster(parts.world, pool), len(batching.blocks(0, run_ns))
    for segment, groups in draw_groups(batching, blocks, pulses, unit.seed, moves=parts.moves):
        geometry = built.open(window_of(parts, scenario.start_ns, batching, segment))
        yield geometry, groups, min((groups[-1].first + GROUP) * batching.sequence_ns / run_ns, 1.0)


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
        """Compute the answer for some pulses of a width; its number distinguishes answers with different sub-rays."""
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
