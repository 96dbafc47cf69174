"""Rotations from yaw, pitch and roll."""

import math

import numpy as np

from vlp16emu.kernels.compiler import array_kernel, inline_kernel
from vlp16emu.trig import cos_sin
from vlp16emu.types import F8


@inline_kernel
def fill_rotation(cy: float, sy: float, cp: float, sp: float, cr: float, sr: float, out: F8) -> None:
    """Fill the rotation (3, 3) of `rotate` from cosines and sines of yaw, pitch and roll."""
    out[0, 0] = cy * cp
    out[0, 1] = cy * sp * sr - sy * cr
    out[0, 2] = cy * sp * cr + sy * sr
    out[1, 0] = sy * cp
    out[1, 1] = sy * sp * sr + cy * cr
    out[1, 2] = sy * sp * cr - cy * sr
    out[2, 0] = -sp
    out[2, 1] = cp * sr
    out[2, 2] = cp * cr


@inline_kernel
def rotate(yaw_rad: float, pitch_rad: float, roll_rad: float, out: F8) -> None:
    """Fill a rotation (3, 3), body to world: about z, then y, then x.

    Yaw is counter-clockwise from east, positive pitch is nose down, positive roll is right side down.
    """
    fill_rotation(*cos_sin(yaw_rad), *cos_sin(pitch_rad), *cos_sin(roll_rad), out)


@array_kernel
def rotations(yaw_rad: F8, pitch_rad: float, roll_rad: float) -> F8:
    """Return world_R_body (n, 3, 3) for headings (n,) and a fixed inclination, angles as in `rotate`."""
    out = np.empty((yaw_rad.size, 3, 3))
    for i in range(yaw_rad.size):
        rotate(yaw_rad[i], pitch_rad, roll_rad, out[i])
    return out


def rotation(yaw_deg: float, pitch_deg: float, roll_deg: float) -> F8:
    """Return a rotation (3, 3), body to world, with angles as in `rotate`."""
    inclination = math.radians(pitch_deg), math.radians(roll_deg)
    yaw_rad = np.array([math.radians(yaw_deg)])
    turn: F8 = rotations(yaw_rad, *inclination)[0]
    return turn
