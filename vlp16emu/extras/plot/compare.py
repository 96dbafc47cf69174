"""Histograms of two captures side by side, and the distances of their statistics."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vlp16emu.extras.plot.sheet import BLUE, INK, SOFT, VERMILION, Look, Report, plain_logarithm

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLUMNS = 3
_MOST_DISTANCES = 14  # statistics with a bar, the most different first
_LOGARITHMIC = 5.0  # distance from which they are drawn on a logarithmic axis
_PAPER = {"boxstyle": "square,pad=0.1", "fc": "white", "ec": "none"}
_LOOKS: dict[str, Look] = {
    "first": {"color": BLUE, "alpha": 0.35, "fill": True, "lw": 0},
    "second": {"color": VERMILION, "lw": 2.0},
}


def draw(figure: "Figure", report: Report) -> None:
    """Draw each histogram of both captures in one panel, and bars of the greatest distances below."""
    histograms = report["histograms"]
    rows = -(-len(histograms) // _COLUMNS)
    figure.set_size_inches(15, 4.0 * rows + 5.5)
    names = [Path(file).name for file in report["files"]]
    figure.suptitle(f"{names[0]} (blue, filled) and {names[1]} (red line)")
    parts: Any = figure.subfigures(2, 1, height_ratios=(4.0 * rows, 5.0))
    upper, lower = parts
    for number, histogram in enumerate(histograms):
        _draw_histogram(upper.add_subplot(rows, _COLUMNS, number + 1), histogram, names, number)
    _draw_distances(lower.add_subplot(), report)


def _draw_histogram(axes: "Axes", histogram: Report, names: list[str], number: int) -> None:
    for capture, look in _LOOKS.items():
        shares = histogram[capture]
        name = names[capture == "second"]
        if shares is None:
            axes.plot([], [], color=look["color"], label=f"{name}: none")
            continue
        label = f"{name}: {histogram[f'{capture}_values']}"
        axes.stairs(
            100 * np.array(shares),
            histogram["edges"],
            label=label,
            gid=f"histogram-{number}-{capture}",
            **look,
        )
    axes.set(title=histogram["name"].capitalize(), xlabel=histogram["unit"], ylabel="share, %")
    axes.set_xlim(histogram["edges"][0], histogram["edges"][-1])
    axes.margins(y=0.25)  # room for the legend
    axes.set_ylim(0)
    axes.legend(fontsize=10, loc="upper right")


def _draw_distances(axes: "Axes", report: Report) -> None:
    far = sorted(report["statistics"], key=lambda row: -row["distance"])[:_MOST_DISTANCES]
    names = [row["text"] for row in far]
    colours = [VERMILION if row["apart"] else SOFT for row in far]
    bars = axes.barh(range(len(far)), [row["distance"] for row in far], color=colours, height=0.7)
    for bar, row in zip(bars, far, strict=True):
        bar.set_gid(f"distance-{row['name']}")
        text = f"{row['first']:.3g} and {row['second']:.3g}"
        axes.annotate(
            text,
            (row["distance"], bar.get_y() + 0.35),
            (6, 0),
            textcoords="offset points",
            va="center",
            fontsize=10,
            bbox=_PAPER,
        )
    axes.set_yticks(range(len(far)), names, fontsize=10)
    axes.invert_yaxis()
    axes.axvline(1.0, color=INK, lw=1.2, ls="--")
    axes.grid(visible=False, axis="y")
    counts = f"{len(report['apart'])} of {len(report['statistics'])}"
    axes.set_title(
        f"Greatest differences of statistics: {counts} exceed those of real units (dashed), with both values"
    )
    axes.set_xlabel("difference as a multiple of the spread of real units")
    greatest = max([1.0, *(row["distance"] for row in far)])
    if greatest > _LOGARITHMIC:
        axes.set_xscale("log")
        axes.set_xlim(0.1, 3 * greatest)
        plain_logarithm(axes, "x")
    else:
        axes.set_xlim(0, 1.25 * greatest)
