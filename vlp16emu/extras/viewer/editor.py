"""Path editor of the page: a gizmo for each way point, and a panel for how it is walked."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import viser

from vlp16emu.errors import Vlp16emuError
from vlp16emu.extras.viewer.draft import Course, Draft, Outlook

_FARTHEST_M = 10_000.0  # limit of a way point from the scene's origin: no hand drags it farther
_GAITS = ("as in the scene", "none", "paper", "natural", "strong")
_RAISED_M = 0.15
_GOOD, _BAD = (30, 90, 220), (220, 30, 30)


class Editor:
    """Gizmos and panel of a draft that is saved `to` a file; `step` executes their requests on the thread that draws."""

    def __init__(self, server: viser.ViserServer, draft: Draft, duration_s: float, to: Path | None) -> None:
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
        """Return the way point that the panel shows, from 0."""
        number = self._number.value
        last = len(self._draft.course.points) - 1
        return min(max(int(number) - 1, 0), last) if math.isfinite(number) else 0

    def _as_in_panel(self, course: Course, number: int) -> Course:
        """Return the course with speed, laps, gait, harness and stop of the panel."""
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
        """Draw the course, and report what it leads to."""
        course = self._draft.course
        outlook = self._draft.outlook(course)
        with self._server.atomic():
            self._show_points(course)
            self._show_path(outlook)
        self._speed.value, self._laps.value = course.speed_m_s, course.laps
        self._gait.value, self._harness.value = course.gait or _GAITS[0], course.harness
        self._pause.value = course.points[self._chosen()][2]
        lines = [outlook.fault] if outlook.fault else self._figures(outlook)
        if outlook.in_the_way_m is not None and (stems := len(outlook.in_the_way_m)):
            lines.append(f"**{stems} stems in the way**")
        self._text.content = "  \n".join([*lines, self._note])

    def _figures(self, outlook: Outlook) -> list[str]:
        lines = [f"path: {outlook.length_m:.1f} m", f"run time: {outlook.run_time_s:.1f} s"]
        lines += [f"revolutions: {outlook.revolutions:.0f}", f"data packets: {outlook.packets}"]
        if outlook.run_time_s > self._duration_s:
            lines.append(f"recorded: the first {self._duration_s:g} s, which is the scene's duration")
        return lines

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
        """Draw the path on the ground, the stems in its way, and the place of a fault."""
        scene = self._server.scene
        if outlook.path_m is not None:
            line_m = outlook.path_m + np.array([0.0, 0.0, _RAISED_M])
            segments_m = np.stack([line_m[:-1], line_m[1:]], axis=1)
            scene.add_line_segments("/draft", segments_m, _GOOD, thickness=0.12)
        marked = (marks for marks in (outlook.in_the_way_m, outlook.fault_m) if marks is not None)
        marks_m = np.concatenate([np.zeros((0, 3)), *marked])
        scene.add_point_cloud("/in_the_way", marks_m, _BAD, point_size=0.6, point_shape="circle", precision="float32")
