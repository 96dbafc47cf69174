"""What was flown in a live run: a table of knots with all their digits, read back as the same motion bit by bit."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import norm
from vlp16emu.engine import Parts
from vlp16emu.engine.windows import STEPS, Batching, Windows
from vlp16emu.errors import TrajectoryError
from vlp16emu.extras.live.knots import STEP_NS, Knots
from vlp16emu.motion.pose import Kinematics
from vlp16emu.motion.pose_files import RATES, UNIT_TOLERANCE, finite, named_cells, seconds_ns
from vlp16emu.raycast.caster import Geometry
from vlp16emu.types import Poses
from vlp16emu.units import S_NS

Array = NDArray[np.float64]

Cell = tuple[int, int, int]
"""Name of a box of the world, for whose sensors a window is opened."""

_STATE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw", *RATES[:-1])
_CELL = RATES[-1]
FLOWN_HEADER = ",".join(["t_s", *_STATE, _CELL]) + "\n"
"""First line of the table."""


@dataclass(frozen=True, slots=True)
class Flown:
    """A table of knots."""

    states: NDArray[np.float64]
    """(n, 13), a step apart, from the first pulse on."""
    cells: tuple[tuple[int, Cell], ...]
    """Knots from which windows of other cells are in use; the first is 0."""


def flown_rows(first: int, states: Array, cells: dict[int, Cell]) -> str:
    """Write knots (n, 13) from number `first` on, each number with all the digits that it needs to be read back as it is."""
    lines = []
    for number, state in enumerate(states.tolist(), start=first):
        seconds, rest_ns = divmod(number * STEP_NS, S_NS)
        cell = " ".join(map(str, cells[number])) if number in cells else ""
        lines.append(f"{seconds}.{rest_ns:09d},{','.join(map(repr, state))},{cell}\n")
    return "".join(lines)


def read_flown(path: Path) -> Flown:
    """Read a table of knots; `TrajectoryError` where the file is none, or is not whole from its beginning."""
    lines = named_cells(path, ["t_s", *_STATE, _CELL], [])
    if len(lines) < 2:
        raise TrajectoryError(str(path), f"found {len(lines)} knots", "at least 2")
    states, cells = np.empty((len(lines), len(_STATE))), list[tuple[int, Cell]]()
    for number, (where, row) in enumerate(lines):
        if seconds_ns(where, row["t_s"]) != number * STEP_NS:
            expected = f"{number * STEP_NS / S_NS:.9f}, as knots are {STEP_NS / S_NS:.9f} s apart"
            raise TrajectoryError(f"{where}, column t_s", f"found {row['t_s']}", expected)
        states[number] = [finite(f"{where}, column {name}", row[name]) for name in _STATE]
        if row[_CELL] or number == 0:
            cells.append((number, _cell(f"{where}, column {_CELL}", row[_CELL])))
    lengths = norm(states[:, 3:7])
    if (off := np.abs(lengths - 1.0) > UNIT_TOLERANCE).any():
        i = int(off.argmax())
        raise TrajectoryError(lines[i][0], f"a quaternion of length {lengths[i]:.6g}", "length 1")
    return Flown(states, tuple(cells))


class FlownMotion:
    """Motion of a body as it was flown; the first knot is at `start_ns`, UTC."""

    moves = True

    def __init__(self, flown: Flown, *, start_ns: int) -> None:
        self.flown = flown
        self._knots = Knots(start_ns, flown.states)
        self.run_time_s = self._knots.last_ns / S_NS

    def require_open(self) -> None:
        """Do nothing: what was flown is known."""

    def windows(self, parts: Parts, start_ns: int, batching: Batching, threads: int) -> Windows[Geometry]:
        """Return the windows that were in use; parameters as of `engine.windows.windows_of`."""
        from vlp16emu.extras.live.cells import CellWindows  # here: it names the boxes by `Cell`

        cells = [(number // STEPS, cell) for number, cell in self.flown.cells]
        return CellWindows(parts, start_ns, batching, threads, cells)

    def poses_at(self, t_ns: NDArray[np.int64]) -> Poses:
        """Poses at UTC instants (n,)."""
        return self._knots.poses_at(t_ns)

    def kinematics_at(self, t_ns: NDArray[np.int64]) -> Kinematics:
        """Poses at UTC instants (n,) with their derivatives."""
        return self._knots.kinematics_at(t_ns)


def _cell(where: str, text: str) -> Cell:
    """Read the name of a box."""
    try:
        x, y, z = map(int, text.split())
    except ValueError:
        raise TrajectoryError(where, f"found {text!r}", "three whole numbers") from None
    return x, y, z
