"""The stream of position packets: what the sensor says of its clock and of the GPS receiver."""

from collections.abc import Iterator

from vlp16emu.assembly import Parts
from vlp16emu.motion import fix_at
from vlp16emu.packets import STAMP_LEAD_NS, first_position_packet, pack_position, position_due_ns, rmc
from vlp16emu.scenario import Scenario
from vlp16emu.types import Packet, PacketKind

__all__ = ["position_number", "position_packets"]


def position_number(scenario: Scenario, since_ns: int) -> int:
    """Find the number of the first position packet due at a time since the first pulse, or later."""
    start_ns = scenario.start_ns
    return first_position_packet(scenario.sensor.position_rate, scenario.seed, start_ns, start_ns + since_ns)


def position_packets(scenario: Scenario, parts: Parts, start_ns: int, stop_ns: int) -> Iterator[Packet]:
    """Yield the position packets due in a span since the first pulse."""
    rate, gps, clock = scenario.sensor.position_rate, parts.gps, parts.head.clock
    named_ns, sentence = None, b""
    for number in range(position_number(scenario, start_ns), position_number(scenario, stop_ns)):
        due_ns = position_due_ns(rate, scenario.seed, scenario.start_ns, number, 1)
        stamp_ns = due_ns - STAMP_LEAD_NS
        second_ns = gps.second_ns(int(stamp_ns[0]))
        if second_ns is not None and second_ns != named_ns:
            fix = fix_at(parts.motion, second_ns, scenario.gps.latitude_deg, scenario.gps.longitude_deg)
            named_ns, sentence = second_ns, rmc(fix)
        payload = pack_position(int(clock.reading_ns(stamp_ns)[0]), gps.pps, sentence)
        yield Packet(PacketKind.POSITION, int(due_ns[0]), payload)
