"""A route whose derivatives are plain formulas, and people who walk it."""

import numpy as np

from vlp16emu.extras.walk.motion import WalkMotion
from vlp16emu.extras.walk.settings import Gait, Harness, Walk

START_NS = 1_780_000_000 * 10**9
STILL = Gait(preset="none", step_hz=1.85)


class Circle:
    """Round a circle and up a slope, from a stand to 1.2 m/s within two seconds."""

    run_time_s, radius_m, speed_m_s = 3600.0, 8.0, 1.2

    def __init__(self, centre_m=(0.0, 0.0, 0.0)):
        self.centre_m = np.array(centre_m)

    def at(self, elapsed_s):
        """Nodes and speeds at times since the start."""
        t, stop, radius_m, full_m_s = elapsed_s, 2.0, self.radius_m, self.speed_m_s
        x = np.clip(t / stop, 0.0, 1.0)
        speed = full_m_s * x**3 * (10 - 15 * x + 6 * x * x)
        rise = full_m_s * 30 * x * x * (1 - x) ** 2 / stop
        along = full_m_s * (stop * x**4 * (2.5 - 3 * x + x * x) + np.maximum(t - stop, 0.0))
        angle = along / radius_m
        c, s, zero = np.cos(angle), np.sin(angle), np.zeros_like(angle)
        ahead, left = np.stack([c, s, zero + 0.05], -1), np.stack([-s, c, zero], -1)
        position = np.stack([radius_m * s, radius_m * (1 - c), 0.05 * along], -1)
        acceleration = rise[:, None] * ahead + (speed**2 / radius_m)[:, None] * left
        nodes = np.zeros((len(angle), 6, 3))
        nodes[:, :3] = np.stack([self.centre_m + position, speed[:, None] * ahead, acceleration], -1)
        nodes[:, 5] = np.stack([angle, speed / radius_m, rise / radius_m], -1)
        return nodes, speed


def gait(**own):
    """A gait with every motion in it, but for what is given."""
    round_m = {"vertical_m": 0.02, "sideways_m": 0.02, "heel_strike_m": 0.001}
    return Gait(**{"step_hz": 1.85, "roll_deg": 1.7, "yaw_deg": 3.5, "variation": 0.02, **round_m, **own})


def straps(hz, damping_ratio):
    """Straps from the frequencies of all axes, or from one for all."""
    axes = ("fore_aft_hz", "sideways_hz", "vertical_hz", "roll_hz", "pitch_hz", "yaw_hz")
    own_hz = hz if isinstance(hz, tuple) else (hz,) * 6
    return Harness(**dict(zip(axes, own_hz, strict=True)), damping_ratio=damping_ratio)


def walking(route=None, own_gait=None, harness=None, start_ns=START_NS):
    points_m = [(0.0, 0.0), (1.0, 0.0)]  # of no effect: the route is given
    section = Walk(kind="walk", way_points_m=points_m, gait=own_gait or gait(), harness=harness)
    return WalkMotion(section, route or Circle(), start_ns=start_ns, seed=1)


def at(motion, seconds):
    return motion.poses_at(START_NS + np.rint(np.asarray(seconds) * 1e9).astype(np.int64))
