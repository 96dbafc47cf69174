"""Ground with relief: a sum of plane waves and scattered mounds and pits, so that it has no edge and no period.

Two bands of waves: hills, and roughness that a foot would feel. Within a band the power spectrum falls
with the third power of the wave number (assumption; natural ground is found between 2.5 and 4).
Mounds and hollows represent what waves cannot show: old stumps, stones under moss; pits with a mound beside each
are what uprooted trees leave, and ruts what machines leave.
"""

import math

import numba
import numpy as np

from vlp16emu.elementary import atan2, cos, sin, tan
from vlp16emu.errors import GeometryError
from vlp16emu.forest.ground.settings import Terrain
from vlp16emu.forest.ground.trails import Trails
from vlp16emu.forest.ground.waves import sum_of_waves, waves
from vlp16emu.forest.purpose import Growth
from vlp16emu.random import generator, philox4x32
from vlp16emu.types import Array

_HILL_WAVELENGTHS_M = (30.0, 300.0)
_ROUGH_WAVELENGTHS_M = (1.0, 12.0)

_STEEPEST_DEG = 45.0  # rms of slopes; loose soil slides from 30 to 45 degrees on (angle of repose)

_MOUND_CELL_M = 2.0
"""Edge of a square that holds one mound at most: the widest mound, so that nine squares hold all that matter."""

_MOUND_WIDTH_M = (1.0, 2.0)
_MOUND_HEIGHT_M = 0.15  # mounds rise and hollows sink by up to this; assumption, like their width

_PIT_CELL_M = 4.0
"""Edge of a square that holds one pit with its mound at most: more than both together reach from their middle."""

_PIT_WIDTH_M, _PIT_DEPTH_M = (2.0, 3.0), (0.2, 0.4)
"""From the smallest to the largest; the mound is as wide and as high (assumption)."""

_PIT_ASIDE = 0.8  # distance of the middles of pit and mound from the middle of both over their radius; assumption

_MOUND, _PIT = int(Growth.MOUND), int(Growth.PIT)


class TerrainHeights:
    """Ground height at any point of the plane, good to a nanometre up to 1e6 m from the origin, through which its slope passes.

    Raises GeometryError for waves that are steeper than ground can be.
    """

    def __init__(self, section: Terrain, *, seed: int) -> None:
        bands = ((_HILL_WAVELENGTHS_M, section.hill_rms_m), (_ROUGH_WAVELENGTHS_M, section.rough_rms_m))
        self._waves = np.concatenate([waves(generator(seed, Growth.TERRAIN, i), *band) for i, band in enumerate(bands)])
        number2 = np.square(self._waves[:, 0]) + np.square(self._waves[:, 1])
        steep = math.sqrt(float((np.square(self._waves[:, 2]) * number2).sum()) / 2)
        if (steep_deg := math.degrees(atan2(steep, 1.0))) > _STEEPEST_DEG:
            found = f"hill_rms_m = {section.hill_rms_m:g} and rough_rms_m = {section.rough_rms_m:g} slope by {steep_deg:.1f} degrees rms"
            raise GeometryError("world.terrain", found, f"at most {_STEEPEST_DEG:g}: hills of 10 m, roughness of 0.4 m")
        rise, towards = tan(math.radians(section.slope_deg)), math.radians(section.slope_towards_deg)
        self._gradient = (rise * cos(towards), rise * sin(towards))
        self._seed = (np.uint32(seed & 0xFFFFFFFF), np.uint32(seed >> 32))
        self._mound_share = section.mounds_per_ha * _MOUND_CELL_M * _MOUND_CELL_M / 10_000
        self._pit_share = section.pits_per_ha * _PIT_CELL_M * _PIT_CELL_M / 10_000
        self.trails = Trails(section, seed=seed)

    def height_m(self, x_m: Array, y_m: Array) -> Array:
        """Ground height at points of any common shape; a point's height depends on that point alone."""
        x, y = (np.ascontiguousarray(a, dtype=np.float64) for a in np.broadcast_arrays(x_m, y_m))
        height = np.empty(x.shape)
        sum_of_waves(height.reshape(-1), x.reshape(-1), y.reshape(-1), self._waves, *self._gradient)
        flat = height.reshape(-1), x.reshape(-1), y.reshape(-1)
        if self._mound_share:
            _add(*flat, self._mound_share, _MOUND_CELL_M, _MOUND, *self._seed)
        if self._pit_share:
            _add(*flat, self._pit_share, _PIT_CELL_M, _PIT, *self._seed)
        self.trails.add(*flat)
        return height


@numba.njit(cache=True, nogil=True)
def _add(
    out: Array, x: Array, y: Array, share: float, cell_m: float, purpose: int, seed_low: np.uint32, seed_high: np.uint32
) -> None:
    """Add to (n,) heights the mounds or pits of the squares around each point; `share` of all squares have one."""
    for i in range(out.shape[0]):
        column, row = math.floor(x[i] / cell_m), math.floor(y[i] / cell_m)
        for ix in range(column - 1, column + 2):
            for iy in range(row - 1, row + 2):
                column_word, row_word = np.uint32(ix & 0xFFFFFFFF), np.uint32(iy & 0xFFFFFFFF)
                words = philox4x32(column_word, row_word, np.uint32(0), np.uint32(purpose), seed_low, seed_high)
                if words[0] * 2.0**-32 >= share:
                    continue
                east_m = x[i] - (ix + words[1] * 2.0**-32) * cell_m
                north_m = y[i] - (iy + words[2] * 2.0**-32) * cell_m
                # Two numbers from one half of the last word each: 65536 values are plenty.
                one, other = (words[3] >> np.uint32(16)) * 2.0**-16, (words[3] & np.uint32(0xFFFF)) * 2.0**-16
                if purpose == _MOUND:
                    out[i] += _mound_m(east_m, north_m, one, other)
                else:
                    out[i] += _pit_m(east_m, north_m, one, other)


@numba.njit(cache=True, nogil=True)
def _mound_m(east_m: float, north_m: float, wide: float, high: float) -> float:
    """Height of a mound at a place from its middle, of a width and a height in [0, 1): (1 - (r / R)^2)^3, smooth to its rim."""
    radius = (_MOUND_WIDTH_M[0] + wide * (_MOUND_WIDTH_M[1] - _MOUND_WIDTH_M[0])) / 2
    inside = 1.0 - (east_m * east_m + north_m * north_m) / (radius * radius)
    return (2.0 * high - 1.0) * _MOUND_HEIGHT_M * (inside * inside * inside) if inside > 0.0 else 0.0


@numba.njit(cache=True, nogil=True)
def _pit_m(east_m: float, north_m: float, size: float, turn: float) -> float:
    """Height of a pit and its mound, of a size and a direction in [0, 1): (1 - (r / R)^2)^2 of either, smooth to its rim."""
    radius = (_PIT_WIDTH_M[0] + size * (_PIT_WIDTH_M[1] - _PIT_WIDTH_M[0])) / 2
    depth = _PIT_DEPTH_M[0] + size * (_PIT_DEPTH_M[1] - _PIT_DEPTH_M[0])
    east = _PIT_ASIDE * radius * cos(2 * math.pi * turn)
    north = _PIT_ASIDE * radius * sin(2 * math.pi * turn)
    mound = _dome(east_m - east, north_m - north, radius)
    pit = _dome(east_m + east, north_m + north, radius)
    return depth * (mound * mound - pit * pit)


@numba.njit(cache=True, nogil=True, forceinline=True, _nrt=False)
def _dome(east_m: float, north_m: float, radius: float) -> float:
    """Height of a paraboloid of height 1 at a place from its middle; 0 beyond its radius."""
    return max(1.0 - (east_m * east_m + north_m * north_m) / (radius * radius), 0.0)
