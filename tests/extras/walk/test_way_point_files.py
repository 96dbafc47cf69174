"""Waypoints in CSV and GPX files."""

import numpy as np
import pytest

from vlp16emu.errors import TrajectoryError
from vlp16emu.extras.walk.way_points import read_way_points
from vlp16emu.motion.gnss import to_geodetic
from vlp16emu.motion.settings import Gps

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


@pytest.mark.parametrize(("container", "element"), [("trk", "trkpt"), ("rte", "rtept")])
def test_gpx_is_read_onto_the_plane_of_the_scene(tmp_path, container, element):
    """Points of a track or route come back within a millimetre, wherever they are within 300 m."""
    xy_m = np.array([[0.0, 0.0], [120.0, -30.0], [-200.0, 200.0]])
    places = to_geodetic(np.column_stack([xy_m, np.zeros(3)]), ORIGIN)
    points = "".join(
        f'<{element} lat="{p[0]:.10f}" lon="{p[1]:.10f}"><ele>120</ele></{element}>' for p in places
    )
    inner = f"<trkseg>{points}</trkseg>" if container == "trk" else points
    way = f'<wpt lat="1" lon="2"/><{container}><name>walk</name>{inner}</{container}>'
    found = read(written(tmp_path, "way.GPX", GPX.format(way)))
    np.testing.assert_allclose(found.xy_m, xy_m, atol=0.01)
    assert not found.pause_s.any()


BAD = [
    ("none.gpx", None, ": no such file or directory; expected a GPX file"),
    ("way.txt", "", "found the ending '.txt'; expected .csv or .gpx"),
    ("a.csv", "x_m,y_m,stop\n1,2,3\n", (", line 1: unknown column 'stop'; expected stop_s, the nearest, "
                                       "or a name unlike it")),
    ("g.csv", "x_m,y_m,stop_s\n1,2,-1\n", (", line 2, column stop_s: found -1; expected a number from 0 "
                                          "to 1e+06")),
    ("h.gpx", "<gpx>", ", line 1: no XML: no element found; expected a GPX file"),
    ("h2.gpx", '<?xml version="1.0" encoding="x-garmin"?><gpx/>', (", line 1: unknown encoding: x-garmin; "
                                                                  "expected a GPX file in UTF-8")),
    ("i.gpx", "<gpx></gpx>", ": found 0 tracks and 0 routes; expected one of them"),
    ("j.gpx", "<gpx><trk/><trk/></gpx>", ": found 2 tracks and 0 routes; expected one of them"),
    ("k.gpx", '<!DOCTYPE gpx [<!ENTITY a "b">]><gpx>&a;</gpx>', (", line 1: a document type declaration; "
                                                                "expected none in a GPX file")),
    ("l.gpx", '<gpx><trk>\n<trkpt lat="62" lon="x"/></trk></gpx>', (", line 2, column lon: found 'x'; "
                                                                   "expected a number from -180 to 180")),
    ("m.gpx", '<gpx><trk>\n<trkpt lat="91" lon="2"/></trk></gpx>', (", line 2, column lat: found 91; "
                                                                   "expected a number from -90 to 90")),
    ("n.gpx", '<gpx><trk>\n<trkpt lat="62.24" lon="35.75"/></trk></gpx>', (", line 2: lies 519 km from "
                                                                          "the scene's origin; expected "
                                                                          "at most 100 km from 62.24, "
                                                                          "25.75 degrees")),
]  # fmt: skip


@pytest.mark.parametrize(("name", "text", "line"), BAD, ids=[row[0] for row in BAD])
def test_a_bad_file_is_reported_in_one_line(tmp_path, name, text, line):
    """File, line, what was found and what was expected."""
    path = tmp_path / name if text is None else written(tmp_path, name, text)
    with pytest.raises(TrajectoryError) as caught:
        read(path)
    assert str(caught.value).removeprefix(str(path)).removeprefix(": ") == line.removeprefix(": ")
