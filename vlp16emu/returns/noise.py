"""Errors of range and reflectivity, white ones of each echo and those that a unit is born with.

And the reflectivity byte.
"""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.random import Purpose, normal, uniform
from vlp16emu.returns.settings import DetectorConstants

__all__ = [
    "BIAS_LIMIT_M",
    "RETROREFLECTIVE",
    "gain",
    "no_return_reflectivity",
    "range_bias_m",
    "range_sigma_m",
    "reflectivity_byte",
]

BIAS_LIMIT_M = 0.03
"""Accuracy of the data sheet, which no laser exceeds."""
_STEADY, _DARK = 0.88, 0.024
_FAINTEST_REFLECTANCE = 0.01
_NO_RETURN_CODES = 3, 24
"""Least and greatest on no-returns of two real units with 3.x firmware: 3..11 on one, 9..24 on the other."""


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
def range_sigma_m(constants: DetectorConstants, reflectance: float, amplitude: float) -> float:
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
    far_m = constants.sigma_m * constants.amplitude_noise / amplitude
    return math.sqrt(
        constants.range_noise_m * constants.range_noise_m * (_STEADY + _DARK / shown) + far_m * far_m
    )


RETROREFLECTIVE = 100.5
"""Percent from which a target is no white wall any more; what rounds to 100 still is."""
_IDEAL = 1000.0
"""Reflectance, as a multiple of a white Lambertian surface, that is reported as 255. A coefficient of retroreflection
R (cd/lx/m2) equals a reflectance of pi R: 255 stands for 318 cd/lx/m2, between high-intensity (about 250) and prismatic
sheeting (about 700). The manual gives the ends of the scale only; that it is logarithmic between them is an assumption."""
_COUNTS_PER_E_FOLD = (255 - 101) / math.log(_IDEAL)


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False, forceinline=True)
def reflectivity_byte(percent: float, gain: float, noise: float) -> np.uint8:
    """Code a reflectivity: 0..100 percent of a diffuse target, 101..255 of a retroreflector.

    Source: 63-9243 Rev D, section 6.1. Neither gain nor noise moves a target from one class to the other,
    since they stand for small errors of calibration.

    Parameters
    ----------
    percent : brightness, corrected for range, of a white Lambertian surface at right angles
    gain : of the laser
    noise : in counts
    """
    if percent <= RETROREFLECTIVE:
        return np.uint8(min(max(np.rint(gain * percent + noise), 0.0), 100.0))
    code = 101.0 + _COUNTS_PER_E_FOLD * math.log(0.01 * gain * percent) + noise
    return np.uint8(min(max(np.rint(code), 101.0), 255.0))
