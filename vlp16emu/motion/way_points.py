"""Way points in files: CSV, and GPX of a track or route."""

from dataclasses import dataclass
from pathlib import Path
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import TrajectoryError, readable
from vlp16emu.motion.geodesy import Origin, to_local
from vlp16emu.motion.user_file import finite, named_cells

__all__ = ["WayPoints", "read_way_points"]

_FARTHEST_M = 100_000.0
"""Farther from the scene's origin the plane of the map is no picture of the earth."""
_CONTAINER = {"trkpt": "trk", "rtept": "rte"}
"""Elements of points, and of what they make up (GPX 1.1 schema, Topografix)."""


@dataclass(frozen=True, slots=True)
class WayPoints:
    """Places to pass, in order."""

    xy_m: NDArray[np.float64]
    """(n, 2) world."""
    pause_s: NDArray[np.float64]
    """(n,) how long the person stands there, 0 where the walk goes on."""

    def with_pause(self, number: int, pause_s: float) -> "WayPoints":
        """Give the same way points with a longer stop at one of them, the first having number 1.

        Raises
        ------
        TrajectoryError
            where there is no such way point
        """
        if not 1 <= number <= len(self.pause_s):
            raise TrajectoryError("stop", f"found way point {number}", f"from 1 to {len(self.pause_s)}")
        longer_s = self.pause_s.copy()
        longer_s[number - 1] += pause_s
        return WayPoints(self.xy_m, longer_s)


def read_way_points(path: Path, *, origin_m: tuple[float, float], geodetic_origin: Origin) -> WayPoints:
    """Read way points, their kind told by the ending of the file's name: .csv or .gpx.

    A CSV has the columns x_m and y_m, and stop_s where the person is to stop. Of a GPX file the one track
    is read, or the one route if it has no track; its times and heights are left aside.

    Parameters
    ----------
    origin_m : easting and northing in the CSV that become (0, 0) in the scene
    geodetic_origin : where on earth the scene's origin is

    Raises
    ------
    TrajectoryError
        where the file is no such file, or lies more than 100 km from the scene's origin
    """
    kind = path.suffix.lower()
    if kind == ".csv":
        return _read_csv(path, origin_m)
    if kind == ".gpx":
        return _read_gpx(path, geodetic_origin)
    raise TrajectoryError(str(path), f"found the ending {kind!r}", ".csv or .gpx")


def _read_csv(path: Path, origin_m: tuple[float, float]) -> WayPoints:
    """Read a table of way points."""
    xy_m, pause_s = [], []
    for where, row in named_cells(path, ["x_m", "y_m"], ["stop_s"]):
        xy_m.append([finite(f"{where}, column {axis}", row[axis]) for axis in ("x_m", "y_m")])
        pause_s.append(finite(f"{where}, column stop_s", row.get("stop_s") or "0"))
        if pause_s[-1] < 0:
            raise TrajectoryError(f"{where}, column stop_s", f"found {pause_s[-1]:g}", "0 or more")
    return WayPoints(np.reshape(xy_m, (-1, 2)) - np.array(origin_m), np.array(pause_s))


def _read_gpx(path: Path, origin: Origin) -> WayPoints:
    """Read a track or route onto the plane at the scene's origin."""
    reader = _GpxReader(path)
    with readable(path, "a GPX file", TrajectoryError):
        reader.feed(path.read_bytes())
    tracks, routes = reader.count["trk"], reader.count["rte"]
    if (tracks or routes) != 1:
        raise TrajectoryError(str(path), f"found {tracks} tracks and {routes} routes", "one of them")
    points = reader.points["trkpt" if tracks else "rtept"]
    places = [(latitude, longitude, origin.height_m) for _, latitude, longitude in points]
    xy_m = to_local(np.reshape(places, (-1, 3)), origin)[:, :2]
    for (line, _, _), away_m in zip(points, np.hypot(*xy_m.T), strict=True):
        if away_m > _FARTHEST_M:
            raise TrajectoryError(
                f"{path}, line {line}",
                f"lies {away_m / 1000:.0f} km from the scene's origin",
                f"at most {_FARTHEST_M / 1000:g} km from {origin.latitude_deg:g}, {origin.longitude_deg:g} degrees",
            )
    return WayPoints(np.ascontiguousarray(xy_m), np.zeros(len(xy_m)))


class _GpxReader:
    """Points of a GPX file, read without building a tree.

    A document type declaration is refused: entities are what small files grow vast by.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.points: dict[str, list[tuple[int, float, float]]] = {name: [] for name in _CONTAINER}
        """Line, latitude and longitude of each point, by element."""
        self.count = dict.fromkeys(_CONTAINER.values(), 0)
        """How many tracks and routes there are."""
        self._parser = expat.ParserCreate()
        self._parser.StartDoctypeDeclHandler = self._refuse
        self._parser.StartElementHandler = self._start

    def feed(self, text: bytes) -> None:
        """Read the whole file."""
        try:
            self._parser.Parse(text, True)
        except expat.ExpatError as error:
            found = f"no XML: {expat.ErrorString(error.code)}"
            raise TrajectoryError(f"{self._path}, line {error.lineno}", found, "a GPX file") from None

    def _refuse(self, *_: object) -> None:
        where = f"{self._path}, line {self._parser.CurrentLineNumber}"
        raise TrajectoryError(where, "a document type declaration", "none in a GPX file")

    def _start(self, element: str, attributes: dict[str, str]) -> None:
        name, line = element.rpartition(":")[2], self._parser.CurrentLineNumber
        if name in self.count:
            self.count[name] += 1
        if name not in self.points:
            return
        where = f"{self._path}, line {line}"
        degrees = [finite(f"{where}, {axis}", attributes.get(axis, "")) for axis in ("lat", "lon")]
        for axis, value, limit in zip(("lat", "lon"), degrees, (90.0, 180.0), strict=True):
            if abs(value) > limit:
                raise TrajectoryError(f"{where}, {axis}", f"found {value:g}", f"from {-limit:g} to {limit:g}")
        self.points[name].append((line, degrees[0], degrees[1]))
