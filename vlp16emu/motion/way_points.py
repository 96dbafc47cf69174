"""Waypoints of a walk: in the scene, in files, or of a pattern over a plot."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vlp16emu.doors import door
from vlp16emu.elementary import atan2, cos, norm, sin
from vlp16emu.errors import TrajectoryError
from vlp16emu.motion.settings import Gps, LawnMower, Walk
from vlp16emu.types import Array

_POINTS_PER_QUARTER = 6  # waypoints in a quarter turn: the spline through them keeps within 0.2 % of the radius
_LOOP_RADIUS_M = 0.5  # of the turn behind each end of a way back and forth: a step to the side, and round (assumption)
_LOOP_LENGTH_M = _LOOP_RADIUS_M * math.pi / 3 * 7  # a way that is shorter from end to end is no way to go back on


@dataclass(frozen=True, slots=True)
class WayPoints:
    """Places to pass, in order."""

    xy_m: Array  # (n, 2) world
    pause_s: Array  # (n,) how long the person stops there, 0 where the walk goes on


def way_points(walk: Walk, gps: Gps, origin_m: tuple[float, float]) -> WayPoints:
    """Return the waypoints of a walk, with the stops at them.

    Raises TrajectoryError if a file has none, a pattern does not fit, or a stop is at none of them.

    Parameters
    ----------
    gps : where on earth the scene's origin is
    origin_m : easting and northing in files that become (0, 0) in the scene
    """
    if walk.way_points_file is not None:
        points: WayPoints = door("way_points")(Path(walk.way_points_file), gps, origin_m)
    else:
        xy_m = np.array(walk.way_points_m) if walk.lawn_mower is None else lawn_mower(walk.lawn_mower)
        points = WayPoints(xy_m, np.zeros(len(xy_m)))
    for stop in walk.stops:
        if stop.way_point is not None:
            if stop.way_point > len(points.pause_s):
                raise TrajectoryError("stop", f"found waypoint {stop.way_point}", f"from 1 to {len(points.pause_s)}")
            points.pause_s[stop.way_point - 1] += stop.pause_s
    return _there_and_back(points) if walk.back_and_forth else points


def _there_and_back(points: WayPoints) -> WayPoints:
    """Go back on the same way, round a small loop behind each end; stops are made there and back, at the ends once."""
    xy_m, pause_s = points.xy_m, points.pause_s
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


def _turning_loop(before_m: Array, end_m: Array) -> Array:
    """Waypoints (n, 2) of a loop that leads back to the end of a way, straight against how one came there.

    A sixth of a circle to the right, five sixths to the left round a centre straight ahead, and a sixth to the right, all
    of one radius, with a waypoint at each sixth.
    """
    turns = math.pi / 3 * np.array([-1.0, 1.0, 1.0, 1.0, 1.0, 1.0, -1.0])
    ahead_m = end_m - before_m
    headings = atan2(float(ahead_m[1]), float(ahead_m[0])) + np.cumsum(turns) - turns / 2
    chords_m = _LOOP_RADIUS_M * np.column_stack([cos(headings), sin(headings)])  # as long as the radius
    return np.asarray(end_m + np.cumsum(chords_m, axis=0)[:-1])


def lawn_mower(plot: LawnMower) -> Array:
    """Waypoints (n, 2) along parallel lines to and fro over a rectangle, joined by rounded turns inside it.

    The lines are as many as fit, in the middle of the width.

    Raises TrajectoryError if the turns do not fit between two lines or along the plot.
    """
    line_spacing_m, radius_m = plot.line_spacing_m, plot.turn_radius_m
    room_m = min(line_spacing_m, plot.length_m)
    if 2 * radius_m > room_m:
        expected = f"above 0 and at most half of {room_m:g} m, line spacing or length"
        raise TrajectoryError("turn radius", f"found {radius_m:g} m", expected)
    lines = 1 + math.floor(plot.width_m / line_spacing_m)
    offset_m = (plot.width_m - (lines - 1) * line_spacing_m) / 2
    spacing_m = radius_m * math.pi / 2 / _POINTS_PER_QUARTER
    corners = [(0.0, offset_m)]
    for line in range(lines):
        y_m = offset_m + line * line_spacing_m
        far_m = 0.0 if line % 2 else plot.length_m
        corners.append((far_m, y_m))
        if line < lines - 1:
            corners.append((far_m, y_m + line_spacing_m))
    along, across = _rounded(np.array(corners), radius_m, spacing_m).T
    azimuth_rad = math.radians(plot.azimuth_deg)
    cosine, sine = cos(azimuth_rad), sin(azimuth_rad)
    return np.column_stack([cosine * along - sine * across, sine * along + cosine * across]) + plot.corner_m


def _rounded(corners_m: Array, radius_m: float, spacing_m: float) -> Array:
    """Points (n, 2) at about equal distances along right-angled corners (c, 2) that are cut by quarter circles."""
    ahead = np.diff(corners_m, axis=0)
    ahead /= norm(ahead)[:, None]
    pieces, at = [], corners_m[0]
    for corner, before, after in zip(corners_m[1:-1], ahead[:-1], ahead[1:], strict=True):
        pieces.append(_straight(at, corner - radius_m * before, spacing_m))
        angle = np.arange(_POINTS_PER_QUARTER)[:, None] / _POINTS_PER_QUARTER * (math.pi / 2)
        centre = corner + radius_m * (after - before)
        pieces.append(centre - radius_m * cos(angle) * after + radius_m * sin(angle) * before)
        at = corner + radius_m * after
    return np.concatenate([*pieces, _straight(at, corners_m[-1], spacing_m), corners_m[-1:]])


def _straight(start_m: Array, end_m: Array, spacing_m: float) -> Array:
    """Points (n, 2) from a start until before an end; none where both are one."""
    count = math.ceil(norm(end_m - start_m) / spacing_m - 1e-9)
    return start_m + np.arange(count)[:, None] / max(count, 1) * (end_m - start_m)
