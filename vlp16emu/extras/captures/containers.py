"""Frames of pcapng, and of archives with pcap or pcapng in them.

This module parses the records itself, because dpkt's readers convert stamps to floats, drop the length on the
wire and the link types of pcapng, and do not report a truncated last packet.
"""

import bz2
import gzip
import lzma
import re
import struct
from collections.abc import Mapping
from contextlib import suppress
from io import BufferedReader
from pathlib import Path
from typing import Any, Literal

from vlp16emu.captures.records import EXPECTED, PCAP, Damage, Frames, Window, not_a_capture, pcap_frames
from vlp16emu.captures.runs import Frame
from vlp16emu.errors import CaptureError
from vlp16emu.extras.captures.bags import bag_frames, is_bag
from vlp16emu.extras.captures.blocks import LATEST_NS, LONGEST_BLOCK_BYTES, PACKET, Interface, packet_runs
from vlp16emu.inputs import parsing
from vlp16emu.units import S_NS, US_NS

_SECTION = 0x0A0D0D0A
_INTERFACE = 1
_OLD_PACKET = 2
_SIMPLE_PACKET = 3
"""Block types of pcapng beside `PACKET`. Source of all pcapng numbers: IETF draft-ietf-opsawg-pcapng."""
_KINDS = (_SECTION, _INTERFACE, _OLD_PACKET, _SIMPLE_PACKET, 4, 5, PACKET)  # 4, 5: names, statistics
_BYTE_ORDER = 0x1A2B3C4D
_NAME: Mapping[str, Literal["little", "big"]] = {"<": "little", ">": "big"}
_OPTION_RESOLUTION = 9
_OPTION_CHECK = 13
_OPTION_OFFSET = 14
_ARCHIVES: dict[bytes, Any] = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ\0": lzma.open}
_ZSTD = b"\x28\xb5\x2f\xfd"
_TAR_AT = 257  # offset of the magic number of POSIX tar (IEEE 1003.1, ustar)
_OTHERS = {b"PK\x03\x04": ("zip", "unzip -p"), b"\x04\x22\x4d\x18": ("lz4", "lz4 -dc")}


def frames(path: Path, file: Any) -> Frames:
    """Yield the frames of a file that is no plain pcap.

    Raises CaptureError if it is neither pcapng, nor a bag, nor a readable archive with a capture in it.
    """
    with parsing(path, EXPECTED, CaptureError):
        unpacked = _unpacked(path, file)
    head = b""
    with suppress(EOFError), parsing(path, EXPECTED, CaptureError):  # a truncated archive
        head = unpacked.peek(_TAR_AT + 5)
    if head[_TAR_AT : _TAR_AT + 5] == b"ustar":
        raise CaptureError(str(path), "a tar archive", f"{EXPECTED}: `tar xOf {path.name} > some.pcap`")
    if head[:4] in PCAP:
        found = pcap_frames(path, unpacked)
    elif is_bag(head):
        found = bag_frames(path, unpacked)
    elif int.from_bytes(head[:4]) == _SECTION:
        found = _pcapng(path, Window(unpacked))
    else:
        raise not_a_capture(path, head)
    while True:
        with parsing(path, EXPECTED, CaptureError):
            frame = next(found, _END)
        if isinstance(frame, _End):
            return
        yield frame


def _unpacked(path: Path, file: Any) -> Any:
    """Return the stream of an archive, or the file itself if it is no archive."""
    head: bytes = file.peek(6)
    if head.startswith(_ZSTD):
        return _of_zstd(path, file)
    for magic, (name, command) in _OTHERS.items():
        if head.startswith(magic):
            raise CaptureError(
                str(path), f"a {name} archive", f"{EXPECTED}: `{command} {path.name} > some.pcap`"
            )
    return next((opener(file) for magic, opener in _ARCHIVES.items() if head.startswith(magic)), file)


def _of_zstd(path: Path, file: Any) -> Any:
    """Return the stream of a zstd archive, by either of two libraries."""
    with suppress(ImportError):
        import zstandard

        return BufferedReader(zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True))
    try:
        from backports import zstd  # rosbags brings it
    except ImportError:
        expected = "the library zstandard (pip install zstandard), or the file unpacked by `unzstd`"
        raise CaptureError(str(path), "a zstd archive", expected) from None
    return zstd.ZstdFile(file)


class _End:
    """Mark of the end of the frames."""


_END = _End()


def _pcapng(path: Path, window: Window) -> Frames:
    """Yield the frames of pcapng."""
    order = "<"
    interfaces = list[Interface]()
    blocks = 0
    while window.peek(1):
        blocks += 1
        begin = window.at_bytes
        order, block, is_complete = _block(window, order)
        if not block:
            window.skip(1)
            if _find_block(window, order):
                yield Damage(begin, window.at_bytes - begin)
                continue
            yield Damage(begin, window.at_bytes - begin) if is_complete else None
            return
        window.skip(len(block))
        kind = int.from_bytes(block[:4], _NAME[order])
        body = block[8:]
        try:
            if kind == _SECTION:
                interfaces = []
            if kind == _INTERFACE:
                interfaces.append(_interface(body, order))
            frame = _frame(body, kind, order, interfaces)
        except struct.error:
            yield Damage(begin, len(block))
            continue
        if frame is None:
            continue
        if not 0 <= frame.stamp_ns <= LATEST_NS:
            found = f"a stamp of {frame.stamp_ns // S_NS} s since 1970"
            expected = f"0 to {LATEST_NS // S_NS}, from 1970 to 2106"
            raise CaptureError(f"{path}: block {blocks}", found, expected)
        yield frame
        for run in packet_runs(window, order, interfaces):
            blocks += len(run.begin)
            yield run


def _block(window: Window, order: str) -> tuple[str, bytes, bool]:
    """Return the block at the window, empty if there is none that is whole, with its byte order.

    The length of a block stands before and after its content. The last value is False if the file may end
    within the block.
    """
    head = window.peek(12)
    if len(head) < 12:
        return order, b"", False
    if int.from_bytes(head[:4]) == _SECTION:  # a palindrome
        order = "<" if int.from_bytes(head[8:], "little") == _BYTE_ORDER else ">"
    length = int.from_bytes(head[4:8], _NAME[order])
    if not 12 <= length <= LONGEST_BLOCK_BYTES or length % 4:  # type, length, length again
        return order, b"", True
    block = window.peek(length)
    if len(block) < length:
        return order, b"", False
    return order, block if block[-4:] == head[4:8] else b"", True


def _find_block(window: Window, order: str) -> bool:
    """Move the window to the next whole block; False at the end of the file."""
    kinds = (kind.to_bytes(4, _NAME[order]) for kind in _KINDS)
    pattern = re.compile(b"|".join(re.escape(kind) for kind in kinds))
    while window.skip_to(pattern, 3):
        if _block(window, order)[1]:
            return True
        window.skip(1)
    return False


def _interface(body: bytes, order: str) -> Interface:
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
    return Interface(link_type, snap_bytes, units_per_s, offset_s, check_bytes)


def _frame(body: bytes, kind: int, order: str, interfaces: list[Interface]) -> Frame | None:
    """Read a packet block; None for other blocks and for packets of an interface that is not described."""
    if kind == _SIMPLE_PACKET and interfaces:
        wire = struct.unpack_from(f"{order}I", body)[0]
        interface = interfaces[0]
        captured = min(wire, interface.snap_bytes or wire)
        whole = max(wire - interface.check_bytes, 0)
        return Frame(0, interface.link_type, whole, body[4 : 4 + min(captured, whole)])
    if kind not in (PACKET, _OLD_PACKET) or len(body) < 20:  # the fields before the frame
        return None
    number, high, low, captured, wire = struct.unpack_from(
        f"{order}{'I' if kind == PACKET else 'H2x'}4I", body
    )
    if number >= len(interfaces):
        return None
    interface = interfaces[number]
    stamp_ns = interface.offset_s * S_NS + (high << 32 | low) * S_NS // interface.units_per_s
    whole = max(wire - interface.check_bytes, 0)
    return Frame(stamp_ns, interface.link_type, whole, body[20 : 20 + min(captured, whole)])
