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

from vlp16emu.chain import PulseHook, Unit, assemble, with_events
from vlp16emu.chain.cells import cuts_of, require_poses, windows_for
from vlp16emu.chain.position import make_receiver, position_number, position_packets
from vlp16emu.chain.sending import SendingSpan, joined, rows_of
from vlp16emu.chain.windows import Batching, prefetch
from vlp16emu.device.events import Event
from vlp16emu.errors import TrajectoryError
from vlp16emu.packets import pack_data
from vlp16emu.raycast.caster import Geometry
from vlp16emu.returns.detect import detect
from vlp16emu.scenario import Scenario
from vlp16emu.sensor.settings import on_the_wire
from vlp16emu.types import Packet, Returns, SensorModel
from vlp16emu.units import seconds_to_ns

__all__ = ["Chain"]


class Chain:
    """A sensor, or several on one carrier, in the world of a scenario.

    Parameters
    ----------
    scenario : decides every byte
    threads : workers, 0 for one per core; they change the speed only
    audit : looks at what the pulses of each block met, on the thread that cast them

    Raises
    ------
    InputError
        where a part of the scenario cannot be made
    """

    def __init__(self, scenario: Scenario, *, threads: int = 0, audit: PulseHook | None = None) -> None:
        self.scenario = scenario
        self.parts = assemble(scenario)
        self._audit = audit
        self._threads = threads or os.cpu_count() or 1
        beams = self.parts.head.beams
        self.batching = Batching(len(beams.elevation_deg), beams.sequence_ns, cuts_of(self.parts))
        self.windows = windows_for(self.parts, scenario.start_ns, self.batching, self._threads)
        self.receiver = make_receiver(scenario, self.parts, self.windows)

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
        streams, span_ns = list[Iterator[Packet]](), self._span_ns(start_s, stop_s)
        for unit in self.parts.units:  # of packets due at once those of the first unit leave first
            streams.append(self._data_packets(unit, *span_ns))
            streams.append(position_packets(self.scenario, self.parts.gps, self.receiver, unit, *span_ns))
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

    def first_position_packets(self, start_s: float = 0.0) -> list[int]:
        """Find the number of each unit's first position packet from `start_s` on; a run's first has 0."""
        return [position_number(self.scenario, unit, seconds_to_ns(start_s)) for unit in self.parts.units]

    def _span_ns(self, start_s: float, stop_s: float | None) -> tuple[int, int]:
        """Check a span and put it into nanoseconds since the first pulse."""
        require_poses(self.parts)
        stop_s = self.scenario.duration_s if stop_s is None else stop_s
        if (start_ns := seconds_to_ns(start_s)) < 0:
            raise TrajectoryError("start", f"found {start_s:g} s", "0 s or later")
        if stop_s > (end_s := self.parts.motion.run_time_s):
            raise TrajectoryError("duration", f"found {stop_s:g} s", f"at most the walk's {end_s:.1f} s")
        return start_ns, seconds_to_ns(stop_s)

    def _scan(self, unit: Unit, run: range, opened: Future[Geometry], *, truth: bool = False) -> Returns:
        """Emit and receive a run of blocks of pulses."""
        head, block, poses_at = unit.head, self.batching.block, unit.motion.poses_at
        firings = head.aim(run.start * block, len(run) * block, poses_at, beam_axis=unit.beam.has_width)
        geometry = opened.result()
        hits = geometry.cast(firings, head.beams.near_m, unit.section.max_range_m, unit.beam)
        if self._audit:
            self._audit(unit, firings, hits, geometry)
        hits = unit.optics.dimmed(firings, hits)
        return unit.optics.received(detect(firings, hits, geometry.surfaces, unit.detector, truth=truth))

    def _data_packets(self, unit: Unit, start_ns: int, stop_ns: int) -> Iterator[Packet]:
        """Yield the data packets of a unit due in a span since the first pulse."""
        model = SensorModel(on_the_wire(unit.section).model)
        for span in unit.sending.spans:
            slots = next(unit.sending.slots_of(span, start_ns, stop_ns), None)
            if slots is not None:
                first, stop = int(slots[0, 0]), unit.sending.stop_of(span, stop_ns)
                if span.fov_deg is None:
                    stop -= (stop - first) % span.per_packet
                yield from self._of_span(unit, span, model, first, stop)

    def _of_span(
        self, unit: Unit, span: SendingSpan, model: SensorModel, first: int, stop: int
    ) -> Iterator[Packet]:
        """Yield the packets that firing sequences fill, all of one span of settings; pulses of a block are cast together."""
        block, blocks = (
            self.batching.block,
            range(first // self.batching.block, -(-stop // self.batching.block)),
        )
        detector = unit.detector.for_mode(span.mode)

        def scan(run: range, opened: Future[Geometry]) -> list[Packet] | Returns:
            """Scan blocks, and take what is sent; packed, where packets begin and end with blocks."""
            returns = self._scan(replace(unit, detector=detector), run, opened)
            begin = run.start * block
            here, end = max(first, begin), min(stop, run.stop * block)
            if span.fov_deg is None:
                return pack_data(
                    rows_of(returns, slice(here - begin, end - begin)), span.mode, model, unit.number
                )
            return rows_of(returns, unit.sending.chosen(span, here, end & ~1) - begin)

        left: Returns | None = None
        threads, together = self._threads // len(self.parts.units) or 1, unit.beam.together
        for scanned in prefetch(scan, self.windows, blocks=blocks, threads=threads, together=together):
            if isinstance(scanned, list):
                yield from scanned
                continue
            left = scanned if left is None else joined(left, scanned)
            whole = len(left.distance_m) // span.per_packet * span.per_packet
            yield from pack_data(rows_of(left, slice(whole)), span.mode, model, unit.number)
            left = rows_of(left, slice(whole, None))
