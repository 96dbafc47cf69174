"""Extinction and brightness of fog and rain."""

import math

from vlp16emu.elementary import power

_LN10 = 2.302585092994046
_WAVELENGTH_NM = 903.0  # data sheet of the VLP-16
_LIDAR_RATIO_SR = 18.2
"""Extinction over backscatter of water droplets, near infrared (1.06 um): Pinnick et al., J. Geophys. Res.
88, 1983. Assumption: the same for rain drops."""


def fog_extinction_per_m(visibility_m: float) -> float:
    """Return the extinction of fog and haze at 903 nm.

    Source: Koschmieder's law at 2 % contrast with the wavelength law of Kruse, McGlauchlin and McQuistan
    (1962) in the form by Kim, McArthur and Korevaar, Proc. SPIE 4214 (2001), in which thick fog does not
    depend on wavelength.
    """
    km = visibility_m / 1000.0
    if km > 50.0:
        q = 1.6
    elif km > 6.0:
        q = 1.3
    elif km > 1.0:
        q = 0.16 * km + 0.34
    else:
        q = max(km - 0.5, 0.0)
    return 3.912 / visibility_m * power(_WAVELENGTH_NM / 550.0, -q)


def rain_extinction_per_m(rain_mm_h: float) -> float:
    """Return the extinction of rain.

    It is 1.076 R**0.67 dB/km, for all wavelengths (Carbonneau and Wisely, Proc. SPIE 3491, 1998).
    """
    return 1.076 * power(rain_mm_h, 0.67) * _LN10 / 10.0 / 1000.0


def extinction_per_m(visibility_m: float | None, rain_mm_h: float) -> float:
    """Return the extinction of fog, if any, and rain together."""
    fog_per_m = 0.0 if visibility_m is None else fog_extinction_per_m(visibility_m)
    return fog_per_m + rain_extinction_per_m(rain_mm_h)


def air_reflectance(extinction_per_m: float, sigma_m: float) -> float:
    """Return the reflectance of a wall that reflects as much as the air within a pulse.

    The pulse has a standard deviation of `sigma_m` in range. The lidar equation gives pi times backscatter
    times the pulse's equivalent length.
    """
    return math.pi * extinction_per_m / _LIDAR_RATIO_SR * math.sqrt(2.0 * math.pi) * sigma_m
