"""Waypoints of a walk in CSV and GPX files."""

from collections import Counter
from pathlib import Path
from xml.parsers import expat

import numpy as np

from vlp16emu.elementary import norm
from vlp16emu.errors import TrajectoryError, readable
from vlp16emu.motion import Gps
from vlp16emu.motion.gnss import to_local
from vlp16emu.motion.way_points import WayPoints
from vlp16emu.tables import Column, Table, read_table

_FARTHEST_M = 100_000.0  # farther from the scene's origin the plane of the map is no picture of the earth
_GEODETIC = {"lat": Column({"lat": 1.0}, -90.0, 90.0), "lon": Column({"lon": 1.0}, -180.0, 180.0)}
_CSV = {
    "x_m": Column({"x_m": 1.0, "x": 1.0}),
    "y_m": Column({"y_m": 1.0, "y": 1.0}),
    "stop_s": Column({"stop_s": 1.0}, 0.0, 1e6, is_needed=False, is_filled=False),
}


def read_way_points(path: Path, gps: Gps, origin_m: tuple[float, float]) -> WayPoints:
    """Read waypoints from a file whose name ends in .csv or .gpx.

    A CSV has the columns x_m and y_m, and stop_s where the person is to stop. Of a GPX file the one track
    is read, or the one route if it has no track; its times and heights are left aside.

    Raises TrajectoryError if the file is no such file, or lies more than 100 km from the scene's origin.

    Parameters
    ----------
    gps : where on earth the scene's origin is
    origin_m : easting and northing in the CSV that become (0, 0) in the scene
    """
    kind = path.suffix.lower()
    if kind == ".csv":
        expected = "a CSV with the columns x_m, y_m and, if wanted, stop_s"
        table = read_table(path, _CSV, expected, TrajectoryError)
        return WayPoints(table.numbers("x_m", "y_m") - np.array(origin_m), np.nan_to_num(table.numbers("stop_s")))
    if kind != ".gpx":
        raise TrajectoryError(str(path), f"found the ending {kind!r}", ".csv or .gpx")
    with readable(path, "a GPX file", TrajectoryError):
        points, count = _gpx_points(path)
    tracks, routes = count["trk"], count["rte"]
    if (tracks or routes) != 1:
        raise TrajectoryError(str(path), f"found {tracks} tracks and {routes} routes", "one of them")
    table = points["trkpt" if tracks else "rtept"]
    places = np.column_stack([table.numbers("lat", "lon"), np.full(len(table), gps.height_m)])
    xy_m = to_local(places, gps)[:, :2]
    for i in np.flatnonzero((away_m := norm(xy_m)) > _FARTHEST_M):
        expected = f"at most {_FARTHEST_M / 1000:g} km from {gps.latitude_deg:g}, {gps.longitude_deg:g} degrees"
        raise TrajectoryError(table.where(int(i)), f"lies {away_m[i] / 1000:.0f} km from the scene's origin", expected)
    return WayPoints(np.ascontiguousarray(xy_m), np.zeros(len(xy_m)))


def _gpx_points(path: Path) -> tuple[dict[str, Table], Counter[str]]:
    """Points of a GPX file by their element, as a table, and how many there are of each element."""
    parser, count = expat.ParserCreate(), Counter[str]()
    names = {axis: axis for axis in _GEODETIC}
    points = {
        name: Table(path, TrajectoryError, _GEODETIC, names, [], {axis: [] for axis in names}, _has_commas=True)
        for name in ("trkpt", "rtept")
    }

    def refuse(*_: object) -> None:  # entities are what small files grow vast by
        where = f"{path}, line {parser.CurrentLineNumber}"
        raise TrajectoryError(where, "a document type declaration", "none in a GPX file")

    def start(element: str, attributes: dict[str, str]) -> None:
        name = element.rpartition(":")[2]
        count[name] += 1
        if name in points:
            points[name].lines.append(parser.CurrentLineNumber)
            for axis, cells in points[name].cells.items():
                cells.append(attributes.get(axis, ""))

    parser.StartDoctypeDeclHandler, parser.StartElementHandler = refuse, start
    try:
        parser.Parse(path.read_bytes(), True)
    except expat.ExpatError as error:
        found = f"no XML: {expat.ErrorString(error.code)}"
        raise TrajectoryError(f"{path}, line {error.lineno}", found, "a GPX file") from None
    except (LookupError, ValueError) as error:  # of the codec that the XML declaration names
        raise TrajectoryError(f"{path}, line 1", str(error), "a GPX file in UTF-8") from None
    return points, count
