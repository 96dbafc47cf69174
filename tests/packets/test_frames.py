"""Ethernet frames around the payloads."""

import struct
from pathlib import Path

import dpkt
import pytest

from vlp16emu.packets.frames import FACTORY_LINK, Link, data_header, position_frame

CAPTURE = Path(__file__).parents[2] / ".." / "shared" / "captures" / "mrpt_vlp16_gps.pcap"
# The unit of the capture, which somebody had given another address.
CAPTURED_LINK = Link(bytes.fromhex("607688102f6f"), b"\xff" * 6, "10.0.0.100", "255.255.255.255")


def slow_checksum(data: bytes) -> int:
    """Sum 16-bit words in ones' complement one by one, as RFC 1071 has it."""
    total = 0
    for (word,) in struct.iter_unpack(">H", data):
        total += word
        total = (total & 0xFFFF) + (total >> 16)
    return ~total & 0xFFFF


@pytest.mark.parametrize("number", [0, 1, 0x8537, 0xFFFF])
def test_position_frame_has_valid_checksums(number):
    """Both checksums of a position frame are those of a sum made word by word, and its fields are the real
    ones."""
    frame = position_frame(FACTORY_LINK, bytes(range(256)) * 2, number)
    ip, udp = frame[14:34], frame[34:]
    assert len(frame) == 554
    assert slow_checksum(ip) == 0
    assert slow_checksum(ip[12:20] + struct.pack(">HH", 17, len(udp)) + udp) == 0
    assert ip[:10] == struct.pack(">BBHHHBB", 0x45, 0, 540, number, 0, 64, 17)
    assert udp[:6] == struct.pack(">HHH", 8308, 8308, 520)


def test_position_frames_at_their_limits():
    """Packet 65536 has the identification of packet 0; a UDP checksum of 0, which means none, is sent as
    0xFFFF (RFC 768)."""
    payload = bytes(512)
    assert position_frame(FACTORY_LINK, payload, 0x10000) == position_frame(FACTORY_LINK, payload, 0)
    payload = bytearray(512)
    frame = position_frame(FACTORY_LINK, bytes(payload), 7)
    payload[:2] = frame[40:42]  # adding a checksum to its own data makes the sum come out as 0
    assert position_frame(FACTORY_LINK, bytes(payload), 7)[40:42] == b"\xff\xff"


@pytest.mark.parametrize("size", [0, 1, 100, 511])
def test_frames_of_cut_packets_are_whole_frames(size):
    """IP and UDP lengths are those of what is left, and checksums right, also of an odd number of bytes."""
    payload = bytes(range(1, 256)) * 3
    position = position_frame(FACTORY_LINK, payload[:size], 7)
    for frame in (data_header(FACTORY_LINK, size) + payload[:size], position):
        ip = dpkt.ethernet.Ethernet(frame).data
        assert (ip.len, ip.data.ulen, ip.data.data) == (28 + size, 8 + size, payload[:size])
        assert slow_checksum(frame[14:34]) == 0
    pseudo = position[26:34] + struct.pack(">2H", 17, 8 + size)
    assert slow_checksum(pseudo + position[34:] + bytes(size % 2)) == 0


@pytest.mark.skipif(not CAPTURE.exists(), reason="no real captures beside the repository")
def test_every_frame_of_the_real_capture_is_rebuilt():
    """All 350 frames that a real unit sent come out byte by byte from their payloads."""
    with CAPTURE.open("rb") as file:
        frames = [frame for _, frame in dpkt.pcap.Reader(file)]
    for frame in frames:
        payload = frame[42:]
        if len(payload) == 1206:
            rebuilt = data_header(CAPTURED_LINK) + payload
        else:
            rebuilt = position_frame(CAPTURED_LINK, payload, int.from_bytes(frame[18:20]))
        assert rebuilt == frame
    assert len(frames) == 350
