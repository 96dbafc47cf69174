#!/usr/bin/env python3
"""Your own motion: a carrier that follows a function of time, here a sensor that swings on a rope.

A package that declares it as an entry point of the group `vlp16emu.motions` makes it available to all
scene files and commands.

tools/examples/own_motion.py [SECONDS]
"""

import math
import sys
from typing import Literal

import numpy as np

from vlp16emu import Emulator
from vlp16emu.motion.pose import Kinematics
from vlp16emu.motion.settings import MotionSection
from vlp16emu.settings import Size
from vlp16emu.types import Poses


class Swing(MotionSection):
    """A sensor that swings along x below a branch."""

    kind: Literal["swing"]
    rope_m: Size = 3.0
    amplitude_rad: float = 0.3

    def carrier(self, site: object, *, start_ns: int, **_: object) -> tuple["Pendulum", np.ndarray]:
        """Return the motion, and its path on the map for the layout of a forest."""
        reach_m = self.rope_m * math.sin(self.amplitude_rad)
        return Pendulum(self, start_ns), np.array([[-reach_m, 0.0], [reach_m, 0.0]])


class Pendulum:
    """A `Motion` of vlp16emu: poses at any time, with the derivatives of the same function for the IMU."""

    run_time_s, moves = math.inf, True

    def __init__(self, swing: Swing, start_ns: int) -> None:
        self.swing, self.start_ns, self.rate = swing, start_ns, math.sqrt(9.81 / swing.rope_m)

    def poses_at(self, t_ns: np.ndarray) -> Poses:
        """Return poses at UTC instants (n,): the rope is straight, so pitch is the angle of the swing."""
        c, s = np.cos(self.angle(t_ns)), np.sin(self.angle(t_ns))
        zero, one = np.zeros(len(t_ns)), np.ones(len(t_ns))
        turn = np.array([[c, zero, -s], [zero, one, zero], [s, zero, c]]).transpose(2, 0, 1)
        place_m = self.swing.rope_m * np.column_stack([s, zero, 1 - c]) + [0.0, 0.0, 1.0]
        return Poses(t_ns, np.ascontiguousarray(turn), place_m)

    def kinematics_at(self, t_ns: np.ndarray) -> Kinematics:
        """Return poses with velocity, acceleration, angular rate and angular acceleration."""
        poses, c, s = self.poses_at(t_ns), np.cos(self.angle(t_ns)), np.sin(self.angle(t_ns))
        w, a, zero = self.angle(t_ns, 1), self.angle(t_ns, 2), np.zeros(len(t_ns))
        v_m_s = self.swing.rope_m * np.column_stack([c * w, zero, s * w])
        a_m_s2 = self.swing.rope_m * np.column_stack([c * a - s * w**2, zero, s * a + c * w**2])
        turns = (np.column_stack([zero, -rate, zero]) for rate in (w, a))  # nose down is positive
        return Kinematics(t_ns, poses.world_R_body, poses.world_p_body_m, v_m_s, a_m_s2, *turns)

    def angle(self, t_ns: np.ndarray, derivative: int = 0) -> np.ndarray:
        """Return the angle of the swing, or a derivative of it."""
        phase = self.rate * (t_ns - self.start_ns) * 1e-9 + derivative * math.pi / 2
        return self.swing.amplitude_rad * self.rate**derivative * np.sin(phase)


if __name__ == "__main__":
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 5.0
    settings = {"motion": {"kind": "swing", "rope_m": 2.0}, "imu": {"preset": "consumer"}}
    recording = Emulator("static_bench", settings).record(
        "swing.pcap", duration_s=seconds, truth="swing_truth"
    )
    print(recording.returns, "returns; samples of its IMU in swing_truth/imu.csv")
