"""The faults that happen to packets on their way."""

from collections.abc import Callable, Iterator, Sequence

from vlp16emu.engine import Unit
from vlp16emu.engine.changes import end_ns
from vlp16emu.engine.timetable import number_at
from vlp16emu.extras.bench.faults import PacketFault, Wire, kinds_of
from vlp16emu.scenario import Scenario
from vlp16emu.scenario.events import Freeze, PacketEvent
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import seconds_to_ns

Streams = Callable[[int, int], Iterator[Packet]]
"""Packets of all units due in a span since the first pulse, in order of sending."""


def faults_of(scenario: Scenario, units: Sequence[Unit]) -> list[PacketFault]:
    """Make the faults of packets that the events of a run are."""
    faults = list[PacketFault]()
    for number, event in enumerate(scenario.events):
        if not isinstance(event, PacketEvent):
            continue
        unit, start_ns, begin_ns = units[event.unit - 1], scenario.start_ns, seconds_to_ns(event.at_s)
        counted = dict[PacketKind, range]()
        if event.count is not None:
            firsts = {kind: number_at(scenario, unit, kind, begin_ns) for kind in kinds_of(event)}
            counted = {kind: range(first, first + event.count) for kind, first in firsts.items()}
        span_ns = start_ns + begin_ns, start_ns + end_ns(event)
        faults.append(PacketFault(event, number, unit, start_ns, *span_ns, counted))
    return faults


def earliest_ns(scenario: Scenario, faults: Sequence[PacketFault], start_ns: int) -> int:
    """Find the time since the first pulse from which on packets may be so late that they arrive at a time, or later."""
    utc_ns = scenario.start_ns + start_ns
    return max(start_ns - sum(fault.longest_ns for fault in faults if fault.begin_ns < utc_ns), 0)


def arriving(
    scenario: Scenario, units: Sequence[Unit], streams: Streams, start_ns: int, stop_ns: int
) -> Iterator[Packet]:
    """Give the packets that arrive in a span since the first pulse; those that leave in it, where nothing happens to them."""
    faults = faults_of(scenario, units)
    if not faults:
        return streams(start_ns, stop_ns)
    utc_ns, from_ns = scenario.start_ns, earliest_ns(scenario, faults, start_ns)
    frozen = {
        (fault.number, kind): packet
        for fault in faults
        if isinstance(fault.event, Freeze) and fault.begin_ns < utc_ns + from_ns < fault.end_ns
        for kind in kinds_of(fault.event)
        if (packet := _first(fault, kind, streams(fault.begin_ns - utc_ns, stop_ns)))
    }
    numbers = {unit.number: unit.timeline.count(0, from_ns) for unit in units}
    passed = Wire(faults, numbers, frozen).passed(streams(from_ns, stop_ns))
    return (packet for packet in passed if start_ns <= packet.due_ns - utc_ns < stop_ns)


def _first(fault: PacketFault, kind: PacketKind, packets: Iterator[Packet]) -> Packet | None:
    return next((packet for packet in packets if packet.unit == fault.unit.number and packet.kind is kind), None)
