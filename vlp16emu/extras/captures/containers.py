"""Frames of pcapng, and of archives with pcap or pcapng in them.

This module parses the records itself, because dpkt's readers convert stamps to floats, drop the length on the
wire and the link types of pcapng, and do not report a truncated last packet.
"""

import bz2
import gzip
import lzma
import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from io import BufferedReader
from pathlib import Path
from typing import Any, NamedTuple

from vlp16emu.captures.capture import EXPECTED, PCAP, Frame, not_a_capture, pcap_frames, read
from vlp16emu.errors import CaptureError
from vlp16emu.units import FOREVER_NS, S_NS, US_NS

_SECTION = 0x0A0D0D0A
_INTERFACE = 1
_OLD_PACKET = 2
_SIMPLE_PACKET = 3
_PACKET = 6
"""Block types of pcapng. Source of all pcapng numbers: IETF draft-ietf-opsawg-pcapng."""
_BYTE_ORDER = 0x1A2B3C4D
_OPTION_RESOLUTION = 9
_OPTION_CHECK = 13
_OPTION_OFFSET = 14
_LONGEST_BLOCK_BYTES = 16 << 20  # a longer block means damage (MAX_BLOCK_SIZE of Wireshark)
_ARCHIVES: dict[bytes, Any] = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ\0": lzma.open}
_ZSTD = b"\x28\xb5\x2f\xfd"
_TAR_AT = 257  # offset of the magic number of POSIX tar (IEEE 1003.1, ustar)
_OTHERS = {b"PK\x03\x04": ("zip", "unzip -p"), b"\x04\x22\x4d\x18": ("lz4", "lz4 -dc")}

Frames = Iterator[
    Frame | None
]  # frames of a file; the last is None if the file ends in the middle of a record


def frames(path: Path, file: Any) -> Frames:
    """Yield the frames of a file that is no plain pcap.

    Raises CaptureError if it is neither pcapng nor a readable archive with a capture in it, or a record is
    damaged.
    """
    head = b""
    try:
        unpacked = _unpacked(path, file)
        with suppress(EOFError):  # from an archive that is truncated in its first bytes
            head = unpacked.peek(_TAR_AT + 5)
        if head[_TAR_AT : _TAR_AT + 5] == b"ustar":
            raise CaptureError(str(path), "a tar archive", f"{EXPECTED}: `tar xOf {path.name} > some.pcap`")
        head = head[:4]
        if head in PCAP:
            yield from pcap_frames(path, unpacked)
        elif int.from_bytes(head) == _SECTION:
            read(unpacked, 4)
            yield from _pcapng(path, unpacked)
        else:
            raise not_a_capture(path, head)
    except (zlib.error, lzma.LZMAError) as error:
        raise CaptureError(str(path), f"a damaged archive: {error}", EXPECTED) from error


def _unpacked(path: Path, file: Any) -> Any:
    """Return the stream of an archive, or the file itself if it is no archive."""
    head: bytes = file.peek(6)
    if head.startswith(_ZSTD):
        try:
            import zstandard
        except ImportError:
            expected = "the library zstandard (pip install zstandard), or the file unpacked by `unzstd`"
            raise CaptureError(str(path), "a zstd archive", expected) from None
        return BufferedReader(zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True))
    for magic, (name, command) in _OTHERS.items():
        if head.startswith(magic):
            raise CaptureError(
                str(path), f"a {name} archive", f"{EXPECTED}: `{command} {path.name} > some.pcap`"
            )
    return next((opener(file) for magic, opener in _ARCHIVES.items() if head.startswith(magic)), file)


class _Interface(NamedTuple):
    link_type: int
    snap_bytes: int
    units_per_s: int
    offset_s: int
    check_bytes: int  # length of the frame check sequence


def _pcapng(path: Path, file: Any) -> Frames:
    """Yield the frames of pcapng; the file is read from after the type of its first block."""
    order = "<"
    kind = _SECTION
    interfaces = list[_Interface]()
    blocks = 0
    while True:
        blocks += 1
        length_at = read(file, 8 if kind == _SECTION else 4)
        if kind == _SECTION:
            order = "<" if int.from_bytes(length_at[4:], "little") == _BYTE_ORDER else ">"
            interfaces = []
        length = int.from_bytes(length_at[:4], "little" if order == "<" else "big")
        if len(length_at) < (8 if kind == _SECTION else 4):
            yield None
            return
        if not 12 <= length <= _LONGEST_BLOCK_BYTES or length % 4:  # type, length, length again
            where = f"{path}: block {blocks}"
            expected = f"12 to {_LONGEST_BLOCK_BYTES}, in steps of 4"
            raise CaptureError(where, f"a length of {length} bytes", expected)
        body = read(file, rest := length - 4 - len(length_at))
        if len(body) < rest:
            yield None
            return
        try:
            if kind == _INTERFACE:
                interfaces.append(_interface(body, order))
            frame = _frame(body, kind, order, interfaces)
        except struct.error:
            found = f"a block of type {kind} with {len(body) - 4} bytes"
            expected = "its fields"
            raise CaptureError(f"{path}: block {blocks}", found, expected) from None
        if frame is not None:
            if abs(frame.stamp_ns) > FOREVER_NS:
                found = f"a stamp of {frame.stamp_ns // S_NS} s since 1970"
                raise CaptureError(f"{path}: block {blocks}", found, "one from 1824 to 2116")
            yield frame
        head = read(file, 4)
        if len(head) < 4:  # a block type
            if head:
                yield None
            return
        kind = int.from_bytes(
            head, "little" if order == "<" else "big"
        )  # the type of a section is a palindrome


def _interface(body: bytes, order: str) -> _Interface:
    link_type, _, snap_bytes = struct.unpack_from(f"{order}2HI", body)
    units_per_s = S_NS // US_NS
    offset_s = 0
    check_bytes = 0
    at = 8
    while at + 4 <= len(body):
        code, size = struct.unpack_from(f"{order}2H", body, at)
        value = body[at + 4 : at + 4 + size]
        if code == _OPTION_RESOLUTION and value:
            units_per_s = 2 ** (value[0] & 0x7F) if value[0] & 0x80 else 10 ** value[0]
        elif code == _OPTION_CHECK and value:
            check_bytes = value[0]
        elif code == _OPTION_OFFSET:
            offset_s = int.from_bytes(value, "little" if order == "<" else "big", signed=True)
        at += 4 + -(-size // 4) * 4
    return _Interface(link_type, snap_bytes, units_per_s, offset_s, check_bytes)


def _frame(body: bytes, kind: int, order: str, interfaces: list[_Interface]) -> Frame | None:
    """Read a packet block; None for other blocks and for packets of an interface that is not described."""
    if kind == _SIMPLE_PACKET and interfaces:
        wire = struct.unpack_from(f"{order}I", body)[0]
        interface = interfaces[0]
        captured = min(wire, interface.snap_bytes or wire)
        whole = max(wire - interface.check_bytes, 0)
        return Frame(0, interface.link_type, whole, body[4 : 4 + min(captured, whole)])
    if kind not in (_PACKET, _OLD_PACKET) or len(body) < 20:  # the fields before the frame
        return None
    number, high, low, captured, wire = struct.unpack_from(
        f"{order}{'I' if kind == _PACKET else 'H2x'}4I", body
    )
    if number >= len(interfaces):
        return None
    interface = interfaces[number]
    stamp_ns = interface.offset_s * S_NS + (high << 32 | low) * S_NS // interface.units_per_s
    whole = max(wire - interface.check_bytes, 0)
    return Frame(stamp_ns, interface.link_type, whole, body[20 : 20 + min(captured, whole)])
