"""Which packets the events of a run concern."""

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

from vlp16emu.engine import Unit
from vlp16emu.engine.position import number_at, positions_due
from vlp16emu.extras.bench.events import Event
from vlp16emu.extras.bench.faults import PacketFault, faults_of, kinds_of
from vlp16emu.scenario import Scenario
from vlp16emu.sensor.settings import Sensor
from vlp16emu.types import Packet, PacketKind


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
        begin_ns = event.begin_ns
        if not event.is_random and (from_ns is None or from_ns <= begin_ns) and begin_ns < until_ns:
            found += _whole(scenario, units[event.unit - 1], place, event, stop_ns)
    random = [fault for fault in faults_of(scenario, units) if fault.event.is_random]
    if random:
        found += _single(scenario, units, random, from_ns or 0, until_ns)
    return sorted(found)


def _whole(scenario: Scenario, unit: Unit, place: int, event: Event, stop_ns: int) -> Iterator[Happening]:
    """Yield an event with all packets that are due meanwhile."""
    begin_ns, over_ns, start_ns = event.begin_ns, event.end_ns, scenario.start_ns
    if event.effect != "power":
        over_ns = min(over_ns, max(stop_ns, begin_ns))
    kinds: tuple[PacketKind, ...] = (PacketKind.POSITION if event.effect == "gps" else PacketKind.DATA,)
    for kind in kinds_of(event) if event.effect == "packets" else kinds:
        first, until_ns = number_at(scenario, unit, kind, begin_ns), over_ns
        if event.effect == "packets" and event.count is not None:
            due_ns = (packet.due_ns for packet in timetable(scenario, [unit], begin_ns, over_ns) if packet.kind is kind)
            last_ns = max(islice(due_ns, event.count), default=start_ns + begin_ns)
            until_ns = last_ns + 1 - start_ns
        count = number_at(scenario, unit, kind, until_ns) - first
        times = start_ns + begin_ns, start_ns + until_ns
        yield Happening(
            *times, place + 1, event.unit, event.kind, kind, first - number_at(scenario, unit, kind, 0), count
        )


def _single(
    scenario: Scenario, units: Sequence[Unit], faults: Sequence[PacketFault], from_ns: int, until_ns: int
) -> Iterator[Happening]:
    """Yield the packets due in a span that faults befall."""
    numbers = {unit.number: number_at(scenario, unit, PacketKind.DATA, from_ns) for unit in units}
    for packet in timetable(scenario, units, from_ns, until_ns):
        number = packet.number
        if packet.kind is PacketKind.DATA:
            number = numbers[packet.unit]
            numbers[packet.unit] += 1
        for fault in faults:
            if fault.unit.number == packet.unit and fault.befalls(packet, number):
                times, of = (packet.due_ns, packet.due_ns), (fault.number + 1, fault.unit.number + 1)
                first = number - number_at(scenario, fault.unit, packet.kind, 0)
                yield Happening(*times, *of, fault.event.kind, packet.kind, first, 1)


def timetable(scenario: Scenario, units: Sequence[Unit], start_ns: int, stop_ns: int) -> Iterator[Packet]:
    """Yield the packets due in a span since the first pulse in order of sending, without bytes, so that no light is cast.

    Of a sensor without packets, as many firing sequences at a time.
    """

    def data(unit: Unit) -> Iterator[Packet]:
        sequence_ns = unit.head.beams.sequence_ns
        for rows in unit.timeline.sequences(start_ns, stop_ns):
            for first, last in zip(rows[:, 0].tolist(), rows[:, -1].tolist(), strict=True):
                due_ns, fired_ns = (scenario.start_ns + number * sequence_ns for number in (last + 1, first))
                yield Packet(PacketKind.DATA, due_ns, b"", unit.number, fired_ns)

    def position(unit: Unit) -> Iterator[Packet]:
        for number, due_ns in (
            positions_due(scenario, unit, start_ns, stop_ns) if isinstance(unit.section, Sensor) else ()
        ):
            yield Packet(PacketKind.POSITION, due_ns, b"", unit.number, number=number)

    streams = (stream(unit) for unit in units for stream in (data, position))
    return heapq.merge(*streams, key=lambda packet: packet.due_ns)
