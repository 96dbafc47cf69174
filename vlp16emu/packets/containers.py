"""Frames in capture files: classic pcap and pcapng, plain or compressed.

The records are walked here, as dpkt's readers turn stamps into floats, drop the length on the wire and the link types of
pcapng, and do not report when the last packet is cut.
"""

import bz2
import gzip
import lzma
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from vlp16emu.errors import CaptureError
from vlp16emu.units import S_NS, US_NS

EXPECTED = "a pcap or pcapng file, also as .gz, .bz2, .xz or .zst (`editcap` converts others)"

_PCAP = {0xA1B2C3D4: (US_NS, "4I"), 0xA1B23C4D: (1, "4I"), 0xA1B2CD34: (US_NS, "4I8x")}
"""Nanoseconds per unit of a stamp's fraction, and format of a record's header, by magic number.
Source: IETF draft-ietf-opsawg-pcap; the last is the "modified" pcap of routers, as Wireshark's wiki describes it."""
_PCAP_HEADER_BYTES = 24
_SECTION, _INTERFACE, _OLD_PACKET, _SIMPLE_PACKET, _PACKET = 0x0A0D0D0A, 1, 2, 3, 6
"""Block types of pcapng, as all below from IETF draft-ietf-opsawg-pcapng."""
_BYTE_ORDER = 0x1A2B3C4D
_OPTION_RESOLUTION, _OPTION_OFFSET = 9, 14
_LONGEST_FRAME_BYTES, _LONGEST_BLOCK_BYTES = 262_144, 16 << 20
"""A longer record means damage (MAXIMUM_SNAPLEN of libpcap), and so does a longer block (MAX_BLOCK_SIZE of Wireshark)."""
_ARCHIVES = {b"\x1f\x8b": "gzip", b"BZh": "bzip2", b"\xfd7zXZ\0": "xz", b"\x28\xb5\x2f\xfd": "zstd"}
_OTHERS = {b"PK\x03\x04": ("zip", "unzip -p"), b"\x04\x22\x4d\x18": ("lz4", "lz4 -dc")}


class Frame(NamedTuple):
    """A captured frame."""

    stamp_ns: int
    """UTC; 0 in simple packet blocks of pcapng, which have no stamp."""
    link_type: int
    """LINKTYPE_ value of tcpdump.org."""
    wire_bytes: int
    """Length of the frame on the wire."""
    content: bytes


Frames = Iterator[Frame | None]
"""Frames of a file; the last is None if the file ends in the middle of a record."""


@contextmanager
def opened(path: Path) -> Iterator[BinaryIO]:
    """Open a capture, decompressed.

    Raises
    ------
    CaptureError
        If it cannot be read, or is an archive that cannot be unpacked.
    """
    try:
        with path.open("rb") as file:
            yield _unpacked(path, file)
    except OSError as error:  # gzip and bz2 report damage so, too
        raise CaptureError(str(path), error.strerror or f"{error}", EXPECTED) from error
    except (zlib.error, lzma.LZMAError) as error:
        raise CaptureError(str(path), f"a damaged archive: {error}", EXPECTED) from error


def _unpacked(path: Path, file: Any) -> BinaryIO:
    head: bytes = file.peek(6)
    kind = next((kind for magic, kind in _ARCHIVES.items() if head.startswith(magic)), None)
    if kind == "zstd":
        try:
            import zstandard
        except ImportError:
            expected = "the library zstandard (pip install zstandard), or the file unpacked by `unzstd`"
            raise CaptureError(str(path), "a zstd archive", expected) from None
        return zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
    for magic, (name, command) in _OTHERS.items():
        if head.startswith(magic):
            raise CaptureError(str(path), f"a {name} archive", f"{EXPECTED}: `{command} {path.name} > some.pcap`")
    openers: dict[str | None, Any] = {"gzip": gzip.open, "bzip2": bz2.open, "xz": lzma.open}
    unpacked: BinaryIO = openers[kind](file) if kind else file
    return unpacked


def frames_in(path: Path, file: BinaryIO) -> Frames:
    """Return the frames of a capture.

    Raises
    ------
    CaptureError
        If it is neither pcap nor pcapng, or a record is damaged.
    """
    head = _read(file, 4)
    if int.from_bytes(head) == _SECTION:
        return _pcapng(path, file)
    for order in "<>":
        magic = int.from_bytes(head, "little" if order == "<" else "big")
        head += _read(file, _PCAP_HEADER_BYTES - 4) if magic in _PCAP else b""
        if len(head) == _PCAP_HEADER_BYTES:
            return _pcap(path, file, order, head)
    raise CaptureError(str(path), f"no capture, it begins with {head[:4].hex(' ') or 'nothing'}", EXPECTED)


def _read(file: BinaryIO, size: int) -> bytes:
    """Read `size` bytes, fewer at the end of the file or of an archive that is cut."""
    parts = []
    while size > 0:
        try:
            part = file.read(size)
        except EOFError:
            part = b""
        if not part:
            break
        parts.append(part)
        size -= len(part)
    return parts[0] if len(parts) == 1 else b"".join(parts)


def _pcap(path: Path, file: BinaryIO, order: str, header: bytes) -> Frames:
    def link_type_in(header: bytes) -> int:
        return int(struct.unpack_from(f"{order}I", header, 20)[0]) & 0xFFFF  # above are flags of the check sequence

    unit_ns, form = _PCAP[struct.unpack_from(f"{order}I", header)[0]]
    record, number, link_type = struct.Struct(order + form), 0, link_type_in(header)
    while head := _read(file, record.size):
        if head.startswith(header[:8]):  # another file behind this one, as `cat` puts it there
            head += _read(file, _PCAP_HEADER_BYTES - len(head))
            if len(head) == _PCAP_HEADER_BYTES:
                link_type = link_type_in(head)
                continue
        if len(head) < record.size:
            yield None
            return
        seconds, fraction, captured, wire = record.unpack(head)
        number += 1
        if captured > _LONGEST_FRAME_BYTES:
            where = f"{path}: packet {number}"
            raise CaptureError(where, f"a length of {captured} bytes", f"at most {_LONGEST_FRAME_BYTES}")
        content = _read(file, captured)
        if len(content) < captured:
            yield None
            return
        yield Frame(seconds * S_NS + fraction * unit_ns, link_type, wire, content)


class _Interface(NamedTuple):
    link_type: int
    snap_bytes: int
    units_per_s: int
    offset_s: int


def _pcapng(path: Path, file: BinaryIO) -> Frames:
    order, kind, interfaces, blocks = "<", _SECTION, list[_Interface](), 0
    while True:
        blocks += 1
        length_at = _read(file, 8 if kind == _SECTION else 4)
        if kind == _SECTION:
            order = "<" if int.from_bytes(length_at[4:], "little") == _BYTE_ORDER else ">"
            interfaces = []
        length = int.from_bytes(length_at[:4], "little" if order == "<" else "big")
        if len(length_at) < (8 if kind == _SECTION else 4):
            yield None
            return
        if not 12 <= length <= _LONGEST_BLOCK_BYTES or length % 4:  # type, length, length again
            where, expected = f"{path}: block {blocks}", f"12 to {_LONGEST_BLOCK_BYTES}, in steps of 4"
            raise CaptureError(where, f"a length of {length} bytes", expected)
        body = _read(file, rest := length - 4 - len(length_at))
        if len(body) < rest:
            yield None
            return
        try:
            if kind == _INTERFACE:
                interfaces.append(_interface(body, order))
            frame = _frame(body, kind, order, interfaces)
        except struct.error:
            found, expected = f"a block of type {kind} with {len(body) - 4} bytes", "its fields"
            raise CaptureError(f"{path}: block {blocks}", found, expected) from None
        if frame is not None:
            yield frame
        head = _read(file, 4)
        if len(head) < 4:  # a block type
            if head:
                yield None
            return
        kind = int.from_bytes(head, "little" if order == "<" else "big")  # a section's reads the same either way


def _interface(body: bytes, order: str) -> _Interface:
    link_type, _, snap_bytes = struct.unpack_from(f"{order}2HI", body)
    units_per_s, offset_s, at = S_NS // US_NS, 0, 8
    while at + 4 <= len(body):
        code, size = struct.unpack_from(f"{order}2H", body, at)
        value = body[at + 4 : at + 4 + size]
        if code == _OPTION_RESOLUTION and value:
            units_per_s = 2 ** (value[0] & 0x7F) if value[0] & 0x80 else 10 ** value[0]
        elif code == _OPTION_OFFSET:
            offset_s = int.from_bytes(value, "little" if order == "<" else "big", signed=True)
        at += 4 + -(-size // 4) * 4
    return _Interface(link_type, snap_bytes, units_per_s, offset_s)


def _frame(body: bytes, kind: int, order: str, interfaces: list[_Interface]) -> Frame | None:
    """Read a packet block; None for other blocks and for packets of an interface that is not described."""
    if kind == _SIMPLE_PACKET and interfaces:
        wire, own = struct.unpack_from(f"{order}I", body)[0], interfaces[0]
        captured = min(wire, own.snap_bytes or wire)
        return Frame(0, own.link_type, wire, body[4 : 4 + captured])
    if kind not in (_PACKET, _OLD_PACKET) or len(body) < 20:  # the fields before the frame
        return None
    number, high, low, captured, wire = struct.unpack_from(f"{order}{'I' if kind == _PACKET else 'H2x'}4I", body)
    if number >= len(interfaces):
        return None
    own = interfaces[number]
    stamp_ns = own.offset_s * S_NS + (high << 32 | low) * S_NS // own.units_per_s
    return Frame(stamp_ns, own.link_type, wire, body[20 : 20 + captured])
