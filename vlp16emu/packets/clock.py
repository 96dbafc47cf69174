"""UTC of data packets: by the sensor's clock, by the sentences of its GPS receiver, or by the host that captured them.

A packet says when it was fired past an hour that it does not name, on a clock that follows UTC only with lock to GPS.
"""

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vlp16emu.errors import CaptureError, InputError, PacketError
from vlp16emu.packets.capture import Capture, CapturedUnit, Datagram
from vlp16emu.packets.decode import decode_position
from vlp16emu.packets.layout import DATA_BYTES, DATA_PAYLOAD, POSITION_BYTES, RETURN_MODE_BYTE, SEQUENCES_PER_PACKET
from vlp16emu.packets.nmea import rmc_time
from vlp16emu.sensor.beams import SEQUENCE_NS
from vlp16emu.types import PpsState
from vlp16emu.units import HOUR_NS, S_NS, US_NS

_STEADY_NS = S_NS  # steps of the sensor's clock up to this leave its hour alone, whatever the host's clock does
_CLOSE_NS = S_NS  # a clock so close to the host's is taken for one that follows UTC, if no position packet says it
_LOOKED_AT = 10_000  # packets of a unit among which its first position packet is looked for: 7 s in dual return
_PERIOD_NS = {RETURN_MODE_BYTE[mode]: count * SEQUENCE_NS for mode, count in SEQUENCES_PER_PACKET.items()}


class Clock(StrEnum):
    """Source of the time of packets."""

    SENSOR = "sensor"  # The sensor's clock, in the hour that is nearest to the capture's stamp
    GPS = "gps"  # The sensor's clock, in the hour that the first valid sentence of the GPS receiver names
    HOST = "host"
    """The capture's stamp, less the time in which a packet fills: as a ROS driver without `gps_time` sees it."""


class PacketClock:
    """Turns the stamps of the packets of one sensor into UTC, packet by packet in order.

    Parameters
    ----------
    clock : source of the time
    host_behind_ns : by how much capture stamps are behind UTC, as far as the choice of the hour is concerned
    """

    def __init__(self, clock: Clock = Clock.SENSOR, host_behind_ns: int = 0) -> None:
        self.clock, self._host_behind_ns = clock, host_behind_ns
        self._before: tuple[int, int] | None = None
        self.host_ahead_ns: int | None = None
        """Capture stamp of the first packet less its end on the sensor's clock; None before the first one."""

    def sensor_ns(self, stamp_ns: int, timestamp_us: int) -> int:
        """Return UTC of a packet's first pulse by the sensor's clock; the hour is found again after each gap."""
        clock_ns = timestamp_us * US_NS
        near_ns = stamp_ns + self._host_behind_ns
        if self._before is not None:
            stamp_before_ns, before_ns = self._before
            step_ns = (clock_ns - before_ns + HOUR_NS // 2) % HOUR_NS - HOUR_NS // 2
            near_ns = before_ns + (step_ns if abs(step_ns) <= _STEADY_NS else stamp_ns - stamp_before_ns)
        t_ns = clock_ns + round((near_ns - clock_ns) / HOUR_NS) * HOUR_NS
        self._before = stamp_ns, t_ns
        return t_ns

    def packet_ns(self, stamp_ns: int, timestamp_us: int, mode: int) -> tuple[int, int]:
        """Return UTC of a packet's first pulse, by the sensor's clock and by the chosen one; `mode` is its return-mode byte."""
        sensor_ns, fired_ns = self.sensor_ns(stamp_ns, timestamp_us), stamp_ns - _PERIOD_NS.get(mode, 0)
        if self.host_ahead_ns is None:
            self.host_ahead_ns = fired_ns - sensor_ns
        return sensor_ns, fired_ns if self.clock is Clock.HOST else sensor_ns

    def position_ns(self, stamp_ns: int, timestamp_us: int) -> int:
        """Return UTC of a position packet by the chosen clock."""
        return stamp_ns if self.clock is Clock.HOST else self.sensor_ns(stamp_ns, timestamp_us)


class UnitClock(NamedTuple):
    """Clock of a unit, by its first packets."""

    clock: Clock  # The chosen one, or the default: the sensor's if it is locked, else the host's
    locked: bool | None  # State of the pulse per second in the first position packet; None without one
    host_behind_ns: int
    first_ns: int  # UTC of the first data packet by the clock

    def make(self) -> PacketClock:
        """Return a clock for the unit's packets, from the first on."""
        return PacketClock(self.clock, self.host_behind_ns)


def unit_clocks(
    path: Path, units: Sequence[CapturedUnit | None], name: str | None = None, *, where: str = "clock"
) -> list[UnitClock]:
    """Choose the clock of each unit of a capture.

    Parameters
    ----------
    units : None stands for all packets
    name : "sensor", "gps" or "host"; without one the sensor's clock for a unit that is locked to GPS, or that has no position
        packets and is within a second of the host; else the host's, in which everything else of a recording is stamped
    where : how error lines call the choice

    Raises CaptureError if the file is no capture; InputError if there is no such clock, or no valid sentence for "gps".
    """
    if name not in (None, *Clock):
        raise InputError(where, f"found {name}", ", ".join(Clock))
    seen = [_Seen() for _ in units]
    with Capture(path) as capture:
        for datagram in capture:
            for unit, of in zip(units, seen, strict=True):
                if unit is None or unit.owns(datagram):
                    of.take(datagram)
            if all(of.is_known(wants_sentence=name == Clock.GPS) for of in seen):
                break
    return [of.clock(path, name, where) for of in seen]


def packet_clock(
    path: Path, unit: CapturedUnit | None, name: str | None = None, *, where: str = "clock"
) -> PacketClock:
    """Return the clock for the packets of one unit, as `unit_clocks`; by default the sensor's for a pipe, which is read only once."""
    if path.is_fifo() and name != Clock.GPS and (name is None or name in tuple(Clock)):
        return PacketClock(Clock(name or Clock.SENSOR))
    return unit_clocks(path, [unit], name, where=where)[0].make()


class _Seen:
    """First packets of a unit."""

    def __init__(self) -> None:
        self.data: Datagram | None = None
        self.pps: PpsState | None = None
        self.behind_ns: int | None = None
        self.count = 0

    def take(self, datagram: Datagram) -> None:
        self.count += 1
        if len(datagram.payload) == DATA_BYTES:
            self.data = self.data or datagram
        elif len(datagram.payload) == POSITION_BYTES and (self.pps is None or self.behind_ns is None):
            try:
                fields = decode_position(datagram.payload)
                self.pps = fields.pps if self.pps is None else self.pps
                second_ns, valid = rmc_time(fields.sentence)
            except PacketError:
                return
            if second_ns is not None and valid and self.behind_ns is None:
                self.behind_ns = second_ns - datagram.stamp_ns

    def is_known(self, *, wants_sentence: bool) -> bool:
        """Return whether more packets would change nothing."""
        if self.data is None:
            return False
        return self.behind_ns is not None if wants_sentence else self.pps is not None or self.count > _LOOKED_AT

    def clock(self, path: Path, name: str | None, where: str) -> UnitClock:
        locked = None if self.pps is None else self.pps is PpsState.LOCKED
        behind_ns = self.behind_ns or 0 if name == Clock.GPS else 0
        if name == Clock.GPS and self.behind_ns is None:
            raise InputError(where, f"no valid sentence of a GPS receiver in {path}", "sensor or host")
        if self.data is None:
            return UnitClock(Clock(name or Clock.SENSOR), locked, behind_ns, 0)
        fields = np.frombuffer(self.data.payload, DATA_PAYLOAD)[0]
        stamps = self.data.stamp_ns, int(fields["timestamp_us"]), int(fields["return_mode"])
        sensor_ns, host_ns = PacketClock(Clock.HOST, behind_ns).packet_ns(*stamps)
        follows_utc = locked if locked is not None else abs(host_ns - sensor_ns) <= _CLOSE_NS
        clock = Clock(name) if name else Clock.SENSOR if follows_utc else Clock.HOST
        return UnitClock(clock, locked, behind_ns, host_ns if clock is Clock.HOST else sensor_ns)


def check_stamps(path: Path, clocks: Sequence[UnitClock], latest_ns: int) -> None:
    """Refuse a capture whose first packets are before 1970 or after `latest_ns`, which no file format can hold."""
    for of in clocks:
        if not 0 <= of.first_ns <= latest_ns:
            found = f"a first packet at {of.first_ns / S_NS:.3f} s since 1970 by the {of.clock}'s clock"
            raise CaptureError(str(path), found, f"0 to {latest_ns // S_NS} s; --clock chooses another")
