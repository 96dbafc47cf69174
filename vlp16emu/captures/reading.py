"""Captures read back: the UTC of packets, points chunk by chunk, and a summary in numbers.

The time stamp of a packet counts from a full hour that the packet does not name, on a clock that follows UTC
only if it is locked to GPS. So UTC comes from the sensor's clock, the sentences of its GPS receiver, or the
host that captured the packets.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from pathlib import Path
from threading import Event
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from vlp16emu.captures.capture import Capture, CapturedUnit, Datagram
from vlp16emu.elementary import matvec
from vlp16emu.errors import CaptureError, InputError, PacketError
from vlp16emu.packets import layout
from vlp16emu.packets.decode import (
    JUMP_NS,
    SENSOR_R_MANUAL,
    PointFrame,
    Points,
    PositionFields,
    data_fields,
    decode_data,
    decode_position,
    faults_in,
    scan_starts,
)
from vlp16emu.packets.nmea import rmc_time
from vlp16emu.sensor.beams import SEQUENCE_NS
from vlp16emu.types import I8, U1, U2, PpsState, ReturnMode, SensorModel
from vlp16emu.units import HOUR_NS, S_NS, US_NS

_STEADY_NS = S_NS  # up to this step of the sensor's clock its hour is kept, even if the host's clock jumps
_CLOSE_NS = S_NS  # without position packets, a clock this close to the host's is taken as UTC
_LOOKED_AT = (
    10_000  # the first position packet is looked for among this many packets of a unit: 7 s in dual return
)
_PERIOD_NS = {
    layout.RETURN_MODE_BYTE[mode]: count * SEQUENCE_NS for mode, count in layout.SEQUENCES_PER_PACKET.items()
}
_CHUNK = 2_000  # packets decoded at once: 0.8 million records, some 50 MB of points
_BLOCK_RECORDS = 32


class Clock(StrEnum):
    """Time source for packets."""

    SENSOR = "sensor"  # The sensor's clock, in the hour nearest to the capture stamp
    GPS = "gps"  # The sensor's clock, in the hour of the first valid GPS sentence
    HOST = "host"
    """The capture stamp minus the duration of a packet, as a ROS driver without `gps_time` computes it."""


class PacketClock:
    """Converts the packet stamps of one sensor into UTC by a chosen clock, packet by packet in order.

    The hour is chosen as if capture stamps were behind UTC by `host_behind_ns`.
    """

    def __init__(self, clock: Clock = Clock.SENSOR, host_behind_ns: int = 0) -> None:
        self.clock = clock
        self._host_behind_ns = host_behind_ns
        self._before: tuple[int, int] | None = None
        self.host_ahead_ns: int | None = None
        """Capture stamp of the first packet minus its end on the sensor's clock; None before the first
        packet."""

    def sensor_ns(self, stamp_ns: int, timestamp_us: int) -> int:
        """Return UTC of a packet's first pulse by the sensor's clock; after each gap the hour is determined again."""
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
        sensor_ns = self.sensor_ns(stamp_ns, timestamp_us)
        fired_ns = stamp_ns - _PERIOD_NS.get(mode, 0)
        if self.host_ahead_ns is None:
            self.host_ahead_ns = fired_ns - sensor_ns
        return sensor_ns, fired_ns if self.clock is Clock.HOST else sensor_ns

    def position_ns(self, stamp_ns: int, timestamp_us: int) -> int:
        """Return UTC of a position packet by the chosen clock."""
        return stamp_ns if self.clock is Clock.HOST else self.sensor_ns(stamp_ns, timestamp_us)


class UnitClock(NamedTuple):
    """Clock of a unit, chosen from its first packets."""

    clock: Clock  # Chosen by name, or the default: the sensor's clock if it is locked, else the host's
    locked: bool | None  # The first position packet reports a locked pulse per second; None without one
    host_behind_ns: int
    first_ns: int  # UTC of the first data packet by the clock

    def make(self) -> PacketClock:
        """Return a clock for all packets of the unit, from the first."""
        return PacketClock(self.clock, self.host_behind_ns)


def unit_clocks(
    path: Path, units: Sequence[CapturedUnit | None], name: str | None = None, *, where: str = "clock"
) -> list[UnitClock]:
    """Choose the clock of each unit of a capture.

    Parameters
    ----------
    units : None stands for all packets
    name : "sensor", "gps" or "host"; by default the sensor's clock if the unit is locked to GPS, or if it has
        no position
        packets and is within a second of the host; else the host's clock, which stamps everything else of a
        recording
    where : name of the option in error lines

    Raises CaptureError if the file is not a capture; InputError if there is no such clock, or no valid
    sentence for "gps".
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
    """Return the clock for the packets of one unit, as `unit_clocks`; by default a pipe has the sensor's clock.

    Raises InputError for "gps" of a pipe, whose packets cannot be read again after its sentences.
    """
    if path.is_fifo() and name in (None, *Clock):
        if name == Clock.GPS:
            raise InputError(where, f"found gps for the pipe {path}", "sensor or host, or a file")
        return PacketClock(Clock(name or Clock.SENSOR))
    return unit_clocks(path, [unit], name, where=where)[0].make()


class _Seen:
    def __init__(self) -> None:
        self.data: Datagram | None = None
        self.pps: PpsState | None = None
        self.behind_ns: int | None = None
        self.count = 0

    def take(self, datagram: Datagram) -> None:
        self.count += 1
        if len(datagram.payload) == layout.DATA_BYTES:
            self.data = self.data or datagram
        elif len(datagram.payload) == layout.POSITION_BYTES and (self.pps is None or self.behind_ns is None):
            try:
                fields = decode_position(datagram.payload)
                self.pps = fields.pps if self.pps is None else self.pps
                second_ns, valid = rmc_time(fields.sentence)
            except PacketError:
                return
            if second_ns is not None and valid and self.behind_ns is None:
                self.behind_ns = second_ns - datagram.stamp_ns

    def is_known(self, *, wants_sentence: bool) -> bool:
        """Return whether further packets cannot change the choice."""
        if self.data is None:
            return False
        return (
            self.behind_ns is not None if wants_sentence else self.pps is not None or self.count > _LOOKED_AT
        )

    def clock(self, path: Path, name: str | None, where: str) -> UnitClock:
        locked = None if self.pps is None else self.pps is PpsState.LOCKED
        behind_ns = self.behind_ns or 0 if name == Clock.GPS else 0
        if name == Clock.GPS and self.behind_ns is None:
            raise InputError(where, f"no valid sentence of a GPS receiver in {path}", "sensor or host")
        if self.data is None:
            return UnitClock(Clock(name or Clock.SENSOR), locked, behind_ns, 0)
        fields = np.frombuffer(self.data.payload, layout.DATA_PAYLOAD)[0]
        stamps = self.data.stamp_ns, int(fields["timestamp_us"]), int(fields["return_mode"])
        sensor_ns, host_ns = PacketClock(Clock.HOST, behind_ns).packet_ns(*stamps)
        follows_utc = locked if locked is not None else abs(host_ns - sensor_ns) <= _CLOSE_NS
        clock = Clock(name) if name else Clock.SENSOR if follows_utc else Clock.HOST
        return UnitClock(clock, locked, behind_ns, host_ns if clock is Clock.HOST else sensor_ns)


class PacketChunk(NamedTuple):
    """Data packets decoded at once."""

    points: Points  # Without no-returns
    # (n,) sensor's clock of the points, counted from the full hour before the capture, without wrapping
    clock_ns: I8
    packet_ns: I8  # (p,) sensor's clock of the packets' first pulses, counted likewise
    utc_ns: I8  # (p,) UTC of the packets' first pulses, by the reader's clock
    fields: NDArray[np.void]  # (p,) `DATA_PAYLOAD`, the packets themselves
    number: I8  # (p,) frame numbers in the file, from 1

    @property
    def t_ns(self) -> I8:
        """(n,) UTC of the points, by the reader's clock."""
        return self.clock_ns + (self.utc_ns - self.packet_ns)[self.points.packet]

    @property
    def columns(self) -> dict[str, NDArray[np.generic]]:
        """Arrays (n,) of the points by name, and the clock."""
        arrays = {name: getattr(self.points, name) for name in Points.__slots__}
        return {**arrays, "clock_ns": self.clock_ns, "t_ns": self.t_ns}


@dataclass(frozen=True, slots=True)
class Summary:
    """Contents of a capture in numbers."""

    model: SensorModel
    return_mode: str  # One mode, or several with commas if it changes
    rpm: float
    packets: int
    position_packets: int
    other_datagrams: int
    points: int
    no_returns: int
    scans: int  # Revolutions, including the incomplete ones at both ends
    records_per_scan: (
        int | None
    )  # Median of complete revolutions, no-returns included; None without a complete one
    range_m: dict[str, float] | None  # Minimum, median and maximum of the returns; None without returns
    start_utc: str  # Stamp of the first data packet in the capture
    duration_s: float
    """From the first data packet to the last, by the sensor's clock; by the host's if the sensor's jumps."""
    clock: Clock  # Time source of UTC
    host_ahead_s: (
        float  # Capture stamp minus the sensor's clock in the nearest hour, at the first data packet
    )
    gps: dict[str, str] | None  # Pulse and sentence of the last position packet
    cut: bool  # True if the file ends in the middle of a packet
    repeats: int  # Repeated packets that were skipped


class CaptureReader:
    """Reads a capture once, from front to back, and summarizes what it has read. A context manager.

    Parameters
    ----------
    path : as for `Capture`
    unit : the sensor whose packets are read; None for all
    frame : axes of the points
    model : sensor model of prototype units, whose product byte names another sensor
    clock : clock for the UTC of the packets
    passes_over : whether faulty packets are skipped; else the first one ends the reading
    stop : as for `Capture`

    Raises CaptureError if the file is not a capture.
    """

    def __init__(
        self,
        path: Path,
        unit: CapturedUnit | None = None,
        frame: PointFrame = PointFrame.SENSOR,
        model: SensorModel | None = None,
        clock: PacketClock | None = None,
        *,
        passes_over: bool = False,
        stop: Event | None = None,
    ) -> None:
        self.clock = clock or PacketClock()
        self._model = model
        self._passes_over = passes_over
        self._path = path
        self._unit = unit
        self._frame = frame
        self._capture = Capture(path, stop=stop)
        self._codes = np.zeros(2**16, np.int64)
        self._azimuth_cdeg = list[U2]()
        self._packet_ns = list[I8]()
        self._modes = list[U1]()
        self._factory: int | None = None
        self._positions = self._others = self._zero_ns = 0
        self._gps: PositionFields | None = None
        self.first_stamp_ns = 0  # Capture stamp (UTC) of the first data packet; 0 before it is read

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return

    def points(self) -> Iterator[PacketChunk]:
        """Read chunk by chunk; all points before a faulty packet or record are yielded before the error is raised.

        Raises CaptureError if a record is damaged or there is no data packet; PacketError if a packet is not
        from a VLP-16.
        """
        for held in self._chunks():
            payloads = np.frombuffer(b"".join(datagram.payload for datagram in held), np.uint8)
            payloads = payloads.reshape(len(held), layout.DATA_BYTES)
            faults = faults_in(data_fields(payloads), self._factory, self._model)
            sound = np.ones(len(held), np.bool_)
            sound[[fault.packet for fault in faults]] = False
            if faults and not self._passes_over:
                sound[faults[0].packet :] = False
            if sound.any():
                numbers = np.array([(datagram.number, datagram.stamp_ns) for datagram in held])
                yield self._decoded(payloads[sound], *numbers[sound].T)
            # If all packets are faulty the capture is not from this sensor: skipping them would give an empty
            # result.
            if faults and not (self._passes_over and self._azimuth_cdeg):
                where = f"{self._path}: frame {held[faults[0].packet].number}: {faults[0].what}"
                raise PacketError(where, *faults[0][2:])
        if not self._azimuth_cdeg:
            raise self._capture.no_data()

    @property
    def summary(self) -> Summary:
        """Summary of what has been read; complete once all points have been yielded."""
        azimuth_cdeg = np.concatenate(self._azimuth_cdeg)
        modes = np.concatenate(self._modes)
        packet_ns, host_ns = np.concatenate(self._packet_ns, axis=1)
        step_ns = np.diff(packet_ns)
        host_step_ns = np.diff(host_ns)
        is_jump = (step_ns < 0) | (np.abs(host_step_ns) < np.abs(step_ns))  # the host's clock may be set too
        is_jump &= np.abs(step_ns - host_step_ns) > JUMP_NS
        block_ns = np.arange(layout.BLOCKS_PER_PACKET) * layout.BLOCK_PERIOD_NS
        starts = scan_starts(azimuth_cdeg.ravel() / 100, (packet_ns[:, None] + block_ns).ravel())
        whole = np.diff(starts)[1:] * _BLOCK_RECORDS
        names = {code: mode for mode, code in layout.RETURN_MODE_BYTE.items()}
        points = int(self._codes[1:].sum())
        start = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=self.first_stamp_ns // US_NS)
        gps = self._gps
        return Summary(
            model=next(
                (model for model in SensorModel if layout.FACTORY_BYTE[model] == self._factory),
                self._model or SensorModel.VLP_16,
            ),
            return_mode=", ".join(names[code] for code in dict.fromkeys(modes.tolist())),
            rpm=round(_rpm(azimuth_cdeg, modes), 2),
            packets=len(azimuth_cdeg),
            position_packets=self._positions,
            other_datagrams=self._others,
            points=points,
            no_returns=len(azimuth_cdeg) * layout.RECORDS_PER_PACKET - points,
            scans=len(starts),
            records_per_scan=int(np.median(whole)) if len(whole) else None,
            range_m=self._ranges_m() if points else None,
            start_utc=start.isoformat().replace("+00:00", "Z"),
            duration_s=int(np.where(is_jump, host_step_ns, step_ns).sum()) / S_NS,
            clock=self.clock.clock,
            host_ahead_s=round((self.clock.host_ahead_ns or 0) / S_NS, 6),
            gps={"pps": gps.pps.name.lower(), "sentence": gps.sentence.decode("ascii", "replace").strip()}
            if gps
            else None,
            cut=self._capture.cut,
            repeats=self._capture.repeated,
        )

    def _chunks(self) -> Iterator[list[Datagram]]:
        """Collect data packets into chunks; packets before an error are yielded before it is raised."""
        held: list[Datagram] = []
        try:
            for datagram in self._capture:
                if self._unit is not None and not self._unit.owns(datagram):
                    continue
                if len(datagram.payload) != layout.DATA_BYTES:
                    self._note_other(datagram)
                    continue
                self.first_stamp_ns = self.first_stamp_ns or datagram.stamp_ns
                held.append(datagram)
                if len(held) == _CHUNK:
                    yield held
                    held = []
        except (CaptureError, PacketError):
            if held:
                yield held
            raise
        if held:
            yield held

    def _decoded(self, payloads: U1, number: I8, stamp_ns: I8) -> PacketChunk:
        """Decode packets, (n, 1206), and count them."""
        points = decode_data(payloads, keep_no_returns=False, model=self._model)
        fields = data_fields(payloads)
        if self._frame is PointFrame.MANUAL:
            turned_m = matvec(SENSOR_R_MANUAL.T, points.xyz_m.astype(np.float64))
            points = replace(points, xyz_m=turned_m.astype(np.float32))
        stamps = zip(
            stamp_ns.tolist(), fields["timestamp_us"].tolist(), fields["return_mode"].tolist(), strict=True
        )
        sensor_ns, utc_ns = np.array([self.clock.packet_ns(*each) for each in stamps]).T
        if not self._packet_ns:
            self._zero_ns = int(sensor_ns[0]) // HOUR_NS * HOUR_NS
        packet_ns = sensor_ns - self._zero_ns
        self._packet_ns.append(np.stack([packet_ns, stamp_ns]))
        since_ns = (points.time_ns - packet_ns[points.packet]) % HOUR_NS
        self._codes += np.bincount(fields["blocks"]["records"]["distance_lsb"].ravel(), minlength=2**16)
        self._azimuth_cdeg.append(fields["blocks"]["azimuth_cdeg"].copy())
        self._modes.append(fields["return_mode"].copy())
        self._factory = int(fields["factory"][0])
        return PacketChunk(points, packet_ns[points.packet] + since_ns, packet_ns, utc_ns, fields, number)

    def _note_other(self, datagram: Datagram) -> None:
        if len(datagram.payload) != layout.POSITION_BYTES:
            self._others += 1
            return
        self._positions += 1
        try:
            self._gps = decode_position(datagram.payload)
        except PacketError as error:
            if self._passes_over:
                return
            where = f"{self._path}: frame {datagram.number}: {error.where}"
            raise PacketError(where, error.found, error.expected) from None

    def _ranges_m(self) -> dict[str, float]:
        below = np.cumsum(self._codes[1:])
        codes = np.searchsorted(below, (1, -(-below[-1] // 2), below[-1])).tolist()
        return {
            name: round((n + 1) * layout.DISTANCE_LSB_M, 3)
            for name, n in zip(("min", "median", "max"), codes, strict=True)
        }


def _rpm(azimuth_cdeg: U2, modes: U1) -> float:
    """Return the mean rotor speed over packets, from the azimuths (n, 12) of their blocks and return modes (n,)."""
    turned_cdeg = turning_ns = 0
    for mode in np.unique(modes):
        # In dual return, blocks 0 and 1 share their azimuth.
        stride = 1 + (mode == layout.RETURN_MODE_BYTE[ReturnMode.DUAL])
        own_cdeg: I8 = azimuth_cdeg[modes == mode, ::stride].astype(np.int64)
        step_cdeg: I8 = np.diff(own_cdeg) % layout.AZIMUTH_CODES
        # A step far wider than its neighbours is the edge of the field of view.
        even = step_cdeg <= 2 * np.median(step_cdeg, axis=1, keepdims=True)
        turned_cdeg += int(step_cdeg[even].sum())
        turning_ns += int(even.sum()) * layout.BLOCK_PERIOD_NS
    return turned_cdeg / layout.AZIMUTH_CODES / max(turning_ns / S_NS, 1e-9) * 60
