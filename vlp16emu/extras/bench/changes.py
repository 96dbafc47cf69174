"""Effects of events on the state of a sensor: operation, GPS input, clock, rotor and optics."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from heapq import heappop, heappush
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from vlp16emu.engine import GpsInput, SensorState
from vlp16emu.extras.bench.events import Event
from vlp16emu.scenario import Scenario
from vlp16emu.sensor.clock import ClockEvent
from vlp16emu.sensor.operation import Operation
from vlp16emu.sensor.rotor import Wobble
from vlp16emu.sensor.steps import Span, Spans, Steps
from vlp16emu.types import Firings, Hits, Returns
from vlp16emu.units import FOREVER_NS, S_NS, seconds_to_ns


@dataclass(frozen=True, slots=True)
class DisturbedOptics:
    """Dead lasers and dirty sectors of the window, over time."""

    events: Sequence[
        tuple[int, int, Event]
    ]  # begin and end since the first pulse of events with the effect `optics`
    start_ns: int  # UTC of the first pulse

    def dim(self, firings: Firings, hits: Hits) -> Hits:
        """Attenuate the light of each pulse by a dirty window, twice, through the cosine of incidence."""
        passes = np.ones(firings.t_ns.shape, np.float32)
        for event, during in self._during("dirty_window", firings):
            begin, end = event.sector_deg
            a = firings.azimuth_deg
            inside = (a >= begin) & (a <= end) if begin <= end else (a >= begin) | (a <= end)
            passes[inside & during] *= event.transmission * event.transmission
        return replace(hits, cos_incidence=hits.cos_incidence * np.repeat(passes, hits.count.reshape(-1)))

    def without_dead_lasers(self, returns: Returns) -> Returns:
        """Remove the returns of dead lasers."""
        for event, during in self._during("dead_laser", returns.firings):
            lost = during[:, event.laser]
            returns.distance_m[lost, event.laser] = 0.0
            returns.reflectivity[lost, event.laser] = 0
        return returns

    def _during(self, kind: str, firings: Firings) -> Iterator[tuple[Event, NDArray[np.bool_]]]:
        """Yield the events of a kind that affect some pulses, and which (n, L)."""
        since_ns = firings.t_ns - self.start_ns
        first_ns = int(since_ns[0, 0])
        last_ns = int(since_ns[-1, -1])
        for begin_ns, end_ns, event in self.events:
            if event.kind == kind and begin_ns <= last_ns and first_ns < end_ns:
                yield event, (since_ns >= begin_ns) & (since_ns < end_ns)


def with_events(state: SensorState, scenario: Scenario, number: int) -> SensorState:
    """Return the state of a unit, from 0, with the events of a scenario applied."""
    events = [event for event in scenario.events if event.unit == number + 1]
    if not events:
        return state
    start_ns = scenario.start_ns
    optics = [(event.begin_ns, event.end_ns, event) for event in events if event.effect == "optics"]
    wobbles = (
        Wobble(event.begin_ns, event.end_ns - event.begin_ns, event.amplitude_rpm, event.period_s)
        for event in events
        if event.kind == "rpm_wobble"
    )
    return SensorState(
        operation=operation_of(state.operation.at(0), events),
        gps=gps_of(state.gps, events, start_ns),
        wobbles=tuple(wobbles),
        clock_events=tuple(_clock_events(events, start_ns)),
        optics=DisturbedOptics(optics, start_ns) if optics else None,
    )


def operation_of(power_up: Operation, events: Iterable[Event]) -> Steps[Operation]:
    """Return the operation of a sensor since the first pulse.

    A setting without power, while the sensor starts, holds from power-up.
    """
    events = list(events)
    off = Spans.union((event.begin_ns, event.end_ns) for event in events if event.effect == "power")
    turns: list[tuple[int, Event | None]] = [(t_ns, None) for span in off for t_ns in span]
    turns += [(event.begin_ns, event) for event in events if event.kind in ("setting", "motor_stop")]
    turns += [(event.end_ns, event) for event in events if event.kind == "motor_stop"]
    now = power_up
    next_settings = power_up.settings
    steps = [(0, power_up)]
    for t_ns, event in sorted((turn for turn in turns if turn[0] < FOREVER_NS), key=itemgetter(0)):
        if event is None and now.is_powered:
            now = replace(now, is_powered=False)
            next_settings = power_up.settings
        elif event is None:
            now = Operation(next_settings)
        elif event.kind == "motor_stop":
            now = replace(now, motor_on=t_ns != event.begin_ns)
        elif now.is_powered:
            now = replace(now, settings=replace(now.settings, **event.settings))
        else:
            next_settings = replace(next_settings, **event.settings)
        steps.append((t_ns, now))
    return Steps(tuple(steps))


def gps_of(gps: GpsInput, events: Iterable[Event], start_ns: int) -> GpsInput:
    """Return the input of a receiver whose pulses and sentences are disturbed by events.

    The sensor may lose its power.
    """

    def spans_of(kind: str) -> Spans:
        return Spans.union(_utc(event, start_ns) for event in events if event.kind == kind)

    events = list(events)
    lost = ((_next_second_ns(begin), _next_second_ns(end)) for begin, end in spans_of("pps_loss"))
    return replace(
        gps,
        off=spans_of("power_cycle"),
        lost=Spans.union(lost),
        missing=spans_of("missing_sentence"),
        void=spans_of("void_sentence"),
        garbled=tuple(
            (*_utc(event, start_ns), event.characters) for event in events if event.kind == "wrong_sentence"
        ),
        late=_delays(
            (*_utc(event, start_ns), seconds_to_ns(event.by_s))
            for event in events
            if event.kind == "late_sentence"
        ),
    )


def _delays(late: Iterable[tuple[int, int, int]]) -> Steps[int]:
    """Return the delay of sentences over time.

    Of the spans (begin, end, delay) that contain an instant, the longest delay counts.
    """
    waiting = sorted(late, reverse=True)
    turns_ns = sorted({turn_ns for begin_ns, end_ns, _ in waiting for turn_ns in (begin_ns, end_ns)})
    steps = [(0, 0)]
    active = list[tuple[int, int]]()  # heap of the delays that have begun, the longest first, and their ends
    for turn_ns in turns_ns:
        while waiting and waiting[-1][0] <= turn_ns:
            _, end_ns, delay_ns = waiting.pop()
            heappush(active, (-delay_ns, end_ns))
        while active and active[0][1] <= turn_ns:
            heappop(active)
        steps.append((turn_ns, -active[0][0] if active else 0))
    return Steps(tuple(steps))


def _clock_events(events: Sequence[Event], start_ns: int) -> Iterator[ClockEvent]:
    for event in events:
        t_ns = start_ns + event.end_ns
        if event.kind == "oscillator":
            yield ClockEvent(t_ns, round(event.offset_us * 1000), event.drift_ppm)
        elif event.kind == "power_cycle":
            yield ClockEvent(t_ns, is_power_up=True)


def _utc(event: Event, start_ns: int) -> Span:
    return start_ns + event.begin_ns, min(start_ns + event.end_ns, FOREVER_NS)


def _next_second_ns(t_ns: int) -> int:
    return -(-t_ns // S_NS) * S_NS
