"""Devices on a carrier, and rates that integrate back to the pose over 60 s in steps of 1 ms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vlp16emu.motion import Mount
from vlp16emu.motion.carrier import StaticMotion
from vlp16emu.motion.mount import mounted
from vlp16emu.motion.pose import rotations


def tripod():
    return StaticMotion(np.array([1.0, 2.0, 3.0]), 90.0, 0.0, 0.0)


def test_mount_that_changes_nothing_costs_nothing(walking, start_ns):
    """A device in the carrier's own frame has the carrier's own motion."""
    carrier = walking()
    assert mounted(carrier, Mount(), start_ns) is carrier


def test_lever_arm_and_tilt_are_in_the_carriers_frame(start_ns):
    """On a carrier that looks north, an arm forward points north and a tilt nose down looks down northwards."""
    device = mounted(tripod(), Mount(lever_arm_m=(0.5, 0.0, 0.2), pitch_deg=90.0), start_ns)
    poses = device.poses_at(np.arange(5))
    assert len(poses.t_ns) == 1
    assert not device.moves
    np.testing.assert_allclose(poses.world_p_body_m, [[1.0, 2.5, 3.2]], atol=1e-15)
    np.testing.assert_allclose(poses.world_R_body[0] @ [1, 0, 0], [0, 0, -1], atol=1e-15)
    np.testing.assert_allclose(poses.world_R_body[0] @ [0, 0, 1], [0, 1, 0], atol=1e-15)


def test_spinning_stage_turns_the_tilted_device(start_ns):
    """After a quarter of a turn counter-clockwise about the carrier's z, a device tilted forward is tilted left."""
    device = mounted(tripod(), Mount(pitch_deg=30.0, spin_hz=0.5, spin_axis=(0.0, 0.0, 2.0)), start_ns)
    assert device.moves
    t_ns = start_ns + np.array([0, 500_000_000, 86_400 * 10**9 + 500_000_000])
    tilt, turns = rotations(np.zeros(1), np.radians(30.0), 0.0)[0], device.poses_at(t_ns).world_R_body
    carrier = tripod().poses_at(t_ns).world_R_body[0]
    for turn, yaw in zip(turns, (0.0, np.pi / 2, np.pi / 2), strict=True):
        np.testing.assert_allclose(turn, carrier @ rotations(np.array([yaw]), 0.0, 0.0)[0] @ tilt, atol=1e-13)


def test_spinning_device_on_a_tripod_has_the_rate_of_its_stage(start_ns):
    """It reads the stage's rate about its own tilted axis, steadily, and moves nowhere."""
    device = mounted(tripod(), Mount(lever_arm_m=(0.3, 0.0, 0.0), pitch_deg=30.0, spin_hz=0.5), start_ns)
    k = device.kinematics_at(start_ns + np.arange(0, 2 * 10**9, 1_000_003))
    np.testing.assert_allclose(k.body_w_rad_s, np.tile(np.pi * np.array([-0.5, 0, np.sqrt(0.75)]), (len(k.t_ns), 1)))
    assert not k.body_alpha_rad_s2.any()
    assert not k.world_a_body_m_s2.any()


@pytest.mark.parametrize("spin_hz", [0.0, 0.5])
def test_poses_and_kinematics_are_one_function(walking, start_ns, spin_hz):
    """Both ways of asking give the same bits, at any size of question."""
    turns = {"yaw_deg": 1.0, "pitch_deg": 2.0, "roll_deg": 3.0, "spin_hz": spin_hz}
    mount = Mount(lever_arm_m=(0.1, 0.2, 0.3), spin_axis=(1.0, 1.0, 1.0), **turns)
    device = mounted(walking(), mount, start_ns)
    t_ns = start_ns + np.arange(0, 3 * 10**9, 7_000_001)
    poses, kinematics = device.poses_at(t_ns), device.kinematics_at(t_ns)
    assert (poses.world_R_body == kinematics.world_R_body).all()
    assert (poses.world_p_body_m == kinematics.world_p_body_m).all()
    alone = device.kinematics_at(t_ns[100:101])
    for name in ("world_v_body_m_s", "world_a_body_m_s2", "body_w_rad_s", "body_alpha_rad_s2"):
        assert (getattr(alone, name)[0] == getattr(kinematics, name)[100]).all()


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
