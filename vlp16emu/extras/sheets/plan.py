"""The plan: crowns, stems, things on the ground, relief and the path, seen from above with north up."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import KDTree

from vlp16emu.extras.palette import colour_of_kind, colour_of_species
from vlp16emu.extras.sheets.section import MARK_LEAD, StandSection
from vlp16emu.types import HeightField
from vlp16emu.world.vectors import places_m

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes


Array = NDArray[np.float64]

INK, SOFT, WALK = "#26302b", "#747e78", "#c8372d"
"""Colours of writing, of what is less important, and of the path."""

_LEAST_STEM_PX = 2.4
"""Stems that would be thinner on paper are drawn this wide, or nobody would see them."""

_SMOOTH_M = 2.0
"""One sigma of the smoothing of contour lines."""

_ARROW_EVERY = 0.12
"""Of the path's length."""

_ROUND_M = (0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
"""Lengths that a scale bar or a contour interval may have."""

_DARK = 0.6
"""Of the light of a face that its edge has."""
_BELOW_PX = 14.0
"""Middle of the scale bar under the plan, where it covers nothing."""


@dataclass(frozen=True, slots=True)
class PlanView:
    """What the plan shows."""

    low_m: Array
    """(2,) south-west corner of the sheet."""
    high_m: Array
    """(2,) north-east corner."""
    path_m: Array
    """(n, 3) sensor positions in order of time; one for a sensor that stands."""
    field_of_view_deg: tuple[float, float]
    """Elevations of the sensor's lowest and highest beam."""
    radius_m: float | None
    """How far around the path things are shown; None where all are."""
    trees: NDArray[np.void]
    """(n,) with `x_m`, `y_m`, `dbh_m`, `crown_width_m` and `species`."""
    species: Mapping[int, str]
    """Names by number."""
    outlines_m: Mapping[str, Sequence[Array]]
    """By kind of thing, (k, 2) each, drawn in this order."""
    names: Sequence[tuple[str, Array]]
    """What is written beside things, and where (2,)."""
    height_m: HeightField
    """Ground."""


def draw_plan(axes: "Axes", plan: PlanView, section: StandSection) -> None:
    """Draw a plan, with the strip of a section marked, into axes whose size is settled."""
    axes.set(xlim=(plan.low_m[0], plan.high_m[0]), ylim=(plan.low_m[1], plan.high_m[1]), aspect="equal", anchor="NW")
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_color("#d8d5cc")
    _draw_ground(axes, plan)
    _draw_things(axes, plan)
    _draw_trees(axes, plan)
    _draw_way(axes, plan.path_m[:, :2])
    _draw_strip(axes, section)
    _draw_scale_and_north(axes, plan)
    for name, place_m in plan.names:
        axes.annotate(
            name, (place_m[0], place_m[1]), xytext=(5, 5), textcoords="offset points", size=8, color=INK, zorder=9
        )


def legend_entries(plan: PlanView) -> "list[Artist]":
    """Make samples of what a plan shows, with names as labels: species first, the most frequent at the top."""
    from matplotlib.lines import Line2D

    def sample(name: str, colour: tuple[int, int, int], marker: str, size: float, alpha: float = 1.0) -> Line2D:
        looks: dict[str, object] = {
            "markerfacecolor": (*_share(colour), alpha),
            "markeredgecolor": _share(colour, _DARK),
        }
        looks |= {"marker": marker, "markersize": size, "markeredgewidth": 0.6}
        return Line2D([], [], linestyle="none", label=name.replace("_", " "), **looks)  # type: ignore[arg-type]

    numbers, stems = np.unique(plan.trees["species"], return_counts=True)
    names = [plan.species[int(numbers[i])] for i in np.argsort(-stems, kind="stable")]
    entries: list[Artist] = [sample(name, colour_of_species(name), "o", 11, 0.6) for name in names]
    entries += [sample(kind, colour_of_kind(kind), "s", 6) for kind, outlines in plan.outlines_m.items() if outlines]
    return [*entries, Line2D([], [], color=WALK, lw=1.6, label="path of the sensor")]


def _draw_ground(axes: "Axes", plan: PlanView) -> None:
    """Contour lines, and the border of the area considered."""
    low, high = plan.low_m, plan.high_m
    cell_m = float((high - low).max()) / 240
    x_m, y_m = np.meshgrid(*(np.arange(a, b + cell_m, cell_m) for a, b in zip(low, high, strict=True)))
    if plan.radius_m is not None:
        grid = np.column_stack([x_m.ravel(), y_m.ravel()])
        gap_m = np.reshape(KDTree(plan.path_m[:, :2]).query(grid)[0], x_m.shape)
        dashes = [(0, (6, 4))]
        axes.contour(x_m, y_m, gap_m, [plan.radius_m], colors=SOFT, linewidths=0.9, linestyles=dashes, zorder=6)
    # Hills and hollows are wanted, not every step: the roughness is smoothed away.
    ground_m = gaussian_filter(plan.height_m(x_m, y_m), _SMOOTH_M / cell_m, mode="nearest")
    interval_m = _round_up_m(float(np.ptp(ground_m)) / 8)
    if np.ptp(ground_m) > interval_m:
        levels = np.arange(np.ceil(ground_m.min() / interval_m), ground_m.max() / interval_m) * interval_m
        lines = axes.contour(
            x_m, y_m, ground_m, levels, colors="#b08d5b", linewidths=0.6, linestyles="solid", alpha=0.8, zorder=1
        )
        axes.clabel(lines, fontsize=6.5, fmt="%g m", inline_spacing=2)


def _draw_things(axes: "Axes", plan: PlanView) -> None:
    """Outlines of everything that is no tree."""
    from matplotlib.collections import PolyCollection

    for kind, outlines in plan.outlines_m.items():
        colour = colour_of_kind(kind)
        faces, edges = (*_share(colour), 0.2 if kind == "ground" else 0.75), (*_share(colour, _DARK), 0.8)
        looks: dict[str, Any] = {"facecolors": [faces], "edgecolors": [edges]}
        axes.add_collection(PolyCollection(list(outlines), linewidths=0.3, zorder=2, **looks), autolim=False)


def _draw_trees(axes: "Axes", plan: PlanView) -> None:
    """Crowns as discs of their width, small ones first, then stems at their diameter."""
    from matplotlib.collections import EllipseCollection

    trees = plan.trees[np.argsort(plan.trees["crown_width_m"], kind="stable")]
    if not len(trees):
        return
    where = places_m(trees, "xy")
    colours = [colour_of_species(plan.species[number]) for number in trees["species"].tolist()]
    least_m = _LEAST_STEM_PX * float(np.ptp(axes.get_xlim())) / axes.get_window_extent().width
    stems_m = np.maximum(trees["dbh_m"], least_m)
    faces, edges = [(*_share(c), 0.42) for c in colours], [(*_share(c, _DARK), 0.75) for c in colours]
    crowns: dict[str, Any] = {"facecolors": faces, "edgecolors": edges, "zorder": 3}
    stems: dict[str, Any] = {"facecolors": [(0.22, 0.16, 0.11)], "edgecolors": ["none"], "zorder": 4}
    at: dict[str, Any] = {"units": "xy", "offsets": where, "offset_transform": axes.transData, "linewidths": 0.5}
    for width_m, looks in ((trees["crown_width_m"], crowns), (stems_m, stems)):
        discs = EllipseCollection(width_m, width_m, np.zeros(len(trees)), **at, **looks)
        axes.add_collection(discs, autolim=False)


def _draw_way(axes: "Axes", way_xy_m: Array) -> None:
    """Draw the path with arrow heads along it, or the place where the sensor stands."""
    axes.plot(*way_xy_m[0], marker="o", ms=6, mfc="white", mec=WALK, mew=1.6, zorder=8)
    if len(way_xy_m) < 2:
        return
    axes.plot(*way_xy_m.T, color=WALK, lw=1.6, zorder=7)
    gone_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way_xy_m, axis=0).T))])
    for share in np.arange(_ARROW_EVERY, 1.0 + 1e-9, (1 - _ARROW_EVERY) / 6):
        head = max(1, int(np.searchsorted(gone_m, share * gone_m[-1] - 1e-9)))
        back = max(0, min(int(np.searchsorted(gone_m, gone_m[head] - 1.0)), head - 1))
        arrow = {"arrowstyle": "-|>", "color": WALK, "lw": 0, "mutation_scale": 13}
        axes.annotate("", way_xy_m[head], way_xy_m[back], arrowprops=arrow, zorder=8)


def _draw_strip(axes: "Axes", section: StandSection) -> None:
    """Outline of the section's strip, with its ends named."""
    half_m = section.depth_m / 2 * section.towards
    ends = section.start_xy_m, section.start_xy_m + section.length_m * section.along
    corners = np.array([ends[0] - half_m, ends[1] - half_m, ends[1] + half_m, ends[0] + half_m])
    axes.plot(*np.concatenate([corners, corners[:1]]).T, color=INK, lw=0.9, ls=(0, (3, 2)), zorder=7)
    for name, end, side in (("A", ends[0], -1), ("B", ends[1], 1)):
        place_m = end + side * MARK_LEAD * section.length_m * section.along
        box = {"boxstyle": "circle,pad=0.15", "fc": "white", "ec": INK, "lw": 0.8}
        axes.text(place_m[0], place_m[1], name, size=9, color=INK, ha="center", va="center", bbox=box, zorder=9)


def _draw_scale_and_north(axes: "Axes", plan: PlanView) -> None:
    """Draw a bar of a round length, and an arrow to the north, below the plan."""
    from matplotlib.patches import Rectangle

    bar_m = _round_up_m(float(plan.high_m[0] - plan.low_m[0]) / 12)
    x_m, pixel = float(plan.low_m[0]), 1.0 / axes.get_window_extent().height
    below, y = axes.get_xaxis_transform(), -_BELOW_PX * pixel
    for i, colour in enumerate((INK, "white")):
        box = Rectangle((x_m + i * bar_m / 2, y - 2.5 * pixel), bar_m / 2, 5 * pixel, transform=below)
        box.set(fc=colour, ec=INK, lw=0.7, clip_on=False)
        axes.add_patch(box)
    words: dict[str, Any] = {"color": INK, "va": "center_baseline", "transform": below}
    axes.text(x_m + 1.08 * bar_m, y, f"{bar_m:g} m", size=8.5, **words)
    arrow = {"arrowstyle": "-|>", "color": INK, "lw": 1.4, "mutation_scale": 12, "shrinkA": 0, "shrinkB": 0}
    ends = (0.995, y + 10 * pixel), (0.995, y - 12 * pixel)
    axes.annotate("", *ends, "axes fraction", arrowprops=arrow)
    axes.text(0.985, y, "N", size=9, ha="right", **words | {"transform": axes.transAxes})


def _round_up_m(length_m: float) -> float:
    return next((length for length in _ROUND_M if length >= length_m), _ROUND_M[-1])


def _share(colour: tuple[int, int, int], light: float = 1.0) -> tuple[float, float, float]:
    red, green, blue = colour
    return light * red / 255, light * green / 255, light * blue / 255
