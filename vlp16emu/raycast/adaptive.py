"""How many sub-rays a pulse needs.

Two questions. Before any sub-ray: do the middles of a pulse and of its neighbours in azimuth, whose distance is
that of the footprint's edge or more, lie on one smooth surface? Then the one ray along the middle tells its
range, and sub-rays would tell the same. Otherwise it is the first of a round of `ROUND` sub-rays, and after each
round: what is the range of the strongest echo still worth?

Among plants the first question is not asked far away, for the answer is known: of pulses that reach 40 m in
`scenes/reference_forest` nineteen in twenty are split. There the ray along the middle goes on as one of its round.

The error that is meant is the mean absolute error of the strongest echo's range, where another echo taken for it
counts as the resolution. It is estimated for each pulse; if estimates fall as 1/n with the number of sub-rays, rays
are best spent where the last ray of every pulse buys the same, estimate / n = constant, and the mean error falls as
the root of that constant.
"""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.raycast.footprint import ROUND, Footprint
from vlp16emu.types import NO_SURFACE, Firings, Semantic

__all__ = ["enough", "first_round", "judged_to"]

_NONE = np.uint32(NO_SURFACE)
_BEND = 2.0
"""Times the target that a smooth surface may bend over three pulses: within the light of one of them it bends by a
thirtieth of that. At 1 as good a strongest echo takes 3 % more sub-rays, at 4 more second echoes are lost."""
_PER_RAY = 1075.0
"""What a ray must buy, over the 3.5th power of the target, so that scenes/reference_forest and birch_walk come out at their
target or below, from 0.03 to 0.08 m: in m-2.5, fitted."""
_EVENNESS = 0.27
"""Variance of a share by a round or two of sub-rays over that by random points; see `footprint`."""
_JUDGED_M = 40.0
"""How far pulses are judged by their middles among plants. Half a per cent more sub-rays than at 100 m, for 5 to 17 % less
time; 30 m takes 1.3 % more in the same time."""


def judged_to(surfaces: NDArray[np.void]) -> float:
    """Range in metres up to which the rays along the middles tell whether a pulse is split; beyond it is."""
    plants = np.isin(surfaces["semantic"], (Semantic.TREE, Semantic.SHRUB))
    return _JUDGED_M if plants.any() else math.inf


def first_round(
    firings: Firings,
    range_m: NDArray[np.float32],
    cos_incidence: NDArray[np.float32],
    beam: Footprint,
    block: int,
) -> NDArray[np.uint16]:
    """Sub-rays of each pulse after its first round, (k, L): 1 where the ray along its middle is enough.

    Parameters
    ----------
    range_m, cos_incidence : (k, L) what the rays along the middle met
    block : sequences that are neighbours of each other only
    """
    wanted = np.empty(range_m.shape, np.uint16)
    for first in range(0, len(range_m), block):
        of = slice(first, first + block)
        # Of a laser that looks level; one that looks up the axis turns in place.
        step_rad = float(np.linalg.norm(np.diff(firings.direction[first : first + 2], axis=0), axis=-1).max())
        # Neighbours nearer than the footprint's edge say too little.
        reach = max(1, math.ceil(beam.divergence_rad[0] / 2 / step_rad)) if step_rad > 0 else 1
        _first_round(
            range_m[of], cos_incidence[of], reach, beam.quarters, beam.target_m, beam.resolution_m, wanted[of]
        )
    return np.minimum(wanted, beam.rays, out=wanted, casting="unsafe")


@numba.njit(cache=True, nogil=True, _nrt=False)
def _first_round(
    range_m: NDArray[np.float32],
    cos_incidence: NDArray[np.float32],
    reach: int,
    quarters: NDArray[np.float64],
    target_m: float,
    resolution_m: float,
    wanted: NDArray[np.uint16],
) -> None:
    """Fill `wanted`. At either end of a block the nearest pulse with two neighbours speaks for the others."""
    count, lasers = range_m.shape
    reach = min(reach, (count - 1) // 2)
    for i in range(count):
        middle = min(max(i, reach), count - 1 - reach)
        for j in range(lasers):
            before, here, after = (
                float(range_m[middle - reach, j]),
                float(range_m[middle, j]),
                float(range_m[middle + reach, j]),
            )
            bend_m = abs(before + after - 2.0 * here)  # not a number where nothing was met
            across_m = quarters[0] + quarters[2] * here
            cosine = float(cos_incidence[i, j])
            # The deepest that one standard deviation of the beam reaches on a surface so inclined.
            flat = across_m * math.sqrt(1.0 - cosine * cosine) <= 0.2 * resolution_m * cosine
            wanted[i, j] = 1 if bend_m <= _BEND * target_m and flat else ROUND


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
