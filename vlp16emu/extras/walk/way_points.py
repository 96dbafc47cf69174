"""Waypoints of a walk, from scene, CSV, GPX or a pattern over a plot; detours around obstacles."""

import math
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from xml.parsers import expat

import numpy as np

from vlp16emu.elementary import atan2, cos, norm, sin
from vlp16emu.errors import TrajectoryError
from vlp16emu.extras.walk.path import level_path
from vlp16emu.extras.walk.settings import LawnMower, Walk
from vlp16emu.inputs import read_bytes
from vlp16emu.motion.gnss import to_local
from vlp16emu.motion.settings import Gps
from vlp16emu.tables import Column, Table, read_table
from vlp16emu.types import F8

_POINTS_PER_QUARTER = 6  # waypoints in a quarter turn: their spline keeps within 0.2 % of the radius
_LOOP_RADIUS_M = 0.5  # of the loop behind each end of a way back and forth (assumption)
_LOOP_LENGTH_M = _LOOP_RADIUS_M * math.pi / 3 * 7  # least distance from end to end of a way back and forth
_FARTHEST_M = 100_000.0  # from the scene's origin; farther away a plane map does not represent the earth
_GEODETIC = {"lat": Column({"lat": 1.0}, -90.0, 90.0), "lon": Column({"lon": 1.0}, -180.0, 180.0)}
_CSV = {
    "x_m": Column({"x_m": 1.0, "x": 1.0}),
    "y_m": Column({"y_m": 1.0, "y": 1.0}),
    "stop_s": Column({"stop_s": 1.0}, 0.0, 1e6, is_needed=False, is_filled=False),
}
_TRIES = 300  # waypoints that are put beside an obstacle, or moved farther away from it
_SPARE_M = 0.05  # added to the required distance, as the curve between waypoints cuts corners
_WIDER_M = 0.05  # growth of that distance with each try at the same obstacle


@dataclass(frozen=True, slots=True)
class WayPoints:
    """Places to pass, in order."""

    xy_m: F8  # (n, 2) world
    pause_s: F8  # (n,) time that the person stops there, 0 for no stop


def way_points(walk: Walk, gps: Gps, origin_m: tuple[float, float]) -> WayPoints:
    """Return the waypoints of a walk, with the stops at them.

    Raises TrajectoryError if a file has no waypoint, a pattern does not fit, or a stop is at no waypoint.

    Parameters
    ----------
    gps : where on earth the scene's origin is
    origin_m : easting and northing in files that become (0, 0) in the scene
    """
    if walk.way_points_file is not None:
        points = read_way_points(Path(walk.way_points_file), gps, origin_m)
    else:
        xy_m = np.array(walk.way_points_m) if walk.lawn_mower is None else lawn_mower(walk.lawn_mower)
        points = WayPoints(xy_m, np.zeros(len(xy_m)))
    for stop in walk.stops:
        if stop.way_point is not None:
            if stop.way_point > len(points.pause_s):
                raise TrajectoryError(
                    "stop", f"found waypoint {stop.way_point}", f"from 1 to {len(points.pause_s)}"
                )
            points.pause_s[stop.way_point - 1] += stop.pause_s
    return _there_and_back(points) if walk.back_and_forth else points


def read_way_points(path: Path, gps: Gps, origin_m: tuple[float, float]) -> WayPoints:
    """Read waypoints from a file whose name ends in .csv or .gpx.

    A CSV has the columns x_m and y_m, and optionally stop_s, the duration of a stop. From a GPX file the one
    track is read, or the one route if it has no track; its times and heights are ignored.

    Raises TrajectoryError if the file is not of this form, or lies more than 100 km from the scene's origin.

    Parameters
    ----------
    gps : where on earth the scene's origin is
    origin_m : easting and northing in the CSV that become (0, 0) in the scene
    """
    kind = path.suffix.lower()
    if kind == ".csv":
        expected = "a CSV with the columns x_m, y_m and, if wanted, stop_s"
        table = read_table(path, _CSV, expected, TrajectoryError)
        return WayPoints(
            table.numbers("x_m", "y_m") - np.array(origin_m), np.nan_to_num(table.numbers("stop_s"))
        )
    if kind != ".gpx":
        raise TrajectoryError(str(path), f"found the ending {kind!r}", ".csv or .gpx")
    points, count = _gpx_points(path)
    tracks = count["trk"]
    routes = count["rte"]
    if (tracks or routes) != 1:
        raise TrajectoryError(str(path), f"found {tracks} tracks and {routes} routes", "one of them")
    table = points["trkpt" if tracks else "rtept"]
    places = np.column_stack([table.numbers("lat", "lon"), np.full(len(table), gps.height_m)])
    xy_m = to_local(places, gps)[:, :2]
    for i in np.flatnonzero((away_m := norm(xy_m)) > _FARTHEST_M):
        expected = (
            f"at most {_FARTHEST_M / 1000:g} km from {gps.latitude_deg:g}, {gps.longitude_deg:g} degrees"
        )
        raise TrajectoryError(
            table.where(int(i)), f"lies {away_m[i] / 1000:.0f} km from the scene's origin", expected
        )
    return WayPoints(np.ascontiguousarray(xy_m), np.zeros(len(xy_m)))


def _gpx_points(path: Path) -> tuple[dict[str, Table], Counter[str]]:
    """Return the points of a GPX file as a table by element, and the number of elements of each kind."""
    content = read_bytes(path, "a GPX file", TrajectoryError)
    parser = expat.ParserCreate()
    count = Counter[str]()
    names = {axis: axis for axis in _GEODETIC}
    points = {
        name: Table(
            path, TrajectoryError, _GEODETIC, names, [], {axis: [] for axis in names}, _has_commas=True
        )
        for name in ("trkpt", "rtept")
    }

    def refuse(*_: object) -> None:  # entities can make a small file expand without bound
        """Refuse a document type declaration."""
        where = f"{path}, line {parser.CurrentLineNumber}"
        raise TrajectoryError(where, "a document type declaration", "none in a GPX file")

    def start(element: str, attributes: dict[str, str]) -> None:
        """Note the line of an element that begins."""
        name = element.rpartition(":")[2]
        count[name] += 1
        if name in points:
            points[name].lines.append(parser.CurrentLineNumber)
            for axis, cells in points[name].cells.items():
                cells.append(attributes.get(axis, ""))

    parser.StartDoctypeDeclHandler = refuse
    parser.StartElementHandler = start
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        found = f"no XML: {expat.ErrorString(error.code)}"
        raise TrajectoryError(f"{path}, line {error.lineno}", found, "a GPX file") from None
    except (LookupError, ValueError) as error:  # from the codec that the XML declaration names
        raise TrajectoryError(f"{path}, line 1", str(error), "a GPX file in UTF-8") from None
    return points, count


def _there_and_back(points: WayPoints) -> WayPoints:
    """Return the path there and back, with a small loop behind each end; stops count in both directions."""
    xy_m = points.xy_m
    pause_s = points.pause_s
    if len(xy_m) < 2 or norm(xy_m[-1] - xy_m[0]) < _LOOP_LENGTH_M:
        found = f"found {len(xy_m)} waypoints, the last {norm(xy_m[-1] - xy_m[0]):.2f} m from the first"
        expected = f"at least 2, and {_LOOP_LENGTH_M:.1f} m; laps go round a closed path without it"
        raise TrajectoryError("back_and_forth", found, expected)
    ends = _turning_loop(xy_m[-2], xy_m[-1]), _turning_loop(xy_m[1], xy_m[0])
    none = np.zeros(len(ends[0]))
    return WayPoints(
        np.concatenate([xy_m, ends[0], xy_m[::-1], ends[1], xy_m[:1]]),
        np.concatenate([pause_s, none, [0.0], pause_s[-2:0:-1], [0.0], none, pause_s[:1]]),
    )


def _turning_loop(before_m: F8, end_m: F8) -> F8:
    """Return waypoints (n, 2) of a loop that leads back to the end of a path in the opposite direction.

    It is a sixth of a circle to the right, five sixths to the left round a centre straight ahead, and a sixth
    to the right, all with one radius, and has a waypoint at each sixth.
    """
    turns = math.pi / 3 * np.array([-1.0, 1.0, 1.0, 1.0, 1.0, 1.0, -1.0])
    ahead_m = end_m - before_m
    headings = atan2(float(ahead_m[1]), float(ahead_m[0])) + np.cumsum(turns) - turns / 2
    chords_m = _LOOP_RADIUS_M * np.column_stack([cos(headings), sin(headings)])  # chord = radius
    return np.asarray(end_m + np.cumsum(chords_m, axis=0)[:-1])


def lawn_mower(plot: LawnMower) -> F8:
    """Return waypoints (n, 2) along parallel lines over a rectangle, joined by rounded turns inside it.

    As many lines as fit are centred on the width.

    Raises TrajectoryError if the turns do not fit between two lines or along the plot.
    """
    line_spacing_m = plot.line_spacing_m
    radius_m = plot.turn_radius_m
    room_m = min(line_spacing_m, plot.length_m)
    if 2 * radius_m > room_m:
        expected = f"above 0 and at most half of {room_m:g} m, line spacing or length"
        raise TrajectoryError("turn radius", f"found {radius_m:g} m", expected)
    lines = 1 + math.floor(plot.width_m / line_spacing_m + 1e-9)  # 3.3 / 1.1 is below 3 in float64
    offset_m = (plot.width_m - (lines - 1) * line_spacing_m) / 2
    spacing_m = radius_m * math.pi / 2 / _POINTS_PER_QUARTER
    corners = [(0.0, offset_m)]
    for line in range(lines):
        y_m = offset_m + line * line_spacing_m
        far_m = 0.0 if line % 2 else plot.length_m
        corners.append((far_m, y_m))
        if line < lines - 1:
            corners.append((far_m, y_m + line_spacing_m))
    along, across = _round_corners(np.array(corners), radius_m, spacing_m).T
    azimuth_rad = math.radians(plot.azimuth_deg)
    cosine, sine = cos(azimuth_rad), sin(azimuth_rad)
    return np.column_stack([cosine * along - sine * across, sine * along + cosine * across]) + plot.corner_m


def _round_corners(corners_m: F8, radius_m: float, spacing_m: float) -> F8:
    """Sample points (n, 2) about evenly along right-angled corners (c, 2) rounded by quarter circles."""
    ahead = np.diff(corners_m, axis=0)
    ahead /= norm(ahead)[:, None]
    pieces = []
    at = corners_m[0]
    for corner, before, after in zip(corners_m[1:-1], ahead[:-1], ahead[1:], strict=True):
        pieces.append(_straight(at, corner - radius_m * before, spacing_m))
        angle = np.arange(_POINTS_PER_QUARTER)[:, None] / _POINTS_PER_QUARTER * (math.pi / 2)
        centre = corner + radius_m * (after - before)
        pieces.append(centre - radius_m * cos(angle) * after + radius_m * sin(angle) * before)
        at = corner + radius_m * after
    return np.concatenate([*pieces, _straight(at, corners_m[-1], spacing_m), corners_m[-1:]])


def _straight(start_m: F8, end_m: F8, spacing_m: float) -> F8:
    """Return points (n, 2) from a start to just before an end; none if both are equal."""
    count = math.ceil(norm(end_m - start_m) / spacing_m - 1e-9)
    return start_m + np.arange(count)[:, None] / max(count, 1) * (end_m - start_m)


def lead_around(points: WayPoints, places_m: F8, gaps_m: F8) -> WayPoints:
    """Add waypoints that keep the path at least gaps (n,) away from places (n, 2); the user's stay.

    Raises TrajectoryError if no way around is found.
    """
    beside = dict[int, tuple[int, F8]]()  # tries and waypoint by place
    for _ in range(_TRIES):
        path = level_path(points.xy_m)
        apart_m = np.array([norm(path.xy_m - place_m) for place_m in places_m])
        short_m = gaps_m - apart_m.min(axis=1)
        worst = int(short_m.argmax())
        if short_m[worst] <= 0:
            return points
        tries, before = beside.get(worst, (0, None))
        nearest = int(apart_m[worst].argmin())
        aside = path.xy_m[nearest] - places_m[worst] if before is None else before - places_m[worst]
        if norm(aside) < _SPARE_M:  # the path goes through its centre: pass on the left
            ahead = path.xy_m[min(nearest + 1, len(path.xy_m) - 1)] - path.xy_m[max(nearest - 1, 0)]
            aside = np.array([-ahead[1], ahead[0]])
        to_m = places_m[worst] + aside / norm(aside) * (gaps_m[worst] + _SPARE_M + tries * _WIDER_M)
        beside[worst] = tries + 1, to_m
        if before is None:
            along_m = norm(np.diff(path.xy_m[: nearest + 1], axis=0)).sum()
            place = int(np.clip(np.searchsorted(path.way_points_at_m, along_m), 1, len(points.xy_m) - 1))
            points = WayPoints(
                np.insert(points.xy_m, place, to_m, axis=0), np.insert(points.pause_s, place, 0.0)
            )
        else:
            xy_m = np.where((points.xy_m == before).all(axis=1)[:, None], to_m, points.xy_m)
            points = WayPoints(xy_m, points.pause_s)
    x_m, y_m = places_m[worst]
    found = f"no way found around what is at ({x_m:g}, {y_m:g}) m"
    expected = 'another path, a smaller path_clearance_m, or "drop"'
    raise TrajectoryError("world.on_conflict", found, expected, at_m=(float(x_m), float(y_m)))
