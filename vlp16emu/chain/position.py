"""The stream of position packets: what the sensor says of its clock and of the GPS receiver."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from vlp16emu.chain import Parts, Unit
from vlp16emu.chain.windows import Windows
from vlp16emu.device import GpsInput
from vlp16emu.motion.gnss import Receiver
from vlp16emu.packets import STAMP_LEAD_NS, first_position_packet, pack_position, position_due_ns, rmc
from vlp16emu.raycast.caster import Geometry
from vlp16emu.raycast.sky import sky_cover
from vlp16emu.scenario import Scenario
from vlp16emu.sensor.settings import on_the_wire
from vlp16emu.types import Packet, PacketKind

__all__ = ["make_receiver", "position_number", "position_packets"]

_AT_ONCE = 128
"""Position packets whose times are found at once, a second of them."""
_LOWEST_DEG = 15.0
"""Elevation from which on receivers use satellites: the usual mask of forest surveys."""


def make_receiver(scenario: Scenario, parts: Parts, windows: Windows[Geometry]) -> Receiver:
    """Make the GPS receiver, which sees the sky through the windows of the run."""
    gps, start_ns, far_m = scenario.gps, scenario.start_ns, scenario.sensor.max_range_m

    def cover(t_ns: int, antenna_m: NDArray[np.float64]) -> float:
        """Share of the sky that is covered over the antenna."""
        geometry = windows.wait(windows.at_time(t_ns - start_ns))
        return sky_cover(geometry, t_ns, antenna_m, _LOWEST_DEG, far_m)

    sky = cover if gps.canopy_loss else None
    return Receiver(parts.motion, gps, seed=scenario.seed, sky=sky)


def position_number(scenario: Scenario, unit: Unit, since_ns: int) -> int:
    """Find the number of a unit's first position packet due at a time since the first pulse, or later."""
    start_ns, rate = scenario.start_ns, on_the_wire(unit.section).position_rate
    return first_position_packet(rate, unit.seed, start_ns, start_ns + since_ns)


def position_packets(
    scenario: Scenario, gps: GpsInput, receiver: Receiver, unit: Unit, start_ns: int, stop_ns: int
) -> Iterator[Packet]:
    """Yield the position packets of a unit due in a span since the first pulse."""
    rate, clock = on_the_wire(unit.section).position_rate, unit.head.clock
    named_ns, sentence = None, b""
    first, stop = (position_number(scenario, unit, since_ns) for since_ns in (start_ns, stop_ns))
    for number in range(first, stop, _AT_ONCE):
        due_ns = position_due_ns(rate, unit.seed, scenario.start_ns, number, min(_AT_ONCE, stop - number))
        stamp_ns = due_ns - STAMP_LEAD_NS
        clock_ns = clock.reading_ns(stamp_ns).tolist()
        for due, stamp, reading in zip(due_ns.tolist(), stamp_ns.tolist(), clock_ns, strict=True):
            second_ns = gps.second_ns(stamp)
            if second_ns is not None and second_ns != named_ns:
                named_ns, sentence = second_ns, rmc(receiver.fix(second_ns))
            if unit.sending.is_silent(due - scenario.start_ns):
                continue
            payload = pack_position(reading, gps.pps, sentence)
            yield Packet(PacketKind.POSITION, due, payload, unit.number)
