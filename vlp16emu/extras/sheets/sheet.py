"""Files that `vlp16emu forest` writes: inventory, stems, ground, digital twin; and plan and section on one sheet."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import KDTree

from vlp16emu.extras.camera import Orthographic, look
from vlp16emu.extras.plots import colour_of_kind, colour_of_species, plotted, surface_colours
from vlp16emu.extras.sheets.survey import Survey, subtitle_of, summary_of, survey
from vlp16emu.forest.ground.dem import write_ascii
from vlp16emu.forest.plants.stem import STEM_CIRCLE
from vlp16emu.forest.stand.inventory import write_csv
from vlp16emu.forest.stand.twin import AllNear, Grow, cut_out, write_glb
from vlp16emu.output import OutputFile
from vlp16emu.raycast.caster import Geometry, caster
from vlp16emu.scenario import Scenario
from vlp16emu.types import F8, U1, HeightField
from vlp16emu.world.vectors import places_m

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

MARK_LEAD = 0.02  # share of a strip's length between its ends and the marks that name them on a plan

_PAPER_RGB, _SOIL = np.array([252.0, 251.0, 248.0]), np.array([196.0, 178.0, 150.0])
_DOTS = 3  # rays per pixel along either axis; a pixel is their mean
_HAZE = 0.55  # share of the paper's colour in the farthest things
_DARKEST = 0.6  # brightness of a surface seen edge on
_LEAD = 0.06  # share of a strip's length that lies before the path begins, and after it leaves
_ROWS = 8  # rows of pixels cast at once; casters take rays by the eight
_SECTION_M = 60.0
"""Length of a section, the classic one of forest profile diagrams (Davis and Richards 1933: 200 ft by 25 ft)."""
_DEPTHS_M, _ENOUGH_TREES = (8.0, 12.0, 20.0, 30.0), 25
"""A section takes the first of these depths in which so many trees stand, or else the last."""
_OVERHANG_M = 15.0  # how far crowns may reach out of the strip in which their trees stand
_LEAD_M = 6.0  # trees this far beyond the ends of a section may have crowns that reach into it
_BELOW_M, _ABOVE_M, _LEAST_HEIGHT_M = 1.5, 0.8, 6.0
"""How far a section reaches below the lowest ground and above the highest top, and its least height."""
_INSIDE_M = 0.01  # how far behind a hall's wall its section begins


@dataclass(frozen=True, slots=True)
class StandSection:
    """A strip of the world, seen level and from the side."""

    start_xy_m: F8  # (2,) left end of the strip's middle line
    along: F8  # (2,) unit vector to the right of the picture; the view is to the left of it
    length_m: float
    depth_m: float  # width of the strip, half of it on either side of its middle line
    low_m: float
    high_m: float  # heights in the world between which it is drawn

    @property
    def towards(self) -> F8:
        """(2,) unit vector into the picture."""
        return np.array([-self.along[1], self.along[0]])

    def holds(self, xy_m: F8, lead_m: float) -> NDArray[np.bool_]:
        """Return which points (n, 2) lie in the strip, or beyond its ends by less than `lead_m`."""
        along_m, into_m = self.coordinates(xy_m)
        lengthwise = (along_m >= -lead_m) & (along_m <= self.length_m + lead_m)
        return np.asarray(lengthwise & (np.abs(into_m) <= self.depth_m / 2))

    def within(self, low_m: F8, high_m: F8) -> "StandSection":
        """Return the strip, shortened about its middle until its ends and their marks lie in a rectangle with corners (2,)."""
        middle_m = self.start_xy_m + self.length_m / 2 * self.along
        room_m = np.minimum(middle_m - low_m, high_m - middle_m)
        reach_m = np.divide(room_m, np.abs(self.along), out=np.full(2, np.inf), where=self.along != 0).min()
        length_m = min(self.length_m, 2 * float(reach_m) / (1 + 4 * MARK_LEAD))
        return replace(self, start_xy_m=middle_m - length_m / 2 * self.along, length_m=length_m)

    def coordinates(self, xy_m: F8) -> tuple[F8, F8]:
        """Return distances of points (n, 2) along the strip and into it, 0 at its middle line."""
        offset = xy_m - self.start_xy_m
        return offset @ self.along, offset @ self.towards


def section_of(seen: Survey) -> StandSection:
    """Lay the section of a survey: a hall from its southern wall, a forest along the path, deep enough to hold some trees."""
    if seen.hall is not None:
        length_m, width_m, height_m = seen.hall.size_m
        start_xy_m, along = np.array([-length_m / 2, 0.0]), np.array([1.0, 0.0])
        return StandSection(start_xy_m, along, length_m, width_m - 2 * _INSIDE_M, -_BELOW_M, height_m)
    foot_m = places_m(seen.trees, "xy")
    for depth_m in _DEPTHS_M:
        section = strip_along(seen.path_m, _SECTION_M, depth_m).within(*seen.bounds_m)
        holds = section.holds(foot_m, _LEAD_M)
        if holds.sum() >= _ENOUGH_TREES:
            break
    line_m = np.linspace(0.0, section.length_m, 61)[:, None] * section.along + section.start_xy_m
    strip_m = np.concatenate([line_m + side * section.depth_m / 2 * section.towards for side in (-1, 0, 1)])
    ground_m = seen.bare.height_m(strip_m[:, 0], strip_m[:, 1])
    tops_m = (seen.trees["z_m"] + seen.trees["height_m"])[holds]
    top_m = max([*tops_m.tolist(), float(ground_m.max()) + _LEAST_HEIGHT_M]) + _ABOVE_M
    return replace(section, low_m=float(ground_m.min()) - _BELOW_M, high_m=top_m)


def strip_along(path_m: F8, length_m: float, depth_m: float) -> StandSection:
    """Lay a strip along the beginning of a path (n, 3), from west to east if the sensor stands still.

    A path that is shorter lies in the middle of the strip. The strip's heights are still those of the path.
    """
    xy_m = path_m[:, :2]
    gone_m = np.hypot(*(xy_m - xy_m[0]).T)
    beyond = np.flatnonzero(gone_m > length_m * (1 - 2 * _LEAD))
    end = int(beyond[0]) if len(beyond) else int(gone_m.argmax())
    along = (xy_m[end] - xy_m[0]) / gone_m[end] if gone_m[end] > 0 else np.array([1.0, 0.0])
    start_xy_m = (xy_m[0] + xy_m[end]) / 2 - length_m / 2 * along
    low_m, high_m = float(path_m[:, 2].min()), float(path_m[:, 2].max())
    return StandSection(start_xy_m, along, length_m, depth_m, low_m, high_m)


def draw_stand(seen: Survey, section: StandSection, pixels_per_m: float) -> U1:
    """Draw what stands in a section of a survey: (rows, columns, 3)."""
    window, overhang_m = seen.window, 0.0
    shape: Grow = seen.world.shape
    if seen.hall is None:
        overhang_m = _OVERHANG_M
        feet_m = [places_m(seen.trees, "xy"), *(one.place_m[None, :2] for one in seen.things)]
        ids = np.array([*seen.trees["id"].tolist(), *(one.instance for one in seen.things)], np.uint32)
        wanted = ids[section.holds(np.concatenate(feet_m), _LEAD_M)]
        window, shape = cut_out(window, shape, instances=wanted, inside=lambda xy_m: section.holds(xy_m, _LEAD_M))
    with ThreadPoolExecutor() as workers:
        geometry = caster(AllNear(window, shape), workers).open(window)
    colours = surface_colours(seen.window.surfaces, seen.species)
    return draw_section(geometry, section, overhang_m, colours, seen.bare.height_m, pixels_per_m)


def draw_section(
    geometry: Geometry,
    section: StandSection,
    overhang_m: float,
    colours: U1,
    height_m: HeightField,
    pixels_per_m: float,
) -> U1:
    """Draw what stands in the strip, whole, and the ground of the strip, cut open at its near side: (rows, columns, 3).

    Parameters
    ----------
    geometry : with nothing in it that stands before or behind the strip
    overhang_m : how far crowns may reach out of the strip in which their trees stand
    colours : (m, 3) of its surfaces
    height_m : ground, below which the cut shows soil
    """
    columns, rows = (round(m * pixels_per_m) for m in (section.length_m, section.high_m - section.low_m))
    axes = np.array([[*section.along, 0.0], [0.0, 0.0, 1.0], [*-section.towards, 0.0]])
    left_m, near_m = section.start_xy_m @ section.along, section.depth_m / 2 - section.start_xy_m @ section.towards
    centre_m = np.array([left_m + columns / pixels_per_m / 2, section.high_m - rows / pixels_per_m / 2, 0.0])
    centre_m[2] = near_m + overhang_m
    camera = Orthographic(axes, centre_m, _DOTS * pixels_per_m, (_DOTS * columns, _DOTS * rows))
    edge_m, _ = camera.rays(range(1))
    edge_m -= overhang_m * axes[2]
    ground_m = height_m(edge_m[:, 0], edge_m[:, 1])
    picture = np.empty((rows, columns, 3), np.uint8)
    for row in range(0, rows, _ROWS):
        origin_m, ahead = camera.rays(range(row * _DOTS, (row + _ROWS) * _DOTS))
        dots = look(geometry, origin_m, ahead, section.depth_m + 2 * overhang_m)
        rgb = dots.rgb(colours, _DARKEST + (1 - _DARKEST) * dots.cos_incidence, _PAPER_RGB)
        haze = _HAZE * np.clip((dots.range_m - overhang_m) / section.depth_m, 0.0, 1.0)
        rgb += haze[:, None] * (_PAPER_RGB - rgb)
        rgb[origin_m[:, 2] < np.tile(ground_m, _ROWS * _DOTS)] = _SOIL
        band = rgb.reshape(_ROWS, _DOTS, columns, _DOTS, 3).mean(axis=(1, 3))
        picture[row : row + _ROWS] = np.round(band[: rows - row])
    return picture


INK, SOFT, WALK = "#26302b", "#747e78", "#c8372d"
"""Colours of writing, of what is less important, and of the path; on paper."""

_DRAWN_IN_ORDER = (
    *("none", "ground", "grass", "tuft", "herb", "dwarf_shrub", "fern", "stone", "log", "broken_log"),
    *("stump", "broken_stump", "root_plate", "deadwood", "sapling", "shrub", "tree", "other"),
)  # kinds of things, the lowest first
_MARGIN_M = 2.0
_LEAST_STEM_PX = 2.4  # thinner stems are drawn this wide, or nobody would see them
_SMOOTH_M = 2.0  # one sigma of the smoothing of contour lines, which show hills and not every step
_ARROWS, _FIRST_ARROW = 7, 0.12  # arrows along the path, and where the first one is, as a share of its length
_ROUND_M = (0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
"""Lengths that a scale bar or a contour interval may have."""
_DARK = 0.6  # brightness of a face's edge, relative to the face
_BELOW_PX = 14.0  # middle of the scale bar under the plan, where it covers nothing


def extent_m(seen: Survey) -> tuple[F8, F8]:
    """Return the south-west and the north-east corner (2,) of the plan of a survey."""
    low_m, high_m = seen.bounds_m
    return low_m - _MARGIN_M, high_m + _MARGIN_M


def draw_plan(axes: "Axes", seen: Survey, section: StandSection) -> None:
    """Draw the plan of a survey, with the strip of a section marked, into axes whose size is settled."""
    low_m, high_m = extent_m(seen)
    axes.set(xlim=(low_m[0], high_m[0]), ylim=(low_m[1], high_m[1]), aspect="equal", anchor="NW", xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set_color("#d8d5cc")
    _draw_ground(axes, seen)
    _draw_things(axes, seen)
    _draw_trees(axes, seen)
    _draw_path(axes, seen.path_m[:, :2])
    _draw_strip(axes, section)
    _draw_scale_and_north(axes)


def _kinds(seen: Survey) -> list[str]:
    return sorted({thing.kind for thing in seen.things}, key=_DRAWN_IN_ORDER.index)


def legend_entries(seen: Survey) -> "list[Artist]":
    """Return samples of what a plan shows, with names as labels: species first, the most frequent at the top."""
    from matplotlib.lines import Line2D

    def sample(name: str, colour: tuple[int, int, int], marker: str, size: float, alpha: float = 1.0) -> Line2D:
        looks: dict[str, Any] = {"markerfacecolor": _rgba(colour, alpha), "markeredgecolor": _rgba(colour, 1.0, _DARK)}
        looks |= {"marker": marker, "markersize": size, "markeredgewidth": 0.6}
        return Line2D([], [], linestyle="none", label=name.replace("_", " "), **looks)

    numbers, stems = np.unique(seen.near["species"], return_counts=True)
    names = [seen.species[int(numbers[i])] for i in np.argsort(-stems, kind="stable")]
    entries: list[Artist] = [sample(name, colour_of_species(name), "o", 11, 0.6) for name in names]
    entries += [sample(kind, colour_of_kind(kind), "s", 6) for kind in _kinds(seen)]
    return [*entries, Line2D([], [], color=WALK, lw=1.6, label="path of the sensor")]


def _draw_ground(axes: "Axes", seen: Survey) -> None:
    low, high = extent_m(seen)
    cell_m = float((high - low).max()) / 240
    x_m, y_m = np.meshgrid(*(np.arange(a, b + cell_m, cell_m) for a, b in zip(low, high, strict=True)))
    if seen.hall is None:
        grid = np.column_stack([x_m.ravel(), y_m.ravel()])
        gap_m = np.reshape(KDTree(seen.path_m[:, :2]).query(grid)[0], x_m.shape)
        border: dict[str, Any] = {"colors": SOFT, "linewidths": 0.9, "linestyles": [(0, (6, 4))], "zorder": 6}
        axes.contour(x_m, y_m, gap_m, [seen.radius_m], **border)
    ground_m = gaussian_filter(seen.bare.height_m(x_m, y_m), _SMOOTH_M / cell_m, mode="nearest")
    interval_m = _round_up_m(float(np.ptp(ground_m)) / 8)
    if np.ptp(ground_m) > interval_m:
        levels = np.arange(np.ceil(ground_m.min() / interval_m), ground_m.max() / interval_m) * interval_m
        looks: dict[str, Any] = {"colors": "#b08d5b", "linewidths": 0.6, "linestyles": "solid", "alpha": 0.8}
        lines = axes.contour(x_m, y_m, ground_m, levels, zorder=1, **looks)
        axes.clabel(lines, fontsize=6.5, fmt="%g m", inline_spacing=2)


def _draw_things(axes: "Axes", seen: Survey) -> None:
    from matplotlib.collections import PolyCollection

    for kind in _kinds(seen):
        colour, outlines = colour_of_kind(kind), [one.outline_m for one in seen.things if one.kind == kind]
        faces, edges = _rgba(colour, 0.2 if kind == "ground" else 0.75), _rgba(colour, 0.8, _DARK)
        looks: dict[str, Any] = {"facecolors": [faces], "edgecolors": [edges], "linewidths": 0.3, "zorder": 2}
        axes.add_collection(PolyCollection(outlines, **looks), autolim=False)
    beside: dict[str, Any] = {"xytext": (5, 5), "textcoords": "offset points", "size": 8, "color": INK, "zorder": 9}
    for thing in seen.things:
        if (name := seen.names.get(thing.instance)) is not None:
            axes.annotate(name, (thing.place_m[0], thing.place_m[1]), **beside)


def _draw_trees(axes: "Axes", seen: Survey) -> None:
    """Draw crowns as discs of their width, small ones first, then stems at their diameter."""
    from matplotlib.collections import EllipseCollection

    trees = seen.near[np.argsort(seen.near["crown_width_m"], kind="stable")]
    if not len(trees):
        return
    colours = [colour_of_species(seen.species[number]) for number in trees["species"].tolist()]
    least_m = _LEAST_STEM_PX * float(np.ptp(axes.get_xlim())) / axes.get_window_extent().width
    crowns: dict[str, Any] = {"facecolors": [_rgba(c, 0.42) for c in colours], "zorder": 3}
    crowns["edgecolors"] = [_rgba(c, 0.75, _DARK) for c in colours]
    stems: dict[str, Any] = {"facecolors": [(0.22, 0.16, 0.11)], "edgecolors": ["none"], "zorder": 4}
    at: dict[str, Any] = {"units": "xy", "offsets": places_m(trees, "xy"), "offset_transform": axes.transData}
    for width_m, looks in ((trees["crown_width_m"], crowns), (np.maximum(trees["dbh_m"], least_m), stems)):
        discs = EllipseCollection(width_m, width_m, np.zeros(len(trees)), linewidths=0.5, **at, **looks)
        axes.add_collection(discs, autolim=False)


def _draw_path(axes: "Axes", path_xy_m: F8) -> None:
    axes.plot(*path_xy_m[0], marker="o", ms=6, mfc="white", mec=WALK, mew=1.6, zorder=8)
    if len(path_xy_m) < 2:
        return
    axes.plot(*path_xy_m.T, color=WALK, lw=1.6, zorder=7)
    gone_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path_xy_m, axis=0).T))])
    arrow = {"arrowstyle": "-|>", "color": WALK, "lw": 0, "mutation_scale": 13}
    for head_m in gone_m[-1] * np.linspace(_FIRST_ARROW, 1.0, _ARROWS):
        (tail_x, x), (tail_y, y) = (np.interp([head_m - 1.0, head_m], gone_m, axis) for axis in path_xy_m.T)
        axes.annotate("", (x, y), (tail_x, tail_y), arrowprops=arrow, zorder=8)


def _draw_strip(axes: "Axes", section: StandSection) -> None:
    half_m = section.depth_m / 2 * section.towards
    ends = section.start_xy_m, section.start_xy_m + section.length_m * section.along
    corners = np.array([ends[0] - half_m, ends[1] - half_m, ends[1] + half_m, ends[0] + half_m])
    axes.plot(*np.concatenate([corners, corners[:1]]).T, color=INK, lw=0.9, ls=(0, (3, 2)), zorder=7)
    for name, end, side in (("A", ends[0], -1), ("B", ends[1], 1)):
        place_m = end + side * MARK_LEAD * section.length_m * section.along
        box = {"boxstyle": "circle,pad=0.15", "fc": "white", "ec": INK, "lw": 0.8}
        axes.text(place_m[0], place_m[1], name, size=9, color=INK, ha="center", va="center", bbox=box, zorder=9)


def _draw_scale_and_north(axes: "Axes") -> None:
    (x_m, right_m), pixel = axes.get_xlim(), 1.0 / axes.get_window_extent().height
    bar_m, y = _round_up_m((right_m - x_m) / 12), -_BELOW_PX * pixel
    below: dict[str, Any] = {"color": INK, "transform": axes.get_xaxis_transform(), "clip_on": False}
    axes.plot([x_m, x_m + bar_m], [y, y], lw=3.5, solid_capstyle="butt", **below)
    axes.text(x_m + 1.08 * bar_m, y, f"{bar_m:g} m", size=8.5, va="center_baseline", **below)
    arrow = {"arrowstyle": "-|>", "color": INK, "lw": 1.4, "mutation_scale": 12, "shrinkA": 0, "shrinkB": 0}
    ends = (0.995, y + 10 * pixel), (0.995, y - 12 * pixel)
    axes.annotate("", *ends, "axes fraction", arrowprops=arrow)
    axes.text(0.985, y, "N", size=9, ha="right", va="center_baseline", color=INK, transform=axes.transAxes)


def _round_up_m(length_m: float) -> float:
    return next((length for length in _ROUND_M if length >= length_m), _ROUND_M[-1])


def _rgba(colour: tuple[int, int, int], alpha: float, light: float = 1.0) -> tuple[float, float, float, float]:
    red, green, blue = colour
    return light * red / 255, light * green / 255, light * blue / 255, alpha


_PAPER, _DPI = "#fcfbf8", 84
_WIDTH_IN, _LEGEND_IN, _EDGE_IN = 12.0, 1.9, 0.35
_HEAD_IN, _GAP_IN, _FOOT_IN = 0.85, 0.45, 0.45
_TALLEST_PLAN_IN, _TALLEST_SECTION_IN = 7.0, 9.0
_COLOURS = 88  # size of the file's palette: leaves fill pictures with noise, which is costly in more
_TICK_M = 5.0
_BEAM_M = 12.0  # how far the lines of the field of view are drawn
_WINDS = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")


def draw_sheet(file: BinaryIO, seen: Survey, section: StandSection, drawn: U1, *, title: str, subtitle: str) -> None:
    """Draw plan and section as PNG, with a title of two lines; `drawn` (rows, columns, 3) is the section by `draw_section`."""
    low_m, high_m = extent_m(seen)
    across_m, tall_m = high_m - low_m
    plan_width_in = _WIDTH_IN - _LEGEND_IN - 2 * _EDGE_IN
    plan_in = min(plan_width_in * float(tall_m / across_m), _TALLEST_PLAN_IN)
    side_in, side_width_in = (pixels / _DPI for pixels in drawn.shape[:2])
    height_in = _HEAD_IN + plan_in + _GAP_IN + side_in + _FOOT_IN
    size_px = round(_WIDTH_IN * _DPI), round(height_in * _DPI)
    with plotted(file, size_px, layout=None, few_colours=_COLOURS, dpi=_DPI) as figure:
        figure.set_facecolor(_PAPER)

        def place(bottom_in: float, width_in: float, tall_in: float) -> "Axes":
            left, bottom = _EDGE_IN / _WIDTH_IN, bottom_in / height_in
            return figure.add_axes((left, bottom, width_in / _WIDTH_IN, tall_in / height_in), facecolor=_PAPER)

        draw_plan(place(_FOOT_IN + side_in + _GAP_IN, plan_width_in, plan_in), seen, section)
        corner = (1 - (_LEGEND_IN + 0.2) / _WIDTH_IN, 1 - _HEAD_IN / height_in)
        looks: dict[str, Any] = {"loc": "upper left", "frameon": False, "fontsize": 9}
        looks |= {"labelcolor": INK, "labelspacing": 0.7}
        figure.legend(handles=legend_entries(seen), bbox_to_anchor=corner, **looks)
        draw_side(place(_FOOT_IN, side_width_in, side_in), seen, section, drawn)
        figure.text(_EDGE_IN / _WIDTH_IN, 1 - 0.38 / height_in, title, size=15, color=INK, weight="bold")
        figure.text(_EDGE_IN / _WIDTH_IN, 1 - 0.66 / height_in, subtitle, size=9.5, color=SOFT)


def draw_side(axes: "Axes", seen: Survey, section: StandSection, drawn: U1) -> None:
    """Draw the section with heights, lengths, the sensor's path and the sensor."""
    axes.imshow(drawn, extent=(0.0, section.length_m, section.low_m, section.high_m), interpolation="none")
    axes.set(xlim=(0, section.length_m), ylim=(section.low_m, section.high_m))
    axes.tick_params(labelsize=8, colors=SOFT, length=3)
    for name, spine in axes.spines.items():
        spine.set_visible(name in ("left", "bottom"))
        spine.set_color(SOFT)
    axes.set_xticks(np.arange(0, section.length_m + 0.1, _TICK_M))
    axes.set_yticks(np.arange(np.ceil(section.low_m / _TICK_M) * _TICK_M, section.high_m, _TICK_M))
    along_m, _ = section.coordinates(seen.path_m[:, :2])
    # From the first point on for as long as it keeps between the ends, also where it leaves the strip sideways.
    left = np.flatnonzero((along_m < 0) | (along_m > section.length_m))
    shown = slice(0, int(left[0]) + 1 if len(left) else None)
    axes.plot(along_m[shown], seen.path_m[shown, 2], color=WALK, lw=0.9, ls=(0, (4, 2)))
    if len(inside := np.flatnonzero(section.holds(seen.path_m[:, :2], 0.0))):
        _draw_sensor(axes, seen, int(inside[len(inside) // 2]), float(along_m[inside[len(inside) // 2]]))
    bearing = _WINDS[round(np.degrees(np.arctan2(*section.towards)) % 360 / 45) % 8]
    note = f"A - B: what stands in a strip {section.depth_m:.0f} m deep, seen towards {bearing}; metres"
    axes.text(0.005, 0.985, note, size=9, color=INK, va="top", transform=axes.transAxes)


def _draw_sensor(axes: "Axes", seen: Survey, row: int, x_m: float) -> None:
    ground_m = float(seen.bare.height_m(seen.path_m[row : row + 1, 0], seen.path_m[row : row + 1, 1])[0])
    sensor_m = float(seen.path_m[row, 2])
    axes.plot([x_m, x_m], [ground_m, sensor_m], color=WALK, lw=2.2, solid_capstyle="butt", zorder=5)
    axes.plot(x_m, sensor_m, "s", color=INK, ms=4, zorder=6)
    for side in (-1, 1):
        for rise_m in _BEAM_M * np.tan(np.radians(seen.field_of_view_deg)):
            axes.plot([x_m, x_m + side * _BEAM_M], [sensor_m, sensor_m + rise_m], color=WALK, lw=0.5, alpha=0.6)


_GROUND_CELL_M = 0.25  # cell of the ground grid: the finest that is usual for forests


def write_sheets(
    scene: str, scenario: Scenario, radius_m: float, wanted: Mapping[str, Path], *, truth: Path | None
) -> dict[str, Any]:
    """Survey a scene and write the files of some options, which are opened before anything heavy; return the summary.

    The files take their names together at the end.

    InputError if `truth`, the folder of a run, has no returns of this scene.
    """
    with ExitStack() as stack:
        outputs = {name: stack.enter_context(OutputFile(path, where=f"{name} {path}")) for name, path in wanted.items()}
        seen = survey(scenario, radius_m)
        summary = summary_of(scene, scenario, seen)
        for name, output in outputs.items():
            file = stack.enter_context(output.writing())
            if name == "--picture":
                _write_picture(file, seen, scenario.title, subtitle_of(summary))
            else:
                _write_table_or_twin(name, file, seen, truth)
            file.flush()  # here, so that none takes its name if the disk is full
    return summary


def _write_table_or_twin(name: str, file: BinaryIO, seen: Survey, truth: Path | None) -> None:
    if name == "--inventory":  # all trees within the sensor's range, with what a run saw of their stems
        more = seen.stems_seen(seen.trees, truth) if truth else None
        write_csv(file, seen.inventory(seen.trees), more, table=seen.plants.trees)
    elif name == "--stems":  # skeletons with radii, as a QSM has them
        text: dict[str, Any] = {"fmt": [*["%d"] * 4, *["%.4f"] * 5], "delimiter": ",", "comments": ""}
        np.savetxt(file, seen.stem_circles(seen.trees), header=",".join(STEM_CIRCLE.names or ()), **text)
    elif name == "--ground":
        write_ascii(file, seen.bare.height_m, *seen.bounds_m, _GROUND_CELL_M)
    else:  # everything within the radius, or the whole hall, as a twin
        at_m = {thing.instance: thing.place_m for thing in seen.things}
        at_m |= dict(zip(seen.near["id"].tolist(), places_m(seen.near), strict=True))
        shape: Grow = seen.world.shape
        window = seen.window
        if seen.hall is None:
            window, shape = cut_out(window, shape, instances=np.array(list(at_m), np.uint32), inside=seen.inside)
        colours = surface_colours(seen.window.surfaces, seen.species)
        write_glb(file, window, shape, places_m=at_m, species=seen.species, colours=colours)


def _write_picture(file: BinaryIO, seen: Survey, title: str, subtitle: str) -> None:
    section = section_of(seen)  # it fills the sheet's width, or is as tall as it may be
    wide, tall = (_WIDTH_IN - 2 * _EDGE_IN) / section.length_m, section.high_m - section.low_m
    drawn = draw_stand(seen, section, min(wide, _TALLEST_SECTION_IN / tall) * _DPI)
    draw_sheet(file, seen, section, drawn, title=title, subtitle=subtitle)
