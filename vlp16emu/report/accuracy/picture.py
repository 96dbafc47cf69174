"""Error against run time as a picture, with logarithmic axes, where an order is a slope."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from vlp16emu.report.accuracy.rows import Accuracy, Kind, Row, fitted_order, front

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_accuracy"]

_DPI = 100
_SOFT, _IN_USE = "#bbbbbb", "#d62728"
_STYLES = {
    Kind.ONE_RAY: ("#555555", "s"),
    Kind.BEAM_ERROR: ("#9467bd", "x"),
    Kind.FIXED: ("#1f77b4", "o"),
    Kind.ADAPTIVE: ("#2ca02c", "D"),
}


def draw_accuracy(file: BinaryIO, accuracy: Accuracy) -> None:
    """Draw mean error and RMSE of each setting of light against its run time, as PNG.

    Parameters
    ----------
    file : open for writing
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.8), dpi=_DPI, layout="constrained")
    left, right = figure.subplots(1, 2)
    _draw(left, accuracy.rows, lambda row: row.errors.mean_error_m)
    line = front(accuracy.rows)
    left.plot(
        [row.us_per_pulse for row in line],
        [row.errors.mean_error_m for row in line],
        color=_SOFT,
        linewidth=6,
        alpha=0.6,
        zorder=0,
        label="Pareto front",
    )
    _draw_orders(left, accuracy.rows)
    left.set(title="All returns: wrong and lost ones count as the resolution", ylabel="mean error, m")
    left.legend(fontsize=8)
    _draw(right, accuracy.rows, lambda row: row.errors.range_rmse_m)
    right.axhline(accuracy.answer_rmse_m, color=_SOFT, linestyle=":", label="the answer's own error")
    right.set(title="Returns of the right echo", ylabel="range RMSE, m")
    right.legend(fontsize=8)
    figure.suptitle(f"{accuracy.scene}: error against run time, {accuracy.rows[0].errors.pulses} pulses")
    figure.savefig(file, format="png")


def _draw(axes: "Axes", rows: Sequence[Row], error_m: Callable[[Row], float]) -> None:
    """Draw one error of all rows."""
    for kind, (colour, marker) in _STYLES.items():
        own = [row for row in rows if row.kind is kind]
        us, errors = [row.us_per_pulse for row in own], [error_m(row) for row in own]
        spread = np.array([row.us_spread / 2 for row in own])
        line = "-" if kind in (Kind.FIXED, Kind.ADAPTIVE) else ""
        axes.errorbar(us, errors, xerr=spread, color=colour, marker=marker, linestyle=line, label=kind.value)
        for row, x, y in zip(own, us, errors, strict=True):
            axes.annotate(_short(row), (x, y), (4, 5), textcoords="offset points", fontsize=7, color=colour)
    for row in rows:
        if row.in_use:
            place = [row.us_per_pulse], [error_m(row)]
            axes.plot(*place, "o", ms=15, mfc="none", mec=_IN_USE, mew=2, label="in use")
    axes.set(xscale="log", yscale="log", xlabel="us per pulse, one core")
    axes.grid(which="both", alpha=0.2)
    axes.xaxis.set_minor_formatter("")


def _draw_orders(axes: "Axes", rows: Sequence[Row]) -> None:
    """Draw with what power of run time errors fall."""
    for kind in (Kind.FIXED, Kind.ADAPTIVE):
        if (fit := fitted_order(rows, kind)) is not None:
            us = np.array([row.us_per_pulse for row in rows if row.kind is kind])
            us = np.array([us.min() / 1.2, us.max() * 1.2])
            name = f"{kind.value}: error ~ time^-{fit.order:.2f}"
            axes.plot(us, fit.at_1_us_m * us**-fit.order, "--", color=_STYLES[kind][0], lw=1, label=name)


def _short(row: Row) -> str:
    """Last number of a setting, or its last word."""
    return row.name.rpartition("=")[2]
