"""What is set on a sensor, and what happens to it, over time: from settings and events to rotor, clock and what is sent."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vlp16emu.engine.gps import GpsInput
from vlp16emu.engine.timeline import Stretch
from vlp16emu.scenario.events import Event, LastingEvent, MotorStop, Oscillator, PowerCycle, Setting, Wobble
from vlp16emu.sensor.beams import SEQUENCE_NS
from vlp16emu.sensor.rotor import ClockSpan, Spin, Wobbling
from vlp16emu.sensor.settings import FreeSensor, Sensor
from vlp16emu.types import PpsState, ReturnMode
from vlp16emu.units import S_NS, seconds_to_ns

RUN_UP_RPM_S = 300.0
"""Change of the rotor's speed per second (assumption: the manual has no figure)."""
_PULL = 0.05
"""Share of the speed by which a rotor is faster or slower while it is pulled into its phase (assumption)."""
_FOREVER_NS = 2**62
_GRID = 24
"""Firing sequences: settings take effect between packets, in every return mode."""
ALL_AROUND = (0, 359)


def end_ns(event: LastingEvent) -> int:
    """End of an event, since the first pulse."""
    if event.duration_s is None:
        return _FOREVER_NS
    return seconds_to_ns(event.at_s + event.duration_s)


def silences_ns(events: Sequence[Event]) -> tuple[tuple[int, int], ...]:
    """Spans of time since the first pulse in which a unit without power, or one that starts, sends nothing."""
    return tuple(
        (seconds_to_ns(event.at_s), seconds_to_ns(event.at_s + event.off_s))
        for event in events
        if isinstance(event, PowerCycle)
    )


def wobbles(events: Sequence[Event]) -> tuple[Wobbling, ...]:
    """Find how the speed is not held."""
    return tuple(
        Wobbling(begin, end_ns(event) - begin, event.amplitude_rpm, event.period_s)
        for event in events
        if isinstance(event, Wobble)
        for begin in [seconds_to_ns(event.at_s)]
    )


def clock_spans(
    section: Sensor | FreeSensor, events: Sequence[Event], gps: GpsInput, start_ns: int
) -> tuple[ClockSpan, ...]:
    """Find how the clock runs: locked to GPS where it can be, otherwise free from where it was, or from power-up.

    Pulses without sentences pull the part below a second to their edge (63-9243 Rev D, appendix G).

    Parameters
    ----------
    gps : the receiver's pulse and sentences
    start_ns : UTC of the first pulse of a laser
    """
    power_up_ns, ppm = start_ns - seconds_to_ns(section.powered_for_s), section.clock_error_ppm
    locked_ns = gps.spans_ns(PpsState.LOCKED)
    pulsed_ns = tuple((-(-begin // S_NS) * S_NS, end) for begin, end in gps.spans_ns(PpsState.SYNCHRONIZING))
    turns: list[tuple[int, Event | None]] = [(t_ns, None) for span in locked_ns + pulsed_ns for t_ns in span]
    turns += [
        (start_ns + seconds_to_ns(event.at_s + getattr(event, "off_s", 0.0)), event)
        for event in events
        if isinstance(event, Oscillator | PowerCycle)
    ]
    spans = list[ClockSpan]()
    turns = sorted((turn for turn in turns if power_up_ns < turn[0] < _FOREVER_NS), key=lambda turn: turn[0])
    for t_ns, event in [(power_up_ns, None), *turns]:
        if isinstance(event, Oscillator):
            ppm = section.clock_error_ppm + event.drift_ppm
        if _among(locked_ns, t_ns):
            spans += [] if spans and spans[-1].reading_ns is None else [ClockSpan(t_ns)]
            continue
        reading_ns = 0 if not spans or isinstance(event, PowerCycle) else _shown(spans[-1], t_ns)
        if isinstance(event, Oscillator):
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
    """What is set on a rotor."""

    rpm: int
    phase_deg: float | None
    runs: bool = True


def spins(section: Sensor | FreeSensor, events: Sequence[Event], start_ns: int) -> tuple[Spin, ...]:
    """Find how the rotor turns: held at its speed, run up and down to another, and pulled into phase."""
    wanted = _Wanted(section.rpm, section.phase_lock_deg if isinstance(section, Sensor) else None)
    power_up = wanted

    def started(t_ns: int) -> Spin:
        free = wanted.phase_deg is None
        angle_deg = section.start_azimuth_deg if free else _in_phase_deg(wanted, start_ns + t_ns)
        return Spin(t_ns, angle_deg, float(wanted.rpm))

    done = [started(0)]
    for t_ns, event in _in_order(events):
        before = wanted
        wanted = _after(event, wanted, power_up, stops=t_ns == seconds_to_ns(event.at_s))
        if isinstance(event, PowerCycle) or wanted != before:
            while len(done) > 1 and done[-1].from_ns > t_ns:  # what it was doing, it does no more
                done.pop()
            is_on = isinstance(event, PowerCycle)
            done += [started(t_ns)] if is_on else _led(done[-1], t_ns, wanted, start_ns)
    return tuple(done)


def _in_order(events: Sequence[Event]) -> Iterator[tuple[int, Event]]:
    """Instants since the first pulse at which the rotor is set, and by what."""
    instants = list[tuple[int, Event]]()
    for event in events:
        if isinstance(event, Setting | MotorStop):
            instants.append((seconds_to_ns(event.at_s), event))
        if isinstance(event, MotorStop) and event.duration_s is not None:
            instants.append((end_ns(event), event))
        if isinstance(event, PowerCycle):
            instants.append((seconds_to_ns(event.at_s + event.off_s), event))
    yield from sorted(instants, key=lambda instant: instant[0])


def _after(event: Event, wanted: _Wanted, power_up: _Wanted, *, stops: bool) -> _Wanted:
    if isinstance(event, PowerCycle):
        return power_up
    if isinstance(event, MotorStop):
        return replace(wanted, runs=not stops)
    assert isinstance(event, Setting)
    phase_deg = wanted.phase_deg
    if event.phase_lock_deg is not None:
        phase_deg = None if event.phase_lock_deg == "off" else event.phase_lock_deg
    return replace(wanted, rpm=event.rpm or wanted.rpm, phase_deg=phase_deg)


def _in_phase_deg(wanted: _Wanted, utc_ns: int) -> float:
    """Angle of a rotor in phase: speeds are multiples of 60 rpm, so there are whole turns in a second."""
    assert wanted.phase_deg is not None
    turned_ns = utc_ns % S_NS * (wanted.rpm // 60) % S_NS
    return (wanted.phase_deg + 360.0 * turned_ns / S_NS) % 360.0


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
        off_deg = (_in_phase_deg(wanted, start_ns + t_ns) - angle_deg + 180.0) % 360.0 - 180.0
        rate_rpm = math.copysign(max(round(_PULL * target), 1), off_deg)
        if round(abs(off_deg) / 6.0 / abs(rate_rpm) * S_NS):
            yield Spin(t_ns, angle_deg, target + rate_rpm)
            t_ns += round(abs(off_deg) / 6.0 / abs(rate_rpm) * S_NS)
        angle_deg = _in_phase_deg(wanted, start_ns + t_ns)
    yield Spin(t_ns, angle_deg, target)


def _angle_deg(spin: Spin, t_ns: int) -> float:
    return float(spin.at(np.array([t_ns]))[0])


@dataclass(frozen=True, slots=True)
class _Sent:
    """What is set on what is sent."""

    mode: ReturnMode
    fov_deg: tuple[int, int] = ALL_AROUND
    laser: bool = True


def spans_of(sensor: Sensor | FreeSensor, events: Sequence[Event]) -> tuple[Stretch, ...]:
    """Cut a run where return mode, field of view or laser change; without spans where nothing is sent.

    A change takes effect with the next packet of single return, and begins a packet.
    """
    power_up = sent = _Sent(ReturnMode(sensor.return_mode))
    changes = [(0, sent)]
    for event in sorted(events, key=lambda event: event.at_s):
        if isinstance(event, PowerCycle):
            sent = power_up
            changes += [
                (_sequence(event.at_s), replace(sent, laser=False)),
                (_sequence(event.at_s + event.off_s), sent),
            ]
        elif isinstance(event, Setting):
            sent = replace(
                sent,
                mode=ReturnMode(event.return_mode or sent.mode),
                fov_deg=event.fov_deg or sent.fov_deg,
                laser=sent.laser if event.laser is None else event.laser,
            )
            # One that is set while the sensor starts takes effect when it sends.
            changes.append((max(_sequence(event.at_s), changes[-1][0]), sent))
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


def _sequence(at_s: float) -> int:
    return -(-seconds_to_ns(at_s) // (_GRID * SEQUENCE_NS)) * _GRID
