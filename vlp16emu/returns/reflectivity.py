"""The reflectivity byte."""

import math

import numba
import numpy as np

__all__ = ["RETROREFLECTIVE", "reflectivity_byte"]

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
