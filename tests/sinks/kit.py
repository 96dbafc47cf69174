"""Packets to send."""

from vlp16emu.types import Packet, PacketKind

PERIOD_NS = 1_327_104
START_NS = 1_732_000_000_123_456_789


def make_packets(count, first_number=0):
    """Packets at the times of single return, every fifth one a position packet."""
    packets = []
    for i in range(count):
        kind, size = (PacketKind.POSITION, 512) if i % 5 == 4 else (PacketKind.DATA, 1206)
        payload = i.to_bytes(2) * (size // 2)
        packets.append(Packet(kind, START_NS + i * PERIOD_NS, payload, number=first_number + i // 5))
    return packets
