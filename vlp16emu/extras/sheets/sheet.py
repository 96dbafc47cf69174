"""Plan and section together on one sheet, as PNG."""

from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from vlp16emu.extras.plots import save_in_few_colours
from vlp16emu.extras.sheets.plan import INK, SOFT, WALK, PlanView, draw_plan, legend_entries
from vlp16emu.extras.sheets.section import StandSection

if TYPE_CHECKING:
    from matplotlib.axes import Axes


Array = NDArray[np.float64]

_PAPER = "#fcfbf8"
_DPI = 84
_WIDTH_IN, _LEGEND_IN, _EDGE_IN = 12.0, 1.9, 0.35
_HEAD_IN, _GAP_IN, _FOOT_IN = 0.85, 0.45, 0.45
_TALLEST_PLAN_IN, _TALLEST_SECTION_IN = 7.0, 9.0

_COLOURS = 88
"""Of the file's palette: leaves fill pictures with noise, which is costly in more."""

_TICK_M = 5.0

_BEAM_M = 12.0
"""How far the lines of the field of view are drawn."""


def section_pixels_per_m(section: StandSection) -> float:
    """Scale at which a section fills the sheet's width, or is as tall as it may be."""
    wide, tall = (_WIDTH_IN - 2 * _EDGE_IN) / section.length_m, section.high_m - section.low_m
    return min(wide, _TALLEST_SECTION_IN / tall) * _DPI


def draw_sheet(
    file: BinaryIO, plan: PlanView, section: StandSection, drawn: NDArray[np.uint8], *, title: str, subtitle: str
) -> None:
    """Draw plan and section as PNG, with a title of two lines; `drawn` (rows, columns, 3) is the section by `draw_section`."""
    from matplotlib.figure import Figure

    across_m, tall_m = plan.high_m - plan.low_m
    plan_width_in = _WIDTH_IN - _LEGEND_IN - 2 * _EDGE_IN
    plan_in = min(plan_width_in * float(tall_m / across_m), _TALLEST_PLAN_IN)
    side_in, side_width_in = (pixels / _DPI for pixels in drawn.shape[:2])
    height_in = _HEAD_IN + plan_in + _GAP_IN + side_in + _FOOT_IN
    figure = Figure(figsize=(_WIDTH_IN, height_in), dpi=_DPI, facecolor=_PAPER)

    def place(bottom_in: float, width_in: float, tall_in: float) -> "Axes":
        left, bottom = _EDGE_IN / _WIDTH_IN, bottom_in / height_in
        return figure.add_axes((left, bottom, width_in / _WIDTH_IN, tall_in / height_in), facecolor=_PAPER)

    above = place(_FOOT_IN + side_in + _GAP_IN, plan_width_in, plan_in)
    draw_plan(above, plan, section)
    figure.legend(
        handles=legend_entries(plan),
        loc="upper left",
        bbox_to_anchor=(1 - (_LEGEND_IN + 0.2) / _WIDTH_IN, 1 - _HEAD_IN / height_in),
        frameon=False,
        fontsize=9,
        labelcolor=INK,
        labelspacing=0.7,
    )
    _draw_side(place(_FOOT_IN, side_width_in, side_in), plan, section, drawn)
    figure.text(_EDGE_IN / _WIDTH_IN, 1 - 0.38 / height_in, title, size=15, color=INK, weight="bold")
    figure.text(_EDGE_IN / _WIDTH_IN, 1 - 0.66 / height_in, subtitle, size=9.5, color=SOFT)
    save_in_few_colours(figure, file, _COLOURS)


def _draw_side(axes: "Axes", plan: PlanView, section: StandSection, drawn: NDArray[np.uint8]) -> None:
    """Draw the section with heights, lengths, the sensor's path and the sensor."""
    axes.imshow(drawn, extent=(0.0, section.length_m, section.low_m, section.high_m), interpolation="none")
    axes.set(xlim=(0, section.length_m), ylim=(section.low_m, section.high_m))
    axes.tick_params(labelsize=8, colors=SOFT, length=3)
    for name, spine in axes.spines.items():
        spine.set_visible(name in ("left", "bottom"))
        spine.set_color(SOFT)
    axes.set_xticks(np.arange(0, section.length_m + 0.1, _TICK_M))
    axes.set_yticks(np.arange(np.ceil(section.low_m / _TICK_M) * _TICK_M, section.high_m, _TICK_M))
    along_m, _ = section.coordinates(plan.path_m[:, :2])
    inside = section.holds(plan.path_m[:, :2], 0.0)
    # From the first point on for as long as it keeps between the ends, also where it leaves the strip sideways.
    left = np.flatnonzero((along_m < 0) | (along_m > section.length_m))
    seen = slice(0, int(left[0]) + 1 if len(left) else None)
    axes.plot(along_m[seen], plan.path_m[seen, 2], color=WALK, lw=0.9, ls=(0, (4, 2)))
    if inside.any():
        middle = np.flatnonzero(inside)[inside.sum() // 2]
        ground_m = plan.height_m(plan.path_m[middle : middle + 1, 0], plan.path_m[middle : middle + 1, 1])[0]
        place_m = float(along_m[middle]), float(ground_m), float(plan.path_m[middle, 2])
        _draw_carrier(axes, *place_m, plan.field_of_view_deg, walks=len(plan.path_m) > 1)
    bearing = np.degrees(np.arctan2(*section.towards)) % 360
    points = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")
    note = f"A - B: what stands in a strip {section.depth_m:.0f} m deep, seen towards {points[round(bearing / 45) % 8]}; metres"
    axes.text(0.005, 0.985, note, size=9, color=INK, va="top", transform=axes.transAxes)


def _draw_carrier(
    axes: "Axes", x_m: float, ground_m: float, sensor_m: float, field_of_view_deg: tuple[float, float], *, walks: bool
) -> None:
    """Who or what carries the sensor, the sensor, and the lower and upper end of its field of view."""
    from matplotlib.patches import Circle, Rectangle

    ink: dict[str, Any] = {"color": WALK, "solid_capstyle": "round", "zorder": 5}
    if walks:
        hip_m, neck_m = ground_m + 0.9, ground_m + 1.45
        axes.plot([x_m - 0.25, x_m, x_m + 0.25], [ground_m, hip_m, ground_m], lw=2.2, **ink)
        axes.plot([x_m, x_m + 0.06], [hip_m, neck_m], lw=4.5, **ink)
        axes.plot([x_m - 0.2, x_m - 0.2], [hip_m + 0.05, sensor_m], lw=2.0, **ink)
        axes.add_patch(Circle((x_m + 0.08, neck_m + 0.2), 0.13, color=WALK, zorder=5))
        x_m -= 0.2
    else:
        for foot_m in (-0.35, 0.0, 0.35):
            axes.plot([x_m + foot_m, x_m], [ground_m, sensor_m - 0.05], lw=1.4, **ink)
    axes.add_patch(Rectangle((x_m - 0.08, sensor_m - 0.06), 0.16, 0.12, fc=INK, ec="none", zorder=6))
    for side in (-1, 1):
        for rise_m in _BEAM_M * np.tan(np.radians(field_of_view_deg)):
            axes.plot([x_m, x_m + side * _BEAM_M], [sensor_m, sensor_m + rise_m], color=WALK, lw=0.5, alpha=0.6)
