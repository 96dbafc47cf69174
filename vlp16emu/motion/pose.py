"""Rotations from angles, and angular rates from the angles' derivatives."""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.trig import cos_sin

__all__ = ["body_rate", "fill_rotation", "rotate", "rotations"]


@numba.njit(cache=True, nogil=True, forceinline=True, _nrt=False)
def fill_rotation(
    cy: float, sy: float, cp: float, sp: float, cr: float, sr: float, out: NDArray[np.float64]
) -> None:
    """Fill the rotation (3, 3) of `rotate` from cosines and sines of yaw, pitch and roll."""
    out[0, 0], out[0, 1], out[0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    out[1, 0], out[1, 1], out[1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    out[2, 0], out[2, 1], out[2, 2] = -sp, cp * sr, cp * cr


@numba.njit(cache=True, nogil=True, forceinline=True, _nrt=False)
def rotate(yaw_rad: float, pitch_rad: float, roll_rad: float, out: NDArray[np.float64]) -> None:
    """Fill a rotation (3, 3), body to world: about z, then y, then x.

    Yaw is counter-clockwise from east, positive pitch is nose down, positive roll is right side down.
    """
    fill_rotation(*cos_sin(yaw_rad), *cos_sin(pitch_rad), *cos_sin(roll_rad), out)


@numba.njit(cache=True, nogil=True)
def rotations(yaw_rad: NDArray[np.float64], pitch_rad: float, roll_rad: float) -> NDArray[np.float64]:
    """world_R_body (n, 3, 3) for headings (n,) and a fixed inclination, angles as in `rotate`."""
    out = np.empty((yaw_rad.size, 3, 3))
    for i in range(yaw_rad.size):
        rotate(yaw_rad[i], pitch_rad, roll_rad, out[i])
    return out


@numba.njit(cache=True, nogil=True)
def body_rate(
    angle_rad: NDArray[np.float64],
    rate_rad_s: NDArray[np.float64],
    acceleration_rad_s2: NDArray[np.float64],
    w_rad_s: NDArray[np.float64],
    alpha_rad_s2: NDArray[np.float64],
) -> None:
    """Fill angular rate and acceleration (3,), in body axes, from roll, pitch, yaw (3,) and their derivatives.

    Source: the z-y-x Euler kinematic equations, for instance Diebel, "Representing Attitude", 2006, section 5.
    """
    cr, sr = math.cos(angle_rad[0]), math.sin(angle_rad[0])
    cp, sp = math.cos(angle_rad[1]), math.sin(angle_rad[1])
    roll, pitch, yaw = rate_rad_s
    roll2, pitch2, yaw2 = acceleration_rad_s2
    w_rad_s[0] = roll - sp * yaw
    w_rad_s[1] = cr * pitch + sr * cp * yaw
    w_rad_s[2] = -sr * pitch + cr * cp * yaw
    alpha_rad_s2[0] = roll2 - sp * yaw2 - cp * pitch * yaw
    across = cp * yaw2 - sp * pitch * yaw
    alpha_rad_s2[1] = cr * pitch2 + sr * across + roll * w_rad_s[2]
    alpha_rad_s2[2] = -sr * pitch2 + cr * across - roll * w_rad_s[1]
