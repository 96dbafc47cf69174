"""Deskewed points of a capture.

A trajectory transforms each point to the world with the pose at its own pulse.
"""

from datetime import UTC, datetime, timedelta
from itertools import chain
from pathlib import Path
from threading import Event

import numpy as np
from numpy.typing import NDArray

from vlp16emu.captures import CaptureReader, Survey, packet_clock
from vlp16emu.captures.units import CapturedUnit
from vlp16emu.elementary import matmul, matvec
from vlp16emu.errors import InputError, TrajectoryError
from vlp16emu.extras.clouds import cloud
from vlp16emu.extras.clouds.epochs import clock_offset
from vlp16emu.extras.options import TrajectoryErrors
from vlp16emu.extras.recorded.files import read_tum
from vlp16emu.extras.recorded.motion import RecordedMotion
from vlp16emu.extras.recorded.settings import Recorded
from vlp16emu.extras.truth.description import read_rig
from vlp16emu.extras.truth.slots import SlotReader
from vlp16emu.packets import Clock, PacketClock, PacketTable, Points, points_in, utc_ns_of
from vlp16emu.rotation import rotation, rotations
from vlp16emu.scenario import load
from vlp16emu.trees import Tree
from vlp16emu.types import F8, I8, AnyArray
from vlp16emu.units import S_NS, US_NS, seconds_to_ns

_BLOCK_PACKETS = 100  # packets that are transformed together: 38 400 points, some 20 MB
_MINUTE_NS = 60 * S_NS
_COPIED = ("distance_m", "azimuth_deg", "reflectivity", "ring", "laser", "is_last")
"""Columns that are copied from packets unchanged."""


class Trajectory:
    """Poses of a sensor in the world, from a file.

    Parameters
    ----------
    path : a TUM file, or a folder with the ground truth of a run
    unit : number of the sensor in the run, from 1; InputError if the folder has no such trajectory
    errors : applied to its poses
    """

    def __init__(self, path: Path, unit: int, errors: TrajectoryErrors | None = None) -> None:
        self.path = path
        self.unit = unit
        self.origin = None
        self.sensor = None
        if path.is_dir():
            self.path, self.origin, self.sensor = _truth_trajectory(path, unit)
        poses = read_tum(self.path)
        self._first_ns, self._last_ns = int(poses.t_ns[0]), int(poses.t_ns[-1])
        recorded = Recorded(kind="recorded", file=str(self.path), format="tum")
        self._motion = RecordedMotion(recorded, poses, start_ns=self._first_ns)
        errors = errors or TrajectoryErrors()
        self.needs_clock = errors.time_offset_s is None
        """True until `find_clock` has found the time offset."""
        self.clock: str | None = None
        """Clock of the stamps, if it was found."""
        self._offset_ns = seconds_to_ns(errors.time_offset_s or 0.0)
        self._mount = errors.mount
        self._drift = errors.drift
        self.first_m = poses.position_m[0]

    @property
    def span_ns(self) -> tuple[int, int]:
        """UTC of the first and the last pulse that have a pose, in ns."""
        return self._first_ns - self._offset_ns, self._last_ns - self._offset_ns

    @property
    def span_s(self) -> tuple[float, float]:
        """UTC of the first and the last pulse that have a pose, in seconds."""
        first_ns, last_ns = self.span_ns
        return first_ns / S_NS, last_ns / S_NS

    @property
    def time_offset_s(self) -> float:
        """Time added to a pulse's time before its pose is looked up."""
        return self._offset_ns / S_NS

    def find_clock(self, pulses_ns: tuple[int, int]) -> None:
        """Set the time offset from the UTC of a run's first and last pulse, as `clock_offset`."""
        offset = clock_offset((self._first_ns, self._last_ns), pulses_ns)
        self.clock = offset.clock
        self._offset_ns = offset.offset_ns
        self.needs_clock = False

    def has(self, t_ns: I8) -> NDArray[np.bool_]:
        """Return a mask (n,) of the instants that the poses cover, to the microsecond of stamps."""
        pose_ns = t_ns + self._offset_ns
        return np.asarray((pose_ns >= self._first_ns - US_NS) & (pose_ns <= self._last_ns + US_NS))

    def poses_at(self, t_ns: I8) -> tuple[F8, F8]:
        """Return rotations (n, 3, 3) and positions (n, 3) of the sensor in the world at instants (n,)."""
        pose_ns = np.clip(t_ns + self._offset_ns, self._first_ns, self._last_ns)
        poses = self._motion.poses_at(pose_ns)
        world_R_sensor = poses.world_R_body
        world_p_sensor_m = poses.world_p_body_m
        if self._drift is not None:
            minutes = (pose_ns - self._first_ns) / _MINUTE_NS
            world_R_sensor, world_p_sensor_m = self._with_drift(
                world_R_sensor, world_p_sensor_m, minutes, self._drift
            )
        if self._mount is not None:
            *lever_arm_m, roll_deg, pitch_deg, yaw_deg = self._mount
            world_p_sensor_m = world_p_sensor_m + matvec(world_R_sensor, np.array(lever_arm_m))
            world_R_sensor = matmul(world_R_sensor, rotation(yaw_deg, pitch_deg, roll_deg))
        return world_R_sensor, world_p_sensor_m

    def _with_drift(
        self, world_R_sensor: F8, world_p_sensor_m: F8, minutes: F8, drift: tuple[float, ...]
    ) -> tuple[F8, F8]:
        """Return poses with the drift of `minutes` (n,): a rotation about the first pose, then a shift."""
        *per_minute_m, yaw_deg = drift
        yaw = rotations(np.radians(yaw_deg * minutes), 0.0, 0.0)
        from_first_m = matvec(yaw, world_p_sensor_m - self.first_m)
        shift_m = minutes[:, None] * np.array(per_minute_m)
        return matmul(yaw, world_R_sensor), self.first_m + from_first_m + shift_m


class CaptureTruth:
    """Ground truth of the points of a capture, from the truth folder of its run.

    Parameters
    ----------
    folder : written by `record --truth --truth-returns`; InputError if it has no returns
    unit : number of the sensor in the run, from 1
    scheme : scheme of additional labels; needs the scene of the run
    """

    def __init__(self, folder: Path, unit: int, scheme: cloud.LabelScheme | None) -> None:
        self._rows = SlotReader(folder / f"returns{'' if unit == 1 else f'_{unit}'}.parquet")
        self._labels: cloud.PointLabels | None = None
        if scheme is not None:
            scenario = load(folder / "scenario.json")
            self._labels = cloud.PointLabels(scheme, scenario.world.site(scenario.world_seed).height_m)

    @property
    def columns(self) -> tuple[cloud.Column, ...]:
        """Return the columns of the points beyond `cloud.DESKEWED_COLUMNS`."""
        known_names = {column.name for column in cloud.DESKEWED_COLUMNS} | {"reflectance"}
        columns = cloud.TRUTH_COLUMNS + cloud.LABEL_COLUMNS * (self._labels is not None)
        return tuple(column for column in columns if column.name not in known_names)

    def values_of(self, table: PacketTable, points: Points, rows: I8) -> dict[str, AnyArray]:
        """Return labels and true values (n,) of the points in `rows` (n,); heights are at true positions."""
        values = self._rows.rows(table["timestamp_us"], points.packet[rows], points.slot[rows])
        if self._labels is None or not values:
            return values
        world_m = np.column_stack([values[f"world_{axis}_m"] for axis in "xyz"])
        return values | self._labels.labels_of(values | {"world_m": world_m})


def write_deskewed(
    capture: Path,
    path: Path,
    trajectory: Trajectory,
    truth: CaptureTruth | None,
    *,
    stop: Event,
    clock: str | None = None,
) -> Tree:
    """Write the points of a capture in the world and in the sensor's frame, and return the report.

    Parameters
    ----------
    path : file to write, as for `point_file`
    truth : labels each point with its surface; None for no labels
    stop : ends the file between two parts of the capture
    clock : clock of the pulses, as for `vlp16emu.captures.unit_clocks`

    Raises InputError, TrajectoryError if the ground truth belongs to another run, or no pulse has a pose;
    CaptureError, PacketError if the capture cannot be read, or is damaged; the file has the points before.
    """
    sensor = Survey(capture, stop).chosen(trajectory.sensor or str(trajectory.unit), where="--unit")
    unit_clock = packet_clock(capture, sensor, clock, where="--clock", stop=stop)
    if trajectory.needs_clock:
        trajectory.find_clock(_pulses_ns(capture, sensor, unit_clock, stop))
    tables = CaptureReader(capture, sensor, clock=unit_clock).tables()
    first = next(tables)
    start_ns = int(first["utc_ns"][0])
    metadata = _metadata(trajectory, start_ns, unit_clock.clock)
    columns = cloud.DESKEWED_COLUMNS + (truth.columns if truth else ())
    points = 0
    without_pose = 0
    last_ns = 0
    inputs = (capture, trajectory.path)
    with cloud.point_file(path, columns, metadata, where=str(path), inputs=inputs) as writer:
        for table in chain([first], tables):
            for begin in range(0, len(table), _BLOCK_PACKETS):
                part = table[begin : begin + _BLOCK_PACKETS]
                block, left_out = _block(part, trajectory, truth, start_ns)
                writer.write(block)
                points += len(block["t_ns"])
                without_pose += left_out
            last_ns = int(table["utc_ns"][-1]) - start_ns
            if stop.is_set():
                break
        if without_pose and not points:
            raise _no_pose_error(trajectory, (start_ns, start_ns + last_ns), unit_clock.clock)
    return {
        "file": str(path),
        "capture": str(capture),
        "trajectory": str(trajectory.path),
        "points": points,
        "without_pose": without_pose,  # points left out because the trajectory has no pose at their pulses
        "truth": truth is not None,
        "simulated_s": last_ns / S_NS,  # from the first pulse of the capture to the last
        **_clocks(trajectory, unit_clock),
        "bytes": path.stat().st_size,
        "interrupted": stop.is_set(),
    }


def _clocks(trajectory: Trajectory, clock: PacketClock) -> Tree:
    """Return the part of the report on the clocks of pulses and poses."""
    return {
        "clock": clock.clock,
        "time_offset_s": trajectory.time_offset_s,
        "clock_of_poses": trajectory.clock,  # how the offset was found; None if it was given
        "fit": clock.fit.summary if clock.fit else None,  # of the host's clock to the sensor's
        # Capture stamp minus sensor's clock at the first packet.
        "host_ahead_s": (clock.host_ahead_ns or 0) / S_NS,
    }


def _metadata(trajectory: Trajectory, start_ns: int, clock: Clock) -> cloud.CloudMetadata:
    """Return the head of a file of points whose first pulse is at `start_ns` UTC by a clock."""
    comments = "x, y, z in the world by a trajectory", cloud.time_comment(clock.whose)
    start_utc = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=start_ns // 1000)
    return cloud.CloudMetadata(comments, start_utc, trajectory.origin, trajectory.unit)


def _pulses_ns(
    capture: Path, sensor: CapturedUnit | None, clock: PacketClock, stop: Event
) -> tuple[int, int]:
    """Return UTC of the first and the last data packet of a capture, or of its part before a stop.

    Raises InputError for a pipe.
    """
    if capture.is_fifo():
        found = f"found auto for the pipe {capture}"
        raise InputError("--time-offset", found, "a number, or a file, which can be read twice")
    ends_ns = list[int]()
    for table in CaptureReader(capture, sensor, clock=clock, is_quiet=True).tables():
        ends_ns += [int(table["utc_ns"][0]), int(table["utc_ns"][-1])]
        if stop.is_set():
            break
    return ends_ns[0], ends_ns[-1]


def _no_pose_error(trajectory: Trajectory, pulses_ns: tuple[int, int], clock: str) -> TrajectoryError:
    """Return the error of a trajectory without a pose between the first and the last pulse of a capture."""
    first_ns, last_ns = pulses_ns
    pulses = f"from {first_ns / S_NS:.3f} to {last_ns / S_NS:.3f} s"
    expected = f"poses at the pulses, {pulses} by the {clock} clock (see --clock and --time-offset)"
    first_s, last_s = trajectory.span_s
    return TrajectoryError(str(trajectory.path), f"poses from {first_s:.3f} to {last_s:.3f} s", expected)


def _block(
    table: PacketTable, trajectory: Trajectory, truth: CaptureTruth | None, start_ns: int
) -> tuple[dict[str, AnyArray], int]:
    """Return the transformed points of some data packets, each echo once, and the number without a pose."""
    points = points_in(table)
    t_ns = utc_ns_of(table, points)
    rows = np.flatnonzero(trajectory.has(t_ns))
    t_ns = t_ns[rows]
    sensor_m = points.xyz_m[rows]
    world_R_sensor, world_p_sensor_m = trajectory.poses_at(t_ns)
    block: dict[str, AnyArray] = {
        "t_ns": t_ns,
        "since_start_ns": t_ns - start_ns,
        "world_m": matvec(world_R_sensor, sensor_m.astype(np.float64)) + world_p_sensor_m,
        "sensor_m": sensor_m,
        "viewpoint_m": world_p_sensor_m,
    }
    block |= {name: getattr(points, name)[rows] for name in _COPIED}
    if truth:
        block |= truth.values_of(table, points, rows)
    return block, len(points.slot) - len(rows)


def _truth_trajectory(folder: Path, unit: int) -> tuple[Path, tuple[float, float, float] | None, str | None]:
    """Return the file of a unit's trajectory, the world's origin, and the unit's address and port.

    The last is None if there is one unit.
    """
    rig = folder / "rig.json"
    expected = "a folder that `record --truth` has written, or a TUM file"
    tree = read_rig(folder, expected)
    world = tree["world"]
    origin = world["latitude_deg"], world["longitude_deg"], world["height_m"]
    rows = tree["units"]
    if unit > len(rows):
        raise InputError("--unit", f"found {unit}", f"at most {len(rows)}, the units in {rig}")
    row = rows[unit - 1]
    sensor = f"{row['address']}:{row['data_port']}" if len(rows) > 1 else None
    return folder / row["trajectory"], origin, sensor
