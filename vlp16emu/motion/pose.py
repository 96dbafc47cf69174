"""The pose of a moving or static body at any time with its derivatives, and rotations from angles."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from vlp16emu.kernels.compiler import array_kernel, inline_kernel
from vlp16emu.trig import cos_sin
from vlp16emu.types import F8, I8, Poses


@dataclass(frozen=True, slots=True)
class Kinematics(Poses):
    """Poses of a body at n instants with the exact derivatives of the same function."""

    world_v_body_m_s: F8  # (n, 3) velocity
    world_a_body_m_s2: F8  # (n, 3) acceleration, without gravity
    body_w_rad_s: F8  # (n, 3) angular rate of the body, in body axes
    body_alpha_rad_s2: F8  # (n, 3) time derivative of `body_w_rad_s`


class Motion(Protocol):
    """Pose of a body at any time."""

    @property
    def run_time_s(self) -> float:
        """Time for which there is a pose; infinite if the motion never ends."""

    @property
    def moves(self) -> bool:
        """True if poses change with time."""

    def poses_at(self, t_ns: I8) -> Poses:
        """Return poses at UTC instants (n,); a single pose if nothing moves."""

    def kinematics_at(self, t_ns: I8) -> Kinematics:
        """Return poses at UTC instants (n,) with the derivatives of the same function."""


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
    return rotations(np.array([math.radians(yaw_deg)]), *inclination)[0]


class StaticMotion:
    """A sensor on a tripod at a position (3,) in the world, rotated as by `rotate`: a single pose."""

    run_time_s = math.inf
    moves = False

    def __init__(self, position_m: F8, yaw_deg: float, pitch_deg: float, roll_deg: float) -> None:
        turn = rotation(yaw_deg, pitch_deg, roll_deg)
        self._poses = Poses(np.zeros(1, np.int64), turn[None], position_m[None])

    def poses_at(self, t_ns: I8) -> Poses:  # noqa: ARG002  # constant
        """Return the one pose."""
        return self._poses

    def kinematics_at(self, t_ns: I8) -> Kinematics:
        """Repeat the one pose at instants (n,), without any motion."""
        n = len(t_ns)
        still = np.zeros((n, 3))
        turns = np.repeat(self._poses.world_R_body, n, axis=0)
        return Kinematics(t_ns, turns, np.repeat(self._poses.world_p_body_m, n, axis=0), *(still,) * 4)
