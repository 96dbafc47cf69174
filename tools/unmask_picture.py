"""Picture of one sweep of real and emulated units, side by side, for `tools/unmask --picture`."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw
from unmask_windows import Array

from vlp16emu.extras.compare import Sequences
from vlp16emu.packets.layout import AZIMUTH_CODES

WIDTH, ROW_PX, TITLE_PX, GAP_PX = 1400, 6, 14, 3
BLACK_LSB, E_FOLDS = 200.0, 4.3
"""Range that is black, 0.4 m, and logarithm of the ratio to the range that is white, 30 m."""
SILENT = (200, 30, 60)


def draw(path: Path, units: Iterable[tuple[str, Sequences]]) -> None:
    """Write codes, and ranges on a logarithmic scale, of the first sweep of each unit."""
    sheets = [(name, *images(one)) for name, one in units]
    high = 16 * ROW_PX
    tall = TITLE_PX + 2 * (high + GAP_PX)
    out = Image.new("RGB", (WIDTH, tall * len(sheets)), "white")
    text = ImageDraw.Draw(out)
    for i, (name, *parts) in enumerate(sheets):
        text.text((2, i * tall + 1), f"{name}: codes, ranges", fill="black")
        for row, part in enumerate(parts):
            sheet = part.resize((WIDTH, high), Image.Resampling.NEAREST)
            out.paste(sheet, (0, i * tall + TITLE_PX + row * (high + GAP_PX)))
    out.save(path, optimize=True)


def images(one: Sequences) -> tuple[Image.Image, Image.Image]:
    """Return codes and ranges of the first sweep, lasers by elevation."""
    azimuth = np.interp(one.number, 2 * one.block, one.azimuth_cdeg)
    turn = int(np.searchsorted(azimuth, azimuth[0] + AZIMUTH_CODES))
    downwards = np.argsort(one.layout.model.beams.ring)[::-1]
    d, r = (v[:turn, downwards].T for v in (one.distance_lsb, one.reflectivity))
    return shades(r / 100.0, d == 0), shades(np.log(np.maximum(d, BLACK_LSB) / BLACK_LSB) / E_FOLDS, d == 0)


def shades(value: Array, silent: Array) -> Image.Image:
    """Return values of 0 to 1 in shades of grey, and what has no return in red."""
    grey = (255.0 * np.clip(value, 0.0, 1.0)).astype(np.uint8)
    rgb = np.stack([grey, grey, grey], axis=2)
    rgb[silent] = SILENT
    return Image.fromarray(rgb)
