"""Ground with relief: a sum of plane waves and scattered mounds and pits, without edge and period.

There are two bands of waves: hills, and roughness at the scale of a foot. Within a band the power spectrum
falls with the third power of the wave number (assumption; natural ground has exponents between 2.5 and 4).
Mounds and hollows represent features that waves cannot: old stumps, stones under moss. Uprooted trees leave
pits with a mound beside each, and machines leave ruts: smooth troughs under the wheels of either side,
between low shoulders of displaced soil, with a depth that varies along the trail.
"""

import math

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import atan2, cos, power, sin, tan
from vlp16emu.errors import GeometryError
from vlp16emu.forest.purpose import Growth
from vlp16emu.forest.settings import Terrain
from vlp16emu.kernels.compiler import array_kernel, inline_kernel
from vlp16emu.random import generator, philox4x32
from vlp16emu.trig import cos_sin
from vlp16emu.types import F8

_WAVES = 48  # enough for a nearly normal sum; the cost is proportional to it


def waves(rng: np.random.Generator, wavelengths_m: tuple[float, float], rms: float) -> F8:
    """Waves of a band (n, 4): wave vector x and y in rad/m, amplitude, phase; empty if flat.

    They are spread evenly over log wavelength, with a variance proportional to the wavelength: the power
    spectrum falls with the third power of the wave number.
    """
    count = _WAVES if rms > 0 else 0
    shortest, longest = wavelengths_m
    position = (np.arange(count) + rng.random(count)) / _WAVES
    wavelength = shortest * power(longest / shortest, position)
    direction, phase = rng.uniform(0, 2 * np.pi, (2, count))
    # A wave of amplitude a has variance a**2 / 2.
    amplitude = rms * np.sqrt(2 * wavelength / wavelength.sum())
    number_rad_m = 2 * np.pi / wavelength
    return np.column_stack([number_rad_m * cos(direction), number_rad_m * sin(direction), amplitude, phase])


@array_kernel
def sum_of_waves(out: F8, x: F8, y: F8, band: F8, gradient_x: float, gradient_y: float) -> None:
    """Fill (n,) sums of a slope and waves.

    Each point is summed alone, wave by wave, independent of its neighbours.
    """
    for i in range(out.shape[0]):
        out[i] = gradient_x * x[i] + gradient_y * y[i]
    for j in range(band.shape[0]):
        along_x, along_y, high, phase = band[j]
        for i in range(out.shape[0]):
            out[i] += high * cos_sin(along_x * x[i] + along_y * y[i] + phase)[0]


_TRACK_M = (1.8, 2.2)
"""Range of the distance between the centres of a trail's ruts: forwarders are 2.5 m to 3 m wide overall
(assumption)."""
_RUT_M = (0.5, 0.7)
"""Range of a rut's width at the level of the ground beside it: a tyre's width (600/55-26.5 and 710/45-26.5
are usual)."""
# Range of depth along a rut: 0.17, 0.22 and 0.35 m were measured on dry, moist and wet skidder trails
# (Jourgholami and Majnounian, "Effects of wheeled cable skidder on rut formation in skid trail", J. Forestry
# Research 22, 2011).
_DEPTH_M = (0.05, 0.2)
_SHOULDER = 1.5
"""Distance of the end of a rut's shoulder over half the rut's width; the shoulder is a seventeenth of the
depth high."""
_WAVES_M = (7.0, 19.0)  # wavelengths of the depth along a rut; assumption
_FREE_M = 2.0
"""Distance from the middle of a trail without trees: trails are 4 m wide (FSC and PEFC in Germany)."""
_RUT = int(Growth.RUT)


class Trails:
    """Parallel trails over the whole plane, at an offset drawn from the seed."""

    def __init__(self, section: Terrain, *, seed: int) -> None:
        self._spacing_m = section.trail_spacing_m
        towards = math.radians(section.trail_towards_deg)
        self._along = (cos(towards), sin(towards))
        self._seed = (np.uint32(seed & 0xFFFFFFFF), np.uint32(seed >> 32))
        self.free_share = 1.0 - 2 * _FREE_M / self._spacing_m if self._spacing_m else 1.0
        """Share of the ground for trees."""

    def are_free(self, xy_m: F8) -> NDArray[np.bool_]:
        """Return a mask (n,) of the points (n, 2) off all trails."""
        if not self._spacing_m:
            return np.ones(len(xy_m), np.bool_)
        first = _first_m(*self._seed, self._spacing_m)
        across_m = self._along[0] * xy_m[:, 1] - self._along[1] * xy_m[:, 0] - first
        aside_m = np.abs(across_m - self._spacing_m * np.floor(across_m / self._spacing_m + 0.5))
        return np.asarray(aside_m > _FREE_M)

    def add(self, height_m: F8, x_m: F8, y_m: F8) -> None:
        """Add ruts to heights (n,) of points."""
        if self._spacing_m:
            _add_ruts(height_m, x_m, y_m, self._spacing_m, *self._along, *self._seed)


@array_kernel
def _first_m(seed_low: np.uint32, seed_high: np.uint32, spacing_m: float) -> float:
    none = np.uint32(0)
    return (
        philox4x32(none, none, np.uint32(1), np.uint32(_RUT), seed_low, seed_high)[0] * 2.0**-32 * spacing_m
    )


@array_kernel
def _add_ruts(
    out: F8,
    x: F8,
    y: F8,
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
            # The phases of a rut's two waves take one half of the bits each.
            phases = words[2] if aside > 0 else words[3]
            along_m = along_x * x[i] + along_y * y[i]
            first_phase = (phases >> np.uint32(16)) * 2.0**-16
            second_phase = (phases & np.uint32(0xFFFF)) * 2.0**-16
            wave = cos_sin(2 * math.pi * (along_m / _WAVES_M[0] + first_phase))[0]
            wave += cos_sin(2 * math.pi * (along_m / _WAVES_M[1] + second_phase))[0]
            depth_m = _DEPTH_M[0] + (0.5 + 0.25 * wave) * (_DEPTH_M[1] - _DEPTH_M[0])
            inside = 1.0 - square
            out[i] -= depth_m * (inside * inside) * (1.0 - _SHOULDER * _SHOULDER * square)


_HILL_WAVELENGTHS_M = (30.0, 300.0)
_ROUGH_WAVELENGTHS_M = (1.0, 12.0)
_STEEPEST_DEG = 45.0  # rms of slopes; loose soil slides from 30 to 45 degrees on (angle of repose)
_MOUND_CELL_M = 2.0
"""Edge of a square that holds at most one mound: the widest mound, so that nine squares hold all relevant
ones."""
_MOUND_WIDTH_M = (1.0, 2.0)
_MOUND_HEIGHT_M = 0.15  # greatest height of mounds and depth of hollows; assumption, like their width
_PIT_CELL_M = 4.0
"""Edge of a square that holds at most one pit with its mound: more than their reach from their common
centre."""
_PIT_WIDTH_M = (2.0, 3.0)
_PIT_DEPTH_M = (0.2, 0.4)
"""Range of sizes; the mound is as wide and as high as the pit (assumption)."""
_PIT_ASIDE = 0.8  # distance of pit and mound from their common centre over their radius; assumption
_MOUND = int(Growth.MOUND)
_PIT = int(Growth.PIT)


class TerrainHeights:
    """Ground height at any point of the plane, accurate to 1 nm up to 1e6 m from the origin.

    The slope has height 0 there.

    Raises GeometryError for waves that are steeper than ground can be.
    """

    def __init__(self, section: Terrain, *, seed: int) -> None:
        bands = ((_HILL_WAVELENGTHS_M, section.hill_rms_m), (_ROUGH_WAVELENGTHS_M, section.rough_rms_m))
        self._waves = np.concatenate(
            [waves(generator(seed, Growth.TERRAIN, i), *band) for i, band in enumerate(bands)]
        )
        number2 = np.square(self._waves[:, 0]) + np.square(self._waves[:, 1])
        steep = math.sqrt(float((np.square(self._waves[:, 2]) * number2).sum()) / 2)
        if (steep_deg := math.degrees(atan2(steep, 1.0))) > _STEEPEST_DEG:
            relief = f"hill_rms_m = {section.hill_rms_m:g} and rough_rms_m = {section.rough_rms_m:g}"
            found = f"{relief} slope by {steep_deg:.1f} degrees rms"
            raise GeometryError(
                "world.terrain", found, f"at most {_STEEPEST_DEG:g}: hills of 10 m, roughness of 0.4 m"
            )
        rise = tan(math.radians(section.slope_deg))
        towards = math.radians(section.slope_towards_deg)
        self._gradient = (rise * cos(towards), rise * sin(towards))
        self._seed = (np.uint32(seed & 0xFFFFFFFF), np.uint32(seed >> 32))
        self._mound_share = section.mounds_per_ha * _MOUND_CELL_M * _MOUND_CELL_M / 10_000
        self._pit_share = section.pits_per_ha * _PIT_CELL_M * _PIT_CELL_M / 10_000
        self.trails = Trails(section, seed=seed)

    def height_m(self, x_m: F8, y_m: F8) -> F8:
        """Ground height at points of any common shape; a point's height depends on that point alone."""
        x, y = (np.ascontiguousarray(a, dtype=np.float64) for a in np.broadcast_arrays(x_m, y_m))
        height = np.empty(x.shape)
        flat = height.reshape(-1), x.reshape(-1), y.reshape(-1)
        sum_of_waves(*flat, self._waves, *self._gradient)
        if self._mound_share:
            _add_features(*flat, self._mound_share, _MOUND_CELL_M, _MOUND, *self._seed)
        if self._pit_share:
            _add_features(*flat, self._pit_share, _PIT_CELL_M, _PIT, *self._seed)
        self.trails.add(*flat)
        return height


@array_kernel
def _add_features(
    out: F8,
    x: F8,
    y: F8,
    share: float,
    cell_m: float,
    purpose: int,
    seed_low: np.uint32,
    seed_high: np.uint32,
) -> None:
    """Add to heights (n,) the mounds or pits of the squares around each point.

    `share` of all squares have one.
    """
    for i in range(out.shape[0]):
        column, row = math.floor(x[i] / cell_m), math.floor(y[i] / cell_m)
        for ix in range(column - 1, column + 2):
            for iy in range(row - 1, row + 2):
                column_word, row_word = np.uint32(ix & 0xFFFFFFFF), np.uint32(iy & 0xFFFFFFFF)
                words = philox4x32(
                    column_word, row_word, np.uint32(0), np.uint32(purpose), seed_low, seed_high
                )
                if words[0] * 2.0**-32 >= share:
                    continue
                east_m = x[i] - (ix + words[1] * 2.0**-32) * cell_m
                north_m = y[i] - (iy + words[2] * 2.0**-32) * cell_m
                # Two numbers from one half of the last word each: 65536 values are enough.
                first_draw = (words[3] >> np.uint32(16)) * 2.0**-16
                second_draw = (words[3] & np.uint32(0xFFFF)) * 2.0**-16
                if purpose == _PIT:
                    out[i] += _pit_m(east_m, north_m, first_draw, second_draw)
                    continue
                # A mound with a width and a height in [0, 1) is (1 - (r / R)^2)^3, smooth to its rim.
                radius = (_MOUND_WIDTH_M[0] + first_draw * (_MOUND_WIDTH_M[1] - _MOUND_WIDTH_M[0])) / 2
                inside = _dome(east_m, north_m, radius)
                out[i] += (2.0 * second_draw - 1.0) * _MOUND_HEIGHT_M * (inside * inside * inside)


@array_kernel
def _pit_m(east_m: float, north_m: float, size: float, turn: float) -> float:
    """Height of a pit and its mound for a size and a direction in [0, 1).

    Each is (1 - (r / R)^2)^2, smooth to its rim.
    """
    radius = (_PIT_WIDTH_M[0] + size * (_PIT_WIDTH_M[1] - _PIT_WIDTH_M[0])) / 2
    depth = _PIT_DEPTH_M[0] + size * (_PIT_DEPTH_M[1] - _PIT_DEPTH_M[0])
    east = _PIT_ASIDE * radius * cos(2 * math.pi * turn)
    north = _PIT_ASIDE * radius * sin(2 * math.pi * turn)
    mound = _dome(east_m - east, north_m - north, radius)
    pit = _dome(east_m + east, north_m + north, radius)
    return depth * (mound * mound - pit * pit)


@inline_kernel
def _dome(east_m: float, north_m: float, radius: float) -> float:
    """Height of a paraboloid of height 1 at an offset from its centre; 0 beyond its radius."""
    return max(1.0 - (east_m * east_m + north_m * north_m) / (radius * radius), 0.0)
