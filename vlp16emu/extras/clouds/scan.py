"""Whole revolutions of a sensor as arrays, from a scene or from a capture."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import compress, pairwise
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from vlp16emu.captures import CaptureReader, Survey, packet_clock
from vlp16emu.elementary import cos, matvec, sin
from vlp16emu.engine import Engine, Unit
from vlp16emu.errors import InputError
from vlp16emu.extras.displace import offset_tangents
from vlp16emu.packets import (
    DATA_BYTES,
    JUMP_NS,
    PacketClock,
    PacketTable,
    PointFrame,
    Points,
    faults_in,
    packet_row,
    packet_table,
    points_in,
    scan_starts,
    utc_ns_of,
)
from vlp16emu.packets.decode import block_since_ns, layouts_of, readings_in
from vlp16emu.sensor.beams import BLOCK_RECORDS, BeamTable
from vlp16emu.sensor.head import in_sensor
from vlp16emu.types import (
    F4,
    F8,
    I8,
    SURFACE,
    AnyArray,
    Firings,
    Labels,
    Packet,
    Poses,
    ReturnMode,
    Returns,
    Scan,
)
from vlp16emu.units import S_NS, seconds_to_ns

_LONGEST_NS = 2 * S_NS
"""Time after which readings without a whole revolution are left out: the rotor stands. The slowest scanner
that a user can define turns once a second."""
_LABELS = ("semantic", "part", "instance", "species")


@dataclass(frozen=True, slots=True)
class Chunk:
    """n points of m azimuth readings, in order of time."""

    t_ns: I8  # (m,) UTC of the first pulse after each reading
    azimuth_deg: F8  # (m,) azimuth readings
    reading: I8  # (n,) index of each point's reading, ascending
    arrays: Mapping[str, AnyArray]  # arrays of n points by their names in a scan

    def extended_by(self, later: "Chunk") -> "Chunk":
        """Return this chunk with a later one appended."""
        return Chunk(
            np.concatenate([self.t_ns, later.t_ns]),
            np.concatenate([self.azimuth_deg, later.azimuth_deg]),
            np.concatenate([self.reading, later.reading + len(self.t_ns)]),
            {name: np.concatenate([array, later.arrays[name]]) for name, array in self.arrays.items()},
        )

    def readings(self, begin: int, end: int) -> Self:
        """Return the readings from `begin` to before `end`, with their points."""
        first, last = np.searchsorted(self.reading, (begin, end))
        points = {name: array[first:last] for name, array in self.arrays.items()}
        readings = slice(begin, end)
        return type(self)(
            self.t_ns[readings], self.azimuth_deg[readings], self.reading[first:last] - begin, points
        )


def cut_scans(chunks: Iterable[Chunk], pose_at: Callable[[int], F8] | None = None) -> Iterator[Scan]:
    """Cut points into whole revolutions; partial ones at the ends and at a jump of the clock are left out.

    Parameters
    ----------
    chunks : chunks in order of time, without gaps
    pose_at : returns `world_T_sensor` (4, 4) at a UTC time in ns; None for a capture
    """
    pending = None
    is_whole = False
    for chunk in chunks:
        if not len(chunk.t_ns):
            continue
        pending = chunk if pending is None else pending.extended_by(chunk)
        starts = scan_starts(pending.azimuth_deg, pending.t_ns).tolist()
        for begin, end in pairwise(starts):
            jumps = abs(int(pending.t_ns[end] - pending.t_ns[end - 1])) > JUMP_NS
            if not jumps and (is_whole or _begins_at_zero(pending.azimuth_deg[begin:])):
                yield _scan(pending.readings(begin, end), pose_at)
            is_whole = not jumps
        pending = pending.readings(starts[-1], len(pending.t_ns))
        if pending.t_ns[-1] - pending.t_ns[0] > _LONGEST_NS:
            pending = None
            is_whole = False
    if pending is None or not _ends_at_zero(pending.azimuth_deg):
        return
    if is_whole or _begins_at_zero(pending.azimuth_deg):
        yield _scan(pending, pose_at)


def _begins_at_zero(azimuth_deg: F8) -> bool:
    """Return True if the reading before the first one would belong to another revolution."""
    return len(azimuth_deg) > 1 and bool(azimuth_deg[0] < (azimuth_deg[1] - azimuth_deg[0]) % 360.0)


def _ends_at_zero(azimuth_deg: F8) -> bool:
    """Return True if the reading after the last one would belong to another revolution."""
    return len(azimuth_deg) > 1 and bool(2 * azimuth_deg[-1] - azimuth_deg[-2] >= 360.0)


def _scan(chunk: Chunk, pose_at: Callable[[int], F8] | None) -> Scan:
    """Return the points of one revolution as a scan."""
    arrays = dict(chunk.arrays)
    start_ns = int(chunk.t_ns[0])
    labels = None
    if "semantic" in arrays:
        labels = Labels(**{name: arrays.pop(name) for name in Labels.__slots__})
    pose = None if pose_at is None else pose_at(start_ns)
    return Scan(start_ns=start_ns, world_T_sensor=pose, labels=labels, **arrays)


def decode(
    capture: str | Path,
    unit: str | int | None = None,
    *,
    frame: str | PointFrame = PointFrame.SENSOR,
    clock: str | None = None,
) -> Iterator[Scan]:
    """Read the whole revolutions of a capture with the formulas of the sensor's manual.

    The capture is from the emulator or a real sensor. The parts of revolutions at its beginning and end are
    left out: a capture of less than a revolution gives no scan.

    Parameters
    ----------
    capture : a classic pcap file with the packets of a model of `SensorModel`
    unit : sensor, if there are several: its number from 1, or `address:port` with its data port
    frame : frame of `xyz_m`: "sensor" (x forward, y left, z up) or "manual" (x right, y forward, z up)
    clock : clock of `t_ns`: "sensor", "gps" or "host"; by default the choice of `unit_clocks`

    Returns
    -------
    iterator over the whole revolutions, which reads the file step by step; scans before an error come first

    Raises CaptureError if the file cannot be read, is damaged or has no data packets; PacketError if a packet
    is none of a known model; InputError if there is no such frame, clock or unit, or if `unit` is missing and
    there are several.
    """
    if frame not in tuple(PointFrame):
        raise InputError("frame", f"found {frame}", " or ".join(PointFrame))
    path = Path(capture)
    sensor = Survey(path).chosen(None if unit is None else str(unit))
    reader = CaptureReader(path, sensor, clock=packet_clock(path, sensor, clock))
    return cut_scans(
        chunk_of(table, points_in(table, frame=PointFrame(frame)), {}) for table in reader.tables()
    )


def chunk_of(table: PacketTable, points: Points, labels: Mapping[str, AnyArray]) -> Chunk:
    """Return the points of data packets sorted by azimuth readings.

    Labels are arrays of `Labels`, empty if there are none.
    """
    reading = readings_in(table)
    is_reading = np.diff(reading, axis=1, prepend=-1) > 0  # the first of the blocks that share a reading
    first = np.concatenate([[0], np.cumsum(is_reading.sum(axis=1))])
    block_ns = table["utc_ns"][:, None] + block_since_ns(table)
    copied_fields = ("xyz_m", "distance_m", "azimuth_deg", "reflectivity", "is_last")
    ring = points.ring.astype(np.uint16)
    arrays: dict[str, AnyArray] = {"t_ns": utc_ns_of(table, points), "ring": ring, **labels}
    arrays |= {name: getattr(points, name) for name in copied_fields}
    return Chunk(
        t_ns=block_ns[is_reading],
        azimuth_deg=table["blocks"]["azimuth_cdeg"][is_reading] / 100,
        reading=first[points.packet] + reading[points.packet, points.slot // BLOCK_RECORDS],
        arrays=arrays,
    )


def chunk_of_packets(packets: Iterable[Packet]) -> Chunk | None:
    """Return the points of data packets of one sensor; None if no packet is complete and without fault.

    Points have labels if the packets carry ground truth. Packets of a prepared run, which do not know their
    first pulse, are dated by their sending.
    """
    complete = [packet for packet in packets if len(packet.payload) == DATA_BYTES]
    if not complete:
        return None
    clock = PacketClock()
    rows = (
        packet_row(number, packet.due_ns, packet.payload, clock) for number, packet in enumerate(complete)
    )
    table = packet_table(rows)
    table["utc_ns"] = [packet.due_ns if packet.fired_ns is None else packet.fired_ns for packet in complete]
    table["utc_ns"] += layouts_of(table)[0].model.stamp_after_ns
    is_valid = np.ones(len(complete), np.bool_)
    is_valid[[fault.packet for fault in faults_in(table)]] = False
    if not is_valid.any():
        return None
    table = table[is_valid]
    points = points_in(table)
    labels = dict[str, AnyArray]()
    if complete[0].slots is not None:
        slots = np.array([packet.slots for packet in compress(complete, is_valid)])[
            points.packet, points.slot
        ]
        labels = {name: slots[name] for name in Labels.__slots__}
    return chunk_of(table, points, labels)


def scans_of(engine: Engine, number: int, span_s: tuple[float, float], *, truth: bool) -> Iterator[Scan]:
    """Return whole revolutions of a unit, numbered from 0, within a span; with labels if `truth`.

    Raises TrajectoryError if the walk ends before the span.
    """
    start_ns = engine.scenario.start_ns
    unit = engine.parts.units[number]
    begin_ns, end_ns = (start_ns + seconds_to_ns(since_s) for since_s in span_s)
    returns = engine.returns(*span_s, number, truth=truth)
    chunks = (_chunk_of_returns(unit, block, begin_ns, end_ns, truth=truth) for block in returns)
    return cut_scans(chunks, lambda t_ns: unit.world_T_sensor(np.array([t_ns]))[0])


def _chunk_of_returns(unit: Unit, returns: Returns, begin_ns: int, end_ns: int, *, truth: bool) -> Chunk:
    """Return the points of a block whose azimuth is read in a span: each echo once, the last one first."""
    firings = returns.firings
    step = unit.head.beams.per_reading
    reading_ns = firings.t_ns[::step, 0]
    is_inside = (reading_ns >= begin_ns) & (reading_ns < end_ns)
    if returns.is_sent is not None:
        is_inside &= returns.is_sent[::step]
    is_inside_laser = np.broadcast_to(np.repeat(is_inside, step)[:, None], firings.t_ns.shape)
    points, sequence = points_of(unit, returns, is_inside_laser, truth=truth)
    # In dual return, a single echo is both strongest and last.
    distance_m = returns.distance_m[sequence, points["laser"]]
    is_dual = returns.mode is ReturnMode.DUAL
    is_last = points["return_number"] == 1
    is_last |= (points["return_number"] == 0) & (distance_m[:, 0] == distance_m[:, 1]) & is_dual
    order = np.lexsort((~is_last, points["laser"], sequence))
    names: tuple[str, ...] = ("t_ns", "distance_m", "azimuth_deg", "ring", "reflectivity")
    if truth:
        names = (*names, *_LABELS, "range_m")
    arrays = {name: points[name] for name in names}
    arrays |= {"xyz_m": points["sensor_m"].astype(np.float32), "is_last": is_last}
    return Chunk(
        t_ns=reading_ns[is_inside],
        azimuth_deg=firings.reading_deg[::step][is_inside],
        reading=(np.cumsum(is_inside) - 1)[sequence[order] // step],
        arrays={name: array[order] for name, array in arrays.items()},
    )


def points_of(
    unit: Unit, returns: Returns, inside: NDArray[np.bool_], *, truth: bool
) -> tuple[dict[str, AnyArray], I8]:
    """Return the n points of the pulses that are `inside` (k, L), and the firing sequence (n,) of each.

    A firing sequence is its row in the block.
    """
    firings = returns.firings
    beams = unit.head.beams
    t_ns = returns.firings.t_ns
    is_reported = _is_reported(returns.distance_m, returns.mode) & inside[..., None]
    sequence, laser, number = np.nonzero(is_reported)
    distance_m = returns.distance_m[is_reported]
    pulse_ns = t_ns[sequence, laser]
    poses = unit.motion.poses_at(pulse_ns)
    tangents = None
    if unit.beam.section.model == "offset":
        tangents = offset_tangents(distance_m, unit.beam, firings.index + sequence, laser, t_ns.shape[1])
    points: dict[str, AnyArray] = {
        "t_ns": pulse_ns,
        **positions_of(beams, firings, sequence, laser, distance_m, poses, tangents),
        "distance_m": distance_m,
        "reflectivity": returns.reflectivity[is_reported],
        "ring": beams.ring[laser],
        "laser": laser,
        "return_number": number,
        "viewpoint_m": np.broadcast_to(poses.world_p_body_m, (len(pulse_ns), 3)),
    }
    return points | (_labels_of(returns, is_reported) if truth else {}), sequence


def positions_of(
    beams: BeamTable,
    firings: Firings,
    sequence: I8,
    laser: I8,
    distance_m: F4,
    poses: Poses,
    tangents: F8 | None = None,
) -> dict[str, F8]:
    """Compute points from returns with the manual's formulas (63-9243 Rev D, section 9.2).

    A driver with perfect poses does the same. Errors of encoder and angles displace the points, because the
    sensor does not report them; without them a point in the world is the pulse's origin + distance *
    direction.

    Parameters
    ----------
    sequence, laser : (n,) indices of the pulses in `firings`
    distance_m : (n,)
    poses : poses of the body at the pulses, n or one for all
    tangents : (n, 2) offsets of points from the pulse axis over distance, to greater azimuths and upwards;
        None without such offsets

    Returns
    -------
    `azimuth_deg` (n,), encoder reading of the firing sequence plus the rotor's turn until the pulse and the
    laser's azimuth offset, [0, 360); `elevation_deg` (n,) of the beam table; `sensor_m` (n, 3) in the
    sensor's frame at the instant of the pulse; `world_m` (n, 3)
    """
    turned_deg = firings.azimuth_deg[sequence, laser] - firings.azimuth_deg[sequence, 0]
    azimuth_deg = firings.reading_deg[sequence] + turned_deg + beams.azimuth_offset_deg[laser]
    azimuth_deg %= 360.0
    elevation_deg = beams.elevation_deg[laser]
    range_m = distance_m.astype(np.float64)
    sensor_m = in_sensor(azimuth_deg, elevation_deg, beams.vertical_offset_m[laser], range_m)
    if tangents is not None:  # off the axis of the pulse, at the same range
        a, b = tangents.T
        azimuth_rad = np.radians(azimuth_deg)
        elevation_rad = np.radians(elevation_deg)
        cos_azimuth = cos(azimuth_rad)
        sin_azimuth = sin(azimuth_rad)
        cos_elevation = cos(elevation_rad)
        sin_elevation = sin(elevation_rad)
        shortening = 1.0 - np.sqrt(1.0 - a * a - b * b)
        sensor_m[:, 0] -= range_m * (
            shortening * cos_elevation * cos_azimuth + a * sin_azimuth + b * sin_elevation * cos_azimuth
        )
        sensor_m[:, 1] += range_m * (
            shortening * cos_elevation * sin_azimuth - a * cos_azimuth + b * sin_elevation * sin_azimuth
        )
        sensor_m[:, 2] += range_m * (b * cos_elevation - shortening * sin_elevation)
    world_m = matvec(poses.world_R_body, sensor_m) + poses.world_p_body_m
    return {
        "azimuth_deg": azimuth_deg,
        "elevation_deg": elevation_deg,
        "sensor_m": sensor_m,
        "world_m": world_m,
    }


def _is_reported(distance_m: F4, mode: ReturnMode) -> NDArray[np.bool_]:
    """Return a mask (k, L, 3) of the returns that the sensor would report.

    Each echo is reported once, a single echo as the strongest (rules of dual return: 63-9243 Rev D, section
    9.3.2).
    """
    is_reported = distance_m > 0
    if mode is ReturnMode.DUAL:
        same = distance_m[..., 0] == distance_m[..., 1]
        is_reported[..., 1] &= ~same
        is_reported[..., 2] &= same
    else:
        is_reported &= np.arange(3) == (1 if mode is ReturnMode.LAST else 0)
    return is_reported


def _labels_of(returns: Returns, is_reported: NDArray[np.bool_]) -> dict[str, AnyArray]:
    """Return the labels of the surface of each point; returns from fog or rain have no class."""
    assert returns.surface is not None
    assert returns.surfaces is not None
    assert returns.range_m is not None
    surfaces = np.append(returns.surfaces, np.zeros(1, SURFACE))  # the last row is `NO_SURFACE`
    rows = surfaces[np.minimum(returns.surface[is_reported], len(returns.surfaces))]
    return {name: rows[name] for name in (*_LABELS, "reflectance")} | {
        "range_m": returns.range_m[is_reported]
    }
