"""Ground with relief: a sum of plane waves, so that it has no edge, no period and no grid.

Two bands: hills, and roughness that a foot would feel. Within a band the power spectrum falls with
the third power of the wave number (assumption; natural ground is found between 2.5 and 4), which
makes a wave's variance proportional to its wavelength when waves are spread evenly over log wavelength.
"""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.random import Purpose, generator

__all__ = ["Terrain"]

Array = NDArray[np.float64]

_HILL_WAVELENGTHS_M = (30.0, 300.0)
_ROUGH_WAVELENGTHS_M = (1.0, 12.0)
_WAVES_PER_BAND = 48
"""Enough that the sum of a band is near normal; the cost of a height is proportional to it."""


class Terrain:
    """Ground height at any point of the plane, good to a nanometre up to 1e6 m from the origin.

    Parameters
    ----------
    seed : of the scenario
    hill_rms_m : standard deviation of height over wavelengths of 30 m to 300 m
    rough_rms_m : standard deviation of height over wavelengths of 1 m to 12 m
    slope_deg : of the plane under it all, which passes through the origin
    slope_towards_deg : where that plane rises to, counter-clockwise from east
    """

    def __init__(
        self, *, seed: int, hill_rms_m: float, rough_rms_m: float, slope_deg: float, slope_towards_deg: float
    ) -> None:
        bands = ((_HILL_WAVELENGTHS_M, hill_rms_m), (_ROUGH_WAVELENGTHS_M, rough_rms_m))
        self._waves = np.concatenate([_band(seed, i, *band) for i, band in enumerate(bands)])
        rise, towards = math.tan(math.radians(slope_deg)), math.radians(slope_towards_deg)
        self._gradient = (rise * math.cos(towards), rise * math.sin(towards))

    def height_m(self, x_m: Array, y_m: Array) -> Array:
        """Ground height at points of any common shape; a point's height depends on that point alone."""
        x, y = (np.ascontiguousarray(a, dtype=np.float64) for a in np.broadcast_arrays(x_m, y_m))
        height = np.empty(x.shape)
        _heights(height.reshape(-1), x.reshape(-1), y.reshape(-1), self._waves, *self._gradient)
        return height


def _band(seed: int, number: int, wavelengths_m: tuple[float, float], rms_m: float) -> Array:
    """Waves of one band: (n, 4) with wave vector x and y in rad/m, amplitude in m, phase in rad; none if flat."""
    count = _WAVES_PER_BAND if rms_m > 0 else 0
    rng = generator(seed, Purpose.TERRAIN, number)
    shortest, longest = wavelengths_m
    position = (np.arange(count) + rng.random(count)) / _WAVES_PER_BAND
    wavelength = shortest * (longest / shortest) ** position
    direction, phase = rng.uniform(0, 2 * np.pi, (2, count))
    # A wave of amplitude a has variance a**2 / 2.
    amplitude = rms_m * np.sqrt(2 * wavelength / wavelength.sum())
    number_rad_m = 2 * np.pi / wavelength
    return np.column_stack(
        [number_rad_m * np.cos(direction), number_rad_m * np.sin(direction), amplitude, phase]
    )


@numba.njit(cache=True, nogil=True)
def _heights(out: Array, x: Array, y: Array, waves: Array, gradient_x: float, gradient_y: float) -> None:
    """Fill (n,) heights; each point is summed alone so that its neighbours cannot matter."""
    for i in range(out.shape[0]):
        z = gradient_x * x[i] + gradient_y * y[i]
        for j in range(waves.shape[0]):
            z += waves[j, 2] * math.cos(waves[j, 0] * x[i] + waves[j, 1] * y[i] + waves[j, 3])
        out[i] = z
