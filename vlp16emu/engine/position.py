"""The stream of position packets: what the sensor says of its clock and of the GPS receiver."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from vlp16emu.engine.build import Parts, Unit
from vlp16emu.engine.windows import Windows
from vlp16emu.motion.gnss import Receiver
from vlp16emu.packets import STAMP_LEAD_NS, first_position_packet, pack_position, position_due_ns
from vlp16emu.raycast.caster import Geometry, sky_cover
from vlp16emu.scenario import Scenario
from vlp16emu.sensor.settings import on_the_wire
from vlp16emu.types import Packet, PacketKind

_AT_ONCE = 128  # position packets whose times are found at once, a second of them
_LOWEST_DEG = 15.0  # elevation from which on receivers use satellites: the usual mask of forest surveys


def make_receiver(scenario: Scenario, parts: Parts, windows: Windows[Geometry]) -> Receiver:
    """Make the GPS receiver, which sees the sky through the windows of the run."""
    gps, start_ns, far_m = scenario.gps, scenario.start_ns, scenario.sensor.max_range_m

    def cover(t_ns: int, antenna_m: NDArray[np.float64]) -> float:
        geometry = windows.wait(windows.at_time(t_ns - start_ns))
        return sky_cover(geometry, t_ns, antenna_m, _LOWEST_DEG, far_m)

    sky = cover if gps.canopy_loss else None
    return Receiver(parts.motion, gps, seed=scenario.sensor_seed, sky=sky)


def number_at(scenario: Scenario, unit: Unit, kind: PacketKind, since_ns: int) -> int:
    """Find the number of the first packet of a kind that a unit sends at a time since the first pulse, or later."""
    if kind is PacketKind.DATA:
        return unit.timeline.count(0, since_ns)
    rate = on_the_wire(unit.section).position_rate
    return first_position_packet(rate, unit.seed, unit.positions_from_ns, scenario.start_ns + since_ns)


def positions_due(scenario: Scenario, unit: Unit, start_ns: int, stop_ns: int) -> Iterator[tuple[int, int]]:
    """Yield number and UTC of the position packets of a unit due in a span since the first pulse."""
    rate = on_the_wire(unit.section).position_rate
    first, stop = (number_at(scenario, unit, PacketKind.POSITION, since_ns) for since_ns in (start_ns, stop_ns))
    from_ns = unit.positions_from_ns
    for number in range(first, stop, _AT_ONCE):
        due_ns = position_due_ns(rate, unit.seed, from_ns, number, min(_AT_ONCE, stop - number))
        for place, due in enumerate(due_ns.tolist()):
            if not unit.timeline.is_silent(due - scenario.start_ns):
                yield number + place, due


def position_packets(
    scenario: Scenario, receiver: Receiver, unit: Unit, start_ns: int, stop_ns: int
) -> Iterator[Packet]:
    """Yield the position packets of a unit due in a span since the first pulse."""
    named_ns, sentence = None, b""
    for number, due_ns in positions_due(scenario, unit, start_ns, stop_ns):
        stamp_ns = due_ns - STAMP_LEAD_NS
        second_ns = unit.gps.second_ns(stamp_ns)
        if second_ns != named_ns:
            named_ns = second_ns
            sentence = b"" if second_ns is None else unit.gps.sentence(receiver.fix(second_ns), unit.seed)
        clock_ns = int(unit.head.clock.reading_ns(np.array([stamp_ns]))[0])
        payload = pack_position(clock_ns, unit.gps.pps_at(stamp_ns), sentence)
        yield Packet(PacketKind.POSITION, due_ns, payload, unit.number, number=number)
