"""A canvas for points: the nearest in front, edges darkened by eye-dome lighting."""

import numpy as np

from vlp16emu.extras.camera import Pixels
from vlp16emu.types import U1

_BACKGROUND = (14, 18, 24)
_RELIEF = 0.35
"""How dark a pixel gets per metre by which its neighbours are nearer: eye-dome lighting (Boucheny, thesis, Grenoble 2009)."""
_DARKEST = 0.3
_NEIGHBOUR_PX = 2


class Canvas:
    """A picture of a size in pixels, width and height, that points of `dot_px` are added to."""

    def __init__(self, size: tuple[int, int], dot_px: tuple[int, int] = (2, 2)) -> None:
        self.size, self._dot_px = size, dot_px
        self.clear()

    def clear(self) -> None:
        """Take away all points."""
        width, height = self.size
        self._near = np.full(height * width, -np.inf)
        self._rgb = np.zeros((height * width, 3), np.uint8)

    def add(self, pixels: Pixels, rgb: U1) -> None:
        """Draw points at pixels (n,) in colours (n, 3); what lies outside is left out."""
        width, height = self.size
        order = np.argsort(pixels[2], kind="stable")
        column, row, near, rgb = *(of[order] for of in pixels), rgb[order]
        for x in range(self._dot_px[0]):
            for y in range(self._dot_px[1]):
                inside = (column + x >= 0) & (column + x < width) & (row + y >= 0) & (row + y < height)
                pixel = (row[inside] + y) * width + column[inside] + x
                in_front = near[inside] > self._near[pixel]
                # Points come by nearness, and of several at one pixel numpy keeps the last.
                self._near[pixel[in_front]] = near[inside][in_front]
                self._rgb[pixel[in_front]] = rgb[inside][in_front]

    def image(self) -> U1:
        """Return the picture (height, width, 3), with relief."""
        width, height = self.size
        near = self._near.reshape(height, width)
        drawn = np.isfinite(near)
        behind, flat = np.zeros((height, width)), np.where(drawn, near, -1e6)
        for axis in (0, 1):
            for step in (-_NEIGHBOUR_PX, _NEIGHBOUR_PX):
                behind += np.clip(np.roll(flat, step, axis) - flat, 0.0, 2.0)
        light = np.maximum(np.exp(-_RELIEF * behind), _DARKEST)
        rgb = np.where(drawn[..., None], self._rgb.reshape(height, width, 3) * light[..., None], _BACKGROUND)
        return np.rint(rgb).astype(np.uint8)
