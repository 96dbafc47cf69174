"""Reading of VLP-16 captures: datagrams, the sensors that sent them, the UTC of packets, and points."""

from vlp16emu.captures.capture import Capture, chosen_unit, units_in
from vlp16emu.captures.reading import (
    CaptureReader,
    Clock,
    PacketChunk,
    PacketClock,
    UnitClock,
    packet_clock,
    unit_clocks,
)
