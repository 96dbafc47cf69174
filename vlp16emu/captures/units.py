"""Sensors of a capture, and the datagrams that each has sent."""

from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from ipaddress import ip_address
from itertools import pairwise
from threading import Event
from typing import NamedTuple

import numpy as np

from vlp16emu.captures.capture import Capture
from vlp16emu.captures.datagrams import Batch, Datagram, Flow, PacketBuffer, PacketRows
from vlp16emu.packets.layout import DATA_BYTES
from vlp16emu.types import I8


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

    def owns(self, flow: Flow) -> bool:
        """Return whether this unit has sent the datagrams of a flow."""
        port = flow.destination_port
        is_ours = flow.source == self.source and (port == self.data_port or port in self.position_ports)
        return is_ours and (not self.mac or flow.mac == self.mac)


def parts_by_unit(
    capture: Capture, units: Sequence[CapturedUnit | None]
) -> Iterator[tuple[int | None, list[Datagram]]]:
    """Yield datagrams that follow one another with the index of the unit that has sent them all.

    The index is None for other senders; a unit None has sent all.
    """
    for batch in capture.batches():
        owner = owners_in(batch, units)
        edges = [0, *(np.flatnonzero(np.diff(owner)) + 1).tolist(), len(owner)]
        for first, end in pairwise(edges):
            yield (None if owner[first] < 0 else int(owner[first])), batch.datagrams(first, end)


def by_unit(capture: Capture, units: Sequence[CapturedUnit | None]) -> Iterator[tuple[int | None, Datagram]]:
    """Yield each datagram with the index of the unit that has sent it, as `parts_by_unit`."""
    for unit, datagrams in parts_by_unit(capture, units):
        for datagram in datagrams:
            yield unit, datagram


def owners_in(batch: Batch, units: Sequence[CapturedUnit | None]) -> I8:
    """Return the index (n,) of the first unit that has sent each datagram of a batch; -1 for others."""
    flows, flow = batch.flows()
    return np.array([_owner_of(each, units) for each in flows])[flow]


def _owner_of(flow: Flow, units: Sequence[CapturedUnit | None]) -> int:
    """Return the index of the first unit that has sent a flow, or -1; a unit None has sent all."""
    return next((i for i, unit in enumerate(units) if unit is None or unit.owns(flow)), -1)


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
    for batch in capture.batches():
        if stop is not None and stop.is_set():
            raise CancelledError
        owner = np.where(batch.payload_bytes == DATA_BYTES, owners_in(batch, units), -1)
        for i, buffer in enumerate(buffers):
            rows = np.flatnonzero(owner == i)
            if len(rows):
                buffer.take(PacketRows.of(batch, rows))
        for i, buffer in enumerate(buffers):
            yield from ((i, packets) for packets in buffer.chunks())
    for i, buffer in enumerate(buffers):
        yield from ((i, packets) for packets in buffer.rest())
