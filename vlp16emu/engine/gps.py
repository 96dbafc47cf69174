"""The GPS receiver on the sensor's serial input and pulse line."""

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self, TypeVar

import numpy as np

from vlp16emu.motion.settings import Gps
from vlp16emu.packets.nmea import rmc
from vlp16emu.random import Purpose, generator
from vlp16emu.scenario.events import (
    Event,
    LastingEvent,
    LateSentence,
    PowerCycle,
    PpsLoss,
    SentenceLoss,
    VoidSentence,
    WrongSentence,
)
from vlp16emu.types import GnssFix, PpsState
from vlp16emu.units import S_NS, seconds_to_ns

_FOREVER_NS = 2**62
_STALE_NS = 5 * S_NS
"""After so long without a sentence the sensor is as one that never had any (assumption: the window of the pulse)."""
_PRINTABLE = (0x30, 0x5B)
"""What a garbled character becomes: digits, capitals, and what is between them in ASCII."""

E = TypeVar("E", bound=LastingEvent)
_Spans = tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True)
class GpsInput:
    """A receiver that has been locked since before the run but for what happens to its line, or none at all.

    All times are UTC in ns. A sentence is known by its second and by when it should come: `sentence_delay_ns` later.
    """

    connected: bool
    sentence_delay_ns: int
    """From the second's edge to the arrival of the sentence that names it."""
    pps_window_ns: int = 5 * S_NS
    """For so long the pulse must be steady."""
    requires_valid: bool = False
    """Whether sentences of status V do not set the clock."""
    events: tuple[Event, ...] = ()
    """What happens to it, and losses of the sensor's power."""
    start_ns: int = 0
    """UTC of the first pulse of a laser, from which events count."""

    @classmethod
    def of(cls, gps: Gps, events: Iterable[Event], start_ns: int) -> Self:
        """Make that of a sensor, to which `events` happen."""
        ours = (PpsLoss, VoidSentence, WrongSentence, LateSentence, SentenceLoss, PowerCycle)
        return cls(
            gps.connected,
            seconds_to_ns(gps.sentence_delay_s),
            seconds_to_ns(gps.pps_window_s),
            gps.requires_valid,
            tuple(event for event in events if isinstance(event, ours)),
            start_ns,
        )

    def spans_ns(self, state: PpsState) -> _Spans:
        """Spans of UTC in which the pulse is in a state, in order."""
        spans, begin_ns = list[tuple[int, int]](), None
        for t_ns in (-_FOREVER_NS, *sorted(set(self._turns_ns())), _FOREVER_NS):
            is_so = t_ns < _FOREVER_NS and self.pps_at(t_ns) is state
            if is_so and begin_ns is None:
                begin_ns = t_ns
            elif not is_so and begin_ns is not None:
                spans.append((begin_ns, t_ns))
                begin_ns = None
        return tuple(spans)

    def pps_at(self, t_ns: int) -> PpsState:
        """State of the pulse as the sensor reports it at an instant.

        Locked are pulses that were steady for the window, with sentences that name the second before them; a sentence
        that is garbled, or names another second, is an error (63-9243 Rev D, section 9.3.3 and appendix G; when a
        state ends is an assumption: that of a pulse with the edge that is missed, that of a sentence with the next one,
        or when none came for 5 s).

        Fixes that trees hide leave it locked: that receivers keep their pulse is an assumption too.
        """
        edge_ns = t_ns // S_NS * S_NS
        if not self.connected or _at(self._lost, edge_ns) or _at(self._off, t_ns):
            return PpsState.ABSENT
        steady_ns = [span[1] for spans in (self._lost, self._off) if (span := _before(spans, t_ns))]
        if steady_ns and t_ns < max(steady_ns) + self.pps_window_ns:
            return PpsState.SYNCHRONIZING
        second_ns = self.second_ns(t_ns)
        if second_ns is None or t_ns - self._comes_ns(second_ns) >= _STALE_NS:
            return PpsState.SYNCHRONIZING
        if self._of(WrongSentence, second_ns) or self._comes_ns(second_ns) >= second_ns + S_NS:
            return PpsState.ERROR
        if self.requires_valid and self._of(VoidSentence, second_ns):
            return PpsState.SYNCHRONIZING
        return PpsState.LOCKED

    def second_ns(self, t_ns: int) -> int | None:
        """Whole UTC second that the sentence in the sensor's buffer names at `t_ns`; None where there is no sentence.

        The sentence names the edge before it, so it is up to a second and the delay old
        (63-9243 Rev D, figure 7-4).
        """
        if not self.connected:
            return None
        second_ns = (t_ns - self.sentence_delay_ns) // S_NS * S_NS
        while (before_ns := self._absent_ns(second_ns, t_ns)) is not None:
            second_ns = (before_ns - 1 - self.sentence_delay_ns) // S_NS * S_NS
        if (off := _before(self._off, t_ns)) and self._comes_ns(second_ns) < off[1]:
            return None
        return second_ns

    def sentence(self, fix: GnssFix, seed: int) -> bytes:
        """Write the sentence of a second as it comes to the sensor.

        Parameters
        ----------
        fix : of the receiver
        seed : of the unit
        """
        if self._of(VoidSentence, fix.t_ns):
            fix = replace(fix, valid=False)
        text = bytearray(rmc(fix))
        for event in self._of(WrongSentence, fix.t_ns):
            random = generator(seed, Purpose.SENTENCE, fix.t_ns // S_NS)
            body = range(len(b"$GPRMC,"), text.index(b"*"))
            for place in random.choice(body, min(event.characters, len(body)), replace=False).tolist():
                others = [code for code in range(*_PRINTABLE) if code != text[place]]
                text[place] = others[int(random.integers(len(others)))]
            if _checksum(text) == text[-4:-2]:  # several characters may cancel each other
                text[-3] = ord("1") if text[-3] == ord("0") else ord("0")
        return bytes(text)

    @property
    def _off(self) -> _Spans:
        """Spans without power."""
        return _merged(
            (begin_ns, begin_ns + seconds_to_ns(event.off_s))
            for event in self.events
            if isinstance(event, PowerCycle)
            for begin_ns in [self._begin_ns(event)]
        )

    @property
    def _lost(self) -> _Spans:
        """Spans from the first pulse that is missing to the first that is there again."""
        return _merged(
            (_ceil(begin_ns), _ceil(end_ns))
            for event in self.events
            if isinstance(event, PpsLoss)
            for begin_ns, end_ns in [self._span_ns(event)]
        )

    def _of(self, kind: type[E], second_ns: int) -> list[E]:
        """Events of a kind that happen to the sentence of a second."""
        due_ns = second_ns + self.sentence_delay_ns
        return [
            event
            for event in self.events
            if isinstance(event, kind) and self._span_ns(event)[0] <= due_ns < self._span_ns(event)[1]
        ]

    def _comes_ns(self, second_ns: int) -> int:
        late_s = max((event.by_s for event in self._of(LateSentence, second_ns)), default=0.0)
        return second_ns + self.sentence_delay_ns + seconds_to_ns(late_s)

    def _absent_ns(self, second_ns: int, t_ns: int) -> int | None:
        if missing := self._of(SentenceLoss, second_ns):
            return min(self._begin_ns(event) for event in missing)
        return second_ns + self.sentence_delay_ns if self._comes_ns(second_ns) > t_ns else None

    def _begin_ns(self, event: Event) -> int:
        return self.start_ns + seconds_to_ns(event.at_s)

    def _span_ns(self, event: LastingEvent) -> tuple[int, int]:
        begin_ns = self._begin_ns(event)
        return begin_ns, _FOREVER_NS if event.duration_s is None else begin_ns + seconds_to_ns(event.duration_s)

    def _turns_ns(self) -> Iterator[int]:
        """Instants at which the state may change: pulses and sentences near the begin and the end of events."""
        late_ns = {0, *(seconds_to_ns(event.by_s) for event in self.events if isinstance(event, LateSentence))}
        bounds_ns = {b for event in self.events if isinstance(event, LastingEvent) for b in self._span_ns(event)}
        bounds_ns |= {b for span in self._off for b in span}
        yield from (b for span in self._off for b in span)
        for _, end_ns in (*self._off, *self._lost):
            yield end_ns + self.pps_window_ns
        for bound_ns in bounds_ns - {_FOREVER_NS}:
            first_ns = bound_ns // S_NS * S_NS - S_NS
            last_ns = bound_ns + max(late_ns) + _STALE_NS + 2 * S_NS
            for edge_ns in range(first_ns, last_ns, S_NS):
                yield edge_ns
                for by_ns in late_ns:
                    comes_ns = edge_ns + self.sentence_delay_ns + by_ns
                    yield from (comes_ns, comes_ns + _STALE_NS)


def _checksum(sentence: bytes | bytearray) -> bytes:
    """Checksum of a sentence, between `$` and `*`."""
    body = bytes(sentence[1 : sentence.index(b"*")])
    return b"%02X" % int(np.bitwise_xor.reduce(np.frombuffer(body, np.uint8)))


def _ceil(t_ns: int) -> int:
    return -(-t_ns // S_NS) * S_NS


def _merged(spans: Iterable[tuple[int, int]]) -> _Spans:
    """Put spans in order, and those that overlap or touch together; empty ones fall away."""
    out = list[tuple[int, int]]()
    for begin, end in sorted(span for span in spans if span[0] < span[1]):
        if out and begin <= out[-1][1]:
            out[-1] = out[-1][0], max(end, out[-1][1])
        else:
            out.append((begin, end))
    return tuple(out)


def _at(spans: Sequence[tuple[int, int]], t_ns: int) -> bool:
    return any(begin <= t_ns < end for begin, end in spans)


def _before(spans: _Spans, t_ns: int) -> tuple[int, int] | None:
    place = bisect_right([end for _, end in spans], t_ns)
    return spans[place - 1] if place else None
