"""A route whose derivatives are plain formulas, and people who walk it."""

import numpy as np
import pytest

from vlp16emu.extras.walk import Gait, Harness, Walk
from vlp16emu.extras.walk.motion import WalkMotion

START_NS = 1_780_000_000 * 10**9


class Circle:
    """Round a circle and up a slope, from a stand to 1.2 m/s within two seconds."""

    run_time_s = 3600.0

    def __init__(self, radius_m, speed_m_s, centre_m):
        self.radius_m, self.speed_m_s, self.centre_m = radius_m, speed_m_s, centre_m

    def at(self, elapsed_s):
        """Nodes and speeds at times since the start."""
        t, stop = elapsed_s, 2.0
        x = np.clip(t / stop, 0.0, 1.0)
        speed = self.speed_m_s * x**3 * (10 - 15 * x + 6 * x * x)
        rise = self.speed_m_s * 30 * x * x * (1 - x) ** 2 / stop
        along = self.speed_m_s * (stop * x**4 * (2.5 - 3 * x + x * x) + np.maximum(t - stop, 0.0))
        angle = along / self.radius_m
        c, s, zero = np.cos(angle), np.sin(angle), np.zeros_like(angle)
        ahead, left = np.stack([c, s, zero + 0.05], -1), np.stack([-s, c, zero], -1)
        position = np.stack([self.radius_m * s, self.radius_m * (1 - c), 0.05 * along], -1)
        acceleration = rise[:, None] * ahead + (speed**2 / self.radius_m)[:, None] * left
        nodes = np.zeros((len(angle), 6, 3))
        nodes[:, :3] = np.stack([self.centre_m + position, speed[:, None] * ahead, acceleration], -1)
        nodes[:, 5] = np.stack([angle, speed / self.radius_m, rise / self.radius_m], -1)
        return nodes, speed


@pytest.fixture(scope="session")
def start_ns():
    """UTC at which walks begin."""
    return START_NS


@pytest.fixture(scope="session")
def circle():
    """Make a route round a circle."""

    def make(radius_m=8.0, speed_m_s=1.2, centre_m=(0.0, 0.0, 0.0)):
        return Circle(radius_m, speed_m_s, np.array(centre_m))

    return make


@pytest.fixture(scope="session")
def gait():
    """Make a gait of which everything moves, less what is given."""

    def make(**own):
        round_m = {"vertical_m": 0.02, "sideways_m": 0.02, "heel_strike_m": 0.001}
        return Gait(**{"step_hz": 1.85, "roll_deg": 1.7, "yaw_deg": 3.5, "variation": 0.02, **round_m, **own})

    return make


@pytest.fixture(scope="session")
def straps():
    """Make straps from the frequencies of all axes, or from one for all, and their damping."""

    def make(hz, damping_ratio):
        axes = ("fore_aft_hz", "sideways_hz", "vertical_hz", "roll_hz", "pitch_hz", "yaw_hz")
        own_hz = hz if isinstance(hz, tuple) else (hz,) * 6
        return Harness(**dict(zip(axes, own_hz, strict=True)), damping_ratio=damping_ratio)

    return make


@pytest.fixture(scope="session")
def still():
    """Give a gait without any motion."""
    return Gait(preset="none", step_hz=1.85)


@pytest.fixture(scope="session")
def walking(circle, gait):
    """Let a person walk."""

    def make(route=None, own_gait=None, harness=None, start_ns=START_NS):
        points_m = [(0.0, 0.0), (1.0, 0.0)]  # of no effect: the route is given
        section = Walk(kind="walk", way_points_m=points_m, gait=own_gait or gait(), harness=harness)
        return WalkMotion(section, route or circle(), start_ns=start_ns, seed=1)

    return make


@pytest.fixture(scope="session")
def at(start_ns):
    """Ask for poses at seconds since the start."""

    def ask(motion, seconds):
        return motion.poses_at(start_ns + np.rint(np.asarray(seconds) * 1e9).astype(np.int64))

    return ask
