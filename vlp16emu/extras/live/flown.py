"""The table of knots of a live run, which gives the same motion bit for bit, and the windows that were in use.

The bytes of a pulse depend on the window that it is cast in, through rounding and the place where the medium
begins. A live run does not know its path, so its windows belong to boxes of the world: they change only at
the start of ordinary blocks, a window depends on the name of its box alone, and the table of knots has these
names.
"""

import math
import os
import sys
from bisect import bisect_right
from collections.abc import Hashable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vlp16emu.elementary import norm
from vlp16emu.engine import Parts, window_of
from vlp16emu.engine.windows import STEPS, Batching, Windows
from vlp16emu.errors import TrajectoryError
from vlp16emu.extras.live.knots import STEP_NS, Knots
from vlp16emu.extras.recorded.files import POSE, TIMED_POSES, unit_lengths
from vlp16emu.raycast.caster import Geometry, caster
from vlp16emu.tables import Column, read_table
from vlp16emu.types import F8
from vlp16emu.units import S_NS

if TYPE_CHECKING:
    from vlp16emu.extras.live.motion import LiveMotion

Cell = tuple[int, int, int]  # name of a box of the world, for whose sensors a window is opened

_RATES = ("vx_m_s", "vy_m_s", "vz_m_s", "wx_rad_s", "wy_rad_s", "wz_rad_s")
_RATE_COLUMNS = {name: Column({name: 1.0}) for name in _RATES}
_COLUMNS = {**TIMED_POSES, **_RATE_COLUMNS, "cell": Column({"cell": 1.0}, is_filled=False)}
FLOWN_HEADER = ",".join(_COLUMNS) + "\n"  # first line of the table


def flown_rows(first: int, states: F8, cells: dict[int, Cell]) -> str:
    """Return knots (n, 13) from number `first` on as lines of text, with all digits that a float64 needs."""
    lines = []
    for number, state in enumerate(states.tolist(), start=first):
        seconds, rest_ns = divmod(number * STEP_NS, S_NS)
        cell = " ".join(map(str, cells[number])) if number in cells else ""
        lines.append(f"{seconds}.{rest_ns:09d},{','.join(map(repr, state))},{cell}\n")
    return "".join(lines)


def read_flown(path: Path) -> tuple[F8, dict[int, Cell]]:
    """Read a table of knots: states (n, 13), a step apart, and cells by the knot from which their windows are in use.

    Raises TrajectoryError if the file is not such a table, or lacks knots from its beginning on.
    """
    table = read_table(path, _COLUMNS, "a table of knots", TrajectoryError)
    if len(table) < 2:
        raise TrajectoryError(str(path), f"found {len(table)} knots", "at least 2")
    for number, t_ns in enumerate(table.times_ns("t_s")):
        if t_ns != number * STEP_NS:
            expected = f"{number * STEP_NS / S_NS:.9f}, as knots are {STEP_NS / S_NS:.9f} s apart"
            raise TrajectoryError(table.where(number, "t_s"), f"found {table.cells['t_s'][number]}", expected)
    states = table.numbers(*POSE, *_RATES)
    unit_lengths(table, states[:, 3:7])
    cells = dict[int, Cell]()
    for i, text in enumerate(table.texts("cell")):
        if text or i == 0:
            try:
                x, y, z = map(int, text.split())
            except ValueError:
                raise TrajectoryError(
                    table.where(i, "cell"), f"found {text!r}", "three whole numbers"
                ) from None
            cells[i] = x, y, z
    return states, cells


class FlownMotion(Knots):
    """Motion of a body from the table `path`; the first knot is at `start_ns`, UTC. Errors as in `read_flown`."""

    def __init__(self, path: Path, *, start_ns: int) -> None:
        states, self.cells = read_flown(path)
        super().__init__(start_ns, states)
        self.run_time_s = self.last_ns / S_NS

    def require_open(self) -> None:
        """Do nothing: the motion is known."""

    def windows(self, parts: Parts, start_ns: int, batching: Batching, threads: int) -> Windows[Geometry]:
        """Return the windows that were in use; parameters as in `engine.windows.windows_of`."""
        cells = [(number // STEPS, cell) for number, cell in self.cells.items()]
        return CellWindows(parts, start_ns, batching, threads, cells)


_WIDE_M = 16.0  # size of a box on the map, and its height
_HIGH_M = 32.0
_ASIDE_M = (
    8.0  # margin around its box in which a window is valid: at 3 m/s there are 2 s to open the next one
)
_APART_M = 2.0
"""Distance between the lines that a window is opened along: each place is within the 1 m that the medium
allows for."""
# margin left when the run waits for the next window: a block lasts 0.1 s
_SPARE_M = 2.0
_SPARE_S = 0.15
_EXPECTED_S = 1.0  # look-ahead to the place whose window is opened

_LATE_BLOCKS = 6
"""Steps of delay, 32 ms, from which all late steps are left out: receivers need recent packets."""
_NICE = 10
"""Niceness of threads that open windows of a live run above the casting threads, which then get nine tenths
of a core."""

_Name = tuple[Cell, int]  # box, and segment of time if trees sway


def cell_of(place_m: F8) -> Cell:
    """Return the name of the box that contains a place (3,)."""
    x, y, z = np.floor(place_m / [_WIDE_M, _WIDE_M, _HIGH_M]).astype(int).tolist()
    return x, y, z


def track_of(cell: Cell, arm_m: float) -> F8:
    """Return positions (n, 3) all over a box and around it, for sensors up to `arm_m` from the body."""
    aside_m = _ASIDE_M + arm_m
    lines = 1 + math.ceil((_WIDE_M + 2 * aside_m) / _APART_M)
    x_m = cell[0] * _WIDE_M - aside_m + np.repeat(np.arange(lines), 2) * _APART_M
    ends_m = np.array([-aside_m, _WIDE_M + aside_m, _WIDE_M + aside_m, -aside_m])
    y_m = cell[1] * _WIDE_M + np.resize(ends_m, 2 * lines)
    return np.column_stack([x_m, y_m, np.full(2 * lines, (cell[2] + 0.5) * _HIGH_M)])


class CellWindows(Windows[Geometry]):
    """The world in windows of boxes; parameters as in `windows_of`, and the box in use by first block."""

    kept = 4

    def __init__(
        self, parts: Parts, start_ns: int, batching: Batching, threads: int, cells: list[tuple[int, Cell]]
    ) -> None:
        built = caster(parts.world, ThreadPoolExecutor(threads, "build", self.yielding))
        arm_m = max(float(norm(np.array(unit.mount.lever_arm_m))) for unit in parts.units)

        def open_cell(name: _Name) -> Geometry:
            cell, segment = name
            return built.open(window_of(parts, start_ns, batching, segment, track_of(cell, arm_m)))

        super().__init__(open_cell, batching, moves=True, threads=threads)
        self.cells = cells
        self._sways = parts.wind is not None
        self._segment = batching.segment

    def name_of(self, block: int) -> Hashable:
        """Return the name of the window of a block."""
        at = bisect_right(self.cells, block // self._parts, key=lambda change: change[0])
        return self._named(self.cells[max(at, 1) - 1][1], block)

    def _named(self, cell: Cell, block: int) -> _Name:
        return cell, block // self._segment if self._sways else 0


class LiveWindows(CellWindows):
    """Windows of a run that is being flown: the next one is opened as the body comes near, and used when it is open."""

    def __init__(
        self, parts: Parts, start_ns: int, batching: Batching, threads: int, motion: "LiveMotion"
    ) -> None:
        super().__init__(parts, start_ns, batching, threads, [])
        self._motion = motion
        self.decided = -1  # last ordinary block whose window is decided
        self.left_out = 0  # blocks that were not cast because their time was over

    @staticmethod
    def yielding() -> None:
        """Lower the priority of a thread that opens windows: the next window can wait, casting cannot."""
        if sys.platform == "linux":
            os.nice(_NICE)

    @property
    def lead(self) -> int:
        """Return 0 blocks: their place is not known."""
        return 0

    def at_block(self, block: int) -> Future[Geometry]:
        """Return the window of a block; for past blocks the window in which they were, or would have been, cast."""
        if block // self._parts > self.decided:
            self.decided = block // self._parts
            self._decide(block)
        return super().at_block(block)

    def is_here(self) -> bool:
        """Return True if the window in use is valid at the present position of the body."""
        state = self._motion.state
        return _serves(self.cells[-1][1], state[:3], state[7:10])

    def begin_again(self) -> None:
        """Forget the windows that were in use, for a run that begins again."""
        self.cells.clear()
        self.decided = -1
        self.left_out = 0

    def runs(self, blocks: range, together: int, threads: int) -> Iterator[range]:  # noqa: ARG002  # one at a time with any number of threads
        """Yield blocks one by one, so that packets do not wait for each other, and skip to the present if they are too late."""
        block = blocks.start
        while block < blocks.stop:
            late = self._motion.elapsed_ns // self._block_ns - block
            if late > _LATE_BLOCKS:
                self.left_out += min(late, blocks.stop - block)
                block += late
                continue
            yield range(block, block + 1)
            block += 1

    def _decide(self, block: int) -> None:
        state = self._motion.state
        place_m = state[:3]
        velocity_m_s = state[7:10]
        wanted = cell_of(place_m + _EXPECTED_S * velocity_m_s)
        if not _serves(wanted, place_m, velocity_m_s):
            wanted = cell_of(place_m)
        if self._sways and block % self._segment >= self._segment - self._segment * 3 // 8:
            self._opened(self._named(wanted, block + self._segment))
        if not self.cells:
            self.cells.append((self.decided, wanted))
        elif wanted != self.cells[-1][1]:
            is_open = self._opened(self._named(wanted, block)).done()
            if is_open or not self.is_here():
                self.cells.append((self.decided, wanted))


def _serves(cell: Cell, place_m: F8, velocity_m_s: F8) -> bool:
    middle_m = (np.array(cell[:2]) + 0.5) * _WIDE_M
    spare_m = _SPARE_M + _SPARE_S * float(norm(velocity_m_s))
    return bool((np.abs(place_m[:2] - middle_m) <= _WIDE_M / 2 + _ASIDE_M - spare_m).all())
