"""The motion of a sensor that stands still."""

import math

import numpy as np

from vlp16emu.motion.pose import Kinematics, rotation
from vlp16emu.types import Array, IntArray, Poses


class StaticMotion:
    """A sensor on a tripod at a place (3,) in the world, turned as by `motion.pose.rotate`: one pose, computed once."""

    run_time_s = math.inf
    moves = False

    def __init__(self, position_m: Array, yaw_deg: float, pitch_deg: float, roll_deg: float) -> None:
        turn = rotation(yaw_deg, pitch_deg, roll_deg)
        self._poses = Poses(np.zeros(1, np.int64), turn[None], position_m[None])

    def poses_at(self, t_ns: IntArray) -> Poses:  # noqa: ARG002  # the same at all times
        """Return the one pose."""
        return self._poses

    def kinematics_at(self, t_ns: IntArray) -> Kinematics:
        """Repeat the one pose at instants (n,), without any motion."""
        n, still = len(t_ns), np.zeros((len(t_ns), 3))
        turns = np.repeat(self._poses.world_R_body, n, axis=0)
        return Kinematics(t_ns, turns, np.repeat(self._poses.world_p_body_m, n, axis=0), *(still,) * 4)
