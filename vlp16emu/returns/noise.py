"""Errors of range and reflectivity: white ones of each echo, and those that a unit is born with."""

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.random import Purpose, normal, uniform
from vlp16emu.returns.law import Law

__all__ = [
    "BIAS_LIMIT_M",
    "Noise",
    "gain",
    "no_return_reflectivity",
    "range_bias_m",
    "range_sigma_m",
]

BIAS_LIMIT_M = 0.03
"""Accuracy of the data sheet, which no laser exceeds."""
_STEADY, _DARK = 0.88, 0.024
_FAINTEST_REFLECTANCE = 0.01
_NO_RETURN_CODES = 3, 24
"""Least and greatest on no-returns of two real units with 3.x firmware: 3..11 on one, 9..24 on the other."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Errors of a unit. The order of magnitude of each is told with its default in the scenario."""

    range_noise_m: float
    """White, one sigma, of a target of 20 % reflectivity at short range."""
    range_bias_m: float
    """One sigma of the lasers' constant errors."""
    warm_up_m: float
    """By how much ranges are too long at power-up."""
    warm_up_s: float
    """Time constant with which that fades, more than 0."""
    reflectivity_noise: float
    """White, one sigma, in counts."""
    gain_spread: float
    """One sigma of the lasers' relative errors of reflectivity."""
    weak_echoes_lost: bool
    """Whether there is a detection threshold."""
    no_return_reflectivity: bool
    """Whether records without a return carry their laser's constant."""


def range_bias_m(seed: int, lasers: int, sigma_m: float) -> NDArray[np.float64]:
    """Constant error of each laser of the unit, (lasers,) m: Gaussian, cut at the data sheet's accuracy."""
    return np.clip(sigma_m * normal(seed, Purpose.RANGE_BIAS, 0, lasers), -BIAS_LIMIT_M, BIAS_LIMIT_M)


def gain(seed: int, lasers: int, spread: float) -> NDArray[np.float64]:
    """Factor on the reflectivity of each laser of the unit, (lasers,), above 0."""
    return np.exp(spread * normal(seed, Purpose.REFLECTIVITY, 0, lasers))


def no_return_reflectivity(seed: int, lasers: int) -> NDArray[np.uint8]:
    """Reflectivity of each laser's records without a return, (lasers,).

    Real units send it in 50 to 98 % of such records, and multiples of it in the others; here it is constant.
    """
    low, high = _NO_RETURN_CODES
    drawn = low + (high - low + 1) * uniform(seed, Purpose.NO_RETURN, 0, lasers)
    return drawn.astype(np.uint8)


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False, forceinline=True)
def range_sigma_m(law: Law, reflectance: float, amplitude: float) -> float:
    """White range noise of an echo, one sigma.

    sigma**2 = noise**2 (0.88 + 0.024 / reflectance) + (width / signal-to-noise ratio)**2. The first part was fitted to
    a real unit before a static scene 0.5 to 8 m away: 6.5 mm in the median, 8.8 mm below a reflectivity of 5, 6.2 mm
    above 50, and no growth with range. For the sensor fires stronger at what is far or dark: on the HDL-32E one of 11
    powers, chosen by the shot before (its software version 2.0). The second part is the least error of the place of
    a Gaussian pulse in white noise, and counts where power is at its end.

    Parameters
    ----------
    reflectance : as it is reported; 0.01 and 1 stand for what is darker or brighter
    amplitude : of the peak
    """
    shown = min(max(reflectance, _FAINTEST_REFLECTANCE), 1.0)
    far_m = law.sigma_m * law.amplitude_noise / amplitude
    return math.sqrt(law.range_noise_m * law.range_noise_m * (_STEADY + _DARK / shown) + far_m * far_m)
