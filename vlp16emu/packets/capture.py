"""Reading classic pcap files: numbered UDP datagrams with their stamps and headers.

The records are walked here, with dpkt's structures, because dpkt's own reader turns stamps into floats,
drops the length on the wire and does not report when the last packet is cut. All of dpkt is loaded with the first of its
names, for 40 ms, so it is imported where captures are read.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, Self

from vlp16emu.errors import CaptureError
from vlp16emu.units import S_NS, US_NS

_PCAPNG_MAGIC = bytes.fromhex("0a0d0d0a")
"""Block type of a section header, the same in both byte orders. Source: IETF draft-ietf-opsawg-pcapng."""
_LONGEST_FRAME_BYTES = 262_144
"""Largest snapshot length that libpcap accepts; a longer record means damage (MAXIMUM_SNAPLEN of libpcap)."""
_UDP_START = struct.Struct(">3H")
"""Source port, destination port, length."""


class Datagram(NamedTuple):
    """One UDP datagram over IPv4, as captured."""

    number: int
    """Of its frame in the file, from 1, as Wireshark counts."""
    stamp_ns: int
    """UTC."""
    captured_bytes: int
    """Length of the frame in the file."""
    wire_bytes: int
    """Length of the frame on the wire."""
    ip_offset: int
    """Where the IPv4 header begins in `header`; 14 without VLAN tag."""
    source_port: int
    destination_port: int
    header: bytes
    """Ethernet, IPv4 and UDP headers."""
    payload: bytes
    """As long as the UDP header says, or shorter where the frame was captured in part."""

    @property
    def source(self) -> bytes:
        """IPv4 address of the sender, 4 bytes."""
        return self.ip[12:16]

    @property
    def udp_checksum(self) -> int:
        """As sent; 0 stands for none."""
        return int.from_bytes(self.header[-2:])

    @property
    def ip(self) -> bytes:
        """IPv4 header with its options."""
        return self.header[self.ip_offset : -8]

    @property
    def identification(self) -> int:
        """Identification field of the IPv4 header."""
        return int.from_bytes(self.ip[4:6])


class Capture:
    """A classic pcap file of Ethernet frames: either byte order, microsecond or nanosecond stamps.

    A context manager to be iterated over once; frames that are no UDP over IPv4, and all fragments but
    the first, are counted and passed over.

    Parameters
    ----------
    path : the file

    Raises
    ------
    CaptureError
        If the file cannot be read, is no classic pcap, or holds something else than Ethernet; while
        iterating, if a record is damaged.
    """

    def __init__(self, path: Path) -> None:
        import dpkt

        self.path = path
        self.frames = 0
        """Frames read so far, whatever they hold."""
        self.cut = False
        """True when the file ended in the middle of a record; what came before it is whole."""
        try:
            self._file = path.open("rb")
            head = self._file.read(dpkt.pcap.FileHdr.__hdr_len__)
        except OSError as error:
            raise CaptureError(str(path), str(error.strerror), "a readable pcap file") from error
        try:
            self._order, self._unit_ns = _read_file_header(path, head)
        except CaptureError:
            self._file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def __iter__(self) -> Iterator[Datagram]:
        record = struct.Struct(f"{self._order}4I")
        while head := self._file.read(record.size):
            if len(head) < record.size:
                self.cut = True
                return
            seconds, fraction, captured, wire = record.unpack(head)
            if captured > _LONGEST_FRAME_BYTES:
                where = f"{self.path}: packet {self.frames + 1}"
                raise CaptureError(where, f"a length of {captured} bytes", f"at most {_LONGEST_FRAME_BYTES}")
            frame = self._file.read(captured)
            if len(frame) < captured:
                self.cut = True
                return
            self.frames += 1
            stamp_ns = seconds * S_NS + fraction * self._unit_ns
            datagram = _datagram(self.frames, stamp_ns, wire, frame)
            if datagram is not None:
                yield datagram


def _read_file_header(path: Path, head: bytes) -> tuple[str, int]:
    """Byte order for struct, and nanoseconds per unit of the stamps' fractions."""
    import dpkt

    expected = "a classic pcap file of Ethernet frames"
    unit_ns = {dpkt.pcap.TCPDUMP_MAGIC: US_NS, dpkt.pcap.TCPDUMP_MAGIC_NANO: 1}
    if head[:4] == _PCAPNG_MAGIC:
        raise CaptureError(str(path), "a pcapng file", f"{expected} (editcap -F pcap makes one)")
    if len(head) == dpkt.pcap.FileHdr.__hdr_len__:
        for order, layout in (("<", dpkt.pcap.LEFileHdr), (">", dpkt.pcap.FileHdr)):
            header = layout(head)
            if header.magic not in unit_ns:
                continue
            if header.linktype != dpkt.pcap.DLT_EN10MB:
                found = f"a pcap file of link type {header.linktype}"
                raise CaptureError(str(path), found, f"{expected}, link type {dpkt.pcap.DLT_EN10MB}")
            return order, unit_ns[header.magic]
    raise CaptureError(str(path), f"no pcap file, it begins with {head[:4].hex(' ') or 'nothing'}", expected)


def _datagram(number: int, stamp_ns: int, wire_bytes: int, frame: bytes) -> Datagram | None:
    """Parse one frame, or None where it is no (first fragment of a) UDP datagram over IPv4."""
    import dpkt

    ip = 14
    while int.from_bytes(frame[ip - 2 : ip]) in (dpkt.ethernet.ETH_TYPE_8021Q, dpkt.ethernet.ETH_TYPE_8021AD):
        ip += 4
    if int.from_bytes(frame[ip - 2 : ip]) != dpkt.ethernet.ETH_TYPE_IP or len(frame) < ip + 20:
        return None
    udp = ip + 4 * (frame[ip] & 0x0F)
    fragment = int.from_bytes(frame[ip + 6 : ip + 8]) & dpkt.ip.IP_OFFMASK
    is_ipv4 = frame[ip] >> 4 == 4 and udp >= ip + 20
    if not is_ipv4 or frame[ip + 9] != dpkt.ip.IP_PROTO_UDP or fragment or len(frame) < udp + 8:
        return None
    source_port, destination_port, udp_bytes = _UDP_START.unpack_from(frame, udp)
    header, payload = frame[: udp + 8], frame[udp + 8 : udp + udp_bytes]
    return Datagram(number, stamp_ns, len(frame), wire_bytes, ip, source_port, destination_port, header, payload)
