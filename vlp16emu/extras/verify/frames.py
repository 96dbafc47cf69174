"""Rules about frames: lengths, ports, headers, their order, and time stamps that keep pace with the capture's clock.

The header fields were measured on frames of two real units, see `vlp16emu.packets.frames`.
"""

import struct
from collections.abc import Iterator
from functools import lru_cache
from typing import TypeVar

import dpkt
import numpy as np
from numpy.typing import NDArray

from vlp16emu.extras.verify.rules import Findings, Level, Rule
from vlp16emu.packets.capture import Datagram
from vlp16emu.packets.frames import DATA_PORT, DATA_TTL, HEADER_BYTES, POSITION_PORT, POSITION_TTL
from vlp16emu.packets.layout import (
    BLOCK_FLAG,
    DATA_BYTES,
    DATA_PAYLOAD,
    POSITION_BYTES,
    POSITION_PAYLOAD,
    RETURN_MODE_BYTE,
    SEQUENCES_PER_PACKET,
)
from vlp16emu.sensor.beams import SEQUENCE_NS
from vlp16emu.types import PacketKind
from vlp16emu.units import HOUR_NS, MS_NS, US_NS

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
        """Compare the offset of a frame, its capture stamp less its time stamp, with that of the first packet."""
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


_LAYOUTS = {PacketKind.DATA: DATA_PAYLOAD, PacketKind.POSITION: POSITION_PAYLOAD}
_MODE_AT: int = DATA_PAYLOAD.fields["return_mode"][1]  # type: ignore[index]  # it has fields
_PERIODS_NS = {RETURN_MODE_BYTE[mode]: count * SEQUENCE_NS for mode, count in SEQUENCES_PER_PACKET.items()}
_HELD = 128
"""Packets among which one is put in its place: those of 0.17 s in single return."""
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
    faults = _header_faults(datagram.header, datagram.ip_offset, kind)
    for found, expected in faults + (_udp_checksum_faults(datagram) if kind is PacketKind.POSITION else ()):
        findings.add(Rule.HEADER, datagram.number, f"{kind} {found}", expected)
    return True


def is_rewritten(datagram: Datagram) -> bool:
    """Whether VeloView has put its own header around a packet: nothing is known of that of the sensor."""
    return datagram.header[6:30] == _VELOVIEW


@lru_cache(_HEADER_FAULTS_CACHED)
def _header_faults(header: bytes, ip_offset: int, kind: PacketKind) -> tuple[tuple[str, str], ...]:
    """Check the fields; real sensors put one and the same header in front of all data packets, so it is looked at once."""
    ip, payload_bytes, is_data = header[ip_offset:-8], _PAYLOAD_BYTES[kind], kind is PacketKind.DATA
    tos, total, identification, fragment, ttl = struct.unpack_from(">xBHHHB", ip)
    checksum = int.from_bytes(header[-2:])
    checks = (
        ("header bytes", len(header), HEADER_BYTES),
        ("type of service", tos, 0),
        ("IP length", total, len(ip) + 8 + payload_bytes),
        ("flags and offset", fragment, _FLAGS[kind]),
        ("TTL", ttl, _TTL[kind]),
        ("UDP length", int.from_bytes(header[-4:-2]), 8 + payload_bytes),
        ("remainder of the IP header's sum", _remainder(ip), 0),
        ("identification", is_data and identification, 0),
    )
    faults = [(f"{name} {value}", f"{want}") for name, value, want in checks if value != want]
    if is_data and checksum:
        faults.append((f"UDP checksum 0x{checksum:04x}", "0, for none"))
    return tuple(faults)


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


class InOrder:
    """Brings the packets of one kind into the order in which they were made, and leaves out those that come again.

    What does not fit the packets held, because the clock has been set or a stamp is wrong, stays where it is.
    """

    def __init__(self, kind: PacketKind, findings: Findings) -> None:
        self._kind, self._findings = kind, findings
        self._stamp_at: int = _LAYOUTS[kind].fields["timestamp_us"][1]  # type: ignore[index]  # it has fields
        self._held: list[Datagram] = []
        self._repeats = 0

    def take(self, datagram: Datagram) -> Iterator[Datagram]:
        """Put a packet in its place, and yield those whose turn has come."""
        for known in reversed(self._held):
            if datagram.payload == known.payload:
                self._report_again(datagram, known)
                return
            if self._stamp_us(known) <= self._stamp_us(datagram):
                break
        self._repeats = 0
        place = len(self._held)
        if self._held and self._since_us(datagram, self._held[-1]) < 0:
            if self._is_late(datagram):
                place = next(n for n in range(place, 0, -1) if self._since_us(datagram, self._held[n - 1]) >= 0)
                found = f"a {self._kind} packet overtaken by {len(self._held) - place}"
                self._findings.add(Rule.PACKET_ORDER, datagram.number, found, "packets in order of their time stamps")
            else:
                yield from self.rest()
                place = 0
        self._held.insert(place, datagram)
        if len(self._held) > _HELD:
            yield self._held.pop(0)

    def rest(self) -> Iterator[Datagram]:
        """Yield those that are still held."""
        held, self._held = self._held, []
        yield from held

    def _report_again(self, datagram: Datagram, known: Datagram) -> None:
        """Report a packet that was there already; a sensor that hangs sends it again and again."""
        rule, found = Rule.DUPLICATE, f"packet {known.number} again"
        counts_on = self._kind is PacketKind.POSITION and datagram.identification != known.identification
        if self._repeats > 0 or counts_on:
            rule, found = Rule.FROZEN, f"the payload of packet {known.number} again and again"
        self._repeats += 1
        self._findings.add(rule, datagram.number, found, f"a new {self._kind} packet")

    def _is_late(self, datagram: Datagram) -> bool:
        """Whether it belongs between those that are held: by the period of data packets, or the count of position packets."""
        if self._since_us(datagram, self._held[0]) <= 0:
            return False
        if self._kind is PacketKind.POSITION:
            return 0 < (self._held[-1].identification - datagram.identification) % 0x10000 <= _HELD
        period_ns = _PERIODS_NS.get(datagram.payload[_MODE_AT])
        if period_ns is None:
            return False
        behind_ns = -self._since_us(datagram, self._held[-1]) * US_NS
        return abs(behind_ns - round(behind_ns / period_ns) * period_ns) <= 2 * US_NS

    def _since_us(self, datagram: Datagram, other: Datagram) -> int:
        return wrap_hour_us(self._stamp_us(datagram) - self._stamp_us(other))

    def _stamp_us(self, datagram: Datagram) -> int:
        return int.from_bytes(datagram.payload[self._stamp_at : self._stamp_at + 4], "little")
