"""A capture as points, chunk by chunk, and what it holds in numbers."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import matvec
from vlp16emu.errors import CaptureError, PacketError
from vlp16emu.packets.capture import Capture, CapturedUnit, Datagram
from vlp16emu.packets.clock import Clock, PacketClock
from vlp16emu.packets.decode import (
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
from vlp16emu.packets.layout import (
    AZIMUTH_CODES,
    BLOCK_PERIOD_NS,
    BLOCKS_PER_PACKET,
    DATA_BYTES,
    DISTANCE_LSB_M,
    FACTORY_BYTE,
    POSITION_BYTES,
    RECORDS_PER_PACKET,
    RETURN_MODE_BYTE,
)
from vlp16emu.types import I8, U1, U2, ReturnMode, SensorModel
from vlp16emu.units import HOUR_NS, S_NS

_CHUNK = 2_000  # packets decoded at once: 0.8 million records, some 50 MB of points
_BLOCK_RECORDS = 32


class PacketChunk(NamedTuple):
    """Data packets decoded at once."""

    points: Points  # Without no-returns
    clock_ns: I8  # (n,) of the points: the sensor's clock, from the full hour before the capture, on past the next one
    packet_ns: I8  # (p,) the same of the packets' first pulses
    utc_ns: I8  # (p,) UTC of the packets' first pulses, by the clock of the reader
    fields: NDArray[np.void]  # (p,) `DATA_PAYLOAD`, the packets themselves
    number: I8  # (p,) of their frames in the file, from 1

    @property
    def t_ns(self) -> I8:
        """(n,) UTC of the points, by the clock of the reader."""
        return self.clock_ns + (self.utc_ns - self.packet_ns)[self.points.packet]

    @property
    def columns(self) -> dict[str, NDArray[np.generic]]:
        """(n,) each of the points' arrays by name, and the clock."""
        arrays = {name: getattr(self.points, name) for name in Points.__slots__}
        return {**arrays, "clock_ns": self.clock_ns, "t_ns": self.t_ns}


@dataclass(frozen=True, slots=True)
class Summary:
    """Contents of a capture in numbers."""

    packets: int
    position_packets: int
    other_datagrams: int
    model: SensorModel
    return_mode: str  # One mode, or several with commas if it changes
    points: int
    no_returns: int
    scans: int  # Turns of the head, begun ones at both ends included
    records_per_scan: int | None  # Median of the whole turns, no-returns counted; None without a whole turn
    rpm: float
    first_stamp_ns: int  # UTC, of the capture, at the first data packet
    duration_s: float  # From the first data packet to the last, by the sensor's clock
    clock: Clock  # Where UTC comes from
    host_ahead_s: float  # Capture stamps less the sensor's clock, in the hour nearest to them, at the first data packet
    range_m: tuple[float, float, float] | None  # Minimum, median and maximum of the returns; None without returns
    gps: PositionFields | None  # The last position packet
    cut: bool  # The file ends in the middle of a packet
    repeats: int  # Packets left out as the capture has them before


class CaptureReader:
    """Reads a capture once, front to back, and counts for a summary what it reads. A context manager.

    Parameters
    ----------
    path : as for `Capture`
    unit : the sensor whose packets are read; None for all
    frame : of the points
    model : of units from before release, whose product byte is that of another sensor
    clock : of the unit's packets, for their UTC
    passes_over : whether packets at fault are passed over; else the first one ends the reading

    Raises CaptureError if it is none.
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
    ) -> None:
        self.clock = clock or PacketClock()
        self._model, self._passes_over = model, passes_over
        self._path, self._unit, self._frame = path, unit, frame
        self._capture = Capture(path)
        self._codes = np.zeros(2**16, np.int64)
        self._azimuth_cdeg, self._packet_ns, self._modes = list[U2](), list[I8](), list[U1]()
        self._factory: int | None = None
        self._positions = self._others = self._zero_ns = 0
        self._gps: PositionFields | None = None
        self.first_stamp_ns = 0  # UTC, of the capture, at the first data packet; 0 before one has been read

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return

    def points(self) -> Iterator[PacketChunk]:
        """Read chunk by chunk; all points before a packet or record at fault come before the error is raised.

        Raises CaptureError if a record is damaged, or no packet is a data packet; PacketError if a packet is not a VLP-16's.
        """
        for held in self._chunks():
            payloads = np.frombuffer(b"".join(datagram.payload for datagram in held), np.uint8)
            payloads = payloads.reshape(len(held), DATA_BYTES)
            faults = faults_in(data_fields(payloads), self._factory, self._model)
            sound = np.ones(len(held), np.bool_)
            sound[[fault.packet for fault in faults]] = False
            if faults and not self._passes_over:
                sound[faults[0].packet :] = False
            if sound.any():
                numbers = np.array([(datagram.number, datagram.stamp_ns) for datagram in held])
                yield self._decoded(payloads[sound], *numbers[sound].T)
            # A capture of nothing but faults is none of this sensor: passing over it would leave an empty result.
            if faults and not (self._passes_over and self._azimuth_cdeg):
                where = f"{self._path}: frame {held[faults[0].packet].number}: {faults[0].what}"
                raise PacketError(where, *faults[0][2:])
        if not self._azimuth_cdeg:
            raise self._capture.no_data()

    @property
    def summary(self) -> Summary:
        """Summary of what has been read, once all points have been taken."""
        azimuth_cdeg, modes = np.concatenate(self._azimuth_cdeg), np.concatenate(self._modes)
        packet_ns = np.concatenate(self._packet_ns)
        block_ns = np.arange(BLOCKS_PER_PACKET) * BLOCK_PERIOD_NS
        starts = scan_starts(azimuth_cdeg.ravel() / 100, (packet_ns[:, None] + block_ns).ravel())
        whole = np.diff(starts)[1:] * _BLOCK_RECORDS
        names = {code: mode for mode, code in RETURN_MODE_BYTE.items()}
        points = int(self._codes[1:].sum())
        return Summary(
            packets=len(azimuth_cdeg),
            position_packets=self._positions,
            other_datagrams=self._others,
            model=next(
                (model for model in SensorModel if FACTORY_BYTE[model] == self._factory),
                self._model or SensorModel.VLP_16,
            ),
            return_mode=", ".join(names[code] for code in dict.fromkeys(modes.tolist())),
            points=points,
            no_returns=len(azimuth_cdeg) * RECORDS_PER_PACKET - points,
            scans=len(starts),
            records_per_scan=int(np.median(whole)) if len(whole) else None,
            rpm=_rpm(azimuth_cdeg, modes),
            first_stamp_ns=self.first_stamp_ns,
            duration_s=int(packet_ns[-1] - packet_ns[0]) / S_NS,
            clock=self.clock.clock,
            host_ahead_s=(self.clock.host_ahead_ns or 0) / S_NS,
            range_m=self._ranges_m() if points else None,
            gps=self._gps,
            cut=self._capture.cut,
            repeats=self._capture.repeated,
        )

    def _chunks(self) -> Iterator[list[Datagram]]:
        """Gather data packets; those before an error come before it."""
        held: list[Datagram] = []
        try:
            for datagram in self._capture:
                if self._unit is not None and not self._unit.owns(datagram):
                    continue
                if len(datagram.payload) != DATA_BYTES:
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
        points, fields = (decode_data(payloads, keep_no_returns=False, model=self._model), data_fields(payloads))
        if self._frame is PointFrame.MANUAL:
            turned_m = matvec(SENSOR_R_MANUAL.T, points.xyz_m.astype(np.float64))
            points = replace(points, xyz_m=turned_m.astype(np.float32))
        stamps = zip(stamp_ns.tolist(), fields["timestamp_us"].tolist(), fields["return_mode"].tolist(), strict=True)
        sensor_ns, utc_ns = np.array([self.clock.packet_ns(*each) for each in stamps]).T
        if not self._packet_ns:
            self._zero_ns = int(sensor_ns[0]) // HOUR_NS * HOUR_NS
        packet_ns = sensor_ns - self._zero_ns
        self._packet_ns.append(packet_ns)
        since_ns = (points.time_ns - packet_ns[points.packet]) % HOUR_NS
        self._codes += np.bincount(fields["blocks"]["records"]["distance_lsb"].ravel(), minlength=2**16)
        self._azimuth_cdeg.append(fields["blocks"]["azimuth_cdeg"].copy())
        self._modes.append(fields["return_mode"].copy())
        self._factory = int(fields["factory"][0])
        return PacketChunk(points, packet_ns[points.packet] + since_ns, packet_ns, utc_ns, fields, number)

    def _note_other(self, datagram: Datagram) -> None:
        if len(datagram.payload) != POSITION_BYTES:
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

    def _ranges_m(self) -> tuple[float, float, float]:
        below = np.cumsum(self._codes[1:])
        shares = (1, -(-below[-1] // 2), below[-1])
        low, middle, high = (float(code + 1) * DISTANCE_LSB_M for code in np.searchsorted(below, shares))
        return low, middle, high


def _rpm(azimuth_cdeg: U2, modes: U1) -> float:
    """Return the mean speed of the rotor over packets, from azimuths (n, 12) of their blocks and return modes (n,)."""
    turned_cdeg = turning_ns = 0
    for mode in np.unique(modes):
        stride = (
            2 if mode == RETURN_MODE_BYTE[ReturnMode.DUAL] else 1
        )  # blocks 0 and 1 of dual return share their azimuth
        own_cdeg: I8 = azimuth_cdeg[modes == mode, ::stride].astype(np.int64)
        step_cdeg: I8 = np.diff(own_cdeg) % AZIMUTH_CODES
        # A far wider step than its neighbours is the edge of a field of view.
        even = step_cdeg <= 2 * np.median(step_cdeg, axis=1, keepdims=True)
        turned_cdeg += int(step_cdeg[even].sum())
        turning_ns += int(even.sum()) * BLOCK_PERIOD_NS
    return turned_cdeg / AZIMUTH_CODES / max(turning_ns / S_NS, 1e-9) * 60
