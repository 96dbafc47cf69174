"""Rotations from angles."""

import math

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["rotations"]


@numba.njit(cache=True, nogil=True)
def rotations(yaw_rad: NDArray[np.float64], pitch_rad: float, roll_rad: float) -> NDArray[np.float64]:
    """world_R_body (n, 3, 3) for headings (n,) and a fixed mounting: about z, then y, then x.

    Yaw is counter-clockwise from east, positive pitch is nose down, positive roll is right side down.
    """
    out = np.empty((yaw_rad.size, 3, 3))
    cp, sp, cr, sr = math.cos(pitch_rad), math.sin(pitch_rad), math.cos(roll_rad), math.sin(roll_rad)
    for i in range(yaw_rad.size):
        cy, sy = math.cos(yaw_rad[i]), math.sin(yaw_rad[i])
        out[i, 0, 0], out[i, 0, 1], out[i, 0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
        out[i, 1, 0], out[i, 1, 1], out[i, 1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
        out[i, 2, 0], out[i, 2, 1], out[i, 2, 2] = -sp, cp * sr, cp * cr
    return out
