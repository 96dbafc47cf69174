"""Rotor of a spinning head: its true angle over time, and its encoder's readings.

Sources of the measured constants: the laws `encoder` and `motor` of `laws.toml`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Self

import numpy as np

from vlp16emu.elementary import cos, sin
from vlp16emu.kernels.compiler import array_kernel, kernel
from vlp16emu.random import Purpose, normal, normal_at, uniform, uniform_at
from vlp16emu.sensor.laws import law, span
from vlp16emu.sensor.settings import Lidar
from vlp16emu.sensor.steps import NEVER, Spans
from vlp16emu.trig import cos_sin
from vlp16emu.types import F8, I8
from vlp16emu.units import S_NS

_TICK_NS = int(law("encoder.tick_ns"))
_TICK_PHASE_NS = span("encoder.tick_phase_ns")
_CDEG_PER_LASER = 6.0 * 2.304e-4  # hundredths of a degree in 2.304 us, the period of a firing, at 1 rpm
_SPEEDS_CDEG = np.array(span("encoder.speeds_cdeg"))
_RATE_ERROR = 0.2464  # deficit of 5/8 of a hundredth of a degree in 2.304 us relative to 600 rpm
_SLOW_SHARES = span("encoder.slow_shares")
_SLOW = sum(_SLOW_SHARES) / len(_SLOW_SHARES)
_HALF_WIDTH = math.sqrt(3.0)  # half-width of a uniform distribution, in standard deviations
_LINE_GAP_DEG = 1e-5  # least distance of a reading from the next line
_KNOT_BITS = 20  # a swing is linear between multiples of 2**20 ns, 1 ms
PULL = 0.05  # relative change of the speed while the rotor is pulled into its phase (assumption)
Sine = tuple[float, float]  # amplitude and phase, in degrees; no error if the amplitude is 0


@dataclass(frozen=True, slots=True)
class Spin:
    """The rotor after an instant, at constant speed or at constant acceleration."""

    from_ns: int  # since the start
    angle_deg: float  # true angle at that instant
    rpm: float  # speed at that instant; an integer if it stays constant
    rpm_per_s: float = 0.0  # change of speed

    def at(self, elapsed_ns: I8) -> F8:
        """Return true angles (n,), [0, 360), at times since the start (n,)."""
        since_ns = elapsed_ns - self.from_ns
        out = np.empty(elapsed_ns.shape)
        if self.rpm_per_s:
            since_s = since_ns / S_NS
            out[:] = self.angle_deg + 6.0 * since_s * (self.rpm + 0.5 * self.rpm_per_s * since_s)
            return np.asarray(out % 360.0)
        # Only the time since the last whole turn on a whole second counts, so no error grows with time.
        rpm = round(self.rpm)
        per_minute = math.gcd(rpm, 60)
        span_ns = 60 // per_minute * S_NS
        turns = rpm // per_minute
        _turn(since_ns, span_ns, turns * 360.0 / span_ns, self.angle_deg, out)
        return out

    def rpm_at(self, elapsed_ns: int) -> float:
        """Return the speed at a time since the start, in rpm."""
        return self.rpm + self.rpm_per_s * (elapsed_ns - self.from_ns) / S_NS


@dataclass(frozen=True, slots=True)
class Swing:
    """A sinusoidal lead of the motor over its set speed, as a time; it stops with the motor."""

    amplitude_ns: float
    period_ns: float
    phase_rad: float

    def rate_at(self, elapsed_ns: int) -> float:
        """Return the speed that the swing adds at a time since the start, as a share of the set speed."""
        per_ns = 2.0 * math.pi / self.period_ns
        return self.amplitude_ns * per_ns * cos(per_ns * elapsed_ns + self.phase_rad)

    @classmethod
    def sample(
        cls, seed: int, error_rpm: float, wander_rpm: float, *, is_exact: bool = False
    ) -> "tuple[Swing, ...]":
        """Sample the swings of one unit at 600 rpm.

        One changes the mean speed over minutes, two change it within seconds, and one within a turn.

        Parameters
        ----------
        is_exact : True if the error of the mean speed at the start is exactly `error_rpm`; else this is one
            sigma
        """
        draws = uniform(seed, Purpose.MOTOR_SPEED, 0, 11)
        limit = law("motor.most_sigmas")
        sigmas = np.clip(normal(seed, Purpose.MOTOR_SPEED, 0, 1, 1), -limit, limit)
        sigma = 1.0 if is_exact else float(sigmas[0])
        phase_rad = 0.0 if is_exact else (draws[1] - 0.5) * 0.5
        shortest_s, longest_s = span("motor.drift_s")
        short_s, long_s, shorter_s, longer_s = span("motor.wander_s")
        few, many = span("motor.ripple_per_turn")
        least, greatest = span("motor.ripple_deg_per_rpm")
        ripple_s = 0.1 / (few + (many - few) * draws[8])
        ripple_deg_per_rpm = least + (greatest - least) * draws[9] * draws[9]
        wanted = (
            (error_rpm * sigma, shortest_s + (longest_s - shortest_s) * draws[0], phase_rad),
            (wander_rpm * 2.0 * draws[2], short_s + (long_s - short_s) * draws[3], 2.0 * math.pi * draws[4]),
            (
                wander_rpm * 2.0 * draws[5],
                shorter_s + (longer_s - shorter_s) * draws[6],
                2.0 * math.pi * draws[7],
            ),
            (
                wander_rpm * ripple_deg_per_rpm * math.pi / (3.0 * ripple_s),
                ripple_s,
                2.0 * math.pi * draws[10],
            ),
        )
        return tuple(
            cls(rpm / 600.0 * period_s * S_NS / (2.0 * math.pi), period_s * S_NS, float(at_start_rad))
            for rpm, period_s, at_start_rad in wanted
            if rpm
        )


@dataclass(frozen=True, slots=True)
class Wobble:
    """A sinusoidal change of the rotor speed, for a time."""

    from_ns: int  # since the start
    lasts_ns: int
    amplitude_rpm: float
    period_s: float

    def ahead_deg(self, elapsed_ns: I8) -> F8:
        """Return the lead (n,) of the rotor over a constant rotation, as angles."""
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
class Encoder:
    """Encoder of one unit: it reads the true angle with periodic errors and white noise.

    On real units the steps between blocks have a lag-1 autocorrelation near -0.5: the noise belongs to the
    reading and not to the speed. Between two lines of an encoder the reading advances at one of two speeds,
    one too low and one too high.
    """

    seed: int
    once: Sine = (0.0, 0.0)  # error once per revolution; it crosses zero upwards at the angle of its phase
    twice: Sine = (0.0, 0.0)  # error twice per revolution
    hum_deg: float = 0.0  # half the height of the sawtooth from sampling at ticks of a clock, at 600 rpm
    tick_ns: int = int(_TICK_PHASE_NS[0])  # phase of this clock in the sensor's stamp
    noise_deg: float = 0.0  # white error of each reading, one sigma; with lines at 600 rpm. 0 switches it off
    noise_limit_deg: float = math.inf  # limit of the white error of an encoder without lines
    pitch_deg: float = 0.0  # spacing of the lines; 0 for an encoder without lines
    rate_error: float = 0.0  # relative deficit of the lower speed at 600 rpm; in proportion at other speeds
    first_deg: float = 0.0  # reading of the line after which readings have the first of `slow_shares`
    slow_shares: Sequence[float] = _SLOW_SHARES
    """Shares of readings at the lower speed after consecutive lines."""

    @classmethod
    def of_unit(cls, section: Lidar, seed: int) -> Self:
        """Sample the encoder of one unit; with `rotation_spread` also its unit-to-unit deviations."""
        spread = section.rotation_spread
        draws = uniform(seed, Purpose.AZIMUTH_PATTERN, 0, 12)
        shares = np.array(_SLOW_SHARES)
        width = spread * law("encoder.slow_share_spread")
        factor = 1.0 + spread * (2.0 * draws[:3] - 1.0)
        turned_deg = 360.0 * draws[3:6] * (spread > 0.0)
        return cls(
            seed=seed,
            once=(
                section.eccentricity_deg * factor[0],
                (section.eccentricity_phase_deg + turned_deg[0]) % 360.0,
            ),
            twice=(section.twice_per_turn_deg * factor[1], turned_deg[1]),
            hum_deg=section.hum_deg * (1.0 + 0.1 * (factor[2] - 1.0)),
            tick_ns=int(_TICK_PHASE_NS[int(spread > 0.0 and draws[5] < 0.2)]),
            noise_deg=section.azimuth_noise_deg,
            noise_limit_deg=0.1,  # so that readings of an encoder without lines never go back (assumption)
            pitch_deg=law("encoder.pitch_deg") * (section.preset == "unit"),
            rate_error=section.encoder_rate_error,
            first_deg=math.floor(20.0 * draws[6]) / 100,
            slow_shares=(shares + width * shares * (1.0 - shares) * (draws[8:] - 0.5)).tolist(),
        )

    @property
    def limit_deg(self) -> float:
        """Limit of reading minus true angle at up to 3000 rpm; no normal number exceeds 9."""
        return self.once[0] + self.twice[0] + self.pitch_deg + 9.0 * (self.hum_deg + self.noise_deg)

    def read(self, angle_deg: F8, sequence: I8, clock_ns: I8, rpm: F8 | float) -> F8:
        """Return readings (k,), [0, 360), at true angles (k,) of firing sequences (k,).

        Parameters
        ----------
        clock_ns : (k,) the sensor's clock at these instants; its ticks sample the encoder
        rpm : (k,) speeds, or one for all
        """
        reading = _with_sine(angle_deg, angle_deg - self.once[1], self.once[0])
        reading = _with_sine(reading, 2.0 * reading - self.twice[1], self.twice[0])
        if self.hum_deg:
            since_tick = (clock_ns - self.tick_ns) % _TICK_NS / _TICK_NS
            reading = reading + self.hum_deg * rpm / 600.0 * (1.0 - 2.0 * since_tick)
        if self.pitch_deg:
            return self._between_lines(reading, sequence, rpm) % 360.0
        if self.noise_deg:
            drawn_deg = self.noise_deg * normal_at(self.seed, Purpose.AZIMUTH_READING, sequence)
            reading = reading + np.clip(drawn_deg, -self.noise_limit_deg, self.noise_limit_deg)
        return np.asarray(reading % 360.0)

    def _between_lines(self, angle_deg: F8, sequence: I8, rpm: F8 | float) -> F8:
        # The white error is here a uniform time error of the detection of a line.
        early = 2.0 * uniform_at(self.seed, Purpose.AZIMUTH_READING, sequence) - 1.0
        angle_deg = angle_deg + _HALF_WIDTH * self.noise_deg * rpm / 600.0 * early
        line, since_deg = np.divmod(angle_deg - self.first_deg, self.pitch_deg)
        slow, fast, slow_share = _speeds(rpm) if isinstance(rpm, np.ndarray) else _constant_speeds(rpm)
        # The four lines keep their order: all shares fall to 0, or rise to 1, with their mean.
        share = np.take(self.slow_shares, line.astype(int) % len(self.slow_shares))
        share = np.where(
            slow_share < _SLOW,
            share * slow_share / _SLOW,
            1.0 - (1.0 - share) * (1.0 - slow_share) / (1.0 - _SLOW),
        )
        is_slow = uniform_at(self.seed, Purpose.AZIMUTH_READING, sequence, 1) < share
        rate = 1.0 + self.rate_error / _RATE_ERROR * (np.where(is_slow, slow, fast) - 1.0)
        return np.asarray(
            angle_deg - since_deg + np.minimum(since_deg * rate, self.pitch_deg - _LINE_GAP_DEG)
        )


def _speeds(rpm: F8) -> tuple[F8, F8, F8]:
    """Return the two speeds of a reading between lines over the true speed, and the share of the slower.

    All have the shape of `rpm`.
    """
    true_cdeg = _CDEG_PER_LASER * np.maximum(np.abs(rpm), 1.0)
    factor = np.where(np.abs(rpm) < law("encoder.leads_from_rpm"), law("encoder.lag"), law("encoder.lead"))
    mean_cdeg = true_cdeg * factor
    faster = np.clip(np.searchsorted(_SPEEDS_CDEG, mean_cdeg), 1, len(_SPEEDS_CDEG) - 1)
    low, high = _SPEEDS_CDEG[faster - 1], _SPEEDS_CDEG[faster]
    return low / true_cdeg, high / true_cdeg, np.clip((high - mean_cdeg) / (high - low), 0.0, 1.0)


@cache
def _constant_speeds(rpm: float) -> tuple[F8, F8, F8]:
    return _speeds(np.asarray(rpm))


@dataclass(frozen=True)
class Rotor:
    """Motor of a head: it turns clockwise, seen from above, at constant speed but for swings and events.

    The true angle is a function of time alone.
    """

    spins: tuple[Spin, ...]  # spins in order of time; the first begins at the start
    encoder: Encoder
    wobbles: tuple[Wobble, ...] = ()
    swings: tuple[Swing, ...] = ()
    drift: Swing | None = None  # error of the mean speed over minutes, which a phase lock removes
    locks_ns: Spans = NEVER  # spans since the start with phase lock

    @property
    def rpm(self) -> float:
        """Speed at the start."""
        return self.spins[0].rpm

    @cached_property
    def turns_ns(self) -> I8:
        """Times since the start (n,) at which spins follow each other."""
        return np.array([spin.from_ns for spin in self.spins[1:]], np.int64)

    @cached_property
    def _spin_table(self) -> F8:
        """Begin, speed and change of speed of each spin (n, 3)."""
        return np.array([(spin.from_ns, spin.rpm, spin.rpm_per_s) for spin in self.spins])

    def angle_deg(self, elapsed_ns: I8) -> F8:
        """Return true angles, [0, 360), at times since the start, any shape.

        They are exact after any number of hours.
        """
        flat_ns = elapsed_ns.reshape(-1)
        if self.drift and self.locks_ns.spans:
            flat_ns = steady_ns(self.swings, flat_ns) + self._drift_ns(self.drift, flat_ns)
        else:
            flat_ns = steady_ns((self.drift, *self.swings) if self.drift else self.swings, flat_ns)
        if len(self.spins) == 1:
            out = self.spins[0].at(flat_ns)
        else:
            out = np.empty(len(flat_ns))
            spin_of = np.searchsorted(self.turns_ns, flat_ns, side="right")
            for number in np.unique(spin_of).tolist():
                out[spin_of == number] = self.spins[number].at(flat_ns[spin_of == number])
        for wobble in self.wobbles:
            out = (out + wobble.ahead_deg(flat_ns)) % 360.0
        return out.reshape(elapsed_ns.shape)

    @cached_property
    def _pulls(self) -> tuple[I8, I8, I8, I8]:
        """Begin and end of each lock, the motor's lead at its begin, and the lead removed until its end."""
        assert self.drift is not None
        bounds_ns = np.array(self.locks_ns.spans)
        ahead_ns = steady_ns((self.drift,), bounds_ns.reshape(-1)) - bounds_ns.reshape(-1)
        removed_ns = [0]
        at_begin_ns = list[int]()
        for (begin_ns, end_ns), ahead in zip(
            bounds_ns.tolist(), ahead_ns.reshape(-1, 2).tolist(), strict=True
        ):
            before_ns, after_ns = (ns - removed_ns[-1] for ns in ahead)
            at_end = max(1.0 - PULL * (end_ns - begin_ns) / max(abs(before_ns), 1), 0.0)
            at_begin_ns.append(before_ns)
            removed_ns.append(removed_ns[-1] + after_ns - round(before_ns * at_end))
        begins_ns, ends_ns = bounds_ns.T
        return begins_ns, ends_ns, np.array(at_begin_ns), np.array(removed_ns)

    def _drift_ns(self, drift: Swing, elapsed_ns: I8) -> I8:
        """Return the lead (n,) of the motor, in ns, by the error of its mean speed; a lock pulls it to 0."""
        begins_ns, ends_ns, at_begin_ns, removed_ns = self._pulls
        begun = np.searchsorted(begins_ns, elapsed_ns, side="right")
        latest = np.maximum(begun - 1, 0)
        before_ns = at_begin_ns[latest]
        left = 1.0 - PULL * (elapsed_ns - begins_ns[latest]) / np.maximum(np.abs(before_ns), 1)
        pulled_ns = np.rint(before_ns * np.clip(left, 0.0, 1.0)).astype(np.int64)
        free_ns = steady_ns((drift,), elapsed_ns) - elapsed_ns - removed_ns[begun]
        return np.where((begun > 0) & (elapsed_ns < ends_ns[latest]), pulled_ns, free_ns)

    def read(self, angle_deg: F8, elapsed_ns: I8, sequence: I8, clock_ns: I8) -> F8:
        """Return encoder readings (k,), [0, 360), at true angles (k,) of firing sequences (k,).

        Parameters
        ----------
        elapsed_ns : (k,) times since the start
        clock_ns : (k,) the sensor's clock
        """
        rpm: F8 | float = self.spins[0].rpm
        if len(self.spins) > 1:
            spin_of = np.searchsorted(self.turns_ns, elapsed_ns, side="right")
            begin_ns, begin_rpm, per_s = self._spin_table[spin_of].T
            rpm = begin_rpm + per_s * (elapsed_ns - begin_ns) / S_NS
        return self.encoder.read(angle_deg, sequence, clock_ns, rpm)

    def revolutions(self, elapsed_ns: int) -> float:
        """Return the turns from the start to a time; a wobble adds none, as it returns to zero."""
        stops_ns = [*(spin.from_ns for spin in self.spins[1:]), elapsed_ns]
        turns = 0.0
        for spin, next_ns in zip(self.spins, stops_ns, strict=True):
            stop_ns = min(next_ns, elapsed_ns)
            if stop_ns > spin.from_ns:
                turns += (spin.rpm + spin.rpm_at(stop_ns)) / 2 * (stop_ns - spin.from_ns) / (60 * S_NS)
        return turns

    def rpm_at(self, elapsed_ns: int) -> float:
        """Return the speed at a time since the start, in rpm."""
        spin = self.spins[int(np.searchsorted(self.turns_ns, elapsed_ns, side="right"))]
        rate = 1.0 + sum(swing.rate_at(elapsed_ns) for swing in self.swings)
        if self.drift and not self.locks_ns.at(elapsed_ns):
            rate += self.drift.rate_at(elapsed_ns)
        return spin.rpm_at(elapsed_ns) * rate + sum(wobble.rpm_at(elapsed_ns) for wobble in self.wobbles)


def steady_ns(swings: Sequence[Swing], elapsed_ns: I8) -> I8:
    """Return times (n,) at which a motor of constant speed has the angles of a motor with swings."""
    if not swings:
        return elapsed_ns
    return _steady_ns(elapsed_ns, *np.array([(s.amplitude_ns, s.period_ns, s.phase_rad) for s in swings]).T)


@kernel
def _turn(elapsed_ns: I8, span_ns: int, deg_per_ns: float, start_deg: float, out: F8) -> None:
    """Fill angles (n,) of a constant speed.

    The remainder is exact, as with `%`, because whole turns and their differences are exact.
    """
    for i in range(out.shape[0]):
        angle_deg = start_deg + (elapsed_ns[i] % span_ns) * deg_per_ns
        angle_deg -= 360.0 * math.floor(angle_deg / 360.0)
        out[i] = angle_deg + 360.0 if angle_deg < 0.0 else angle_deg


@array_kernel
def _steady_ns(elapsed_ns: I8, amplitude_ns: F8, period_ns: F8, phase_rad: F8) -> I8:
    """Return times (n,) as `steady_ns`; 0 stays 0."""
    out = np.empty_like(elapsed_ns)
    last = np.int64(np.iinfo(np.int64).min)
    at_ns = 0.0
    further_ns = 0.0
    for i in range(elapsed_ns.shape[0]):
        knot = elapsed_ns[i] >> _KNOT_BITS
        if knot != last:
            at_ns = further_ns = 0.0
            for s in range(amplitude_ns.shape[0]):
                per_knot = 2.0 * math.pi / period_ns[s] * 2**_KNOT_BITS
                zero = cos_sin(phase_rad[s])[1]
                at_ns += amplitude_ns[s] * (cos_sin(per_knot * knot + phase_rad[s])[1] - zero)
                further_ns += amplitude_ns[s] * (cos_sin(per_knot * (knot + 1) + phase_rad[s])[1] - zero)
            last = knot
        fraction = (elapsed_ns[i] - (knot << _KNOT_BITS)) * 2.0**-_KNOT_BITS
        out[i] = elapsed_ns[i] + np.int64(np.rint(at_ns + fraction * (further_ns - at_ns)))
    return out


@array_kernel
def _with_sine(reading_deg: F8, phase_deg: F8, amplitude_deg: float) -> F8:
    if amplitude_deg == 0.0:
        return reading_deg
    out = np.empty_like(reading_deg)
    for i in range(reading_deg.size):
        out[i] = reading_deg[i] + amplitude_deg * cos_sin(math.radians(phase_deg[i]))[1]
    return out
