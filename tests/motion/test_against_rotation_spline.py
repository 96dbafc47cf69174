"""Recorded rotations against those of scipy's RotationSpline."""

import numpy as np
from scipy.spatial.transform import Rotation, RotationSpline

from vlp16emu.motion import Recorded
from vlp16emu.motion.pose_files import RecordedPoses
from vlp16emu.motion.recorded import RecordedMotion


def test_rotations_and_rates_agree_with_scipy():
    """On a head that swings by 40 degrees, recorded at 20 Hz, both splines agree to 1e-4 rad and 2e-3 rad/s."""
    t = np.arange(0.0, 6.0, 0.05)
    angles = np.column_stack([0.7 * np.sin(1.3 * t), 0.4 * np.sin(2.1 * t + 1), 0.3 * np.cos(0.9 * t)])
    recorded = Rotation.from_euler("ZYX", angles)
    theirs = RotationSpline(t, recorded)
    poses = RecordedPoses([], np.rint(t * 1e9).astype(np.int64), np.zeros((len(t), 3)), recorded.as_quat())
    section = Recorded(kind="recorded", file="poses.txt", format="tum")
    motion = RecordedMotion(section, poses, start_ns=0)
    ours = motion.kinematics_at(np.arange(500_000_000, 5_400_000_000, 3_333_333))
    at_s = ours.t_ns / 1e9
    difference = (theirs(at_s).inv() * Rotation.from_matrix(ours.world_R_body)).magnitude()
    assert difference.max() < 1e-4
    np.testing.assert_allclose(ours.body_w_rad_s, theirs(at_s, 1), atol=2e-3)
    np.testing.assert_allclose(ours.body_alpha_rad_s2, theirs(at_s, 2), atol=0.1)
