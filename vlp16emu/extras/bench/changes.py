"""Effects of events on a sensor over time: rotor, clock, optics, GPS input and sent packets."""

import math
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from heapq import heappop, heappush
from itertools import pairwise
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import cos, sin
from vlp16emu.engine import GpsInput, Stretch, Timeline, Unit, clock_at, in_phase_deg
from vlp16emu.extras.bench.events import ALL_AROUND, Event, InForce
from vlp16emu.motion.settings import Gps
from vlp16emu.packets.nmea import rmc
from vlp16emu.random import Purpose, generator
from vlp16emu.scenario import Scenario
from vlp16emu.sensor.beams import SEQUENCE_NS
from vlp16emu.sensor.rotor import PULL, Clock, ClockSpan, Spin
from vlp16emu.sensor.settings import Lidar
from vlp16emu.types import F8, I8, Firings, GnssFix, Hits, PpsState, ReturnMode, Returns
from vlp16emu.units import FOREVER_NS, S_NS, seconds_to_ns


@dataclass(frozen=True, slots=True)
class Wobbling:
    """A sinusoidal change of the rotor speed, for a time."""

    from_ns: int  # since the start
    lasts_ns: int
    amplitude_rpm: float
    period_s: float

    def ahead_deg(self, elapsed_ns: I8) -> F8:
        """Return the angles (n,) by which the rotor is ahead of a constant rotation."""
        since_s = np.clip(elapsed_ns - self.from_ns, 0, self.lasts_ns) / S_NS
        per_s = 2.0 * math.pi / self.period_s
        return np.asarray(6.0 * self.amplitude_rpm / per_s * (1.0 - cos(per_s * since_s)))

    def rpm_at(self, elapsed_ns: int) -> float:
        """Return the speed that the wobble adds, in rpm."""
        since_ns = elapsed_ns - self.from_ns
        if not 0 <= since_ns < self.lasts_ns:
            return 0.0
        return self.amplitude_rpm * sin(2.0 * math.pi * since_ns / S_NS / self.period_s)


@dataclass(frozen=True, slots=True)
class DisturbedOptics:
    """Dead lasers and dirty sectors of the window, over time."""

    events: Sequence[Event]  # events with the effect `optics`
    start_ns: int  # UTC of the first pulse

    def dimmed(self, firings: Firings, hits: Hits) -> Hits:
        """Attenuate the light of each pulse by a dirty window, twice, through the cosine of incidence."""
        passes = np.ones(firings.t_ns.shape, np.float32)
        for event in self.events:
            if event.kind == "dirty_window":
                begin, end = event.sector_deg
                a = firings.azimuth_deg
                inside = (a >= begin) & (a <= end) if begin <= end else (a >= begin) | (a <= end)
                passes[inside & self._during(event, firings)] *= event.transmission * event.transmission
        return replace(hits, cos_incidence=hits.cos_incidence * np.repeat(passes, hits.count.reshape(-1)))

    def received(self, returns: Returns) -> Returns:
        """Remove the returns of dead lasers."""
        for event in self.events:
            if event.kind == "dead_laser":
                lost = self._during(event, returns.firings)[:, event.laser]
                returns.distance_m[lost, event.laser] = 0.0
                returns.reflectivity[lost, event.laser] = 0
        return returns

    def _during(self, event: Event, firings: Firings) -> NDArray[np.bool_]:
        since_ns = firings.t_ns - self.start_ns
        return np.asarray((since_ns >= event.begin_ns) & (since_ns < event.end_ns))


_STALE_NS = 5 * S_NS
"""Time without a sentence after which the sensor behaves as if it never had one (assumption: the window of
the pulse)."""
_PRINTABLE = (
    0x30,
    0x5B,
)  # range of a garbled character: digits, capitals, and the characters between them in ASCII

_Spans = tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class DisturbedGps(GpsInput):
    """A receiver whose pulses and sentences are disturbed by events, on a sensor that may lose its power.

    A sentence is identified by its second and is due `sentence_delay_ns` later.
    """

    pps_window_ns: int  # time for which the pulse must be steady
    requires_valid: bool  # True if sentences of status V do not set the clock
    events: tuple[Event, ...]  # events with the effects `gps` and `power`
    start_ns: int  # UTC of the first laser pulse, from which events count

    @classmethod
    def of(cls, gps: Gps, events: Iterable[Event], start_ns: int) -> "DisturbedGps":
        """Return the input of a sensor with `events`."""
        spans_ns = seconds_to_ns(gps.sentence_delay_s), seconds_to_ns(gps.pps_window_s)
        own = tuple(event for event in events if event.effect in ("gps", "power"))
        return cls(gps.connected, *spans_ns, gps.requires_valid, own, start_ns)

    def spans_ns(self, state: PpsState) -> _Spans:
        """Return the spans of UTC in which the pulse is in a state, in order."""
        turns_ns = [-FOREVER_NS, *sorted(self._edges_ns()), FOREVER_NS]
        return _union(span for span in pairwise(turns_ns) if self.pps_at(span[0]) is state)

    def pps_at(self, t_ns: int) -> PpsState:
        """Return the state of the pulse as the sensor reports it at an instant.

        Pulses are locked if they were steady for the window and their sentences name the second before them;
        a sentence that is garbled, or names another second, is an error (63-9243 Rev D, section 9.3.3 and
        appendix G; the end of a state is an assumption: a state from pulses ends at the first missing edge, a
        state from a sentence at the next sentence, or after 5 s without one).
        """
        edge_ns = t_ns // S_NS * S_NS
        if not self.connected or _span_at(self._lost, edge_ns) or _span_at(self._off, t_ns):
            return PpsState.ABSENT
        steady_ns = [span[1] for spans in (self._lost, self._off) if (span := _before(spans, t_ns))]
        if steady_ns and t_ns < max(steady_ns) + self.pps_window_ns:
            return PpsState.SYNCHRONIZING
        second_ns = self.second_ns(t_ns)
        if second_ns is None or t_ns - self._comes_ns(second_ns) >= _STALE_NS:
            return PpsState.SYNCHRONIZING
        due_ns = second_ns + self.sentence_delay_ns
        if _span_at(self._spans["wrong_sentence"], due_ns) or self._comes_ns(second_ns) >= second_ns + S_NS:
            return PpsState.ERROR
        if self.requires_valid and _span_at(self._spans["void_sentence"], due_ns):
            return PpsState.SYNCHRONIZING
        return PpsState.LOCKED

    def second_ns(self, t_ns: int) -> int | None:
        """Return the whole UTC second that the sentence in the sensor's buffer names at `t_ns`; None if there is no sentence."""
        if not self.connected:
            return None
        second_ns = (t_ns - self.sentence_delay_ns) // S_NS * S_NS
        missing = self._spans["missing_sentence"]
        while (span := _span_at(missing, second_ns + self.sentence_delay_ns)) or self._comes_ns(
            second_ns
        ) > t_ns:
            # The last sentence before the missing ones.
            first_ns = span[0] if span else second_ns + self.sentence_delay_ns
            second_ns = (first_ns - 1 - self.sentence_delay_ns) // S_NS * S_NS
        if (off := _before(self._off, t_ns)) and self._comes_ns(second_ns) < off[1]:
            return None
        return second_ns

    def sentence(self, fix: GnssFix, seed: int) -> bytes:
        """Return the sentence of a fix as the sensor receives it; parameters as in `GpsInput`."""
        text = bytearray(
            rmc(replace(fix, valid=False) if self._events_at("void_sentence", fix.t_ns) else fix)
        )
        for event in self._events_at("wrong_sentence", fix.t_ns):
            random = generator(seed, Purpose.SENTENCE, fix.t_ns // S_NS)
            body = range(len(b"$GPRMC,"), text.index(b"*"))
            for place in random.choice(body, min(event.characters, len(body)), replace=False).tolist():
                others = [code for code in range(*_PRINTABLE) if code != text[place]]
                text[place] = others[int(random.integers(len(others)))]
            summed = np.bitwise_xor.reduce(np.frombuffer(bytes(text[1 : text.index(b"*")]), np.uint8))
            if b"%02X" % int(summed) == text[-4:-2]:  # changes of several characters may cancel
                text[-3] = ord("1") if text[-3] == ord("0") else ord("0")
        return bytes(text)

    @cached_property
    def _spans(self) -> Mapping[str, _Spans]:
        """Spans of UTC of the events of each kind."""
        spans = defaultdict[str, list[tuple[int, int]]](list)
        for event in self.events:
            spans[event.kind].append(self._span_ns(event))
        return defaultdict(tuple, {kind: _union(of_kind) for kind, of_kind in spans.items()})

    @cached_property
    def _off(self) -> _Spans:
        return _union(self._span_ns(event) for event in self.events if event.effect == "power")

    @cached_property
    def _lost(self) -> _Spans:
        """Spans from the first missing pulse to the first pulse that is back."""
        return _union((_ceil(begin_ns), _ceil(end_ns)) for begin_ns, end_ns in self._spans["pps_loss"])

    @cached_property
    def _delays_ns(self) -> tuple[Sequence[int], Sequence[int]]:
        """Instants UTC of the arrival of punctual sentences, and the delay of sentences from each instant on."""
        late = [
            (*self._span_ns(event), seconds_to_ns(event.by_s)) for event in self._events_of("late_sentence")
        ]
        begins = sorted(late)
        turns_ns = sorted({turn_ns for begin_ns, end_ns, _ in late for turn_ns in (begin_ns, end_ns)})
        delays_ns = list[int]()
        active = list[
            tuple[int, int]
        ]()  # heap of the delays that have begun, the longest first, and their ends
        begun = 0
        for turn_ns in turns_ns:
            while begun < len(begins) and begins[begun][0] <= turn_ns:
                heappush(active, (-begins[begun][2], begins[begun][1]))
                begun += 1
            while active and active[0][1] <= turn_ns:
                heappop(active)
            delays_ns.append(-active[0][0] if active else 0)
        return turns_ns, delays_ns

    def _events_of(self, kind: str) -> Iterator[Event]:
        return (event for event in self.events if event.kind == kind)

    def _events_at(self, kind: str, second_ns: int) -> list[Event]:
        """Return the events of a kind that affect the sentence of a second."""
        since_ns = second_ns + self.sentence_delay_ns - self.start_ns
        return [event for event in self._events_of(kind) if event.begin_ns <= since_ns < event.end_ns]

    def _comes_ns(self, second_ns: int) -> int:
        due_ns = second_ns + self.sentence_delay_ns
        turns_ns, delays_ns = self._delays_ns
        place = bisect_right(turns_ns, due_ns)
        return due_ns + (delays_ns[place - 1] if place else 0)

    def _span_ns(self, event: Event) -> tuple[int, int]:
        return self.start_ns + event.begin_ns, min(self.start_ns + event.end_ns, FOREVER_NS)

    def _edges_ns(self) -> set[int]:
        """Return the instants at which the state may change: pulses and sentences near the begin and the end of events."""
        edges_ns = {bound_ns for span in self._off for bound_ns in span}
        edges_ns |= {end_ns + self.pps_window_ns for _, end_ns in (*self._off, *self._lost)}
        seconds = set[int]()
        longest_ns = max(self._delays_ns[1], default=0)
        for event in self.events:
            # A late sentence from before the power is back may be the first that the sensor gets.
            reach_ns = 2 * S_NS + self.sentence_delay_ns + longest_ns * (event.effect == "power")
            for bound_ns in self._span_ns(event):
                if bound_ns < FOREVER_NS:
                    seconds.update(range((bound_ns - reach_ns) // S_NS, (bound_ns + _STALE_NS) // S_NS + 3))
        for second in seconds:
            comes_ns = self._comes_ns(second * S_NS)
            edges_ns |= {second * S_NS, comes_ns, comes_ns + _STALE_NS}
        return edges_ns


def _ceil(t_ns: int) -> int:
    return -(-t_ns // S_NS) * S_NS


def _union(spans: Iterable[tuple[int, int]]) -> _Spans:
    """Return the union of spans in order, without empty ones."""
    out = list[tuple[int, int]]()
    for begin, end in sorted(span for span in spans if span[0] < span[1]):
        if out and begin <= out[-1][1]:
            out[-1] = out[-1][0], max(end, out[-1][1])
        else:
            out.append((begin, end))
    return tuple(out)


def _span_at(spans: _Spans, t_ns: int) -> tuple[int, int] | None:
    """Return the span that contains an instant; None if there is none."""
    place = bisect_right(spans, t_ns, key=itemgetter(0))
    return spans[place - 1] if place and t_ns < spans[place - 1][1] else None


def _before(spans: _Spans, t_ns: int) -> tuple[int, int] | None:
    """Return the last span that is over at an instant; None if there is none."""
    place = bisect_right(spans, t_ns, key=itemgetter(1))
    return spans[place - 1] if place else None


RUN_UP_RPM_S = 300.0  # change of the rotor's speed per second (assumption: the manual has no figure)
_GRID = 24  # firing sequences: settings take effect between packets, in every return mode


def with_events(unit: Unit, scenario: Scenario) -> Unit:
    """Return a unit with the events of a scenario applied."""
    events = [event for event in scenario.events if event.unit == unit.number + 1]
    if not events:
        return unit
    section = unit.section
    start_ns = scenario.start_ns
    gps = DisturbedGps.of(scenario.gps, events, start_ns)
    wobbles = (
        Wobbling(one.begin_ns, one.end_ns - one.begin_ns, one.amplitude_rpm, one.period_s)
        for one in events
        if one.kind == "rpm_wobble"
    )
    rotor = replace(
        unit.head.rotor,
        spins=spins(unit, events, start_ns),
        wobbles=tuple(wobbles),
        locks_ns=locks_ns(InForce.of(section), events),
    )
    head = replace(unit.head, rotor=rotor, clock=Clock(clock_spans(section, events, gps, start_ns)))
    silences_ns = _union((event.begin_ns, event.end_ns) for event in events if event.effect == "power")
    optics = [event for event in events if event.effect == "optics"]
    return replace(
        unit,
        head=head,
        timeline=Timeline(head, spans_of(section, events), silences_ns),
        optics=DisturbedOptics(optics, start_ns) if optics else None,
        gps=gps,
    )


def clock_spans(
    section: Lidar, events: Sequence[Event], gps: DisturbedGps, start_ns: int
) -> tuple[ClockSpan, ...]:
    """Return the spans of the clock: locked to GPS if possible, otherwise free-running from its last reading, or from power-up.

    Pulses without sentences pull the fraction of a second to their edge (63-9243 Rev D, appendix G).

    Parameters
    ----------
    gps : the receiver's pulse and sentences
    start_ns : UTC of the first laser pulse
    """
    power_up_ns = start_ns - seconds_to_ns(section.powered_for_s or 0.0)
    own_ppm = section.clock_error_ppm or 0.0
    ppm = own_ppm
    locked_ns = gps.spans_ns(PpsState.LOCKED)
    pulsed_ns = tuple((_ceil(begin), end) for begin, end in gps.spans_ns(PpsState.SYNCHRONIZING))
    turns: list[tuple[int, Event | None]] = [(t_ns, None) for span in locked_ns + pulsed_ns for t_ns in span]
    turns += [(start_ns + event.end_ns, event) for event in events if event.effect in ("clock", "power")]
    spans = list[ClockSpan]()
    turns = sorted((turn for turn in turns if power_up_ns < turn[0] < FOREVER_NS), key=lambda turn: turn[0])
    for t_ns, event in [(power_up_ns, None), *turns]:
        kind = event.kind if event else None
        if event and kind == "oscillator":
            ppm = own_ppm + event.drift_ppm
        if _span_at(locked_ns, t_ns):
            spans += [] if spans and spans[-1].reading_ns is None else [clock_at(t_ns, section, locked=True)]
            continue
        reading_ns = 0 if not spans or kind == "power_cycle" else int(spans[-1].reading(np.array([t_ns]))[0])
        if event and kind == "oscillator":
            reading_ns += round(event.offset_us * 1000)
        if pulsed := _span_at(pulsed_ns, t_ns):
            reading_ns = t_ns % S_NS + round((reading_ns - t_ns % S_NS) / S_NS) * S_NS
        spans.append(ClockSpan(t_ns, reading_ns, 0.0 if pulsed else ppm))
    return tuple(spans)


def spins(unit: Unit, events: Sequence[Event], start_ns: int) -> tuple[Spin, ...]:
    """Return the motion of the rotor: constant speed, changes to another speed, and pulls into phase."""
    done = list(unit.head.rotor.spins)
    power_up = InForce.of(unit.section)
    runs = True
    wanted = power_up
    for t_ns, event in _rotor_settings(events):
        before = wanted.rpm, wanted.phase_lock_deg, runs
        is_on = event.kind == "power_cycle"
        if is_on:
            wanted = power_up
            runs = True
        elif event.kind == "motor_stop":
            runs = t_ns != event.begin_ns
        else:
            wanted = wanted.after(event)
        if is_on or (wanted.rpm, wanted.phase_lock_deg, runs) != before:
            while len(done) > 1 and done[-1].from_ns > t_ns:  # drop phases of the motion that have not begun
                done.pop()
            angle_deg = _phase_deg(wanted, start_ns + t_ns)
            on = Spin(t_ns, done[0].angle_deg if angle_deg is None else angle_deg, float(wanted.rpm))
            done += [on] if is_on else _steered(done[-1], t_ns, wanted, start_ns, runs=runs)
    return tuple(done)


def locks_ns(power_up: InForce, events: Sequence[Event]) -> tuple[tuple[int, int], ...]:
    """Return the spans since the first pulse in which the rotor is locked to a phase, or pulled into it."""
    turns = [(0, power_up)]
    for t_ns, event in _rotor_settings(events):
        if event.kind == "power_cycle":
            turns.append((t_ns, power_up))
        elif event.kind == "setting":
            turns.append((t_ns, turns[-1][1].after(event)))
    ends_ns = [t_ns for t_ns, _ in turns[1:]] + [FOREVER_NS]
    spans = zip(turns, ends_ns, strict=True)
    return _union(
        (begin_ns, end_ns) for (begin_ns, wanted), end_ns in spans if wanted.phase_lock_deg != "off"
    )


def _phase_deg(wanted: InForce, utc_ns: int) -> float | None:
    """Return the angle of a rotor that is in phase; None without phase lock."""
    phase_deg = wanted.phase_lock_deg
    return None if phase_deg == "off" else in_phase_deg(phase_deg, wanted.rpm, utc_ns)


def _rotor_settings(events: Sequence[Event]) -> list[tuple[int, Event]]:
    """Return the instants since the first pulse at which the rotor is set, with their events."""
    begins, ends = ("setting", "motor_stop"), ("motor_stop", "power_cycle")
    instants = [
        (t_ns, event)
        for event in events
        for t_ns, kinds in ((event.begin_ns, begins), (event.end_ns, ends))
        if event.kind in kinds and t_ns < FOREVER_NS
    ]
    return sorted(instants, key=itemgetter(0))


def _steered(spin: Spin, t_ns: int, wanted: InForce, start_ns: int, *, runs: bool) -> Iterator[Spin]:
    """Yield the motion of the rotor from its present state to the wanted one, from an instant on."""
    rpm = spin.rpm_at(t_ns)
    target = float(wanted.rpm if runs else 0)
    angle_deg = _angle_deg(spin, t_ns)
    if rpm != target:
        ramp = Spin(t_ns, angle_deg, rpm, math.copysign(RUN_UP_RPM_S, target - rpm))
        yield ramp
        t_ns += round(abs(target - rpm) / RUN_UP_RPM_S * S_NS)
        angle_deg = _angle_deg(ramp, t_ns)
    if target and (phase_deg := _phase_deg(wanted, start_ns + t_ns)) is not None:
        off_deg = (phase_deg - angle_deg + 180.0) % 360.0 - 180.0
        rate_rpm = math.copysign(max(round(PULL * target), 1), off_deg)
        if round(abs(off_deg) / 6.0 / abs(rate_rpm) * S_NS):
            yield Spin(t_ns, angle_deg, target + rate_rpm)
            t_ns += round(abs(off_deg) / 6.0 / abs(rate_rpm) * S_NS)
        angle_deg = _phase_deg(wanted, start_ns + t_ns) or 0.0
    yield Spin(t_ns, angle_deg, target)


def _angle_deg(spin: Spin, t_ns: int) -> float:
    return float(spin.at(np.array([t_ns]))[0])


def spans_of(sensor: Lidar, events: Sequence[Event]) -> tuple[Stretch, ...]:
    """Cut a run at changes of return mode, field of view or laser; spans without packets are left out.

    A change takes effect with the next packet of single return, and begins a packet.
    """
    power_up = sent = InForce.of(sensor)
    changes = [(0, sent)]
    for event in sorted(events, key=lambda event: event.at_s):
        if event.kind == "power_cycle":
            sent = power_up
            off = _sequence(event.begin_ns)
            on = _sequence(event.end_ns)
            changes += [(off, replace(sent, laser=False)), (on, sent)]
        elif event.kind == "setting":
            sent = sent.after(event)
            # A setting during the start of the sensor takes effect when it sends.
            changes.append((max(_sequence(event.begin_ns), changes[-1][0]), sent))
    spans = list[Stretch]()
    stops = [first for first, _ in changes[1:]] + [None]
    for (first, state), stop in zip(changes, stops, strict=True):
        if not state.laser or first == stop:
            continue
        mode = ReturnMode(state.return_mode)
        fov_deg = None if state.fov_deg == ALL_AROUND else state.fov_deg
        last = spans[-1] if spans else None
        if last and last.stop == first and (last.mode, last.fov_deg) == (mode, fov_deg):
            spans[-1] = replace(last, stop=stop)
        else:
            spans.append(Stretch(first, stop, mode, fov_deg))
    return tuple(spans)


def _sequence(since_ns: int) -> int:
    return -(-since_ns // (_GRID * SEQUENCE_NS)) * _GRID
