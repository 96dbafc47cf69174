"""Error against run time: measured settings, what follows for the choice of one, and the picture."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from vlp16emu.extras.accuracy.compare import Errors
from vlp16emu.extras.plots import CYCLE, INK, SOFT, plotted

if TYPE_CHECKING:
    from matplotlib.axes import Axes


WANTED_M = (0.5, 0.2, 0.1, 0.05, 0.03, 0.02, 0.01)


class Kind(StrEnum):
    """Kind of a setting."""

    ONE_RAY = "one ray"
    FIXED = "fixed"
    ADAPTIVE = "adaptive"
    BEAM_ERROR = "beam error"
    POSE = "pose"


@dataclass(frozen=True, slots=True)
class Row:
    """Error and run time of one setting."""

    kind: Kind
    name: str  # setting of a beam as `--set` takes it
    in_use: bool  # whether it is the scene's own
    errors: Errors
    us_per_pulse: float  # run time on one core: of casting and detecting, or for poses of posing and aiming
    us_spread: float  # difference between the slowest and the quickest repeat
    rays_per_pulse: float


@dataclass(frozen=True, slots=True)
class Mean:
    """A mean over pulses."""

    value: float
    off: float  # difference from the explicit world
    half: float  # half of the 95 % interval of that difference

    @property
    def departs(self) -> bool:
        """True if the difference exceeds chance."""
        return abs(self.off) > self.half


@dataclass(frozen=True, slots=True)
class LevelOfDetail:
    """A world cast leaf by leaf to some distance."""

    name: str  # as `--set` takes it
    in_use: bool
    us_per_pulse: float  # run time of casting and detecting on one core
    means: Mapping[str, Mean]


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Errors of a scene by setting."""

    scene: str
    seed: int
    answer_rays: int  # sub-rays of the answer
    answer_rmse_m: float  # error of the answer itself, from two answers with different sub-rays
    rows: tuple[Row, ...]
    poses: tuple[Row, ...]
    """Held poses against a pose per pulse, with the beam of the answer; none if the sensor stands still."""
    foliage: tuple[LevelOfDetail, ...] = ()
    """Worlds cast leaf by leaf to some distances, the explicit one last; none of a hall."""


def front(rows: Sequence[Row]) -> list[Row]:
    """Return the rows that no other beats in both speed and mean error, the quickest first.

    The paper's beam errors do not count: they are there to be compared with, not to be chosen.
    """
    kept = list[Row]()
    for row in sorted(_to_choose(rows), key=lambda row: (row.us_per_pulse, row.errors.mean_error_m)):
        if not kept or row.errors.mean_error_m < kept[-1].errors.mean_error_m:
            kept.append(row)
    return kept


def choices(rows: Sequence[Row]) -> dict[str, float]:
    """Return the quickest settings for some wanted mean errors: by name, the least error in m that each is good for."""
    found: dict[str, float] = {}
    for wanted_m in WANTED_M:
        good = [row for row in _to_choose(rows) if row.errors.mean_error_m <= wanted_m]
        if good:
            found[min(good, key=lambda row: row.us_per_pulse).name] = wanted_m
    return found


def _to_choose(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row.kind is not Kind.BEAM_ERROR]


_SIZE_PX = 1100, 480
_IN_USE = CYCLE[3]
_STYLES = {
    Kind.ONE_RAY: (INK, "s", (6, -10)),
    Kind.BEAM_ERROR: (CYCLE[4], "x", (4, 5)),
    Kind.FIXED: (CYCLE[0], "o", (4, 5)),
    Kind.ADAPTIVE: (CYCLE[2], "D", (-8, -13)),
}
"""Colour, mark, and offset of the label in points; to the left it is right-aligned."""


def draw_accuracy(file: BinaryIO, accuracy: Accuracy) -> None:
    """Draw mean error and RMSE of each setting of the beam against its run time, as PNG."""
    rows = accuracy.rows
    with plotted(file, _SIZE_PX) as figure:
        left, right = figure.subplots(1, 2)
        _draw(left, rows, lambda row: row.errors.mean_error_m)
        us, error_m = zip(*((row.us_per_pulse, row.errors.mean_error_m) for row in front(rows)), strict=True)
        left.plot(us, error_m, color=SOFT, linewidth=6, alpha=0.5, zorder=0, label="Pareto front")
        left.set(title="All returns: wrong and lost ones count as the resolution", ylabel="mean error, m")
        _draw(right, rows, lambda row: row.errors.range_rmse_m)
        right.axhline(accuracy.answer_rmse_m, color=SOFT, linestyle=":", label="the answer's own error")
        right.set(title="Returns of the right echo", ylabel="range RMSE, m")
        for axes in (left, right):
            axes.legend(loc="upper right")
        figure.suptitle(f"{accuracy.scene}: error against run time, {rows[0].errors.pulses} pulses")


def _draw(axes: "Axes", rows: Sequence[Row], error_m: Callable[[Row], float]) -> None:
    for kind, (colour, marker, aside) in _STYLES.items():
        own = [row for row in rows if row.kind is kind]
        us, spread = ([getattr(row, name) for row in own] for name in ("us_per_pulse", "us_spread"))
        line = "-" if kind in (Kind.FIXED, Kind.ADAPTIVE) else ""
        look: dict[str, Any] = {"color": colour, "marker": marker, "linestyle": line, "label": kind.value}
        axes.errorbar(us, [error_m(row) for row in own], xerr=np.array(spread) / 2, **look)
        words: dict[str, Any] = {"fontsize": 7, "color": colour, "ha": "left" if aside[0] > 0 else "right"}
        for row in own:
            place, short = (row.us_per_pulse, error_m(row)), row.name.rpartition("=")[2]
            axes.annotate(short, place, aside, textcoords="offset points", **words)
            if row.in_use:
                axes.plot(*place, "o", ms=15, mfc="none", mec=_IN_USE, mew=2, label="in use")
    axes.set(xscale="log", yscale="log", xlabel="us per pulse, one core")
    axes.grid(which="both", alpha=0.5)
    axes.xaxis.set_minor_formatter("")
