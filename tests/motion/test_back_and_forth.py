"""An open path, walked there and back."""

import numpy as np
import pytest

from vlp16emu.errors import TrajectoryError
from vlp16emu.motion import Gps, Stop, Walk
from vlp16emu.motion.path import Path
from vlp16emu.motion.route import Route
from vlp16emu.motion.walk import WalkMotion
from vlp16emu.motion.way_points import way_points

BIRCH_M = [[0, 0], [18, 4], [34, -3], [52, 2], [66, 14], [80, 18]]
LAPS = 3


def hilly(x_m, y_m):
    return np.sin(0.1 * x_m) + 0.5 * np.cos(0.2 * y_m)


def walk(way_points_m=BIRCH_M, **own):
    return Walk(kind="walk", way_points_m=way_points_m, back_and_forth=True, **own)


def route(section):
    points = way_points(section, Gps(), (0.0, 0.0))
    return Route(Path(points.xy_m, hilly), section, points.pause_s)


@pytest.fixture(scope="module")
def track():
    """Hundredths of a second of three laps."""
    made = route(walk(laps=LAPS))
    return made.at(np.arange(0.0, made.run_time_s, 1e-2))


def test_each_lap_passes_all_way_points_there_and_back(track):
    """Waypoints are passed in their order, in reverse, and again, each within 1 cm; the ends once, before the loop and after it."""
    gap_m = np.linalg.norm(track[0][None, :, :2, 0] - np.array(BIRCH_M, float)[:, None], axis=2)
    nearest, near = gap_m.argmin(axis=0), gap_m.min(axis=0) < 0.01
    passed = nearest[near][np.diff(nearest[near], prepend=-1) != 0].tolist()
    assert passed == LAPS * [0, 1, 2, 3, 4, 5, 4, 3, 2, 1] + [0]


def test_the_way_back_is_the_way_there(track):
    """Off the loops behind its ends, of 1.4 m, the path back is within half a metre of the path there."""
    nodes = track[0][::10]
    xy_m = nodes[:, :2, 0]
    turned = np.abs(np.angle(np.exp(1j * (nodes[:, 5, 0] - np.arctan2(4, 18))))) > np.pi / 2
    back = xy_m[turned & (xy_m[:, 0] > 2) & (xy_m[:, 0] < 78)]
    apart_m = np.linalg.norm(back[:, None] - xy_m[None, ~turned], axis=2).min(axis=1)
    assert len(back) > 1000
    assert apart_m.max() < 0.5


def test_the_person_turns_round_without_a_halt(track):
    """Limits of speed, acceleration and turn rate hold, also behind the ends; between first and last step nobody stands still."""
    nodes, speed_m_s = track
    assert np.degrees(np.abs(nodes[:, 5, 1])).max() < 60.0 * 1.001
    assert speed_m_s.max() <= 1.2 + 1e-9
    assert np.abs(np.diff(speed_m_s)).max() / 1e-2 < 1.0 + 1e-6
    assert speed_m_s[300:-300].min() > 0.3


def test_pose_and_velocity_are_continuous_at_the_ends():
    """A sensor that is carried by a gait has velocities and turn rates that are the differences of its poses over a millisecond."""
    section = walk(laps=2)
    made = route(section)
    motion, turn_s = WalkMotion(section, made, start_ns=0, seed=1), made.run_time_s / 2
    t_ns = np.arange((turn_s - 8.0) * 1000, (turn_s + 8.0) * 1000).astype(np.int64) * 1_000_000
    truth = motion.kinematics_at(t_ns)
    moved_m_s = (truth.world_p_body_m[2:] - truth.world_p_body_m[:-2]) / 2e-3
    np.testing.assert_allclose(moved_m_s, truth.world_v_body_m_s[1:-1], atol=2e-4)
    assert np.abs(np.diff(truth.world_v_body_m_s, axis=0)).max() < 0.05  # 50 m/s2 over a millisecond, of heel strikes
    assert np.abs(np.diff(truth.body_w_rad_s, axis=0)).max() < 0.05


def test_stops_are_made_there_and_back():
    """A stop at an inner waypoint is made twice in a lap, one at an end once; the run is longer by that."""
    moving_s = route(walk()).run_time_s
    for number, times in ((3, 2), (6, 1)):
        stopped = route(walk(stops=[Stop(way_point=number, pause_s=30.0)]))
        _, speed_m_s = stopped.at(np.arange(0.0, stopped.run_time_s, 0.1))
        still = np.diff((speed_m_s[30:-30] < 1e-9).astype(int))
        assert (still == 1).sum() == times
        assert stopped.run_time_s > moving_s + 30.0 * times


@pytest.mark.parametrize("way_points_m", [[[0, 0], [9, 0], [9, 9], [0, 0]], [[0, 0], [3, 0]]])
def test_a_closed_path_and_one_that_is_too_short_are_refused(way_points_m):
    """Where the ends are nearer to each other than the loops behind them are long, the line names the key."""
    with pytest.raises(TrajectoryError, match=r"back_and_forth: found .* from the first; expected at least 2"):
        route(walk(way_points_m))
