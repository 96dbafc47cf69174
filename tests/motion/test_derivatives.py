"""Rates and accelerations integrate back to the pose: 60 s, walked with everything on, in steps of 1 ms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vlp16emu.motion import Mount
from vlp16emu.motion.mount import mounted

STEP_NS, STEPS = 1_000_000, 60_000
H = STEP_NS * 1e-9
GAUSS = (0.5 * (1 - np.sqrt(1 / 3)), 0.5 * (1 + np.sqrt(1 / 3)))
"""Gauss points of order four."""


@pytest.fixture(scope="module", params=["pack", "device"])
def samples(request, walking, straps, start_ns):
    """Kinematics at the ends and both Gauss points of each step, of the pack and of a tilted, spinning device."""
    motion = walking(harness=straps((2.5, 3.0, 2.0, 3.0, 3.0, 2.5), 0.2))
    if request.param == "device":
        turns = {"yaw_deg": 20.0, "pitch_deg": 30.0, "roll_deg": -10.0, "spin_hz": 0.5}
        mount = Mount(lever_arm_m=(0.1, -0.2, 0.5), spin_axis=(0.2, 0.0, 1.0), **turns)
        motion = mounted(motion, mount, start_ns)
    begin = start_ns + np.arange(STEPS + 1, dtype=np.int64) * STEP_NS
    inner = [motion.kinematics_at(begin[:-1] + round(c * STEP_NS)) for c in GAUSS]
    return motion.kinematics_at(begin), inner


def summed(steps):
    """Sums (n + 1, 3) of steps (n, 3)."""
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def test_acceleration_integrates_back_to_velocity_and_position(samples):
    """Once and twice integrated, the acceleration leads to velocity and position within 1e-9 m/s and m."""
    ends, (early, late) = samples
    a0, a1 = early.world_a_body_m_s2, late.world_a_body_m_s2
    v = ends.world_v_body_m_s[0] + summed(H / 2 * (a0 + a1))
    within = H * H / 2 * ((1 - GAUSS[0]) * a0 + (1 - GAUSS[1]) * a1)
    p = ends.world_p_body_m[0] + summed(H * v[:-1] + within)
    assert np.abs(v - ends.world_v_body_m_s).max() < 1e-9
    assert np.abs(p - ends.world_p_body_m).max() < 1e-9


def test_angular_rate_integrates_back_to_rotation(samples):
    """Rotation by rotation (Magnus expansion of order four), the rate leads to the pose within 1e-9 rad."""
    ends, (early, late) = samples
    w0, w1 = early.body_w_rad_s, late.body_w_rad_s
    turns = Rotation.from_rotvec(H / 2 * (w0 + w1) + np.sqrt(3) / 12 * H * H * np.cross(w0, w1)).as_matrix()
    R, worst = ends.world_R_body[0].copy(), 0.0
    for i, turn in enumerate(turns):
        R = R @ turn
        if i % 50 == 49:
            worst = max(worst, np.abs(R - ends.world_R_body[i + 1]).max())
    assert worst < 1e-9


def test_angular_acceleration_integrates_back_to_rate(samples):
    """The angular acceleration leads to the angular rate within 1e-9 rad/s."""
    ends, (early, late) = samples
    w = ends.body_w_rad_s[0] + summed(H / 2 * (early.body_alpha_rad_s2 + late.body_alpha_rad_s2))
    assert np.abs(w - ends.body_w_rad_s).max() < 1e-9
