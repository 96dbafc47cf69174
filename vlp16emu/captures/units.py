"""Sensors of a capture, and the datagrams that each has sent."""

from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from ipaddress import ip_address
from itertools import pairwise
from threading import Event
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.captures.capture import Capture
from vlp16emu.captures.datagrams import MAC_AT, Datagram, PacketBuffer, PacketRows, PlainBatch
from vlp16emu.captures.runs import ETHERNET, SOURCE_AT
from vlp16emu.packets.layout import DATA_BYTES
from vlp16emu.types import I8

_IPV4_BYTES = 4  # of an address


class CapturedUnit(NamedTuple):
    """A sensor, identified by its address and data port.

    If two sensors share these, the MAC address identifies them too.
    """

    source: bytes  # IP address, 4 bytes, or 16 of IPv6
    data_port: int
    position_ports: tuple[int, ...]  # Ports of its position packets; none if none were captured
    mac: bytes = b""  # 6 bytes; empty if address and port are enough

    def __str__(self) -> str:
        return f"{ip_address(self.source)}:{self.data_port}{'@' + self.mac.hex(':') if self.mac else ''}"

    def owns(self, datagram: Datagram) -> bool:
        """Return whether this unit has sent a datagram."""
        port = datagram.destination_port
        is_ours = datagram.source == self.source and (port == self.data_port or port in self.position_ports)
        return is_ours and (not self.mac or datagram.mac == self.mac)

    def owns_rows(self, batch: PlainBatch) -> NDArray[np.bool_]:
        """Return a mask (n,) of the datagrams of a batch that this unit has sent."""
        ports = (self.data_port, *self.position_ports)
        is_ours = np.isin(batch.columns.destination_port, ports)
        if len(self.source) != _IPV4_BYTES:
            return np.zeros_like(is_ours)
        is_ours &= (batch.field(SOURCE_AT, _IPV4_BYTES) == np.frombuffer(self.source, np.uint8)).all(axis=1)
        if self.mac:
            sent_by = batch.field(MAC_AT[ETHERNET], len(self.mac))
            is_ours &= (sent_by == np.frombuffer(self.mac, np.uint8)).all(axis=1)
        return is_ours


def parts_by_unit(
    capture: Capture, units: Sequence[CapturedUnit | None]
) -> Iterator[tuple[int | None, list[Datagram]]]:
    """Yield datagrams that follow one another with the index of the unit that has sent them all.

    The index is None for other senders; a unit None has sent all.
    """
    for part in capture.parts():
        if isinstance(part, PlainBatch):
            owner = owners_in(part, units)
            edges = [0, *(np.flatnonzero(np.diff(owner)) + 1).tolist(), len(owner)]
            for first, end in pairwise(edges):
                yield (None if owner[first] < 0 else int(owner[first])), part.datagrams(first, end)
        else:
            for datagram in part:
                yield owner_of(datagram, units), [datagram]


def by_unit(capture: Capture, units: Sequence[CapturedUnit | None]) -> Iterator[tuple[int | None, Datagram]]:
    """Yield each datagram with the index of the unit that has sent it, as `parts_by_unit`."""
    for unit, datagrams in parts_by_unit(capture, units):
        for datagram in datagrams:
            yield unit, datagram


def owner_of(datagram: Datagram, units: Sequence[CapturedUnit | None]) -> int | None:
    """Return the index of the first unit that has sent a datagram; a unit None has sent all."""
    return next((i for i, unit in enumerate(units) if unit is None or unit.owns(datagram)), None)


def owners_in(batch: PlainBatch, units: Sequence[CapturedUnit | None]) -> I8:
    """Return the index (n,) of the first unit that has sent each datagram of a batch; -1 for others."""
    owner = np.full(len(batch.columns.end), -1)
    for i in reversed(range(len(units))):
        unit = units[i]
        owner[slice(None) if unit is None else unit.owns_rows(batch)] = i
    return owner


def searched(
    capture: Capture, units: Sequence[CapturedUnit | None], stop: Event | None
) -> Iterator[tuple[int | None, Datagram]]:
    """Yield datagrams as `by_unit` before anything is written; CancelledError once `stop` is set."""
    for found in by_unit(capture, units):
        if stop is not None and stop.is_set():
            raise CancelledError
        yield found


def data_rows(
    capture: Capture, units: Sequence[CapturedUnit | None], chunk: int, stop: Event | None
) -> Iterator[tuple[int, PacketRows]]:
    """Yield the data packets of units, so many of one unit at once, with the index of the unit.

    Raises CancelledError once `stop` is set.
    """
    buffers = [PacketBuffer(chunk) for _ in units]
    for part in capture.parts():
        if stop is not None and stop.is_set():
            raise CancelledError
        if isinstance(part, PlainBatch):
            owner = np.where(part.payload_bytes == DATA_BYTES, owners_in(part, units), -1)
            for i, buffer in enumerate(buffers):
                rows = np.flatnonzero(owner == i)
                if len(rows):
                    buffer.take_rows(PacketRows.of_batch(part, rows))
        else:
            for datagram in part:
                owned = owner_of(datagram, units)
                if owned is not None and len(datagram.payload) == DATA_BYTES:
                    buffers[owned].take(datagram)
        for i, buffer in enumerate(buffers):
            yield from ((i, packets) for packets in buffer.chunks())
    for i, buffer in enumerate(buffers):
        yield from ((i, packets) for packets in buffer.rest())
