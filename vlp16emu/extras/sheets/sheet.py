"""Plan and section together on one sheet, as PNG."""

from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from vlp16emu.extras.plots import plotted
from vlp16emu.extras.sheets.plan import INK, SOFT, WALK, draw_plan, extent_m, legend_entries
from vlp16emu.extras.sheets.section import StandSection
from vlp16emu.extras.sheets.survey import Survey
from vlp16emu.types import U1

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_PAPER, _DPI = "#fcfbf8", 84
_WIDTH_IN, _LEGEND_IN, _EDGE_IN = 12.0, 1.9, 0.35
_HEAD_IN, _GAP_IN, _FOOT_IN = 0.85, 0.45, 0.45
_TALLEST_PLAN_IN, _TALLEST_SECTION_IN = 7.0, 9.0
_COLOURS = 88  # size of the file's palette: leaves fill pictures with noise, which is costly in more
_TICK_M = 5.0
_BEAM_M = 12.0  # how far the lines of the field of view are drawn
_WINDS = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")


def section_pixels_per_m(section: StandSection) -> float:
    """Return the scale at which a section fills the sheet's width, or is as tall as it may be."""
    wide, tall = (_WIDTH_IN - 2 * _EDGE_IN) / section.length_m, section.high_m - section.low_m
    return min(wide, _TALLEST_SECTION_IN / tall) * _DPI


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
        figure.legend(
            handles=legend_entries(seen),
            loc="upper left",
            bbox_to_anchor=corner,
            frameon=False,
            fontsize=9,
            labelcolor=INK,
            labelspacing=0.7,
        )
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
    """Draw the sensor at a row of the path, the pole that holds it, and the ends of its field of view."""
    ground_m = float(seen.bare.height_m(seen.path_m[row : row + 1, 0], seen.path_m[row : row + 1, 1])[0])
    sensor_m = float(seen.path_m[row, 2])
    axes.plot([x_m, x_m], [ground_m, sensor_m], color=WALK, lw=2.2, solid_capstyle="butt", zorder=5)
    axes.plot(x_m, sensor_m, "s", color=INK, ms=4, zorder=6)
    for side in (-1, 1):
        for rise_m in _BEAM_M * np.tan(np.radians(seen.field_of_view_deg)):
            axes.plot([x_m, x_m + side * _BEAM_M], [sensor_m, sensor_m + rise_m], color=WALK, lw=0.5, alpha=0.6)
