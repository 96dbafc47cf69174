"""The table of knots of a live run, which gives the same motion bit for bit."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from vlp16emu.engine import Parts
from vlp16emu.engine.windows import STEP_NS, Batching, Windows
from vlp16emu.errors import TrajectoryError
from vlp16emu.extras.live.knots import Knots
from vlp16emu.extras.live.windows import CubeWindows
from vlp16emu.extras.recorded.files import POSE, TIMED_POSES, unit_lengths
from vlp16emu.raycast.caster import Geometry
from vlp16emu.tables import Column, read_table
from vlp16emu.types import F8
from vlp16emu.units import S_NS

_RATES = ("vx_m_s", "vy_m_s", "vz_m_s", "wx_rad_s", "wy_rad_s", "wz_rad_s")
_COLUMNS = {**TIMED_POSES, **{name: Column({name: 1.0}) for name in _RATES}}
FLOWN_HEADER = ",".join(_COLUMNS) + "\n"  # first line of the table


def flown_rows(first: int, states: F8) -> str:
    """Return knots (n, 13) from number `first` on as lines of text, with all digits that a float64 needs."""
    lines = []
    for number, state in enumerate(states.tolist(), start=first):
        seconds, rest_ns = divmod(number * STEP_NS, S_NS)
        lines.append(f"{seconds}.{rest_ns:09d},{','.join(map(repr, state))}\n")
    return "".join(lines)


def read_flown(path: Path) -> F8:
    """Read a table of knots: states (n, 13), a step apart.

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
    return states


class FlownMotion(Knots):
    """Motion from the table `path`, with its first knot at `start_ns`, UTC; errors as in `read_flown`."""

    def __init__(self, path: Path, *, start_ns: int) -> None:
        super().__init__(start_ns, read_flown(path))
        self.run_time_s = self.last_ns / S_NS

    def require_open(self) -> None:
        """Do nothing: the motion is known."""

    def windows(self, parts: Parts, start_ns: int, batching: Batching, threads: int) -> Windows[Geometry]:
        """Return the windows of the run that was flown; parameters as in `engine.windows.windows_of`."""
        builders = ThreadPoolExecutor(threads, "build")
        return CubeWindows(parts, start_ns, batching, threads, self, builders=builders)
