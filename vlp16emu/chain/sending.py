"""Which firing sequences of a unit are sent, and in which packets."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.packets import SEQUENCES_PER_PACKET, azimuth_cdeg, pack_data
from vlp16emu.raycast.caster import Geometry
from vlp16emu.sensor.head import Head
from vlp16emu.types import NO_SURFACE, Firings, Packet, ReturnMode, Returns, SensorModel

Opened = Future[Geometry]
SlotsOf = Callable[[Returns, ReturnMode], NDArray[np.void]]
"""What is behind the records of returns that are packed in a mode."""

_AT_ONCE = 1 << 16
"""Firing sequences whose azimuths are read at once, 3.6 s of them."""
_BY_SEQUENCE = ("t_ns", "clock_ns", "azimuth_deg", "reading_deg", "origin_m", "direction")
"""Arrays of `Firings`, one row each per firing sequence."""


@dataclass(frozen=True, slots=True)
class SendingSpan:
    """A part of a run in which the settings of packets stay as they are."""

    first: int
    """Firing sequence, at which a packet begins."""
    stop: int | None
    """Firing sequence after the last; None for a span without end."""
    mode: ReturnMode
    fov_deg: tuple[int, int] | None
    """First and last azimuth that is sent, in whole degrees; None for all around."""

    @property
    def per_packet(self) -> int:
        """Firing sequences of a packet."""
        return SEQUENCES_PER_PACKET[self.mode]


@dataclass(frozen=True, slots=True)
class Sending:
    """What a unit sends over a run."""

    unit: int
    """Place in the rig, from 0."""
    model: str
    """That decides the factory byte; "free" of a sensor without packets."""
    head: Head
    spans: tuple[SendingSpan, ...]
    """In order of time, without overlap."""
    silences_ns: tuple[tuple[int, int], ...] = ()
    """Spans of time since the first pulse in which no packet of any kind leaves."""

    def stop_of(self, span: SendingSpan, stop_ns: int) -> int:
        """Find the firing sequence after the last of a span that a packet due before a time since the first pulse may have."""
        last = -(-stop_ns // self.head.beams.sequence_ns) - 1
        return last if span.stop is None else min(span.stop, last)

    def chosen(self, span: SendingSpan, first: int, stop: int) -> NDArray[np.int64]:
        """Find the firing sequences from `first` until before `stop`, both even, that lie in the field of view of a span.

        Blocks are sent or not as a whole, by the azimuth in them; the last degree of the field of view is part of it.
        """
        every = np.arange(first, stop, dtype=np.int64)
        if span.fov_deg is None:
            return every
        angle_deg = self.head.rotor.angle_deg(every * self.head.beams.sequence_ns)
        code = azimuth_cdeg(self.head.rotor.reading_deg(angle_deg, first)[::2])
        begin, end = 100 * span.fov_deg[0], 100 * (span.fov_deg[1] + 1)
        inside = (code >= begin) & (code < end) if begin < end else (code >= begin) | (code < end)
        return every[np.repeat(inside, 2)]

    def _begin_of(self, span: SendingSpan, start_ns: int) -> int:
        """Find the firing sequence at which the packets of a span begin that may be due from a time on."""
        if span.fov_deg is not None:
            return span.first
        period_ns = span.per_packet * self.head.beams.sequence_ns
        behind_ns = start_ns - span.first * self.head.beams.sequence_ns
        return span.first + max(0, -(-behind_ns // period_ns) - 1) * span.per_packet

    def slots(self, start_ns: int, stop_ns: int) -> Iterator[NDArray[np.int64]]:
        """Yield the firing sequences (n, 24) or (n, 12) of packets due in a span of time since the first pulse."""
        for span in self.spans:
            yield from self.slots_of(span, start_ns, stop_ns)

    def slots_of(self, span: SendingSpan, start_ns: int, stop_ns: int) -> Iterator[NDArray[np.int64]]:
        """Yield those of a span of settings."""
        sequence_ns = self.head.beams.sequence_ns
        begin, stop = self._begin_of(span, start_ns), self.stop_of(span, stop_ns) & ~1
        left = np.empty(0, np.int64)
        for first in range(begin, stop, _AT_ONCE):
            sequences = np.concatenate([left, self.chosen(span, first, min(first + _AT_ONCE, stop))])
            whole = len(sequences) // span.per_packet * span.per_packet
            slots, left = sequences[:whole].reshape(-1, span.per_packet), sequences[whole:]
            slots = slots[(slots[:, -1] + 1) * sequence_ns >= start_ns]
            if len(slots):
                yield slots

    def parts(self, start_ns: int, stop_ns: int, slots_of: SlotsOf | None = None) -> Iterator["SendingPart"]:
        """Cut a span of time since the first pulse where settings change; without parts that no packet is due in."""
        for span in self.spans:
            slots = next(self.slots_of(span, start_ns, stop_ns), None)
            if slots is not None:
                first, stop = int(slots[0, 0]), self.stop_of(span, stop_ns)
                if span.fov_deg is None:
                    stop -= (stop - first) % span.per_packet
                yield SendingPart(self, span, first, stop, slots_of)

    def count(self, start_ns: int, stop_ns: int) -> int:
        """Count the packets due in a span of time since the first pulse."""
        return sum(
            sum(map(len, self.slots_of(span, start_ns, stop_ns)))
            if span.fov_deg
            else max((self.stop_of(span, stop_ns) - self._begin_of(span, start_ns)) // span.per_packet, 0)
            for span in self.spans
        )

    def is_silent(self, since_ns: int) -> bool:
        """Whether nothing is sent at a time since the first pulse."""
        return any(begin <= since_ns < end for begin, end in self.silences_ns)


@dataclass(frozen=True, slots=True)
class _Chosen:
    """What is sent of the firing sequences `first` to `stop` - 1."""

    first: int
    stop: int
    returns: Returns


@dataclass(frozen=True, slots=True)
class SendingPart:
    """A part of a run in which the settings of packets stay as they are, from the first packet that is asked for."""

    sending: Sending
    span: SendingSpan
    first: int
    """Firing sequence at which that packet begins."""
    stop: int
    """Firing sequence after the last."""
    slots_of: SlotsOf | None = None
    """Where packets carry the truth behind their records."""

    def blocks(self, block: int) -> range:
        """Blocks of so many firing sequences that hold it."""
        return range(self.first // block, -(-self.stop // block))

    def taken(
        self, scan: Callable[[range, Opened], Returns], block: int, run: range, opened: Opened
    ) -> "list[Packet] | _Chosen":
        """Scan a run of blocks, and take what is sent of it; packed, where packets begin and end with blocks."""
        returns, begin = scan(run, opened), run.start * block
        first, stop = max(self.first, begin), min(self.stop, run.stop * block)
        if self.span.fov_deg is None:
            return self._packed(_rows(returns, slice(first - begin, stop - begin)))
        chosen = self.sending.chosen(self.span, first, stop & ~1)
        return _Chosen(first, stop, _rows(returns, chosen - begin))

    def packets(self, taken: "Iterable[list[Packet] | _Chosen]") -> Iterator[Packet]:
        """Pack what is taken of successive firing sequences; a packet that does not fill is not sent.

        Where some were left out, packets go on as if they had been sent.
        """
        left, reached, lost = list[Returns](), self.first, 0
        for some in taken:
            if isinstance(some, list):
                yield from some
                continue
            if some.first > reached:
                lost += sum(map(_count, left)) + len(self.sending.chosen(self.span, reached, some.first & ~1))
                left.clear()
            reached, missed = some.stop, min(-lost % self.span.per_packet, _count(some.returns))
            lost += missed
            left.append(_rows(some.returns, slice(missed, None)))
            rows = _joined(left)
            whole = _count(rows) // self.span.per_packet * self.span.per_packet
            yield from self._packed(_rows(rows, slice(whole)))
            left = [_rows(rows, slice(whole, None))]

    def _packed(self, returns: Returns) -> list[Packet]:
        """Pack whole packets."""
        packets = pack_data(returns, self.span.mode, SensorModel(self.sending.model), self.sending.unit)
        if self.slots_of is None:
            return packets
        slots = self.slots_of(returns, self.span.mode)
        return [replace(packet, slots=rows) for packet, rows in zip(packets, slots, strict=True)]


_BY_RETURN = ("distance_m", "reflectivity", "surface", "range_m", "share")


def _rows(returns: Returns, rows: slice | NDArray[np.int64]) -> Returns:
    """Take some firing sequences of returns, for packing: in order of time, not all of them in a row."""
    arrays = {name: getattr(returns.firings, name)[rows] for name in _BY_SEQUENCE}
    taken = {name: whole[rows] for name in _BY_RETURN if (whole := getattr(returns, name)) is not None}
    firings = Firings(index=returns.firings.index, beam_axis=None, **arrays)
    return Returns(firings, surfaces=returns.surfaces, **taken)


def _joined(some: list[Returns]) -> Returns:
    """Put the rows of returns behind each other, and their tables of surfaces."""
    first, arrays = some[0], dict[str, NDArray[Any]]()
    for name in _BY_SEQUENCE:
        arrays[name] = np.concatenate([getattr(each.firings, name) for each in some])
    firings = Firings(index=first.firings.index, beam_axis=None, **arrays)
    if first.surfaces is None:
        joined = {name: np.concatenate([getattr(each, name) for each in some]) for name in _BY_RETURN[:2]}
        return Returns(firings, **joined)
    tables = [each.surfaces for each in some if each.surfaces is not None]
    begins = np.cumsum([0, *map(len, tables[:-1])])
    moved = [
        replace(
            each, surface=np.where(each.surface == NO_SURFACE, NO_SURFACE, each.surface + np.uint32(begin))
        )
        for each, begin in zip(some, begins.tolist(), strict=True)
        if each.surface is not None
    ]
    joined = {name: np.concatenate([getattr(each, name) for each in moved]) for name in _BY_RETURN}
    return Returns(firings, surfaces=np.concatenate(tables), **joined)


def _count(returns: Returns) -> int:
    return len(returns.distance_m)
