"""Tables of the ground truth: poses with velocities, inertial unit and receiver, as rows and as text."""

from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.format import read_array_header_1_0, read_magic
from numpy.typing import ArrayLike, NDArray

from vlp16emu.elementary import matvec
from vlp16emu.engine import Engine
from vlp16emu.engine.build import Sampler
from vlp16emu.engine.engine import make_receiver
from vlp16emu.errors import InputError
from vlp16emu.inputs import open_input, parsing
from vlp16emu.motion.gnss import Receiver, to_geodetic
from vlp16emu.motion.pose import Kinematics, Motion
from vlp16emu.motion.settings import Gps
from vlp16emu.scenario.model import InertialSection
from vlp16emu.types import F8, I8
from vlp16emu.units import FOREVER_NS, S_NS

Rows = NDArray[np.void]
"""Rows (n,) of a table, in the order of their times."""

_EXPECTED = "a table of a --truth folder, which earlier versions did not write"
_LONGEST_BYTES = 2**62  # rows stay on the disk
_CHECKED = 65_536  # rows that are checked at a time
_NORM = 1e-6  # greatest departure of a squared norm from 1
_TOGETHER = 4096  # rows that are Python's numbers at a time; a capture may have a gap of hours


@dataclass(frozen=True, slots=True)
class Table:
    """A kind of rows, and their text; each has `t_ns`, UTC."""

    dtype: np.dtype[np.void]
    suffix: str  # of the text
    header: str
    formats: Mapping[str, str]  # of the numbers of each field in the text; times are in seconds
    separator: str = ","

    def rows(self, t_ns: Sequence[int] | I8, **fields: ArrayLike) -> Rows:
        """Return rows from the values of their fields; fields without values are 0."""
        rows = np.zeros(len(t_ns), self.dtype)
        rows["t_ns"] = t_ns
        for name, values in fields.items():
            rows[name] = values
        return rows

    def text(self, rows: Rows) -> str:
        """Return a line for each row."""
        cells = list[list[str]]()
        for name, form in self.formats.items():
            for values in np.atleast_2d(rows[name].T).tolist():
                is_time = name.endswith("_ns")
                cells.append([seconds_text(one) if is_time else format(one, form) for one in values])
        return "".join(f"{self.separator.join(line)}\n" for line in zip(*cells, strict=True))


def columns(rows: Rows, *names: str) -> Iterator[tuple[Any, ...]]:
    """Yield the values of some fields of each row, as Python's numbers and lists."""
    for first in range(0, len(rows), _TOGETHER):
        part = rows[first : first + _TOGETHER]
        yield from zip(*(part[name].tolist() for name in names), strict=True)


def seconds_text(t_ns: int) -> str:
    """Return an instant in seconds with all nine decimals, which a float cannot represent."""
    return f"{t_ns // S_NS}.{t_ns % S_NS:09d}"


POSES = Table(
    np.dtype(
        [
            ("t_ns", "<i8"),
            ("position_m", "<f8", 3),  # of the sensor in the world
            ("quaternion_xyzw", "<f8", 4),  # from the sensor's axes to the world's; w is never negative
            ("velocity_m_s", "<f8", 3),  # relative to the world, in the sensor's axes, as the next
            ("rate_rad_s", "<f8", 3),
        ]
    ),
    ".tum",
    "# t_utc_s x_m y_m z_m qx qy qz qw: world_T_sensor; world east, north, up; "
    "sensor x forward, y left, z up\n",
    {"t_ns": "", "position_m": ".9f", "quaternion_xyzw": ".12f"},
    " ",
)
"""Poses of a sensor; the text is that of the TUM RGB-D benchmark, without velocities."""

_OF_FIXES = {
    "valid": "d",
    "cover": ".4f",  # hidden share of the sky
    "true_latitude_deg": ".10f",
    "true_longitude_deg": ".10f",
    "true_height_m": ".4f",
    "true_east_m_s": ".6f",
    "true_north_m_s": ".6f",
    "latitude_deg": ".10f",
    "longitude_deg": ".10f",
    "speed_m_s": ".6f",
    "course_deg": ".4f",
}
FIXES = Table(
    np.dtype([("t_ns", "<i8"), *((name, "?" if form == "d" else "<f8") for name, form in _OF_FIXES.items())]),
    ".csv",
    f"t_utc_s,{','.join(_OF_FIXES)}\n",
    {"t_ns": "", **_OF_FIXES},
)
"""What a receiver measures and reports in each second."""

INERTIAL = np.dtype(
    [
        ("t_ns", "<i8"),
        ("rate_rad_s", "<f8", 3),  # measured, as the next
        ("force_m_s2", "<f8", 3),  # specific force, acceleration minus gravity
        ("true_rate_rad_s", "<f8", 3),
        ("true_force_m_s2", "<f8", 3),
        ("rate_bias_rad_s", "<f8", 3),
        ("force_bias_m_s2", "<f8", 3),
        ("attitude_xyzw", "<f8", 4),  # that the unit reports; zeros if it reports none
        ("stamp_ns", "<i8"),  # time stamp of the sample, by the unit
    ]
)
_AXES = ("wx_rad_s", "wy_rad_s", "wz_rad_s", "fx_m_s2", "fy_m_s2", "fz_m_s2")
_ATTITUDE = ("qx", "qy", "qz", "qw")


def inertial_table(imu: InertialSection) -> Table:
    """Return the table of an inertial unit, all in its own axes; the text has what the unit reports."""
    header = ["t_utc_s", *_AXES, *(f"true_{axis}" for axis in _AXES), *(f"bias_{axis}" for axis in _AXES)]
    formats = dict.fromkeys((INERTIAL.names or ())[:-2], ".9f")
    if imu.attitude:
        header += _ATTITUDE
        formats["attitude_xyzw"] = ".9f"
    if imu.is_late:
        header.append("stamp_utc_s")
        formats["stamp_ns"] = ""
    return Table(INERTIAL, ".csv", f"{','.join(header)}\n", formats)


@dataclass(frozen=True, slots=True)
class Samples:
    """Rows of a table at a constant rate, sample i at `zero_ns` + i / `rate_hz`."""

    table: Table
    rows: Callable[[int, int], Rows]  # returns samples first .. first + count - 1
    zero_ns: int
    rate_hz: int

    def between(self, start_ns: int, stop_ns: int) -> Rows:
        """Return the samples from `start_ns` on and before `stop_ns`."""
        first = self._count_before(start_ns)
        count = self._count_before(stop_ns) - first
        return self.rows(first, count) if count > 0 else np.zeros(0, self.table.dtype)

    def _count_before(self, t_ns: int) -> int:
        # Sample i lies i * S_NS // rate_hz after sample 0.
        return -(-(t_ns - self.zero_ns) * self.rate_hz // S_NS)


def pose_samples(motion: Motion, start_ns: int, rate_hz: int) -> Samples:
    """Return the samples of a trajectory."""

    def rows(first: int, count: int) -> Rows:
        """Return `count` poses from number `first` on."""
        t_ns = start_ns + np.arange(first, first + count, dtype=np.int64) * S_NS // rate_hz
        return pose_rows(motion.kinematics_at(t_ns))

    return Samples(POSES, rows, start_ns, rate_hz)


def pose_rows(true: Kinematics) -> Rows:
    """Return rows of `POSES`."""
    return POSES.rows(
        true.t_ns,
        position_m=true.world_p_body_m,
        quaternion_xyzw=quaternions(true.world_R_body),
        velocity_m_s=matvec(true.world_R_body.transpose(0, 2, 1), true.world_v_body_m_s),
        rate_rad_s=true.body_w_rad_s,
    )


def quaternions(R: F8) -> F8:
    """Return rotations (..., 3, 3) as unit quaternions x, y, z, w (..., 4); w is never negative."""
    from scipy.spatial.transform import Rotation  # here: the import takes 0.1 s, and few runs need it

    return np.asarray(Rotation.from_matrix(R).as_quat(canonical=True))


def inertial_samples(engine: Engine) -> Samples | None:
    """Return the samples of the inertial unit of a run; None if it has none."""
    scenario = engine.scenario
    imu = engine.parts.imu
    if scenario.imu is None or imu is None:
        return None
    table = inertial_table(scenario.imu)
    return Samples(table, partial(_inertial_rows, table, imu), scenario.start_ns, scenario.imu.rate_hz)


def fix_samples(engine: Engine) -> Samples:
    """Return the samples of the receiver of a run; sample i is the UTC second i."""
    receiver = engine.receiver or make_receiver(engine.scenario, engine.parts, engine.windows)
    return Samples(FIXES, partial(_fix_rows, receiver, engine.scenario.gps), 0, 1)


def _inertial_rows(table: Table, imu: Sampler, first: int, count: int) -> Rows:
    read = imu.read(first, count)
    return table.rows(
        read.t_ns,
        rate_rad_s=read.angular_rate_rad_s,
        force_m_s2=read.specific_force_m_s2,
        true_rate_rad_s=read.true_angular_rate_rad_s,
        true_force_m_s2=read.true_specific_force_m_s2,
        rate_bias_rad_s=read.gyro_bias_rad_s,
        force_bias_m_s2=read.accel_bias_m_s2,
        attitude_xyzw=0.0 if read.world_R_imu is None else quaternions(read.world_R_imu),
        stamp_ns=read.t_ns if read.stamp_ns is None else read.stamp_ns,
    )


def _fix_rows(receiver: Receiver, gps: Gps, first: int, count: int) -> Rows:
    rows = []
    for t_ns in range(first * S_NS, (first + count) * S_NS, S_NS):
        true = receiver.reading(t_ns)
        fix = receiver.fix(t_ns)
        position = to_geodetic(true.antenna_m[None], gps)[0].tolist()
        east_m_s, north_m_s, _ = true.velocity_m_s.tolist()
        reported = fix.latitude_deg, fix.longitude_deg, fix.speed_m_s, fix.course_deg
        rows.append((t_ns, fix.valid, true.cover, *position, east_m_s, north_m_s, *reported))
    return np.array(rows, FIXES.dtype)


class StoredTable:
    """A table in a folder of ground truth, whose rows stay on the disk.

    Raises InputError if the file is missing or no such table.
    """

    def __init__(self, path: Path, dtype: np.dtype[np.void]) -> None:
        self.path = path
        opened = open_input(path, _EXPECTED, InputError, most_bytes=_LONGEST_BYTES)
        with opened as file, parsing(path, _EXPECTED, InputError):
            _ = read_magic(file)
            shape, _, stored = read_array_header_1_0(file)
            self.rows: Rows = np.memmap(file, stored, "r", file.tell(), shape)
        if self.rows.dtype != dtype or self.rows.ndim != 1:
            columns = ", ".join(self.rows.dtype.names or [str(self.rows.dtype)])
            raise InputError(str(path), f"found columns {columns}", _EXPECTED)
        self._check()

    def _check(self) -> None:
        """Refuse rows whose times do not ascend, or with a number that is not finite."""
        before_ns = -FOREVER_NS
        for start in range(0, len(self.rows), _CHECKED):
            rows = self.rows[start : start + _CHECKED]
            later = np.diff(rows["t_ns"], prepend=before_ns) > 0
            sound = later & (rows["t_ns"] <= FOREVER_NS)
            for name in self.rows.dtype.names or ():
                values = rows[name].reshape(len(rows), -1)
                sound &= np.isfinite(values).all(axis=1)
                if name == "quaternion_xyzw":
                    sound &= np.abs((np.minimum(np.abs(values), 2.0) ** 2).sum(axis=1) - 1.0) < _NORM
            if not sound.all():
                row = start + int(sound.argmin())
                found = f"row {row + 1}: {self.rows[row]}"
                raise InputError(str(self.path), found, "ascending times, finite numbers, unit quaternions")
            before_ns = int(rows["t_ns"][-1])

    def between(self, start_ns: int, stop_ns: int) -> Rows:
        """Return the rows from `start_ns` on and before `stop_ns`."""
        start, stop = (
            bisect_left(self.rows, t_ns, key=lambda row: row["t_ns"]) for t_ns in (start_ns, stop_ns)
        )
        return self.rows[start:stop]
