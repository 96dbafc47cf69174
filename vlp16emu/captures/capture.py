"""Captures: numbered UDP datagrams with their stamps and headers, and the sensors that sent them.

Classic pcap of Ethernet, as this package writes it, is read here; `vlp16emu.extras.captures` reads the rest.
"""

import glob
import logging
import re
import struct
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from io import BufferedReader, RawIOBase
from pathlib import Path
from threading import Event
from typing import BinaryIO, Protocol

from vlp16emu.captures.datagrams import Batch, Datagram, OtherBatch, PlainBatch
from vlp16emu.captures.records import EXPECTED, PCAP, Damage, Frames, in_runs, pcap_frames
from vlp16emu.captures.repeats import Repeats
from vlp16emu.captures.runs import ETHERNET, IP_AT, UDP_AT, Frame, Run, plain_datagrams
from vlp16emu.doors import Part
from vlp16emu.errors import CaptureError
from vlp16emu.inputs import open_input
from vlp16emu.packets.layout import (
    BLOCK,
    BLOCK_FLAG,
    BLOCK_FLAGS,
    BLOCKS_PER_PACKET,
    DATA_BYTES,
    RETURN_MODE_BYTE,
)

_log = logging.getLogger(__name__)
_ENDING = re.compile(r"\.((pcap|pcapng|cap)\d*(\.(gz|bz2|xz|zst))?|bag(\.active)?|mcap|db3)$", re.IGNORECASE)

_UDP_START = struct.Struct(">3H")  # source port, destination port and length of UDP (RFC 768)
_UNFRAGMENTED = b"\x40\0", b"\0\0"
_TUNNELS = (4789).to_bytes(2), (6081).to_bytes(2)  # UDP ports of VXLAN and Geneve (RFC 7348, RFC 8926)
_FLAG = BLOCK_FLAG.to_bytes(2, "little")
_FLAGS = {flag.to_bytes(2, "little") for flag in (0, *BLOCK_FLAGS)}  # 0 of blocks that hold nothing
_BAG_FILES = (".db3", ".mcap")  # of a folder of ROS 2, in order of their numbers
_OTHERS = 32  # frames from one that is not plain on that are read one by one
_OFTEN = 1000  # frames from one call for the progress to the next
_MOST_DAMAGE = 100  # damaged parts that are reported
_MOST_WARNINGS = 3  # of damaged parts
_CUT_SHORT = "frames that were captured in part (capture with `tcpdump -s 0`)"


class UdpFinder(Protocol):
    """Finder of UDP in the frames of one capture that are not plain."""

    @property
    def missed(self) -> Mapping[str, int]:
        """Numbers of what was left out, by description."""

    def udp_in(self, link_type: int, frame: bytes) -> tuple[bytes, int, int] | None:
        """Return a frame with a whole datagram, and the offsets of its IP and UDP headers."""


UNWRAPPER = Part[Callable[[], UdpFinder]]("vlp16emu.extras.captures.links:Unwrapper")
FRAMES = Part[Callable[[Path, BinaryIO], Frames]]("vlp16emu.extras.captures.containers:frames")


def is_capture_name(name: str | Path) -> bool:
    """Return whether a name ends in .pcap, .pcapng or .cap.

    A rotation number and a compression suffix may follow. Bags end in .bag, .mcap or .db3, or are folders.
    """
    return _ENDING.search(str(name)) is not None or is_bag_folder(Path(name))


def is_bag_folder(path: Path) -> bool:
    """Return whether a path is a folder that ROS 2 has recorded."""
    return (path / "metadata.yaml").is_file()


class Capture:
    """UDP datagrams of a capture: pcap or pcapng, plain or compressed, of any link type that carries IP.

    To be iterated over once. Other frames, and packets that the capture holds twice, are skipped and counted.

    Parameters
    ----------
    path : the file; a pattern with `*` or `?` in its name stands for the files of one walk, read in order of
        their first stamps
    repeats : also yield repeated packets
    stop : an event that ends the wait for the bytes of a pipe, as if the pipe ended there
    is_quiet : give no warning of damage, as in a pass before the one that counts
    progress : called with the share of the files that is read, 0 to 1, now and then

    Raises CaptureError if a file cannot be read or is not a capture. Damaged records are left out, with a
    warning.
    """

    def __init__(
        self,
        path: Path,
        *,
        repeats: bool = False,
        stop: Event | None = None,
        is_quiet: bool = False,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        self.path = path
        self._keeps_repeats = repeats
        self._stop = stop or Event()
        self._most_warnings = 0 if is_quiet else _MOST_WARNINGS
        self.frames = 0  # Frames read so far, of all kinds
        self.cut = False  # True if a file ended in the middle of a record; what came before it is whole
        self.repeated = 0  # Repeated packets that were skipped
        self.damage = list[str]()  # Damaged parts that were left out, the first hundred
        self._files = _files(path)
        self._unwrapper: UdpFinder | None = None  # made for the first frame that is not plain
        self._cut_short = 0
        self._repeats = Repeats()
        self._progress = progress
        self._next_shown = 0

    def __iter__(self) -> Iterator[Datagram]:
        for batch in self.batches():
            yield from batch.datagrams()

    def batches(self) -> Iterator[Batch]:
        """Yield the datagrams in batches, none of them empty."""
        shown = self._files if self._progress else ()
        sizes = [path.stat().st_size if path.is_file() else 0 for path in shown]
        for number, path in enumerate(self._files):
            with _opened(path, self._stop) as file:
                for part in in_runs(_frames(path, file)):
                    if part is None:
                        self.cut = True
                        break
                    if isinstance(part, Damage):
                        self._note_damage(path, part)
                        continue
                    yield from self._batches(part) if isinstance(part, Run) else self._others([part])
                    if self._progress and self.frames >= self._next_shown and sizes[number]:
                        self._next_shown = self.frames + _OFTEN
                        self._progress((sum(sizes[:number]) + file.raw.tell()) / sum(sizes))

    @property
    def missed(self) -> str:
        """Reason why packets could not be read, with the remedy; empty if all were read."""
        counts = Counter(self._unwrapper.missed if self._unwrapper else ()) + Counter(
            {_CUT_SHORT: self._cut_short}
        )
        return "; ".join([*(f"{number} {what}" for what, number in counts.items()), *self.damage[:1]])

    def no_data(self) -> CaptureError:
        """Return the error for a capture without data packets, with the cause if it is known."""
        found = f"no data packet, but {self.missed}" if self.missed else "no data packet"
        return CaptureError(str(self.path), found, "UDP payloads of 1206 bytes")

    def _note_damage(self, path: Path, damage: Damage) -> None:
        lost = f"{damage.lost_bytes} bytes at byte {damage.at_bytes}"
        found = f"{lost}, after packet {self.frames}, are damaged and left out"
        if len(self.damage) < self._most_warnings:
            _log.warning("%s: %s", path, found)
        elif len(self.damage) == self._most_warnings > 0:
            _log.warning("%s: further bytes are damaged and left out", path)
        if len(self.damage) < _MOST_DAMAGE:
            self.damage.append(f"{path}: {found}" if len(self._files) > 1 else found)

    def _batches(self, run: Run) -> Iterator[Batch]:
        """Yield the datagrams of a run of frames."""
        while frames := len(run.begin):
            columns = plain_datagrams(run)
            count = len(columns.end)
            if count:
                batch = PlainBatch(run.part(0, count), columns, self.frames + 1)
                self.frames += count
                self._cut_short += int(columns.is_cut_short.sum())
                if self._keeps_repeats or self._repeats.take_new(batch):
                    yield batch
                elif new := self._new(batch.datagrams()):
                    yield OtherBatch(new)
            end = min(count + _OTHERS, frames)
            yield from self._others(map(run.frame, range(count, end)))
            run = run.part(end, frames)

    def _others(self, frames: Iterable[Frame]) -> Iterator[Batch]:
        """Yield the datagrams of frames that are read one by one, if there are any."""
        found = [datagram for frame in frames for datagram in self._of_frame(frame)]
        if found:
            yield OtherBatch(found)

    def _of_frame(self, frame: Frame) -> list[Datagram]:
        """Return the datagrams that a frame completes."""
        self.frames += 1
        found = self._datagram(frame)
        if found is None:
            return []
        return self._new(_parts(found) if len(found.payload) > DATA_BYTES else (found,))

    def _new(self, datagrams: Iterable[Datagram]) -> list[Datagram]:
        """Return datagrams without repeats, which are counted."""
        if self._keeps_repeats:
            return list(datagrams)
        every = list(datagrams)
        new = [datagram for datagram in every if not self._repeats.take(datagram)]
        self.repeated += len(every) - len(new)
        return new

    def _datagram(self, frame: Frame) -> Datagram | None:
        """Parse one frame; None if it completes no UDP datagram."""
        _, link_type, wire_bytes, content, is_suspect = frame
        at = IP_AT
        body = UDP_AT
        if not _is_plain(link_type, content):
            if self._unwrapper is None and UNWRAPPER.is_installed:
                self._unwrapper = UNWRAPPER.load()()
            if not self._unwrapper or (found := self._unwrapper.udp_in(link_type, content)) is None:
                return None
            if found[0] is not content:  # reassembled from fragments
                wire_bytes = len(found[0])
            content, at, body = found
        if len(content) < body + 8:
            return None
        source_port, destination_port, udp_bytes = _UDP_START.unpack_from(content, body)
        end = body + udp_bytes if udp_bytes else len(content)
        self._cut_short += end > len(content) < wire_bytes
        lengths = (len(content), wire_bytes)
        ports = (source_port, destination_port)
        parts = content[: body + 8], content[body + 8 : end]
        if is_suspect and len(parts[1]) == DATA_BYTES and not _is_data(parts[1]):
            return None
        return Datagram(self.frames, frame.stamp_ns, *lengths, at, *ports, *parts, link_type)


def _is_plain(link_type: int, frame: bytes) -> bool:
    """Return whether a frame is complete UDP over IPv4, as nearly all are.

    It has no IP options, VLAN tags or tunnel.
    """
    return (
        link_type == ETHERNET
        and frame[12:15] == b"\x08\x00\x45"
        and frame[23:24] == b"\x11"
        and frame[20:22] in _UNFRAGMENTED
        and frame[36:38] not in _TUNNELS
    )


def _is_data(payload: bytes) -> bool:
    """Return whether a payload has the flags of all blocks, and ends as a data packet does."""
    size = BLOCK.itemsize
    flags = {payload[at : at + 2] for at in range(0, BLOCKS_PER_PACKET * size, size)}
    return payload.startswith(_FLAG) and flags <= _FLAGS and payload[-2] in RETURN_MODE_BYTE.values()


def _parts(datagram: Datagram) -> Iterable[Datagram]:
    """Return the data packets in a long datagram, or the datagram if it holds something else.

    A network card may have merged several (UDP GRO of Linux).
    """
    payload = datagram.payload
    size = DATA_BYTES
    if len(payload) % size or not payload.startswith(_FLAG):
        return (datagram,)
    own_bytes = len(datagram.header) + size
    parts = (payload[at : at + size] for at in range(0, len(payload), size))
    return (datagram._replace(payload=part, captured_bytes=own_bytes, wire_bytes=own_bytes) for part in parts)


def _files(path: Path) -> list[Path]:
    """Return the files of a capture, in order of their first stamps."""
    if path.is_fifo():
        return [path]  # a pipe can be read only once
    if is_bag_folder(path):
        inside = sorted(each for each in path.iterdir() if each.suffix in _BAG_FILES)
        return inside or [path / "*.mcap"]
    is_pattern = not path.exists() and glob.has_magic(path.name)  # a file may have brackets in its name
    found = sorted(path.parent.glob(path.name)) if is_pattern else []
    return sorted(found or [path], key=_first_ns)


def _opened(
    path: Path, stop: Event | None = None, *, takes_pipes: bool = True
) -> AbstractContextManager["BufferedReader[RawIOBase]"]:
    """Open a file of a capture; CaptureError if it cannot be read."""
    return open_input(path, EXPECTED, CaptureError, most_bytes=None, takes_pipes=takes_pipes, stop=stop)


def _frames(path: Path, file: "BufferedReader[RawIOBase]") -> Frames:
    """Return the frames of an open file; CaptureError if it is not a capture."""
    return pcap_frames(path, file) if file.peek(4)[:4] in PCAP else FRAMES.load()(path, file)


def _first_ns(path: Path) -> int:
    """Return the stamp of the first frame of a file; 0 if it has none."""
    with _opened(path, takes_pipes=False) as file:
        first = next(_frames(path, file), None)
    return first.stamp_ns if isinstance(first, Frame) else 0
