"""Plan of a stand with stems, path and relief, and the profile along the path; or the plan of a hall."""

from collections import Counter
from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vlp16emu.extras.colours import Rgb, colour_of_kind, colour_of_species
from vlp16emu.extras.plot.sheet import BLUE, INK, SOFT, VERMILION, Look, Report

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PATH: Look = {"color": VERMILION, "lw": 2.4}
_GROUND = "#cdbfa3"
_CONTOUR = "#a08a5f"
_MARKERS = "osD^vPX*hp"
"""Marks of species, the most frequent first: they differ in shape, not only in colour."""
_PX2_PER_CM = 3.2  # area of the mark of a stem, in points squared per cm of DBH
_SIZES_CM = 10, 30, 60  # DBH in the legend
_ASIDE_M = 5.0  # distance from the path up to which stems are in the profile
_MOST_EXAGGERATED = 6.0
_SEEN_SHARE = 0.5  # share of bark from which a stem is drawn as seen: circles need about half of it
_INTERVALS_M = 0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0  # between contour lines
_MOST_CONTOURS = 10


def draw(figure: "Figure", report: Report) -> None:
    """Draw a forest from above and along the path, or a hall from above."""
    if "stems" not in report:
        figure.set_size_inches(11, 9)
        figure.suptitle(_wrap(f"{report['scene']}: {report['title']}", 70))
        _draw_hall(figure.add_subplot(), report)
        return
    stems = report["stems"]
    ground = report["ground"]
    rows, columns = np.shape(ground["heights_m"])
    tall = min(max(10.5 * rows / columns, 5.0), 11.0)
    figure.set_size_inches(14, tall + 5.2)
    path_m = report["path"]["length_m"]
    density = f"{len(stems['id'])} stems within {report['radius_m']:g} m of {path_m:.0f} m of path"
    title = _wrap(f"{report['scene']}, seed {report['seed']}: {report['title']}", 100)
    figure.suptitle(f"{title}\n{density}", fontsize=15)
    looks = _looks(stems["species"])
    plan, side = figure.subplots(2, 1, height_ratios=(tall, 4.2))
    _draw_plan(plan, report, looks)
    _draw_profile(side, report, looks)


def _wrap(text: str, columns: int) -> str:
    return "\n".join(wrap(text, columns))


def _looks(names: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Return colour and marker by species, the most frequent first."""
    ranked = [name for name, _ in Counter(sorted(names)).most_common()]
    return {
        name: (_hex(colour_of_species(name)), _MARKERS[i % len(_MARKERS)]) for i, name in enumerate(ranked)
    }


def _hex(rgb: Rgb) -> str:
    return "#{:02x}{:02x}{:02x}".format(*rgb)


def _draw_plan(axes: "Axes", report: Report, looks: Mapping[str, tuple[str, str]]) -> None:
    from matplotlib.collections import EllipseCollection

    _draw_relief(axes, report["ground"])
    stems = report["stems"]
    profile = report["profile"]
    place_m = np.column_stack([stems["x_m"], stems["y_m"]]).reshape(-1, 2)
    width_m = np.array(stems["crown_width_m"])
    dbh_m = np.array(stems["dbh_m"])
    names = np.array(stems["species"])
    look: Look = {"facecolors": "none", "edgecolors": [looks[name][0] for name in names], "linewidths": 0.9}
    at: Look = {"units": "xy", "offsets": place_m, "offset_transform": axes.transData, "alpha": 0.6}
    crowns = EllipseCollection(width_m, width_m, np.zeros(len(names)), zorder=2, **at, **look)
    crowns.set_gid("crowns")
    axes.add_collection(crowns, autolim=False)
    seen = np.array(stems["bark_seen"]) if "bark_seen" in stems else None
    for name, (colour, marker) in looks.items():
        is_species = names == name
        label = f"{name.replace('_', ' ').capitalize()}, {is_species.sum()}"
        style: Look = {"marker": marker, "edgecolors": INK, "linewidths": 0.7, "zorder": 4}
        faces = (
            colour
            if seen is None
            else [colour if share >= _SEEN_SHARE else "white" for share in seen[is_species]]
        )
        marks = axes.scatter(
            place_m[is_species, 0],
            place_m[is_species, 1],
            s=_areas(dbh_m[is_species]),
            c=faces,
            gid=f"stems-{name}",
            **style,
        )
        axes.scatter([], [], s=_areas(np.array([0.3])), c=colour, label=label, **style)
        marks.set_label("_")
    if seen is not None:
        label = f"under half of its bark seen, {(seen < _SEEN_SHARE).sum()}"
        axes.scatter([], [], s=60, c="white", edgecolors=INK, linewidths=0.7, label=label)
    axes.plot(profile["x_m"], profile["y_m"], label="path of the sensor", gid="path", zorder=5, **_PATH)
    axes.plot(
        profile["x_m"][0],
        profile["y_m"][0],
        "^",
        ms=11,
        mec="white",
        color=VERMILION,
        label="start",
        zorder=6,
    )
    axes.plot([], [], color=SOFT, marker="o", mfc="none", ms=14, ls="none", label="width of a crown")
    for dbh_cm in _SIZES_CM:
        size = _areas(np.array([dbh_cm / 100]))
        axes.scatter([], [], s=size, c="white", edgecolors=INK, linewidths=0.7, label=f"DBH {dbh_cm} cm")
    axes.plot([], [], color=_CONTOUR, lw=1, label="height of the ground, m")
    axes.set(xlabel="east, m", ylabel="north, m", aspect="equal", title="From above")
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), labelspacing=0.8, frameon=False)


def _areas(dbh_m: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(_PX2_PER_CM * 100 * dbh_m)


def _draw_relief(axes: "Axes", ground: Report) -> None:
    heights_m = np.array(ground["heights_m"])
    rows, columns = heights_m.shape
    x_m = ground["west_m"] + ground["cell_m"] * np.arange(columns)
    y_m = ground["south_m"] + ground["cell_m"] * np.arange(rows)
    axes.set(xlim=(x_m[0], x_m[-1]), ylim=(y_m[0], y_m[-1]))
    span_m = float(np.ptp(heights_m))
    interval_m = next((m for m in _INTERVALS_M if span_m / m <= _MOST_CONTOURS), _INTERVALS_M[-1])
    if span_m <= interval_m:
        return
    levels = np.arange(np.ceil(heights_m.min() / interval_m), heights_m.max() / interval_m) * interval_m
    lines = axes.contour(
        x_m, y_m, heights_m, levels, colors=_CONTOUR, linewidths=1, linestyles="solid", zorder=1
    )
    lines.set_gid("relief")
    axes.clabel(lines, fontsize=9, fmt="%g")


def _draw_profile(axes: "Axes", report: Report, looks: Mapping[str, tuple[str, str]]) -> None:
    """Draw ground and sensor along the path, and the trees near it as stems with crowns."""
    from matplotlib.patches import Ellipse

    profile = report["profile"]
    stems = report["stems"]
    along_m = np.array(profile["distance_m"])
    ground_m = np.array(profile["ground_m"])
    near = np.flatnonzero(np.array(stems["aside_m"]) <= _ASIDE_M)
    foot_m, height_m, base_m, wide_m, dbh_m, at_m = (
        np.array(stems[name])[near]
        for name in ("z_m", "height_m", "crown_base_m", "crown_width_m", "dbh_m", "along_m")
    )
    names = [stems["species"][i] for i in near.tolist()]
    top_m = max([ground_m.max() + 6.0, *(foot_m + height_m).tolist()]) + 1.0
    low_m = min([float(ground_m.min()), *foot_m.tolist()])
    axes.set(xlim=(along_m[0] - 3, along_m[-1] + 3), ylim=(low_m - 1.5, top_m))
    for i, name in enumerate(names):
        colour, _ = looks[name]
        middle_m = foot_m[i] + (base_m[i] + height_m[i]) / 2
        crown = Ellipse(
            (at_m[i], middle_m), wide_m[i], height_m[i] - base_m[i], fc=colour, ec=INK, lw=0.5, alpha=0.35
        )
        axes.add_patch(crown)
        axes.plot(
            [at_m[i]] * 2,
            [foot_m[i], foot_m[i] + height_m[i]],
            color=colour,
            lw=1.0 + 8.0 * dbh_m[i],
            zorder=3,
        )
    axes.vlines(at_m, foot_m, foot_m + height_m, color=INK, lw=0.5, zorder=3, gid="profile-stems")
    axes.fill_between(
        along_m,
        low_m - 1.5,
        ground_m,
        color=_GROUND,
        zorder=4,
        label="ground under the path",
        gid="profile-ground",
    )
    sensor_m = np.array(profile["sensor_m"])
    axes.plot(along_m, sensor_m, label="height of the sensor", gid="profile-sensor", zorder=5, **_PATH)
    scale = _exaggeration(axes)
    axes.set_title(
        f"Along the path: trees within {_ASIDE_M:g} m{'' if scale == 1 else f', heights {scale:.1f} times'}"
    )
    axes.set(xlabel="distance along the path, m", ylabel="height, m")
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)


def _exaggeration(axes: "Axes") -> float:
    """Draw heights and lengths on one scale unless the path is too long.

    Returns the scale of heights over lengths.
    """
    length_m, tall_m = (float(np.ptp(ends)) for ends in (axes.get_xlim(), axes.get_ylim()))
    natural = 0.42 * length_m / tall_m  # the panel is 0.42 times as tall as wide
    if natural <= _MOST_EXAGGERATED / 3:
        axes.set_aspect("equal")
        return 1.0
    return natural


def _draw_hall(axes: "Axes", report: Report) -> None:
    from matplotlib.patches import Rectangle

    length_m, width_m, _ = report["hall_m"]
    axes.add_patch(
        Rectangle((-length_m / 2, -width_m / 2), length_m, width_m, fc="none", ec=INK, lw=2, gid="walls")
    )
    for thing in report["named"]:
        (x_m, y_m, _) = thing["place_m"]
        (along_m, across_m, tall_m) = thing["size_m"]
        corner = (x_m - along_m / 2, y_m - across_m / 2)
        colour = _hex(colour_of_kind(thing["kind"]))
        axes.add_patch(Rectangle(corner, along_m, across_m, fc=colour, ec=INK, gid=f"thing-{thing['name']}"))
        text = f"{thing['name']}, {tall_m:.2g} m tall"
        axes.annotate(
            text, (x_m, y_m + across_m / 2), (0, 4), textcoords="offset points", fontsize=9, ha="center"
        )
    x_m, y_m, z_m = report["path"]["start_m"]
    axes.plot(x_m, y_m, "^", ms=12, color=BLUE, label=f"sensor, {z_m:.2f} m above the floor", gid="sensor")
    if report["path"]["length_m"]:
        axes.plot(*report["path"]["end_m"][:2], "v", ms=12, color=BLUE, label="end of its path")
    axes.set(
        xlabel="east, m", ylabel="north, m", aspect="equal", title="From above; rectangles bound the things"
    )
    axes.set(xlim=(-length_m / 2 - 1, length_m / 2 + 1), ylim=(-width_m / 2 - 1, width_m / 2 + 1))
    axes.legend(loc="upper right")
