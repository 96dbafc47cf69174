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

_MAC_AT = {ETHERNET: 6, 113: 6, 276: 12}
"""Offset of the sender's address by link type: Ethernet, Linux cooked (SLL, SLL2). Source:
www.tcpdump.org/linktypes.html."""
_MAC_BYTES = 6
_IPV4_BYTES = 4
_PORT_BYTES = 2


class Flow(NamedTuple):
    """Sender and destination port of datagrams."""

    mac: bytes  # Address of the sender on the link, 6 bytes; empty if the capture has none
    source: bytes  # IP address of the sender, 4 bytes, or 16 of IPv6
    destination_port: int


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
        at = _MAC_AT.get(self.link_type)
        return b"" if at is None else self.header[at : at + _MAC_BYTES]

    @property
    def flow(self) -> Flow:
        """Sender and destination port."""
        return Flow(self.mac, self.source, self.destination_port)

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
    def stamp_ns(self) -> I8:
        """Capture stamps (n,), UTC."""
        return self.run.stamp_ns

    @property
    def payload_bytes(self) -> I8:
        """Lengths (n,) of the payloads."""
        return self.columns.end - self.run.begin - PAYLOAD_AT

    def payload(self, row: int) -> bytes:
        """Return the payload of a row."""
        return self.run.held[int(self.run.begin[row]) + PAYLOAD_AT : int(self.columns.end[row])]

    def payloads(self, rows: I8, size: int) -> U1:
        """Return the payloads (m, size) of some rows."""
        return self._field(PAYLOAD_AT, size, rows)

    def flows(self) -> tuple[list[Flow], I8]:
        """Return the flows of the datagrams, and the index (n,) of that of each."""
        addresses = self._field(_MAC_AT[ETHERNET], _MAC_BYTES), self._field(SOURCE_AT, _IPV4_BYTES)
        fields = np.concatenate([*addresses, self._field(UDP_AT + 2, _PORT_BYTES)], axis=1)
        each = fields.view(f"V{fields.shape[1]}").ravel()
        distinct, flow = np.unique(each, return_inverse=True)
        return [_flow_of(one.tobytes()) for one in distinct], flow

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

    def _field(self, at: int, size: int, rows: slice | I8 = slice(None)) -> U1:
        """Return bytes (m, size) from an offset in the frames of some rows; all of these have them."""
        content = np.frombuffer(self.run.held, np.uint8)
        return np.lib.stride_tricks.sliding_window_view(content, size)[self.run.begin[rows] + at]


@dataclass(frozen=True, slots=True)
class OtherBatch:
    """Datagrams in frames of any kind that follow one another, as `PlainBatch` has them."""

    each: Sequence[Datagram]

    @property
    def number(self) -> I8:
        """Numbers (n,) of the frames."""
        return np.array([datagram.number for datagram in self.each], np.int64)

    @property
    def stamp_ns(self) -> I8:
        """Capture stamps (n,), UTC."""
        return np.array([datagram.stamp_ns for datagram in self.each], np.int64)

    @property
    def payload_bytes(self) -> I8:
        """Lengths (n,) of the payloads."""
        return np.array([len(datagram.payload) for datagram in self.each], np.int64)

    def payload(self, row: int) -> bytes:
        """Return the payload of a row."""
        return self.each[row].payload

    def payloads(self, rows: I8, size: int) -> U1:
        """Return the payloads (m, size) of some rows."""
        content = b"".join([self.each[row].payload for row in rows.tolist()])
        return np.frombuffer(content, np.uint8).reshape(-1, size)

    def flows(self) -> tuple[list[Flow], I8]:
        """Return the flows of the datagrams, and the index (n,) of that of each."""
        flows = dict[Flow, int]()
        flow = [flows.setdefault(datagram.flow, len(flows)) for datagram in self.each]
        return list(flows), np.array(flow, np.int64)

    def datagrams(self, first: int = 0, end: int | None = None) -> list[Datagram]:
        """Return the datagrams from row `first` on and before `end`."""
        return list(self.each[first:end])


Batch = PlainBatch | OtherBatch
"""Datagrams that follow one another in a capture."""


def _flow_of(field: bytes) -> Flow:
    """Return a flow from its bytes: MAC address, IPv4 address and port."""
    mac = field[:_MAC_BYTES]
    source = field[_MAC_BYTES:-_PORT_BYTES]
    return Flow(mac, source, int.from_bytes(field[-_PORT_BYTES:]))


class PacketRows(NamedTuple):
    """Data packets of a capture in columns."""

    number: I8  # (n,) numbers of the frames
    arrival_ns: I8  # (n,) capture stamps, UTC
    payloads: U1  # (n, 1206)

    @classmethod
    def of(cls, batch: Batch, rows: I8) -> Self:
        """Return those in some rows (n,) of a batch."""
        return cls(batch.number[rows], batch.stamp_ns[rows], batch.payloads(rows, DATA_BYTES))

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
        self._count = 0

    def take(self, rows: PacketRows) -> None:
        """Take packets."""
        self._parts.append(rows)
        self._count += len(rows.number)

    def chunks(self) -> Iterator[PacketRows]:
        """Yield the chunks that are complete."""
        if self._count < self._chunk:
            return
        every = PacketRows.joined(self._parts)
        whole = self._count // self._chunk * self._chunk
        self._parts = [every.part(whole, self._count)]
        self._count -= whole
        for first in range(0, whole, self._chunk):
            yield every.part(first, first + self._chunk)

    def rest(self) -> Iterator[PacketRows]:
        """Yield what is left, if there is something."""
        yield from self.chunks()
        if self._count:
            yield PacketRows.joined(self._parts)
        self._parts = []
        self._count = 0


def table_of(datagrams: Sequence[Datagram], clock: PacketClock) -> PacketTable:
    """Return the table of one or more data packets that follow those which `clock` has converted."""
    return PacketRows.of(OtherBatch(datagrams), np.arange(len(datagrams))).table(clock)
