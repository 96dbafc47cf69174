"""The program on one page: poses, aim, cast, shade, dim, detect, pack, merge in order of sending.

Blocks of firing sequences are computed whole, and windows of the world change at fixed blocks, so neither the
number of threads nor the requested span can change a byte.
"""

import heapq
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from itertools import chain
from threading import Event
from typing import TYPE_CHECKING, Self

import numpy as np

from vlp16emu.cores import usable_cores
from vlp16emu.doors import Part
from vlp16emu.engine.build import Parts, Unit, assemble, with_events
from vlp16emu.engine.timeline import Packer, Stretch, TruthOf
from vlp16emu.engine.windows import Batching, OwnWindows, Windows, in_order, windows_of
from vlp16emu.errors import TrajectoryError
from vlp16emu.packets import STAMP_LEAD_NS, first_position_packet, pack_position, position_due_ns
from vlp16emu.raycast.caster import Geometry, sky_cover
from vlp16emu.raycast.texture import add_texture
from vlp16emu.returns.detect import detect
from vlp16emu.returns.detector import UnitDetector
from vlp16emu.scenario import Scenario
from vlp16emu.sensor.settings import require_packets
from vlp16emu.types import F8, I8, Firings, Hits, Packet, PacketKind, Returns
from vlp16emu.units import S_NS, seconds_to_ns

if TYPE_CHECKING:
    from vlp16emu.motion.gnss import Receiver

_AT_ONCE = 128  # position packets whose times are computed at once: one second
_LONGEST_S = 14 * 86_400
"""Sum of the latest start of a run and the longest run; stamps then still fit a capture."""
_LOWEST_DEG = 15.0  # lowest elevation of satellites that receivers use: the usual mask of forest surveys


@dataclass(frozen=True, slots=True)
class Job:
    """Blocks of one unit that are scanned together, under constant settings."""

    unit: Unit
    detector: UnitDetector  # Detector for the return mode of the stretch
    blocks: range  # Numbers of the blocks, within one window of the world
    block: int  # Firing sequences per block
    texture_seed: int
    truth: bool = False  # True if returns carry the surfaces that they come from


Tap = Callable[[Job, Firings, Hits, Geometry], None]
"""Observer of a job's pulses and their hits, called on the thread that cast them; texture is added to the
hits after it returns."""


Sent = Callable[[int, int], Iterator[Packet]]
"""Function that returns the packets that are sent in a span, in ns since the first pulse."""
FAULTS = Part[Callable[[Scenario, Sequence[Unit], Sent, int, int], Iterator[Packet]]](
    "vlp16emu.extras.bench.faults:arriving_packets"
)
"""Function that returns the packets that arrive in a span, in ns since the first pulse."""


def scan(job: Job, geometry: Geometry, taps: Iterable[Tap] = ()) -> Returns:
    """Emit the pulses of a job and detect their echoes."""
    unit = job.unit
    head = job.unit.head
    count = len(job.blocks) * job.block
    firings = head.aim(
        job.blocks.start * job.block, count, unit.motion.poses_at, beam_axis=unit.beam.has_width
    )
    hits = geometry.cast(firings, head.beams.near_m, unit.section.max_range_m, unit.beam)
    for tap in taps:
        tap(job, firings, hits, geometry)
    add_texture(firings, hits, geometry.surfaces, job.texture_seed)
    if firings.beam_axis is not None:
        firings = replace(firings, beam_axis=None)  # a quarter of the memory of returns that wait
    optics = unit.state.optics
    light = optics.dim(firings, hits) if optics else hits
    returns = detect(firings, light, geometry.surfaces, job.detector, truth=job.truth, block=job.block)
    return optics.without_dead_lasers(returns) if optics else returns


@dataclass(frozen=True)
class Engine:
    """A scenario ready to run: sensors on one carrier, and the world around them.

    An engine is a value: `with_events` and `dataclasses.replace` make another one with other events, taps or
    options, which shares world, windows and receiver.
    """

    scenario: Scenario  # Determines every byte
    parts: Parts
    batchings: dict[int, Batching]
    """Blocks of sensors by the length of their firing sequences; windows have the segments of the first."""
    windows: Windows[Geometry]
    receiver: "Receiver | None"  # None if none is connected
    threads: int  # Workers; they change the speed only
    taps: tuple[Tap, ...] = ()
    prompt: bool = False
    """True if blocks are cast one by one, so that new settings take effect soon; it changes the speed
    only."""
    truth_of: TruthOf | None = None  # Ground truth that is attached to data packets

    @classmethod
    def of(
        cls, scenario: Scenario, *, threads: int = 0, taps: Sequence[Tap] = (), like: "Engine | None" = None
    ) -> Self:
        """Set up a scenario for a number of threads, 0 for one per core; no geometry is built yet.

        The world of `like` is reused if it is the same. Raises InputError if a part of the scenario cannot be
        made.
        """
        parts = assemble(scenario, like)
        threads = threads or usable_cores()
        batchings = Batching.of(parts.units)
        windows = windows_of(parts, scenario.start_ns, next(iter(batchings.values())), threads)
        receiver = make_receiver(scenario, parts, windows) if scenario.gps.connected else None
        return cls(scenario, parts, batchings, windows, receiver, threads, tuple(taps))

    @property
    def batching(self) -> Batching:
        """Blocks of the first sensor, and the segments of the windows."""
        return self.batching_of(self.parts.units[0])

    def batching_of(self, unit: Unit) -> Batching:
        """Return the blocks in which a sensor is computed."""
        return self.batchings[unit.head.beams.sequence_ns]

    def packets(self, start_s: float = 0.0, stop_s: float | None = None) -> Iterator[Packet]:
        """Return the packets sent from `start_s` until before `stop_s`, in order of sending.

        Raises ScenarioError if the sensor has no packets; TrajectoryError if the span begins before the first
        pulse, or if the walk ends before the span.
        """
        require_packets(self.scenario.sensor)
        span_ns = self.span_ns(start_s, stop_s)
        if not self.scenario.events:
            return self.packets_sent(*span_ns)
        return FAULTS.load()(self.scenario, self.parts.units, self.packets_sent, *span_ns)

    def packets_sent(self, start_ns: int, stop_ns: int) -> Iterator[Packet]:
        """Merge the packets that are sent in a span since the first pulse, before network faults."""
        streams = list[Iterator[Packet]]()
        # Packets due at the same time leave in order of units, data packets before position packets.
        for unit in self.parts.units:
            streams.append(self._data_packets(unit, start_ns, stop_ns))
            streams.append(position_packets(self.scenario, self.receiver, unit, start_ns, stop_ns))
        return heapq.merge(*streams, key=lambda packet: packet.due_ns)

    def returns(
        self, start_s: float = 0.0, stop_s: float | None = None, unit: int = 0, *, truth: bool = False
    ) -> Iterator[Returns]:
        """Return a unit's returns before packing, in whole blocks that cover the span; surfaces if `truth`.

        A block in which settings change is returned once for the settings before and once for those after,
        each time with the firing sequences that are sent; blocks without any are left out.
        """
        sensor = self.parts.units[unit]
        blocks = self.batching_of(sensor).blocks(*self.span_ns(start_s, stop_s))
        return chain.from_iterable(
            self._returns_of(sensor, stretch, blocks, truth=truth) for stretch in sensor.timeline.spans
        )

    def stopped_by(self, stop: Event) -> Self:
        """Return an engine for one run, whose packets and returns end with CancelledError once `stop` is set.

        It shares world and windows; other runs go on.
        """
        windows = self.windows.stopped_by(stop)
        receiver = self.receiver and make_receiver(self.scenario, self.parts, windows)
        return replace(self, windows=windows, receiver=receiver)

    def with_events(self, events: Sequence[object]) -> Self:
        """Return an engine with other sensor events in place of the scene's."""
        scenario = self.scenario.model_copy(update={"events": list(events)})
        return replace(self, scenario=scenario, parts=with_events(self.parts, scenario))

    def span_ns(self, start_s: float, stop_s: float | None) -> tuple[int, int]:
        """Check a span of the run and convert it to ns since the first pulse; the default end is the scene's.

        Raises TrajectoryError if it begins before the first pulse, ends after the motion or after two weeks,
        or if no poses arrive in a live scene.
        """
        if isinstance(self.parts.carrier, OwnWindows):
            self.parts.carrier.require_open()
        stop_s = self.scenario.duration_s if stop_s is None else stop_s
        if (start_ns := seconds_to_ns(start_s)) < 0:
            raise TrajectoryError("start", f"found {start_s:g} s", "0 s or later")
        if stop_s > (end_s := self.parts.motion.run_time_s):
            keys = "; longer with motion.laps, and motion.back_and_forth where the path is open"
            expected = (
                f"at most the walk's {end_s:.1f} s{keys if self.scenario.motion.kind == 'walk' else ''}"
            )
            raise TrajectoryError("duration", f"found {stop_s:g} s", expected)
        stop_ns = seconds_to_ns(stop_s)
        if max(start_ns, stop_ns) > _LONGEST_S * S_NS:
            raise TrajectoryError(
                "duration", f"found {max(start_s, stop_s):g} s", f"at most {_LONGEST_S} s, two weeks"
            )
        return start_ns, stop_ns

    def _data_packets(self, unit: Unit, start_ns: int, stop_ns: int) -> Iterator[Packet]:
        """Yield the data packets of a unit due in a span since the first pulse."""
        threads = self.threads // len(self.parts.units) or 1
        for stretch in unit.timeline.stretches(start_ns, stop_ns):
            detector = unit.detector.for_mode(stretch.mode)
            packer = Packer(unit, stretch, self.truth_of)
            blocks = stretch.blocks(self.batching_of(unit).block)
            scans = self._scans(unit, detector, blocks, threads, truth=self.truth_of is not None)
            # With `map` no variable keeps returns, up to 25 MB, until the next are ready.
            for packets in map(packer.pack, scans):
                yield from packets

    def _returns_of(self, unit: Unit, stretch: Stretch, blocks: range, *, truth: bool) -> Iterator[Returns]:
        """Yield returns of the blocks in which a stretch sends, with the firing sequences that are sent."""
        sending = stretch.blocks_among(blocks, self.batching_of(unit).block)
        for returns in self._scans(
            unit, unit.detector.for_mode(stretch.mode), sending, self.threads, truth=truth
        ):
            first = returns.firings.index
            sent = unit.timeline.is_sent(stretch, first, first + len(returns.distance_m))
            if sent is None or sent.any():
                yield replace(returns, is_sent=sent)

    def _scans(
        self, unit: Unit, detector: UnitDetector, blocks: range, threads: int, *, truth: bool
    ) -> Iterator[Returns]:
        """Scan blocks on several threads; yield their returns in order of blocks."""
        at_once = 1 if self.prompt or self.truth_of else unit.beam.revolutions_at_once
        batching = self.batching_of(unit)
        windows = self.windows if batching == self.batching else self.windows.in_blocks_of(batching)
        seed = self.parts.world.seed

        def work(run: range, opened: Future[Geometry]) -> Returns:
            """Scan a run of blocks in its window."""
            return self._scan(Job(unit, detector, run, batching.block, seed, truth), opened)

        runs = windows.runs(blocks, at_once, threads)
        return in_order(work, runs, windows, threads=threads, stop=blocks.stop)

    def _scan(self, job: Job, opened: Future[Geometry]) -> Returns:
        return scan(job, opened.result(), self.taps)


def make_receiver(scenario: Scenario, parts: Parts, windows: Windows[Geometry]) -> "Receiver":
    """Make the GPS receiver, whose view of the sky comes from the windows of the run."""
    from vlp16emu.motion.gnss import Receiver  # here: sensors without one do without

    gps = scenario.gps
    start_ns = scenario.start_ns
    far_m = scenario.sensor.max_range_m

    still = parts.wind is None and parts.people is None
    # A body at rest sees the same sky again: the last window, antenna, and hidden share.
    last: tuple[Geometry | None, bytes, float] = (None, b"", 0.0)

    def cover(t_ns: int, antenna_m: F8) -> float:
        """Return the share of the sky that is hidden from an antenna (3,) at a UTC instant."""
        nonlocal last
        geometry = windows.wait(windows.at_time(t_ns - start_ns))
        seen_in, seen_from, seen = last
        if not still or geometry is not seen_in or antenna_m.tobytes() != seen_from:
            seen = sky_cover(geometry, t_ns, antenna_m, _LOWEST_DEG, far_m)
            last = geometry, antenna_m.tobytes(), seen
        return seen

    sky = cover if gps.canopy_loss else None
    return Receiver(parts.motion, gps, seed=scenario.sensor_seed, sky=sky)


def number_at(scenario: Scenario, unit: Unit, kind: PacketKind, since_ns: int) -> int:
    """Return the number of the first packet of a kind sent at or after a time since the first pulse."""
    if kind is PacketKind.DATA:
        return unit.timeline.count(0, since_ns)
    rate = require_packets(unit.section).position_rate
    return first_position_packet(rate, unit.seed, unit.positions_from_ns, scenario.start_ns + since_ns)


def sent_before(scenario: Scenario, unit: Unit, kind: PacketKind, since_ns: int) -> int:
    """Count the packets of a kind that a unit sends from the first pulse until before a time since it.

    Position packets have numbers also while the sensor is without power, but do not leave.
    """
    if kind is PacketKind.DATA:
        return number_at(scenario, unit, kind, since_ns)
    spans_ns = [(0, since_ns)]
    spans_ns += [(begin, min(end, since_ns)) for begin, end in unit.state.silences if begin < since_ns]
    due, *silent = (
        number_at(scenario, unit, kind, stop_ns) - number_at(scenario, unit, kind, begin_ns)
        for begin_ns, stop_ns in spans_ns
    )
    return due - sum(silent)


def positions_due(scenario: Scenario, unit: Unit, start_ns: int, stop_ns: int) -> Iterator[tuple[I8, I8]]:
    """Yield numbers and UTC (n,) of the position packets of a unit due in a span since the first pulse."""
    rate = require_packets(unit.section).position_rate
    first, stop = (
        number_at(scenario, unit, PacketKind.POSITION, since_ns) for since_ns in (start_ns, stop_ns)
    )
    run_ns = scenario.start_ns
    silences = unit.state.silences
    for begin in range(first, stop, _AT_ONCE):
        number = np.arange(begin, min(begin + _AT_ONCE, stop))
        due_ns = position_due_ns(rate, unit.seed, unit.positions_from_ns, begin, len(number))
        is_sent = np.array([silences.at(since_ns) is None for since_ns in (due_ns - run_ns).tolist()])
        yield number[is_sent], due_ns[is_sent]


def position_packets(
    scenario: Scenario, receiver: "Receiver | None", unit: Unit, start_ns: int, stop_ns: int
) -> Iterator[Packet]:
    """Yield the position packets of a unit due in a span since the first pulse."""
    gps = unit.state.gps
    named_ns = None
    sentence = b""
    for numbers, due in positions_due(scenario, unit, start_ns, stop_ns):
        clocks_ns = unit.head.clock.reading_ns(due - STAMP_LEAD_NS)
        columns = numbers.tolist(), due.tolist(), clocks_ns.tolist()
        for number, due_ns, clock_ns in zip(*columns, strict=True):
            stamp_ns = due_ns - STAMP_LEAD_NS
            second_ns = gps.second_ns(stamp_ns)
            if second_ns != named_ns:
                named_ns = second_ns
                sentence = b""
                if receiver is not None and second_ns is not None:
                    sentence = gps.sentence(receiver.fix(second_ns), unit.seed)
            payload = pack_position(clock_ns, gps.pps.at(stamp_ns), sentence)
            yield Packet(PacketKind.POSITION, due_ns, payload, unit.number, number=number)
