"""Trails of harvesters and forwarders through a managed stand: straight, parallel, with a rut under the wheels of either side.

A rut is a smooth trough between low shoulders of the soil that it was pressed out of, deep and shallow by turns. Rut depths of
0.17, 0.22 and 0.35 m were measured on dry, moist and wet trails of skidders (Jourgholami and Majnounian, "Effects of wheeled
cable skidder on rut formation in skid trail", Journal of Forestry Research 22, 2011); those of older trails are less.
"""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import cos, sin
from vlp16emu.forest.ground.settings import Terrain
from vlp16emu.forest.purpose import Growth
from vlp16emu.random import philox4x32
from vlp16emu.trig import cos_sin
from vlp16emu.types import Array

_TRACK_M = (1.8, 2.2)
"""Between the middles of a trail's ruts, least and most: forwarders are 2.5 m to 3 m wide over all (assumption)."""

_RUT_M = (0.5, 0.7)
"""Width of a rut at the height of the ground beside it, least and most: that of a tyre (600/55-26.5 and 710/45-26.5 are usual)."""

_DEPTH_M = (0.05, 0.2)  # least and most depth along a rut; assumption, with the source above

_SHOULDER = 1.5
"""Where the shoulder of a rut ends, over half its width; it is then a seventeenth as high as the rut is deep."""

_WAVES_M = (7.0, 19.0)  # lengths of the waves by which depth changes along a rut; assumption
_FREE_M = 2.0  # from the middle of a trail within which no tree stands: trails are 4 m wide (FSC and PEFC in Germany)

_RUT = int(Growth.RUT)


class Trails:
    """Trails over all of the plane, one of them at a place that the seed gives."""

    def __init__(self, section: Terrain, *, seed: int) -> None:
        self._spacing_m, towards = section.trail_spacing_m, math.radians(section.trail_towards_deg)
        self._along = (cos(towards), sin(towards))
        self._seed = (np.uint32(seed & 0xFFFFFFFF), np.uint32(seed >> 32))
        self.free_share = 1.0 - 2 * _FREE_M / self._spacing_m if self._spacing_m else 1.0  # on which trees may stand

    def are_free(self, xy_m: Array) -> NDArray[np.bool_]:
        """Which of points (n, 2) are off all trails."""
        if not self._spacing_m:
            return np.ones(len(xy_m), np.bool_)
        first = _first_m(*self._seed, self._spacing_m)
        across_m = self._along[0] * xy_m[:, 1] - self._along[1] * xy_m[:, 0] - first
        aside_m = np.abs(across_m - self._spacing_m * np.floor(across_m / self._spacing_m + 0.5))
        return np.asarray(aside_m > _FREE_M)

    def add(self, height_m: Array, x_m: Array, y_m: Array) -> None:
        """Add ruts to heights (n,) of points."""
        if self._spacing_m:
            _add_ruts(height_m, x_m, y_m, self._spacing_m, *self._along, *self._seed)


@numba.njit(cache=True, nogil=True)
def _first_m(seed_low: np.uint32, seed_high: np.uint32, spacing_m: float) -> float:
    none = np.uint32(0)
    return philox4x32(none, none, np.uint32(1), np.uint32(_RUT), seed_low, seed_high)[0] * 2.0**-32 * spacing_m


@numba.njit(cache=True, nogil=True)
def _add_ruts(
    out: Array,
    x: Array,
    y: Array,
    spacing_m: float,
    along_x: float,
    along_y: float,
    seed_low: np.uint32,
    seed_high: np.uint32,
) -> None:
    """Add to (n,) heights the ruts of the nearest trail of each point."""
    first = _first_m(seed_low, seed_high, spacing_m)
    widest_m = _TRACK_M[1] / 2 + _SHOULDER * _RUT_M[1] / 2
    for i in range(out.shape[0]):
        across = along_x * y[i] - along_y * x[i] - first
        trail = math.floor(across / spacing_m + 0.5)
        aside = across - trail * spacing_m
        if abs(aside) > widest_m:
            continue
        number = np.uint32(trail & 0xFFFFFFFF)
        words = philox4x32(number, np.uint32(0), np.uint32(0), np.uint32(_RUT), seed_low, seed_high)
        track_m = _TRACK_M[0] + words[0] * 2.0**-32 * (_TRACK_M[1] - _TRACK_M[0])
        reach_m = _SHOULDER / 2 * (_RUT_M[0] + words[1] * 2.0**-32 * (_RUT_M[1] - _RUT_M[0]))
        off = (abs(aside) - track_m / 2) / reach_m
        square = off * off
        if square < 1.0:
            phases = words[2] if aside > 0 else words[3]
            depth_m = _depth_m(along_x * x[i] + along_y * y[i], phases)
            rest = 1.0 - square
            out[i] -= depth_m * (rest * rest) * (1.0 - _SHOULDER * _SHOULDER * square)


@numba.njit(cache=True, nogil=True)
def _depth_m(along_m: float, phases: np.uint32) -> float:
    """Depth of a rut at a place along it; the phases of its waves are one half of the bits each."""
    one, other = (phases >> np.uint32(16)) * 2.0**-16, (phases & np.uint32(0xFFFF)) * 2.0**-16
    wave = cos_sin(2 * math.pi * (along_m / _WAVES_M[0] + one))[0]
    wave += cos_sin(2 * math.pi * (along_m / _WAVES_M[1] + other))[0]
    return _DEPTH_M[0] + (0.5 + 0.25 * wave) * (_DEPTH_M[1] - _DEPTH_M[0])
