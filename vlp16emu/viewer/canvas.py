"""Points drawn into a picture as they come: what is nearer hides what is behind, and memory is that of the picture."""

import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

_BACKGROUND = (14, 18, 24)
_RELIEF = 0.35
"""How dark a pixel gets per metre by which its neighbours are nearer: eye-dome lighting (Boucheny, thesis, Grenoble 2009)."""
_DARKEST = 0.3
_NEAR_PX = 2
"""How far off the neighbours are."""
_FEWEST_COLUMNS = 800
"""Firing sequences of a revolution at 1200 rpm are some 900."""


class View(Protocol):
    """Where points are in a picture."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, in pixels."""

    @property
    def dot_px(self) -> tuple[int, int]:
        """Width and height of a point."""

    def pixels(
        self, place: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """Column, row and distance towards the eye of points (n, 3)."""


class Oblique:
    """A view from above at a slant, without perspective: lengths across it are the same everywhere.

    Parameters
    ----------
    from_deg : where the eye is, clockwise from north
    elevation_deg : how high it is above the horizon
    size : width and height, in pixels
    box_m : (2, 3) corners of what has to be in the picture
    """

    def __init__(
        self, from_deg: float, elevation_deg: float, size: tuple[int, int], box_m: NDArray[np.float64]
    ) -> None:
        a, e = math.radians(from_deg), math.radians(elevation_deg)
        right = np.array([-math.cos(a), math.sin(a), 0.0])
        back = np.array([math.sin(a) * math.cos(e), math.cos(a) * math.cos(e), math.sin(e)])
        self._axes = np.stack([right, np.cross(back, right), back])
        corners_m = np.array(
            [[box_m[i, 0], box_m[j, 1], box_m[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
        )
        seen_m = corners_m @ self._axes.T
        low_m, high_m = seen_m.min(axis=0), seen_m.max(axis=0)
        self.size, self.dot_px = size, (2, 2)
        self.px_per_m = float(min(size[0] / (high_m[0] - low_m[0]), size[1] / (high_m[1] - low_m[1])))
        self._middle_m = (low_m + high_m) / 2

    def pixels(
        self, world_m: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """Column, row and distance towards the eye (m) of points (n, 3)."""
        right, up, near = ((world_m @ self._axes.T) - self._middle_m).T
        column = np.floor(self.size[0] / 2 + right * self.px_per_m).astype(np.int64)
        row = np.floor(self.size[1] / 2 - up * self.px_per_m).astype(np.int64)
        return column, row, near


class LaserRows:
    """A row for each laser, the highest one above, and azimuths from left to right; points are azimuth (deg), ring and 0.

    Parameters
    ----------
    size : width and height, in pixels
    rings : lasers of the sensor
    """

    def __init__(self, size: tuple[int, int], rings: int) -> None:
        self.size, self.rings = size, rings
        width, height = size
        self.left, self.top = round(0.06 * width), round(0.1 * height)
        """Of the pixel that is azimuth 0 of the highest laser."""
        self.width, self.height = round(0.85 * width), height - 2 * self.top
        self.dot_px = 1 + self.width // _FEWEST_COLUMNS, -(-self.height // rings)

    def pixels(
        self, place: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """See `View`."""
        azimuth_deg, ring, near = place.T
        column = self.left + np.floor(azimuth_deg * self.width / 360.0).astype(np.int64)
        return column, self.top + (self.rings - 1 - ring.astype(np.int64)) * self.height // self.rings, near


class Canvas:
    """A picture that points are added to.

    Parameters
    ----------
    view : of the picture
    """

    def __init__(self, view: View) -> None:
        self.view = view
        self.clear()

    def clear(self) -> None:
        """Take away all points."""
        width, height = self.view.size
        self._near_m = np.full(height * width, -np.inf)
        self._rgb = np.zeros((height * width, 3), np.uint8)

    def add(self, world_m: NDArray[np.float64], rgb: NDArray[np.uint8]) -> None:
        """Draw points (n, 3) in colours (n, 3)."""
        width, height = self.view.size
        column, row, near_m = self.view.pixels(world_m)
        order = np.argsort(near_m, kind="stable")
        column, row, near_m, rgb = column[order], row[order], near_m[order], rgb[order]
        for x in range(self.view.dot_px[0]):
            for y in range(self.view.dot_px[1]):
                inside = (column + x >= 0) & (column + x < width) & (row + y >= 0) & (row + y < height)
                pixel = (row[inside] + y) * width + column[inside] + x
                in_front = near_m[inside] > self._near_m[pixel]
                # Points come by nearness, and of several at one pixel the last is kept.
                self._near_m[pixel[in_front]] = near_m[inside][in_front]
                self._rgb[pixel[in_front]] = rgb[inside][in_front]

    def image(self) -> NDArray[np.uint8]:
        """Give the picture (height, width, 3), with relief."""
        width, height = self.view.size
        near_m = self._near_m.reshape(height, width)
        drawn = np.isfinite(near_m)
        behind_m = np.zeros((height, width))
        flat_m = np.where(drawn, near_m, -1e6)
        for axis in (0, 1):
            for step in (-_NEAR_PX, _NEAR_PX):
                behind_m += np.clip(np.roll(flat_m, step, axis) - flat_m, 0.0, 2.0)
        light = np.maximum(np.exp(-_RELIEF * behind_m), _DARKEST)
        rgb = np.where(drawn[..., None], self._rgb.reshape(height, width, 3) * light[..., None], _BACKGROUND)
        return np.rint(rgb).astype(np.uint8)
