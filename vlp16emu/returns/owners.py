"""Truth: whose light a return is."""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.returns.echoes import amplitude_of
from vlp16emu.returns.law import Law
from vlp16emu.returns.weather import clutter_echo
from vlp16emu.types import NO_SURFACE

__all__ = ["find_owners"]

_REACH_SIGMAS = 5.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def find_owners(
    law: Law,
    first: int,
    count: NDArray[np.uint16],
    range_m: NDArray[np.float32],
    met: NDArray[np.uint32],
    cos_incidence: NDArray[np.float32],
    reflectance: NDArray[np.float32],
    distance_m: NDArray[np.float32],
    surface: NDArray[np.uint32],
) -> None:
    """Fill surface (k, L, 3) with that of the sub-ray which gives most of the light at each distance.

    Light that the air gives, and distance 0, belong to no surface.
    """
    stop = 0
    for i in range(count.shape[0]):
        for j in range(count.shape[1]):
            start, stop = stop, stop + int(count[i, j])
            air_m, air = 0.0, 0.0
            if law.extinction_per_m > 0.0:
                air_m, air = clutter_echo(law, first + i, j, start, stop, range_m)
            for column in range(3):
                at_m = np.float64(distance_m[i, j, column])
                surface[i, j, column] = NO_SURFACE
                most = air * _pulse(law, air_m - at_m)
                for ray in range(start if at_m > 0.0 else stop, stop):
                    ray_m = np.float64(range_m[ray])
                    if abs(ray_m - at_m) < _REACH_SIGMAS * law.sigma_m:
                        energy = np.float64(reflectance[met[ray]]) * cos_incidence[ray] / (stop - start)
                        light = amplitude_of(law, energy, ray_m) * _pulse(law, ray_m - at_m)
                        if light > most:
                            most, surface[i, j, column] = light, met[ray]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _pulse(law: Law, away_m: float) -> float:
    """Height of a pulse at a distance from its middle."""
    away = away_m / law.sigma_m
    return math.exp(-0.5 * away * away)
