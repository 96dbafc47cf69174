"""What is set on a sensor, and what happens to it, over time: from events to rotor, clock, optics, GPS input and what is sent."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from vlp16emu.engine import Stretch, Timeline, Unit, clock_at, in_phase_deg
from vlp16emu.extras.bench.events import FOREVER_NS, Event
from vlp16emu.extras.bench.gps import DisturbedGps
from vlp16emu.extras.bench.optics import DisturbedOptics
from vlp16emu.scenario import Scenario
from vlp16emu.sensor.beams import SEQUENCE_NS
from vlp16emu.sensor.rotor import Clock, ClockSpan, Spin, Wobbling
from vlp16emu.sensor.settings import FreeSensor, Sensor
from vlp16emu.types import PpsState, ReturnMode
from vlp16emu.units import S_NS, seconds_to_ns

RUN_UP_RPM_S = 300.0
"""Change of the rotor's speed per second (assumption: the manual has no figure)."""
_PULL = 0.05  # share of the speed by which a rotor is faster or slower while it is pulled into its phase (assumption)
_GRID = 24  # firing sequences: settings take effect between packets, in every return mode
ALL_AROUND = (0, 359)


def with_events(unit: Unit, scenario: Scenario) -> Unit:
    """Return a unit to which the events of a scenario happen."""
    events = [event for event in scenario.events if event.unit == unit.number + 1]
    if not events:
        return unit
    section, start_ns = unit.section, scenario.start_ns
    gps = DisturbedGps.of(scenario.gps, events, start_ns)
    wobbles = [event for event in events if event.kind == "rpm_wobble"]
    rotor = replace(
        unit.head.rotor,
        spins=spins(unit, events, start_ns),
        wobbles=tuple(
            Wobbling(event.begin_ns, event.end_ns - event.begin_ns, event.amplitude_rpm, event.period_s)
            for event in wobbles
        ),
    )
    head = replace(unit.head, rotor=rotor, clock=Clock(clock_spans(section, events, gps, start_ns)))
    silences_ns = tuple((event.begin_ns, event.end_ns) for event in events if event.effect == "power")
    optics = [event for event in events if event.effect == "optics"]
    return replace(
        unit,
        head=head,
        timeline=Timeline(head, spans_of(section, events), silences_ns),
        optics=DisturbedOptics(optics, start_ns) if optics else None,
        gps=gps,
    )


def clock_spans(
    section: Sensor | FreeSensor, events: Sequence[Event], gps: DisturbedGps, start_ns: int
) -> tuple[ClockSpan, ...]:
    """Find how the clock runs: locked to GPS if it can be, otherwise free from its last reading, or from power-up.

    Pulses without sentences pull the part below a second to their edge (63-9243 Rev D, appendix G).

    Parameters
    ----------
    gps : the receiver's pulse and sentences
    start_ns : UTC of the first pulse of a laser
    """
    power_up_ns, own_ppm = start_ns - seconds_to_ns(section.powered_for_s or 0.0), section.clock_error_ppm or 0.0
    ppm = own_ppm
    locked_ns = gps.spans_ns(PpsState.LOCKED)
    pulsed_ns = tuple((-(-begin // S_NS) * S_NS, end) for begin, end in gps.spans_ns(PpsState.SYNCHRONIZING))
    turns: list[tuple[int, Event | None]] = [(t_ns, None) for span in locked_ns + pulsed_ns for t_ns in span]
    turns += [(start_ns + event.end_ns, event) for event in events if event.effect in ("clock", "power")]
    spans = list[ClockSpan]()
    turns = sorted((turn for turn in turns if power_up_ns < turn[0] < FOREVER_NS), key=lambda turn: turn[0])
    for t_ns, event in [(power_up_ns, None), *turns]:
        kind = event.kind if event else None
        if event and kind == "oscillator":
            ppm = own_ppm + event.drift_ppm
        if _among(locked_ns, t_ns):
            spans += [] if spans and spans[-1].reading_ns is None else [clock_at(t_ns, section, locked=True)]
            continue
        reading_ns = 0 if not spans or kind == "power_cycle" else _shown(spans[-1], t_ns)
        if event and kind == "oscillator":
            reading_ns += round(event.offset_us * 1000)
        if pulsed := _among(pulsed_ns, t_ns):
            reading_ns = t_ns % S_NS + round((reading_ns - t_ns % S_NS) / S_NS) * S_NS
        spans.append(ClockSpan(t_ns, reading_ns, 0.0 if pulsed else ppm))
    return tuple(spans)


def _among(spans_ns: Sequence[tuple[int, int]], t_ns: int) -> bool:
    return any(begin <= t_ns < end for begin, end in spans_ns)


def _shown(span: ClockSpan, t_ns: int) -> int:
    return int(span.reading(np.array([t_ns]))[0])


@dataclass(frozen=True, slots=True)
class _Wanted:
    """Settings of a rotor in force from an instant on."""

    rpm: int
    phase_deg: float | None
    runs: bool = True

    def in_phase_deg(self, utc_ns: int) -> float:
        assert self.phase_deg is not None
        return in_phase_deg(self.phase_deg, self.rpm, utc_ns)


def spins(unit: Unit, events: Sequence[Event], start_ns: int) -> tuple[Spin, ...]:
    """Find how the rotor turns: held at its speed, run up and down to another, and pulled into phase."""
    section, done = unit.section, list(unit.head.rotor.spins)
    wanted = power_up = _Wanted(section.rpm, section.phase_lock_deg if isinstance(section, Sensor) else None)
    for t_ns, event in _in_order(events):
        before = wanted
        if event.kind == "power_cycle":
            wanted = power_up
        elif event.kind == "motor_stop":
            wanted = replace(wanted, runs=t_ns != event.begin_ns)
        else:
            set_deg, held_deg = event.phase_lock_deg, wanted.phase_deg
            phase_deg = held_deg if set_deg is None else None if set_deg == "off" else set_deg
            wanted = replace(wanted, rpm=event.rpm or wanted.rpm, phase_deg=phase_deg)
        is_on = event.kind == "power_cycle"
        if is_on or wanted != before:
            while len(done) > 1 and done[-1].from_ns > t_ns:  # what it was doing, it does no more
                done.pop()
            free = wanted.phase_deg is None
            angle_deg = done[0].angle_deg if free else wanted.in_phase_deg(start_ns + t_ns)
            done += [Spin(t_ns, angle_deg, float(wanted.rpm))] if is_on else _led(done[-1], t_ns, wanted, start_ns)
    return tuple(done)


def _in_order(events: Sequence[Event]) -> list[tuple[int, Event]]:
    """Instants since the first pulse at which the rotor is set, and by what."""
    begins, ends = ("setting", "motor_stop"), ("motor_stop", "power_cycle")
    instants = [
        (t_ns, event)
        for event in events
        for t_ns, kinds in ((event.begin_ns, begins), (event.end_ns, ends))
        if event.kind in kinds and t_ns < FOREVER_NS
    ]
    return sorted(instants, key=itemgetter(0))


def _led(spin: Spin, t_ns: int, wanted: _Wanted, start_ns: int) -> Iterator[Spin]:
    """Lead the rotor from what it does to what is wanted, from an instant on."""
    rpm, target = spin.rpm_at(t_ns), float(wanted.rpm if wanted.runs else 0)
    angle_deg = _angle_deg(spin, t_ns)
    if rpm != target:
        ramp = Spin(t_ns, angle_deg, rpm, math.copysign(RUN_UP_RPM_S, target - rpm))
        yield ramp
        t_ns += round(abs(target - rpm) / RUN_UP_RPM_S * S_NS)
        angle_deg = _angle_deg(ramp, t_ns)
    if target and wanted.phase_deg is not None:
        off_deg = (wanted.in_phase_deg(start_ns + t_ns) - angle_deg + 180.0) % 360.0 - 180.0
        rate_rpm = math.copysign(max(round(_PULL * target), 1), off_deg)
        if round(abs(off_deg) / 6.0 / abs(rate_rpm) * S_NS):
            yield Spin(t_ns, angle_deg, target + rate_rpm)
            t_ns += round(abs(off_deg) / 6.0 / abs(rate_rpm) * S_NS)
        angle_deg = wanted.in_phase_deg(start_ns + t_ns)
    yield Spin(t_ns, angle_deg, target)


def _angle_deg(spin: Spin, t_ns: int) -> float:
    return float(spin.at(np.array([t_ns]))[0])


@dataclass(frozen=True, slots=True)
class _Sent:
    """Settings of the packets in force from an instant on."""

    mode: ReturnMode
    fov_deg: tuple[int, int] = ALL_AROUND
    laser: bool = True


def spans_of(sensor: Sensor | FreeSensor, events: Sequence[Event]) -> tuple[Stretch, ...]:
    """Cut a run where return mode, field of view or laser change; without spans in which nothing is sent.

    A change takes effect with the next packet of single return, and begins a packet.
    """
    power_up = sent = _Sent(ReturnMode(sensor.return_mode))
    changes = [(0, sent)]
    for event in sorted(events, key=lambda event: event.at_s):
        if event.kind == "power_cycle":
            sent = power_up
            off, on = _sequence(event.begin_ns), _sequence(event.end_ns)
            changes += [(off, replace(sent, laser=False)), (on, sent)]
        elif event.kind == "setting":
            sent = replace(
                sent,
                mode=ReturnMode(event.return_mode or sent.mode),
                fov_deg=event.fov_deg or sent.fov_deg,
                laser=sent.laser if event.laser is None else event.laser,
            )
            # One that is set while the sensor starts takes effect when it sends.
            changes.append((max(_sequence(event.begin_ns), changes[-1][0]), sent))
    spans = list[Stretch]()
    stops = [first for first, _ in changes[1:]] + [None]
    for (first, state), stop in zip(changes, stops, strict=True):
        if not state.laser or first == stop:
            continue
        fov_deg = None if state.fov_deg == ALL_AROUND else state.fov_deg
        last = spans[-1] if spans else None
        if last and last.stop == first and (last.mode, last.fov_deg) == (state.mode, fov_deg):
            spans[-1] = replace(last, stop=stop)
        else:
            spans.append(Stretch(first, stop, state.mode, fov_deg))
    return tuple(spans)


def _sequence(since_ns: int) -> int:
    return -(-since_ns // (_GRID * SEQUENCE_NS)) * _GRID
