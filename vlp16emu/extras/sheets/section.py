"""A vertical section through a world, as light would draw it: parallel level rays, one per dot."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vlp16emu.raycast.caster import Geometry
from vlp16emu.types import NO_SURFACE, Firings, HeightField, Hits

Array = NDArray[np.float64]

_PAPER = np.array([252.0, 251.0, 248.0])
_SOIL = np.array([196.0, 178.0, 150.0])

_DOTS = 3
"""Rays per pixel along either axis; their mean is the pixel."""

_HAZE = 0.55
"""How far the colour of the farthest things has faded into the paper."""

_DARKEST = 0.6
"""Brightness of a surface seen edge on."""

_LEAD = 0.06
"""Share of a strip's length that lies before the path begins, and after it leaves."""

MARK_LEAD = 0.02
"""Share of a strip's length between its ends and the marks that name them on a plan."""

_ROWS = 8
"""Casters want sequences by the eight."""


@dataclass(frozen=True, slots=True)
class StandSection:
    """A strip of the world, seen level and from the side."""

    start_xy_m: Array
    """(2,) left end of the strip's middle line."""
    along: Array
    """(2,) unit vector to the right; one looks to the left of it, into the picture."""
    length_m: float
    depth_m: float
    """Of the strip, half of it on either side of its middle line."""
    low_m: float
    high_m: float
    """Heights in the world between which it is drawn."""

    @property
    def towards(self) -> Array:
        """(2,) unit vector into the picture."""
        return np.array([-self.along[1], self.along[0]])

    def holds(self, xy_m: Array, lead_m: float) -> NDArray[np.bool_]:
        """Which points (n, 2) lie in the strip, or beyond its ends by less than `lead_m`."""
        along_m, into_m = self.coordinates(xy_m)
        lengthwise = (along_m >= -lead_m) & (along_m <= self.length_m + lead_m)
        inside: NDArray[np.bool_] = lengthwise & (np.abs(into_m) <= self.depth_m / 2)
        return inside

    def within(self, low_m: Array, high_m: Array) -> "StandSection":
        """Shorten the strip about its middle until its ends and their marks lie in a rectangle with corners (2,)."""
        middle_m = self.start_xy_m + self.length_m / 2 * self.along
        room_m = np.minimum(middle_m - low_m, high_m - middle_m)
        reach_m = np.divide(room_m, np.abs(self.along), out=np.full(2, np.inf), where=self.along != 0).min()
        length_m = min(self.length_m, 2 * float(reach_m) / (1 + 4 * MARK_LEAD))
        return replace(self, start_xy_m=middle_m - length_m / 2 * self.along, length_m=length_m)

    def coordinates(self, xy_m: Array) -> tuple[Array, Array]:
        """Distances of points (n, 2) along the strip and into it, 0 at its middle line."""
        offset = xy_m - self.start_xy_m
        return offset @ self.along, offset @ self.towards


def strip_along(path_m: Array, length_m: float, depth_m: float) -> StandSection:
    """Lay a strip along the beginning of a path (n, 3); where it stands still, from west to east through it.

    The middle of a path that is shorter is the strip's middle. Its heights are still those of the path.
    """
    xy_m = path_m[:, :2]
    gone_m = np.hypot(*(xy_m - xy_m[0]).T)
    beyond = np.flatnonzero(gone_m > length_m * (1 - 2 * _LEAD))
    end = int(beyond[0]) if len(beyond) else int(gone_m.argmax())
    along = (xy_m[end] - xy_m[0]) / gone_m[end] if gone_m[end] > 0 else np.array([1.0, 0.0])
    start_xy_m = (xy_m[0] + xy_m[end]) / 2 - length_m / 2 * along
    low_m, high_m = float(path_m[:, 2].min()), float(path_m[:, 2].max())
    return StandSection(start_xy_m, along, length_m, depth_m, low_m, high_m)


def draw_section(
    geometry: Geometry,
    section: StandSection,
    overhang_m: float,
    *,
    colours: NDArray[np.uint8],
    height_m: HeightField,
    pixels_per_m: float,
) -> NDArray[np.uint8]:
    """Draw what stands in the strip, whole, and the ground of the strip, cut open at its near side: (rows, columns, 3).

    Parameters
    ----------
    geometry : with nothing in it that stands before or behind the strip
    overhang_m : how far crowns may reach out of the strip in which their trees stand
    colours : (m, 3) of its surfaces
    height_m : ground; below it the cut shows soil
    """
    columns = round(section.length_m * pixels_per_m)
    rows = round((section.high_m - section.low_m) * pixels_per_m)
    picture = np.empty((rows, columns, 3), np.uint8)
    s_m = (np.arange(columns * _DOTS) + 0.5) / _DOTS / pixels_per_m
    edge_xy_m = section.start_xy_m + s_m[:, None] * section.along - section.depth_m / 2 * section.towards
    ground_m = height_m(edge_xy_m[:, 0], edge_xy_m[:, 1])
    origin_m = np.empty((_ROWS * _DOTS, len(edge_xy_m), 3))
    origin_m[..., :2] = edge_xy_m - overhang_m * section.towards
    ahead, from_m, to_m = np.array([*section.towards, 0.0]), np.zeros(len(edge_xy_m)), section.depth_m + 2 * overhang_m
    for row in range(0, rows, _ROWS):
        dots = np.arange(row * _DOTS, (row + _ROWS) * _DOTS)
        z_m = section.high_m - (dots + 0.5) / _DOTS / pixels_per_m
        origin_m[..., 2] = z_m[:, None]
        hits = geometry.cast(Firings.rays(0, origin_m, ahead), from_m, to_m)
        rgb = _shaded(hits, colours, overhang_m, section.depth_m)
        rgb[z_m[:, None] < ground_m] = _SOIL
        band = rgb.reshape(_ROWS, _DOTS, columns, _DOTS, 3).mean(axis=(1, 3))
        picture[row : row + _ROWS] = np.round(band[: rows - row])
    return picture


def _shaded(hits: Hits, colours: NDArray[np.uint8], overhang_m: float, depth_m: float) -> Array:
    """Colours (k, lasers, 3): darker where the light grazes, paler with distance."""
    met = hits.surface.reshape(hits.count.shape)
    missed = met == NO_SURFACE
    surface = np.where(missed, 0, met)
    light = _DARKEST + (1 - _DARKEST) * hits.cos_incidence.reshape(*met.shape, 1).astype(np.float64)
    into = np.where(missed, 0.0, hits.range_m.reshape(met.shape) - overhang_m) / depth_m
    haze = _HAZE * np.clip(into, 0.0, 1.0)[..., None]
    rgb: Array = (1 - haze) * colours[surface] * light + haze * _PAPER
    rgb[missed] = _PAPER
    return rgb
