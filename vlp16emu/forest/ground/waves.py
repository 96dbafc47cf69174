"""Smooth noise over the plane without edge and period: sums of plane waves."""

import numba
import numpy as np

from vlp16emu.elementary import cos, power, sin
from vlp16emu.trig import cos_sin
from vlp16emu.types import Array

_WAVES = 48  # enough that their sum is near normal; its cost is proportional to it


def waves(rng: np.random.Generator, wavelengths_m: tuple[float, float], rms: float) -> Array:
    """Waves of a band: (n, 4) with wave vector x and y in rad/m, amplitude, phase; none if flat.

    Spread evenly over log wavelength, with a variance in proportion to the wavelength: the power spectrum falls with the
    third power of the wave number.
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


@numba.njit(cache=True, nogil=True)
def sum_of_waves(out: Array, x: Array, y: Array, band: Array, gradient_x: float, gradient_y: float) -> None:
    """Fill (n,) sums of a slope and the waves of bands; each point is summed alone, wave by wave, so that its neighbours cannot matter."""
    for i in range(out.shape[0]):
        out[i] = gradient_x * x[i] + gradient_y * y[i]
    for j in range(band.shape[0]):
        along_x, along_y, high, phase = band[j]
        for i in range(out.shape[0]):
            out[i] += high * cos_sin(along_x * x[i] + along_y * y[i] + phase)[0]
