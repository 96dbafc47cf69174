"""Ways around given stems."""

import numpy as np
import pytest

from vlp16emu.errors import TrajectoryError
from vlp16emu.extras.walk.path import Path
from vlp16emu.extras.walk.way_points import WayPoints, lead_around
from vlp16emu.foliage.polyline import distance_m


def way(*xy_m):
    return WayPoints(np.array(xy_m, float), np.zeros(len(xy_m)))


def gaps_m(points, places_m):
    return distance_m(np.asarray(places_m, float), Path(points.xy_m, lambda x, y: 0 * x).xy_m)


def test_the_path_keeps_its_distance_and_its_waypoints():
    """Around scattered stems, one right on the path, the curve has the gaps asked for, and passes the
    user's waypoints in order."""
    points = way([0, 0], [20, 0], [40, 6])
    places = np.array([[5, 0.3], [11, -0.5], [14, 0.0], [30, 3.2], [25, 9.0]])
    wanted = np.array([0.9, 1.0, 1.1, 0.95, 1.0])
    found = lead_around(points, places, wanted)
    assert (gaps_m(found, places) >= wanted).all()
    at = [np.flatnonzero((found.xy_m == xy).all(axis=1)) for xy in points.xy_m]
    assert [len(one) for one in at] == [1, 1, 1]
    assert np.diff(np.concatenate(at)).min() > 0
    assert np.abs(found.xy_m[:, 1] - 0.15 * np.maximum(found.xy_m[:, 0] - 20, 0) * 2).max() < 2.5


def test_a_free_path_stays_as_it_is():
    """A path with nothing too near gets no further waypoint."""
    points = way([0, 0], [10, 1], [20, 0])
    assert lead_around(points, np.array([[10.0, 5.0]]), np.array([1.0])) is points


def test_stops_stay_with_their_waypoints():
    """Waypoints that are added have no stop, and the others keep theirs."""
    points = WayPoints(np.array([[0.0, 0], [10, 0], [20, 0]]), np.array([0.0, 4.0, 0.0]))
    found = lead_around(points, np.array([[5.0, 0.1]]), np.array([0.8]))
    assert found.pause_s.tolist() == [0, 0, 4, 0]
    assert found.xy_m[2].tolist() == [10, 0]


def test_where_there_is_no_way_it_is_named(monkeypatch):
    """A waypoint of the user that is itself too near cannot be led around, however often it is tried."""
    monkeypatch.setattr("vlp16emu.extras.walk.way_points._TRIES", 20)
    with pytest.raises(
        TrajectoryError, match=r"no way found around what is at \(10, 0.2\) m; expected another path"
    ):
        lead_around(way([0, 0], [10, 0], [20, 0]), np.array([[10.0, 0.2]]), np.array([1.0]))
