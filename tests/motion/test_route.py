"""A path with its timing."""

import time

import numpy as np
import pytest

from vlp16emu.errors import TrajectoryError
from vlp16emu.motion import Stop, Walk
from vlp16emu.motion.path import Path
from vlp16emu.motion.route import Route

WAY_POINTS_M = np.array([[0.0, 0.0], [18.0, 4.0], [34.0, -3.0], [36.0, 2.0], [20.0, 14.0]])
LOOP_M = np.array([[0.0, 0.0], [12.0, 0.0], [12.0, 9.0], [0.0, 9.0], [0.0, 0.0]])


def hilly(x_m, y_m):
    return np.sin(0.3 * x_m) + 0.5 * np.cos(0.2 * y_m)


def route(way_points_m=WAY_POINTS_M, pause_s=None, **own):
    path, turn = Path(way_points_m, hilly), {"yaw_rate_deg_s": np.degrees(1.0)}
    walk = Walk(kind="walk", way_points_m=way_points_m.tolist(), **turn, **own)
    return Route(path, walk, np.zeros(len(way_points_m)) if pause_s is None else pause_s)


@pytest.fixture(scope="module")
def track():
    """Milliseconds of a walk with a stop."""
    made = route(stops=[Stop(at_m=10.0, pause_s=2.0)])
    return made.at(np.arange(0.0, made.run_time_s, 1e-3))


def test_speed_along_the_spline_is_that_of_the_profile(track):
    """The length of the velocity is the speed of the profile, to 0.1 %."""
    nodes, speed_m_s = track
    np.testing.assert_allclose(np.linalg.norm(nodes[:, :3, 1], axis=1), speed_m_s, rtol=1e-3, atol=1e-12)


def test_derivatives_belong_to_the_same_function(track):
    """Each derivative of place and heading is the difference of what it derives over a millisecond."""
    nodes, _ = track
    for order, tolerance in ((0, 1e-5), (1, 1e-4)):
        slope = (nodes[2:, :, order] - nodes[:-2, :, order]) / 2e-3
        np.testing.assert_allclose(slope, nodes[1:-1, :, order + 1], atol=tolerance)


def test_a_person_looks_where_the_walk_goes(track):
    """The heading is the direction of the velocity on the map."""
    nodes, speed_m_s = track
    moving = nodes[speed_m_s > 0.01]
    east, north, _ = moving[:, :3, 1].T
    turn = moving[:, 5, 0] - np.arctan2(north, east)
    np.testing.assert_allclose((turn + np.pi) % (2 * np.pi), np.pi, atol=1e-9)


def test_laps_go_round_without_a_halt():
    """Three laps of a loop end where they began, three turns later, at full speed between the laps."""
    made = route(LOOP_M, laps=3)
    (start, end), _ = made.at(np.array([0.0, made.run_time_s]))
    np.testing.assert_allclose(end[:3, 0], start[:3, 0], atol=1e-9)
    assert end[5, 0] - start[5, 0] == pytest.approx(6 * np.pi, abs=1e-9)
    _, speed_m_s = made.at(np.arange(5.0, made.run_time_s - 5.0, 0.01))
    assert speed_m_s.min() > 0.5


def test_stops_come_on_each_lap():
    """A stop at the first and last waypoint of a loop of two laps is made at start, between, and at the end."""
    made = route(LOOP_M, np.array([1.0, 0.0, 2.0, 0.0, 1.0]), laps=2)
    rest = made.at(np.arange(0.0, made.run_time_s, 1e-3))[1] < 1e-12
    starts = np.flatnonzero(np.diff(rest.astype(int)) == 1)
    assert len(starts) == 4  # twice at the third waypoint, once between the laps, once at the end


def test_an_open_path_has_one_lap():
    """Laps of a path that does not close are refused."""
    with pytest.raises(TrajectoryError, match="laps: found 2 on an open path; expected 1, back_and_forth = true, or"):
        route(laps=2)


def test_a_path_of_two_kilometres_is_made_at_once():
    """Path and profile of 2 km take less than 0.3 s of processor time, in the best of three."""
    points_m = np.column_stack([np.arange(160.0) * 10.0, 10 * np.sin(np.arange(160.0))])
    took_s = []
    for _ in range(3):
        begin = time.thread_time()
        made = route(points_m, run_time_s=2500.0)
        took_s.append(time.thread_time() - begin)
    assert made.length_m > 1950.0
    assert min(took_s) < 0.3


def test_a_person_stands_before_the_first_step():
    """For `stand_s` nothing moves; from then on it is the walk that it is without, also where its time is given."""
    for pace in ({}, {"run_time_s": 90.0}):
        plain, standing = route(**pace), route(stand_s=7.5, **pace)
        assert standing.run_time_s == plain.run_time_s + 7.5
        t_s = np.arange(0.0, plain.run_time_s, 0.125)  # whole steps of 7.5 s, so that no bit is lost
        (walked, _), (later, _) = plain.at(t_s), standing.at(t_s + 7.5)
        before, speed_m_s = standing.at(t_s[t_s <= 7.5])
        assert (walked == later).all()
        assert not speed_m_s.any()
        assert (before[:, :3, 0] == walked[0, :3, 0]).all()
