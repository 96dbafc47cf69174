"""Effects of events on the state of a sensor: operation, GPS input, clock, rotor and optics."""

from collections import defaultdict
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
from vlp16emu.types import F8, Firings, Hits, Returns
from vlp16emu.units import FOREVER_NS, S_NS, seconds_to_ns


@dataclass(frozen=True, slots=True)
class DisturbedOptics:
    """Dead lasers and dirty sectors of the window, over time."""

    events: Sequence[tuple[int, int, Event]]
    """Begin and end, in ns since the first pulse, of each event with the effect `optics`, and the event."""
    start_ns: int  # UTC of the first pulse
    azimuth_offset_deg: F8  # (L,) azimuth of each beam minus that of the rotor

    def dim(self, firings: Firings, hits: Hits) -> Hits:
        """Attenuate the light of each pulse by a dirty window, twice, through the cosine of incidence."""
        transmission = np.ones(firings.t_ns.shape, np.float32)
        beam_deg = (firings.azimuth_deg + self.azimuth_offset_deg) % 360.0
        for event, is_affected in self._affected_pulses("dirty_window", firings):
            begin_deg, end_deg = event.sector_deg
            is_after = beam_deg >= begin_deg
            is_before = beam_deg <= end_deg
            is_in_sector = is_after & is_before if begin_deg <= end_deg else is_after | is_before
            transmission[is_in_sector & is_affected] *= event.transmission * event.transmission
        of_hits = np.repeat(transmission, hits.count.reshape(-1))
        return replace(hits, cos_incidence=hits.cos_incidence * of_hits)

    def without_dead_lasers(self, returns: Returns) -> Returns:
        """Remove the returns of dead lasers, in place, and return the block."""
        for event, is_affected in self._affected_pulses("dead_laser", returns.firings):
            is_dead = is_affected[:, event.laser]
            returns.distance_m[is_dead, event.laser] = 0.0
            returns.reflectivity[is_dead, event.laser] = 0
        return returns

    def _affected_pulses(self, kind: str, firings: Firings) -> Iterator[tuple[Event, NDArray[np.bool_]]]:
        """Yield the events of a kind that affect some of the pulses, each with a mask (n, L) of them."""
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
    beams = [scenario.sensor, *scenario.rig][number].beam_table()
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
        optics=DisturbedOptics(optics, start_ns, beams.azimuth_offset_deg) if optics else None,
    )


def operation_of(power_up: Operation, events: Iterable[Event]) -> Steps[Operation]:
    """Return the operation of a sensor since the first pulse.

    A setting without power, while the sensor starts, holds from power-up.
    """
    events = list(events)
    off = Spans.union((event.begin_ns, event.end_ns) for event in events if event.effect == "power")
    changes: list[tuple[int, Event | None]] = [(t_ns, None) for span in off for t_ns in span]
    changes += [(event.begin_ns, event) for event in events if event.kind in ("setting", "motor_stop")]
    changes += [(event.end_ns, event) for event in events if event.kind == "motor_stop"]
    operation = power_up
    next_settings = power_up.settings
    steps = [(0, power_up)]
    for t_ns, event in sorted((change for change in changes if change[0] < FOREVER_NS), key=itemgetter(0)):
        if event is None and operation.is_powered:
            operation = replace(operation, is_powered=False)
            next_settings = power_up.settings
        elif event is None:
            operation = Operation(next_settings)
        elif event.kind == "motor_stop":
            operation = replace(operation, motor_on=t_ns != event.begin_ns)
        elif operation.is_powered:
            operation = replace(operation, settings=replace(operation.settings, **event.settings))
        else:
            next_settings = replace(next_settings, **event.settings)
        steps.append((t_ns, operation))
    return Steps(tuple(steps))


def gps_of(gps: GpsInput, events: Iterable[Event], start_ns: int) -> GpsInput:
    """Return the input from a receiver whose pulses and sentences events disturb, or whose sensor is off.

    Parameters
    ----------
    gps : input without events
    start_ns : UTC of the first pulse
    """
    by_kind = defaultdict[str, list[Event]](list)
    for event in events:
        by_kind[event.kind].append(event)

    def spans_of(kind: str) -> Spans:
        """Return the spans of all events of a kind, in UTC ns."""
        return Spans.union(_utc_span(event, start_ns) for event in by_kind[kind])

    lost = ((_next_second_ns(begin), _next_second_ns(end)) for begin, end in spans_of("pps_loss"))
    garbled = ((*_utc_span(event, start_ns), event.characters) for event in by_kind["wrong_sentence"])
    late = ((*_utc_span(event, start_ns), seconds_to_ns(event.by_s)) for event in by_kind["late_sentence"])
    return replace(
        gps,
        off=spans_of("power_cycle"),
        lost=Spans.union(lost),
        missing=spans_of("missing_sentence"),
        void=spans_of("void_sentence"),
        garbled=tuple(garbled),
        late=_delays(late),
    )


def _delays(late: Iterable[tuple[int, int, int]]) -> Steps[int]:
    """Return the delay of sentences over time: the longest of the spans (begin, end, delay) at an instant."""
    waiting = sorted(late, reverse=True)
    changes_ns = sorted({change_ns for begin_ns, end_ns, _ in waiting for change_ns in (begin_ns, end_ns)})
    steps = [(0, 0)]
    active = list[tuple[int, int]]()  # heap of the delays that have begun, the longest first, and their ends
    for change_ns in changes_ns:
        while waiting and waiting[-1][0] <= change_ns:
            _, end_ns, delay_ns = waiting.pop()
            heappush(active, (-delay_ns, end_ns))
        while active and active[0][1] <= change_ns:
            heappop(active)
        steps.append((change_ns, -active[0][0] if active else 0))
    return Steps(tuple(steps))


def _clock_events(events: Sequence[Event], start_ns: int) -> Iterator[ClockEvent]:
    for event in events:
        t_ns = start_ns + event.end_ns
        if event.kind == "oscillator":
            yield ClockEvent(t_ns, round(event.offset_us * 1000), event.drift_ppm)
        elif event.kind == "power_cycle":
            yield ClockEvent(t_ns, is_power_up=True)


def _utc_span(event: Event, start_ns: int) -> Span:
    """Return begin and end of an event, in UTC ns."""
    return start_ns + event.begin_ns, min(start_ns + event.end_ns, FOREVER_NS)


def _next_second_ns(t_ns: int) -> int:
    return -(-t_ns // S_NS) * S_NS
