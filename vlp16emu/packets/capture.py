"""Reading captures: numbered UDP datagrams with their stamps and headers, whatever file and link they come from."""

import glob
import re
import struct
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple, Self

from vlp16emu.errors import CaptureError
from vlp16emu.packets.containers import Frame, frames_in, opened
from vlp16emu.packets.links import LINK_TYPES, PLAIN_AT, PLAIN_BODY, Ip, ip_in, is_plain, mac_of

_UDP, _UDP_START = 17, struct.Struct(">3H")
"""Protocol number; source port, destination port, length (RFC 768)."""
_IPV4 = 4
_DATA_BYTES, _POSITION_BYTES, _FLAG = 1206, 512, b"\xff\xee"
"""Lengths of packets, and how data packets begin; as in `layout`."""
_RECENT = 512
"""Packets in which a repeat is found: those of 0.7 s of one sensor. Bridges, bonds and `-i any` repeat within milliseconds."""
_INCOMPLETE = 64
"""Datagrams whose fragments are waited for at a time."""

_ENDING = re.compile(r"\.(pcap|pcapng|cap)\d*(\.(gz|bz2|xz|zst))?$", re.IGNORECASE)


class Datagram(NamedTuple):
    """One UDP datagram, as captured; one that came in fragments is put together."""

    number: int
    """Number of its frame (of its last fragment) in the file, from 1, as Wireshark counts; files of one capture count on."""
    stamp_ns: int
    """UTC."""
    captured_bytes: int
    """Length of the frame in the file."""
    wire_bytes: int
    """Length of the frame on the wire."""
    ip_offset: int
    """Offset of the IP header in `header`; 14 on Ethernet without VLAN tag."""
    source_port: int
    destination_port: int
    header: bytes
    """Headers of link, IP and UDP."""
    payload: bytes
    """Payload as long as the UDP header says, or shorter if the frame was captured in part."""
    link_type: int
    """LINKTYPE_ value of tcpdump.org; 1 is Ethernet."""

    @property
    def source(self) -> bytes:
        """IP address of the sender, 4 bytes, or 16 of IPv6."""
        ip = self.ip
        return ip[12:16] if ip[0] >> 4 == _IPV4 else ip[8:24]

    @property
    def mac(self) -> bytes:
        """Address of the sender on the link, 6 bytes; empty if the capture has none."""
        return mac_of(self.link_type, self.header)

    @property
    def udp_checksum(self) -> int:
        """UDP checksum as sent; 0 stands for none."""
        return int.from_bytes(self.header[-2:])

    @property
    def ip(self) -> bytes:
        """IP header with its options or extensions."""
        return self.header[self.ip_offset : -8]

    @property
    def identification(self) -> int:
        """Identification field of the IPv4 header."""
        return int.from_bytes(self.ip[4:6])


def is_capture_name(name: str | Path) -> bool:
    """Return whether a name ends as captures do: .pcap, .pcapng or .cap, also with a number of rotation or compressed."""
    return _ENDING.search(str(name)) is not None


class Capture:
    """UDP datagrams of a capture: pcap or pcapng, plain or compressed, of any link type that carries IP.

    A context manager to be iterated over once. Other frames are counted and passed over, and so are packets that the
    capture has seen before.

    Parameters
    ----------
    path : the file; a pattern with `*` or `?` in its name stands for the files of one walk, read in order of their first stamps
    repeats : also yield packets that come again

    Raises
    ------
    CaptureError
        If a file cannot be read, or is no capture; while iterating, if a record is damaged.
    """

    def __init__(self, path: Path, *, repeats: bool = False) -> None:
        self.path, self._keeps_repeats = path, repeats
        self.frames = 0
        """Frames read so far, whatever they hold."""
        self.cut = False
        """True if a file ended in the middle of a record; what came before it is whole."""
        self.repeated = 0
        """Packets left out as they came before."""
        self._files = _files(path)
        self._fragments = _Fragments()
        self._missed = Counter[str]()
        self._recent, self._order = set[tuple[bytes, int, bytes]](), deque[tuple[bytes, int, bytes]]()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return

    def __iter__(self) -> Iterator[Datagram]:
        for path in self._files:
            with opened(path) as file:
                for frame in frames_in(path, file):
                    if frame is None:
                        self.cut = True
                        break
                    self.frames += 1
                    for datagram in _merged(self._datagram(frame)):
                        if self._keeps_repeats or not self._is_repeat(datagram):
                            yield datagram

    @property
    def missed(self) -> str:
        """Why packets could not be read, with the remedy; empty if there is nothing to say."""
        if self._fragments.incomplete:
            self._missed[_NO_FRAGMENTS] = self._fragments.incomplete
        return "; ".join(f"{number} {what}" for what, number in self._missed.items())

    def no_data(self) -> CaptureError:
        """Return the error of a capture without data packets, with the cause if it is known."""
        found = f"no data packet, but {self.missed}" if self.missed else "no data packet"
        return CaptureError(str(self.path), found, "UDP payloads of 1206 bytes")

    def _datagram(self, frame: Frame) -> Datagram | None:
        """Parse one frame, or None if no UDP datagram is complete with it."""
        _, link_type, wire_bytes, content = frame
        at, body = PLAIN_AT, PLAIN_BODY
        if not is_plain(link_type, content):
            if link_type not in LINK_TYPES:
                self._missed[f"frames of link type {link_type}, which is not read"] += 1
                return None
            ip = ip_in(link_type, content)
            if ip is None or ip.protocol != _UDP:
                return None
            if ip.fragment or ip.more:
                whole = self._fragments.add(content, ip)
                if whole is None:
                    return None
                content, ip = whole
                wire_bytes = len(content)
            at, body = ip.at, ip.body
        if len(content) < body + 8:
            return None
        source_port, destination_port, udp_bytes = _UDP_START.unpack_from(content, body)
        end = body + udp_bytes if udp_bytes else len(content)
        if end > len(content) < wire_bytes:
            self._missed[_CUT_SHORT] += 1
        return Datagram(
            self.frames,
            frame.stamp_ns,
            len(content),
            wire_bytes,
            at,
            source_port,
            destination_port,
            content[: body + 8],
            content[body + 8 : end],
            link_type,
        )

    def _is_repeat(self, datagram: Datagram) -> bool:
        """Count a packet whose payload the same sender has sent to the same port just before: stamps make each one new."""
        payload = datagram.payload
        if len(payload) != _POSITION_BYTES and not (len(payload) == _DATA_BYTES and payload.startswith(_FLAG)):
            return False
        known = datagram.source, datagram.destination_port, payload
        if known in self._recent:
            self.repeated += 1
            return True
        self._recent.add(known)
        self._order.append(known)
        if len(self._order) > _RECENT:
            self._recent.discard(self._order.popleft())
        return False


def _merged(datagram: Datagram | None) -> Iterable[Datagram]:
    """Yield a datagram; if a network card has merged several data packets into it (UDP GRO of Linux), each of them."""
    if datagram is None:
        return ()
    payload, size = datagram.payload, _DATA_BYTES
    if len(payload) <= size or len(payload) % size or not payload.startswith(_FLAG):
        return (datagram,)
    own_bytes = len(datagram.header) + size
    parts = (payload[at : at + size] for at in range(0, len(payload), size))
    return (datagram._replace(payload=part, captured_bytes=own_bytes, wire_bytes=own_bytes) for part in parts)


_NO_FRAGMENTS = "datagrams whose other IP fragments are missing (capture with `udp or ip[6:2] & 0x1fff != 0`)"
_CUT_SHORT = "frames that were captured in part (capture with `tcpdump -s 0`)"


class _Fragments:
    """IP fragments of datagrams that are not complete (RFC 791, section 3.2)."""

    def __init__(self) -> None:
        self._held: dict[bytes, dict[int, tuple[bytes, Ip]]] = {}
        self._dropped = 0

    @property
    def incomplete(self) -> int:
        """Datagrams that were not completed so far."""
        return self._dropped + len(self._held)

    def add(self, frame: bytes, ip: Ip) -> tuple[bytes, Ip] | None:
        """Return the frame of the first fragment with the bytes of all, once the last one is there."""
        held = self._held.setdefault(ip.key, {})
        held[ip.fragment] = frame, ip
        parts, at = list[bytes](), 0
        while at in held:
            part, one = held[at]
            parts.append(part[one.body : one.end])
            if not one.more:
                del self._held[ip.key]
                first, begin = held[0]
                return first[: begin.body] + b"".join(parts), begin
            if not parts[-1]:
                break
            at += len(parts[-1])
        if len(self._held) > _INCOMPLETE:
            del self._held[next(iter(self._held))]
            self._dropped += 1
        return None


def _files(path: Path) -> list[Path]:
    """Return the files of a capture, in order of their first stamps."""
    if path.is_fifo():
        return [path]  # which can be read only once
    is_pattern = not path.exists() and glob.has_magic(path.name)
    found = sorted(path.parent.glob(path.name)) if is_pattern else []
    stamps_ns = {file: _first_stamp_ns(file) for file in found or [path]}
    return sorted(stamps_ns, key=lambda file: stamps_ns[file])


def _first_stamp_ns(path: Path) -> int:
    with opened(path) as file:
        first = next(frames_in(path, file), None)
        return first.stamp_ns if first else 0
