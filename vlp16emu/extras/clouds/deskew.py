"""Deskewed points of a capture.

A trajectory transforms each point to the world with the pose at its own pulse.
"""

from datetime import UTC, datetime, timedelta
from itertools import chain
from pathlib import Path
from threading import Event

import numpy as np
from numpy.typing import NDArray

from vlp16emu.captures import CaptureReader, chosen_unit, packet_clock
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
from vlp16emu.motion.pose import rotation, rotations
from vlp16emu.packets import PacketTable, Points, points_in, utc_ns_of
from vlp16emu.scenario import load
from vlp16emu.trees import Tree
from vlp16emu.types import F8, I8, AnyArray
from vlp16emu.units import S_NS, US_NS, seconds_to_ns

_PACKETS = 100  # transformed together: 38 400 points, some 20 MB
_MINUTE_NS = 60 * S_NS
_TAKEN = ("distance_m", "azimuth_deg", "reflectivity", "ring", "laser", "is_last")
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
            self.path, self.origin, self.sensor = _of_truth(path, unit)
        poses = read_tum(self.path)
        self._first_ns, self._last_ns = int(poses.t_ns[0]), int(poses.t_ns[-1])
        recorded = Recorded(kind="recorded", file=str(self.path), format="tum")
        self._motion = RecordedMotion(recorded, poses, start_ns=self._first_ns)
        errors = errors or TrajectoryErrors()
        self.needs_clock = errors.time_offset_s is None  # True until `find_clock` has found the time offset
        self.clock: str | None = None  # clock of the stamps, if it was found
        self._offset_ns = seconds_to_ns(errors.time_offset_s or 0.0)
        self._mount = errors.mount
        self._drift = errors.drift
        self.first_m = poses.position_m[0]

    @property
    def span_ns(self) -> tuple[int, int]:
        """UTC of the first and the last pulse that have a pose."""
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
        found = clock_offset((self._first_ns, self._last_ns), pulses_ns)
        self.clock = found.clock
        self._offset_ns = found.offset_ns
        self.needs_clock = False

    def has(self, t_ns: I8) -> NDArray[np.bool_]:
        """Return a mask (n,) of instants between the first and the last pose.

        Instants count to the whole microsecond of stamps.
        """
        at_ns = t_ns + self._offset_ns
        return np.asarray((at_ns >= self._first_ns - US_NS) & (at_ns <= self._last_ns + US_NS))

    def poses_at(self, t_ns: I8) -> tuple[F8, F8]:
        """Return rotations (n, 3, 3) and positions (n, 3) of the sensor in the world at instants (n,)."""
        at_ns = np.clip(t_ns + self._offset_ns, self._first_ns, self._last_ns)
        poses = self._motion.poses_at(at_ns)
        turn = poses.world_R_body
        place_m = poses.world_p_body_m
        if self._drift is not None:
            minutes = (at_ns - self._first_ns) / _MINUTE_NS
            turn, place_m = self._with_drift(turn, place_m, minutes, self._drift)
        if self._mount is not None:
            *lever_arm_m, roll_deg, pitch_deg, yaw_deg = self._mount
            place_m = place_m + matvec(turn, np.array(lever_arm_m))
            turn = matmul(turn, rotation(yaw_deg, pitch_deg, roll_deg))
        return turn, place_m

    def _with_drift(self, turn: F8, place_m: F8, minutes: F8, drift: tuple[float, ...]) -> tuple[F8, F8]:
        """Return poses with drift after `minutes` (n,): rotation about the first pose, then translation."""
        *per_minute_m, yaw_deg = drift
        yaw = rotations(np.radians(yaw_deg * minutes), 0.0, 0.0)
        from_first_m = matvec(yaw, place_m - self.first_m)
        return matmul(yaw, turn), self.first_m + from_first_m + minutes[:, None] * np.array(per_minute_m)


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
        known = {column.name for column in cloud.DESKEWED_COLUMNS} | {"reflectance"}
        wanted = cloud.TRUTH_COLUMNS + cloud.LABEL_COLUMNS * (self._labels is not None)
        return tuple(column for column in wanted if column.name not in known)

    def of(self, table: PacketTable, points: Points, kept: I8) -> dict[str, AnyArray]:
        """Return labels and true values (n,) of the points `kept`; heights are at true positions."""
        rows = self._rows.rows(table["timestamp_us"], points.packet[kept], points.slot[kept])
        if self._labels is None or not rows:
            return rows
        world_m = np.column_stack([rows[f"world_{axis}_m"] for axis in "xyz"])
        return rows | self._labels.of(rows | {"world_m": world_m})


def write_deskewed(
    capture: Path,
    path: Path,
    way: Trajectory,
    truth: CaptureTruth | None,
    *,
    stop: Event,
    clock: str | None = None,
) -> Tree:
    """Write the points of a capture, in the world and in the sensor's frame, to a file of `point_file`.

    Return its contents.

    Parameters
    ----------
    truth : labels each point with its surface
    stop : ends the file between two parts of the capture
    clock : clock of the pulses, as for `vlp16emu.captures.unit_clocks`

    Raises InputError, TrajectoryError if the ground truth belongs to another run, or no pulse has a pose;
    CaptureError, PacketError if the capture cannot be read, or is damaged; the file has the points before.
    """
    known = chosen_unit(capture, way.sensor or str(way.unit), where="--unit")
    stamped = packet_clock(capture, known, clock, where="--clock")
    if way.needs_clock and capture.is_fifo():
        found = f"found auto for the pipe {capture}"
        raise InputError("--time-offset", found, "a number, or a file, which can be read twice")
    if way.needs_clock:
        way.find_clock(_pulses_ns(CaptureReader(capture, known, clock=stamped), stop))
    tables = CaptureReader(capture, known, clock=stamped).tables()
    first = next(tables)
    start_ns = int(first["utc_ns"][0])
    comments = "x, y, z in the world by a trajectory", cloud.time_comment(stamped.clock.whose)
    start_utc = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=start_ns // 1000)
    about = cloud.CloudAbout(comments, start_utc, way.origin, way.unit)
    columns = cloud.DESKEWED_COLUMNS + (truth.columns if truth else ())
    points = without_pose = last_ns = 0
    with cloud.point_file(path, columns, about, where=str(path), inputs=(capture, way.path)) as writer:
        for table in chain([first], tables):
            for begin in range(0, len(table), _PACKETS):
                block, left_out = _block(table[begin : begin + _PACKETS], way, truth, start_ns)
                writer.write(block)
                points = points + len(block["t_ns"])
                without_pose = without_pose + left_out
            last_ns = int(table["utc_ns"][-1]) - start_ns
            if stop.is_set():
                break
        if without_pose and not points:
            raise _without_poses(way, (start_ns, start_ns + last_ns), stamped.clock)
    return {
        "file": str(path),
        "capture": str(capture),
        "trajectory": str(way.path),
        "points": points,
        "without_pose": without_pose,  # points left out because the trajectory has no pose at their pulses
        "truth": truth is not None,
        "simulated_s": last_ns / S_NS,  # from the first pulse of the capture to the last
        "clock": stamped.clock,
        "time_offset_s": way.time_offset_s,
        "clock_of_poses": way.clock,  # how the offset was found; None if it was given
        "fit": stamped.fit.summary if stamped.fit else None,  # of the host's clock to the sensor's
        "host_ahead_s": (stamped.host_ahead_ns or 0)
        / S_NS,  # capture stamp minus sensor's clock at the first packet
        "bytes": path.stat().st_size,
        "interrupted": stop.is_set(),
    }


def _pulses_ns(reader: CaptureReader, stop: Event) -> tuple[int, int]:
    """Return UTC of the first and the last data packet of a capture, or of its part before a stop."""
    ends_ns = list[int]()
    for table in reader.tables():
        ends_ns += [int(table["utc_ns"][0]), int(table["utc_ns"][-1])]
        if stop.is_set():
            break
    return ends_ns[0], ends_ns[-1]


def _without_poses(way: Trajectory, pulses_ns: tuple[int, int], clock: str) -> TrajectoryError:
    """Return the error of a trajectory without a pose between the first and the last pulse of a capture."""
    poses, pulses = (
        "from {:.3f} to {:.3f} s".format(*s) for s in (way.span_s, [t_ns / S_NS for t_ns in pulses_ns])
    )
    expected = f"poses at the pulses, {pulses} by the {clock} clock (see --clock and --time-offset)"
    return TrajectoryError(str(way.path), f"poses {poses}", expected)


def _block(
    table: PacketTable, way: Trajectory, truth: CaptureTruth | None, start_ns: int
) -> tuple[dict[str, AnyArray], int]:
    """Return the transformed points of some data packets, each echo once, and the number without a pose."""
    points = points_in(table)
    t_ns = utc_ns_of(table, points)
    kept = np.flatnonzero(way.has(t_ns))
    t_ns = t_ns[kept]
    sensor_m = points.xyz_m[kept]
    turn, place_m = way.poses_at(t_ns)
    block: dict[str, AnyArray] = {
        "t_ns": t_ns,
        "since_start_ns": t_ns - start_ns,
        "world_m": matvec(turn, sensor_m.astype(np.float64)) + place_m,
        "sensor_m": sensor_m,
        "viewpoint_m": place_m,
    }
    block |= {name: getattr(points, name)[kept] for name in _TAKEN}
    if truth:
        block |= truth.of(table, points, kept)
    return block, len(points.slot) - len(kept)


def _of_truth(folder: Path, unit: int) -> tuple[Path, tuple[float, float, float] | None, str | None]:
    """Return a unit's trajectory and the world's origin.

    If there are several units, address and port of the unit are returned too.
    """
    rig = folder / "rig.json"
    expected = "a folder that `record --truth` has written, or a TUM file"
    tree = read_rig(folder, expected)
    world = tree["world"]
    origin = world["latitude_deg"], world["longitude_deg"], world["height_m"]
    known = [
        (folder / unit["trajectory"], f"{unit['address']}:{unit['data_port']}") for unit in tree["units"]
    ]
    if unit > len(known):
        raise InputError("--unit", f"found {unit}", f"at most {len(known)}, the units in {rig}")
    file, sensor = known[unit - 1]
    return file, origin, sensor if len(known) > 1 else None
