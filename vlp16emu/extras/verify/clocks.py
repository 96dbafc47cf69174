"""The clocks of a sensor and of the host that captured its packets, held against each other."""

from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from vlp16emu.captures.datagrams import Datagram
from vlp16emu.extras.verify.calm import CalmRun
from vlp16emu.extras.verify.frames import (
    HOUR_US,
    JITTER_US,
    PAYLOAD_BYTES,
    SENTENCE_OFFSET,
    STAMP_AT,
    Findings,
    Level,
    Rule,
)
from vlp16emu.packets import layout
from vlp16emu.packets.table import wrap_hour
from vlp16emu.types import I8, PacketKind, PpsState
from vlp16emu.units import S_NS, US_NS

_DRIFT_PPM = 150  # clocks of sensors and hosts differed by 2 to 20 ppm; a cheap oscillator may be 100 ppm off
_PPS_AT: int = layout.POSITION_PAYLOAD.fields["pps"][1]  # type: ignore[index]  # it has fields
_GAIN_NS = 2 * S_NS  # a clock that gets pulse and sentence is set within a second
_MOST_GAINS = 64
LEAP_SECOND = b"235960"
"""Time of a leap second in a sentence (NMEA 0183)."""
SILENCE_US = 500_000
"""Longest time without packets, which arrive every 20 ms or faster, also with lasers off; and the difference
between both clocks' steps that a stall of the host does not explain."""
_BACK_US = 20_000  # step back of a clock that goes on, between packets of both kinds
_SOUND_US = 100_000  # difference between the steps of both clocks behind a packet at which one was set


class HostClock:
    """Times of packets by the clock of the host, without the steps by which somebody has set it.

    The host's clock was set where its step from packet to packet differs from that of the sensor's clock,
    which goes on. The duration is by the sensor's clock, and by the host's where the sensor's was set.
    """

    def __init__(self, findings: Findings) -> None:
        self._findings = findings
        self._before: tuple[int, int] | None = None  # capture stamp and time stamp of the last packet, us
        self._doubtful: tuple[PacketKind, Datagram, int, int] | None = None
        """Packet at which the host's clock may have been set, and the steps to it by both clocks, us."""
        self.set_ns = 0  # by which the host's clock was set so far
        self.elapsed_us = 0  # since the first packet

    def follow(self, datagram: Datagram, kind: PacketKind) -> Iterator[tuple[PacketKind, Datagram]]:
        """Yield packets with the stamps of a host's clock that was not set, in the order of the capture.

        A packet at which both clocks differ waits for the next one: a sensor that starts sends an old time
        stamp first.
        """
        steps_us = self._steps_us(datagram, kind)
        is_sound = steps_us is not None and abs(steps_us[0] - steps_us[1]) <= _SOUND_US
        yield from self.rest(is_set=is_sound)
        if steps_us is not None:
            host_us, sensor_us = steps_us
            may_be_set = host_us < 0 or -_BACK_US < sensor_us < SILENCE_US
            if may_be_set and abs(host_us - sensor_us) > SILENCE_US:
                self._doubtful = kind, datagram, host_us, sensor_us
                return
            self._add_step(datagram.number, sensor_us if abs(host_us - sensor_us) <= SILENCE_US else host_us)
        yield kind, self._corrected(datagram)

    def follow_run(self, run: CalmRun) -> CalmRun | None:
        """Return a run as `follow` would yield its packets; None if it is not calm, and nothing is changed.

        In a calm run both clocks make the same steps, none of them a silence.
        """
        if self._before is None or self._doubtful is not None:
            return None
        host_us = run.host_ns // US_NS
        host_steps_us = np.diff(host_us, prepend=self._before[0])
        sensor_steps_us = wrap_hour(np.diff(run.stamp_us, prepend=self._before[1]), HOUR_US)
        if (np.abs(host_steps_us - sensor_steps_us) > SILENCE_US).any() or (
            sensor_steps_us > SILENCE_US
        ).any():
            return None
        self._before = int(host_us[-1]), int(run.stamp_us[-1])
        self.elapsed_us += int(sensor_steps_us.sum())
        if not self.set_ns:
            return run
        datagrams = [self._corrected(each) for each in run.datagrams]
        return run._replace(datagrams=datagrams, host_ns=run.host_ns - self.set_ns)

    def rest(self, *, is_set: bool = False) -> Iterator[tuple[PacketKind, Datagram]]:
        """Yield the packet that waits; `is_set` if the host's clock was set at it."""
        if self._doubtful is None:
            return
        kind, datagram, host_us, sensor_us = self._doubtful
        self._doubtful = None
        step_us = max(sensor_us, 0) if is_set else max(host_us, 0)
        if is_set:
            set_us = host_us - step_us
            self.set_ns += set_us * US_NS
            found = f"capture stamps set by {set_us / 1e6:+.3f} s, while time stamps go on"
            self._findings.add(Rule.HOST_CLOCK, datagram.number, found, "a clock that is not set", Level.NOTE)
        self._add_step(datagram.number, step_us)
        yield kind, self._corrected(datagram)

    def _steps_us(self, datagram: Datagram, kind: PacketKind) -> tuple[int, int] | None:
        """Return the steps to a packet by the host's and the sensor's clock; the latter up to whole hours.

        It is None for the first packet, and for one without a time stamp.
        """
        if len(datagram.payload) != PAYLOAD_BYTES[kind]:
            return None
        stamp_at = STAMP_AT[kind]
        sensor_us = int.from_bytes(datagram.payload[stamp_at : stamp_at + 4], "little")
        host_us = datagram.stamp_ns // US_NS
        before = self._before
        self._before = host_us, sensor_us
        return None if before is None else (host_us - before[0], wrap_hour(sensor_us - before[1], HOUR_US))

    def _add_step(self, number: int, step_us: int) -> None:
        if step_us > SILENCE_US:
            found = f"no packet for {step_us / 1e6:.2f} s before it"
            self._findings.add(Rule.SILENCE, number, found, "data or position packets all the time")
        self.elapsed_us += step_us

    def _corrected(self, datagram: Datagram) -> Datagram:
        if not self.set_ns:
            return datagram
        return datagram._replace(stamp_ns=datagram.stamp_ns - self.set_ns)


class GpsGains:
    """Times at which GPS may set the sensor's clock: leap seconds and rises of its state (appendix G)."""

    def __init__(self) -> None:
        self._state: int | None = None
        self._stamps_ns = deque[int](maxlen=_MOST_GAINS)

    def take(self, datagram: Datagram) -> None:
        """Note the time of a position packet that shows such a time."""
        state = datagram.payload[_PPS_AT]
        is_leap = datagram.payload.startswith(LEAP_SECOND, SENTENCE_OFFSET + len("$GPRMC,"))
        if is_leap or (self._state is not None and self._state < state <= PpsState.LOCKED):
            self._stamps_ns.append(datagram.stamp_ns)
        self._state = state

    def has_new(self, datagrams: Sequence[Datagram]) -> bool:
        """Return True if position packets show another state, or a leap second."""
        states = {each.payload[_PPS_AT] for each in datagrams}
        if states - {self._state}:
            return True
        leap_at = SENTENCE_OFFSET + len("$GPRMC,")
        return any(each.payload.startswith(LEAP_SECOND, leap_at) for each in datagrams)

    def near(self, stamps_ns: I8) -> NDArray[np.bool_]:
        """Return a mask of the capture stamps (n,) near such a time."""
        apart_ns = np.abs(stamps_ns[:, None] - np.array(self._stamps_ns, np.int64))
        return np.asarray((apart_ns < _GAIN_NS).any(axis=1))


class ClockWatch:
    """Monitor of the offset between capture stamps and time stamps of one stream."""

    def __init__(self, findings: Findings) -> None:
        self._findings = findings
        self._reference: tuple[int, int] | None = None

    def restart(self) -> None:
        """Forget the past, because the sensor's clock has been set."""
        self._reference = None

    def check(self, packet: int, stamp_ns: int, offset_us: int) -> None:
        """Compare the offset of a frame with the offset of the first packet.

        The offset is capture stamp minus time stamp.
        """
        if self._reference is None:
            self._reference = stamp_ns, offset_us
            return
        since_ns = abs(stamp_ns - self._reference[0])
        moved_us = wrap_hour(offset_us - self._reference[1], HOUR_US)
        if abs(moved_us) > JITTER_US + since_ns / US_NS * _DRIFT_PPM / 1e6:
            found = f"time stamps {-moved_us / 1e3:+.1f} ms off the capture stamps"
            expected = f"within {JITTER_US / 1e3:.0f} ms and {_DRIFT_PPM} ppm"
            self._findings.add(Rule.CLOCK_DRIFT, packet, found, expected)
            self._reference = stamp_ns, offset_us
