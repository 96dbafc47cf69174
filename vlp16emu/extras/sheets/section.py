"""A vertical section through a world: a strip along the path, seen level from the side."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vlp16emu.extras.camera import Orthographic, look
from vlp16emu.extras.palette import surface_colours
from vlp16emu.extras.sheets.survey import Survey
from vlp16emu.forest.stand.nearby import AllNear, Grow, cut_out
from vlp16emu.raycast.caster import Geometry, caster
from vlp16emu.types import F8, U1, HeightField
from vlp16emu.world.hall import HallWorld
from vlp16emu.world.vectors import places_m

MARK_LEAD = 0.02
"""Share of a strip's length between its ends and the marks that name them on a plan."""

_PAPER, _SOIL = np.array([252.0, 251.0, 248.0]), np.array([196.0, 178.0, 150.0])
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
        inside: NDArray[np.bool_] = lengthwise & (np.abs(into_m) <= self.depth_m / 2)
        return inside

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
        return _hall_section(seen.hall)
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


def _hall_section(hall: HallWorld) -> StandSection:
    length_m, width_m, height_m = hall.size_m
    start_xy_m, along = np.array([-length_m / 2, 0.0]), np.array([1.0, 0.0])
    return StandSection(start_xy_m, along, length_m, width_m - 2 * _INSIDE_M, -_BELOW_M, height_m)


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
        rgb = dots.rgb(colours, _DARKEST + (1 - _DARKEST) * dots.cos_incidence, _PAPER)
        haze = _HAZE * np.clip((dots.range_m - overhang_m) / section.depth_m, 0.0, 1.0)
        rgb += haze[:, None] * (_PAPER - rgb)
        rgb[origin_m[:, 2] < np.tile(ground_m, _ROWS * _DOTS)] = _SOIL
        band = rgb.reshape(_ROWS, _DOTS, columns, _DOTS, 3).mean(axis=(1, 3))
        picture[row : row + _ROWS] = np.round(band[: rows - row])
    return picture
