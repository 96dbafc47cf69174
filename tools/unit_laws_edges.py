"""Edges of surfaces before silence, and their width beside that of the beam, for `tools/unit_laws`."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.special import ndtr
from unmask_rows import M_LSB, Capture, azimuths
from unmask_windows import Array

from vlp16emu.packets.layout import AZIMUTH_CODES

FLAT, LAST, RECORDS = 5, 7, 13
"""First records of a window are a calm surface; the eighth is the last return of 13, and silence follows."""
FLAT_LSB, SURFACE_LSB, APART_CDEG = 60, 150, 60
"""Greatest span of range of a calm surface and difference from it of its records, and azimuth between the
last returns of one edge in two turns."""
CODES = 25, 100
"""Codes of surfaces: darker ones are too coarse, brighter ones are glossy."""
WINDOW_CDEG, PLATEAU, UNEVEN, LEAST, LEAST_PLATEAU = 250, 5.0, 0.15, 12, 8
"""Azimuth to both sides of the last return; sigmas of the beam from there to where all of it is on the
surface; greatest scatter of codes over their level there; least records of an edge, and of those there."""
PLACES, WIDTHS = np.arange(-5.0, 2.0, 0.05), np.arange(0.3, 4.0, 0.02)
"""Places of edges from the last return, and their widths, in sigmas of the beam."""
MOST_SHARE, WORST = 1.5, 0.08
"""Greatest code over the level that counts, and greatest mean deviation of the roots of these shares."""
SPOT_MM, DIVERGENCE_MRAD = 12.7, 3.0
"""Width of the beam at the lens, horizontally, and what range adds to it (63-9243 Rev D, table F-1): the 1/e2
diameter of a Gaussian, four sigmas."""


class Edge(NamedTuple):
    """The end of a surface of a laser, which was seen in several turns."""

    laser: int
    side: int
    """1 if silence follows, -1 if it comes before."""
    azimuth_cdeg: float
    """Middle azimuth of the last returns."""
    range_lsb: float


def turned(azimuth_cdeg: Array, zero_cdeg: float) -> Array:
    """Return azimuths (n,) from another one, within half a turn to either side."""
    half = AZIMUTH_CODES // 2
    return np.asarray((azimuth_cdeg - zero_cdeg + half) % AZIMUTH_CODES - half)


def ends_of(one: Capture, side: int) -> tuple[Array, Array, Array]:
    """Return sequence, laser and range (m,) of the last returns of calm surfaces before silence."""
    d, r = (sliding_window_view(of[::side], RECORDS, axis=0) for of in (one.d, one.r))
    surface, level = d[..., :FLAT], np.median(r[..., :FLAT], axis=-1)
    found = (surface > 0).all(axis=-1) & (np.ptp(surface, axis=-1) < FLAT_LSB)
    found &= (d[..., LAST] > 0) & ~d[..., LAST + 1 :].any(axis=-1)
    at, laser = np.nonzero(found & (level >= CODES[0]) & (level <= CODES[1]))
    return np.arange(len(one.d))[::side][at + LAST], laser, np.median(surface[at, laser], axis=-1)


def edges_of(one: Capture, azimuth_cdeg: Array) -> Iterator[Edge]:
    """Yield the edges that were seen in half of the turns, and twice at least."""
    least = max(2, int((azimuth_cdeg[-1] - azimuth_cdeg[0]) / AZIMUTH_CODES / 2))
    for side in (1, -1):
        at, of_laser, of_range = ends_of(one, side)
        for laser in range(16):
            azimuth, range_lsb = azimuth_cdeg[at[of_laser == laser]], of_range[of_laser == laser]
            while len(azimuth):
                off_cdeg = turned(azimuth, azimuth[0])
                same = (np.abs(off_cdeg) < APART_CDEG) & (np.abs(range_lsb - range_lsb[0]) < FLAT_LSB)
                if same.sum() >= least:
                    middle_cdeg = azimuth[0] + float(np.median(off_cdeg[same]))
                    yield Edge(laser, side, middle_cdeg, float(np.median(range_lsb[same])))
                azimuth, range_lsb = azimuth[~same], range_lsb[~same]


def width_of(one: Capture, azimuth_cdeg: Array, edge: Edge) -> float:
    """Return the width of an edge over that of the beam, or NaN if it is none of an even surface.

    The integral of a Gaussian is fitted to codes of all turns, over the level of the surface, by the absolute
    deviations of their square roots.
    """
    d, code = one.d[:, edge.laser], one.r[:, edge.laser]
    off_cdeg = edge.side * turned(azimuth_cdeg, edge.azimuth_cdeg)
    on = (np.abs(off_cdeg) < WINDOW_CDEG) & (d > 0) & (np.abs(d - edge.range_lsb) < SURFACE_LSB)
    sigma_mrad = (SPOT_MM / (edge.range_lsb / M_LSB) + DIVERGENCE_MRAD) / 4.0
    across, code = 1e3 * np.radians(off_cdeg[on] / 100.0) / sigma_mrad, code[on]
    plateau = code[across < -PLATEAU]
    if len(code) < LEAST or len(plateau) < LEAST_PLATEAU or plateau.std() > UNEVEN * np.median(plateau):
        return np.nan
    share = np.minimum(code / np.median(plateau), MOST_SHARE)
    expected = ndtr((PLACES[:, None, None] - across) / WIDTHS[:, None])
    off = np.abs(np.sqrt(expected) - np.sqrt(share)).mean(axis=-1)
    best = np.unravel_index(off.argmin(), off.shape)
    return float(WIDTHS[best[1]]) if off[best] <= WORST else np.nan


def widths_of(one: Capture) -> tuple[Array, Array]:
    """Return range in codes and width over that of the beam (e,) of the edges of a capture."""
    azimuth_cdeg = azimuths(one.sequences)
    found = [(edge.range_lsb, width_of(one, azimuth_cdeg, edge)) for edge in edges_of(one, azimuth_cdeg)]
    range_lsb, width = np.reshape(found, (-1, 2)).T
    return range_lsb[np.isfinite(width)], width[np.isfinite(width)]
