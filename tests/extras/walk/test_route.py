"""A path with its timing: how fast a person goes along it."""

import numpy as np
import pytest

from vlp16emu.errors import TrajectoryError
from vlp16emu.extras.walk.path import Path
from vlp16emu.extras.walk.route import Route
from vlp16emu.extras.walk.settings import Stop, Walk

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


def test_derivatives_belong_to_the_same_function(track):
    """Each derivative of place and heading is the difference of what it derives over a millisecond."""
    nodes, _ = track
    for order, tolerance in ((0, 1e-5), (1, 1e-4)):
        slope = (nodes[2:, :, order] - nodes[:-2, :, order]) / 2e-3
        np.testing.assert_allclose(slope, nodes[1:-1, :, order + 1], atol=tolerance)


def test_a_person_looks_where_the_walk_goes(track):
    """The heading is the direction of the velocity on the map, whose length is the speed along the path to
    0.1 %."""
    nodes, speed_m_s = track
    np.testing.assert_allclose(np.linalg.norm(nodes[:, :3, 1], axis=1), speed_m_s, rtol=1e-3, atol=1e-12)
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
    """A stop at the first and last waypoint of a loop of two laps is made at start, between, and at the
    end."""
    made = route(LOOP_M, np.array([1.0, 0.0, 2.0, 0.0, 1.0]), laps=2)
    rest = made.at(np.arange(0.0, made.run_time_s, 1e-3))[1] < 1e-12
    starts = np.flatnonzero(np.diff(rest.astype(int)) == 1)
    assert len(starts) == 4  # twice at the third waypoint, once between the laps, once at the end


def test_a_person_stands_before_the_first_step():
    """For `stand_s` nothing moves; from then on it is the walk that it is without, also where its time is
    given."""
    for pace in ({}, {"run_time_s": 90.0}):
        plain, standing = route(**pace), route(stand_s=7.5, **pace)
        assert standing.run_time_s == plain.run_time_s + 7.5
        t_s = np.arange(0.0, plain.run_time_s, 0.125)  # whole steps of 7.5 s, so that no bit is lost
        (walked, _), (later, _) = plain.at(t_s), standing.at(t_s + 7.5)
        before, speed_m_s = standing.at(t_s[t_s <= 7.5])
        assert (walked == later).all()
        assert not speed_m_s.any()
        assert (before[:, :3, 0] == walked[0, :3, 0]).all()


LENGTH_M = 60.0


class Line:
    """A path along x, whose turns are those of a function of arc length."""

    closed, way_points_at_m = False, np.zeros(0)

    def __init__(self, length_m, turn_rad_m):
        self.length_m, self.turn_rad_m = length_m, turn_rad_m

    def derivatives_at(self, s_m):
        point_m = np.zeros((len(s_m), 3, 3))
        point_m[:, 0, 0], point_m[:, 1, 0] = s_m, 1.0
        return point_m, np.zeros((len(s_m), 3))


def straight(s_m):
    return np.zeros_like(s_m)


def one_bend(s_m):
    """A turn of up to 2 rad per metre in the middle."""
    return -2.0 * np.exp(-(((s_m - 30.0) / 2.0) ** 2))


def timed(turn=straight, stops=(), yaw_rate_rad_s=1.0, length_m=LENGTH_M, **own):
    limits = {"acceleration_m_s2": 1.0, "yaw_rate_deg_s": np.degrees(yaw_rate_rad_s)}
    own["stops"] = [Stop(at_m=at_m, pause_s=pause_s) for at_m, pause_s in stops]
    walk = Walk(kind="walk", way_points_m=[(0.0, 0.0), (1.0, 0.0)], **limits, **own)
    return Route(Line(length_m, turn), walk, np.zeros(0))


def along(made, t_s):
    """Arc length, speed and acceleration at times."""
    nodes, speed_m_s = made.at(t_s)
    return nodes[:, 0, 0], speed_m_s, nodes[:, 0, 2]


def sampled(made, step_s=1e-3):
    t_s = np.arange(0.0, made.run_time_s, step_s)
    return t_s, *along(made, t_s)


def test_a_person_cruises_between_start_and_end():
    """The walk begins and ends at rest, covers the length, and holds exactly the cruise speed in between."""
    made = timed()
    along_m, speed_m_s, acceleration_m_s2 = along(
        made, np.array([0.0, 20.0, 30.0, made.run_time_s, 1e6, -1.0])
    )
    np.testing.assert_allclose(along_m[[0, 3, 4, 5]], [0.0, LENGTH_M, LENGTH_M, 0.0], atol=1e-12)
    np.testing.assert_allclose(speed_m_s, [0.0, 1.2, 1.2, 0.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(acceleration_m_s2, 0.0, atol=1e-9)
    assert along_m[2] - along_m[1] == pytest.approx(12.0, abs=1e-9)
    assert made.run_time_s == pytest.approx(LENGTH_M / 1.2 + 1.2 / 1.0 + 0.5, abs=0.01)


@pytest.mark.parametrize("turn", [straight, one_bend])
def test_limits_are_kept(turn):
    """Nowhere does the person go backwards, faster than cruise speed, accelerate or turn more than
    allowed; a bend is taken at the limit, to 5 %."""
    made = timed(turn, [(20.0, 3.0)])
    _, along_m, speed_m_s, acceleration_m_s2 = sampled(made)
    assert (np.diff(along_m) >= -1e-12).all()
    assert speed_m_s.max() <= 1.2 * (1 + 1e-12)
    assert np.abs(acceleration_m_s2).max() <= 1.0 + 1e-9
    most_rad_s = np.abs(turn(along_m) * speed_m_s).max()
    assert 0.95 < most_rad_s <= 1.0 + 1e-3 or turn is straight


def test_the_profile_is_smooth_to_the_fourth_derivative():
    """Halving the step divides third differences of the acceleration by more than five; a kink would halve
    them."""
    _, _, _, acceleration_m_s2 = sampled(timed())
    coarse = np.abs(np.diff(sampled(timed(), 2e-3)[3], 3)).max()
    fine = np.abs(np.diff(acceleration_m_s2, 3)).max()
    assert fine < 0.2 * coarse


@pytest.mark.parametrize("at_m", [0.0, 20.0, LENGTH_M])
def test_a_stop_is_at_its_place_and_lasts_its_time(at_m):
    """At a stop the person stands still for at least the pause, and less than half a second longer."""
    t, along_m, speed_m_s, _ = sampled(timed(stops=[(at_m, 4.0)]))
    rest = speed_m_s < 1e-12
    there = rest & (np.abs(along_m - at_m) < 1e-9)
    assert 4.0 - 2e-3 <= there.sum() * 1e-3 < 4.5
    assert (np.diff(t[there]) < 2e-3).all()


def test_speed_is_adapted_to_a_given_run_time():
    """A given run time is kept to the last bit, with all limits."""
    made = timed(one_bend, [(20.0, 3.0)], run_time_s=100.0)
    assert made.run_time_s == 100.0
    _, along_m, speed_m_s, acceleration_m_s2 = sampled(made)
    assert along_m[-1] == pytest.approx(LENGTH_M, abs=1e-6)
    assert 0.6 < made.speed_m_s < 0.75
    assert speed_m_s.max() <= made.speed_m_s
    assert np.abs(acceleration_m_s2).max() <= 1.0 + 1e-9


@pytest.mark.parametrize("length_m", [1e-6, 0.01, 0.5, 20_000.0])
def test_short_and_long_paths_are_finite(length_m):
    """From a micrometre to 20 km the person arrives."""
    made = timed(length_m=length_m)
    values = np.array(along(made, np.linspace(0.0, made.run_time_s, 1000)))
    assert np.isfinite(values).all()
    assert values[0, -1] == pytest.approx(length_m)


AT_MOST = "expected at most 1209600 s, with its stops"


@pytest.mark.parametrize(
    ("wish", "line"),
    [
        ({"laps": 2}, ("laps: found 2 on an open path; expected 1, back_and_forth = true, or a last "
                      "waypoint on the first")),
        ({"run_time_s": 5.0}, ("run time: found 5 s for 60.0 m; expected at least 16.0 s, with its stops, "
                              "turns and starts")),
        ({"stops": [(60.1, 1.0)]}, ("stop: found 60.1 m along the path; expected from 0 to its length, "
                                   "60.00 m")),
        ({"stops": [(20.0, 1e6), (30.0, 1e6)]}, f"run time: found 2.00005e+06 s; {AT_MOST}"),
        ({"speed_m_s": 1e-5}, f"run time: found 6.004e+06 s; {AT_MOST}"),
        ({"speed_m_s": 1e-300}, f"run time: found inf s; {AT_MOST}"),
        ({"turn": one_bend, "yaw_rate_rad_s": 1e-300}, f"run time: found inf s; {AT_MOST}"),
    ],
)  # fmt: skip
def test_impossible_wishes_are_refused(wish, line):
    """A walk outside the limits is refused with what would do; no memory is taken for one of more than two
    weeks."""
    with pytest.raises(TrajectoryError) as caught:
        timed(**wish)
    assert str(caught.value) == line
