"""When a pulse has sub-rays enough.

After each round of eight: what is the range of the strongest echo still worth? The error that is meant is the mean
absolute error of that range, where another echo taken for it counts as the resolution. It is estimated for each pulse;
if estimates fall as 1/n with the number of sub-rays, rays are best spent where the last ray of every pulse buys the
same, estimate / n = constant, and the mean error falls as the root of that constant.
"""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.types import NO_SURFACE

__all__ = ["are_neighbours", "enough", "flat_enough"]

_NONE = np.uint32(NO_SURFACE)
_PER_RAY = 1075.0
"""What a ray must buy, over the 3.5th power of the target, so that scenes/reference_forest and birch_walk come out at their
target or below, from 0.03 to 0.08 m: in m-2.5, fitted."""
_EVENNESS = 0.27
"""Variance of a share by a round or two of sub-rays over that by random points; see `footprint`."""


_STEPS = 2.5
"""Times the beam's divergence that neighbours may be apart in order to say something: the VLP-16 at 1200 rpm is at 2.3."""
_OVERLAP, _MIDWAY_M = 0.3, 10.0
"""Share of the beam's width by which neighbours must at least be apart, at this range: nearer ones meet the same."""


@numba.njit(cache=True, nogil=True, _nrt=False, forceinline=True)
def are_neighbours(
    origin_m: NDArray[np.float64],
    direction: NDArray[np.float64],
    quarters: NDArray[np.float32],
    first: int,
    laser: int,
) -> bool:
    """Whether pulses of a laser are so near each other that they say something, and do not meet the same.

    Parameters
    ----------
    origin_m, direction : (k, L, 3), of which the pulses `first` and the next are looked at
    quarters : (4,) as in `Footprint`
    """
    step2 = gap2_m2 = 0.0
    for a in range(3):
        step = direction[first + 1, laser, a] - direction[first, laser, a]
        gap_m = origin_m[first + 1, laser, a] - origin_m[first, laser, a] + _MIDWAY_M * step
        step2, gap2_m2 = step2 + step * step, gap2_m2 + gap_m * gap_m
    width_m = 4.0 * (quarters[0] + _MIDWAY_M * quarters[2])
    return step2 <= (_STEPS * 4.0 * quarters[2]) ** 2 and gap2_m2 >= (_OVERLAP * width_m) ** 2


@numba.njit(cache=True, nogil=True, _nrt=False, forceinline=True)
def flat_enough(quarters: NDArray[np.float32], range_m: float, cosine: float, resolution_m: float) -> bool:
    """Whether one standard deviation of the beam reaches no deeper than an echo is wide, on a surface so inclined."""
    across_m = quarters[0] + quarters[2] * range_m
    return across_m * math.sqrt(1.0 - cosine * cosine) <= 0.2 * resolution_m * cosine


@numba.njit(cache=True, nogil=True, _nrt=False)
def enough(
    range_m: NDArray[np.float32],
    surface: NDArray[np.uint32],
    cos_incidence: NDArray[np.float32],
    reflectance: NDArray[np.float32],
    target_m: float,
    resolution_m: float,
    order: NDArray[np.float64],
) -> bool:
    """Whether n sub-rays tell the strongest echo well enough for `target_m`.

    Parameters
    ----------
    range_m, surface, cos_incidence : (n,) what the sub-rays met
    reflectance : (m,) of the surfaces
    order : (2, n or more) room to sort in
    """
    n = range_m.shape[0]
    met = _sort_echoes(range_m, surface, cos_incidence, reflectance, order)
    if met == 0:
        return True
    first, last, strongest = _strongest(order, 0, met, resolution_m)
    second = max(
        _strongest(order, 0, first, resolution_m)[2], _strongest(order, last + 1, met, resolution_m)[2]
    )
    mean_m, squares, spread = 0.0, 0.0, 0.0
    for a in range(first, last + 1):
        mean_m += order[1, a] * order[0, a] / strongest
        squares += order[1, a] ** 2
    for a in range(first, last + 1):
        spread += order[1, a] / strongest * (order[0, a] - mean_m) ** 2
    standard_error_m = math.sqrt(_EVENNESS * spread * squares) / strongest
    # Shares of two echoes differ by chance with the variance of a count, in units of a usual ray's energy.
    lead = (strongest - second) ** 2 / (_EVENNESS * (strongest + second) * squares / strongest)
    error_m = 0.5 * math.exp(-lead / 2) * resolution_m + standard_error_m
    return error_m <= n * _PER_RAY * target_m**3.5


@numba.njit(cache=True, nogil=True, _nrt=False)
def _sort_echoes(
    range_m: NDArray[np.float32],
    surface: NDArray[np.uint32],
    cos_incidence: NDArray[np.float32],
    reflectance: NDArray[np.float32],
    order: NDArray[np.float64],
) -> int:
    """Fill ranges and energies of what was met, nearest first; the energy falls with the square of the range."""
    met = 0
    for i in range(range_m.shape[0]):
        if surface[i] == _NONE:
            continue
        reach_m = float(range_m[i])
        energy = reflectance[surface[i]] * cos_incidence[i] / max(reach_m * reach_m, 1e-12)
        if energy > 0.0:
            a = met
            while a > 0 and order[0, a - 1] > reach_m:
                order[0, a], order[1, a] = order[0, a - 1], order[1, a - 1]
                a -= 1
            order[0, a], order[1, a] = reach_m, energy
            met += 1
    return met


@numba.njit(cache=True, nogil=True, _nrt=False)
def _strongest(
    order: NDArray[np.float64], first: int, stop: int, resolution_m: float
) -> tuple[int, int, float]:
    """First, last and energy of the strongest stretch no longer than the resolution, among sorted echoes."""
    best, best_first, best_last = 0.0, first, first - 1
    near, energy = first, 0.0
    for far in range(first, stop):
        energy += order[1, far]
        while order[0, far] - order[0, near] > resolution_m:
            energy -= order[1, near]
            near += 1
        if energy > best:
            best, best_first, best_last = energy, near, far
    return best_first, best_last, best
