"""Which packets the events of a run concern."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

from vlp16emu.engine import Unit
from vlp16emu.engine.changes import end_ns
from vlp16emu.engine.timetable import number_at, timetable
from vlp16emu.extras.bench.faults import PacketFault, kinds_of
from vlp16emu.extras.bench.wire import faults_of
from vlp16emu.scenario import Scenario
from vlp16emu.scenario.events import Event, GpsEvent, LastingEvent, PacketEvent, PowerCycle, Share
from vlp16emu.types import PacketKind
from vlp16emu.units import seconds_to_ns


@dataclass(frozen=True, slots=True, order=True)
class Happening:
    """An event, and the packets of one kind that are due while it lasts; or one packet that an event befalls."""

    begin_ns: int
    """UTC, as the next."""
    end_ns: int
    event: int
    """Number of the table in the scene, from 1."""
    unit: int
    """From 1."""
    kind: str
    packets: PacketKind
    first: int
    """Number of the first packet from its begin on, from 0 at the first pulse of the run."""
    count: int
    """Packets until its end."""


def happenings(
    scenario: Scenario, units: Sequence[Unit], from_ns: int | None, until_ns: int, stop_ns: int
) -> list[Happening]:
    """List what begins to happen in a span of time since the first pulse.

    Events that befall each packet with a probability are listed packet by packet, as these are due.

    Parameters
    ----------
    from_ns : of the span; None with what began earlier
    until_ns : end of the span
    stop_ns : end of the run, and of what lasts longer
    """
    found = list[Happening]()
    for place, event in enumerate(scenario.events):
        begin_ns = seconds_to_ns(event.at_s)
        if not _is_random(event) and (from_ns is None or from_ns <= begin_ns) and begin_ns < until_ns:
            found += _whole(scenario, units[event.unit - 1], place, event, stop_ns)
    random = [fault for fault in faults_of(scenario, units) if _is_random(fault.event)]
    if random:
        found += _single(scenario, units, random, from_ns or 0, until_ns)
    return sorted(found)


def _is_random(event: Event) -> bool:
    return isinstance(event, Share) and event.share < 1.0


def _whole(scenario: Scenario, unit: Unit, place: int, event: Event, stop_ns: int) -> Iterator[Happening]:
    """Give an event with all packets that are due meanwhile."""
    begin_ns = over_ns = seconds_to_ns(event.at_s)
    if isinstance(event, LastingEvent):
        over_ns = min(end_ns(event), max(stop_ns, begin_ns))
    elif isinstance(event, PowerCycle):
        over_ns = seconds_to_ns(event.at_s + event.off_s)
    kinds: tuple[PacketKind, ...] = (PacketKind.DATA,)
    if isinstance(event, GpsEvent):
        kinds = (PacketKind.POSITION,)
    elif isinstance(event, PacketEvent):
        kinds = kinds_of(event)
    for kind in kinds:
        first, until_ns = number_at(scenario, unit, kind, begin_ns), over_ns
        if isinstance(event, PacketEvent) and event.count is not None:
            due_ns = (packet.due_ns for packet in timetable(scenario, [unit], begin_ns, over_ns) if packet.kind is kind)
            last_ns = max(islice(due_ns, event.count), default=scenario.start_ns + begin_ns)
            until_ns = last_ns + 1 - scenario.start_ns
        count = number_at(scenario, unit, kind, until_ns) - first
        times = scenario.start_ns + begin_ns, scenario.start_ns + until_ns
        yield Happening(*times, place + 1, event.unit, event.kind, kind, first, count)


def _single(
    scenario: Scenario, units: Sequence[Unit], faults: Sequence[PacketFault], from_ns: int, until_ns: int
) -> Iterator[Happening]:
    """Give the packets due in a span that faults befall."""
    numbers = {unit.number: number_at(scenario, unit, PacketKind.DATA, from_ns) for unit in units}
    for packet in timetable(scenario, units, from_ns, until_ns):
        number = packet.number
        if packet.kind is PacketKind.DATA:
            number = numbers[packet.unit]
            numbers[packet.unit] += 1
        for fault in faults:
            if fault.unit.number == packet.unit and fault.befalls(packet, number):
                times, of = (packet.due_ns, packet.due_ns), (fault.number + 1, fault.unit.number + 1)
                yield Happening(*times, *of, fault.event.kind, packet.kind, number, 1)
