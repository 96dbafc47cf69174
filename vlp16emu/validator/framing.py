"""Rules about frames.

Lengths, ports, the headers around the payloads, and time stamps that keep pace with the capture's clock.

The header fields were measured on frames of two real units, see `vlp16emu.packets.frames`.
"""

import struct
from functools import lru_cache
from typing import TypeVar

import dpkt
import numpy as np
from numpy.typing import NDArray

from vlp16emu.packets.capture import Datagram
from vlp16emu.packets.frames import (
    DATA_PORT,
    DATA_TTL,
    HEADER_BYTES,
    POSITION_PORT,
    POSITION_TTL,
)
from vlp16emu.packets.layout import BLOCK_FLAG, DATA_BYTES, POSITION_BYTES, POSITION_PAYLOAD
from vlp16emu.types import PacketKind
from vlp16emu.units import HOUR_NS, MS_NS, US_NS
from vlp16emu.validator.rules import Findings, Level, Rule

Microseconds = TypeVar("Microseconds", int, NDArray[np.int64])

HOUR_US = HOUR_NS // US_NS
JITTER_US = 5 * MS_NS // US_NS
"""By how much a capturing host may be late with a stamp, bursts included; a quiet one stays below 0.1 ms."""
_DRIFT_PPM = 150
"""Sensors were seen 2 to 20 ppm off the clocks of hosts; a cheap oscillator may be 100 ppm off."""


def wrap_hour_us(difference_us: Microseconds) -> Microseconds:
    """Difference of two times past the hour, brought to half an hour around 0; number or (n,)."""
    half_us = HOUR_US // 2
    return (difference_us + half_us) % HOUR_US - half_us


class ClockWatch:
    """Follows the distance between capture stamp and time stamp of one stream."""

    def __init__(self, findings: Findings) -> None:
        self._findings = findings
        self._reference: tuple[int, int] | None = None

    def restart(self) -> None:
        """Forget the past, because the sensor's clock has been set."""
        self._reference = None

    def check(self, packet: int, stamp_ns: int, offset_us: int) -> None:
        """Compare with the first packet.

        Parameters
        ----------
        packet : frame number
        stamp_ns : capture stamp
        offset_us : capture stamp less time stamp
        """
        if self._reference is None:
            self._reference = stamp_ns, offset_us
            return
        since_ns = abs(stamp_ns - self._reference[0])
        moved_us = wrap_hour_us(offset_us - self._reference[1])
        if abs(moved_us) > JITTER_US + since_ns / US_NS * _DRIFT_PPM / 1e6:
            found = f"time stamps {-moved_us / 1e3:+.1f} ms off the capture stamps"
            expected = f"within {JITTER_US / 1e3:.0f} ms and {_DRIFT_PPM} ppm"
            self._findings.add(Rule.CLOCK_DRIFT, packet, found, expected)
            self._reference = stamp_ns, offset_us


_FLAG = BLOCK_FLAG.to_bytes(2, "little")
SENTENCE_OFFSET: int = POSITION_PAYLOAD.fields["sentence"][1]  # type: ignore[index]  # it has fields
"""First character of the sentence in a position payload."""
_PORT = {PacketKind.DATA: DATA_PORT, PacketKind.POSITION: POSITION_PORT}
"""From which both are sent, and to which unless the user has set others."""
_PAYLOAD_BYTES = {PacketKind.DATA: DATA_BYTES, PacketKind.POSITION: POSITION_BYTES}
_TTL = {PacketKind.DATA: DATA_TTL, PacketKind.POSITION: POSITION_TTL}
_FLAGS = {PacketKind.DATA: dpkt.ip.IP_DF, PacketKind.POSITION: 0}
_HEADER_FAULTS_CACHED = 64
_VELOVIEW = bytes.fromhex("607688000000 0800 4500 04d2 0000 4000 ff11 b4aa c0a801c8")
"""From the source MAC to the source address: the one header of its old versions for all packets. Source: Kitware/VeloView,
LidarPlugin/Common/Network/NetworkPacket.cxx; so has a capture of 2014."""


def kind_of(datagram: Datagram) -> PacketKind | None:
    """Say what a datagram is meant to be, by the port that it comes from, or else goes to, or by length and first mark."""
    for port in (datagram.source_port, datagram.destination_port):
        for kind, usual in _PORT.items():
            if port == usual:
                return kind
    payload = datagram.payload
    if len(payload) == DATA_BYTES and payload.startswith(_FLAG):
        return PacketKind.DATA
    has_sentence = len(payload) == POSITION_BYTES and payload.startswith(b"$GPRMC", SENTENCE_OFFSET)
    return PacketKind.POSITION if has_sentence else None


def check_frame(datagram: Datagram, kind: PacketKind, findings: Findings) -> bool:
    """Check lengths, ports and headers; returns whether the payload can be read.

    Users may send packets to any port (63-9243 Rev D, section 10.2.3.12); that they come from stays.
    """
    payload_bytes = _PAYLOAD_BYTES[kind]
    if len(datagram.payload) != payload_bytes:
        found = f"a {kind} payload of {len(datagram.payload)} bytes"
        findings.add(Rule.FRAMING, datagram.number, found, f"{payload_bytes} bytes")
        return False
    whole = len(datagram.header) + payload_bytes
    if not datagram.captured_bytes == datagram.wire_bytes == whole:
        found = f"{datagram.captured_bytes} of {datagram.wire_bytes} bytes captured"
        findings.add(Rule.FRAMING, datagram.number, found, f"a frame of {whole} bytes, whole")
    if datagram.source_port != _PORT[kind]:
        found = f"a {kind} packet from {datagram.source_port}"
        findings.add(Rule.PORTS, datagram.number, found, f"from {_PORT[kind]}")
    if kind is PacketKind.POSITION and is_rewritten(datagram):
        found = "position header that VeloView writes, that of data packets"
        findings.add(Rule.HEADER, datagram.number, found, "the sensor's own", Level.NOTE)
        return True
    for found, expected in _header_faults(datagram, kind):
        findings.add(Rule.HEADER, datagram.number, f"{kind} {found}", expected)
    return True


def is_rewritten(datagram: Datagram) -> bool:
    """Whether VeloView has put its own header around a packet: nothing is known of that of the sensor."""
    return datagram.header[6:30] == _VELOVIEW


def _header_faults(datagram: Datagram, kind: PacketKind) -> tuple[tuple[str, str], ...]:
    if kind is PacketKind.DATA:
        return _data_header_faults(datagram.header, datagram.ip_offset)
    return _common_faults(datagram.header, datagram.ip_offset, kind) + _udp_checksum_faults(datagram)


@lru_cache(_HEADER_FAULTS_CACHED)
def _data_header_faults(header: bytes, ip_offset: int) -> tuple[tuple[str, str], ...]:
    """Real sensors put one and the same header in front of all data packets, so look at it once."""
    faults = list(_common_faults(header, ip_offset, PacketKind.DATA))
    identification = int.from_bytes(header[ip_offset + 4 : ip_offset + 6])
    if identification != 0:
        faults.append((f"identification {identification}", "0"))
    checksum = int.from_bytes(header[-2:])
    if checksum != 0:
        faults.append((f"UDP checksum 0x{checksum:04x}", "0, for none"))
    return tuple(faults)


def _common_faults(header: bytes, ip_offset: int, kind: PacketKind) -> tuple[tuple[str, str], ...]:
    """Faults of the fields that both streams have in common, apart from their values."""
    ip = header[ip_offset:-8]
    tos, total, fragment, ttl = struct.unpack_from(">xBH2xHB", ip)
    checks = (
        ("header bytes", len(header), HEADER_BYTES),
        ("type of service", tos, 0),
        ("IP length", total, len(ip) + 8 + _PAYLOAD_BYTES[kind]),
        ("flags and offset", fragment, _FLAGS[kind]),
        ("TTL", ttl, _TTL[kind]),
        ("UDP length", int.from_bytes(header[-4:-2]), 8 + _PAYLOAD_BYTES[kind]),
        ("remainder of the IP header's sum", _remainder(ip), 0),
    )
    return tuple((f"{name} {value}", f"{want}") for name, value, want in checks if value != want)


def _udp_checksum_faults(datagram: Datagram) -> tuple[tuple[str, str], ...]:
    """Position packets carry a checksum, and a valid one."""
    if datagram.udp_checksum == 0:
        return (("UDP checksum 0", "a checksum"),)
    udp = datagram.header[-8:] + datagram.payload
    pseudo_header = datagram.ip[12:20] + struct.pack(">2H", dpkt.ip.IP_PROTO_UDP, len(udp))
    is_valid = _remainder(pseudo_header + udp) == 0
    return () if is_valid else ((f"UDP checksum 0x{datagram.udp_checksum:04x}", "the sum of the packet"),)


def _remainder(summed: bytes) -> int:
    """Checksum over bytes that hold their own checksum, 0 where it is valid.

    As 2**16 is 1 modulo 2**16 - 1, the sum of 16-bit words in ones' complement (RFC 1071) is that of the
    whole number; an even length is needed.
    """
    return int.from_bytes(summed) % 0xFFFF
