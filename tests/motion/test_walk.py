"""Standing and walking."""

import math

import numpy as np
import pytest

from vlp16emu.motion import Gait, Path, Standing, Walking, rotations

START_NS = 1_780_000_000 * 10**9


def ground(x_m, _y_m):
    return 0.1 * x_m


def walking(gait):
    path = Path(np.array([[0.0, 0.0], [60.0, 0.0]]), ground)
    return Walking(
        path, start_ns=START_NS, speed_m_s=1.2, sensor_height_m=2.0, pitch_deg=0.0, roll_deg=0.0, gait=gait
    )


def at(motion, seconds):
    t_ns = START_NS + np.rint(np.asarray(seconds) * 1e9).astype(np.int64)
    return motion.poses_at(t_ns)


def test_without_gait_the_sensor_glides_over_the_ground():
    """Amplitude zero gives the bare path, sensor height above the ground, at the set speed."""
    p = at(walking(Gait(1.8, 0.0, 0.0)), [0.0, 10.0]).world_p_body_m
    np.testing.assert_allclose(p, [[0.0, 0.0, 2.0], [12.0, 0.0, 3.2]], atol=1e-9)


def test_gait_is_two_sines():
    """The body rises once per step and sways to the left and right once per two steps."""
    gait, t = Gait(1.8, 0.025, 0.02), np.linspace(0.0, 5.0, 2001)
    offset = at(walking(gait), t).world_p_body_m - at(walking(Gait(1.8, 0.0, 0.0)), t).world_p_body_m
    np.testing.assert_allclose(offset[:, 2], 0.025 * np.sin(2 * np.pi * 1.8 * t), atol=1e-9)
    np.testing.assert_allclose(offset[:, 1], 0.02 * np.sin(np.pi * 1.8 * t), atol=1e-9)
    np.testing.assert_allclose(offset[:, 0], 0.0, atol=1e-9)


def test_poses_do_not_depend_on_their_company():
    """A pose computed alone has the same bits as among a million others."""
    motion, t = walking(Gait(1.8, 0.025, 0.02)), np.linspace(0.0, 40.0, 100_003)
    among, alone = at(motion, t), at(motion, t[77_777:77_778])
    assert (among.world_p_body_m[77_777] == alone.world_p_body_m[0]).all()
    assert (among.world_R_body[77_777] == alone.world_R_body[0]).all()


def test_run_time_is_length_over_speed():
    """The walk is over when the path is."""
    assert walking(Gait(1.8, 0.0, 0.0)).run_time_s == pytest.approx(60.0 / 1.2)


def test_standing_sensor_has_one_pose_for_all_times():
    """A static sensor computes a single pose, whatever it is asked for."""
    motion = Standing(np.array([1.0, 2.0, 3.0]), 90.0, 0.0, 0.0)
    poses = motion.poses_at(np.arange(1000))
    assert len(poses.t_ns) == 1
    assert motion.run_time_s == math.inf
    np.testing.assert_allclose(poses.world_R_body[0] @ [1, 0, 0], [0, 1, 0], atol=1e-15)


def test_angles_turn_as_documented():
    """Yaw is counter-clockwise, positive pitch puts the nose down, positive roll the right side down."""
    yaw, pitch, roll = (rotations(np.array([a]), b, c)[0] for a, b, c in np.eye(3) * 0.1)
    assert (yaw @ [1, 0, 0])[1] > 0.09
    assert (pitch @ [1, 0, 0])[2] < -0.09
    assert (roll @ [0, -1, 0])[2] < -0.09
    for turn in (yaw, pitch, roll):
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(turn) > 0.999
