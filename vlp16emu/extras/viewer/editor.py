"""Path editor of the page: versions of a path, what they lead to, the scene file with it, gizmos and a panel."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from threading import Event
from typing import Any

import numpy as np
import viser

from vlp16emu.errors import InputError, OutputError, Vlp16emuError
from vlp16emu.extras.sheets.survey import Survey
from vlp16emu.extras.walk import Walk
from vlp16emu.extras.walk.path import Path
from vlp16emu.extras.walk.route import Route
from vlp16emu.extras.walk.way_points import way_points
from vlp16emu.foliage.polyline import Corridor
from vlp16emu.forest.ground.dem import DemHeights
from vlp16emu.forest.settings import Woods
from vlp16emu.forest.stand.stand import foot_discs, path_gap_m
from vlp16emu.output import OutputFile
from vlp16emu.scenario import Scenario, find, load, named_files
from vlp16emu.types import F8
from vlp16emu.world.vectors import places_m

Point = tuple[float, float, float]  # x and y in the world (m), and how long the person stops there (s)


@dataclass(frozen=True, slots=True)
class Course:
    """A path, and how a person walks it."""

    points: tuple[Point, ...]
    speed_m_s: float
    laps: int
    gait: str | None  # preset; None for the gait of the scene
    harness: bool  # whether the pack hangs loose

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
    path_m: F8 | None = None  # (n, 3) on the ground; None if nobody can walk it
    in_the_way_m: F8 | None = None  # (m, 3) feet of stems nearer than `path_clearance_m`
    fault: str = ""  # why nobody can walk it
    fault_m: F8 | None = None  # (1, 3) place of the fault on the ground


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
            stops += [{"at_m": one.at_m, "pause_s": one.pause_s} for one in self._walk.stops if one.at_m is not None]
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
        near = self._seen.trees
        if isinstance(scenario.world, Woods) and len(near):
            corridor, table = Corridor(path.xy_m, scenario.world.path_clearance_m), self._seen.plants.trees
            near = near[path_gap_m(near, foot_discs(near, table=table)[:, 2], corridor) < corridor.clearance_m]
        return Outlook(
            run_time_s=route.run_time_s,
            length_m=route.length_m,
            path_m=np.column_stack([path.xy_m, ground.height_m(*path.xy_m.T)]),
            in_the_way_m=places_m(near),
        )

    def save(self, to: FilePath) -> None:
        """Write the scene file with the current course; comments and other keys stay as the user wrote them.

        InputError if the course is no walk; OutputError if the file cannot be written, or would not find the scene's files.
        """
        import tomlkit

        scenario, folder = self.scenario(self.course), self._file.parent.absolute()
        if to.suffix != ".toml" or (named_files(scenario) and to.parent.absolute() != folder):
            raise OutputError(str(to), "cannot hold the scene", f"a .toml file in {folder}, beside its files")
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


_FARTHEST_M = 10_000.0  # limit of a way point from the scene's origin: no hand drags it farther
_GAITS = ("as in the scene", "none", "paper", "natural", "strong")
_RAISED_M = 0.15
_GOOD, _BAD = (30, 90, 220), (220, 30, 30)


class Editor:
    """Gizmos and panel of a draft that is saved `to` a file; `step` executes their requests on the thread that draws."""

    def __init__(self, server: viser.ViserServer, draft: Draft, duration_s: float, to: FilePath | None) -> None:
        self.wake = Event()  # set when there is a request
        self._server, self._draft = server, draft
        self._duration_s, self._to = duration_s, to
        self._asked: list[Callable[[], Course | None]] = []
        self._gizmos: list[viser.TransformControlsHandle] = []
        self._note = ""
        self._panel()
        self._show()

    def _panel(self) -> None:
        gui, course = self._server.gui, self._draft.course
        with gui.add_folder("Path"):
            self._number = gui.add_number("way point", 1, min=1, step=1)
            self._pause = gui.add_number("stop there, s", course.points[0][2], min=0.0, step=1.0)
            for label, make in ("add after it", Course.added), ("remove it", Course.removed):
                self._ask_on(gui.add_button(label).on_click, make)
            self._speed = gui.add_number("speed, m/s", course.speed_m_s, min=0.1, max=10.0, step=0.1)
            self._laps = gui.add_number("laps", course.laps, min=1, max=1000, step=1)
            self._gait = gui.add_dropdown("gait", _GAITS, initial_value=_GAITS[0])
            self._harness = gui.add_checkbox("loose harness", course.harness)
            for control in (self._pause, self._speed, self._laps, self._gait, self._harness):
                self._ask_on(control.on_update, self._as_in_panel)
            self._number.on_update(lambda _: self.ask(lambda: None))
            gui.add_button("undo").on_click(lambda _: self.ask(self._draft.undo))
            gui.add_button("redo").on_click(lambda _: self.ask(self._draft.redo))
            save = gui.add_button("save", disabled=self._to is None, hint="to the file of --save")
            save.on_click(lambda _: self.ask(self._save))
            self._text = gui.add_markdown("")

    def _ask_on(self, event: Callable[[Any], Any], make: Callable[[Course, int], Course]) -> None:
        """Request a new course when a user acts, and not when the panel follows a change."""

        def done(by: viser.GuiEvent[Any]) -> None:
            if by.client is not None:
                self.ask(lambda: make(self._draft.course, self._chosen()))

        event(done)

    def ask(self, what: Callable[[], Course | None]) -> None:
        """Request something of the thread that draws: it may return another course."""
        self._asked.append(what)
        self.wake.set()

    def _chosen(self) -> int:
        number = self._number.value
        last = len(self._draft.course.points) - 1
        return min(max(int(number) - 1, 0), last) if math.isfinite(number) else 0

    def _as_in_panel(self, course: Course, number: int) -> Course:
        gait = None if self._gait.value == _GAITS[0] else str(self._gait.value)
        speed_m_s, laps = float(self._speed.value), int(self._laps.value)
        walked = replace(course, speed_m_s=speed_m_s, laps=laps, gait=gait, harness=self._harness.value is True)
        return walked.stopped(number, float(self._pause.value))

    def step(self) -> bool:
        """Execute the requests and show their result; return whether there was any."""
        asked, self._asked = self._asked, []
        if not asked:
            return False
        self._note = ""
        for what in asked:
            try:
                course = what()
            except Vlp16emuError as error:
                self._note = str(error)
                continue
            except (TypeError, ValueError, OverflowError, AttributeError):
                continue  # a hostile message may hold anything
            if course is not None:
                self._draft.change(course)
        self._show()
        return True

    def _save(self) -> None:
        if self._to is None:
            return
        self._draft.save(self._to)
        self._note = f"saved {self._to.name}"

    def _show(self) -> None:
        course = self._draft.course
        outlook = self._draft.outlook(course)
        with self._server.atomic():
            self._show_points(course)
            self._show_path(outlook)
        self._speed.value, self._laps.value = course.speed_m_s, course.laps
        self._gait.value, self._harness.value = course.gait or _GAITS[0], course.harness
        self._pause.value = course.points[self._chosen()][2]
        lines = [f"path: {outlook.length_m:.1f} m", f"run time: {outlook.run_time_s:.1f} s"]
        if outlook.fault:
            lines = [outlook.fault]
        elif outlook.run_time_s > self._duration_s:
            lines.append(f"recorded: the first {self._duration_s:g} s, which is the scene's duration")
        if outlook.in_the_way_m is not None and (stems := len(outlook.in_the_way_m)):
            lines.append(f"**{stems} stems in the way**")
        self._text.content = "  \n".join([*lines, self._note])

    def _show_points(self, course: Course) -> None:
        while len(self._gizmos) > len(course.points):
            self._gizmos.pop().remove()
        for number, (x_m, y_m, _) in enumerate(course.points):
            place_m = (x_m, y_m, self._draft.height_m(x_m, y_m) + _RAISED_M)
            if number == len(self._gizmos):
                self._gizmos.append(self._gizmo(number))
            self._gizmos[number].position = place_m

    def _gizmo(self, number: int) -> viser.TransformControlsHandle:
        """Add the gizmo of a way point; it slides level, and goes to the ground when it is let go."""
        look: dict[str, Any] = {"scale": 1.6, "line_width": 4.0, "disable_rotations": True, "depth_test": False}
        level = (True, True, False)
        gizmo = self._server.scene.add_transform_controls(f"/way_points/{number + 1}", active_axes=level, **look)
        self._server.scene.add_label(f"/way_points/{number + 1}/name", str(number + 1))

        def dropped() -> Course | None:
            x_m, y_m = (float(gizmo.position[axis]) for axis in (0, 1))
            points = self._draft.course.points
            if number >= len(points) or not (abs(x_m) <= _FARTHEST_M and abs(y_m) <= _FARTHEST_M):
                return None
            return self._draft.course.moved(number, x_m, y_m)

        gizmo.on_update(lambda event: self.ask(dropped) if event.phase == "end" else None)
        return gizmo

    def _show_path(self, outlook: Outlook) -> None:
        scene = self._server.scene
        if outlook.path_m is not None:
            line_m = outlook.path_m + np.array([0.0, 0.0, _RAISED_M])
            segments_m = np.stack([line_m[:-1], line_m[1:]], axis=1)
            scene.add_line_segments("/draft", segments_m, _GOOD, thickness=0.12)
        marked = (marks for marks in (outlook.in_the_way_m, outlook.fault_m) if marks is not None)
        marks_m = np.concatenate([np.zeros((0, 3)), *marked])
        scene.add_point_cloud("/in_the_way", marks_m, _BAD, point_size=0.6, point_shape="circle", precision="float32")
