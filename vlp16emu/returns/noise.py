"""Errors of range and reflectivity, white ones of each echo and constant ones of a unit; the reflectivity byte."""

import math
from functools import lru_cache

import numba
import numpy as np

from vlp16emu.elementary import cos, exp, log, power
from vlp16emu.random import Purpose, normal, uniform
from vlp16emu.returns.settings import DetectorConstants
from vlp16emu.trig import ZERO, fold
from vlp16emu.types import F8

BIAS_LIMIT_M = 0.03
"""Accuracy of the data sheet, which no laser exceeds."""
_AT = 0.2
"""Reflectance at which the noise is that of the settings."""
_FAINTEST_REFLECTANCE = 0.01
_OVERTONE_RAD = math.radians(85.0)
_COARSE = 45.0
"""Reflectivity from which on codes are wider apart."""
NO_RETURN_KNOT = 32
"""Firing sequences between two knots of what no-returns carry; assumption, after einride: 78 % of neighbours are equal."""
_NO_RETURN_MIDDLE, _NO_RETURN_SPREAD = (1.5, 20.0), 0.5
"""Middle over the lasers, and spread of its logarithm: 13 and 0.4 on mrpt, 5 and 0.45 on nebula, 2.7 and 0.7 on einride,
1.3 and 1 on the unit of 2014. That middles are even in their logarithm is an assumption."""
_UNITS_KEPT = 64
_WANDER_OF_UNITS, _WANDER_OF_LASERS, _WANDER_CODES = 0.7, 0.6, 25.0
"""Spreads of the logarithm; on nebula a laser is at 1 in 39 to 98 % of its records."""


def range_bias_m(seed: int, lasers: int, sigma_m: float) -> F8:
    """Return the constant range error of each laser, (lasers,) m: Gaussian, cut at the data sheet's accuracy."""
    return np.clip(sigma_m * normal(seed, Purpose.RANGE_BIAS, 0, lasers), -BIAS_LIMIT_M, BIAS_LIMIT_M)


def gain(seed: int, lasers: int, spread: float, sector_spread: float) -> F8:
    """Return the factor on the reflectivity of each laser, (2, lasers), above 0: in even and in odd sectors of 45 deg.

    The same lasers are brighter in alternate sectors: gains of one correlate with those of the next but one by 0.94 on mrpt and 0.82 on
    einride.
    """
    mean, half = (normal(seed, Purpose.REFLECTIVITY, 0, lasers, lane) for lane in (0, 1))
    return exp(spread * mean + sector_spread * np.array([[-1.0], [1.0]]) * half)


def no_return_reflectivity(seed: int, lasers: int, middle: float | None) -> F8:
    """Return the reflectivity of each laser's records without a return, (lasers,), before it is cut to whole numbers.

    Real units send it in 50 to 98 % of such records, and multiples of it in the others.

    Parameters
    ----------
    middle : over the lasers; None to draw it
    """
    if middle is None:
        low, high = _NO_RETURN_MIDDLE
        middle = low * power(high / low, float(uniform(seed, Purpose.NO_RETURN, 0, 1)[0]))
    return np.asarray(middle * exp(_NO_RETURN_SPREAD * normal(seed, Purpose.NO_RETURN, 1, lasers)))


def no_return_multiples(seed: int, first: int, count: int, no_return: F8, wander: float) -> F8:
    """Return multiples of `no_return_reflectivity` that firing sequences first .. first + count - 1 carry.

    It wanders smoothly and stays at 1 where it would be less: on real units it changes by one step at a time, and a steady
    unit is at 1 in 98 % of its records (mrpt), a restless one (einride) in 14 to 73 %, and goes through ten multiples.

    Parameters
    ----------
    no_return : (lasers,) codes for a multiple of one; the greater, the less they wander, as on mrpt
    wander : of a unit in the middle; units differ by a factor of two, one sigma, and their lasers nearly as much

    Returns
    -------
    (knots, lasers), one row for each `NO_RETURN_KNOT` sequences, from that of `first` on to one past the last
    """
    lasers = len(no_return)
    begin, stop = first // NO_RETURN_KNOT, (first + count - 1) // NO_RETURN_KNOT + 2
    drawn = [normal(seed, Purpose.NO_RETURN, begin, stop - begin, 1 + laser) for laser in range(lasers)]
    own = np.minimum(_own_wander(seed, lasers, wander), _WANDER_CODES / no_return)
    return np.asarray(own * np.abs(np.stack(drawn, axis=1)))


@lru_cache(_UNITS_KEPT)
def _own_wander(seed: int, lasers: int, wander: float) -> F8:
    *of_lasers, of_unit = normal(seed, Purpose.NO_RETURN, 1 + lasers, lasers + 1)
    return wander * exp(_WANDER_OF_UNITS * of_unit + _WANDER_OF_LASERS * np.array(of_lasers))


def range_beat_m(seed: int, amplitude_m: float, phase_deg: float | None) -> F8:
    """Return the range error by (24 sequence + laser) mod 5, (5,) m.

    A sine and its first overtone, whose phase follows: 78 to 98 deg more than twice that of the sine on four units,
    with 0.17 to 0.36 of its amplitude. As if a clock of the receiver beat with the pulses.

    Parameters
    ----------
    phase_deg : of a unit of exactly this amplitude; None to draw both
    """
    one, two, three = uniform(seed, Purpose.RANGE_BEAT, 0, 3)
    own_m = amplitude_m * (0.75 + 0.5 * one) if phase_deg is None else amplitude_m
    overtone = 0.17 + 0.19 * three if phase_deg is None else 0.25
    angle = 2.0 * math.pi * (np.arange(5) / 5.0 + (two if phase_deg is None else phase_deg / 360.0))
    return np.asarray(own_m * (cos(angle) + overtone * cos(2.0 * angle + _OVERTONE_RAD)))


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False, forceinline=True)
def range_sigma_m(constants: DetectorConstants, reflectance: float, amplitude: float) -> float:
    """Return the white range noise of an echo, one sigma.

    sigma**2 = noise**2 sqrt(0.2 / reflectance) + (width / signal-to-noise ratio)**2. The first part is that of four real
    units on smooth surfaces without the beat (`protocol/README.md`, "The character of a unit"); it does not grow with
    range, for the sensor fires stronger at what is far or dark: on the HDL-32E one of 11 powers, chosen by the shot before
    (its software version 2.0). The second part is the least error of the place of a Gaussian pulse in white noise, and
    counts where power is at its end.

    Parameters
    ----------
    reflectance : as it is reported; 0.01 and 1 stand for what is darker or brighter
    amplitude : of the peak
    """
    shown = min(max(reflectance, _FAINTEST_REFLECTANCE), 1.0)
    far_m = constants.sigma_m * constants.amplitude_noise / amplitude
    return math.sqrt(constants.range_noise_m * constants.range_noise_m * math.sqrt(_AT / shown) + far_m * far_m)


RANGE_TAIL, REFLECTIVITY_TAIL = 0.012, 0.1
"""Parts of the cube. Residuals of range in stretches of 15 pulses have a kurtosis of 2.62 to 2.68 on four real units, Gaussian ones beside our
beat 2.58; those of reflectivity change between revolutions as with a kurtosis of 6.6."""


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False, forceinline=True)
def heavier(z: float, tail: float) -> float:
    """Turn a normal number into one of the same variance, often small and now and then great: with a part of its cube.

    The fourth moment of a normal number is 3, and the sixth 15.
    """
    return z * (1.0 + tail * z * z) / math.sqrt(1.0 + 6.0 * tail + 15.0 * tail * tail)


_BIN_EDGES_M = exp(np.arange(-12.0, 20.0) / 4.0)
"""Ranges from 0.05 to 116 m at which the step of codes changes."""
_TURNS_PER_BIN, _TURNS_PER_GAIN = 0.31, 29.0
"""They spread the steps of codes over lasers and ranges, and are no measurement."""
_AFTER_STEP = 0.1
"""Share of the white error that comes after the step: with none the histograms are sharper than real ones."""
RETROREFLECTIVE = 100.5
"""Percent from which a target is no white wall any more; what rounds to 100 still is."""
_COUNTS_PER_E_FOLD = (255 - 101) / 6.907755278982137  # logarithm of 1000
"""Counts per factor e of reflectance. 255 stands for 1000 times that of a white Lambertian surface. A coefficient of retroreflection
R (cd/lx/m2) equals a reflectance of pi R: 255 stands for 318 cd/lx/m2, between high-intensity (about 250) and prismatic
sheeting (about 700). The manual gives the ends of the scale only; that it is logarithmic between them is an assumption."""


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False, forceinline=True)
def code_step(step: float, gain: float, range_m: float) -> float:
    """Return the spacing of bright codes of one laser at one range, in counts.

    As if whole numbers of the receiver were multiplied by a correction: on real units the codes of a laser within 10 % of
    range are 1.6 to 2.2 apart, 3 at times, and at another range or laser by another step. Which is not known; here it is
    from 0.85 to 1.45 of the setting, and another one at every 28 % more of range (on einride the histograms of a laser at
    23 % more correlate by 0.4, on mrpt and nebula by -0.1 and 0.2).

    Parameters
    ----------
    gain : of the laser
    """
    number = ZERO - 13
    for edge in range(len(_BIN_EDGES_M)):  # a logarithm costs more
        number += range_m >= _BIN_EDGES_M[edge]
    turn = fold(_TURNS_PER_BIN * number + _TURNS_PER_GAIN * gain)
    return step * gain * (0.85 + 0.6 * turn * turn)


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False, forceinline=True)
def reflectivity_byte(percent: float, gain: float, noise: float, step: float) -> np.uint8:
    """Code a reflectivity: 0..100 percent of a diffuse target, 101..255 of a retroreflector.

    Source: 63-9243 Rev D, section 6.1. Neither gain nor noise moves a target from one class to the other,
    since they stand for small errors of calibration.

    Parameters
    ----------
    percent : brightness, corrected for range, of a white Lambertian surface at right angles
    gain : of the laser
    noise : in counts
    step : of codes from 45 on, as `code_step` has it; 0 for none
    """
    if percent <= RETROREFLECTIVE:
        counts = gain * percent + noise
        if step > 0.0 and counts >= _COARSE:
            counts = np.rint(counts / step) * step + _AFTER_STEP * noise
        return np.uint8(min(max(np.rint(counts), 0.0), 100.0))
    code = 101.0 + _COUNTS_PER_E_FOLD * log(0.01 * gain * percent) + noise
    return np.uint8(min(max(np.rint(code), 101.0), 255.0))
