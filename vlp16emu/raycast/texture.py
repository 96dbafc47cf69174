"""Patches of brighter and darker surface, and relief: bark, ground and walls are not of one reflectance, nor walls quite flat."""

import math
from dataclasses import replace

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.random import Purpose, uniform_pair
from vlp16emu.trig import ZERO, fold
from vlp16emu.types import F4, F8, U2, U4, Firings, Hits, PlantPart

_GRID_M, _BARK_GRID_M, _RELIEF_GRID_M = 0.4, 0.15, 0.15
"""Sizes of patches, of walls and ground, of bark, and of relief; folds halve them. With these sizes neighbouring returns are equal as
often, and differ as much, as on real sensors, and relief is alike at pulses 0.2 degrees apart, not at 0.4 (protocol/README.md)."""
_SAME_M = 0.1
"""Sub-rays of a pulse that end within this of each other end on one patch."""
_SPREAD = math.sqrt(3.0)
"""Half-width of an even distribution of variance one."""
_STANDING_OUT = math.sqrt(11.0)
"""The same for the fifth power of an even distribution: most of a wall is flat, and little of it stands out far."""
_TEXTURE = ZERO + Purpose.TEXTURE


def textured(firings: Firings, hits: Hits, surfaces: NDArray[np.void], seed: int) -> Hits:
    """Make what was met brighter and darker, nearer and farther from place to place, by the texture and relief of each surface.

    The brightness goes as the cosine of incidence does, and makes nothing brighter than a white surface. Relief moves
    what is met along the pulse. Both are taken on the axis of the pulse, at the range of the sub-ray.

    Parameters
    ----------
    surfaces : (m,) `SURFACE`, the window's table
    seed : of the world
    """
    met = firings.origin_m, firings.direction, hits.count, hits.range_m, hits.surface
    out = hits
    if surfaces["texture"].any():
        out = replace(out, cos_incidence=hits.cos_incidence.copy())
        of_surface = [np.ascontiguousarray(surfaces[name]) for name in ("texture", "reflectance")]
        grid_m = np.where(surfaces["part"] == PlantPart.NONE, _GRID_M, _BARK_GRID_M)
        _vary(*met, *of_surface, grid_m, seed, out.cos_incidence)
    if surfaces["relief_m"].any():
        out = replace(out, range_m=hits.range_m.copy())
        _raise(*met, np.ascontiguousarray(surfaces["relief_m"]), seed, out.range_m)
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _vary(
    origin_m: F8,
    direction: F8,
    count: U2,
    range_m: F4,
    met: U4,
    texture: F4,
    reflectance: F4,
    grid_m: F8,
    seed: int,
    cosine: F4,
) -> None:
    """Multiply the cosines (n,) of the sub-rays of pulses (k, L)."""
    stop = ZERO
    for i in range(count.shape[0]):
        for j in range(count.shape[1]):
            start, stop = stop, stop + int(count[i, j])
            at_m, patch = -np.inf, 0.0
            for ray in range(start, stop):
                if not range_m[ray] < np.inf or texture[met[ray]] == 0.0:
                    continue
                if abs(range_m[ray] - at_m) > _SAME_M:
                    at_m = np.float64(range_m[ray])
                    drawn, _ = _of_patch(seed, 1.0 / grid_m[met[ray]], origin_m, direction, i, j, at_m)
                    patch = _SPREAD * (2.0 * drawn - 1.0)
                bright = 1.0 + texture[met[ray]] * patch
                cosine[ray] *= np.float32(min(bright, max(1.0, 1.0 / reflectance[met[ray]])))


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _raise(origin_m: F8, direction: F8, count: U2, range_m: F4, met: U4, relief_m: F4, seed: int, out_m: F4) -> None:
    """Move the ranges (n,) of the sub-rays of pulses (k, L) by the relief where they end."""
    stop = ZERO
    for i in range(count.shape[0]):
        for j in range(count.shape[1]):
            start, stop = stop, stop + int(count[i, j])
            for ray in range(start, stop):
                if range_m[ray] < np.inf and relief_m[met[ray]] > 0.0:
                    at_m = np.float64(range_m[ray])
                    _, drawn = _of_patch(seed, 1.0 / _RELIEF_GRID_M, origin_m, direction, i, j, at_m)
                    even = 2.0 * drawn - 1.0
                    square = even * even
                    out_m[ray] += relief_m[met[ray]] * _STANDING_OUT * (square * square * even)


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False, forceinline=True)
def _of_patch(seed: int, per_m: float, origin_m: F8, direction: F8, i: int, j: int, at_m: float) -> tuple[float, float]:
    """Draw the numbers in [0, 1) of the patch at a range along a pulse (i, j); folds make the borders of a grid's cells crooked."""
    x = per_m * (origin_m[i, j, 0] + at_m * direction[i, j, 0])
    y = per_m * (origin_m[i, j, 1] + at_m * direction[i, j, 1])
    z = per_m * (origin_m[i, j, 2] + at_m * direction[i, j, 2])
    u = math.floor(x + fold(0.37 * y + 0.61 * z) + 0.4 * fold(2.3 * z - 1.7 * y))
    v = math.floor(y + fold(0.53 * z - 0.41 * x) + 0.4 * fold(1.9 * x + 2.1 * z))
    w = math.floor(z + fold(0.43 * x + 0.57 * y) + 0.4 * fold(1.6 * y - 2.2 * x))
    low = np.int64(u) & 0xFFFFFFFF
    return uniform_pair(seed, _TEXTURE, low | (np.int64(v) << 32), np.int64(w) & 0xFFFFFFFF)
