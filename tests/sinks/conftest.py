"""Packets to send."""

import pytest

from vlp16emu.types import Packet, PacketKind

START_NS = 1_732_000_000_123_456_789
DATA_PERIOD_NS = 1_327_104


@pytest.fixture
def make_packets():
    """Give a maker of n packets at the times of single return, every fifth one a position packet."""

    def make(count, start_ns=START_NS, first_number=0):
        packets = []
        for i in range(count):
            kind, size = (PacketKind.POSITION, 512) if i % 5 == 4 else (PacketKind.DATA, 1206)
            due_ns, payload = start_ns + i * DATA_PERIOD_NS, i.to_bytes(2) * (size // 2)
            packets.append(Packet(kind, due_ns, payload, number=first_number + i // 5))
        return packets

    return make
