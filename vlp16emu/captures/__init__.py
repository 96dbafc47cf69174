"""Captures of VLP-16 traffic, read: datagrams and the sensors that sent them, the UTC of their packets, and their points."""

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
