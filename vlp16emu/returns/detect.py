"""From hits to what the detector reports."""

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.types import NO_SURFACE, Firings, Hits, Returns

__all__ = ["detect"]


def detect(
    firings: Firings,
    hits: Hits,
    surfaces: NDArray[np.void],
    min_range_m: float,
    max_range_m: float,
    *,
    truth: bool,
) -> Returns:
    """Turn one hit per pulse into its return.

    A lone echo is the strongest and the last at once. Reflectivity is that of a Lambertian surface as the
    sensor reports it, calibrated by range: reflectance times cosine of incidence in percent, 0..100 being the
    diffuse part of the scale (63-9243 Rev D, section 6.1).

    Parameters
    ----------
    hits : one ray each
    surfaces : (m,) `SURFACE`, the window's table
    min_range_m, max_range_m : outside of these there is no return
    truth : whether to keep the surface behind each return
    """
    shape = (*firings.t_ns.shape, 3)
    distance_m = np.zeros(shape, np.float32)
    reflectivity = np.zeros(shape, np.uint8)
    _detect(
        hits.range_m.reshape(firings.t_ns.shape),
        hits.surface.reshape(firings.t_ns.shape),
        hits.cos_incidence.reshape(firings.t_ns.shape),
        np.ascontiguousarray(surfaces["reflectance"]),
        min_range_m,
        max_range_m,
        distance_m,
        reflectivity,
    )
    met = hits.surface.reshape(*firings.t_ns.shape, 1)
    surface = np.where(distance_m > 0, met, NO_SURFACE) if truth else None
    return Returns(firings, distance_m, reflectivity, surface, surfaces if truth else None)


@numba.njit(cache=True, nogil=True)
def _detect(
    range_m: NDArray[np.float32],
    surface: NDArray[np.uint32],
    cos_incidence: NDArray[np.float32],
    reflectance: NDArray[np.float32],
    min_range_m: float,
    max_range_m: float,
    distance_m: NDArray[np.float32],
    reflectivity: NDArray[np.uint8],
) -> None:
    """Fill strongest and last, (k, L, 3)."""
    count, lasers = range_m.shape
    for i in range(count):
        for j in range(lasers):
            if min_range_m <= range_m[i, j] <= max_range_m:
                percent = 100.0 * reflectance[surface[i, j]] * cos_incidence[i, j]
                byte = np.uint8(min(np.rint(percent), 100.0))
                distance_m[i, j, 0] = distance_m[i, j, 1] = range_m[i, j]
                reflectivity[i, j, 0] = reflectivity[i, j, 1] = byte
