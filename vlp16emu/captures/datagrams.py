"""Datagrams of a capture, one by one or in columns, and the data packets among them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import repeat
from typing import NamedTuple, Self

import numpy as np

from vlp16emu.captures.runs import ETHERNET, IP_AT, PAYLOAD_AT, SOURCE_AT, UDP_AT, PlainDatagrams, Run
from vlp16emu.packets.layout import DATA_BYTES, DATA_PAYLOAD
from vlp16emu.packets.table import PacketClock, PacketTable, captured_table
from vlp16emu.types import I8, U1

MAC_AT = {ETHERNET: 6, 113: 6, 276: 12}
"""Offset of the sender's address by link type: Ethernet, Linux cooked (SLL, SLL2). Source:
www.tcpdump.org/linktypes.html."""


class Datagram(NamedTuple):
    """A captured UDP datagram; fragments are reassembled."""

    number: int
    """Frame number (of the last fragment), from 1, as in Wireshark; it counts on over the files of one
    capture."""
    stamp_ns: int  # UTC
    captured_bytes: int  # Length of the frame in the file
    wire_bytes: int  # Length of the frame on the wire
    ip_offset: int  # Offset of the IP header in `header`; 14 on Ethernet without VLAN tag
    source_port: int
    destination_port: int
    header: bytes  # Headers of link, IP and UDP
    payload: bytes  # Payload as long as the UDP header says, or shorter if the frame was captured in part
    link_type: int  # LINKTYPE_ value of tcpdump.org; 1 is Ethernet

    @property
    def source(self) -> bytes:
        """IP address of the sender, 4 bytes, or 16 of IPv6."""
        header = self.header
        at = self.ip_offset
        return header[at + 12 : at + 16] if header[at] >> 4 == 4 else header[at + 8 : at + 24]

    @property
    def mac(self) -> bytes:
        """Address of the sender on the link, 6 bytes; empty if the capture has none."""
        at = MAC_AT.get(self.link_type)
        return b"" if at is None else self.header[at : at + 6]

    @property
    def ip(self) -> bytes:
        """IP header with its options or extensions."""
        return self.header[self.ip_offset : -8]

    @property
    def identification(self) -> int:
        """Identification field of the IPv4 header."""
        return int.from_bytes(self.ip[4:6])


_new_datagram = partial(tuple.__new__, Datagram)  # `Datagram._make` without its check of the length


@dataclass(frozen=True, slots=True)
class PlainBatch:
    """Datagrams in plain frames that follow one another, in columns; nearly all of a capture.

    Parameters
    ----------
    run : the frames
    columns : of their datagrams
    first : number of the first frame
    """

    run: Run
    columns: PlainDatagrams
    first: int

    @property
    def number(self) -> I8:
        """Numbers (n,) of the frames."""
        return self.first + np.arange(len(self.columns.end))

    @property
    def payload_bytes(self) -> I8:
        """Lengths (n,) of the payloads."""
        return self.columns.end - self.run.begin - PAYLOAD_AT

    def field(self, at: int, size: int, rows: slice | I8 = slice(None)) -> U1:
        """Return bytes (m, size) from an offset in the frames of some rows; all have them."""
        content = np.frombuffer(self.run.held, np.uint8)
        return np.lib.stride_tricks.sliding_window_view(content, size)[self.run.begin[rows] + at]

    def payload(self, row: int) -> bytes:
        """Return the payload of a row."""
        return self.run.held[int(self.run.begin[row]) + PAYLOAD_AT : int(self.columns.end[row])]

    def payloads(self, rows: I8, size: int) -> U1:
        """Return the payloads (m, size) of some rows."""
        return self.field(PAYLOAD_AT, size, rows)

    def senders(self, rows: I8) -> U1:
        """Return MAC address, IP address and destination port (m, 12) of some rows."""
        fields = self.field(MAC_AT[ETHERNET], 6, rows), self.field(SOURCE_AT, 4, rows)
        return np.concatenate([*fields, self.field(UDP_AT + 2, 2, rows)], axis=1)

    def datagrams(self, first: int = 0, end: int | None = None) -> list[Datagram]:
        """Return the datagrams from row `first` on and before `end`."""
        run = self.run.part(first, len(self.run.begin) if end is None else end)
        count = len(run.begin)
        begin = run.begin.tolist()
        payload = (run.begin + PAYLOAD_AT).tolist()
        ends, source_port, destination_port = (
            column[first:end].tolist()
            for column in (self.columns.end, self.columns.source_port, self.columns.destination_port)
        )
        numbers = range(self.first + first, self.first + first + count)
        columns = (
            *(numbers, run.stamp_ns.tolist(), run.length.tolist(), run.wire_bytes.tolist()),
            *(repeat(IP_AT, count), source_port, destination_port),
            *(run.cut(begin, payload), run.cut(payload, ends), repeat(run.link_type, count)),
        )
        return list(map(_new_datagram, zip(*columns, strict=True)))


Datagrams = PlainBatch | list[Datagram]
"""Datagrams that follow one another in a capture."""


class PacketRows(NamedTuple):
    """Data packets of a capture in columns."""

    number: I8  # (n,) numbers of the frames
    arrival_ns: I8  # (n,) capture stamps, UTC
    payloads: U1  # (n, 1206)

    @classmethod
    def of_batch(cls, batch: PlainBatch, rows: I8) -> Self:
        """Return those in some rows (n,) of a batch."""
        return cls(batch.number[rows], batch.run.stamp_ns[rows], batch.payloads(rows, DATA_BYTES))

    @classmethod
    def of(cls, datagrams: Sequence[Datagram]) -> Self:
        """Return one or more data packets."""
        number, arrival_ns = np.array([(each.number, each.stamp_ns) for each in datagrams], np.int64).T
        payloads = np.frombuffer(b"".join([each.payload for each in datagrams]), np.uint8)
        return cls(number, arrival_ns, payloads.reshape(-1, DATA_BYTES))

    @classmethod
    def joined(cls, rows: Sequence["PacketRows"]) -> Self:
        """Return one or more packets one after another."""
        number, arrival_ns, payloads = zip(*rows, strict=True)
        return cls(np.concatenate(number), np.concatenate(arrival_ns), np.concatenate(payloads))

    def part(self, first: int, end: int) -> "PacketRows":
        """Return the packets from `first` on and before `end`."""
        return PacketRows(self.number[first:end], self.arrival_ns[first:end], self.payloads[first:end])

    def table(self, clock: PacketClock) -> PacketTable:
        """Return the table of these packets, which follow those that `clock` has converted."""
        fields = self.payloads.reshape(-1).view(DATA_PAYLOAD)
        return captured_table(self.number, self.arrival_ns, fields, clock)


class PacketBuffer:
    """Data packets that are collected into chunks of a fixed number."""

    def __init__(self, chunk: int) -> None:
        self._chunk = chunk
        self._parts = list[PacketRows]()
        self._single = list[Datagram]()  # later than those
        self._count = 0

    def take(self, packet: Datagram) -> None:
        """Take a packet."""
        self._single.append(packet)
        self._count += 1

    def take_rows(self, rows: PacketRows) -> None:
        """Take packets in columns."""
        self._settle()
        self._parts.append(rows)
        self._count += len(rows.number)

    def chunks(self) -> Iterator[PacketRows]:
        """Yield the chunks that are complete."""
        if self._count < self._chunk:
            return
        self._settle()
        every = PacketRows.joined(self._parts)
        whole = self._count // self._chunk * self._chunk
        self._parts = [every.part(whole, self._count)] if whole < self._count else []
        self._count -= whole
        for first in range(0, whole, self._chunk):
            yield every.part(first, first + self._chunk)

    def rest(self) -> Iterator[PacketRows]:
        """Yield what is left, if there is something."""
        yield from self.chunks()
        self._settle()
        if self._parts:
            yield PacketRows.joined(self._parts)
        self._parts = []
        self._count = 0

    def _settle(self) -> None:
        """Put single packets into columns."""
        if self._single:
            self._parts.append(PacketRows.of(self._single))
            self._single = []


def table_of(datagrams: Sequence[Datagram], clock: PacketClock) -> PacketTable:
    """Return the table of one or more data packets that follow those which `clock` has converted."""
    return PacketRows.of(datagrams).table(clock)
