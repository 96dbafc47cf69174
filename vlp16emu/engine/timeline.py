"""The firing sequences of a unit that are sent over a run, and their packets."""

from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.engine.field_of_view import FieldOfView
from vlp16emu.packets import layout_of, pack_data
from vlp16emu.sensor.head import Head
from vlp16emu.sensor.operation import Operation
from vlp16emu.sensor.settings import ALL_AROUND
from vlp16emu.sensor.steps import Steps
from vlp16emu.types import NO_SURFACE, Firings, Packet, ReturnMode, Returns, SensorModel
from vlp16emu.units import FOREVER_NS

if TYPE_CHECKING:
    from vlp16emu.engine.build import Unit

TruthOf = Callable[["Unit", Returns, ReturnMode], NDArray[np.void]]
"""Function that gives the ground truth for the records of whole packets in a return mode."""

_AT_ONCE = 1 << 16  # firing sequences whose azimuths are read at once: 3.6 s
_BY_SEQUENCE = ("t_ns", "clock_ns", "azimuth_deg", "reading_deg", "origin_m", "direction")
"""Arrays of `Firings`, one row each per firing sequence."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """A part of a run in which the settings of packets stay as they are."""

    first: int  # Firing sequence, at which a packet begins
    stop: int | None  # Firing sequence after the last; None for a span without end
    mode: ReturnMode
    fov_deg: tuple[int, int] | None
    """First and last azimuth that is sent, in whole degrees; None for the full circle."""
    per_packet: int  # firing sequences in a packet

    def blocks(self, block: int) -> range:
        """Return the blocks of `block` firing sequences that cover the stretch, which must have an end."""
        assert self.stop is not None
        return range(self.first // block, -(-self.stop // block))

    def blocks_among(self, blocks: range, block: int) -> range:
        """Return the part of `blocks`, of `block` firing sequences each, in the stretch; it may be empty."""
        stop = blocks.stop if self.stop is None else min(blocks.stop, -(-self.stop // block))
        return range(max(blocks.start, self.first // block), stop)


@dataclass(frozen=True)
class Timeline:
    """Transmission of a unit over a run."""

    head: Head
    spans: tuple[Stretch, ...]  # In order of time, without overlap
    _counts: dict[Stretch, tuple[int, ...]] = field(default_factory=dict, init=False, repr=False)
    """Numbers of firing sequences in view from the begin of a span to each multiple of `_AT_ONCE` after it,
    as far as they have been counted."""
    _totals: dict[int, int] = field(default_factory=lambda: {0: 0}, init=False, repr=False)
    """Numbers of packets before spans, by their places."""

    def _stop_of(self, span: Stretch, stop_ns: int) -> int:
        """Find the end of the firing sequences whose packets are due before a time since the first pulse."""
        last = -(-stop_ns // self.head.beams.sequence_ns) - 1
        return last if span.stop is None else min(span.stop, last)

    def begin_of_reading(self, sequence: int) -> int:
        """Return the firing sequence of the last azimuth reading up to a firing sequence."""
        return sequence - sequence % self.head.beams.per_reading

    def in_view(self, span: Stretch, first: int, stop: int) -> NDArray[np.int64]:
        """Find firing sequences from `first` to before `stop`, at azimuth readings, in a field of view.

        What has one azimuth reading is sent as a whole or not at all; the field of view includes its last
        degree.
        """
        every = np.arange(first, stop, dtype=np.int64)
        if span.fov_deg is None:
            return every
        step = self.head.beams.per_reading
        inside = FieldOfView(self.head, *span.fov_deg).inside(every[::step])
        return every[np.repeat(inside, step)]

    def _count_in_view(self, span: Stretch, stop: int) -> int:
        """Count a span's firing sequences in view before one with a reading; the counts are kept."""
        if span.fov_deg is None or stop <= span.first:
            return max(stop - span.first, 0)
        field_of_view = FieldOfView(self.head, *span.fov_deg)
        counts = list(self._counts.get(span, (0,)))
        step = self.head.beams.per_reading
        place = (stop - span.first) // _AT_ONCE
        for first in range(span.first + _AT_ONCE * (len(counts) - 1), stop - _AT_ONCE + 1, _AT_ONCE):
            counts.append(counts[-1] + step * field_of_view.count(first, first + _AT_ONCE))
        self._counts[span] = tuple(counts)
        return counts[place] + step * field_of_view.count(span.first + _AT_ONCE * place, stop)

    def _packets_before(self, span: Stretch, t_ns: int) -> int:
        """Count the packets of a span that are due before a time since the first pulse."""
        return self._count_in_view(span, self.begin_of_reading(self._stop_of(span, t_ns))) // span.per_packet

    def _begin_of(self, span: Stretch, start_ns: int) -> tuple[int, int]:
        """Find a firing sequence from which the packets that are due at or after a time are found.

        Returns its number, and the number of firing sequences in view from it to the first of these packets.
        """
        before = self._packets_before(span, start_ns) * span.per_packet
        if span.fov_deg is None:
            return span.first + before, 0
        counts = self._counts.get(span, (0,))
        place = bisect_right(counts, before) - 1
        return span.first + _AT_ONCE * place, before - counts[place]

    def _spans_in(self, start_ns: int, stop_ns: int) -> Iterator[Stretch]:
        """Yield the spans that may have packets due in a span of time since the first pulse."""
        sequence_ns = self.head.beams.sequence_ns
        for span in self.spans:
            is_over = span.stop is not None and span.stop * sequence_ns < start_ns
            if not is_over and span.first * sequence_ns < stop_ns:
                yield span

    def sequences(self, start_ns: int, stop_ns: int) -> Iterator[NDArray[np.int64]]:
        """Yield firing sequences (n, `per_packet`) of packets due in a span since the first pulse."""
        for span in self._spans_in(start_ns, stop_ns):
            yield from self._sequences_of(span, start_ns, stop_ns)

    def _sequences_of(self, span: Stretch, start_ns: int, stop_ns: int) -> Iterator[NDArray[np.int64]]:
        stop = self.begin_of_reading(self._stop_of(span, stop_ns))
        begin, skipped = self._begin_of(span, start_ns)
        left = np.empty(0, np.int64)
        for first in range(begin, stop, _AT_ONCE):
            chosen = self.in_view(span, first, min(first + _AT_ONCE, stop))
            rows = np.concatenate([left, chosen[skipped:]])
            skipped = max(skipped - len(chosen), 0)
            complete = len(rows) // span.per_packet * span.per_packet
            left = rows[complete:]
            if complete:
                yield rows[:complete].reshape(-1, span.per_packet)

    def stretches(self, start_ns: int, stop_ns: int) -> Iterator[Stretch]:
        """Cut a span since the first pulse where settings change; stretches without packets are dropped.

        Each stretch begins with its first packet that is due in the span.
        """
        for span in self._spans_in(start_ns, stop_ns):
            sequences = next(self._sequences_of(span, start_ns, stop_ns), None)
            if sequences is not None:
                first, stop = int(sequences[0, 0]), self._stop_of(span, stop_ns)
                if span.fov_deg is None:
                    stop -= (stop - first) % span.per_packet
                yield replace(span, first=first, stop=stop)

    def count(self, start_ns: int, stop_ns: int) -> int:
        """Count the packets due in a span of time since the first pulse."""
        return self._count_before(stop_ns) - self._count_before(start_ns)

    def _count_before(self, t_ns: int) -> int:
        """Count the packets due before a time since the first pulse."""
        latest = (t_ns - 1) // self.head.beams.sequence_ns
        place = bisect_right(self.spans, latest, key=lambda span: span.first) - 1
        if place < 0:
            return 0
        for later in range(len(self._totals), place + 1):
            span = self.spans[later - 1]
            assert span.stop is not None
            packets = self._count_in_view(span, span.stop) // span.per_packet
            self._totals[later] = self._totals[later - 1] + packets
        return self._totals[place] + self._packets_before(self.spans[place], t_ns)

    def is_sent(self, span: Stretch, first: int, stop: int) -> NDArray[np.bool_] | None:
        """Return a mask (stop - first,) of the firing sequences that a span sends; None for all of them."""
        begin = max(span.first, first)
        end = stop if span.stop is None else min(span.stop, stop)
        if (begin, end) == (first, stop) and span.fov_deg is None:
            return None
        sent = np.zeros(stop - first, np.bool_)
        sent[self.in_view(span, begin, end) - first] = True
        return sent


def stretches_of(operation: Steps[Operation], model: SensorModel) -> tuple[Stretch, ...]:
    """Cut a run of a model at changes of mode, field of view, laser and power; drop spans without packets.

    A change takes effect with the next packet of single return, and begins a packet.
    """
    single = layout_of(model, ReturnMode.STRONGEST)

    def sequence_at(since_ns: int) -> int:
        """Return the first firing sequence of the next packet of single return."""
        return -(-since_ns // single.period_ns) * single.sequences

    spans = list[Stretch]()
    for begin_ns, end_ns, in_force in operation.spans():
        first = sequence_at(begin_ns)
        stop = None if end_ns == FOREVER_NS else sequence_at(end_ns)
        settings = in_force.settings
        if not in_force.is_powered or not settings.laser or first == stop:
            continue
        mode = ReturnMode(settings.return_mode)
        fov_deg = None if settings.fov_deg == ALL_AROUND else settings.fov_deg
        last = spans[-1] if spans else None
        if last and last.stop == first and (last.mode, last.fov_deg) == (mode, fov_deg):
            spans[-1] = replace(last, stop=stop)
        else:
            spans.append(Stretch(first, stop, mode, fov_deg, layout_of(model, mode).sequences))
    return tuple(spans)


class Packer:
    """Packs returns of a stretch into data packets, with ground truth if asked; keeps an open packet."""

    def __init__(self, unit: "Unit", stretch: Stretch, truth_of: TruthOf | None = None) -> None:
        self._unit = unit
        self._stretch = stretch
        self._truth_of = truth_of
        self._reached = stretch.first
        self._lost = 0
        self._left: Returns | None = None

    def pack(self, returns: Returns) -> Iterator[Packet]:
        """Pack the returns of successive firing sequences; an incomplete packet is not sent.

        If blocks are missing before these, packing goes on as if the missing ones had been sent.
        """
        stretch = self._stretch
        per_packet = self._stretch.per_packet
        begin = returns.firings.index
        first, stop = max(stretch.first, begin), min(stretch.stop or 2**62, begin + _count(returns))
        rows = self._rows(returns, first, stop)
        if first > self._reached:
            timeline = self._unit.timeline
            missing = len(timeline.in_view(stretch, self._reached, timeline.begin_of_reading(first)))
            self._lost += missing + (_count(self._left) if self._left else 0)
            self._left = None
        self._reached = stop
        if skipped := min(-self._lost % per_packet, _count(rows)):
            self._lost += skipped
            rows = _rows(rows, slice(skipped, None))
        rows = _concatenate(self._left, rows) if self._left else rows
        complete = _count(rows) // per_packet * per_packet
        self._left = _rows(rows, slice(complete, None)) if complete < _count(rows) else None
        if not complete:
            return
        rows = _rows(rows, slice(0, complete))
        unit = self._unit
        packets = pack_data(rows, stretch.mode, SensorModel(unit.section.model), unit.number)
        if self._truth_of is None:
            yield from packets
        else:
            truth = self._truth_of(unit, rows, stretch.mode)
            yield from (replace(packet, slots=slots) for packet, slots in zip(packets, truth, strict=True))

    def _rows(self, returns: Returns, first: int, stop: int) -> Returns:
        """Select the returns that are sent from firing sequences `first` to `stop` - 1."""
        begin = returns.firings.index
        if self._stretch.fov_deg is None:
            return _rows(returns, slice(first - begin, stop - begin))
        timeline = self._unit.timeline
        return _rows(returns, timeline.in_view(self._stretch, first, timeline.begin_of_reading(stop)) - begin)


_BY_RETURN = ("distance_m", "reflectivity", "surface", "range_m", "share")


def _rows(returns: Returns, rows: slice | NDArray[np.int64]) -> Returns:
    """Select firing sequences of returns for packing: in order of time, with gaps."""
    if isinstance(rows, slice) and rows == slice(0, _count(returns)):
        return returns
    arrays = {name: getattr(returns.firings, name)[rows] for name in _BY_SEQUENCE}
    present = [name for name in _BY_RETURN if getattr(returns, name) is not None]
    selected = {name: getattr(returns, name)[rows] for name in present}
    firings = Firings(index=returns.firings.index, beam_axis=None, **arrays)
    return Returns(firings, surfaces=returns.surfaces, mode=returns.mode, **selected)


def _concatenate(earlier: Returns, later: Returns) -> Returns:
    """Concatenate the rows of two returns and their tables of surfaces."""

    def concatenate(first: object, second: object, names: tuple[str, ...]) -> dict[str, Any]:
        """Concatenate the fields of both that the first one has."""
        present = [name for name in names if getattr(first, name) is not None]
        return {name: np.concatenate([getattr(first, name), getattr(second, name)]) for name in present}

    if earlier.surfaces is not None and later.surface is not None:
        moved = later.surface + np.uint32(len(earlier.surfaces))
        later = replace(later, surface=np.where(later.surface == NO_SURFACE, NO_SURFACE, moved))
    firings = Firings(
        index=earlier.firings.index,
        beam_axis=None,
        **concatenate(earlier.firings, later.firings, _BY_SEQUENCE),
    )
    return Returns(firings, mode=earlier.mode, **concatenate(earlier, later, (*_BY_RETURN, "surfaces")))


def _count(returns: Returns) -> int:
    return len(returns.distance_m)
