"""The path as a curve over the ground."""

import numpy as np
import pytest

from vlp16emu.errors import TrajectoryError
from vlp16emu.motion import Path

WAY_POINTS_M = np.array([[0.0, 0.0], [18.0, 4.0], [34.0, -3.0], [52.0, 2.0], [66.0, 14.0]])


def flat(x_m, _y_m):
    return np.zeros_like(x_m)


def hilly(x_m, y_m):
    return np.sin(0.3 * x_m) + 0.5 * np.cos(0.2 * y_m)


def test_path_passes_its_way_points():
    """The curve comes within 1 mm of every way point, in order."""
    path = Path(WAY_POINTS_M, flat)
    point_m, _ = path.at(np.linspace(0, path.length_m, 200_001))
    gaps = np.linalg.norm(point_m[None, :, :2] - WAY_POINTS_M[:, None], axis=2)
    assert gaps.min(axis=1).max() < 1e-3
    assert (np.diff(gaps.argmin(axis=1)) > 0).all()


def test_arc_length_is_the_parameter():
    """A metre of parameter is a metre of way over flat ground, to 0.1 %."""
    path = Path(WAY_POINTS_M, flat)
    point_m, _ = path.at(np.arange(0.0, path.length_m, 0.01))
    np.testing.assert_allclose(np.linalg.norm(np.diff(point_m, axis=0), axis=1), 0.01, rtol=1e-3)


def test_straight_path_has_the_length_of_the_line():
    """Two way points give the straight line between them."""
    path = Path(np.array([[1.0, 2.0], [4.0, 6.0]]), flat)
    assert path.length_m == pytest.approx(5.0, abs=1e-9)
    point_m, heading = path.at(np.array([2.5]))
    np.testing.assert_allclose(point_m[0], [2.5, 4.0, 0.0], atol=1e-9)
    assert heading[0] == pytest.approx(np.arctan2(4, 3))


def test_path_follows_the_ground():
    """Between its knots the path stays within 1 mm of a ground with waves of 20 m."""
    path = Path(WAY_POINTS_M, hilly)
    point_m, _ = path.at(np.linspace(0, path.length_m, 5000))
    np.testing.assert_allclose(point_m[:, 2], hilly(point_m[:, 0], point_m[:, 1]), atol=1e-3)


def test_velocity_and_curvature_are_continuous():
    """The curve is C2: across every knot the second difference has no step."""
    path = Path(WAY_POINTS_M, hilly)
    h = 1e-3
    point_m, _ = path.at(np.arange(0.5, path.length_m - 0.5, h))
    second = np.diff(point_m, 2, axis=0) / h**2
    assert np.abs(np.diff(second, axis=0)).max() < 0.02


def test_heading_is_that_of_the_tangent():
    """The heading looks where the next millimetre leads."""
    path = Path(WAY_POINTS_M, flat)
    s_m = np.linspace(0.1, path.length_m - 0.1, 300)
    ahead, back = path.at(s_m + 5e-4)[0], path.at(s_m - 5e-4)[0]
    expected = np.arctan2(*(ahead - back)[:, 1::-1].T)
    np.testing.assert_allclose(path.at(s_m)[1], expected, atol=1e-5)


def test_beyond_its_ends_the_path_stays():
    """Before 0 and after its length the path is at its ends."""
    path = Path(WAY_POINTS_M, flat)
    point_m, _ = path.at(np.array([-5.0, 0.0, path.length_m, path.length_m + 5.0]))
    np.testing.assert_array_equal(point_m[0], point_m[1])
    np.testing.assert_array_equal(point_m[2], point_m[3])


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([[0, 0], [np.nan, 1]], "way point 2 of 2: found (nan, 1.0); expected finite coordinates"),
        (
            [[0, 0], [3, 1], [3, 1.001]],
            "way point 3 of 3: coincides with the one before it; expected at least 1 cm between way points",
        ),
    ],
)
def test_impossible_paths_are_refused(points, message):
    """A way point that cannot be passed is named."""
    with pytest.raises(TrajectoryError) as error:
        Path(np.array(points, float), flat)
    assert str(error.value) == message
