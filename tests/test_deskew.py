"""Points of a hall scanned on the move, decoded from packets and put into the world with the true poses."""

import numpy as np
import pytest

pytestmark = pytest.mark.usefixtures("kept_woods")

PACKET_S = 1.327104e-3


@pytest.fixture(scope="module")
def deskew(tool_named):
    """The tool that prints the table of these figures."""
    return tool_named("deskew")


@pytest.fixture(scope="module")
def walking(deskew):
    """Two seconds of walking."""
    return deskew.scan(turning=False)


@pytest.fixture(scope="module")
def turning(deskew):
    """Two seconds of turning at 300 deg/s."""
    return deskew.scan(turning=True)


@pytest.fixture(params=["walking", "turning"])
def placed(request):
    """Either run."""
    return request.getfixturevalue(request.param)


def rmse_mm(placed, placing):
    return 1000 * np.sqrt((placed.error_m[placing][placed.upright] ** 2).mean())


def test_true_poses_put_every_point_on_its_surface(placed):
    """With the pose of its pulse each point lies on its surface as closely as the wire's steps allow: half of 2 mm and 0.011 deg.

    Flat errors of half a step have an RMSE of 0.58 mm on a wall met head-on: nothing else is left.
    """
    assert len(placed.bound_m) > 500_000
    of_bound = placed.error_m["pulse"] / placed.bound_m
    assert 0.85 < of_bound.max() <= 1.0  # reached, or it would prove nothing
    assert placed.bound_m.max() < 2e-3
    assert 0.5 < rmse_mm(placed, "pulse") < 0.65


def test_one_pose_per_packet_or_sweep_leaves_the_surfaces(placed):
    """Later poses than once per pulse put points off by more than the wire's steps can explain, sweeps by decimetres."""
    assert (placed.error_m["packet"] > placed.bound_m).mean() > 0.01
    assert rmse_mm(placed, "packet") > 2 * rmse_mm(placed, "pulse")
    assert np.quantile(placed.error_m["sweep"][placed.upright], 0.95) > 0.1


def test_the_error_of_a_turn_is_the_angle_turned_times_the_distance(deskew, turning):
    """With one pose per packet it is at most 0.40 deg times the 7.25 m to the farthest corner."""
    largest_m = turning.error_m["packet"][turning.upright].max()
    arc_m = np.radians(deskew.TURN_DEG_S * PACKET_S) * 7.25
    assert arc_m / 2 < largest_m < arc_m
