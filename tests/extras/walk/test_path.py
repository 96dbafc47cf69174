"""The path as a curve over the ground."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vlp16emu.errors import TrajectoryError
from vlp16emu.extras.walk.path import Path, path_over
from vlp16emu.store import user_store

WAY_POINTS_M = np.array([[0.0, 0.0], [18.0, 4.0], [34.0, -3.0], [52.0, 2.0], [66.0, 14.0]])


def flat(x_m, _y_m):
    return np.zeros_like(x_m)


def hilly(x_m, y_m):
    return np.sin(0.3 * x_m) + 0.5 * np.cos(0.2 * y_m)


def points_m(path, s_m):
    return path.derivatives_at(s_m)[0][:, 0]


def test_path_passes_its_way_points():
    """The curve comes within 1 mm of every waypoint, in order."""
    path = Path(WAY_POINTS_M, flat)
    point_m = points_m(path, np.linspace(0, path.length_m, 200_001))
    gaps = np.linalg.norm(point_m[None, :, :2] - WAY_POINTS_M[:, None], axis=2)
    assert gaps.min(axis=1).max() < 1e-3
    assert (np.diff(gaps.argmin(axis=1)) > 0).all()


def test_path_follows_the_ground():
    """Waves of 20 m carry the path with them, to 1 % of their height."""
    path = Path(WAY_POINTS_M, hilly)
    point_m = points_m(path, np.linspace(0, path.length_m, 5000))
    np.testing.assert_allclose(point_m[:, 2], hilly(point_m[:, 0], point_m[:, 1]), atol=0.01)


def test_path_is_level_where_the_ground_is_rough():
    """A roughness of 0.4 m wavelength, shorter than a pace, leaves less than a tenth of its height."""
    path = Path(np.array([[0.0, 0.0], [30.0, 0.0]]), lambda x, _y: 0.1 * np.sin(2 * np.pi * x / 0.4))
    point_m = points_m(path, np.linspace(2.0, 28.0, 5000))
    assert np.abs(point_m[:, 2]).max() < 0.01


def test_an_even_slope_stays_as_it_is():
    """On a plane the path lies in the plane to its very ends, and its length is that of the slope."""
    path = Path(np.array([[0.0, 0.0], [40.0, 30.0]]), lambda x, _y: 0.2 * x)
    point_m = points_m(path, np.linspace(0.0, path.length_m, 1000))
    np.testing.assert_allclose(point_m[:, 2], 0.2 * point_m[:, 0], atol=1e-9)
    assert path.length_m == pytest.approx(np.hypot(50.0, 0.2 * 40.0), abs=1e-9)


def differences(values, step):
    return (values[2:] - values[:-2]) / (2 * step)


@pytest.mark.parametrize("origin_m", [[0.0, 0.0], [1e5, -1e5]])
def test_derivatives_are_those_of_the_same_curve(origin_m):
    """Points and headings differenced over a millimetre give the derivatives, also 100 km from the origin."""
    path, step_m = Path(WAY_POINTS_M + origin_m, hilly), 1e-3
    point_m, heading_rad = path.derivatives_at(np.arange(0.0, path.length_m, step_m))
    for values in (point_m, heading_rad):
        for order in (0, 1):
            np.testing.assert_allclose(
                values[1:-1, order + 1], differences(values[:, order], step_m), atol=2e-7 if order else 1e-7
            )


def test_a_loop_closes_without_a_seam():
    """Where the last waypoint is the first, point, heading and derivatives go on over the seam, lap after
    lap."""
    path = Path(np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 10.0], [0.0, 10.0], [0.0, 0.0]]), hilly)
    assert path.closed
    before, after = (path.derivatives_at(path.length_m * np.arange(1, 4) + h) for h in (-1e-9, 1e-9))
    for a, b in zip(before, after, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-7)
    s_m = np.linspace(0.1, path.length_m - 0.1, 100)
    once, twice = path.derivatives_at(s_m), path.derivatives_at(s_m + path.length_m)
    np.testing.assert_allclose(twice[0], once[0], atol=1e-9)
    np.testing.assert_allclose(twice[1][:, 0], once[1][:, 0] + 2 * np.pi, atol=1e-9)


@given(st.lists(st.tuples(st.floats(-50, 50), st.floats(-50, 50)), min_size=1, max_size=8))
@settings(max_examples=30, deadline=None, derandomize=True)
def test_any_way_points_give_a_smooth_path_or_a_refusal(points):
    """Whatever the waypoints, the curve is finite and turns no tighter than about 0.1 m, or it is refused."""
    try:
        path = Path(np.array(points), hilly)
    except TrajectoryError:
        return
    point_m, heading_rad = path.derivatives_at(np.linspace(0.0, path.length_m, 4001))
    assert np.isfinite(point_m).all()
    assert np.isfinite(heading_rad).all()
    assert np.abs(np.linalg.norm(point_m[:, 1], axis=1) - 1.0).max() < 1e-3
    assert np.abs(heading_rad[:, 1]).max() < 2.5 / 0.1


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([[5, 0], [15, 0]], ("path at (10.37, 0.00) m: the ground rises or falls by 85 degrees; expected "
                            "at most 60 degrees")),
        ([[0, 0], [np.nan, 1]], "waypoint 2 of 2: found (nan, 1.0); expected finite coordinates"),
        ([[0, 0], [3, 1], [3, 1.001]], ("waypoint 3 of 3: coincides with the one before it; expected at "
                                       "least 1 cm between waypoints")),
        ([[3, 4]], "waypoints: found 1; expected at least 2 of them"),
        ([[0, 0], [2e6, 0]], ("waypoint 2 of 2: found (2000000.0, 0.0); expected within 1e+06 m of the "
                             "origin")),
        ([[0, 0], [9e4, 0], [0, 9e4]], ("waypoints: found 217.3 km from first to last; expected at most "
                                       "100 km")),
        ([[0, 0], [10, 0], [0, 0]], ("path at (10.00, 0.00) m, near waypoint 2: turns with a radius of "
                                    "0.00024 m; expected at least 0.1 m: more waypoints round the turn")),
    ],
)  # fmt: skip
def test_impossible_paths_are_refused(points, message):
    """A waypoint that cannot be passed is named; and the place of a step of 10 m in the ground, which
    nobody walks up."""
    with pytest.raises(TrajectoryError) as error:
        Path(np.array(points, float), lambda x, _y: np.where((x > 10.2) & (x < 16), 10.0, 0.0))
    assert str(error.value) == message


def test_a_path_from_the_store_is_the_same(tmp_path, monkeypatch):
    """A path is laid once for each ground and waypoints: then it is read, bit by bit the same."""
    monkeypatch.setenv("VLP16EMU_CACHE_DIR", str(tmp_path / "world"))
    user_store.cache_clear()
    try:
        laid = path_over(WAY_POINTS_M, hilly, "hills")
        user_store().flush()
        read = path_over(WAY_POINTS_M, touched, "hills")
        for wrong in ((WAY_POINTS_M[::-1].copy(), "hills"), (WAY_POINTS_M, "moon"), (WAY_POINTS_M, "")):
            with pytest.raises(AssertionError, match="asked"):
                path_over(wrong[0], touched, wrong[1])
    finally:
        user_store.cache_clear()
    at_m = np.linspace(-1.0, laid.length_m + 1.0, 500)
    for one, other in zip(laid.derivatives_at(at_m), read.derivatives_at(at_m), strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(laid.xy_m, read.xy_m)
    np.testing.assert_array_equal(laid.way_points_at_m, read.way_points_at_m)
    assert (laid.length_m, laid.closed) == (read.length_m, read.closed)


def touched(_x_m, _y_m):
    """Ground that must not be asked for its height."""
    raise AssertionError("asked")
