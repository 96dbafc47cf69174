"""Names of the rules of VLP-16 traffic, and the checks of frames: ports, headers, order, clock drift.

The header fields were measured on frames of two real units, see `vlp16emu.packets.frames`.
"""

import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from importlib.resources import files
from typing import Any, NamedTuple

import dpkt
import numpy as np
from numpy.typing import NDArray

from vlp16emu.captures.datagrams import Datagram
from vlp16emu.packets import layout
from vlp16emu.packets.frames import DATA_PORT, DATA_TTL, POSITION_PORT, POSITION_TTL
from vlp16emu.packets.table import wrap_hour
from vlp16emu.types import I8, PacketKind
from vlp16emu.units import HOUR_NS, MS_NS, US_NS


class Level(StrEnum):
    """Weight of a finding."""

    ERROR = "error"  # no sensor sends it
    NOTE = "note"
    """Caused by settings of the user, receivers, old firmware or recorders; the sensor works correctly."""


class Rule(StrEnum):
    """Rules of real VLP-16 traffic.

    Sources: 63-9243 Rev D, sections 8 (rates) and 9.3 (packets), and captures of real units.
    """

    FRAMING = "framing"  # payloads of 1206 and 512 bytes, whole frames without padding or trailer
    PORTS = "ports"  # source ports are 2368 and 8308; destination ports may be set
    HEADER = "header"  # IPv4 and UDP header fields of each stream, checksums included
    STAMP_ORDER = "stamp-order"  # capture stamps never decrease
    FLAG = "flag"  # every block begins with FF EE
    FACTORY = "factory"
    """Return mode and product are known and the product does not change; a change of mode is a note."""
    TIME_RANGE = "time-range"  # time stamps lie within the hour
    TIME_STEP = "time-step"
    """Time stamps increase by one packet period, across the hour too; a step when GPS is gained is a note."""
    LOST_PACKETS = "lost-packets"  # no packet is missing
    DUPLICATE = "duplicate"  # no packet is repeated
    PACKET_ORDER = "packet-order"  # packets come in order of their time stamps
    FROZEN = "frozen"  # no payload is sent repeatedly, as by a sensor that hangs
    SILENCE = "silence"
    """Packets of one kind or the other arrive all the time while the sensor has power and its cable."""
    LATENESS = "lateness"
    """No packet is later, relative to its time stamp, than its neighbours by more than 5 ms."""
    CLOCK_DRIFT = "clock-drift"  # time stamps keep pace with the capture stamps
    HOST_CLOCK = "host-clock"  # nobody sets the clock of the capture stamps; if somebody does, it is a note
    AZIMUTH_RANGE = "azimuth-range"  # azimuths lie in 0 .. 35999
    AZIMUTH_STEP = "azimuth-step"  # azimuths increase evenly from block to block, across 0 too
    AZIMUTH_GAP = "azimuth-gap"
    """The whole revolution is sent; a limited field of view, a setting of the manual's section 10.1, is a
    note."""
    SINGLE_AS_DUAL = "single-as-dual"
    """In single return the first two blocks differ in azimuth, which some software mistakes for dual."""
    RPM = "rpm"  # the rotor makes 300 to 1200 revolutions per minute
    SPEED = "speed"
    """The rotor holds its speed, a multiple of 60 rpm; a change to another one is a note, and so is another
    one all along."""
    LASER = "laser"  # every laser has returns where those beside it have
    WINDOW = "window"  # no sector turns dark suddenly
    DISTANCE_CODE = "distance-code"  # distances are 0 or at least 250 counts
    DUAL_AZIMUTH = "dual-azimuth"  # in dual return the two blocks of a pair have one azimuth
    DUAL_ORDER = "dual-order"  # the last return, in the even block, is never nearer than its pair
    DUAL_REFLECTIVITY = "dual-reflectivity"
    """Pairs of equal distance have equal reflectivity, with rare exceptions."""
    POSITION_HEAD = "position-head"  # position packets begin with 14 zeros
    PPS = "pps"  # the state of the pulse per second is 0 .. 2; 3 is an error. Once locked it stays locked
    NMEA_FORMAT = "nmea-format"
    """The sentence is RMC as NMEA 0183 has it, by a talker GP, else a note; there is one when the state is
    locked."""
    NMEA_CHECKSUM = "nmea-checksum"  # the sentence's checksum is right
    NMEA_END = "nmea-end"  # the sentence ends with CR LF, and only NUL follows
    NMEA_SECOND = "nmea-second"
    """The sentence names the second before the time stamp, or the one before that; unless locked, a
    disagreement is a note."""
    NMEA_TIME = "nmea-time"  # when locked, sentences come at one time after their second, within 0.25 s
    DATA_RATE = "data-rate"  # 753.5 data packets per second in single, 1507 in dual return, within 10 %
    POSITION_RATE = "position-rate"
    """146 position packets per second as measured, or 53.8 as in the manual, within 10 %."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One place where a rule is broken."""

    rule: Rule
    packet: int  # number of the frame in the capture, from 1, as in Wireshark
    found: str
    expected: str
    level: Level = Level.ERROR

    def __str__(self) -> str:
        rule = f"{self.rule} (note)" if self.level is Level.NOTE else self.rule
        return f"packet {self.packet}: {rule}: {self.found}; expected {self.expected}"


class Row(NamedTuple):
    """One row of `rules.toml`: the column of a chunk that marks broken rules, and the text of a finding."""

    rule: Rule
    broken: str  # boolean column, (n,) or with more axes
    found: str  # format of the text, with names of columns of the same shape, or of single values
    expected: str
    level: Level = Level.ERROR
    at: str = "number"  # column of the frame numbers to which the findings belong
    once: bool = False  # True if only the first finding is kept; all are counted


def _row(rule: str, level: str = Level.ERROR, **columns: Any) -> Row:
    return Row(rule=Rule(rule), level=Level(level), **columns)


_ROWS = tomllib.loads(files(__package__).joinpath("rules.toml").read_text(encoding="utf-8"))
TABLES = {name: tuple(_row(**row) for row in rows) for name, rows in _ROWS.items()}
"""Tables of rules by name."""


class _Element:
    """One element of each column, by the name of the column, for `str.format_map`."""

    def __init__(self, columns: object, index: int) -> None:
        self._columns = columns
        self._index = index

    def __getitem__(self, name: str) -> Any:
        value = getattr(self._columns, name)
        return value.flat[self._index] if isinstance(value, np.ndarray) else value


class Findings:
    """Count of all findings, and the first `limit_per_rule` of each rule."""

    def __init__(self, limit_per_rule: int) -> None:
        self._limit = limit_per_rule
        self.counts = {level: Counter[Rule]() for level in Level}
        self.kept: list[Finding] = []
        self._kept_once = set[Row]()

    def add(self, rule: Rule, packet: int, found: str, expected: str, level: Level = Level.ERROR) -> None:
        """Add one finding."""
        if self.counts[level][rule] < self._limit:
            self.kept.append(Finding(rule, packet, found, expected, level))
        self.counts[level][rule] += 1

    def apply(self, table: Iterable[Row], columns: object, where: slice = slice(None)) -> None:
        """Add a finding for each true element in the columns that a table names.

        `where` limits the rows of a chunk.
        """
        for row in table:
            broken: NDArray[np.bool_] = getattr(columns, row.broken)
            inside = np.zeros_like(broken)
            inside[where] = broken[where]
            if not (places := np.flatnonzero(inside)).size:
                continue
            number = getattr(columns, row.at).ravel()
            left = max(self._limit - self.counts[row.level][row.rule], 0)
            if row.once:
                left = int(row not in self._kept_once)
                self._kept_once.add(row)
            for i in places[:left].tolist():
                element = _Element(columns, i)
                found, expected = (text.format_map(element) for text in (row.found, row.expected))
                self.kept.append(Finding(row.rule, int(number[i]), found, expected, row.level))
            self.counts[row.level][row.rule] += len(places)


HOUR_US = HOUR_NS // US_NS
JITTER_US = 5 * MS_NS // US_NS
"""Greatest delay of a capture stamp, bursts included; a quiet host stays below 0.1 ms."""
_LAYOUTS = {PacketKind.DATA: layout.DATA_PAYLOAD, PacketKind.POSITION: layout.POSITION_PAYLOAD}
STAMP_AT: dict[PacketKind, int] = {
    kind: fields.fields["timestamp_us"][1]  # type: ignore[index]  # it has fields
    for kind, fields in _LAYOUTS.items()
}
"""First byte of the time stamp in a payload of each kind."""
_MODE_AT: int = layout.DATA_PAYLOAD.fields["return_mode"][1]  # type: ignore[index]  # it has fields
_HELD = 128  # packets that are held for sorting: 0.17 s of single return
_FLAG = layout.BLOCK_FLAG.to_bytes(2, "little")
SENTENCE_OFFSET: int = layout.POSITION_PAYLOAD.fields["sentence"][1]  # type: ignore[index]  # it has fields
"""First character of the sentence in a position payload."""
PORT = {PacketKind.DATA: DATA_PORT, PacketKind.POSITION: POSITION_PORT}
"""Source port of each kind, and destination unless the user has set another (63-9243 Rev D, section
10.2.3.12)."""
PAYLOAD_BYTES = {PacketKind.DATA: layout.DATA_BYTES, PacketKind.POSITION: layout.POSITION_BYTES}
_TTL = {PacketKind.DATA: DATA_TTL, PacketKind.POSITION: POSITION_TTL}
_FLAGS = {PacketKind.DATA: dpkt.ip.IP_DF, PacketKind.POSITION: 0}
_VELOVIEW = bytes.fromhex("607688000000 0800 4500 04d2 0000 4000 ff11 b4aa c0a801c8")
"""Header from source MAC to source address that old versions of VeloView give all packets. Source:
Kitware/VeloView, LidarPlugin/Common/Network/NetworkPacket.cxx, and a capture of 2014."""
_HEADER = np.dtype(
    [
        *(("version", "u1"), ("tos", "u1"), ("total", ">u2"), ("identification", ">u2"), ("fragment", ">u2")),
        *(("ttl", "u1"), ("protocol", "u1"), ("ip_sum", ">u2"), ("addresses", "V8")),
        *(("source_port", ">u2"), ("destination_port", ">u2"), ("udp_bytes", ">u2"), ("udp_sum", ">u2")),
    ]
)  # IPv4 header without options and UDP header (RFC 791, RFC 768)


def kind_of(datagram: Datagram) -> PacketKind | None:
    """Return the kind of a datagram.

    It follows from the source port, else the destination port, else length and first bytes.
    """
    for port in (datagram.source_port, datagram.destination_port):
        for kind, usual in PORT.items():
            if port == usual:
                return kind
    payload = datagram.payload
    if len(payload) == layout.DATA_BYTES and payload.startswith(_FLAG):
        return PacketKind.DATA
    has_sentence = len(payload) == layout.POSITION_BYTES and payload.startswith(b"$GPRMC", SENTENCE_OFFSET)
    return PacketKind.POSITION if has_sentence else None


def is_rewritten(datagram: Datagram) -> bool:
    """Return True if VeloView has replaced the header of a packet by its own."""
    return datagram.header[6:30] == _VELOVIEW


class _Frames:
    """Columns of n frames of one kind whose payloads have the right length.

    Header fields (n, c) beside their correct values.
    """

    def __init__(self, datagrams: Sequence[Datagram], kind: PacketKind, *, is_known: bool) -> None:
        self.kind = kind
        is_data = kind is PacketKind.DATA
        payload_bytes = PAYLOAD_BYTES[kind]
        columns = [
            (each.number, each.captured_bytes, each.wire_bytes, len(each.header), each.ip_offset)
            for each in datagrams
        ]
        self.number, self.captured_bytes, self.wire_bytes, header_bytes, ip_offset = np.array(columns).T
        self.frame_bytes = header_bytes + payload_bytes
        self.is_cut = (self.captured_bytes != self.frame_bytes) | (self.wire_bytes != self.frame_bytes)
        self.is_rewritten = np.array([not is_data and is_rewritten(each) for each in datagrams])
        raw = np.frombuffer(b"".join([each.ip[:20] + each.header[-8:] for each in datagrams]), _HEADER)
        header = _words(raw.tobytes(), len(raw))
        # Words that include their own checksum add up to a multiple of 2**16 - 1 (RFC 1071).
        fields = [
            ("IP version", raw["version"] >> 4, 4),
            ("header bytes", header_bytes - ip_offset, 28),
            ("type of service", raw["tos"], 0),
            ("IP length", raw["total"], 28 + payload_bytes),
            ("flags and offset", raw["fragment"] * is_known, _FLAGS[kind] * is_known),
            ("TTL", raw["ttl"] * is_known, _TTL[kind] * is_known),
            ("UDP length", raw["udp_bytes"], 8 + payload_bytes),
            ("remainder of the IP header's sum", header[:, :10].sum(axis=1) % 0xFFFF, 0),
            ("identification", raw["identification"] * (is_data and is_known), 0),
            ("UDP checksum", raw["udp_sum"] * (is_data and is_known), 0),
        ]
        if not is_data:
            payload = _words(b"".join(datagram.payload for datagram in datagrams), len(raw))
            # The UDP sum includes addresses, protocol and length (RFC 768).
            udp = header[:, 6:].sum(axis=1) + payload.sum(axis=1) + dpkt.ip.IP_PROTO_UDP + raw["udp_bytes"]
            remainder = np.where(raw["udp_sum"], udp % 0xFFFF, -1)
            fields.append(("remainder of the UDP sum (-1: none sent)", remainder, 0))
        names, values, correct = zip(*fields, strict=True)
        self.value = np.stack([np.asarray(column, np.int64) for column in values], axis=1)
        self.field = np.broadcast_to(names, self.value.shape)
        self.correct = np.broadcast_to(correct, self.value.shape)
        self.is_fragmented = (raw["version"] >> 4 == 4) & ((raw["fragment"] & 0x3FFF) != 0)
        self.is_other = (self.value != self.correct) & ~(self.is_rewritten | self.is_fragmented)[:, None]
        self.is_other[:, 1:] &= self.is_other[:, :1] == 0  # another IP version has its fields elsewhere
        self.field_number = np.broadcast_to(self.number[:, None], self.value.shape)


def _words(data: bytes, rows: int) -> I8:
    """Return big-endian words of 16 bits (rows, c), whose sums are checked."""
    return np.frombuffer(data, ">u2").reshape(rows, -1).astype(np.int64)


def check_frames(
    datagrams: Sequence[Datagram], kind: PacketKind, findings: Findings, *, is_known: bool
) -> None:
    """Check lengths and headers of frames whose payloads have the right length.

    `is_known` is True if the model's own choices in its headers are known.
    """
    if datagrams:
        findings.apply(TABLES["frames"], _Frames(datagrams, kind, is_known=is_known))


class InOrder:
    """Sorter of the packets of one kind into the order of their creation, which drops repeated packets.

    A packet that does not fit the held packets, because the clock has been set or a stamp is wrong, keeps its
    place.
    """

    def __init__(self, kind: PacketKind, findings: Findings) -> None:
        self._kind = kind
        self._findings = findings
        self._stamp_at = STAMP_AT[kind]
        self._is_at_start = True  # no packet of this stretch has been yielded
        self._held: list[tuple[int, Datagram]] = []  # packets with their time stamps, us
        self._repeats = 0
        self.duplicates = 0  # repeated packets so far, without the packets of a sensor that hangs

    def take(self, datagram: Datagram) -> Iterator[Datagram]:
        """Insert a packet in order, and yield the packets that no later packet can precede."""
        stamp_us = int.from_bytes(datagram.payload[self._stamp_at : self._stamp_at + 4], "little")
        for known_us, known in reversed(self._held):
            if datagram.payload == known.payload:
                self._report_repeat(datagram, known)
                return
            if known_us <= stamp_us:
                break
        self._repeats = 0
        place = len(self._held)
        if self._held and self._since_us(stamp_us, -1) < 0:
            if self._is_late(stamp_us, datagram):
                places = (n for n in range(place, 0, -1) if self._since_us(stamp_us, n - 1) >= 0)
                place = next(places, 0)
                found = f"a {self._kind} packet overtaken by {len(self._held) - place}"
                self._findings.add(
                    Rule.PACKET_ORDER, datagram.number, found, "packets in order of their time stamps"
                )
            else:
                yield from self.rest()
                place = 0
        self._held.insert(place, (stamp_us, datagram))
        if len(self._held) > _HELD:
            self._is_at_start = False
            yield self._held.pop(0)[1]

    @property
    def held(self) -> list[Datagram]:
        """Packets that wait for earlier ones."""
        return [datagram for _, datagram in self._held]

    def count_until(self, yielded: int) -> int:
        """Return after how many packets in order as many of them have been yielded."""
        return yielded + _HELD - len(self._held)

    def continues(self, stamps_us: I8, most_us: int) -> bool:
        """Return True if time stamps (n,) grow from packet to packet, from the latest held one on.

        By at most `most_us` each: such packets repeat and overtake none.
        """
        if not len(stamps_us):
            return True
        steps_us = np.diff(stamps_us, prepend=self._held[-1][0] if self._held else stamps_us[0])
        return bool(((steps_us > 0) & (steps_us <= most_us)).all())

    def extend(self, stamps_us: I8, datagrams: Sequence[Datagram]) -> list[Datagram]:
        """Append packets for which `continues` is true; return those that `take` would yield."""
        if not datagrams:
            return []
        self._repeats = 0
        self._held += zip(stamps_us.tolist(), datagrams, strict=True)
        count = max(len(self._held) - _HELD, 0)
        passed = [datagram for _, datagram in self._held[:count]]
        self._held = self._held[count:]
        self._is_at_start &= count == 0
        return passed

    def rest(self) -> Iterator[Datagram]:
        """Yield the packets that are still held."""
        held = self._held
        self._held = []
        self._is_at_start = True
        yield from (datagram for _, datagram in held)

    def _report_repeat(self, datagram: Datagram, known: Datagram) -> None:
        """Report a repeated packet; a sensor that hangs sends it again and again."""
        rule = Rule.DUPLICATE
        found = f"packet {known.number} again"
        counts_on = self._kind is PacketKind.POSITION and datagram.identification != known.identification
        if self._repeats > 0 or counts_on:
            rule = Rule.FROZEN
            found = f"the payload of packet {known.number} again and again"
        self._repeats += 1
        self.duplicates += rule is Rule.DUPLICATE
        self._findings.add(rule, datagram.number, found, f"a new {self._kind} packet")

    def _is_late(self, stamp_us: int, datagram: Datagram) -> bool:
        """Return True if a packet belongs between held ones.

        It follows from the period of data packets, or the count of position packets.
        """
        if self._since_us(stamp_us, 0) <= 0 and not self._is_at_start:
            return False
        if self._kind is PacketKind.POSITION:
            return 0 < (self._held[-1][1].identification - datagram.identification) % 0x10000 <= _HELD
        mode, product = datagram.payload[_MODE_AT : _MODE_AT + 2]
        if mode not in layout.RETURN_MODE_BYTE.values():
            return False
        behind_ns = -self._since_us(stamp_us, -1) * US_NS
        for of_model in layout.candidates(mode, product):
            off_ns = abs(behind_ns - round(behind_ns / of_model.period_ns) * of_model.period_ns)
            is_whole = off_ns <= 2 * US_NS or of_model.model.period_us is not None
            if behind_ns <= _HELD * of_model.period_ns and is_whole:
                return True
        return False

    def _since_us(self, stamp_us: int, place: int) -> int:
        """Return the time from the packet at a place among the held ones until a time stamp."""
        return wrap_hour(stamp_us - self._held[place][0], HOUR_US)
