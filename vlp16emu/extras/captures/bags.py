"""Frames of bags: the packets of velodyne_msgs/VelodyneScan, as the ROS driver records them.

Bags of ROS 1 and MCAP are read record by record from their beginning, so an index is not needed, and a bag
that was not closed is read as far as it goes. Sources: wiki.ros.org/Bags/Format/2.0, mcap.dev/spec, and
rosbag2_storage_sqlite3.
"""

import bz2
import sqlite3
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from vlp16emu.captures.records import Frame, Frames, Window
from vlp16emu.errors import CaptureError, MissingExtraError
from vlp16emu.packets.frames import FACTORY_LINK, data_header
from vlp16emu.packets.layout import DATA_BYTES
from vlp16emu.units import S_NS

ROS1 = b"#ROSBAG V2.0\n"
MCAP = b"\x89MCAP0\r\n"
SQLITE = b"SQLite format 3\0"
_SCAN = ("velodyne_msgs/VelodyneScan", "velodyne_msgs/msg/VelodyneScan")
_OTHER = (
    "messages of velodyne_msgs/VelodyneScan, as on /velodyne_packets (`verify --for` checks point clouds)"
)
_LONGEST_BYTES = 1 << 30
_MOST_UNITS = 50
_ETHERNET = 1

_OP_MESSAGE = 2
_OP_CHUNK = 5
_OP_CONNECTION = 7
"""Kinds of records of ROS 1 bags."""
_SCHEMA = 3
_CHANNEL = 4
_MESSAGE = 5
_CHUNK = 6
"""Kinds of records of MCAP."""
_MCAP_TAIL = {0x02, 0x0F}  # footer and end of the data: only an index follows


class _Scan(NamedTuple):
    """A serialized message with its topic."""

    topic: str
    content: bytes
    is_cdr: bool


_Scans = Iterator[_Scan | None]
"""The last one is None if the bag ends within a record."""


def bag_frames(path: Path, file: Any) -> Frames:
    """Yield the packets of a bag of ROS 1, or of a file of ROS 2, as frames of the unit's factory addresses.

    Units have addresses in the order of their topics in the bag. Stamps are those of the packets.

    Raises CaptureError if there are no messages of the driver's packets, or one is damaged.
    """
    head = file.peek(len(SQLITE))
    if head.startswith(ROS1):
        return _frames(path, _ros1_scans(Window(file)))
    if head.startswith(MCAP):
        return _frames(path, _mcap_scans(Window(file)))
    return _frames(path, _sqlite_scans(path))


def is_bag(head: bytes) -> bool:
    """Return whether a file begins as a bag does."""
    return head.startswith((ROS1, MCAP, SQLITE))


def _frames(path: Path, scans: _Scans) -> Frames:
    headers = dict[str, bytes]()
    for scan in scans:
        if scan is None:
            yield None
            break
        if scan.topic not in headers:
            if len(headers) == _MOST_UNITS:
                raise CaptureError(str(path), f"more than {_MOST_UNITS} topics of packets", "fewer units")
            source = f"192.168.1.{201 + len(headers)}"
            headers[scan.topic] = data_header(replace(FACTORY_LINK, source=source))
        try:
            packets = list(_packets(scan))
        except struct.error:
            raise CaptureError(f"{path}, {scan.topic}", "a damaged message", _OTHER) from None
        for stamp_ns, payload in packets:
            content = headers[scan.topic] + payload
            yield Frame(stamp_ns, _ETHERNET, len(content), content)
    if not headers:
        raise CaptureError(str(path), "a bag without packets", _OTHER)


def _packets(scan: _Scan) -> Iterator[tuple[int, bytes]]:
    """Yield stamp and payload of the packets of a message, in the encoding of ROS 1 or CDR."""
    content = scan.content
    order = "<"
    at = 0
    if scan.is_cdr:  # the encapsulation says the byte order; alignment counts from after it
        order = "<" if content[1:2] == b"\x01" else ">"
        content = content[4:]
    (size,) = struct.unpack_from(f"{order}I", content, 8 if scan.is_cdr else 12)  # of the frame's name
    at = (12 if scan.is_cdr else 16) + size
    at += -at % 4 if scan.is_cdr else 0
    (count,) = struct.unpack_from(f"{order}I", content, at)
    at += 4
    for _ in range(count):
        seconds, rest_ns = struct.unpack_from(f"{order}2I", content, at)
        (payload,) = struct.unpack_from(f"{DATA_BYTES}s", content, at + 8)
        yield seconds * S_NS + rest_ns, payload
        at += 8 + DATA_BYTES
        at += -at % 4 if scan.is_cdr else 0


def _record(window: Window) -> tuple[Mapping[bytes, bytes], bytes] | None:
    """Return the fields and the data of the next record of ROS 1; None if the bag ends within it."""
    parts = list[bytes]()
    for _ in range(2):
        size = int.from_bytes(window.peek(4), "little")
        part = window.peek(size, 4) if size <= _LONGEST_BYTES else b""
        if len(part) < size:
            return None
        window.skip(4 + size)
        parts.append(part)
    fields = dict[bytes, bytes]()
    header = parts[0]
    at = 0
    while at + 4 <= len(header):
        size = int.from_bytes(header[at : at + 4], "little")
        name, _, value = header[at + 4 : at + 4 + size].partition(b"=")
        fields[name] = value
        at += 4 + size
    return fields, parts[1]


def _ros1_scans(window: Window) -> _Scans:
    window.peek(len(ROS1))
    window.skip(len(ROS1))
    topics = dict[bytes, str]()
    while window.peek(1):
        record = _record(window)
        if record is None:
            yield None
            return
        fields, data = record
        if fields.get(b"op") == bytes([_OP_CHUNK]):
            inner = Window(_Bytes(_unpacked(fields.get(b"compression", b"none").decode("latin-1"), data)))
        elif fields.get(b"op") in (bytes([_OP_CONNECTION]), bytes([_OP_MESSAGE])):
            yield from _ros1_message(fields, data, topics)
            continue
        else:
            continue
        while inner.peek(1):
            record = _record(inner)
            if record is None:
                yield None
                return
            yield from _ros1_message(*record, topics)


def _ros1_message(fields: Mapping[bytes, bytes], data: bytes, topics: dict[bytes, str]) -> Iterator[_Scan]:
    """Note a connection of packets, or yield a message of one."""
    number = fields.get(b"conn", b"")
    if fields.get(b"op") == bytes([_OP_CONNECTION]):
        if b"type=" + _SCAN[0].encode() in data:
            topics[number] = fields.get(b"topic", b"").decode("utf-8", "replace")
    elif fields.get(b"op") == bytes([_OP_MESSAGE]) and number in topics:
        yield _Scan(topics[number], data, is_cdr=False)


def _mcap_records(window: Window) -> Iterator[tuple[int, bytes] | None]:
    while head := window.peek(9):
        size = int.from_bytes(head[1:], "little")
        content = window.peek(size, 9) if size <= _LONGEST_BYTES else b""
        if len(head) < 9 or len(content) < size:
            yield None
            return
        window.skip(9 + size)
        if head[0] in _MCAP_TAIL:
            return
        yield head[0], content


def _mcap_scans(window: Window) -> _Scans:
    window.peek(len(MCAP))
    window.skip(len(MCAP))
    kinds = dict[int, str]()
    topics = dict[int, str]()
    for record in _mcap_records(window):
        inner: Iterator[tuple[int, bytes] | None] = iter((record,))
        if record is not None and record[0] == _CHUNK:
            compression, at = _text(record[1], 28)  # after two times, a size and a sum
            packed = record[1][at + 8 :]
            inner = _mcap_records(Window(_Bytes(_unpacked(compression, packed))))
        for found in inner:
            if found is None:
                yield None
                return
            yield from _mcap_message(*found, kinds, topics)


def _mcap_message(
    kind: int, content: bytes, kinds: dict[int, str], topics: dict[int, str]
) -> Iterator[_Scan]:
    """Note a schema or a channel, or yield a message of packets."""
    number = int.from_bytes(content[:2], "little")
    if kind == _SCHEMA:
        kinds[number] = _text(content, 2)[0]
    elif kind == _CHANNEL and kinds.get(int.from_bytes(content[2:4], "little")) in _SCAN:
        topics[number] = _text(content, 4)[0]
    elif kind == _MESSAGE and number in topics:
        yield _Scan(topics[number], content[22:], is_cdr=True)  # after number and two times


def _text(content: bytes, at: int) -> tuple[str, int]:
    """Return a string and the place after it."""
    end = at + 4 + int.from_bytes(content[at : at + 4], "little")
    return content[at + 4 : end].decode("utf-8", "replace"), end


def _sqlite_scans(path: Path) -> _Scans:
    """Yield the messages of a database of ROS 2, which is not changed."""
    opened = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
    try:
        rows = opened.execute(
            "SELECT topics.name, messages.data FROM messages JOIN topics ON topics.id = messages.topic_id "
            "WHERE topics.type = ? ORDER BY messages.timestamp, messages.id",
            (_SCAN[1],),
        )
        for topic, data in rows:
            yield _Scan(str(topic), bytes(data), is_cdr=True)
    finally:
        opened.close()


class _Bytes:
    """Bytes that are read as a file."""

    def __init__(self, content: bytes) -> None:
        self._content = content

    def read1(self, _: int) -> bytes:
        """Return all that is left."""
        content = self._content
        self._content = b""
        return content


def _unpacked(compression: str, packed: bytes) -> bytes:
    """Unpack a chunk; CaptureError names a compression that is not known."""
    unpack: dict[str, Callable[[bytes], bytes]] = {
        "": bytes,
        "none": bytes,
        "bz2": bz2.decompress,
        "lz4": _lz4,
        "zstd": _zstd,
    }
    if compression not in unpack:
        raise CaptureError("compression", f"found {compression}", "none, bz2, lz4 or zstd")
    return unpack[compression](packed)


def _lz4(packed: bytes) -> bytes:
    try:
        from lz4 import frame
    except ImportError:
        raise MissingExtraError("lz4", "ros", "reading this bag") from None
    unpacked: bytes = frame.decompress(packed)
    return unpacked


def _zstd(packed: bytes) -> bytes:
    try:
        from backports import zstd  # rosbags brings it
    except ImportError:
        raise MissingExtraError("backports.zstd", "ros", "reading this bag") from None
    return zstd.decompress(packed)
