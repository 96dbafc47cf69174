"""Waypoints with their stops, patterns over a plot, and an open path that is walked there and back."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from vlp16emu.errors import TrajectoryError
from vlp16emu.extras.walk.path import Path
from vlp16emu.extras.walk.route import Route
from vlp16emu.extras.walk.settings import LawnMower, Stop, Walk
from vlp16emu.extras.walk.way_points import lawn_mower, way_points
from vlp16emu.motion.settings import Gps


def test_pauses_are_added_by_number(tmp_path):
    """A pause at waypoint 2 adds to what the file says, and a number beyond the last is refused."""
    file = tmp_path / "way.csv"
    file.write_text("x_m,y_m,stop_s\n0,0,0\n9,0,1\n")

    def stopping(number):
        stops = [Stop(way_point=number, pause_s=3.0)]
        return way_points(Walk(kind="walk", way_points_file=str(file), stops=stops), Gps(), (0.0, 0.0))

    np.testing.assert_array_equal(stopping(2).pause_s, [0.0, 4.0])
    with pytest.raises(TrajectoryError, match="stop: found waypoint 3; expected from 1 to 2"):
        stopping(3)


PLOT = {
    "corner_m": (5.0, -6.0),
    "length_m": 30.0,
    "width_m": 27.0,
    "azimuth_deg": 30.0,
    "line_spacing_m": 5.0,
    "turn_radius_m": 1.0,
}


def in_plot(point_m):
    c, s = np.cos(np.radians(30.0)), np.sin(np.radians(30.0))
    x, y = (point_m[:, :2] - PLOT["corner_m"]).T
    return c * x + s * y, c * y - s * x


def test_lines_cover_the_plot_and_stay_in_it():
    """Six lines, 5 m apart and in the middle of 27 m, each walked over nearly its length, within 2 mm of the
    plot.

    Quarter circles cut ten corners off six lines and five links; nowhere does the path turn tighter than 0.8
    times the radius.
    """
    mown = Path(lawn_mower(LawnMower(**PLOT)), lambda x, _y: 0.0 * x)
    point_m, heading_rad = mown.derivatives_at(np.linspace(0.0, mown.length_m, 40_001))
    assert mown.length_m == pytest.approx(6 * 30 + 5 * 5 - 10 * (2 - np.pi / 2), rel=1e-4)
    assert np.abs(heading_rad[:, 1]).max() < 1.25
    along, across = in_plot(point_m[:, 0])
    assert -0.002 < along.min() < along.max() < 30.002
    assert across.min() == pytest.approx(1.0, abs=0.002)
    assert across.max() == pytest.approx(26.0, abs=0.002)
    for line in range(6):
        on_it = np.abs(across - (1.0 + 5.0 * line)) < 0.002
        assert np.ptp(along[on_it]) > 27.9


def test_one_line_is_a_line():
    """A plot narrower than the spacing has one line, in its middle; three spacings wide it has four,
    though 3.3 / 1.1 < 3 in float64."""
    points_m = lawn_mower(LawnMower(**PLOT | {"width_m": 3.0, "azimuth_deg": 0.0}))
    np.testing.assert_allclose(points_m[:, 1], -4.5)
    wide = {"width_m": 3.3, "line_spacing_m": 1.1, "turn_radius_m": 0.5, "azimuth_deg": 0.0}
    x_m, y_m = lawn_mower(LawnMower(**PLOT | wide)).T
    assert len(np.unique(y_m[np.abs(x_m - 20.0) < 5.0].round(6))) == 4


def test_turns_that_do_not_fit_are_refused():
    """The radius is at most half the spacing."""
    with pytest.raises(TrajectoryError, match="above 0 and at most half of 5 m, line spacing or length"):
        lawn_mower(LawnMower(**PLOT | {"turn_radius_m": 2.501}))


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
    """Waypoints are passed in their order, in reverse, and again, each within 1 cm; the ends once, before
    the loop and after it."""
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
    assert len(back) > 1000
    assert KDTree(xy_m[~turned]).query(back)[0].max() < 0.5


def test_the_person_turns_round_without_a_halt(track):
    """Limits of speed, acceleration and turn rate hold, also behind the ends; between first and last step
    nobody stands still."""
    nodes, speed_m_s = track
    assert np.degrees(np.abs(nodes[:, 5, 1])).max() < 60.0 * 1.001
    assert speed_m_s.max() <= 1.2 + 1e-9
    assert np.abs(np.diff(speed_m_s)).max() / 1e-2 < 1.0 + 1e-6
    assert speed_m_s[300:-300].min() > 0.3


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
    with pytest.raises(
        TrajectoryError, match=r"back_and_forth: found .* from the first; expected at least 2"
    ):
        route(walk(way_points_m))
