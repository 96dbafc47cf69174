"""The program on one page: poses -> aim -> cast -> detect -> pack, in order of sending.

Blocks of firing sequences are always computed whole, and windows of the world are opened at fixed
blocks, so neither threads nor the span that is asked for can change a byte.
"""

import heapq
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from dataclasses import replace
from functools import partial

from vlp16emu.chain import Like, PulseHook, Unit, assemble, with_events
from vlp16emu.chain.cells import checked_span_ns, cuts_of, windows_for
from vlp16emu.chain.position import make_receiver, position_packets
from vlp16emu.chain.slots import slots_of
from vlp16emu.chain.windows import Batching, prefetch
from vlp16emu.chain.wire import arriving
from vlp16emu.device.events import Event
from vlp16emu.raycast.caster import Geometry
from vlp16emu.raycast.texture import textured
from vlp16emu.returns.detect import detect
from vlp16emu.scenario import Scenario
from vlp16emu.sensor.settings import on_the_wire
from vlp16emu.types import Packet, Returns


class Chain:
    """A sensor, or several on one carrier, in the world of a scenario.

    Parameters
    ----------
    scenario : decides every byte
    threads : workers, 0 for one per core; they change the speed only
    audit : looks at what the pulses of each block met, on the thread that cast them
    like : another run; what it has grown and built of the same world is used again

    Raises
    ------
    InputError
        where a part of the scenario cannot be made
    """

    def __init__(
        self, scenario: Scenario, *, threads: int = 0, audit: PulseHook | None = None, like: Like = None
    ) -> None:
        self.scenario = scenario
        self.parts = assemble(scenario, like)
        self._span_ns = partial(checked_span_ns, scenario, self.parts)
        self._audit = audit
        self._threads = threads or os.cpu_count() or 1
        beams = self.parts.head.beams
        self.batching = Batching(len(beams.elevation_deg), beams.sequence_ns, cuts_of(self.parts))
        self.windows = windows_for(self.parts, scenario.start_ns, self.batching, self._threads)
        self.receiver = make_receiver(scenario, self.parts, self.windows)
        self.prompt = False
        """Whether blocks are cast one by one, so that what is set anew shows soon; it changes the speed only."""
        self.with_slots = False
        """Whether data packets carry the truth behind their records."""

    def packets(self, start_s: float = 0.0, stop_s: float | None = None) -> Iterator[Packet]:
        """Packets that leave from `start_s` until before `stop_s` after the first pulse, in order of sending.

        Raises
        ------
        ScenarioError
            where the sensor has no packets
        TrajectoryError
            where the span begins before the first pulse, or the walk is over before it ends
        """
        on_the_wire(self.scenario.sensor)
        return arriving(self.scenario, self.parts.units, self._sent, *self._span_ns(start_s, stop_s))

    def _sent(self, *span_ns: int) -> Iterator[Packet]:
        # Of packets due at once those of the first unit leave first, and its data packets first.
        sources = (self._data_packets, partial(position_packets, self.scenario, self.receiver))
        streams = [source(unit, *span_ns) for unit in self.parts.units for source in sources]
        return heapq.merge(*streams, key=lambda packet: packet.due_ns)

    def returns(
        self, start_s: float = 0.0, stop_s: float | None = None, unit: int = 0, *, truth: bool = False
    ) -> Iterator[Returns]:
        """Give a unit's returns before packing, in whole blocks that hold at least the span; with their surfaces if `truth`."""
        blocks, of = self.batching.blocks(*self._span_ns(start_s, stop_s)), self.parts.units[unit]
        scan, together = partial(self._scan, of, truth=truth), of.beam.together
        return prefetch(scan, self.windows, blocks=blocks, threads=self._threads, together=together)

    def set_events(self, events: Sequence[Event]) -> None:
        """Let other events happen; packets that are under way are those of the events before."""
        self.scenario = self.scenario.model_copy(update={"events": list(events)})
        self.parts = with_events(self.parts, self.scenario)

    def _scan(self, unit: Unit, run: range, opened: Future[Geometry], *, truth: bool = False) -> Returns:
        """Emit and receive a run of blocks of pulses."""
        head, block, poses_at = unit.head, self.batching.block, unit.motion.poses_at
        firings = head.aim(run.start * block, len(run) * block, poses_at, beam_axis=unit.beam.has_width)
        geometry = opened.result()
        hits = geometry.cast(firings, head.beams.near_m, unit.section.max_range_m, unit.beam)
        if self._audit:
            self._audit(unit, firings, hits, geometry)
        lit = unit.optics.dimmed(firings, textured(firings, hits, geometry.surfaces, self.parts.world.seed))
        return unit.optics.received(detect(firings, lit, geometry.surfaces, unit.detector, truth=truth))

    def _data_packets(self, unit: Unit, start_ns: int, stop_ns: int) -> Iterator[Packet]:
        """Yield the data packets of a unit due in a span since the first pulse."""
        threads, block = self._threads // len(self.parts.units) or 1, self.batching.block
        slots = partial(slots_of, unit) if self.with_slots else None
        for part in unit.sending.parts(start_ns, stop_ns, slots):
            of_mode = replace(unit, detector=unit.detector.for_mode(part.span.mode))
            scan = partial(self._scan, of_mode, truth=self.with_slots)
            take, blocks = partial(part.taken, scan, block), part.blocks(block)
            together = 1 if self.prompt or slots else unit.beam.together
            taken = prefetch(take, self.windows, blocks=blocks, threads=threads, together=together)
            yield from part.packets(taken)
