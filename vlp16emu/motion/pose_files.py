"""What the user brings to a motion in files: lines, columns, and recorded poses in TUM, CSV and KITTI.

All functions raise `TrajectoryError` with file and line where a file cannot be read, a line is none of its kind, a number is
not finite, a turn is no rotation, or times do not grow.
"""

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from itertools import pairwise
from pathlib import Path

import numpy as np

from vlp16emu.elementary import matmul, norm
from vlp16emu.errors import TrajectoryError, readable
from vlp16emu.motion.settings import Recorded
from vlp16emu.types import Array, IntArray
from vlp16emu.units import S_NS

UNIT_TOLERANCE = 1e-3
"""Of a quaternion's length and of a matrix times its transpose: what four written decimals leave."""
_ROUNDS = 3
"""From that error to one below the last bit: each round squares it."""
_COLUMNS = ("t_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
_AXES = ("x", "y", "z")
RATES = ("vx_m_s", "vy_m_s", "vz_m_s", "wx_rad_s", "wy_rad_s", "wz_rad_s", "cell")
"""Columns that the table of a live run has besides; who wants its poses alone may leave them there."""
_LARGEST_NS = 2**62


@dataclass(frozen=True, slots=True)
class RecordedPoses:
    """Poses as a file has them."""

    where: list[str]
    """(n,) file and line of each, for messages."""
    t_ns: IntArray
    """(n,) stamps, of whatever epoch."""
    position_m: Array
    """(n, 3)."""
    quaternion: Array
    """(n, 4) x, y, z, w of unit length; body to the recording's frame."""


def read_poses(recorded: Recorded) -> RecordedPoses:
    """Read the file of poses, and that of their times, if there is one."""
    path = Path(recorded.file)
    if recorded.format == "kitti":
        return read_kitti(path, recorded.rate_hz or Path(recorded.times_file or ""))
    return read_tum(path) if recorded.format == "tum" else read_trajectory_csv(path)


def read_tum(path: Path) -> RecordedPoses:
    """Read lines of `t x y z qx qy qz qw`, t in seconds (file format of the TUM RGB-D benchmark)."""
    lines = _words(path, 8, "t x y z qx qy qz qw")
    return _read(path, [(where, [(where, cell) for cell in cells]) for where, cells in lines])


def read_trajectory_csv(path: Path) -> RecordedPoses:
    """Read a CSV with the columns t_s, x_m, y_m, z_m, qx, qy, qz and qw in any order; a live run's has others too."""
    lines = named_cells(path, _COLUMNS, RATES)
    return _read(path, [(where, [(f"{where}, column {name}", row[name]) for name in _COLUMNS]) for where, row in lines])


def read_kitti(path: Path, times: Path | float) -> RecordedPoses:
    """Read lines of 12 numbers, the rows of a 3 x 4 pose matrix (KITTI odometry benchmark, development kit).

    Parameters
    ----------
    times : a file with a time in seconds for each pose, one to a line, or the rate of the poses in Hz
    """
    lines = _words(path, 12, "the 12 numbers of a 3 x 4 matrix")
    numbers = [[finite(where, cell) for cell in cells] for where, cells in lines]
    matrix = np.reshape(numbers, (-1, 3, 4))
    turns = matrix[:, :, :3]
    error = np.abs(matmul(turns, turns.transpose(0, 2, 1)) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    volume = (turns[:, 0] * np.cross(turns[:, 1], turns[:, 2])).sum(axis=1)
    for i in np.flatnonzero((error > UNIT_TOLERANCE) | (volume < 0)):
        found = f"a matrix with determinant {volume[i]:.4g}, {error[i]:.2g} off orthonormal"
        raise TrajectoryError(lines[i][0], found, f"a rotation, to {UNIT_TOLERANCE:g}")
    return _checked(
        path,
        [where for where, _ in lines],
        _times_ns(times, len(lines)),
        np.column_stack([matrix[:, :, 3], _quaternions(turns)]).tolist(),
    )


def _quaternions(turns: Array) -> Array:
    """Quaternions (n, 4), x, y, z, w and about of unit length, of the rotations nearest to matrices (n, 3, 3).

    Source: Markley, "Unit quaternion from rotation matrix", J. Guidance, Control, and Dynamics 31(2), 2008.
    """
    for _ in range(_ROUNDS):  # Newton's rule for the nearest rotation (Higham 2008, section 8.3)
        turns = matmul(turns, 1.5 * np.eye(3) - 0.5 * matmul(turns.transpose(0, 2, 1), turns))
    trace, four = turns[:, 0, 0] + turns[:, 1, 1] + turns[:, 2, 2], np.empty((len(turns), 4, 4))
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
    """Stamps of poses in files without stamps."""
    if not isinstance(times, Path):
        return [round(i * S_NS / times) for i in range(count)]
    lines = _words(times, 1, "one time in seconds")
    if len(lines) != count:
        raise TrajectoryError(str(times), f"found {len(lines)} times", f"{count}, one for each pose")
    return [seconds_ns(where, cells[0]) for where, cells in lines]


def seconds_ns(where: str, text: str) -> int:
    """Nanoseconds of a time in seconds, every digit of it: float64 keeps UTC to a microsecond only."""
    try:
        t_ns = Decimal(text).scaleb(9)
    except InvalidOperation:
        raise TrajectoryError(where, f"found {text!r}", "a time in seconds") from None
    if not t_ns.is_finite() or abs(t_ns) > _LARGEST_NS:
        raise TrajectoryError(where, f"found {text}", f"at most {_LARGEST_NS // S_NS} s")
    return int(t_ns.to_integral_value())


def _read(path: Path, lines: Sequence[tuple[str, Sequence[tuple[str, str]]]]) -> RecordedPoses:
    """Read the cells of each line, which are those of `_COLUMNS`, each with what error lines call it."""
    t_ns = [seconds_ns(*cells[0]) for _, cells in lines]
    return _checked(
        path, [where for where, _ in lines], t_ns, [[finite(*cell) for cell in cells[1:]] for _, cells in lines]
    )


def _checked(path: Path, where: list[str], t_ns: list[int], numbers: list[list[float]]) -> RecordedPoses:
    """Refuse what is no rotation, and time that does not go on."""
    if len(where) < 2:
        raise TrajectoryError(str(path), f"found {len(where)} poses", "at least 2")
    for i, (before, after) in enumerate(pairwise(t_ns), start=1):
        if after <= before:
            late = f"a time {(before - after) / S_NS:g} s before that of" if after < before else "the time of"
            raise TrajectoryError(where[i], f"{late} the pose before", "times that grow")
    table = np.array(numbers)
    lengths = norm(table[:, 3:])
    if (off := np.abs(lengths - 1.0) > UNIT_TOLERANCE).any():
        i = int(off.argmax())
        raise TrajectoryError(where[i], f"a quaternion of length {lengths[i]:.6g}", f"length 1, to {UNIT_TOLERANCE:g}")
    return RecordedPoses(where, np.array(t_ns), table[:, :3].copy(), table[:, 3:] / lengths[:, None])


def finite(where: str, text: str) -> float:
    """Read a number that is finite."""
    try:
        number = float(text)
    except ValueError:
        raise TrajectoryError(where, f"found {text!r}", "a number") from None
    if not math.isfinite(number):
        raise TrajectoryError(where, f"found {text}", "a finite number")
    return number


def _words(path: Path, count: int, expected: str) -> list[tuple[str, list[str]]]:
    """File and number of each line, and its `count` words; lines that are empty or begin with # are left out."""
    with readable(path, expected, TrajectoryError):
        text = path.read_text(encoding="utf-8-sig")
    lines = []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells, where = line.split(), f"{path}, line {number}"
        if len(cells) != count:
            raise TrajectoryError(where, f"found {len(cells)} words", expected)
        lines.append((where, cells))
    return lines


def named_cells(path: Path, needed: Sequence[str], optional: Sequence[str]) -> list[tuple[str, dict[str, str]]]:
    """File and number of each line of a CSV with a header, and its cells by the name of their column.

    The delimiter is a semicolon or a tab where the header has one, and a comma otherwise. `x`, `y` and `z` stand for
    `x_m`, `y_m` and `z_m`.
    """
    expected = f"a CSV with the columns {', '.join(needed)}"
    with readable(path, expected, TrajectoryError), path.open(encoding="utf-8-sig", newline="") as file:
        header = file.readline()
        delimiter = next(mark for mark in ";\t," if mark in header or mark == ",")
        known = [*needed, *optional]
        names = [name.strip().lower() for name in next(csv.reader([header], delimiter=delimiter), [])]
        names = [f"{name}_m" if name in _AXES and f"{name}_m" in known else name for name in names]
        if not set(names) & set(known):  # some other file; nothing of it is shown
            raise TrajectoryError(f"{path}, line 1", "none of the columns", expected)
        for name in [*names, *needed]:
            if names.count(name) != 1 or name not in known:
                found = f"{names.count(name)} columns {name!r}" if name in known else f"unknown column {name!r}"
                raise TrajectoryError(f"{path}, line 1", found, f"each of {', '.join(known)} once")
        reader = csv.reader(file, delimiter=delimiter)
        rows = []
        for cells in reader:
            where = f"{path}, line {reader.line_num + 1}"
            if not any(cell.strip() for cell in cells):
                continue
            if len(cells) != len(names):
                raise TrajectoryError(where, f"found {len(cells)} cells", f"{len(names)}, as in line 1")
            rows.append((where, dict(zip(names, (cell.strip() for cell in cells), strict=True))))
    return rows
