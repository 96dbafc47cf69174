"""Recorded poses in files, and a body that moves as they say."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vlp16emu.errors import TrajectoryError
from vlp16emu.extras.recorded.files import RecordedPoses, read_kitti, read_trajectory_csv, read_tum
from vlp16emu.extras.recorded.motion import RecordedMotion
from vlp16emu.extras.recorded.settings import Recorded

START_NS = 1_780_000_000 * 10**9


def poses(t_s, position_m, quaternion):
    where = [f"poses.txt, line {i + 1}" for i in range(len(t_s))]
    t_ns = np.rint(np.asarray(t_s) * 1e9).astype(np.int64)
    return RecordedPoses(where, t_ns, np.asarray(position_m, float), np.asarray(quaternion, float))


def about_z(angle_rad):
    half, zero = np.asarray(angle_rad) / 2, np.zeros(len(angle_rad))
    return np.column_stack([zero, zero, np.sin(half), np.cos(half)])


def recorded(some, **own):
    section = Recorded(kind="recorded", file="poses.txt", format="tum", **own)
    return RecordedMotion(section, some, start_ns=START_NS)


def wandering(signs=None):
    """Five seconds of a body that swings about all axes."""
    t = np.arange(0.0, 5.0, 0.05) + 0.01 * np.sin(np.arange(100.0))
    vector = np.column_stack([np.sin(t), np.cos(1.7 * t), 0.4 * np.sin(0.6 * t), 2 + np.sin(2.1 * t)])
    quaternion = vector / np.linalg.norm(vector, axis=1)[:, None]
    place = np.column_stack([t, np.sin(t), 0.1 * np.cos(3 * t)])
    return poses(t, place, quaternion if signs is None else quaternion * signs[:, None])


def instants(seconds):
    return START_NS + np.rint(np.asarray(seconds) * 1e9).astype(np.int64)


def test_recorded_poses_are_met():
    """At its stamps, the first being the start of the run, the body has the recorded pose."""
    some = wandering()
    found = recorded(some).poses_at(START_NS + some.t_ns - some.t_ns[0])
    np.testing.assert_allclose(found.world_p_body_m, some.position_m, atol=1e-12)
    x, y, z, w = some.quaternion.T
    np.testing.assert_allclose(found.world_R_body[:, 2, 1], 2 * (y * z + x * w), atol=1e-12)
    np.testing.assert_allclose(
        found.world_R_body @ found.world_R_body.transpose(0, 2, 1), np.eye(3)[None].repeat(100, 0), atol=1e-14
    )


def test_the_sign_of_a_quaternion_means_nothing():
    """Antiparallel quaternions give the same bits."""
    signs = np.where(np.arange(100) * 7 % 3 == 1, -1.0, 1.0)
    signs[0] = 1.0
    t_ns = instants(np.linspace(0.0, 4.9, 777))
    one, other = (recorded(wandering(s)).poses_at(t_ns) for s in (None, signs))
    np.testing.assert_array_equal(one.world_R_body, other.world_R_body)


def test_derivatives_belong_to_the_same_function():
    """Velocity, acceleration and angular rates are the differences of poses and rates over a tenth of a
    millisecond."""
    h = 1e-4
    t_ns = instants(np.arange(0.5, 4.0, h))
    k = recorded(wandering()).kinematics_at(t_ns)

    def slope(values):
        return (values[2:] - values[:-2]) / (2 * h)

    np.testing.assert_allclose(slope(k.world_p_body_m), k.world_v_body_m_s[1:-1], atol=1e-6)
    np.testing.assert_allclose(slope(k.world_v_body_m_s), k.world_a_body_m_s2[1:-1], atol=1e-2)
    spin = k.world_R_body[1:-1].transpose(0, 2, 1) @ slope(k.world_R_body)
    np.testing.assert_allclose(spin[:, [2, 0, 1], [1, 2, 0]], k.body_w_rad_s[1:-1], atol=1e-3)
    np.testing.assert_allclose(slope(k.body_w_rad_s), k.body_alpha_rad_s2[1:-1], atol=2e-2)


def test_a_steady_turn_stays_steady():
    """Poses 10 degrees apart leave the turn right to 1e-6 rad, and its rate to 1e-4 of itself."""
    t = np.arange(0.0, 10.0, 0.1)
    motion = recorded(poses(t, np.zeros((100, 3)), about_z(np.radians(100.0) * t)))
    seconds = np.linspace(1.0, 8.9, 1003)
    k = motion.kinematics_at(instants(seconds))
    yaw = np.unwrap(np.arctan2(k.world_R_body[:, 1, 0], k.world_R_body[:, 0, 0]), period=2 * np.pi)
    error = yaw - np.radians(100.0) * seconds
    assert np.abs(error - np.rint(error / (2 * np.pi)) * 2 * np.pi).max() < 1e-6
    np.testing.assert_allclose(k.body_w_rad_s[:, 2], np.radians(100.0), rtol=1e-4)


def test_before_and_after_it_is_at_rest():
    """Beyond its ends the body is at rest at the first and last pose."""
    some = wandering()
    motion = recorded(some)
    k = motion.kinematics_at(instants([-5.0, motion.run_time_s + 5.0]))
    np.testing.assert_allclose(k.world_p_body_m, some.position_m[[0, -1]], atol=1e-12)
    for rate in (k.world_v_body_m_s, k.world_a_body_m_s2, k.body_w_rad_s, k.body_alpha_rad_s2):
        assert not rate.any()


def test_the_recording_is_placed_in_the_world():
    """A turn of 90 degrees and a shift take both position and heading with them."""
    some = poses([0.0, 1.0], [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]], about_z([0.0, 0.0]))
    found = recorded(some, x_m=10.0, y_m=20.0, z_m=3.0, yaw_deg=90.0).poses_at(instants([0.5]))
    np.testing.assert_allclose(found.world_p_body_m[0], [10.0, 21.5, 3.0], atol=1e-12)
    np.testing.assert_allclose(found.world_R_body[0] @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-12)


def test_camera_axes_become_those_of_a_body():
    """A camera that moves along its z axis and turns left about its -y goes forward and turns left."""
    angle = np.array([0.0, 0.5])
    quaternion = np.column_stack([0 * angle, -np.sin(angle / 2), 0 * angle, np.cos(angle / 2)])
    some = poses([0.0, 1.0], [[0.0, 0.0, 0.0], [-0.1, -0.2, 3.0]], quaternion)
    found = recorded(some, axes="camera").poses_at(instants([1.0]))
    np.testing.assert_allclose(found.world_p_body_m[0], [3.0, 0.1, 0.2], atol=1e-12)
    np.testing.assert_allclose(
        found.world_R_body[0] @ [1.0, 0.0, 0.0], [np.cos(0.5), np.sin(0.5), 0.0], atol=1e-12
    )


def test_a_pose_does_not_depend_on_its_company():
    """A pose computed alone has the same bits as among others."""
    motion, t_ns = recorded(wandering()), instants(np.linspace(0.0, 4.9, 10_003))
    among, alone = motion.poses_at(t_ns), motion.poses_at(t_ns[7777:7778])
    assert (among.world_R_body[7777] == alone.world_R_body[0]).all()
    assert (among.world_p_body_m[7777] == alone.world_p_body_m[0]).all()


@pytest.mark.parametrize(
    ("t_s", "angle_rad", "message"),
    [
        ([0.0, 0.5, 1.6], [0, 0, 0], "poses.txt, line 3: found a gap of 1.1 s; expected at most 1 s"),
        ([0.0, 0.5, 1.0], [0, 0, np.pi], ("poses.txt, line 3: turns by 180.0 degrees from the pose before; "
         "expected at most 90 degrees, beyond which its sense is in doubt")),
        ([0.0, 0.9, 0.901, 1.8], [0, 0, 1.5, 1.5], ("poses.txt, line 2: no smooth turn leads here from "
                                                    "the pose before: "
         "times are too uneven; expected poses at more even times")),
    ],
)  # fmt: skip
def test_what_cannot_be_interpolated_is_refused(t_s, angle_rad, message):
    """Gaps, half turns and turns in no time are named with file and line."""
    with pytest.raises(TrajectoryError) as caught:
        recorded(poses(t_s, np.zeros((len(t_s), 3)), about_z(np.array(angle_rad))))
    assert str(caught.value) == message


@given(st.lists(st.floats(-np.pi / 2, np.pi / 2), min_size=1, max_size=12), st.integers(0, 2**32))
@settings(max_examples=60, deadline=None)
def test_steps_of_up_to_90_degrees_are_finite_at_even_times(steps, seed):
    """At even times any turns up to 90 degrees from pose to pose, about any axes, give rotations and
    finite rates."""
    rng = np.random.default_rng(seed)
    quaternions = [np.array([0.0, 0.0, 0.0, 1.0])]
    for step in steps:
        axis = rng.normal(size=3)
        x, y, z = np.sin(step / 2) * axis / np.linalg.norm(axis)
        w = np.cos(step / 2)
        times = np.array([[w, z, -y, x], [-z, w, x, y], [y, -x, w, z], [-x, -y, -z, w]])
        quaternions.append(times @ quaternions[-1])
    n = len(quaternions)
    some = poses(np.arange(n) * 0.1, np.zeros((n, 3)), quaternions)
    try:
        motion = recorded(some)
    except TrajectoryError as error:
        assert "no smooth turn" in str(error)  # noqa: PT017  # allowed, and no other refusal is
        return
    k = motion.kinematics_at(instants(np.linspace(0.0, motion.run_time_s, 301)))
    np.testing.assert_allclose(np.linalg.det(k.world_R_body), 1.0, atol=1e-12)
    assert np.isfinite(k.body_alpha_rad_s2).all()


TUM = """# timestamp tx ty tz qx qy qz qw
1403636579.763555527 1 2 3 0 0 0 1

1403636579.813555527 1.5 2 3 0 0 0.7071068 0.7071068
"""
CSV = """qw,t_s,x_m,y_m,z_m,qx,qy,qz
1,10,1,2,3,0,0,0
0.8,10.05,1.5,2,3,0,0,0.6
"""
KITTI = "1 0 0 1 0 1 0 2 0 0 1 3\n0 -1 0 4 1 0 0 5 0 0 1 6\n"


def written(folder, text, name="poses"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_tum_and_csv_are_read_to_the_nanosecond(tmp_path):
    """Stamps keep all their digits, comments and empty lines are left out, quaternions get unit length;
    columns of a CSV come in any order."""
    poses = read_tum(written(tmp_path, TUM))
    np.testing.assert_array_equal(poses.t_ns, [1403636579763555527, 1403636579813555527])
    np.testing.assert_array_equal(poses.position_m, [[1, 2, 3], [1.5, 2, 3]])
    np.testing.assert_allclose(poses.quaternion[1], [0, 0, 0.5**0.5, 0.5**0.5], atol=1e-15)
    assert [where.rpartition(" ")[2] for where in poses.where] == ["2", "4"]
    poses = read_trajectory_csv(written(tmp_path, CSV))
    np.testing.assert_array_equal(poses.t_ns, [10_000_000_000, 10_050_000_000])
    np.testing.assert_allclose(poses.quaternion, [[0, 0, 0, 1], [0, 0, 0.6, 0.8]])


def test_kitti_is_read_with_a_rate_or_with_times(tmp_path):
    """The twelve numbers are the rows of rotation and position; times come from a rate or a file."""
    path = written(tmp_path, KITTI)
    poses = read_kitti(path, 30.0)
    np.testing.assert_array_equal(poses.t_ns, [0, 33_333_333])
    np.testing.assert_array_equal(poses.position_m, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_allclose(poses.quaternion[1], [0, 0, 0.5**0.5, 0.5**0.5], atol=1e-15)
    times = read_kitti(path, written(tmp_path, "0.5\n6.036e-1\n", "times"))
    np.testing.assert_array_equal(times.t_ns, [500_000_000, 603_600_000])


LINE = "0.1 1 2 3 0 0 0 1\n"
BAD_TUM = [
    ("\n", "found 0 poses; expected at least 2"),
    (LINE, "found 1 poses; expected at least 2"),
    (LINE + "0.2 1 2 3 0 0 1\n", ", line 2: found 7 cells; expected 8: t x y z qx qy qz qw"),
    (LINE + "0.2 1 2 nan 0 0 0 1\n", ", line 2, column z_m: found nan; expected a number"),
    (LINE + "nan 1 2 3 0 0 0 1\n", ", line 2, column t_s: found nan; expected at most 4611686018 s"),
    (LINE + LINE, ", line 2: the time of the pose before; expected times that grow"),
    (
        LINE + "\n0.05 1 2 3 0 0 0 1\n",
        ", line 3: a time 0.05 s before the pose before; expected times that grow",
    ),
    (LINE + "0.2 1 2 3 0 0 0 1.002\n", ", line 2: a quaternion of length 1.002; expected length 1, to 0.001"),
    (LINE + "0.2 1 2 3 0 0 0 0\n", ", line 2: a quaternion of length 0; expected length 1, to 0.001"),
]


@pytest.mark.parametrize(("text", "line"), BAD_TUM, ids=[row[1][:40] for row in BAD_TUM])
def test_a_bad_line_is_reported_with_its_number(tmp_path, text, line):
    """File, line, what was found and what was expected."""
    path = written(tmp_path, text)
    with pytest.raises(TrajectoryError) as caught:
        read_tum(path)
    assert str(caught.value).removeprefix(str(path)).removeprefix(": ") == line


def test_a_matrix_that_is_no_rotation_is_refused(tmp_path):
    """A reflection is named with its determinant, and times must be as many as poses."""
    path = written(tmp_path, KITTI.replace("0 0 1 6", "0 0 -1 6"))
    with pytest.raises(TrajectoryError, match="line 2: a matrix with determinant -1, 0 off orthonormal"):
        read_kitti(path, 10.0)
    with pytest.raises(TrajectoryError, match="times: found 1 times; expected 2, one for each pose"):
        read_kitti(written(tmp_path, KITTI), written(tmp_path, "1.0\n", "times"))
