"""A camera of parallel rays: pixels of points."""

import math
from dataclasses import dataclass
from itertools import product
from typing import Self

import numpy as np

from vlp16emu.types import F8, I8

Pixels = tuple[I8, I8, F8]
"""Columns, rows and nearness (n,) of points; of two points at a pixel the one of greater nearness hides the other."""


@dataclass(frozen=True, slots=True)
class Orthographic:
    """A camera of parallel rays: lengths across the view have one scale everywhere."""

    axes: F8  # (3, 3) unit vectors to the right, upwards in the image, and towards the eye
    centre_m: F8  # (3,) place at the middle of the image, along these axes
    px_per_m: float
    size: tuple[int, int]  # width and height in pixels

    @classmethod
    def around(cls, box_m: F8, from_deg: float, elevation_deg: float, size: tuple[int, int]) -> Self:
        """Look at a box with corners (2, 3) from a bearing, clockwise from north, and an elevation; the box fills the image."""
        a, e = math.radians(from_deg), math.radians(elevation_deg)
        right = np.array([-math.cos(a), math.sin(a), 0.0])
        back = np.array([math.sin(a) * math.cos(e), math.cos(a) * math.cos(e), math.sin(e)])
        axes = np.stack([right, np.cross(back, right), back])
        seen_m = np.array(list(product(*box_m.T))) @ axes.T
        low_m, high_m = seen_m.min(axis=0), seen_m.max(axis=0)
        scale = min(size[0] / (high_m[0] - low_m[0]), size[1] / (high_m[1] - low_m[1]))
        return cls(axes, (low_m + high_m) / 2, float(scale), size)

    def pixels(self, places_m: F8) -> Pixels:
        """Return the pixels of places (n, 3); nearness is in metres."""
        right, up, near = ((places_m @ self.axes.T) - self.centre_m).T
        column = np.floor(self.size[0] / 2 + right * self.px_per_m).astype(np.int64)
        return column, np.floor(self.size[1] / 2 - up * self.px_per_m).astype(np.int64), near
