"""Captures read back: tables of data packets, chunk by chunk, and a summary in numbers."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from threading import Event

import numpy as np
from numpy.typing import NDArray

from vlp16emu.captures.capture import Capture
from vlp16emu.captures.datagrams import Batch, PacketBuffer, PacketRows
from vlp16emu.captures.tally import Duration, ModeTurns, Scans
from vlp16emu.captures.units import CapturedUnit, owners_in
from vlp16emu.errors import CaptureError, PacketError
from vlp16emu.packets import layout
from vlp16emu.packets.decode import (
    PointFrame,
    Points,
    PositionFields,
    block_since_ns,
    decode_position,
    faults_in,
    layouts_of,
    points_in,
    readings_in,
    repeats_in,
)
from vlp16emu.packets.table import Clock, PacketClock, PacketTable, utc_ns_of
from vlp16emu.sensor.beams import BLOCK_RECORDS
from vlp16emu.types import ReturnMode, SensorModel
from vlp16emu.units import HOUR_NS, S_NS, US_NS

_CHUNK = 500  # packets read at once: 0.2 million records, which are written as text in half a second


@dataclass(frozen=True, slots=True)
class Summary:
    """Contents of a capture in numbers."""

    model: SensorModel
    return_mode: str  # One mode, or several with commas if it changes
    rpm: float
    packets: int
    position_packets: int
    other_datagrams: int
    points: int  # Echoes; in dual return a single echo is in two records and counts once
    no_returns: int  # Records without distance
    repeated_records: int  # Records in dual return that repeat a single echo
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
    fit: dict[str, float] | None  # Fit of the host's clock to the sensor's, where `clock` is that
    gps: dict[str, str] | None  # Pulse and sentence of the last position packet
    cut: bool  # True if the file ends in the middle of a packet
    damage: tuple[str, ...]  # Damaged parts of the file that were left out
    repeats: int  # Repeated packets that were skipped


class CaptureReader:
    """Reads a capture once, from front to back, and summarizes what it has read.

    Parameters
    ----------
    path : as for `Capture`
    unit : the sensor whose packets are read; None for all
    model : sensor model of prototype units, whose product byte names another sensor
    clock : clock for the UTC of the packets
    passes_over : whether faulty packets are skipped; else the first one ends the reading
    stop, is_quiet, progress : as for `Capture`

    Raises CaptureError if the file is not a capture.
    """

    def __init__(
        self,
        path: Path,
        unit: CapturedUnit | None = None,
        model: SensorModel | None = None,
        clock: PacketClock | None = None,
        *,
        passes_over: bool = False,
        stop: Event | None = None,
        is_quiet: bool = False,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        self.clock = clock or PacketClock()
        self._model = model
        self._passes_over = passes_over
        self._path = path
        self._unit = unit
        self._capture = Capture(path, stop=stop, is_quiet=is_quiet, progress=progress)
        self._codes = np.zeros(2**16, np.int64)
        self._records = 0
        self._packets = 0
        self._scans = Scans()
        self._duration = Duration()
        self._turns = dict[int, ModeTurns]()  # by the byte of the return mode
        self._factory: int | None = None
        self._positions = 0
        self._others = 0
        self._hour_ns = 0  # full hour of the sensor's clock before the first data packet
        self._gps: PositionFields | None = None
        self.first_stamp_ns = 0  # Capture stamp (UTC) of the first data packet; 0 before it is read

    def tables(self) -> Iterator[PacketTable]:
        """Read chunk by chunk; packets before a faulty packet or record come before its error is raised.

        Raises CaptureError if there is no data packet; PacketError if a packet is not
        from a VLP-16.
        """
        for held in self._chunks():
            table = held.table(self.clock)
            faults = faults_in(table, self._factory, self._model)
            sound = np.ones(len(table), np.bool_)
            sound[[fault.packet for fault in faults]] = False
            if faults and not self._passes_over:
                sound[faults[0].packet :] = False
            if sound.any():
                taken = table[sound]
                self._count(taken)
                yield taken
            # If all packets are faulty the capture is not from this sensor: skipping them would give an empty
            # result.
            if faults and not (self._passes_over and self._packets):
                where = f"{self._path}: frame {held.number[faults[0].packet]}: {faults[0].what}"
                raise PacketError(where, *faults[0][2:])
        if not self._packets:
            raise self._capture.no_data()

    def columns(
        self, table: PacketTable, frame: PointFrame = PointFrame.SENSOR
    ) -> dict[str, NDArray[np.generic]]:
        """Return arrays (m,) of the points of a table by name.

        `t_ns` is their UTC, `clock_ns` the sensor's clock from the full hour before the capture, without
        wrapping.
        """
        points = points_in(table, self._model, frame)
        arrays: dict[str, NDArray[np.generic]] = {name: getattr(points, name) for name in Points.__slots__}
        arrays["t_ns"] = utc_ns_of(table, points)
        arrays["clock_ns"] = (table["sensor_ns"] - self._hour_ns)[points.packet] + points.since_ns
        return arrays

    @property
    def summary(self) -> Summary:
        """Summary of what has been read; complete once all points have been yielded."""
        whole = self._scans.lengths * (self._records / (self._packets * layout.BLOCKS_PER_PACKET))
        names = {code: mode for mode, code in layout.RETURN_MODE_BYTE.items()}
        points = int(self._codes[1:].sum())
        no_returns = int(self._codes[0])
        start = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=self.first_stamp_ns // US_NS)
        gps = self._gps
        return Summary(
            model=self._single.model.name,
            return_mode=", ".join(names[code] for code in self._turns),
            rpm=round(self._rpm(), 2),
            packets=self._packets,
            position_packets=self._positions,
            other_datagrams=self._others,
            points=points,
            no_returns=no_returns,
            repeated_records=self._records - points - no_returns,
            scans=self._scans.count,
            records_per_scan=int(np.median(whole)) if len(whole) else None,
            range_m=self._ranges_m() if points else None,
            start_utc=start.isoformat().replace("+00:00", "Z"),
            duration_s=self._duration.total_ns / S_NS,
            clock=self.clock.clock,
            host_ahead_s=round((self.clock.host_ahead_ns or 0) / S_NS, 6),
            fit=self.clock.fit.summary if self.clock.fit else None,
            gps={"pps": gps.pps.name.lower(), "sentence": gps.sentence.decode("ascii", "replace").strip()}
            if gps
            else None,
            cut=self._capture.cut,
            damage=tuple(self._capture.damage),
            repeats=self._capture.repeated,
        )

    def _chunks(self) -> Iterator[PacketRows]:
        """Collect data packets into chunks; packets before an error are yielded before it is raised."""
        buffer = PacketBuffer(_CHUNK)
        try:
            for batch in self._capture.batches():
                self._take(batch, buffer)
                yield from buffer.chunks()
        except (CaptureError, PacketError):
            yield from buffer.rest()
            raise
        yield from buffer.rest()

    def _take(self, batch: Batch, buffer: PacketBuffer) -> None:
        """Take the data packets of the unit into the buffer, and note others."""
        is_own = owners_in(batch, [self._unit]) == 0
        is_data = batch.payload_bytes == layout.DATA_BYTES
        rows = np.flatnonzero(is_own & is_data)
        fault: PacketError | None = None
        for row in np.flatnonzero(is_own & ~is_data).tolist():
            try:
                self._note_other(int(batch.number[row]), batch.payload(row))
            except PacketError as error:
                fault = error
                rows = rows[rows < row]
                break
        if len(rows):
            self.first_stamp_ns = self.first_stamp_ns or int(batch.stamp_ns[rows[0]])
            buffer.take(PacketRows.of(batch, rows))
        if fault is not None:
            raise fault

    def _count(self, table: PacketTable) -> None:
        """Note what the summary needs."""
        if not self._packets:
            self._hour_ns = int(table["sensor_ns"][0]) // HOUR_NS * HOUR_NS
            self._single, self._dual = layouts_of(table, self._model)
        distance_lsb = table["blocks"]["records"]["distance_lsb"]
        is_used = readings_in(table, self._model) >= 0
        is_own = ~repeats_in(table) & is_used[..., None]
        self._codes += np.bincount(distance_lsb[is_own], minlength=2**16)
        self._records += int(is_used.sum()) * BLOCK_RECORDS
        block_ns = table["sensor_ns"][:, None] + block_since_ns(table, self._model)
        azimuth_cdeg = table["blocks"]["azimuth_cdeg"]
        self._scans.take(azimuth_cdeg.ravel() / 100, block_ns.ravel())
        step_ns = self._duration.take(table["sensor_ns"], table["arrival_ns"])
        modes = table["return_mode"]
        for mode in dict.fromkeys(modes.tolist()):
            is_dual = mode == layout.RETURN_MODE_BYTE[ReturnMode.DUAL]
            turns = self._turns.setdefault(mode, ModeTurns(self._dual if is_dual else self._single))
            turns.take(azimuth_cdeg[modes == mode], step_ns[modes[len(modes) - len(step_ns) :] == mode])
        self._packets += len(table)
        self._factory = int(table["factory"][0])

    def _note_other(self, number: int, payload: bytes) -> None:
        if len(payload) != layout.POSITION_BYTES:
            self._others += 1
            return
        self._positions += 1
        try:
            self._gps = decode_position(payload)
        except PacketError as error:
            if self._passes_over:
                return
            where = f"{self._path}: frame {number}: {error.where}"
            raise PacketError(where, error.found, error.expected) from None

    def _ranges_m(self) -> dict[str, float]:
        below = np.cumsum(self._codes[1:])
        codes = np.searchsorted(below, (1, -(-below[-1] // 2), below[-1])).tolist()
        return {
            name: round((n + 1) * self._single.model.distance_lsb_m, 3)
            for name, n in zip(("min", "median", "max"), codes, strict=True)
        }

    def _rpm(self) -> float:
        """Return the mean rotor speed over packets."""
        turned_cdeg = sum(turns.turned_cdeg for turns in self._turns.values())
        turning_ns = sum(turns.turning_ns for turns in self._turns.values())
        return turned_cdeg / layout.AZIMUTH_CODES / max(turning_ns / S_NS, 1e-9) * 60
