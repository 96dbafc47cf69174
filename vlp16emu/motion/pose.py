"""The pose of a body at any time with its derivatives, and rotations from angles."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from vlp16emu.kernels.compiler import numba
from vlp16emu.trig import cos_sin
from vlp16emu.types import Array, IntArray, Poses


@dataclass(frozen=True, slots=True)
class Kinematics(Poses):
    """Poses of a body at n instants with the exact derivatives of the same function."""

    world_v_body_m_s: Array  # (n, 3) its velocity
    world_a_body_m_s2: Array  # (n, 3) its acceleration, without gravity
    body_w_rad_s: Array  # (n, 3) angular rate of the body, in body axes
    body_alpha_rad_s2: Array  # (n, 3) time derivative of `body_w_rad_s`


class Motion(Protocol):
    """Pose of a body at any time."""

    @property
    def run_time_s(self) -> float:
        """Time for which there is a pose; infinite if the motion never ends."""

    @property
    def moves(self) -> bool:
        """True if poses differ from one instant to another."""

    def poses_at(self, t_ns: IntArray) -> Poses:
        """Poses at UTC instants (n,); a single one where nothing moves."""

    def kinematics_at(self, t_ns: IntArray) -> Kinematics:
        """Poses at UTC instants (n,) with the derivatives of the same function."""


@numba.njit(cache=True, nogil=True, forceinline=True, _nrt=False)
def fill_rotation(cy: float, sy: float, cp: float, sp: float, cr: float, sr: float, out: Array) -> None:
    """Fill the rotation (3, 3) of `rotate` from cosines and sines of yaw, pitch and roll."""
    out[0, 0], out[0, 1], out[0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    out[1, 0], out[1, 1], out[1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    out[2, 0], out[2, 1], out[2, 2] = -sp, cp * sr, cp * cr


@numba.njit(cache=True, nogil=True, forceinline=True, _nrt=False)
def rotate(yaw_rad: float, pitch_rad: float, roll_rad: float, out: Array) -> None:
    """Fill a rotation (3, 3), body to world: about z, then y, then x.

    Yaw is counter-clockwise from east, positive pitch is nose down, positive roll is right side down.
    """
    fill_rotation(*cos_sin(yaw_rad), *cos_sin(pitch_rad), *cos_sin(roll_rad), out)


@numba.njit(cache=True, nogil=True)
def rotations(yaw_rad: Array, pitch_rad: float, roll_rad: float) -> Array:
    """Return world_R_body (n, 3, 3) for headings (n,) and a fixed inclination, angles as in `rotate`."""
    out = np.empty((yaw_rad.size, 3, 3))
    for i in range(yaw_rad.size):
        rotate(yaw_rad[i], pitch_rad, roll_rad, out[i])
    return out


def rotation(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Array:
    """Return a rotation (3, 3), body to world, with angles as in `rotate`."""
    inclination = math.radians(pitch_deg), math.radians(roll_deg)
    return rotations(np.array([math.radians(yaw_deg)]), *inclination)[0]


@numba.njit(cache=True, nogil=True)
def body_rate(
    angle_rad: Array, rate_rad_s: Array, acceleration_rad_s2: Array, w_rad_s: Array, alpha_rad_s2: Array
) -> None:
    """Fill angular rate and acceleration (3,), in body axes, from roll, pitch, yaw (3,) and their derivatives.

    Source: the z-y-x Euler kinematic equations, for instance Diebel, "Representing Attitude", 2006, section 5.
    """
    cr, sr = cos_sin(angle_rad[0])
    cp, sp = cos_sin(angle_rad[1])
    roll, pitch, yaw = rate_rad_s
    roll2, pitch2, yaw2 = acceleration_rad_s2
    w_rad_s[0] = roll - sp * yaw
    w_rad_s[1] = cr * pitch + sr * cp * yaw
    w_rad_s[2] = -sr * pitch + cr * cp * yaw
    alpha_rad_s2[0] = roll2 - sp * yaw2 - cp * pitch * yaw
    across = cp * yaw2 - sp * pitch * yaw
    alpha_rad_s2[1] = cr * pitch2 + sr * across + roll * w_rad_s[2]
    alpha_rad_s2[2] = -sr * pitch2 + cr * across - roll * w_rad_s[1]
