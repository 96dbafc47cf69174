"""Recorded poses in files."""

import numpy as np
import pytest

from vlp16emu.errors import TrajectoryError
from vlp16emu.extras.recorded.files import read_kitti, read_trajectory_csv, read_tum

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


def test_tum_is_read_to_the_nanosecond(tmp_path):
    """Stamps keep all their digits, comments and empty lines are left out, quaternions get unit length."""
    poses = read_tum(written(tmp_path, TUM))
    np.testing.assert_array_equal(poses.t_ns, [1403636579763555527, 1403636579813555527])
    np.testing.assert_array_equal(poses.position_m, [[1, 2, 3], [1.5, 2, 3]])
    np.testing.assert_allclose(poses.quaternion[1], [0, 0, 0.5**0.5, 0.5**0.5], atol=1e-15)
    assert [where.rpartition(" ")[2] for where in poses.where] == ["2", "4"]


def test_csv_is_read_by_its_header(tmp_path):
    """Columns may stand in any order."""
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
    times = read_kitti(path, written(tmp_path, "0.5\n1.036e-1\n".replace("1.036e-1", "6.036e-1"), "times"))
    np.testing.assert_array_equal(times.t_ns, [500_000_000, 603_600_000])


LINE = "0.1 1 2 3 0 0 0 1\n"
BAD_TUM = [
    ("", "found 0 poses; expected at least 2"),
    (LINE, "found 1 poses; expected at least 2"),
    (LINE + "0.2 1 2 3 0 0 1\n", ", line 2: found 7 cells; expected 8: t x y z qx qy qz qw"),
    (LINE + "0.2 1 2 nan 0 0 0 1\n", ", line 2, column z_m: found nan; expected a number"),
    (LINE + "nan 1 2 3 0 0 0 1\n", ", line 2, column t_s: found nan; expected at most 4611686018 s"),
    (LINE + LINE, ", line 2: the time of the pose before; expected times that grow"),
    (
        LINE + "\n0.05 1 2 3 0 0 0 1\n",
        ", line 3: a time 0.05 s before that of the pose before; expected times that grow",
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
