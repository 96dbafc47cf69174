"""What was flown in a live run: a table of knots with all their digits, read back as the same motion bit by bit."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vlp16emu.engine import Parts
from vlp16emu.engine.windows import STEPS, Batching, Windows
from vlp16emu.errors import TrajectoryError
from vlp16emu.extras.live.knots import STEP_NS, Knots
from vlp16emu.extras.recorded.files import POSE, TIMED_POSES, unit_lengths
from vlp16emu.raycast.caster import Geometry
from vlp16emu.tables import Column, read_table
from vlp16emu.units import S_NS

Array = NDArray[np.float64]

Cell = tuple[int, int, int]
"""Name of a box of the world, for whose sensors a window is opened."""

_RATES = ("vx_m_s", "vy_m_s", "vz_m_s", "wx_rad_s", "wy_rad_s", "wz_rad_s")
_COLUMNS = {
    **TIMED_POSES,
    **{name: Column({name: 1.0}) for name in _RATES},
    "cell": Column({"cell": 1.0}, is_filled=False),
}
FLOWN_HEADER = ",".join(_COLUMNS) + "\n"
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
    """Read a table of knots; `TrajectoryError` if the file is none, or is not whole from its beginning."""
    table = read_table(path, _COLUMNS, "a table of knots", TrajectoryError)
    if len(table) < 2:
        raise TrajectoryError(str(path), f"found {len(table)} knots", "at least 2")
    for number, t_ns in enumerate(table.times_ns("t_s")):
        if t_ns != number * STEP_NS:
            expected = f"{number * STEP_NS / S_NS:.9f}, as knots are {STEP_NS / S_NS:.9f} s apart"
            raise TrajectoryError(table.where(number, "t_s"), f"found {table.cells['t_s'][number]}", expected)
    states = table.numbers(*POSE, *_RATES)
    unit_lengths(table, states[:, 3:7])
    names = enumerate(table.texts("cell"))
    cells = tuple((i, _cell(table.where(i, "cell"), text)) for i, text in names if text or i == 0)
    return Flown(states, cells)


class FlownMotion(Knots):
    """Motion of a body as it was flown; the first knot is at `start_ns`, UTC."""

    moves = True

    def __init__(self, flown: Flown, *, start_ns: int) -> None:
        super().__init__(start_ns, flown.states)
        self.flown, self.run_time_s = flown, self.last_ns / S_NS

    def require_open(self) -> None:
        """Do nothing: what was flown is known."""

    def windows(self, parts: Parts, start_ns: int, batching: Batching, threads: int) -> Windows[Geometry]:
        """Return the windows that were in use; parameters as of `engine.windows.windows_of`."""
        from vlp16emu.extras.live.cells import CellWindows  # here: it names the boxes by `Cell`

        cells = [(number // STEPS, cell) for number, cell in self.flown.cells]
        return CellWindows(parts, start_ns, batching, threads, cells)


def _cell(where: str, text: str) -> Cell:
    """Read the name of a box."""
    try:
        x, y, z = map(int, text.split())
    except ValueError:
        raise TrajectoryError(where, f"found {text!r}", "three whole numbers") from None
    return x, y, z
