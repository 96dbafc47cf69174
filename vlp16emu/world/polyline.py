"""Distance in the plane from points to the way somebody walks."""

import math

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["distance_m"]

Array = NDArray[np.float64]


def distance_m(points_xy_m: Array, line_xy_m: Array) -> Array:
    """Distance from each point (n, 2) to a polyline (m, 2), m >= 1: the same number for the line reversed.

    Returns
    -------
    (n,) metres
    """
    out = np.empty(len(points_xy_m))
    _distances(out, np.ascontiguousarray(points_xy_m), np.ascontiguousarray(line_xy_m))
    return out


@numba.njit(cache=True, nogil=True)
def _distances(out: Array, points: Array, line: Array) -> None:
    """Fill (n,) distances."""
    last = line.shape[0] - 1
    for i in range(out.shape[0]):
        nearest = np.inf
        for j in range(max(last, 1)):
            ax, ay = line[j, 0], line[j, 1]
            bx, by = line[min(j + 1, last), 0], line[min(j + 1, last), 1]
            if (bx, by) < (ax, ay):  # one order for both walking directions, to the last bit
                ax, ay, bx, by = bx, by, ax, ay
            ux, uy, px, py = bx - ax, by - ay, points[i, 0] - ax, points[i, 1] - ay
            length2 = ux * ux + uy * uy
            along = min(max((px * ux + py * uy) / length2, 0.0), 1.0) if length2 > 0 else 0.0
            nearest = min(nearest, math.hypot(px - along * ux, py - along * uy))
        out[i] = nearest
