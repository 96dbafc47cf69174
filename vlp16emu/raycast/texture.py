"""Patches of brighter and darker surface: bark, ground and walls are not of one reflectance throughout."""

import math
from dataclasses import replace

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.random import Purpose, uniform_pair
from vlp16emu.trig import ZERO, fold
from vlp16emu.types import Firings, Hits

__all__ = ["textured"]

_GRID_M = 0.4
"""Size of a patch; with it neighbouring returns are equal as often, and differ as much, as those of real sensors from walls."""
_SAME_M = 0.1
"""Sub-rays of a pulse that end within this of each other end on one patch."""
_SPREAD = math.sqrt(3.0)
"""Half-width of an even distribution of variance one."""
_TEXTURE = ZERO + Purpose.TEXTURE


def textured(firings: Firings, hits: Hits, surfaces: NDArray[np.void], seed: int) -> Hits:
    """Make what was met brighter and darker from place to place, in the world, by the texture of each surface.

    The factor goes as the cosine of incidence does. It is taken on the axis of the pulse, at the range of the sub-ray,
    and makes nothing brighter than a white surface.

    Parameters
    ----------
    surfaces : (m,) `SURFACE`, the window's table
    seed : of the world
    """
    if not surfaces["texture"].any():
        return hits
    cosine = hits.cos_incidence.copy()
    of_surface = [np.ascontiguousarray(surfaces[name]) for name in ("texture", "reflectance")]
    _vary(
        *(firings.origin_m, firings.direction, hits.count, hits.range_m, hits.surface),
        *of_surface,
        seed,
        cosine,
    )
    return replace(hits, cos_incidence=cosine)


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _vary(
    origin_m: NDArray[np.float64],
    direction: NDArray[np.float64],
    count: NDArray[np.uint16],
    range_m: NDArray[np.float32],
    met: NDArray[np.uint32],
    texture: NDArray[np.float32],
    reflectance: NDArray[np.float32],
    seed: int,
    cosine: NDArray[np.float32],
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
                    x, y, z = (
                        origin_m[i, j, 0] + at_m * direction[i, j, 0],
                        origin_m[i, j, 1] + at_m * direction[i, j, 1],
                        origin_m[i, j, 2] + at_m * direction[i, j, 2],
                    )
                    patch = _SPREAD * (2.0 * _of_patch(seed, x / _GRID_M, y / _GRID_M, z / _GRID_M) - 1.0)
                bright = 1.0 + texture[met[ray]] * patch
                cosine[ray] *= np.float32(min(bright, max(1.0, 1.0 / reflectance[met[ray]])))


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False, forceinline=True)
def _of_patch(seed: int, x: float, y: float, z: float) -> float:
    """Draw the number in [0, 1) of the patch at a place, in grid steps; folds make the borders crooked."""
    u = math.floor(x + fold(0.37 * y + 0.61 * z) + 0.4 * fold(2.3 * z - 1.7 * y))
    v = math.floor(y + fold(0.53 * z - 0.41 * x) + 0.4 * fold(1.9 * x + 2.1 * z))
    w = math.floor(z + fold(0.43 * x + 0.57 * y) + 0.4 * fold(1.6 * y - 2.2 * x))
    low = np.int64(u) & 0xFFFFFFFF
    drawn, _ = uniform_pair(seed, _TEXTURE, low | (np.int64(v) << 32), np.int64(w) & 0xFFFFFFFF)
    return drawn
