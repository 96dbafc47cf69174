"""Waypoints in files, patterns over a plot, and ways around what is in the way."""

import numpy as np
import pytest

from vlp16emu.errors import TrajectoryError
from vlp16emu.motion import Gps, LawnMower, Stop, Walk
from vlp16emu.motion.geodesy import to_geodetic
from vlp16emu.motion.path import Path
from vlp16emu.motion.way_points import WayPoints, around, lawn_mower, read_way_points, way_points
from vlp16emu.world.polyline import distance_m

ORIGIN = Gps(latitude_deg=62.24, longitude_deg=25.75, height_m=100.0)

GPX = """<?xml version="1.0" encoding="UTF-8"?>
<gpx version="1.1" creator="someone" xmlns="http://www.topografix.com/GPX/1/1">
{}
</gpx>
"""


def written(folder, name, text):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def read(path):
    return read_way_points(path, ORIGIN, (1000.0, 2000.0))


def test_csv_is_read_about_the_origin(tmp_path):
    """The origin's easting and northing are taken off, and an empty stop is none."""
    points = read(written(tmp_path, "way.csv", "y_m,stop_s,X\n2004,,1001\n\n2005,2.5,1012\n"))
    np.testing.assert_array_equal(points.xy_m, [[1.0, 4.0], [12.0, 5.0]])
    np.testing.assert_array_equal(points.pause_s, [0.0, 2.5])


def test_pauses_are_added_by_number(tmp_path):
    """A pause at waypoint 2 adds to what the file says, and a number beyond the last is refused."""
    file = written(tmp_path, "way.csv", "x_m,y_m,stop_s\n0,0,0\n9,0,1\n")

    def stopping(number):
        stops = [Stop(way_point=number, pause_s=3.0)]
        return way_points(Walk(kind="walk", way_points_file=str(file), stops=stops), ORIGIN, (0.0, 0.0))

    np.testing.assert_array_equal(stopping(2).pause_s, [0.0, 4.0])
    with pytest.raises(TrajectoryError, match="stop: found waypoint 3; expected from 1 to 2"):
        stopping(3)


@pytest.mark.parametrize(("container", "element"), [("trk", "trkpt"), ("rte", "rtept")])
def test_gpx_is_read_onto_the_plane_of_the_scene(tmp_path, container, element):
    """Points of a track or route come back within a millimetre, wherever they are within 300 m."""
    xy_m = np.array([[0.0, 0.0], [120.0, -30.0], [-200.0, 200.0]])
    places = to_geodetic(np.column_stack([xy_m, np.zeros(3)]), ORIGIN)
    points = "".join(f'<{element} lat="{p[0]:.10f}" lon="{p[1]:.10f}"><ele>120</ele></{element}>' for p in places)
    inner = f"<trkseg>{points}</trkseg>" if container == "trk" else points
    way = f'<wpt lat="1" lon="2"/><{container}><name>walk</name>{inner}</{container}>'
    found = read(written(tmp_path, "way.GPX", GPX.format(way)))
    np.testing.assert_allclose(found.xy_m, xy_m, atol=0.01)
    assert not found.pause_s.any()


BAD = [
    ("way.txt", "", "found the ending '.txt'; expected .csv or .gpx"),
    (
        "a.csv",
        "x_m,y_m,stop\n1,2,3\n",
        ", line 1: unknown column 'stop'; expected stop_s, the nearest, or a name unlike it",
    ),
    ("g.csv", "x_m,y_m,stop_s\n1,2,-1\n", ", line 2, column stop_s: found -1; expected a number from 0 to 1e+06"),
    ("h.gpx", "<gpx>", ", line 1: no XML: no element found; expected a GPX file"),
    (
        "h2.gpx",
        '<?xml version="1.0" encoding="x-garmin"?><gpx/>',
        ", line 1: unknown encoding: x-garmin; expected a GPX file in UTF-8",
    ),
    ("i.gpx", "<gpx></gpx>", ": found 0 tracks and 0 routes; expected one of them"),
    ("j.gpx", "<gpx><trk/><trk/></gpx>", ": found 2 tracks and 0 routes; expected one of them"),
    (
        "k.gpx",
        '<!DOCTYPE gpx [<!ENTITY a "b">]><gpx>&a;</gpx>',
        ", line 1: a document type declaration; expected none in a GPX file",
    ),
    (
        "l.gpx",
        '<gpx><trk>\n<trkpt lat="62" lon="x"/></trk></gpx>',
        ", line 2, column lon: found 'x'; expected a number from -180 to 180",
    ),
    (
        "m.gpx",
        '<gpx><trk>\n<trkpt lat="91" lon="2"/></trk></gpx>',
        ", line 2, column lat: found 91; expected a number from -90 to 90",
    ),
    (
        "n.gpx",
        '<gpx><trk>\n<trkpt lat="62.24" lon="35.75"/></trk></gpx>',
        ", line 2: lies 519 km from the scene's origin; expected at most 100 km from 62.24, 25.75 degrees",
    ),
]


@pytest.mark.parametrize(("name", "text", "line"), BAD, ids=[row[0] for row in BAD])
def test_a_bad_file_is_reported_in_one_line(tmp_path, name, text, line):
    """File, line, what was found and what was expected."""
    path = written(tmp_path, name, text)
    with pytest.raises(TrajectoryError) as caught:
        read(path)
    assert str(caught.value).removeprefix(str(path)).removeprefix(": ") == line.removeprefix(": ")


def test_a_missing_file_is_reported(tmp_path):
    """The operating system's reason is passed on."""
    with pytest.raises(TrajectoryError, match=r"none\.gpx: no such file or directory; expected a GPX file"):
        read(tmp_path / "none.gpx")


PLOT = {
    "corner_m": (5.0, -6.0),
    "length_m": 30.0,
    "width_m": 27.0,
    "azimuth_deg": 30.0,
    "line_spacing_m": 5.0,
    "turn_radius_m": 1.0,
}


def in_plot(point_m):
    """Along and across the plot."""
    c, s = np.cos(np.radians(30.0)), np.sin(np.radians(30.0))
    x, y = (point_m[:, :2] - PLOT["corner_m"]).T
    return c * x + s * y, c * y - s * x


@pytest.fixture(scope="module")
def mown():
    """A path over level ground."""
    return Path(lawn_mower(LawnMower(**PLOT)), lambda x, _y: 0.0 * x)


def test_lines_cover_the_plot_and_stay_in_it(mown):
    """Six lines, 5 m apart and in the middle of 27 m, each walked over nearly its length, within 2 mm of the plot."""
    along, across = in_plot(mown.at(np.linspace(0.0, mown.length_m, 40_001))[0])
    assert -0.002 < along.min() < along.max() < 30.002
    assert across.min() == pytest.approx(1.0, abs=0.002)
    assert across.max() == pytest.approx(26.0, abs=0.002)
    for line in range(6):
        on_it = np.abs(across - (1.0 + 5.0 * line)) < 0.002
        assert np.ptp(along[on_it]) > 27.9


def test_length_is_that_of_lines_and_arcs(mown):
    """Quarter circles cut ten corners off six lines and five links."""
    assert mown.length_m == pytest.approx(6 * 30 + 5 * 5 - 10 * (2 - np.pi / 2), rel=1e-4)


def test_turns_have_their_radius(mown):
    """Nowhere does the path turn tighter than 0.8 times the radius."""
    _, heading_rad = mown.derivatives_at(np.linspace(0.0, mown.length_m, 40_001))
    assert np.abs(heading_rad[:, 1]).max() < 1.25


def test_one_line_is_a_line():
    """A plot narrower than the spacing has one line, in its middle."""
    points_m = lawn_mower(LawnMower(**PLOT | {"width_m": 3.0, "azimuth_deg": 0.0}))
    np.testing.assert_allclose(points_m[:, 1], -4.5)


@pytest.mark.parametrize("radius_m", [2.501, 2.6])
def test_turns_that_do_not_fit_are_refused(radius_m):
    """The radius is at most half the spacing."""
    with pytest.raises(TrajectoryError, match="above 0 and at most half of 5 m, line spacing or length"):
        lawn_mower(LawnMower(**PLOT | {"turn_radius_m": radius_m}))


def way(*xy_m):
    return WayPoints(np.array(xy_m, float), np.zeros(len(xy_m)))


def gaps_m(points, places_m):
    """Distances of places from the curve through waypoints."""
    return distance_m(np.asarray(places_m, float), Path(points.xy_m, lambda x, y: 0 * x).xy_m)


def test_the_path_keeps_its_distance_and_its_waypoints():
    """Around scattered stems, one right on the path, the curve has the gaps asked for, and passes the user's waypoints in order."""
    points = way([0, 0], [20, 0], [40, 6])
    places = np.array([[5, 0.3], [11, -0.5], [14, 0.0], [30, 3.2], [25, 9.0]])
    wanted = np.array([0.9, 1.0, 1.1, 0.95, 1.0])
    found = around(points, places, wanted)
    assert (gaps_m(found, places) >= wanted).all()
    at = [np.flatnonzero((found.xy_m == xy).all(axis=1)) for xy in points.xy_m]
    assert [len(one) for one in at] == [1, 1, 1]
    assert np.diff(np.concatenate(at)).min() > 0
    assert np.abs(found.xy_m[:, 1] - 0.15 * np.maximum(found.xy_m[:, 0] - 20, 0) * 2).max() < 2.5


def test_a_free_path_stays_as_it_is():
    """Where nothing is too near, no waypoint is added."""
    points = way([0, 0], [10, 1], [20, 0])
    assert around(points, np.array([[10.0, 5.0]]), np.array([1.0])) is points


def test_stops_stay_with_their_waypoints():
    """Waypoints that are added have no stop, and the others keep theirs."""
    points = WayPoints(np.array([[0.0, 0], [10, 0], [20, 0]]), np.array([0.0, 4.0, 0.0]))
    found = around(points, np.array([[5.0, 0.1]]), np.array([0.8]))
    assert found.pause_s.tolist() == [0, 0, 4, 0]
    assert found.xy_m[2].tolist() == [10, 0]


def test_where_there_is_no_way_it_is_named(monkeypatch):
    """A waypoint of the user that is itself too near cannot be led around, however often it is tried."""
    monkeypatch.setattr("vlp16emu.motion.way_points._TRIES", 20)
    with pytest.raises(TrajectoryError, match=r"no way found around what is at \(10, 0.2\) m; expected another path"):
        around(way([0, 0], [10, 0], [20, 0]), np.array([[10.0, 0.2]]), np.array([1.0]))
