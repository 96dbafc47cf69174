"""Devices on a carrier, and rates against their poses."""

import numpy as np
import pytest
from extras.walk.kit import START_NS, straps, walking
from scipy.spatial.transform import Rotation

from vlp16emu.motion.mount import device_motion
from vlp16emu.motion.pose import StaticMotion
from vlp16emu.motion.settings import Mount
from vlp16emu.rotation import rotations


def tripod():
    return StaticMotion(np.array([1.0, 2.0, 3.0]), 90.0, 0.0, 0.0)


def test_mount_that_changes_nothing_costs_nothing():
    """A device in the carrier's own frame has the carrier's own motion."""
    carrier = walking()
    assert device_motion(carrier, Mount(), START_NS) is carrier


def test_lever_arm_and_tilt_are_in_the_carriers_frame():
    """On a carrier that looks north, an arm forward points north and a tilt nose down looks down
    northwards."""
    device = device_motion(tripod(), Mount(lever_arm_m=(0.5, 0.0, 0.2), pitch_deg=90.0), START_NS)
    poses = device.poses_at(np.arange(5))
    assert len(poses.t_ns) == 1
    assert not device.moves
    np.testing.assert_allclose(poses.world_p_body_m, [[1.0, 2.5, 3.2]], atol=1e-15)
    np.testing.assert_allclose(poses.world_R_body[0] @ [1, 0, 0], [0, 0, -1], atol=1e-15)
    np.testing.assert_allclose(poses.world_R_body[0] @ [0, 0, 1], [0, 1, 0], atol=1e-15)


def test_spinning_stage_turns_the_tilted_device():
    """After a quarter of a turn counter-clockwise about the carrier's z, a device tilted forward is tilted
    left."""
    device = device_motion(tripod(), Mount(pitch_deg=30.0, spin_hz=0.5, spin_axis=(0.0, 0.0, 2.0)), START_NS)
    assert device.moves
    t_ns = START_NS + np.array([0, 500_000_000, 86_400 * 10**9 + 500_000_000])
    tilt, turns = rotations(np.zeros(1), np.radians(30.0), 0.0)[0], device.poses_at(t_ns).world_R_body
    carrier = tripod().poses_at(t_ns).world_R_body[0]
    for turn, yaw in zip(turns, (0.0, np.pi / 2, np.pi / 2), strict=True):
        np.testing.assert_allclose(turn, carrier @ rotations(np.array([yaw]), 0.0, 0.0)[0] @ tilt, atol=1e-13)


def test_spinning_device_on_a_tripod_has_the_rate_of_its_stage():
    """It reads the stage's rate about its own tilted axis, steadily, and moves nowhere."""
    device = device_motion(
        tripod(), Mount(lever_arm_m=(0.3, 0.0, 0.0), pitch_deg=30.0, spin_hz=0.5), START_NS
    )
    k = device.kinematics_at(START_NS + np.arange(0, 2 * 10**9, 1_000_003))
    np.testing.assert_allclose(
        k.body_w_rad_s, np.tile(np.pi * np.array([-0.5, 0, np.sqrt(0.75)]), (len(k.t_ns), 1))
    )
    assert not k.body_alpha_rad_s2.any()
    assert not k.world_a_body_m_s2.any()


@pytest.mark.parametrize("spin_hz", [0.0, 0.5])
def test_poses_and_kinematics_are_one_function(spin_hz):
    """Both ways of asking give the same bits, at any size of question."""
    turns = {"yaw_deg": 1.0, "pitch_deg": 2.0, "roll_deg": 3.0, "spin_hz": spin_hz}
    mount = Mount(lever_arm_m=(0.1, 0.2, 0.3), spin_axis=(1.0, 1.0, 1.0), **turns)
    device = device_motion(walking(), mount, START_NS)
    t_ns = START_NS + np.arange(0, 3 * 10**9, 7_000_001)
    poses, kinematics = device.poses_at(t_ns), device.kinematics_at(t_ns)
    assert (poses.world_R_body == kinematics.world_R_body).all()
    assert (poses.world_p_body_m == kinematics.world_p_body_m).all()
    alone = device.kinematics_at(t_ns[100:101])
    for name in ("world_v_body_m_s", "world_a_body_m_s2", "body_w_rad_s", "body_alpha_rad_s2"):
        assert (getattr(alone, name)[0] == getattr(kinematics, name)[100]).all()


@pytest.mark.parametrize("spins", [False, True])
def test_rates_are_the_derivatives_of_poses(spins):
    """Velocity, angular rate and both accelerations of a pack in loose straps, and of a tilted device that
    spins on it, equal differences."""
    motion = walking(harness=straps((2.5, 3.0, 2.0, 3.0, 3.0, 2.5), 0.2))
    if spins:
        turns = {"yaw_deg": 20.0, "pitch_deg": 30.0, "roll_deg": -10.0, "spin_hz": 0.5}
        motion = device_motion(
            motion, Mount(lever_arm_m=(0.1, -0.2, 0.5), spin_axis=(0.2, 0.0, 1.0), **turns), START_NS
        )
    t_ns, h_ns = START_NS + np.arange(0, 25 * 10**9, 12_345_678), 20_000
    before, at, after = (motion.kinematics_at(t_ns + d) for d in (-h_ns, 0, h_ns))
    per_s = 0.5e9 / h_ns
    turned = Rotation.from_matrix(before.world_R_body.swapaxes(1, 2) @ after.world_R_body).as_rotvec()
    np.testing.assert_allclose(
        (after.world_p_body_m - before.world_p_body_m) * per_s, at.world_v_body_m_s, atol=1e-7
    )
    np.testing.assert_allclose(turned * per_s, at.body_w_rad_s, atol=1e-6)
    v, w = (getattr(after, of) - getattr(before, of) for of in ("world_v_body_m_s", "body_w_rad_s"))
    np.testing.assert_allclose(v * per_s, at.world_a_body_m_s2, atol=1e-4)
    np.testing.assert_allclose(w * per_s, at.body_alpha_rad_s2, atol=1e-4)
