"""Error against run time by setting of the beam, and differences between worlds by `near_m`."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from vlp16emu.extras.plot.sheet import (
    BLUE,
    GREEN,
    INK,
    ORANGE,
    PURPLE,
    SKY,
    SOFT,
    VERMILION,
    Look,
    Report,
    plain_logarithm,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SERIES = {
    "none": ("one ray", INK, "s", "none"),
    "angle": ("beam errors of LiDAR-Forest", SOFT, "x", "none"),
    "offset": ("", SOFT, "x", "none"),
    "fixed": ("fixed sub-rays", BLUE, "o", "-"),
    "adaptive": ("adaptive sub-rays, by target", VERMILION, "D", "-"),
}
"""Label, colour, marker and line of the settings of a model of the beam."""
_PANELS = {
    "mean_error_m": "mean error, mm\n(a lost or wrong echo counts as the resolution)",
    "range_rmse_m": "RMSE of matched ranges, mm",
}
_WORLD_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
_WORLD_MARKERS = "osD^vP"
_DODGE = 0.13  # offset between statistics of one world, in worlds


def draw(figure: "Figure", report: Report) -> None:
    """Draw errors of the beam with intervals of error and run time, and below them the worlds of a forest."""
    rows = report["rows"]
    worlds = report["foliage"]
    figure.set_size_inches(14, 11.5 if worlds else 6.8)
    errors = rows[0]["errors"]
    title = f"{report['scene']}, seed {report['seed']}: error against run time"
    figure.suptitle(f"{title}, {errors['pulses']} pulses, bars are 95 % intervals")
    grid = figure.add_gridspec(2 if worlds else 1, 2, height_ratios=(1.5, 1) if worlds else None)
    panels = [figure.add_subplot(grid[0, column]) for column in (0, 1)]
    for axes, (name, label) in zip(panels, _PANELS.items(), strict=True):
        axes.set(xscale="log", yscale="log", xlabel="run time, us per pulse on one core", ylabel=label)
        _draw_errors(axes, rows, name)
        plain_logarithm(axes)
    _draw_suggestions(panels[0], rows, report["choices"])
    if any(row["intervals"][name] is None for row in rows for name in _PANELS):
        note = "no bar: the interval is wider than a factor of ten"
        panels[1].text(0.02, 0.02, note, transform=panels[1].transAxes, color=SOFT, fontsize=10)
    panels[1].legend(*panels[0].get_legend_handles_labels(), loc="upper right")
    if worlds:
        _draw_worlds(figure.add_subplot(grid[1, :]), worlds)


def _draw_errors(axes: "Axes", rows: Sequence[Report], name: str) -> None:
    """Draw one error of all settings with intervals; settings that cast the same sub-rays share a label."""
    labels: dict[tuple[str, float], list[Report]] = {}
    for row in rows:
        if row["errors"][name]:  # zero has no place on a logarithmic axis
            labels.setdefault((row["model"], round(row["errors"][name], 6)), []).append(row)
    for model, (label, colour, marker, line) in _SERIES.items():
        of_model = [
            row for (row_model, _), settings in labels.items() if row_model == model for row in settings[-1:]
        ]
        if not of_model:
            continue
        us = np.array([row["us_per_pulse"] for row in of_model])
        half_us = np.array([row["us_spread"] / 2 for row in of_model])
        error_mm = 1e3 * np.array([row["errors"][name] for row in of_model])
        ends_mm = 1e3 * np.array([row["intervals"][name] or (np.nan, np.nan) for row in of_model], float)
        reach_mm = np.abs(ends_mm.T - error_mm)
        look: Look = {"color": colour, "marker": marker, "linestyle": line, "capsize": 3, "elinewidth": 1}
        bars = axes.errorbar(us, error_mm, yerr=reach_mm, xerr=np.minimum(half_us, 0.9 * us), **look)
        bars.set_label(label or "_")
        bars.lines[0].set_gid(f"{name}-{model}")
    for (model, error_m), settings in labels.items():
        words = [row["name"].rpartition("=")[2] for row in settings[:: max(len(settings) - 1, 1)]]
        text = f"{' to '.join(reversed(words))}{' m' if model == 'adaptive' else ''}"
        beneath = model in ("none", "adaptive")
        _write(
            axes,
            text,
            (settings[-1]["us_per_pulse"], 1e3 * error_m),
            beneath=beneath,
            colour=_SERIES[model][1],
        )
        if any(row["in_use"] for row in settings):
            look = {"ms": 19, "mfc": "none", "mec": INK, "mew": 2.2, "ls": "none", "gid": f"{name}-in-use"}
            axes.plot(settings[-1]["us_per_pulse"], 1e3 * error_m, "o", label="in use", **look)


def _draw_suggestions(axes: "Axes", rows: Sequence[Report], suggestions: Sequence[Report]) -> None:
    """Mark the fastest setting for each wanted mean error, with this error."""
    row_of = {row["name"]: row for row in rows}
    label = "suggested for a mean error of at most"
    for suggestion in suggestions:
        look: Look = {"ms": 13, "mfc": "none", "mec": GREEN, "mew": 2.2, "ls": "none"}
        row = row_of[suggestion["take"]]
        wanted_mm = 1e3 * suggestion["wanted_m"]
        place = row["us_per_pulse"], 1e3 * row["errors"]["mean_error_m"]
        axes.plot(*place, "s", label=label, gid=f"suggested-{wanted_mm:g}", **look)
        label = "_"
        style: Look = {"color": GREEN, "fontsize": 10, "fontweight": "bold", "rotation": 90}
        style |= {"ha": "center", "va": "bottom", "textcoords": axes.get_xaxis_transform()}
        style["arrowprops"] = {"arrowstyle": "-", "color": GREEN, "lw": 0.8, "ls": ":"}
        axes.annotate(f"{wanted_mm:g} mm", place, (place[0], 0.02), **style)


def _write(axes: "Axes", text: str, place: tuple[float, float], *, beneath: bool, colour: str) -> None:
    from matplotlib.patheffects import withStroke

    offset, sides = ((-9, -8), ("right", "top")) if beneath else ((9, 6), ("left", "bottom"))
    look: Look = {
        "textcoords": "offset points",
        "fontsize": 10,
        "color": colour,
        "ha": sides[0],
        "va": sides[1],
    }
    axes.annotate(
        text, place, offset, path_effects=[withStroke(linewidth=3, foreground="white")], zorder=5, **look
    )


def _draw_worlds(axes: "Axes", worlds: Sequence[Report]) -> None:
    """Draw differences from the explicit world, the last one, by statistic."""
    explicit = worlds[-1]["means"]
    for number, name in enumerate(explicit):
        scale = 100.0 / explicit[name]["value"] if explicit[name]["value"] else np.nan
        off = [scale * world["means"][name]["off"] for world in worlds]
        half = [scale * (world["means"][name]["half"] or 0.0) for world in worlds]
        at = np.arange(len(worlds)) + _DODGE * (number - (len(explicit) - 1) / 2)
        look: Look = {"fmt": _WORLD_MARKERS[number % 6], "color": _WORLD_COLOURS[number % 6], "capsize": 3}
        bars = axes.errorbar(at, off, yerr=half, label=name.removesuffix(", %").removesuffix(", m"), **look)
        bars.lines[0].set_gid(f"world-{number}")
    axes.axhline(0.0, color=INK, lw=1)
    labels = [f"{_world(world)}\n{world['us_per_pulse']:.2f} us" for world in worlds]
    axes.set_xticks(range(len(worlds)), labels)
    for tick, world in zip(axes.get_xticklabels(), worlds, strict=True):
        if world["in_use"]:
            tick.set_fontweight("bold")
    axes.set(
        ylabel="difference from\nall leaves single, %",
        title="Single leaves up to world.near_m (in use: bold)",
    )
    axes.legend(ncols=len(explicit), loc="upper center", bbox_to_anchor=(0.5, -0.22), frameon=False)


def _world(world: Report) -> str:
    distance = world["name"].partition("=")[2]
    return "all leaves" if distance == "inf" else f"{distance} m"
