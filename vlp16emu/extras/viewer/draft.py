"""A walk that a user draws: its way points, stops and speed, and its versions; without a page."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple, Self

import numpy as np

from vlp16emu.elementary import norm
from vlp16emu.errors import InputError
from vlp16emu.extras.walk.path import Path, level_path
from vlp16emu.extras.walk.settings import Walk
from vlp16emu.extras.walk.way_points import way_points
from vlp16emu.foliage.polyline import Polyline
from vlp16emu.scenario import Scenario
from vlp16emu.types import F8

_FEWEST = 2  # way points of a path
_FEWEST_OF_LOOP = 4  # with the last on the first: a loop through two places turns on the spot
_SAME_M = 0.01  # way points nearer than this are one place, as for the path
_DECIMALS = 3  # way points are on whole millimetres, which are enough for a foot and short in the file


class WayPoint(NamedTuple):
    """A place that the path passes."""

    x_m: float
    y_m: float
    pause_s: float = 0.0  # time for which the person stops there


@dataclass(frozen=True, slots=True)
class Draft:
    """A walk as it is drawn; changes return another draft.

    In a loop the last way point is at the first one, and moves with it.
    """

    way_points: tuple[WayPoint, ...]
    speed_m_s: float
    run_time_s: float | None  # duration of the walk, which then determines the speed; None for `speed_m_s`
    laps: int
    back_and_forth: bool
    is_whole: bool = False  # True to record the whole walk, however long it takes

    @classmethod
    def of(cls, scenario: Scenario) -> Self:
        """Return the walk of a scene, with the way points of its file or its pattern.

        InputError if the scene's motion is no walk; TrajectoryError as `extras.walk.way_points.way_points`.
        """
        walk = walk_of(scenario)
        single_walk = walk.model_copy(update={"back_and_forth": False})
        site = scenario.world.site(scenario.world_seed)
        path = way_points(single_walk, scenario.gps, site.origin_m[:2])
        rows = np.column_stack([path.xy_m, path.pause_s]).tolist()
        points = tuple(WayPoint(*row) for row in rows)
        return cls(points, walk.speed_m_s, walk.run_time_s, walk.laps, walk.back_and_forth)

    @property
    def xy_m(self) -> F8:
        """Way points (n, 2)."""
        return np.array([(point.x_m, point.y_m) for point in self.way_points])

    @property
    def is_loop(self) -> bool:
        """True if the path closes: its last way point is at the first."""
        gap_m = _gap_m(self.way_points[0], self.way_points[-1])
        return len(self.way_points) >= _FEWEST_OF_LOOP and gap_m < _SAME_M

    def move(self, number: int, x_m: float, y_m: float) -> Self:
        """Return the draft with a way point, from 0, at another place; its stop moves with it."""
        last = len(self.way_points) - 1
        numbers = {0, last} if self.is_loop and number in (0, last) else {number}
        rows = list(self.way_points)
        for index in numbers:
            rows[index] = rows[index]._replace(x_m=round(x_m, _DECIMALS), y_m=round(y_m, _DECIMALS))
        return replace(self, way_points=tuple(rows))

    def set_stop(self, number: int, pause_s: float) -> Self:
        """Return the draft with a stop at a way point; 0 s for none."""
        rows = list(self.way_points)
        rows[number] = rows[number]._replace(pause_s=pause_s)
        return replace(self, way_points=tuple(rows))

    def insert(self, x_m: float, y_m: float) -> tuple[Self, int]:
        """Return the draft with a further way point, in the leg that it lengthens least, and its number."""
        point = WayPoint(round(x_m, _DECIMALS), round(y_m, _DECIMALS))
        detours_m = [
            _gap_m(begin, point) + _gap_m(point, end) - _gap_m(begin, end)
            for begin, end in pairwise(self.way_points)
        ]
        number = 1 + int(np.argmin(detours_m))
        rows = list(self.way_points)
        rows.insert(number, point)
        return replace(self, way_points=tuple(rows)), number

    def remove(self, number: int) -> Self:
        """Return the draft without a way point, or the same one if too few would be left."""
        rows = [point for index, point in enumerate(self.way_points) if index != number]
        if self.is_loop and number in (0, len(rows)):
            rows = [*self.way_points[1:-1], self.way_points[1]._replace(pause_s=0.0)]
        fewest = _FEWEST_OF_LOOP if self.is_loop else _FEWEST
        return replace(self, way_points=tuple(rows)) if len(rows) >= fewest else self

    def set_loop(self, *, is_loop: bool) -> Self:
        """Return the draft as a loop back to the first way point, or open; two way points stay open."""
        if is_loop == self.is_loop or (is_loop and len(self.way_points) < _FEWEST_OF_LOOP - 1):
            return self
        end = self.way_points[0]._replace(pause_s=0.0)
        rows = (*self.way_points, end) if is_loop else self.way_points[:-1]
        return replace(self, way_points=rows, laps=self.laps if is_loop or self.back_and_forth else 1)

    def simplify(self, tolerance_m: float) -> Self:
        """Return the draft with fewer way points, whose curve passes all present ones within a tolerance.

        Way points with a stop stay. The track of a phone has a way point per second, far more than a curve
        needs.
        """
        xy_m = self.xy_m
        last = len(self.way_points) - 1
        indices = {0, last} | {index for index, point in enumerate(self.way_points) if point.pause_s}
        if self.is_loop:
            indices |= {last // 3, 2 * last // 3}
        while strays := set(_strays(xy_m, sorted(indices), tolerance_m)) - indices:
            indices |= strays
        return replace(self, way_points=tuple(self.way_points[index] for index in sorted(indices)))

    def settings(self, first: "Draft", walk: Walk) -> dict[str, object]:
        """Return the keys of a scene that this draft changes, with their values.

        Parameters
        ----------
        first : draft of the scene
        walk : motion of the scene
        """
        changed = dict[str, object]()
        if self.way_points != first.way_points:
            changed["motion.way_points_m"] = [[point.x_m, point.y_m] for point in self.way_points]
            stops = [
                {"way_point": number, "pause_s": point.pause_s}
                for number, point in enumerate(self.way_points, start=1)
                if point.pause_s
            ]
            stops += [stop.model_dump(exclude_none=True) for stop in walk.stops if stop.at_m is not None]
            if stops or walk.stops:
                changed["motion.stops"] = stops
        if self.run_time_s is not None and self.run_time_s != first.run_time_s:
            changed["motion.run_time_s"] = self.run_time_s
        elif self.run_time_s is None and (self.speed_m_s, None) != (first.speed_m_s, first.run_time_s):
            changed["motion.speed_m_s"] = self.speed_m_s
        for key in ("laps", "back_and_forth"):
            if getattr(self, key) != getattr(first, key):
                changed[f"motion.{key}"] = getattr(self, key)
        return changed


def walk_of(scenario: Scenario) -> Walk:
    """Return the table `[motion]` of a scene; InputError if it is no walk."""
    walk = scenario.motion
    if not isinstance(walk, Walk):
        raise InputError("motion.kind", f"found {walk.kind}", "walk, whose path is drawn through way points")
    return walk


class Versions:
    """A list of drafts and the current one among them: each change can be undone and redone."""

    def __init__(self, first: Draft) -> None:
        self._drafts = [first]
        self._at = 0

    @property
    def first(self) -> Draft:
        """The draft of the scene."""
        return self._drafts[0]

    @property
    def draft(self) -> Draft:
        """The current draft."""
        return self._drafts[self._at]

    def change(self, draft: Draft) -> None:
        """Make another draft the current one; undone drafts are dropped."""
        if draft != self.draft:
            self._at += 1
            self._drafts[self._at :] = [draft]

    def step(self, count: int) -> None:
        """Redo `count` changes, or undo as many if it is negative, as far as there are any."""
        self._at = min(max(self._at + count, 0), len(self._drafts) - 1)


def plan_of(xy_m: F8) -> Path | None:
    """Return the path through way points (n, 2) on level ground; None if a turn is too tight to walk."""
    try:
        return level_path(xy_m)
    except InputError:
        return None


def _gap_m(first: WayPoint, second: WayPoint) -> float:
    return float(norm(np.array(first[:2]) - np.array(second[:2])))


def _strays(xy_m: F8, indices: list[int], tolerance_m: float) -> Iterator[int]:
    """Yield the way point of each leg that is farthest from the curve through `indices`, if it is too far."""
    plan = plan_of(xy_m[indices])
    for leg, (begin, end) in enumerate(pairwise(indices)):
        if end - begin < 2:
            continue
        line_m = xy_m[[begin, end]]
        if plan is not None:
            first, last = plan.way_point_rows[leg : leg + 2]
            line_m = plan.xy_m[first : last + 1]
        gap_m = Polyline(line_m).distance_m(xy_m[begin + 1 : end])
        if gap_m.max() > tolerance_m:
            yield begin + 1 + int(gap_m.argmax())
