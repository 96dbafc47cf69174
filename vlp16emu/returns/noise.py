"""Errors of range and reflectivity, white for each echo and constant for a unit; the reflectivity byte.

Sources of the measured constants: the laws `range`, `code` and `no_return` of `vlp16emu/sensor/laws.toml`.
"""

import math

import numpy as np

from vlp16emu.elementary import cos, exp, log, power
from vlp16emu.kernels.compiler import inline_kernel
from vlp16emu.random import Purpose, normal, uniform
from vlp16emu.returns.settings import DetectorConstants, Noise
from vlp16emu.returns.strength import NEXT, in_steps
from vlp16emu.sensor.laws import law, span
from vlp16emu.types import F8, U1

BIAS_LIMIT_M = 0.03  # accuracy of the data sheet, which no laser exceeds
_NOISE_AT = 0.2  # reflectance at which the noise has the value of the settings
_FAINTEST_REFLECTANCE = 0.01
_REFLECTANCES = 0.01 * np.maximum(np.arange(101.0), 1.0)
_DARKER = _NOISE_AT / _REFLECTANCES
_ROOTS = np.sqrt(np.sqrt(_DARKER))
"""Parts of the variance of range noise at codes 0 to 100; tables are faster than roots and quotients."""
NO_RETURN_KNOTS = int(law("no_return.knots"))  # azimuth intervals over which no-return codes change


def range_bias_m(seed: int, lasers: int, sigma_m: float) -> F8:
    """Return the constant range error of each laser, (lasers,) m.

    It is Gaussian, cut at the data sheet's accuracy.
    """
    return np.clip(sigma_m * normal(seed, Purpose.RANGE_BIAS, 0, lasers), -BIAS_LIMIT_M, BIAS_LIMIT_M)


def gain(seed: int, spread: float, elevation_deg: F8) -> F8:
    """Return the factor on the reflectivity of each laser, (lasers,), above 0.

    It is log-normal. Only differences between neighbours in elevation, `apart`, can be measured; they have
    much the same spread on every unit.
    """
    draws = normal(seed, Purpose.REFLECTIVITY, 0, len(elevation_deg))
    apart = np.diff(draws[np.argsort(elevation_deg, kind="stable")], 2) / 2.0
    weight = law("code.gain_weight")
    expected = law("code.gain_neighbours") * len(apart)
    return exp(spread * math.sqrt((expected + weight) / ((apart * apart).sum() + weight)) * draws)


def no_return_reflectivity(seed: int, lasers: int, middle: float | None) -> F8:
    """Return the reflectivity (lasers,) of records without a return, before it is truncated.

    Real units send it in 50 to 98 % of such records, and multiples of it in the others.

    Parameters
    ----------
    middle : median over the lasers; None to draw it
    """
    if middle is None:
        low, high = span("no_return.median")
        middle = low * power(high / low, float(uniform(seed, Purpose.NO_RETURN, 0, 1)[0]))
    factor = exp(law("no_return.spread") * normal(seed, Purpose.NO_RETURN, 1, lasers))
    return np.minimum(middle * factor, 255.0)


def no_return_multiples(seed: int, no_return: F8, wander: float) -> F8:
    """Return the multiples of `no_return_reflectivity` that no-returns carry at each azimuth.

    Values below 1 are sent as 1. An image of a sweep shows patches that all lasers share, at the same
    azimuths in each revolution; on real units they depend on the scene, probably on faint light below the
    threshold; here they are random.

    Parameters
    ----------
    no_return : (lasers,) codes of a multiple of one; larger codes wander less
    wander : value of a median unit; units differ by a factor of two, one sigma, and their lasers nearly as
        much

    Returns
    -------
    (NO_RETURN_KNOTS + 1, lasers), evenly spaced in azimuth; the last row equals the first
    """
    lasers = len(no_return)
    *lasers_alone, shared = (
        normal(seed, Purpose.NO_RETURN, 0, NO_RETURN_KNOTS, 1 + lane) for lane in range(lasers + 1)
    )
    low, high = span("no_return.shared")
    alike = low + (high - low) * float(uniform(seed, Purpose.NO_RETURN, 0, 1, 2 + lasers)[0])
    drawn = alike * shared[:, None] + math.sqrt(1.0 - alike * alike) * np.stack(lasers_alone, axis=1)
    *of_lasers, of_unit = normal(seed, Purpose.NO_RETURN, 1 + lasers, lasers + 1)
    logarithm = law("no_return.wander_of_units") * of_unit
    logarithm = logarithm + law("no_return.wander_of_lasers") * np.array(of_lasers)
    spread = np.minimum(wander * exp(logarithm), law("no_return.wander_codes") / no_return)
    return spread * np.abs(np.concatenate([drawn, drawn[:1]]))


def sent_codes(seed: int, lasers: int, step: float) -> U1:
    """Return the code (lasers, 101) that each laser sends for the codes of diffuse targets.

    Bright codes of a real laser are more than 1 apart, with more spacing at brighter codes: a calibration
    table of each laser from integers of the receiver to codes (laws `code.coarse_from` to `spacing`).

    Parameters
    ----------
    step : mean spacing at code 90; 1 or less sends all codes
    """
    out = np.tile(np.arange(101, dtype=np.uint8), (lasers, 1))
    coarse = law("code.coarse_from")
    for laser in range(lasers if step > 1.0 else 0):
        drawn = iter(uniform(seed, Purpose.REFLECTIVITY, 0, 64, 2 + laser).tolist())
        at = coarse + next(drawn)  # from about this code, each laser leaves out different codes
        sent = [*range(int(coarse))]
        stop = slope = 0.0
        while at < 100.0:
            if at >= stop:
                short, long = span("code.segment")
                low, high = span("code.spacing")
                mean = 1.0 + (step - 1.0) * (at - coarse) / (law("code.step_at") - coarse)
                stop = at + short + (long - short) * next(drawn)
                slope = mean * (low + (high - low) * next(drawn))
            sent.append(math.floor(at))
            at += max(slope, 1.0)
        kept = np.array([*sent, 100])
        out[laser] = kept[np.abs(np.arange(101)[:, None] - kept).argmin(axis=1)]
    return out


def range_beat_m(seed: int, amplitude_m: float, phase_deg: float | None) -> F8:
    """Return the range error by (24 sequence + laser) mod 5, (5,) m.

    It is a sine and its first overtone.

    Parameters
    ----------
    phase_deg : phase of a unit with exactly this amplitude; None to draw both
    """
    size, phase, overtone = uniform(seed, Purpose.RANGE_BEAT, 0, 3)
    least, greatest = span("range.beat")
    first_share, width = span("range.overtone")
    share = first_share + width * overtone
    if phase_deg is None:
        amplitude_m = amplitude_m * (least + (greatest - least) * size)
    else:
        share = 0.25
        phase = phase_deg / 360.0
    angle = 2.0 * math.pi * (np.arange(5) / 5.0 + phase)
    overtone_rad = math.radians(law("range.overtone_deg"))
    return np.asarray(amplitude_m * (cos(angle) + share * cos(2.0 * angle + overtone_rad)))


def range_noise_parts(seed: int, noise: Noise) -> tuple[float, float]:
    """Return the parts of the variance of white range noise of a unit at `_NOISE_AT`: bright and dark.

    The bright one falls with the fourth root of the reflectance, the dark one with the reflectance. Both are
    shares of the set variance, which only a unit like real ones divides.
    """
    if not noise.is_real:
        return 1.0, 0.0
    low, high = span("range.dark")
    drawn = float(uniform(seed, Purpose.UNIT_NOISE, 3, 1)[0]) if noise.unit_spread > 0.0 else 0.5
    middle = math.sqrt(low * high)
    return 1.0 - middle, float(low * power(high / low, drawn))


@inline_kernel
def _variance(constants: DetectorConstants, reflectance: float) -> float:
    """Return the variance of white range noise over the set one, interpolated between codes 1 to 100."""
    percent = 100.0 * min(max(reflectance, _FAINTEST_REFLECTANCE), 1.0)
    below = np.uint32(min(percent, 99.5))
    above = below + NEXT
    fraction = percent - below
    bright = _ROOTS[below] + fraction * (_ROOTS[above] - _ROOTS[below])
    dark = _DARKER[below] + fraction * (_DARKER[above] - _DARKER[below])
    return constants.bright_noise * bright + constants.dark_noise * dark


@inline_kernel
def range_sigma_m(constants: DetectorConstants, reflectance: float, amplitude: float, uneven: float) -> float:
    """Return the white range noise of an echo, one sigma.

    sigma**2 = (1 + uneven)**2 noise**2 (b x**0.25 + d x) + (width / signal-to-noise ratio)**2, with x = 0.2 /
    reflectance, and b and d as in `range_noise_parts`. The first term is measured on four real units on
    smooth surfaces without the beat, even and uneven ones (laws `range.dark` and `range.unsteady`); it does
    not grow with range, because the sensor fires with more power at far or dark targets: on the HDL-32E one
    of 11 powers, chosen by the previous shot (its software version 2.0). The second term is the least error
    of the position of a Gaussian pulse in white noise, and counts at maximum power.

    Parameters
    ----------
    reflectance : reported reflectance, clipped to 0.01 .. 1
    amplitude : amplitude of the peak
    uneven : increase of the first term where brightness changes
    """
    far_m = constants.sigma_m * constants.amplitude_noise / amplitude
    own_m = constants.range_noise_m * (1.0 + uneven)
    return math.sqrt(own_m * own_m * _variance(constants, reflectance) + far_m * far_m)


REFLECTIVITY_TAIL = law("code.tail")


@inline_kernel
def with_heavy_tails(z: float, tail: float) -> float:
    """Return a number of the same variance with heavy tails, from a normal number.

    The share `tail` of its cube is added. The fourth moment of a normal number is 3, and the sixth is 15.
    """
    return z * (1.0 + tail * z * z) / math.sqrt(1.0 + 6.0 * tail + 15.0 * tail * tail)


RETROREFLECTIVE = 100.5
"""Percent above which a target is retroreflective; values that round to 100 are diffuse."""
_COUNTS_PER_E_FOLD = (255 - 101) / 6.907755278982137  # logarithm of 1000
"""Counts per factor e of reflectance. 255 means 1000 times the reflectance of a white Lambertian surface. A
coefficient of retroreflection R (cd/lx/m2) equals a reflectance of pi R: 255 means 318 cd/lx/m2, between
high-intensity (about 250) and prismatic sheeting (about 700). The manual gives the ends of the scale only;
assumption: it is logarithmic between them."""


@inline_kernel
def reflectivity_byte(
    percent: float, gain: float, noise: float, exact: float, scale: tuple[float, float], codes: U1
) -> np.uint8:
    """Return the byte of a reflectivity: 0..100 for a diffuse target, 101..255 for a retroreflector.

    Source: 63-9243 Rev D, section 6.1. Neither gain nor noise moves a target from one class to the other,
    since they are small calibration errors.

    Parameters
    ----------
    percent : range-corrected brightness in percent of a perpendicular white Lambertian surface
    gain : gain of the laser
    noise : noise in counts
    exact : strength of a diffuse target with this gain and noise, before it is rounded
    scale : factor as from `at_range`, and greatest code of a matt surface
    codes : (101,) codes that the laser sends, from `sent_codes`
    """
    if percent <= RETROREFLECTIVE:
        (eighths, top) = scale
        exact_code = min(max(gain * percent + noise, 0.0), top)
        code = in_steps(exact_code, exact, eighths)
        sent = codes[np.uint32(min(code, 100.0) + 0.5)]
        if top > 100.0 and sent == 100:  # such a laser sends no 100
            return np.uint8(min(np.floor(max(code, 100.0)) + 1.0, top))
        return sent
    code = 101.0 + _COUNTS_PER_E_FOLD * log(0.01 * gain * percent) + noise
    return np.uint8(min(max(np.rint(code), 101.0), 255.0))
