"""A path that is being drawn: its versions, what they lead to, and the scene file with it."""

from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from vlp16emu.errors import InputError, OutputError
from vlp16emu.extras.sheets.survey import Survey
from vlp16emu.forest.ground.dem import DemHeights
from vlp16emu.forest.settings import Woods
from vlp16emu.forest.stand.stand import foot_discs, path_gap_m
from vlp16emu.motion.path import Path
from vlp16emu.motion.route import Route
from vlp16emu.motion.settings import Walk
from vlp16emu.motion.way_points import way_points
from vlp16emu.output import OutputFile
from vlp16emu.packets import BLOCKS_PER_PACKET, SEQUENCES_PER_BLOCK
from vlp16emu.scenario import Scenario, find, load
from vlp16emu.scenario.find import named_files
from vlp16emu.sensor.beams import SEQUENCE_NS
from vlp16emu.sensor.settings import Sensor
from vlp16emu.types import F8
from vlp16emu.units import S_NS
from vlp16emu.world.polyline import Corridor
from vlp16emu.world.vectors import places_m

Point = tuple[float, float, float]
"""x and y in the world (m), and how long the person stops there (s)."""


@dataclass(frozen=True, slots=True)
class Course:
    """A path, and how a person walks it."""

    points: tuple[Point, ...]
    speed_m_s: float
    laps: int
    gait: str | None
    """Preset; None for the gait of the scene."""
    harness: bool
    """Whether the pack hangs loose."""

    def moved(self, number: int, x_m: float, y_m: float) -> "Course":
        """Return the course with a way point elsewhere, to the mm; the stop there goes with it."""
        return self._with(number, (round(x_m, 3), round(y_m, 3), self.points[number][2]))

    def stopped(self, number: int, pause_s: float) -> "Course":
        """Return the course with a stop at a way point."""
        return self._with(number, (*self.points[number][:2], pause_s))

    def added(self, number: int) -> "Course":
        """Return the course with a way point after one: half-way to the next, or beyond the last by the length of the last leg."""
        (x_m, y_m, _), is_last = self.points[number], number == len(self.points) - 1
        other, part = (self.points[number - 1], -1.0) if is_last else (self.points[number + 1], 0.5)
        there = round(x_m + part * (other[0] - x_m), 3), round(y_m + part * (other[1] - y_m), 3), 0.0
        return self._with(number, self.points[number], there)

    def removed(self, number: int) -> "Course":
        """Return the course without a way point, if more than two are left."""
        return self._with(number) if len(self.points) > 2 else self

    def _with(self, number: int, *points: Point) -> "Course":
        return replace(self, points=(*self.points[:number], *points, *self.points[number + 1 :]))


@dataclass(frozen=True, slots=True)
class Outlook:
    """Result of a course, computed without growing anything."""

    run_time_s: float = 0.0
    length_m: float = 0.0
    revolutions: float = 0.0
    packets: int = 0
    """Data packets of the first sensor."""
    path_m: F8 | None = None
    """(n, 3) on the ground; None if nobody can walk it."""
    in_the_way_m: F8 | None = None
    """(m, 3) feet of stems nearer than `path_clearance_m`."""
    fault: str = ""
    """Why nobody can walk it."""
    fault_m: F8 | None = None
    """(1, 3) place of the fault on the ground."""


class Draft:
    """The courses drawn in a scene, with undo and redo; InputError if the scene's motion is no walk."""

    def __init__(self, scene: str, scenario: Scenario, seen: Survey) -> None:
        walk = scenario.motion
        if not isinstance(walk, Walk):
            raise InputError("motion.kind", f"found {walk.kind}", "walk, for a path to be drawn")
        self._file, self._scenario, self._walk, self._seen = find(scene), scenario, walk, seen
        self._ground = scenario.world.site(scenario.world_seed)
        self._origin_m = self._ground.origin_m[:2]
        plain = walk.model_copy(update={"back_and_forth": False})
        drawn = way_points(plain, scenario.gps, self._origin_m)
        points = tuple((x, y, pause) for x, y, pause in np.column_stack([drawn.xy_m, drawn.pause_s]).tolist())
        self._courses = [Course(points, walk.speed_m_s, walk.laps, None, walk.harness is not None)]
        self._at = 0

    def height_m(self, x_m: float, y_m: float) -> float:
        """Return the height of the ground."""
        return float(self._ground.height_m(np.array([x_m]), np.array([y_m]))[0])

    @property
    def course(self) -> Course:
        """The current course."""
        return self._courses[self._at]

    def change(self, course: Course) -> None:
        """Take another course; undone ones are forgotten."""
        if course != self.course:
            self._courses[self._at + 1 :] = [course]
            self._at += 1

    def undo(self) -> None:
        """Return to the course before, if there is one."""
        self._at = max(self._at - 1, 0)

    def redo(self) -> None:
        """Return to the course after, if there is one."""
        self._at = min(self._at + 1, len(self._courses) - 1)

    def changes(self, course: Course) -> dict[str, Any]:
        """Return the keys of `[motion]` that a course changes, None for one that it removes."""
        first, changed = self._courses[0], dict[str, Any]()
        if course.points != first.points:
            changed["way_points_m"] = [[x, y] for x, y, _ in course.points]
            changed |= dict.fromkeys(("way_points_file", "lawn_mower"))
            stops = [{"way_point": n, "pause_s": s} for n, (_, _, s) in enumerate(course.points, 1) if s]
            stops += [
                {"at_m": stop.at_m, "pause_s": stop.pause_s} for stop in self._walk.stops if stop.at_m is not None
            ]
            changed["stops"] = stops or None
        if course.speed_m_s != first.speed_m_s:
            changed |= {"speed_m_s": course.speed_m_s, "run_time_s": None}
        if course.laps != first.laps:
            changed["laps"] = course.laps
        if course.gait is not None:
            changed["gait"] = {"preset": course.gait}
        if course.harness != first.harness:
            changed["harness"] = {} if course.harness else None
        return changed

    def scenario(self, course: Course) -> Scenario:
        """Return the scene with a course; ScenarioError if its values are no walk."""
        changes = self.changes(course)
        dropped = {key: Walk.model_fields[key].get_default(call_default_factory=True) for key in changes}
        base = self._scenario.model_copy(update={"motion": self._walk.model_copy(update=dropped)})
        return load(base, {f"motion.{key}": value for key, value in changes.items() if value is not None})

    def outlook(self, course: Course) -> Outlook:
        """Return what a course leads to."""
        try:
            return self._outlook(self.scenario(course))
        except InputError as error:
            place = None if error.at_m is None else np.array([[*error.at_m, self.height_m(*error.at_m)]])
            return Outlook(fault=str(error), fault_m=place)

    def _outlook(self, scenario: Scenario) -> Outlook:
        walk, ground = scenario.motion, self._ground
        assert isinstance(walk, Walk)
        points = way_points(walk, scenario.gps, self._origin_m)
        path = Path(points.xy_m, ground.height_m)
        route = Route(path, walk, points.pause_s)
        if isinstance(ground, DemHeights):
            ground.check(path.xy_m, scenario.sensor.max_range_m)
        run_time_s, sensor = min(route.run_time_s, scenario.duration_s), scenario.sensor
        per_s = 0.0
        if isinstance(sensor, Sensor):
            blocks = 2 if sensor.return_mode == "dual" else 1
            per_s = blocks * S_NS / (BLOCKS_PER_PACKET * SEQUENCES_PER_BLOCK * SEQUENCE_NS)
        return Outlook(
            run_time_s=route.run_time_s,
            length_m=route.length_m,
            revolutions=run_time_s * sensor.rpm / 60.0,
            packets=int(run_time_s * per_s),
            path_m=np.column_stack([path.xy_m, ground.height_m(*path.xy_m.T)]),
            in_the_way_m=self._in_the_way_m(scenario, path.xy_m),
        )

    def _in_the_way_m(self, scenario: Scenario, path_xy_m: F8) -> F8:
        trees = self._seen.trees
        if not isinstance(scenario.world, Woods) or not len(trees):
            return np.zeros((0, 3))
        corridor = Corridor(path_xy_m, scenario.world.path_clearance_m)
        gap_m = path_gap_m(trees, foot_discs(trees, table=self._seen.plants.trees)[:, 2], corridor)
        near = trees[gap_m < corridor.clearance_m]
        return places_m(near)

    def save(self, to: FilePath) -> None:
        """Write the scene file with the current course; comments and other keys stay as the user wrote them.

        InputError if the course is no walk; OutputError if the file cannot be written, or would not find the scene's files.
        """
        import tomlkit

        scenario = self.scenario(self.course)
        self._check_place(to, scenario)
        document = tomlkit.parse(self._file.read_text(encoding="utf-8-sig"))
        motion: Any = document["motion"]
        for key, value in self.changes(self.course).items():
            if value is None:
                motion.pop(key, None)
            else:
                motion[key] = _written(value)
        text = tomlkit.dumps(document)
        with OutputFile(to) as output, output.writing() as file:
            file.write(text.encode())

    def _check_place(self, to: FilePath, scenario: Scenario) -> None:
        folder = self._file.parent.absolute()
        if to.suffix != ".toml" or (named_files(scenario) and to.parent.absolute() != folder):
            raise OutputError(str(to), "cannot hold the scene", f"a .toml file in {folder}, beside its files")


def _written(value: Any) -> Any:
    """Return a list of tables as TOML with one table to a line; anything else as it is."""
    import tomlkit

    if not isinstance(value, list) or not all(isinstance(row, dict) for row in value):
        return value
    rows = tomlkit.array().multiline(len(value) > 1)
    for row in value:
        table = tomlkit.inline_table()
        table.update(row)
        rows.append(table)
    return rows
