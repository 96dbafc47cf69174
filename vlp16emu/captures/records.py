"""Records of classic pcap: frames with their stamps, and where a file is damaged.

A damaged record costs that record: reading goes on at the next place where records follow one another, which
is found by their lengths and stamps as pcapfix does (github.com/Rup0rt/pcapfix, pcap.c: lengths that fit, and
stamps within a day).
"""

import re
import struct
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vlp16emu.captures.runs import Frame, RecordForm, Run, is_sound, run_of, sound_heads
from vlp16emu.errors import CaptureError
from vlp16emu.units import S_NS, US_NS

EXPECTED = "a pcap or pcapng file, also as .gz, .bz2, .xz or .zst, or a bag with /velodyne_packets"
PCAP = {
    magic.to_bytes(4, order): ("<" if order == "little" else ">", unit_ns, record)
    for magic, unit_ns, record in (
        (0xA1B2C3D4, US_NS, "4I"),
        (0xA1B23C4D, 1, "4I"),
        (0xA1B2CD34, US_NS, "4I8x"),
    )
    for order in ("little", "big")
}
"""Byte order, nanoseconds per unit of a stamp's fraction, and format of a record's header, by the first bytes
of a file. Source: IETF draft-ietf-opsawg-pcap; the last magic number is the "modified" pcap of routers, as
Wireshark's wiki describes it."""
_FILE_HEADER_BYTES = 24
_HAS_CHECK = 0x0400_0000  # frames end with a frame check sequence
_SURE = 3  # records in a row that are no accident
_PIECE_BYTES = 1 << 20
_TOGETHER = 64
"""Frames that come one by one and are read at once: at most 85 ms of a sensor, for captures that come through
a pipe."""
_SEARCHED_BYTES = 1 << 20


class Damage(NamedTuple):
    """Bytes of a capture that are no whole record, and are left out."""

    at_bytes: int  # offset in the file, or in what an archive holds
    lost_bytes: int


Frames = Iterator[Frame | Run | Damage | None]
"""Frames of a file, one by one or in runs, and what is lost between them.

It is None at the end if the file ends within a record."""


class Window:
    """The bytes of a file from a place on, which moves forward."""

    def __init__(self, file: Any) -> None:
        self._file = file
        self._held = b""
        self._begin = 0
        self.at_bytes = 0  # offset of the window in the file

    def peek(self, size: int, ahead: int = 0) -> bytes:
        """Return `size` bytes that begin `ahead` bytes after the window, or fewer at the end of the file."""
        self.load(ahead + size)
        begin = self._begin + ahead
        return self._held[begin : begin + size]

    def load(self, size: int) -> int:
        """Read on until `size` bytes are in memory, fewer at the end of the file; return how many are."""
        missing = self._begin + size - len(self._held)
        if missing > 0:
            self._held = b"".join([self._held[self._begin :], *self._parts(missing)])
            self._begin = 0
        return len(self._held) - self._begin

    def _parts(self, size: int) -> Iterator[bytes]:
        """Read at least `size` bytes, or to the end of the file."""
        while size > 0:
            try:
                part = self._file.read1(_PIECE_BYTES)
            except EOFError:  # an archive that is truncated
                return
            if not part:
                return
            size -= len(part)
            yield part

    def held(self) -> tuple[bytes, int]:
        """Return the bytes in memory, and where the window begins in them."""
        return self._held, self._begin

    def grow(self) -> bool:
        """Read on if less than a piece is in memory; False if it is not, or at the end of the file."""
        left = len(self._held) - self._begin
        return left < _PIECE_BYTES and len(self.peek(1, left)) > 0

    def skip(self, size: int) -> None:
        """Move the window over bytes that have been seen."""
        moved = min(size, len(self._held) - self._begin)
        self._begin += moved
        self.at_bytes += moved

    def skip_to(self, pattern: re.Pattern[bytes], margin: int) -> bool:
        """Move the window to the next match of a pattern of at most `margin` bytes; False at the end."""
        while left := self.load(_SEARCHED_BYTES):
            found = pattern.search(self._held, self._begin)
            if found:
                self.skip(found.start() - self._begin)
                return True
            self.skip(left if left < _SEARCHED_BYTES else left - margin)
        return False


class _Head(NamedTuple):
    """Header of a record."""

    seconds: int
    fraction: int
    captured: int  # bytes in the file
    wire: int


class _Records:
    """Records of one file of classic pcap."""

    def __init__(self, magic: bytes, window: Window) -> None:
        self.order, self.unit_ns, form = PCAP[magic]
        self._window = window
        self._struct = struct.Struct(self.order + form)
        self.size = self._struct.size
        self.count = 0  # records read

    def head(self, ahead: int = 0) -> _Head | None:
        """Return a record's header; None if the file ends before or within it."""
        content = self._window.peek(self.size, ahead)
        return _Head(*self._struct.unpack(content)) if len(content) == self.size else None

    def is_sound(self, head: _Head, near_s: int | None, unit_ns: int | None = None) -> bool:
        """Return whether a header is that of a record captured within a day of `near_s`."""
        most_units = S_NS // (unit_ns or self.unit_ns)
        return is_sound(*head[:3], most_units, -1 if near_s is None else near_s)

    def is_chain(self, ahead: int = 0, near_s: int | None = None, unit_ns: int | None = None) -> bool:
        """Return whether records follow one another from a place on, some or to the end of the file."""
        for number in range(_SURE):
            head = self.head(ahead)
            if head is None:
                return number > 0 and not self._window.peek(1, ahead)
            if not self.is_sound(head, near_s, unit_ns) or head.wire < head.captured:
                return False
            near_s = head.seconds
            ahead += self.size + head.captured
            if not self._window.peek(1, ahead - 1):  # the last record is truncated
                return number > 1
        return True

    def sound_runs(
        self, again: bytes, link_type: int, check_bytes: int, near_s: int
    ) -> Generator[Run, None, int]:
        """Yield the sound records from here on, each followed by a sound record; move the window.

        Nearly all frames of a capture are read here. Returns the seconds of the last one.

        Parameters
        ----------
        near_s, again : as for `goes_on`
        """
        form = RecordForm(self.size, self.order == ">", self.unit_ns, link_type, check_bytes)
        while True:
            held, begin = self._window.held()
            run, end, near_s = run_of(held, begin, again, form, near_s)
            if len(run.begin):
                yield run
                self.count += len(run.begin)
                self._window.skip(end - begin)
            elif not self._window.grow():
                return near_s

    def goes_on(self, ahead: int, near_s: int | None, again: bytes) -> bool:
        """Return whether there is a record or the end of the file at a place.

        Parameters
        ----------
        near_s : seconds of the record before
        again : first bytes of a file that is appended to this one
        """
        head = self.head(ahead)
        if head is None or self.is_sound(head, near_s) or self._window.peek(len(again), ahead) == again:
            return True
        return self.is_chain(ahead) or self.has_nanoseconds(ahead)

    def has_nanoseconds(self, ahead: int) -> bool:
        """Return whether records have fractions in nanoseconds under the magic number of microseconds."""
        return self.unit_ns == US_NS and self.is_chain(ahead, unit_ns=1)

    def find(self, near_s: int | None) -> bool:
        """Move the window to the next records captured within a day of `near_s`; False at the end."""
        window = self._window
        while left := window.load(_SEARCHED_BYTES):
            held, begin = window.held()
            for at in sound_heads(held, begin, self.order == ">", self.unit_ns, near_s):
                if self.is_chain(at - begin, near_s):
                    window.skip(at - begin)
                    return True
            window.skip(left if left < _SEARCHED_BYTES else left - self.size + 1)
        return False


def pcap_frames(path: Path, file: Any) -> Frames:
    """Yield the frames of classic pcap; `file` begins with one of `PCAP`.

    Raises CaptureError if the file ends in its header, or if stamps are not in the unit that it declares.
    """
    window = Window(file)
    header = window.peek(_FILE_HEADER_BYTES)
    if len(header) < _FILE_HEADER_BYTES:
        raise not_a_capture(path, header)
    again = header[:8]
    records = _Records(header[:4], window)
    link_type = 0
    check_bytes = 0
    near_s: int | None = None
    while start := window.peek(_FILE_HEADER_BYTES):
        if start.startswith(again) and len(start) == _FILE_HEADER_BYTES:  # also of a file that is appended
            link_type, check_bytes = _link_of(struct.unpack_from(f"{records.order}I", start, 20)[0])
            window.skip(_FILE_HEADER_BYTES)
            continue
        head = records.head()
        if head is None:
            yield None
            return
        begin = window.at_bytes
        if not records.goes_on(0, near_s, again):  # before the first record
            window.skip(1)
            records.find(near_s)
            yield Damage(begin, window.at_bytes - begin)
            continue
        records.count += 1
        if head.fraction * records.unit_ns >= S_NS:
            raise _nanoseconds(path, records.count, head, records.order)
        near_s = head.seconds
        size = records.size + head.captured
        content = window.peek(head.captured, records.size)
        is_complete = len(content) == head.captured
        stamp_ns = head.seconds * S_NS + head.fraction * records.unit_ns
        wire = max(head.wire - check_bytes, 0)
        frame = Frame(stamp_ns, link_type, wire, content[:wire])
        if is_complete and records.goes_on(size, near_s, again):
            window.skip(size)
            yield frame
            near_s = yield from records.sound_runs(again, link_type, check_bytes, near_s)
            continue
        window.skip(1)
        if not records.find(near_s) and not is_complete:
            yield None
            return
        yield from _around_damage(frame, begin, begin + size, window.at_bytes)


def in_runs(frames: Frames) -> Frames:
    """Yield frames of one link type that follow one another in runs; what is suspect stays alone."""
    held = list[Frame]()
    try:
        for part in frames:
            if isinstance(part, Frame) and not part.is_suspect:
                if held and not _has_room(held, part.link_type):
                    yield _joined(held)
                    held = []
                held.append(part)
                continue
            if held:
                yield _joined(held)
                held = []
            yield part
    except CaptureError:
        if held:
            yield _joined(held)
        raise
    if held:
        yield _joined(held)


def _has_room(held: list[Frame], link_type: int) -> bool:
    """Return whether one more frame of a link type may join others."""
    size = sum(len(frame.content) for frame in held)
    return link_type == held[0].link_type and len(held) < _TOGETHER and size < _PIECE_BYTES


def _joined(frames: list[Frame]) -> Run:
    """Return the run of one or more frames of one link type."""
    length = np.array([len(frame.content) for frame in frames], np.int64)
    wire_bytes, stamp_ns = np.array([(frame.wire_bytes, frame.stamp_ns) for frame in frames], np.int64).T
    content = b"".join([frame.content for frame in frames])
    return Run(frames[0].link_type, content, np.cumsum(length) - length, length, wire_bytes, stamp_ns)


def _link_of(field: int) -> tuple[int, int]:
    """Return link type and length of the frame check sequence from the field of a pcap header.

    Source: IETF draft-ietf-opsawg-pcap, section 4: bits P and FCS len, which counts words of 16 bits.
    """
    return field & 0xFFFF, 2 * (field >> 28) if field & _HAS_CHECK else 0


def _around_damage(frame: Frame, begin: int, end: int, next_begin: int) -> Iterator[Frame | Damage]:
    """Yield the frame before damage, if it is complete, and the damage up to where the next record begins.

    Parameters
    ----------
    begin, end : offsets of the frame's record, by its header
    """
    if next_begin >= end:  # else the next record begins within this one
        yield frame._replace(is_suspect=True)
        begin = end
    if next_begin > begin:
        yield Damage(begin, next_begin - begin)


def _nanoseconds(path: Path, number: int, head: _Head, order: str) -> CaptureError:
    """Return the error for nanoseconds under the magic number of microseconds."""
    magic = r"\115\074\262\241" if order == "<" else r"\241\262\074\115"  # octal, as POSIX has it
    found = f"a fraction of {head.fraction} us of a second, which are nanoseconds"
    mend = f"`printf '{magic}' | dd of=COPY conv=notrunc` writes it"
    expected = f"less than 1000000, or the magic number of nanoseconds ({mend})"
    return CaptureError(f"{path}: packet {number}", found, expected)


def not_a_capture(path: Path, head: bytes) -> CaptureError:
    """Return the error for a file that does not begin as a capture does."""
    found = f"no capture, it begins with {head[:4].hex(' ')}" if head else "an archive of an empty file"
    return CaptureError(str(path), found, EXPECTED)
