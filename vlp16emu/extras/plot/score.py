"""Trajectory from above, its errors over time and distance, and stems found and missed."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from vlp16emu.extras.plot.sheet import BLUE, GREEN, INK, SOFT, VERMILION, Look, Report

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LOOKS: dict[str, Look] = {
    "found": {"marker": "o", "c": GREEN, "edgecolors": INK, "linewidths": 0.6},
    "missed": {"marker": "X", "c": VERMILION, "edgecolors": "white", "linewidths": 0.6},
    "false": {"marker": "+", "c": INK, "linewidths": 1.6},
}
"""Marks of stems by kind; kinds differ in shape, not only in colour."""
_PX2_PER_CM = 3.0  # area of the mark of a stem, in points squared per cm of DBH
_COLUMNS = 3
_BINS = 8


def draw(figure: "Figure", report: Report) -> None:
    """Draw the trajectory, the stems, or both, from which scores were computed."""
    path = report["path"]
    trees = report["trees"]
    panels: list[Callable[[Axes], None]] = []
    if path:
        panels += [lambda axes: _draw_over(axes, path, "time_s", "time, s")]
        panels += [lambda axes: _draw_over(axes, path, "distance_m", "distance along the true path, m")]
        panels += [lambda axes: _draw_drift(axes, path, report["scores"])]
    if trees:
        panels += [lambda axes: _draw_shares(axes, trees, "true_dbh_m", 100.0, "DBH, cm")]
        panels += [lambda axes: _draw_shares(axes, trees, "range_m", 1.0, "distance from the path, m")]
        panels += [lambda axes: _draw_diameters(axes, trees)]
    rows = -(-len(panels) // _COLUMNS)
    figure.set_size_inches(15, 6.5 + 4.2 * rows)
    figure.suptitle(_title(report))
    grid = figure.add_gridspec(rows + 1, _COLUMNS, height_ratios=(1.5, *[1.0] * rows))
    _draw_plan(figure.add_subplot(grid[0, :]), path, trees)
    for number, panel in enumerate(panels):
        panel(figure.add_subplot(grid[1 + number // _COLUMNS, number % _COLUMNS]))


def _title(report: Report) -> str:
    reference = report["reference"]
    scores = report["scores"]
    subject = (
        f"{reference['title']}, seed {reference['seed']}" if reference else str(report["inputs"]["truth"])
    )
    words = {
        "ate_m": "ATE {:.3g} m",
        "drift_10m_percent": "drift {:.2g} % over 10 m",
        "stem_f1": "stems F1 {:.2f}",
    }
    found = [text.format(scores[name]) for name, text in words.items() if scores.get(name) is not None]
    return f"{subject}: {', '.join(found)}"


def _draw_plan(axes: "Axes", path: Report | None, trees: Sequence[Report]) -> None:
    if path:
        axes.plot(path["true_x_m"], path["true_y_m"], color=INK, lw=2.6, label="true path", gid="true-path")
        look: Look = {"color": BLUE, "lw": 1.6, "ls": (0, (4, 1.5)), "label": "estimate, aligned"}
        axes.plot(path["found_x_m"], path["found_y_m"], gid="found-path", **look)
        axes.plot(path["true_x_m"][0], path["true_y_m"][0], "^", color=INK, ms=10, label="start")
    for kind, look in _LOOKS.items():
        if of_kind := [row for row in trees if row["kind"] == kind]:
            size = [_PX2_PER_CM * 100 * (row["true_dbh_m"] or 0.15) for row in of_kind]
            place = [row["x_m"] for row in of_kind], [row["y_m"] for row in of_kind]
            label = f"{len(of_kind)} stems {'found falsely' if kind == 'false' else kind}"
            axes.scatter(*place, s=size, label=label, gid=f"stems-{kind}", zorder=3, **look)
    axes.set(
        xlabel="east, m", ylabel="north, m", aspect="equal", title="From above; marks of stems grow with DBH"
    )
    axes.set_adjustable("datalim")
    axes.legend(loc="center left")


def _draw_over(axes: "Axes", path: Report, name: str, label: str) -> None:
    error_cm = 100 * np.array(path["error_m"])
    axes.plot(path[name], error_cm, color=BLUE, gid=f"error-over-{name}")
    axes.set(xlabel=label, ylabel="error of the position, cm", title=f"Error over {name.partition('_')[0]}")
    axes.set_ylim(0)


def _draw_drift(axes: "Axes", path: Report, scores: Report) -> None:
    over_m = path["drift_over_m"]
    title = f"Drift over {over_m:g} m of path"
    axes.set(title=title, xlabel="distance at its end, m", ylabel="drift, % of the length")
    if not path["drift_at_m"]:
        axes.text(
            0.5, 0.5, f"path shorter than {over_m:g} m", ha="center", transform=axes.transAxes, color=SOFT
        )
        return
    axes.plot(path["drift_at_m"], path["drift_percent"], color=BLUE, gid="drift")
    mean = scores[f"drift_{over_m:g}m_percent"]
    axes.axhline(mean, color=INK, ls="--", lw=1.2, label=f"mean {mean:.2g} %")
    axes.set_ylim(0)
    axes.legend(loc="upper left")


def _draw_shares(axes: "Axes", trees: Sequence[Report], name: str, unit: float, label: str) -> None:
    """Draw numbers of true stems, found and missed, in classes of a size."""
    sizes_of = {
        kind: np.array(
            [unit * row[name] for row in trees if row["kind"] == kind and row[name] is not None], float
        )
        for kind in ("found", "missed")
    }
    every = np.concatenate(list(sizes_of.values()))
    axes.set(title=f"Stems by {label.partition(',')[0]}", xlabel=label, ylabel="number of true stems")
    if not len(every):
        axes.text(0.5, 0.5, "not known", ha="center", transform=axes.transAxes, color=SOFT)
        return
    edges = np.linspace(np.floor(every.min()), np.ceil(every.max()) + 1e-9, _BINS + 1)
    found, missed = (np.histogram(values, edges)[0] for values in sizes_of.values())
    at = edges[:-1]
    width = np.diff(edges) * 0.9
    axes.bar(at, found, width, align="edge", color=GREEN, label="found", gid=f"found-by-{name}")
    look: Look = {"color": VERMILION, "hatch": "//", "edgecolor": "white", "lw": 0}
    axes.bar(at, missed, width, found, align="edge", label="missed", gid=f"missed-by-{name}", **look)
    for x, hits, misses, wide in zip(at, found, missed, width, strict=True):
        if hits + misses:
            axes.text(
                x + wide / 2,
                hits + misses,
                f"{100 * hits / (hits + misses):.0f} %",
                ha="center",
                va="bottom",
                fontsize=9,
            )
    axes.legend()
    axes.margins(y=0.15)


def _draw_diameters(axes: "Axes", trees: Sequence[Report]) -> None:
    measured = [row for row in trees if row["dbh_error_m"] is not None]
    axes.axhline(0.0, color=INK, lw=1)
    axes.set(title="Diameters", xlabel="true DBH, cm", ylabel="found minus true DBH, cm")
    if not measured:
        axes.text(0.5, 0.6, "none was measured", ha="center", transform=axes.transAxes, color=SOFT)
        return
    both_cm = 100 * np.array([(row["true_dbh_m"], row["dbh_error_m"]) for row in measured])
    axes.scatter(both_cm[:, 0], both_cm[:, 1], s=40, gid="dbh-errors", **_LOOKS["found"])
    bias_cm = float(both_cm[:, 1].mean())
    axes.axhline(bias_cm, color=BLUE, ls="--", lw=1.2, label=f"mean {bias_cm:+.2f} cm")
    axes.legend()
