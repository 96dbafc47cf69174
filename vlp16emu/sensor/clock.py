"""The sensor's clock: locked to GPS, or free-running on its own oscillator."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter

import numpy as np

from vlp16emu.sensor.laws import law
from vlp16emu.sensor.settings import Lidar
from vlp16emu.sensor.steps import Spans, Steps
from vlp16emu.types import I8, PpsState
from vlp16emu.units import FOREVER_NS, HOUR_NS, S_NS

_LEFT_PPM = law("clock.locked_ppm")


@dataclass(frozen=True, slots=True)
class ClockSpan:
    """The sensor's clock after an instant."""

    from_ns: int  # UTC
    reading_ns: int | None = None
    """Reading of a free-running clock at that instant; None if it is locked to GPS."""
    error_ppm: float = 0.0
    """Rate error, positive is fast; a locked clock is fast in one second and slow in the next."""

    def reading(self, t_ns: I8) -> I8:
        """Return ns past the counter's hour at UTC instants of any shape; before the span, the first."""
        if self.reading_ns is None:
            if not self.error_ppm:
                return np.asarray(t_ns % HOUR_NS)
            in_two_s = t_ns % (2 * S_NS)
            ahead = np.rint(np.minimum(in_two_s, 2 * S_NS - in_two_s) * (self.error_ppm * 1e-6)).astype(
                np.int64
            )
            return np.asarray((t_ns + ahead) % HOUR_NS)
        since = np.maximum(t_ns - self.from_ns, 0)
        if self.error_ppm:
            since = since + np.rint(since * (self.error_ppm * 1e-6)).astype(np.int64)
        return np.asarray((self.reading_ns + since) % HOUR_NS)


@dataclass(frozen=True)
class Clock:
    """The sensor's top-of-hour counter.

    Locked to GPS it shows nanoseconds past the UTC hour; without GPS it runs from power-up on its own
    oscillator and rolls over every 3600 s (63-9243 Rev D, appendix G). Before power-up it stays at zero: the
    stamp of a position packet is older than the packet, and can be older than the clock.
    """

    spans: tuple[ClockSpan, ...]  # spans in order of time; the first is valid at all times before the second

    @cached_property
    def _turns_ns(self) -> I8:
        """Instants UTC (n,) at which spans follow each other."""
        return np.array([span.from_ns for span in self.spans[1:]], np.int64)

    def reading_ns(self, t_ns: I8) -> I8:
        """Return nanoseconds past the counter's hour at UTC instants of any shape."""
        if len(self.spans) == 1:
            return self.spans[0].reading(t_ns)
        out = np.empty(t_ns.shape, np.int64)
        span = np.searchsorted(self._turns_ns, t_ns, side="right")
        for number in np.unique(span).tolist():
            out[span == number] = self.spans[number].reading(t_ns[span == number])
        return out


@dataclass(frozen=True, slots=True)
class ClockEvent:
    """A step and a drift of the free-running clock, or a power-up."""

    t_ns: int  # UTC
    offset_ns: int = 0
    drift_ppm: float = 0.0
    is_power_up: bool = False


def clock_of(
    section: Lidar, power_up_ns: int, pps: Steps[PpsState], events: Iterable[ClockEvent] = ()
) -> Clock:
    """Return the clock of a unit: locked to GPS, or free-running from its last reading or power-up.

    Pulses without sentences pull the fraction of a second to their edge (63-9243 Rev D, appendix G).

    Parameters
    ----------
    power_up_ns : UTC of the first power-up
    pps : state of the pulse, by UTC
    """
    own_ppm = section.clock_error_ppm or 0.0
    ppm = own_ppm
    locked_ns = pps.where(lambda state: state is PpsState.LOCKED)
    pulsed_ns = pps.where(lambda state: state is PpsState.SYNCHRONIZING)
    pulsed_ns = Spans(tuple((-(-begin // S_NS) * S_NS, end) for begin, end in pulsed_ns))
    turns: list[tuple[int, ClockEvent | None]] = [
        (t_ns, None) for span in (*locked_ns, *pulsed_ns) for t_ns in span
    ]
    turns += [(event.t_ns, event) for event in events]
    turns = sorted((turn for turn in turns if power_up_ns < turn[0] < FOREVER_NS), key=itemgetter(0))
    spans = list[ClockSpan]()
    for t_ns, event in [(power_up_ns, None), *turns]:
        if event and not event.is_power_up:
            ppm = own_ppm + event.drift_ppm
        if locked_ns.at(t_ns):
            if not spans or spans[-1].reading_ns is not None:
                spans.append(ClockSpan(t_ns, None, min(max(own_ppm, -_LEFT_PPM), _LEFT_PPM)))
            continue
        is_new = not spans or (event is not None and event.is_power_up)
        reading_ns = 0 if is_new else int(spans[-1].reading(np.array([t_ns]))[0])
        if event:
            reading_ns += event.offset_ns
        is_pulsed = pulsed_ns.at(t_ns) is not None
        if is_pulsed:
            reading_ns = t_ns % S_NS + round((reading_ns - t_ns % S_NS) / S_NS) * S_NS
        spans.append(ClockSpan(t_ns, reading_ns, 0.0 if is_pulsed else ppm))
    return Clock(tuple(spans))
