"""Way points that lead a path around given stems."""

import numpy as np

from vlp16emu.elementary import norm
from vlp16emu.errors import TrajectoryError
from vlp16emu.motion.path import Path
from vlp16emu.motion.way_points import WayPoints
from vlp16emu.types import Array

_TRIES = 300  # waypoints that are put beside something, or moved farther away from it
_SPARE_M, _WIDER_M = 0.05, 0.05
"""Beyond what is asked for, at first and more with each try at the same thing: the curve between waypoints cuts corners."""


def around(points: WayPoints, places_m: Array, gaps_m: Array) -> WayPoints:
    """Put waypoints beside places (n, 2) to which the path comes nearer than gaps (n,), the nearest first; the user's stay.

    Raises TrajectoryError if no way around is found.
    """
    beside = dict[int, tuple[int, Array]]()  # tries and waypoint by place
    for _ in range(_TRIES):
        path = Path(points.xy_m, lambda x, _y: np.zeros_like(x))
        apart_m = np.array([norm(path.xy_m - place_m) for place_m in places_m])
        short_m = gaps_m - apart_m.min(axis=1)
        worst = int(short_m.argmax())
        if short_m[worst] <= 0:
            return points
        tries, before = beside.get(worst, (0, None))
        nearest = int(apart_m[worst].argmin())
        aside = path.xy_m[nearest] - places_m[worst] if before is None else before - places_m[worst]
        if norm(aside) < _SPARE_M:  # through its middle: to the left
            ahead = path.xy_m[min(nearest + 1, len(path.xy_m) - 1)] - path.xy_m[max(nearest - 1, 0)]
            aside = np.array([-ahead[1], ahead[0]])
        to_m = places_m[worst] + aside / norm(aside) * (gaps_m[worst] + _SPARE_M + tries * _WIDER_M)
        beside[worst] = tries + 1, to_m
        if before is None:
            along_m = norm(np.diff(path.xy_m[: nearest + 1], axis=0)).sum()
            place = int(np.clip(np.searchsorted(path.way_points_at_m, along_m), 1, len(points.xy_m) - 1))
            points = WayPoints(np.insert(points.xy_m, place, to_m, axis=0), np.insert(points.pause_s, place, 0.0))
        else:
            xy_m = np.where((points.xy_m == before).all(axis=1)[:, None], to_m, points.xy_m)
            points = WayPoints(xy_m, points.pause_s)
    x_m, y_m = places_m[worst]
    found = f"no way found around what is at ({x_m:g}, {y_m:g}) m"
    raise TrajectoryError("world.on_conflict", found, 'another path, a smaller path_clearance_m, or "drop"')
