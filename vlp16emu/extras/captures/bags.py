"""Frames of bags: the packets of velodyne_msgs/VelodyneScan, as the ROS driver records them.

Bags of ROS 1 and MCAP are read record by record from their beginning, so an index is not needed, and a bag
that was not closed is read as far as it goes. Sources: wiki.ros.org/Bags/Format/2.0, mcap.dev/spec, and
rosbag2_storage_sqlite3.

A damaged record costs that record, and a damaged chunk that is packed the chunk.
"""

import bz2
import re
import sqlite3
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from itertools import chain, pairwise
from pathlib import Path
from typing import Any, NamedTuple

from vlp16emu.captures.records import Damage, Frames, Window
from vlp16emu.captures.runs import Frame
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
_LONGEST_HEADER_BYTES = 1 << 20
_BEGIN_BYTES = 24  # longest first bytes by which a record is searched
_SURE = 3  # records in a row that are no accident
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
_MCAP_TAIL = frozenset((0x02, 0x0F))  # footer and end of the data: only an index follows


class _Scan(NamedTuple):
    """A serialized message with its topic."""

    topic: str
    content: bytes
    place: int  # offset of its record or chunk in the file
    is_cdr: bool


class _Record(NamedTuple):
    """A record of a bag."""

    kind: int
    fields: Mapping[bytes, bytes]  # of the header in ROS 1
    data: bytes
    size: int  # bytes in the file or chunk


_Scans = Iterator[_Scan | Damage | None]
"""The last one is None if the bag ends within a record."""


def bag_frames(path: Path, file: Any) -> Frames:
    """Yield the packets of a bag of ROS 1, or of a file of ROS 2, as frames of the unit's factory addresses.

    Units have addresses in the order of their topics in the bag. Stamps are those of the packets.

    Raises CaptureError if there are no messages of the driver's packets.
    """
    head = file.peek(len(SQLITE))
    if head.startswith(ROS1):
        return _frames(path, _scans(Window(file), _ROS1))
    if head.startswith(MCAP):
        return _frames(path, _scans(Window(file), _MCAP))
    return _frames(path, _sqlite_scans(path))


def is_bag(head: bytes) -> bool:
    """Return whether a file begins as a bag does."""
    return head.startswith((ROS1, MCAP, SQLITE))


def _frames(path: Path, scans: _Scans) -> Frames:
    headers = dict[str, bytes]()
    for scan, after in pairwise(chain(scans, [None])):
        if scan is None:
            yield None
            break
        if isinstance(scan, Damage):
            yield scan
            continue
        if scan.topic not in headers:
            if len(headers) == _MOST_UNITS:
                raise CaptureError(str(path), f"more than {_MOST_UNITS} topics of packets", "fewer units")
            source = f"192.168.1.{201 + len(headers)}"
            headers[scan.topic] = data_header(replace(FACTORY_LINK, source=source))
        try:
            packets = list(_packets(scan))
        except struct.error:
            yield Damage(scan.place, len(scan.content))
            continue
        for stamp_ns, payload in packets:
            content = headers[scan.topic] + payload
            yield Frame(stamp_ns, _ETHERNET, len(content), content, isinstance(after, Damage))
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


def _records(window: Window, form: "_Form", *, is_chunk: bool = False) -> Iterator[_Record | Damage | None]:
    """Yield the records of a bag or of a chunk, and the damage between them.

    The last one is None if a bag ends within a record.
    """
    while window.peek(1):
        begin = window.at_bytes
        record = form.read(window, 0)
        if record is not None:
            window.skip(record.size)
            yield record
            continue
        window.skip(1)
        while window.skip_to(form.begin, _BEGIN_BYTES) and not _is_chain(window, form):
            window.skip(1)
        if is_chunk or window.peek(1):
            yield Damage(begin, window.at_bytes - begin)
        else:
            yield None


def _is_chain(window: Window, form: "_Form") -> bool:
    """Return whether records follow one another from the window on, some or to the end."""
    ahead = 0
    for number in range(_SURE):
        record = form.read(window, ahead)
        if record is None:
            return number > 0 and not window.peek(1, ahead)
        ahead += record.size
    return True


def _scans(window: Window, form: "_Form") -> _Scans:
    """Yield the messages of packets of a bag; what is damaged in a chunk is said to be at its place."""
    window.peek(len(form.magic))
    window.skip(len(form.magic))
    topics = _Topics()
    for record in _records(window, form):
        if not isinstance(record, _Record):
            yield record
            continue
        if record.kind in form.tail:
            return
        place = window.at_bytes - record.size
        if record.kind != form.chunk:
            yield from form.take(record, place, topics)
            continue
        try:
            content = _unpacked(*form.packed(record))
        except (OSError, RuntimeError, ValueError):  # of bz2 and lz4, and of `_zstd`
            yield Damage(place, record.size)
            continue
        for found in _records(Window(_Bytes(content)), form, is_chunk=True):
            if isinstance(found, _Record):
                yield from form.take(found, place, topics)
            elif found is not None:
                yield Damage(place, found.lost_bytes)


class _Topics:
    """What the records of a bag have said about its messages of packets."""

    def __init__(self) -> None:
        self.kinds = dict[bytes, str]()
        self.names = dict[bytes, str]()


def _ros1_record(window: Window, ahead: int) -> _Record | None:
    """Return a record of ROS 1 some bytes after the window; None if there is none that is complete."""
    parts = list[bytes]()
    at = ahead
    for most_bytes in (_LONGEST_HEADER_BYTES, _LONGEST_BYTES):
        head = window.peek(4, at)
        size = int.from_bytes(head, "little")
        part = window.peek(size, at + 4) if size <= most_bytes else b""
        if len(head) < 4 or len(part) < size:
            return None
        at += 4 + size
        parts.append(part)
    fields = dict[bytes, bytes]()
    header = parts[0]
    begin = 0
    while begin + 4 <= len(header):
        size = int.from_bytes(header[begin : begin + 4], "little")
        name, _, value = header[begin + 4 : begin + 4 + size].partition(b"=")
        fields[name] = value
        begin += 4 + size
    kind = fields.get(b"op", b"")
    return _Record(kind[0], fields, parts[1], at - ahead) if begin == len(header) and kind else None


def _ros1_packed(record: _Record) -> tuple[str, bytes]:
    return record.fields.get(b"compression", b"none").decode("latin-1"), record.data


def _ros1_take(record: _Record, place: int, topics: _Topics) -> Iterator[_Scan]:
    """Note a connection of packets, or yield a message of one."""
    number = record.fields.get(b"conn", b"")
    if record.kind == _OP_CONNECTION:
        if b"type=" + _SCAN[0].encode() in record.data:
            topics.names[number] = record.fields.get(b"topic", b"").decode("utf-8", "replace")
    elif record.kind == _OP_MESSAGE and number in topics.names:
        yield _Scan(topics.names[number], record.data, place, is_cdr=False)


def _mcap_record(window: Window, ahead: int) -> _Record | None:
    """Return a record of MCAP some bytes after the window; None if there is none that is complete."""
    head = window.peek(9, ahead)
    size = int.from_bytes(head[1:], "little")
    if len(head) < 9 or not head[0] or size > _LONGEST_BYTES:
        return None
    data = window.peek(size, ahead + 9)
    return _Record(head[0], {}, data, 9 + size) if len(data) == size else None


def _mcap_packed(record: _Record) -> tuple[str, bytes]:
    compression, at = _text(record.data, 28)  # after two times, a size and a sum
    return compression, record.data[at + 8 :]


def _mcap_take(record: _Record, place: int, topics: _Topics) -> Iterator[_Scan]:
    """Note a schema or a channel, or yield a message of packets."""
    data = record.data
    number = data[:2]
    if record.kind == _SCHEMA:
        topics.kinds[number] = _text(data, 2)[0]
    elif record.kind == _CHANNEL and topics.kinds.get(data[2:4]) in _SCAN:
        topics.names[number] = _text(data, 4)[0]
    elif record.kind == _MESSAGE and number in topics.names:
        yield _Scan(topics.names[number], data[22:], place, is_cdr=True)  # after number and two times


class _Form(NamedTuple):
    """A format of bags."""

    magic: bytes
    read: Callable[[Window, int], _Record | None]
    begin: re.Pattern[bytes]  # of a record
    chunk: int
    packed: Callable[[_Record], tuple[str, bytes]]  # compression and content of a chunk
    take: Callable[[_Record, int, _Topics], Iterator[_Scan]]
    tail: frozenset[int] = frozenset()


_FIRST_FIELD = (
    rb"(?:chunk_count|chunk_pos|compression|conn|conn_count|count|index_pos|op|size|time|topic|ver)="
)
_ROS1 = _Form(
    magic=ROS1,
    read=_ros1_record,
    begin=re.compile(rb"[\s\S]{2}\0\0[\s\S]{2}\0\0" + _FIRST_FIELD),  # lengths of header and field
    chunk=_OP_CHUNK,
    packed=_ros1_packed,
    take=_ros1_take,
)
_MCAP = _Form(
    magic=MCAP,
    read=_mcap_record,
    begin=re.compile(rb"[\x01-\x0f][\s\S]{3}[\0-\x03]\0{4}"),  # kind, and a length below 64 MiB
    chunk=_CHUNK,
    packed=_mcap_packed,
    take=_mcap_take,
    tail=_MCAP_TAIL,
)


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
            yield _Scan(str(topic), bytes(data), 0, is_cdr=True)
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
    try:
        return zstd.decompress(packed)
    except zstd.ZstdError as error:
        raise ValueError(str(error)) from None
