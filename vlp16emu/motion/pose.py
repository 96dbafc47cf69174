"""The pose of a moving or static body at any time with its derivatives."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from vlp16emu.rotation import rotation
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
