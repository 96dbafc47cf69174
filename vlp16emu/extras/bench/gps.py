"""The GPS receiver on the sensor's line, and what happens to that line."""

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from vlp16emu.engine import GpsInput
from vlp16emu.extras.bench.events import FOREVER_NS, Event
from vlp16emu.motion.settings import Gps
from vlp16emu.packets.nmea import rmc
from vlp16emu.random import Purpose, generator
from vlp16emu.types import GnssFix, PpsState
from vlp16emu.units import S_NS, seconds_to_ns

_STALE_NS = 5 * S_NS
"""After so long without a sentence the sensor is as one that never had any (assumption: the window of the pulse)."""
_PRINTABLE = (0x30, 0x5B)  # what a garbled character becomes: digits, capitals, and what is between them in ASCII

_Spans = tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class DisturbedGps(GpsInput):
    """A receiver whose pulses and sentences events disturb, on a sensor that may lose its power.

    A sentence is known by its second and by when it should come: `sentence_delay_ns` later.
    """

    pps_window_ns: int
    """For so long the pulse must be steady."""
    requires_valid: bool
    """Whether sentences of status V do not set the clock."""
    events: tuple[Event, ...]
    """Of the effects `gps` and `power`."""
    start_ns: int
    """UTC of the first pulse of a laser, from which events count."""

    @classmethod
    def of(cls, gps: Gps, events: Iterable[Event], start_ns: int) -> "DisturbedGps":
        """Return the input of a sensor to which `events` happen."""
        return cls(
            gps.connected,
            seconds_to_ns(gps.sentence_delay_s),
            seconds_to_ns(gps.pps_window_s),
            gps.requires_valid,
            tuple(event for event in events if event.effect in ("gps", "power")),
            start_ns,
        )

    def spans_ns(self, state: PpsState) -> _Spans:
        """Spans of UTC in which the pulse is in a state, in order."""
        turns_ns = [-FOREVER_NS, *sorted(set(self._turns_ns())), FOREVER_NS]
        return _merged(span for span in pairwise(turns_ns) if self.pps_at(span[0]) is state)

    def pps_at(self, t_ns: int) -> PpsState:
        """State of the pulse as the sensor reports it at an instant.

        Locked are pulses that were steady for the window, with sentences that name the second before them; a sentence
        that is garbled, or names another second, is an error (63-9243 Rev D, section 9.3.3 and appendix G; when a
        state ends is an assumption: that of a pulse with the edge that is missed, that of a sentence with the next one,
        or when none came for 5 s).
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
        if self._of("wrong_sentence", second_ns) or self._comes_ns(second_ns) >= second_ns + S_NS:
            return PpsState.ERROR
        if self.requires_valid and self._of("void_sentence", second_ns):
            return PpsState.SYNCHRONIZING
        return PpsState.LOCKED

    def second_ns(self, t_ns: int) -> int | None:
        """Return the whole UTC second that the sentence in the sensor's buffer names at `t_ns`; None if there is no sentence."""
        if not self.connected:
            return None
        second_ns = (t_ns - self.sentence_delay_ns) // S_NS * S_NS
        while (before_ns := self._absent_ns(second_ns, t_ns)) is not None:
            second_ns = (before_ns - 1 - self.sentence_delay_ns) // S_NS * S_NS
        if (off := _before(self._off, t_ns)) and self._comes_ns(second_ns) < off[1]:
            return None
        return second_ns

    def sentence(self, fix: GnssFix, seed: int) -> bytes:
        """Sentence of a fix as it reaches the sensor; parameters as of `GpsInput`."""
        text = bytearray(rmc(replace(fix, valid=False) if self._of("void_sentence", fix.t_ns) else fix))
        for event in self._of("wrong_sentence", fix.t_ns):
            random = generator(seed, Purpose.SENTENCE, fix.t_ns // S_NS)
            body = range(len(b"$GPRMC,"), text.index(b"*"))
            for place in random.choice(body, min(event.characters, len(body)), replace=False).tolist():
                others = [code for code in range(*_PRINTABLE) if code != text[place]]
                text[place] = others[int(random.integers(len(others)))]
            summed = np.bitwise_xor.reduce(np.frombuffer(bytes(text[1 : text.index(b"*")]), np.uint8))
            if b"%02X" % int(summed) == text[-4:-2]:  # several characters may cancel each other
                text[-3] = ord("1") if text[-3] == ord("0") else ord("0")
        return bytes(text)

    @property
    def _off(self) -> _Spans:
        """Spans without power."""
        return _merged(self._span_ns(event) for event in self.events if event.effect == "power")

    @property
    def _lost(self) -> _Spans:
        """Spans from the first pulse that is missing to the first that is there again."""
        spans = (self._span_ns(event) for event in self.events if event.kind == "pps_loss")
        return _merged((_ceil(begin_ns), _ceil(end_ns)) for begin_ns, end_ns in spans)

    def _of(self, kind: str, second_ns: int) -> list[Event]:
        """Events of a kind that happen to the sentence of a second."""
        since_ns = second_ns + self.sentence_delay_ns - self.start_ns
        return [event for event in self.events if event.kind == kind and event.begin_ns <= since_ns < event.end_ns]

    def _comes_ns(self, second_ns: int) -> int:
        late_s = max((event.by_s for event in self._of("late_sentence", second_ns)), default=0.0)
        return second_ns + self.sentence_delay_ns + seconds_to_ns(late_s)

    def _absent_ns(self, second_ns: int, t_ns: int) -> int | None:
        if missing := self._of("missing_sentence", second_ns):
            return min(self._span_ns(event)[0] for event in missing)
        return second_ns + self.sentence_delay_ns if self._comes_ns(second_ns) > t_ns else None

    def _span_ns(self, event: Event) -> tuple[int, int]:
        return self.start_ns + event.begin_ns, min(self.start_ns + event.end_ns, FOREVER_NS)

    def _turns_ns(self) -> Iterator[int]:
        """Instants at which the state may change: pulses and sentences near the begin and the end of events."""
        late_ns = {0, *(seconds_to_ns(event.by_s) for event in self.events if event.kind == "late_sentence")}
        bounds_ns = {bound_ns for event in self.events for bound_ns in self._span_ns(event)}
        yield from (bound_ns for span in self._off for bound_ns in span)
        for _, end_ns in (*self._off, *self._lost):
            yield end_ns + self.pps_window_ns
        for bound_ns in bounds_ns - {FOREVER_NS}:
            first_ns = bound_ns // S_NS * S_NS - S_NS
            last_ns = bound_ns + max(late_ns) + _STALE_NS + 2 * S_NS
            for edge_ns in range(first_ns, last_ns, S_NS):
                yield edge_ns
                for by_ns in late_ns:
                    comes_ns = edge_ns + self.sentence_delay_ns + by_ns
                    yield from (comes_ns, comes_ns + _STALE_NS)


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
