"""When packets leave, without their bytes."""

import heapq
from collections.abc import Iterator, Sequence

from vlp16emu.engine.build import Unit
from vlp16emu.engine.position import position_due, position_number
from vlp16emu.scenario import Scenario
from vlp16emu.sensor.settings import Sensor
from vlp16emu.types import Packet, PacketKind


def number_at(scenario: Scenario, unit: Unit, kind: PacketKind, since_ns: int) -> int:
    """Find the number of the first packet of a kind that a unit sends at a time since the first pulse, or later."""
    if kind is PacketKind.DATA:
        return unit.timeline.count(0, since_ns)
    return position_number(scenario, unit, since_ns)


def timetable(scenario: Scenario, units: Sequence[Unit], start_ns: int, stop_ns: int) -> Iterator[Packet]:
    """Yield the packets due in a span since the first pulse in order of sending, without their bytes: for these light is cast.

    Of a sensor without packets, as many firing sequences at a time.
    """

    def data(unit: Unit) -> Iterator[Packet]:
        sequence_ns = unit.head.beams.sequence_ns
        for rows in unit.timeline.sequences(start_ns, stop_ns):
            for first, last in zip(rows[:, 0].tolist(), rows[:, -1].tolist(), strict=True):
                due_ns, fired_ns = (scenario.start_ns + number * sequence_ns for number in (last + 1, first))
                yield Packet(PacketKind.DATA, due_ns, b"", unit.number, fired_ns)

    def position(unit: Unit) -> Iterator[Packet]:
        for number, due_ns in position_due(scenario, unit, start_ns, stop_ns):
            yield Packet(PacketKind.POSITION, due_ns, b"", unit.number, number=number)

    streams = list[Iterator[Packet]]()
    for unit in units:
        streams.append(data(unit))
        if isinstance(unit.section, Sensor):
            streams.append(position(unit))
    return heapq.merge(*streams, key=lambda packet: packet.due_ns)
