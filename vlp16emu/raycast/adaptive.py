"""Decision whether a pulse has enough sub-rays.

Two criteria are tested after each round of eight. First, the error of the strongest echo's range: the mean
absolute error, where another echo in its place counts as the resolution. It is estimated for each pulse; if
estimates fall as 1/n with the number of sub-rays, rays are spent best if the last ray of every pulse gains
the same, estimate / n = constant, and the mean error falls as the root of that constant. Second, the
detection of the strongest echo: if it is near the detection threshold, and its sub-rays leave its amplitude
less certain than the receiver's own noise does, another round decides about lost or invented echoes. Besides,
a pulse beside the outline of something much brighter has 24 rays at least (`kernel.is_beside_outline`): eight
of them miss the faint edge of the beam, by which surfaces of real units end in one or two dark records. A
pulse at the outline of something nearer than the least range has all rays: what is left of its light fades
over ten pulses and more.
"""

import math
from typing import NamedTuple

import numpy as np

from vlp16emu.elementary import exp, log
from vlp16emu.kernels.compiler import inline_kernel, kernel
from vlp16emu.types import F4, F8

_LEAST_SQUARED = np.float32(1e-12)  # smallest squared range, in m2
_PER_RAY = 5200.0
"""Error reduction required of a ray over the target to the power 3.5, in m-2.5, fitted so that
scenes/reference_forest and birch_walk reach targets from 0.02 to 0.05 m or better."""
_MOST = 0.65
"""Upper limit of an estimated error, in resolutions: half of one for another echo, plus the rest for eight
rays of one."""
_EVENNESS = 0.27
"""Variance of a share from one or two rounds of sub-rays over that from random points; see `beam`."""
_DOUBT = 0.75
"""Probability that sub-rays decide whether an echo is seen, over its maximum, from which another round is
cast. Chosen on scenes/reference_forest: 6 % more rays remove a third of the lost or invented echoes."""
_PLAIN = 0.4, 2.0
"""Amplitudes over the threshold, of all hits and of one ray's share, below and above which there is no
doubt."""

_SURE = -2.0 * float(log(_DOUBT)) * 1.01
"""Squared distance from the threshold, over the variance of the amplitude, from which there is no doubt
either, with more than the rounding of float32."""

_EVEN = np.float32(0.2)
"""Limit of the sum of squared energies over the square of their sum for `_is_one_echo`: that of five equal
rays."""
_LEAD = 0.5 * float(exp(-0.5 / (_EVENNESS * 1.01 * float(_EVEN))))
_SPREAD = 0.5 * math.sqrt(_EVENNESS * 1.01 * float(_EVEN))
_ROUNDED = 1.01
"""Limits of both parts of `_error_m` then, over the resolution and over the span of the ranges; all with more
than the rounding of float32."""


class RayBudget(NamedTuple):
    """Number of sub-rays that the pulses of a beam need."""

    max_rays: int  # most sub-rays of a pulse
    adaptive: bool  # True if `enough` decides after each round
    worth_m: float  # error reduction required of each ray; see `worth_of_ray_m`
    resolution_m: float
    threshold: float  # amplitude at which half of the echoes are seen, in m-2; 0 if every echo is seen
    amplitude_noise: float  # one sigma
    blank_m: float  # range below which nothing gives an echo


def worth_of_ray_m(target_m: float) -> float:
    """Return the error reduction required of each ray, so that the mean error reaches a target."""
    return _PER_RAY * target_m * target_m * target_m * math.sqrt(target_m)


@inline_kernel
def energy_of(reflectance: np.float32, range_m: np.float32, cos_incidence: np.float32) -> np.float32:
    """Return the energy that a sub-ray brings back, in m-2: it falls with the square of the range."""
    return reflectance * cos_incidence / max(range_m * range_m, _LEAST_SQUARED)


@inline_kernel
def enough(range_m: F4, energy: F4, budget: RayBudget, order: F8) -> bool:
    """Return whether n sub-rays determine the strongest echo and its detection well enough for the target.

    Parameters
    ----------
    range_m, energy : (n,) range of the hit of each sub-ray, infinity without one; and its energy, by
        `energy_of`, 0 without one
    order : (2, n or more) scratch for sorting
    """
    n = range_m.shape[0]
    resolution_m = budget.resolution_m
    worth_m = n * budget.worth_m
    is_precise = worth_m >= _MOST * resolution_m
    if is_precise and _is_sure(range_m, energy, budget):
        return True
    if not is_precise and _is_one_echo(range_m, energy, budget):
        return True
    met = _sort_echoes(range_m, energy, order)
    if met == 0:
        return True
    if budget.threshold > 0.0 and _is_doubtful(order, met, n, budget):
        return False
    return is_precise or _error_m(order, met, resolution_m) <= worth_m


@inline_kernel
def _is_sure(range_m: F4, energy: F4, budget: RayBudget) -> bool:
    """Return True if the rays clearly give an echo, or none: two thirds of the other pulses need no sorting.

    The strongest echo has at most the energy of all rays, and at least that of those around the brightest
    one; it has no greater sum of squares than all rays.
    """
    n = range_m.shape[0]
    threshold = n * budget.threshold
    bright = _PLAIN[1] * threshold
    total = squares = brightest = np.float32(0.0)
    at_m = np.float32(0.0)
    for i in range(n):
        own = energy[i]
        if own >= bright:  # for most bright pulses the first ray suffices
            return True
        total += own
        squares += own * own
        at_m = range_m[i] if own > brightest else at_m
        brightest = max(brightest, own)
    if total <= _PLAIN[0] * threshold:
        return True
    around_m = 0.249 * budget.resolution_m
    middle_m = np.float64(at_m)
    least = 0.0
    for i in range(n):
        # In float64 throughout, so that the compiler makes no branch of it.
        least += np.float64(energy[i]) * np.float64(abs(np.float64(range_m[i]) - middle_m) <= around_m)
    off = max(threshold - total, least - threshold, 0.0)
    noise = n * budget.amplitude_noise
    return bool(off * off >= _SURE * (_EVENNESS * squares + noise * noise))


@inline_kernel
def _is_one_echo(range_m: F4, energy: F4, budget: RayBudget) -> bool:
    """Return True if bounds show that the rays suffice: half of all pulses then need no sorting.

    Within the resolution there is one echo. The variance of its ranges is at most a quarter of the square of
    their span, and with its squares below `_EVEN` of its squared energy `_error_m` has the limits below.
    """
    n = range_m.shape[0]
    low_m = np.float32(np.inf)
    high_m = total = squares = brightest = np.float32(0.0)
    for i in range(n):
        own_m = range_m[i]
        own = energy[i]
        low_m = min(low_m, own_m)
        high_m = max(high_m, own_m if own_m < np.inf else np.float32(0.0))
        total += own
        squares += own * own
        brightest = max(brightest, own)
    threshold = n * budget.threshold
    is_plain = threshold == 0.0 or brightest >= _PLAIN[1] * threshold or total <= _PLAIN[0] * threshold
    is_even = squares < _EVEN * total * total
    span_m = _ROUNDED * (high_m - low_m)
    error_m = _LEAD * budget.resolution_m + _SPREAD * span_m
    return bool(is_plain and is_even and span_m <= budget.resolution_m and error_m <= n * budget.worth_m)


@kernel
def _is_doubtful(order: F8, met: int, n: int, budget: RayBudget) -> bool:
    """Return whether the positions of n sub-rays, rather than noise, decide if the strongest echo is seen."""
    first, last, strongest = _strongest(order, 0, met, budget.resolution_m / 2)
    squares = 0.0
    for a in range(first, last + 1):
        squares += order[1, a] * order[1, a]
    variance = _EVENNESS * squares / (n * n)
    total = variance + budget.amplitude_noise * budget.amplitude_noise
    off = strongest / n - budget.threshold
    return math.sqrt(variance / total) * exp(-(off * off) / (2 * total)) > _DOUBT


@kernel
def _error_m(order: F8, met: int, resolution_m: float) -> float:
    first, last, strongest = _strongest(order, 0, met, resolution_m)
    second = max(
        _strongest(order, 0, first, resolution_m)[2], _strongest(order, last + 1, met, resolution_m)[2]
    )
    mean_m = 0.0
    squares = 0.0
    spread = 0.0
    for a in range(first, last + 1):
        mean_m += order[1, a] * order[0, a] / strongest
        squares += order[1, a] * order[1, a]
    for a in range(first, last + 1):
        off_m = order[0, a] - mean_m
        spread += order[1, a] / strongest * (off_m * off_m)
    standard_error_m = math.sqrt(_EVENNESS * spread * squares) / strongest
    # The difference of two echoes' shares has the variance of a count, in units of a typical ray's energy.
    before = strongest - second
    lead = before * before / (_EVENNESS * (strongest + second) * squares / strongest)
    return 0.5 * exp(-lead / 2) * resolution_m + standard_error_m


@kernel
def _sort_echoes(range_m: F4, energy: F4, order: F8) -> int:
    """Fill ranges and energies of the hits that bring energy back, nearest first; return their number."""
    met = 0
    for i in range(range_m.shape[0]):
        if energy[i] > 0.0:
            reach_m = float(range_m[i])
            a = met
            while a > 0 and order[0, a - 1] > reach_m:
                order[0, a], order[1, a] = order[0, a - 1], order[1, a - 1]
                a -= 1
            order[0, a] = reach_m
            order[1, a] = energy[i]
            met += 1
    return met


@kernel
def _strongest(order: F8, first: int, stop: int, resolution_m: float) -> tuple[int, int, float]:
    """Return first, last and energy of the strongest interval within the resolution, among sorted echoes."""
    best = 0.0
    best_first = first
    best_last = first - 1
    near = first
    energy = 0.0
    for far in range(first, stop):
        energy += order[1, far]
        while order[0, far] - order[0, near] > resolution_m:
            energy -= order[1, near]
            near += 1
        if energy > best:
            best = energy
            best_first = near
            best_last = far
    return best_first, best_last, best
