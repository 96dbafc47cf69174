"""Recorded poses in files: TUM, CSV and KITTI.

All functions raise `TrajectoryError` with file and line if a file or a number cannot be read, a matrix is no
rotation, or times do not increase.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from vlp16emu.elementary import matmul, norm
from vlp16emu.errors import TrajectoryError
from vlp16emu.extras.recorded.settings import Recorded
from vlp16emu.tables import Column, Table, read_table
from vlp16emu.types import F8, I8
from vlp16emu.units import S_NS

UNIT_TOLERANCE = 1e-3
"""Tolerance of a quaternion's length and of a matrix times its transpose: the rounding of four decimals."""
_ROUNDS = 3  # from this error to below the last bit: each round squares it
POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
TIMED_POSES = {
    "t_s": Column({"t_s": 1.0}),
    **{name: Column({name: 1.0, name.removesuffix("_m"): 1.0}) for name in POSE},
}  # columns of a table of poses
_TUM = "t x y z qx qy qz qw"
_MATRIX = tuple(f"{row}{column}" for row in "123" for column in "1234")


@dataclass(frozen=True, slots=True)
class RecordedPoses:
    """Poses of a file."""

    where: list[str]  # (n,) file and line of each, for messages
    t_ns: I8  # (n,) time stamps, of any epoch
    position_m: F8  # (n, 3)
    quaternion: F8  # (n, 4) x, y, z, w of unit length; body to the recording's frame


def read_poses(recorded: Recorded) -> RecordedPoses:
    """Read the file of poses, and the file of their times if there is one."""
    path = Path(recorded.file)
    if recorded.format == "kitti":
        return read_kitti(path, recorded.rate_hz or Path(recorded.times_file or ""))
    return read_tum(path) if recorded.format == "tum" else read_trajectory_csv(path)


def read_tum(path: Path) -> RecordedPoses:
    """Read lines of `t x y z qx qy qz qw`, t in seconds (file format of the TUM RGB-D benchmark)."""
    return _timed_poses(read_table(path, TIMED_POSES, _TUM, TrajectoryError, has_header=False))


def read_trajectory_csv(path: Path) -> RecordedPoses:
    """Read a CSV with the columns t_s, x_m, y_m, z_m, qx, qy, qz and qw; others are ignored."""
    return _timed_poses(
        read_table(path, TIMED_POSES, f"a CSV with the columns {', '.join(TIMED_POSES)}", TrajectoryError)
    )


def read_kitti(path: Path, times: Path | float) -> RecordedPoses:
    """Read lines of 12 numbers, the rows of a 3 x 4 pose matrix (KITTI odometry benchmark, development kit).

    `times` is the rate of the poses in Hz, or a file with a time in seconds for each pose, one per line.
    """
    columns = {name: Column({name: 1.0}) for name in _MATRIX}
    table = read_table(path, columns, "the numbers of a 3 x 4 matrix", TrajectoryError, has_header=False)
    matrix = table.numbers(*_MATRIX).reshape(-1, 3, 4)
    turns = matrix[:, :, :3]
    error = np.abs(matmul(turns, turns.transpose(0, 2, 1)) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    volume = (turns[:, 0] * np.cross(turns[:, 1], turns[:, 2])).sum(axis=1)
    for i in np.flatnonzero((error > UNIT_TOLERANCE) | (volume < 0)):
        found = f"a matrix with determinant {volume[i]:.4g}, {error[i]:.2g} off orthonormal"
        raise TrajectoryError(table.where(int(i)), found, f"a rotation, to {UNIT_TOLERANCE:g}")
    return _valid_poses(
        table, _times_ns(times, len(table)), np.column_stack([matrix[:, :, 3], _quaternions(turns)])
    )


def _quaternions(turns: F8) -> F8:
    """Return unit quaternions (n, 4), x, y, z, w, of the rotations nearest to matrices (n, 3, 3).

    Source: Markley, "Unit quaternion from rotation matrix", J. Guidance, Control, and Dynamics 31(2), 2008.
    """
    for _ in range(_ROUNDS):  # Newton's rule for the nearest rotation (Higham 2008, section 8.3)
        turns = matmul(turns, 1.5 * np.eye(3) - 0.5 * matmul(turns.transpose(0, 2, 1), turns))
    trace = turns[:, 0, 0] + turns[:, 1, 1] + turns[:, 2, 2]
    four = np.empty((len(turns), 4, 4))
    for i in range(3):  # each row is the quaternion times four of its components
        j, k = (i + 1) % 3, (i + 2) % 3
        four[:, i, i] = 1.0 + 2.0 * turns[:, i, i] - trace
        four[:, i, j] = four[:, j, i] = turns[:, i, j] + turns[:, j, i]
        four[:, i, 3] = four[:, 3, i] = turns[:, k, j] - turns[:, j, k]
    four[:, 3, 3] = 1.0 + trace
    longest = np.argmax(np.diagonal(four, axis1=1, axis2=2), axis=1)
    rows = four[np.arange(len(turns)), longest]
    return rows / norm(rows)[:, None]


def _times_ns(times: Path | float, count: int) -> list[int]:
    if not isinstance(times, Path):
        return [round(i * S_NS / times) for i in range(count)]
    table = read_table(
        times, {"t_s": Column({"t_s": 1.0})}, "one time in seconds", TrajectoryError, has_header=False
    )
    if len(table) != count:
        raise TrajectoryError(str(times), f"found {len(table)} times", f"{count}, one for each pose")
    return table.times_ns("t_s")


def _timed_poses(table: Table) -> RecordedPoses:
    return _valid_poses(table, table.times_ns("t_s"), table.numbers(*POSE))


def _valid_poses(table: Table, t_ns: Sequence[int], poses: F8) -> RecordedPoses:
    """Return poses (n, 7) with times; TrajectoryError for a bad quaternion or times that do not increase."""
    if len(table) < 2:
        raise TrajectoryError(str(table.path), f"found {len(table)} poses", "at least 2")
    for i, (before, after) in enumerate(pairwise(t_ns), start=1):
        if after <= before:
            late = f"a time {(before - after) / S_NS:g} s before" if after < before else "the time of"
            raise TrajectoryError(table.where(i), f"{late} the pose before", "times that grow")
    lengths = unit_lengths(table, poses[:, 3:])
    where = [table.where(i) for i in range(len(table))]
    return RecordedPoses(where, np.array(t_ns), poses[:, :3].copy(), poses[:, 3:] / lengths[:, None])


def unit_lengths(table: Table, quaternions: F8) -> F8:
    """Return the lengths (n,) of quaternions (n, 4) of a table, which are 1 to `UNIT_TOLERANCE`."""
    lengths = norm(quaternions)
    if (off := np.abs(lengths - 1.0) > UNIT_TOLERANCE).any():
        i = int(off.argmax())
        expected = f"length 1, to {UNIT_TOLERANCE:g}"
        raise TrajectoryError(table.where(i), f"a quaternion of length {lengths[i]:.6g}", expected)
    return lengths
