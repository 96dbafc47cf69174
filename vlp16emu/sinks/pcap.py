"""Writing of packets to a classic pcap file, in the frames of a real sensor."""

import hashlib
import os
import struct
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from vlp16emu.errors import OutputError, RunError
from vlp16emu.output import STDOUT, OutputFile
from vlp16emu.packets.frames import FACTORY_LINK, Link, data_header, position_frame
from vlp16emu.packets.layout import DATA_BYTES
from vlp16emu.types import Packet, PacketKind, PacketSink
from vlp16emu.units import S_NS, US_NS

_ENDINGS = frozenset(
    {"", ".pcap", ".cap", ".dump", ".dmp"}
)  # endings of classic pcap files; a name may have none
_WAYS_TO = {
    ".pcapng": ", which `editcap -F pcapng` converts",
    ".db3": "; a name that ends in / is a bag of ROS 2, a folder with SQLite",
    **dict.fromkeys((".npz", ".ply", ".csv", ".las", ".laz", ".pcd"), "; `vlp16emu points` writes points"),
}
# Little-endian with microseconds: the only kind that readers with fixed offsets and older libraries accept.
_FILE_HEADER = struct.pack("<I2H4I", 0xA1B2C3D4, 2, 4, 0, 0, 65_535, 1)
_RECORD_HEADER = struct.Struct("<4I")


@dataclass(frozen=True, slots=True)
class PcapResult:
    """Contents of a file."""

    bytes: int  # Size of the file
    sha256: str  # SHA-256 of the whole file, hexadecimal
    messages: Mapping[str, int] | None = None  # Messages of a bag by topic


class PcapSink(PacketSink):
    """Writes data and position packets to a file, stamped with their due times.

    Each record is passed to the operating system in one write, so a killed program leaves a file
    NAME.xxxxxxxx.part that is readable to its last whole packet. After an error other than
    `KeyboardInterrupt` the file also stays under that name and ends with a whole packet, and an earlier file
    NAME is unchanged. An error leaves no file without packets.

    Parameters
    ----------
    path : as for `OutputFile`; an existing file is replaced when this one is complete
    links : addresses and ports of each unit

    Raises OutputError if the file cannot be opened, or another run writes it; RunError if it cannot be
    written: here, or later in `send`.
    """

    def __init__(self, path: Path, links: Sequence[Link] = (FACTORY_LINK,)) -> None:
        self.path = path
        self._is_stdout = path == STDOUT
        self._links = links
        self._data_headers = [data_header(link) for link in links]  # of payloads with the usual length
        self._sent = 0
        self._bytes = 0
        self._failed = False
        self._hash = hashlib.sha256()
        self._output = OutputFile(path, where="standard output" if self._is_stdout else None, buffering=0)
        self._file = self._output.file
        try:
            self._write(_FILE_HEADER)
        except RunError:
            self._output.discard()
            raise

    def __exit__(self, *raised: object) -> None:
        error = raised[1] if raised else None
        if not self._is_stdout:  # standard output may hold other data
            with suppress(OSError):  # a pipe or a device cannot be truncated
                os.ftruncate(self._file.fileno(), self._bytes)
        if not self._failed and (error is None or (self._sent and isinstance(error, KeyboardInterrupt))):
            self._output.keep()
        elif self._sent:
            self._output.leave()
        self._output.discard()

    def send(self, packet: Packet) -> None:
        """Append one packet.

        Raises RunError if the disk is full or the device gone; it names the file with the packets before this
        one; ValueError for an NMEA packet, which is sent by serial line, not by Ethernet.
        """
        frame = self._frame(packet)
        seconds, rest_ns = divmod(packet.due_ns, S_NS)
        self._write(_RECORD_HEADER.pack(seconds, rest_ns // US_NS, len(frame), len(frame)) + frame)
        self._sent += 1

    @property
    def result(self) -> PcapResult:
        """Contents so far."""
        return PcapResult(self._bytes, self._hash.hexdigest())

    def _frame(self, packet: Packet) -> bytes:
        link = self._links[packet.unit]
        if packet.kind is PacketKind.DATA:
            is_whole = len(packet.payload) == DATA_BYTES
            header = self._data_headers[packet.unit] if is_whole else data_header(link, len(packet.payload))
            return header + packet.payload
        if packet.kind is PacketKind.POSITION:
            return position_frame(link, packet.payload, packet.number)
        raise ValueError(f"found a packet of kind {packet.kind}, expected data or position")

    def _write(self, record: bytes) -> None:
        """Write a whole record, or fail without counting it."""
        try:
            written = self._file.write(record)
            while written < len(record):  # a full disk takes a part and refuses only the next byte
                written += self._file.write(record[written:])
        except OSError as error:
            self._failed = True
            name = "standard output" if self._is_stdout else self.path
            sent = self._sent
            kept = (
                f"the {sent} packets before it are in {self._output.place}" if sent else "no file is written"
            )
            raise RunError(f"{name}: {error.strerror} at packet {sent + 1}; {kept}") from error
        self._hash.update(record)
        self._bytes += len(record)


def check_ending(path: Path) -> None:
    """Refuse the ending of another format than classic pcap.

    Raises
    ------
    OutputError : It names the program that writes the other format, if known.
    """
    ending = path.suffix.lower()
    if ending not in _ENDINGS:
        expected = f".pcap, or - for standard output{_WAYS_TO.get(ending, '')}"
        raise OutputError(str(path), f"found the ending {ending!r}", expected)
