"""Runs of records in memory, walked by kernels: nearly all frames of a capture are read here."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from vlp16emu.kernels.compiler import inline_kernel, kernel
from vlp16emu.packets.layout import BLOCK_FLAG, DATA_BYTES, POSITION_BYTES, POSITION_PAYLOAD
from vlp16emu.types import I8, U1
from vlp16emu.units import S_NS

DAY_S = 86_400  # stamps of records that follow one another differ by less
LONGEST_FRAME_BYTES = 262_144  # a longer record means damage (MAXIMUM_SNAPLEN of libpcap)
_HEAD_BYTES = 12  # of a header that are judged: stamp and captured length
_MOST_RECORDS = 4096  # in a run
_FLAG_LOW = BLOCK_FLAG & 0xFF
_FLAG_HIGH = BLOCK_FLAG >> 8
ETHERNET = 1  # link type. Source: www.tcpdump.org/linktypes.html
IP_AT = 14
SOURCE_AT = 26
UDP_AT = 34
PAYLOAD_AT = 42
"""Offsets in a plain frame of IP header, sender's address, UDP header and payload."""
_IPV4_WITHOUT_OPTIONS = 0x080045  # type of Ethernet, version and length of the header (RFC 791)
_UDP_NUMBER = 17
_DONT_FRAGMENT = 0x4000
_VXLAN = 4789  # UDP ports of tunnels (RFC 7348, RFC 8926)
_GENEVE = 6081
DATA_STAMP_AT = DATA_BYTES - 6
POSITION_STAMP_AT: int = POSITION_PAYLOAD.fields["timestamp_us"][1]  # type: ignore[index]  # it has fields
"""Offsets of the time stamp in both payloads."""


class Frame(NamedTuple):
    """A captured frame."""

    stamp_ns: int  # UTC; 0 in simple packet blocks of pcapng, which have no stamp
    link_type: int  # LINKTYPE_ value of tcpdump.org
    wire_bytes: int  # Length of the frame on the wire
    content: bytes
    is_suspect: bool = False  # True if what follows is damaged, so that its last bytes may be, too


class Run(NamedTuple):
    """Frames of sound records that follow one another in memory."""

    link_type: int
    held: bytes
    begin: I8  # (n,) offsets of the frames in `held`
    length: I8  # (n,) bytes of the frames
    wire_bytes: I8  # (n,)
    stamp_ns: I8  # (n,)

    def part(self, first: int, end: int) -> "Run":
        """Return the frames from `first` on and before `end`."""
        columns = (self.begin, self.length, self.wire_bytes, self.stamp_ns)
        return Run(self.link_type, self.held, *(column[first:end] for column in columns))

    def frame(self, place: int) -> Frame:
        """Return one frame."""
        begin = int(self.begin[place])
        content = self.held[begin : begin + int(self.length[place])]
        return Frame(int(self.stamp_ns[place]), self.link_type, int(self.wire_bytes[place]), content)

    def cut(self, begin: Iterable[int], end: Iterable[int]) -> Iterator[bytes]:
        """Yield the bytes between offsets in `held`."""
        return map(self.held.__getitem__, map(slice, begin, end))


class RecordForm(NamedTuple):
    """Form of the records of a file."""

    header_bytes: int  # of a record
    is_big_endian: bool
    unit_ns: int  # of a stamp's fraction
    link_type: int
    check_bytes: int  # length of the frame check sequence


def run_of(held: bytes, begin: int, again: bytes, form: RecordForm, near_s: int) -> tuple[Run, int, int]:
    """Return the sound records in memory, each followed by a sound record.

    Parameters
    ----------
    begin : offset of the first record
    again : first bytes of a file that is appended to this one
    near_s : seconds of the record before

    Returns
    -------
    the records, the offset after the last one, and its seconds; a run ends after some thousand records
    """
    columns = np.empty((4, _MOST_RECORDS), np.int64)
    content = np.frombuffer(held, np.uint8)
    first_bytes = np.frombuffer(again, np.uint8)
    numbers = form.header_bytes, form.is_big_endian, form.unit_ns, form.check_bytes
    count, end, last_s = _sound_records(content, begin, first_bytes, near_s, *numbers, columns)
    return Run(form.link_type, held, *columns[:, :count]), end, last_s


def sound_heads(
    held: bytes, begin: int, is_big_endian: bool, unit_ns: int, near_s: int | None
) -> Iterator[int]:
    """Yield the places of headers of records, captured within a day of `near_s` unless it is None."""
    content = np.frombuffer(held, np.uint8)
    since_s = -1 if near_s is None else near_s
    at = begin - 1
    while (at := _next_sound(content, at + 1, is_big_endian, S_NS // unit_ns, since_s)) >= 0:
        yield at


@inline_kernel
def u4_at(content: U1, at: int | np.int64, is_big_endian: bool) -> np.int64:
    """Read an unsigned integer of 4 bytes."""
    value = np.int64(0)
    for i in range(4):
        place = 3 - i if is_big_endian else i
        value |= np.int64(content[at + i]) << (8 * place)
    return value


@inline_kernel
def _u2(content: U1, at: int | np.int64) -> np.int64:
    """Read an unsigned big-endian integer of 2 bytes."""
    return (np.int64(content[at]) << 8) | np.int64(content[at + 1])


@inline_kernel
def _begins(content: U1, at: int | np.int64, first_bytes: U1) -> bool:
    """Return whether some bytes are at a place."""
    for i in range(len(first_bytes)):  # noqa: SIM110  # a kernel
        if content[at + i] != first_bytes[i]:
            return False
    return True


def is_sound(
    seconds: int | np.int64,
    fraction: int | np.int64,
    captured: int | np.int64,
    most_units: int,
    near_s: int | np.int64,
) -> bool:
    """Return whether a header is that of a record captured within a day of `near_s`, at any time if < 0.

    Zeros alone are none: blocks of a disk that were never written hold them.

    Parameters
    ----------
    fraction : of the stamp's second
    most_units : units of that fraction in a second
    captured : bytes in the file
    """
    fits = captured <= LONGEST_FRAME_BYTES and fraction < most_units
    is_blank = seconds == 0 and fraction == 0 and captured == 0
    is_near = near_s < 0 or -DAY_S <= seconds - near_s <= DAY_S
    return bool(fits and is_near and not is_blank)


_is_sound = inline_kernel(is_sound)  # the same rule within kernels


@inline_kernel
def _begins_record(
    content: U1, at: int | np.int64, is_big_endian: bool, most_units: int, near_s: int | np.int64
) -> bool:
    """Return whether the header of a sound record is at a place."""
    seconds = u4_at(content, at, is_big_endian)
    fraction = u4_at(content, at + 4, is_big_endian)
    captured = u4_at(content, at + 8, is_big_endian)
    return _is_sound(seconds, fraction, captured, most_units, near_s)


@kernel
def _next_sound(content: U1, begin: int, is_big_endian: bool, most_units: int, near_s: int) -> int:
    """Return the first place of a sound header from `begin` on; -1 if there is none."""
    for at in range(begin, len(content) - _HEAD_BYTES + 1):
        if _begins_record(content, at, is_big_endian, most_units, near_s):
            return at
    return -1


@kernel
def _sound_records(
    content: U1,
    begin: int,
    again: U1,
    near_s: int,
    header_bytes: int,
    is_big_endian: bool,
    unit_ns: int,
    check_bytes: int,
    columns: I8,
) -> tuple[int, int, int]:
    """Walk over sound records, and write the columns of `Run` (4, m); return as `run_of`."""
    at = np.int64(begin)
    before_s = np.int64(near_s)
    count = 0
    last = len(content) - header_bytes
    most_units = S_NS // unit_ns
    while at <= last and count < columns.shape[1] and not _begins(content, at, again):
        seconds = u4_at(content, at, is_big_endian)
        fraction = u4_at(content, at + 4, is_big_endian)
        captured = u4_at(content, at + 8, is_big_endian)
        following = at + header_bytes + captured
        if following > last or not _begins_record(content, at, is_big_endian, most_units, before_s):
            break
        if not _begins_record(content, following, is_big_endian, most_units, seconds):
            break
        wire_bytes = u4_at(content, at + 12, is_big_endian) - check_bytes
        if wire_bytes < 0:
            wire_bytes = np.int64(0)
        columns[0, count] = at + header_bytes
        columns[1, count] = min(captured, wire_bytes)
        columns[2, count] = wire_bytes
        columns[3, count] = seconds * S_NS + fraction * unit_ns
        count += 1
        before_s = seconds
        at = following
    return count, int(at), int(before_s)


class PlainDatagrams(NamedTuple):
    """Datagrams in the first frames of a run, which are UDP over IPv4 on Ethernet as sensors send it."""

    source_port: I8  # (n,)
    destination_port: I8  # (n,)
    end: I8  # (n,) offset after the payload
    is_cut_short: I8  # (n,) 1 if the frame was captured in part
    key: I8  # (n,) the same for packets of a sensor with one payload; 0 for what is no packet of a sensor


def plain_datagrams(run: Run) -> PlainDatagrams:
    """Read the datagrams of a run up to the first frame that is not plain, or whose payload is longer.

    Plain frames have no IP options, fragments, VLAN tags or tunnels.
    """
    columns = np.empty((5, len(run.begin)), np.int64)
    content = np.frombuffer(run.held, np.uint8)
    count = 0
    if run.link_type == ETHERNET:
        count = _plain_frames(content, run.begin, run.length, run.wire_bytes, columns)
    return PlainDatagrams(*columns[:, :count])


@kernel
def _plain_frames(content: U1, begin: I8, length: I8, wire_bytes: I8, columns: I8) -> int:
    """Write the columns of `PlainDatagrams` (5, n) up to the first other frame; return their number."""
    for i in range(len(begin)):
        at = begin[i]
        if length[i] < PAYLOAD_AT:
            return i
        ethernet = (_u2(content, at + 12) << 8) | np.int64(content[at + IP_AT])
        flags = _u2(content, at + 20)
        if ethernet != _IPV4_WITHOUT_OPTIONS or content[at + 23] != _UDP_NUMBER:
            return i
        port = _u2(content, at + UDP_AT + 2)
        if flags not in (0, _DONT_FRAGMENT) or port in (_VXLAN, _GENEVE):
            return i
        udp_bytes = _u2(content, at + UDP_AT + 4)
        end = UDP_AT + udp_bytes if udp_bytes else length[i]
        payload_bytes = min(end, length[i]) - PAYLOAD_AT
        if payload_bytes > DATA_BYTES:
            return i
        columns[0, i] = _u2(content, at + UDP_AT)
        columns[1, i] = port
        columns[2, i] = at + max(min(end, length[i]), PAYLOAD_AT)
        columns[3, i] = 1 if end > length[i] and length[i] < wire_bytes[i] else 0
        columns[4, i] = _key(content, at, payload_bytes)
    return len(begin)


@inline_kernel
def _key(content: U1, at: int | np.int64, payload_bytes: int | np.int64) -> np.int64:
    """Return the key of the packet in a plain frame, as in `PlainDatagrams`."""
    payload = at + PAYLOAD_AT
    if payload_bytes == POSITION_BYTES:
        stamp = payload + POSITION_STAMP_AT
    elif payload_bytes == DATA_BYTES and content[payload] == _FLAG_LOW and content[payload + 1] == _FLAG_HIGH:
        stamp = payload + DATA_STAMP_AT
    else:
        return np.int64(0)
    address = u4_at(content, at + SOURCE_AT, True)
    return (address << 20) ^ (_u2(content, at + 36) << 33) ^ u4_at(content, stamp, False) | 1 << 62
