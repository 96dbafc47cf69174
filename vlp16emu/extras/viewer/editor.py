"""Path editor of the page: way points to drag over the ground, the curve through them, and its panel."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from html import escape
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from vlp16emu.errors import InputError, Vlp16emuError
from vlp16emu.extras.survey import Survey
from vlp16emu.extras.viewer.draft import Draft, Versions, walk_of
from vlp16emu.extras.viewer.layers import html_box
from vlp16emu.extras.viewer.outlook import PER_S, Kind, Outlook, Surroundings
from vlp16emu.extras.viewer.scene_file import write_scene
from vlp16emu.extras.walk.settings import Walk
from vlp16emu.run.emulator import Emulator
from vlp16emu.scenario import Scenario, load
from vlp16emu.trees import Tree
from vlp16emu.types import F8, U1
from vlp16emu.units import count_text

_FARTHEST_M = 10_000.0  # limit of a way point from the scene's origin: nobody drags it farther
_GIZMOS = 24  # way points that all have arrows; of more only the selected one, as arrows hide the path
_DOTS = 100  # places along the curve that insert a way point
_RAISED_M = 0.3  # height of the path over the ground, so that the ground does not hide it
_PREVIEW_S = 600.0  # part of a walk whose stand is drawn, if less is recorded: a browser draws some 100 m
_LISTED_EM = 12  # height of the list of marks, which scrolls
_CLEAR: tuple[int, int, int] = (30, 90, 220)
_SELECTED: tuple[int, int, int] = (255, 255, 255)
_RGB: dict[Kind, tuple[int, int, int]] = {
    "unknown": (130, 130, 130),
    "left out": (240, 150, 20),
    "stays": (200, 30, 160),
    "refused": (220, 30, 30),
}
"""Colours of marks, from the least to the most serious."""
_MEANING: dict[Kind, str] = {
    "unknown": "beyond the stand that is drawn",
    "left out": "in the way, left out of the stand that is recorded",
    "stays": "in the way: the sensor goes through it",
    "refused": "so that it cannot be recorded",
}
_BALL = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], np.float32)
_BALL_FACES = [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)]
_BALL_M = 0.35  # radii of the octahedra of way points and of dots
_DOT_M = 0.12


@dataclass(frozen=True, slots=True)
class OpenScene:
    """A scene that is open in the editor."""

    file: Path
    settings: Sequence[str]  # of the command line
    scenario: Scenario  # with these settings
    inputs: Sequence[Path]  # files that must not be replaced
    to: Path | None  # file to save it in; None if the user named none

    def walkable(self, error: InputError) -> Scenario:
        """Return the scene with as many of its way points as a person can walk along; raise `error` if none.

        A phone records a position each second, with an error of metres: nobody walks through all of them.
        """
        walk = self.scenario.motion
        if not isinstance(walk, Walk):
            raise error
        first = Draft.of(self.scenario)
        site = self.scenario.world.site(self.scenario.world_seed)
        for tolerance_m in (0.5, 1.0, 2.0, 4.0):
            settings = first.simplify(tolerance_m).settings(first, walk)
            scenario = load(self.scenario, settings)
            try:
                walk_of(scenario).route(site, scenario.gps, is_stored=False)
            except InputError:
                continue
            return scenario
        raise error


class Editor:
    """Way points of a draft in the scene, and its panel.

    A thread of its own changes the draft, one request after another, and shows the outlook of the last
    change. The preview grows the stand in another thread.

    Parameters
    ----------
    server : page
    open_scene : scene with the first draft
    emulator : the scene for which the stand is drawn
    stand : its stand
    show : draws sweeps and stand of another emulator, and returns its stand
    """

    def __init__(
        self,
        server: viser.ViserServer,
        open_scene: OpenScene,
        emulator: Emulator,
        stand: Survey,
        show: Callable[[Emulator], Survey],
    ) -> None:
        self._server = server
        self._scene = open_scene
        self._emulator = emulator
        self._show_stand = show
        self._around = Surroundings(open_scene.scenario, emulator.parts.units, stand)
        self._versions = Versions(Draft.of(open_scene.scenario))
        self._versions.change(Draft.of(emulator.scenario))
        self._grown_draft = self._versions.draft
        self._saved_draft = self._versions.first
        self._dragged: Draft | None = None  # the draft while a way point is dragged
        self._selected = 0  # number of the selected way point, from 0
        self._is_growing = False
        self._note = ""
        if self._grown_draft != self._saved_draft:
            count = len(self._saved_draft.way_points)
            count_left = len(self._grown_draft.way_points)
            self._note = (
                f"Nobody can walk through all {count} way points; {count_left} are left. Undo shows why."
            )
        self._requests: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._gizmos: list[viser.TransformControlsHandle] = []
        self._names: list[viser.LabelHandle] = []
        self._balls: viser.BatchedMeshHandle | None = None
        self._dots: viser.BatchedMeshHandle | None = None
        self._build_panel()
        self._show()
        Thread(target=self._run, name="path editor", daemon=True).start()

    def _build_panel(self) -> None:
        gui = self._server.gui
        draft = self._versions.draft
        to = self._scene.to
        with gui.add_folder("Path", order=0.0):  # before the sweeps, whose legend may be long
            self._text = gui.add_html("")
            ends = {"preview": self._begin_preview} | ({} if to is None else {"save": self._save})
            self._add_buttons(ends, "preview grows the stand along this path, and shows its sweeps")
            self._number = gui.add_number("way point", 1, min=1, step=1, hint="or click one in the scene")
            self._pause = gui.add_number("stop there, s", draft.way_points[0].pause_s, min=0.0, step=1.0)
            changes = {"insert": self._insert_after, "delete": self._delete}
            self._add_buttons(changes, "or click a dot of the curve")
            steps = {"undo": lambda: self._versions.step(-1), "redo": lambda: self._versions.step(1)}
            self._add_buttons(steps)
            self._loop = gui.add_checkbox("loop", draft.is_loop)
            self._return = gui.add_checkbox("there and back", draft.back_and_forth)
            self._laps = gui.add_number("laps", draft.laps, min=1, max=1000, step=1)
            self._speed = gui.add_number("speed, m/s", draft.speed_m_s, min=0.1, max=10.0, step=0.1)
            self._time = gui.add_number(
                "run time, s", draft.run_time_s or 0.0, min=0.0, step=1.0, hint="0: by the speed"
            )
            hint = "instead of the scene's duration"
            self._record_all = gui.add_checkbox("record all of it", draft.is_whole, hint=hint)
            self._tolerance = gui.add_number("tolerance, m", 1.0, min=0.05, max=20.0, step=0.25)
            self._add_buttons({"simplify": self._simplify}, "fewer way points, within the tolerance")
        checkboxes = self._loop, self._return, self._record_all
        for control in (self._pause, self._laps, self._speed, self._time, *checkboxes):
            self._on_user(control, self._read_panel)
        self._on_user(self._number, lambda: self._choose(int(_clip(self._number.value, 1, 1e6)) - 1))

    def _add_buttons(self, requests: dict[str, Callable[[], None]], hint: str | None = None) -> None:
        """Add a row of buttons, each with its request."""
        buttons = self._server.gui.add_button_group("", tuple(requests), hint=hint)

        def on_click(event: viser.GuiEvent[Any]) -> None:
            self._requests.put(partial(self._press, requests, event.target.value))

        buttons.on_click(on_click)

    def _press(self, requests: dict[str, Callable[[], None]], name: str) -> None:
        requests[name]()  # KeyError for a name that a client has made up

    def _on_user(self, control: Any, request: Callable[[], None]) -> None:
        """Make a request when a user sets a control, and not when the panel follows a change."""

        def on_update(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                self._requests.put(request)

        control.on_update(on_update)

    def _run(self) -> None:
        """Execute requests without end, and show the result of all that wait together."""
        while True:
            request = self._requests.get()
            self._execute(request)
            while not self._requests.empty():
                self._execute(self._requests.get())
            self._show()

    def _execute(self, request: Callable[[], None]) -> None:
        self._note = ""
        try:
            request()
        except Vlp16emuError as error:
            self._note = str(error)
        except (AssertionError, LookupError, OverflowError, TypeError, ValueError):
            self._note = "no such value"  # a client may send anything

    def _choose(self, number: int) -> None:
        self._selected = number

    def _insert_after(self) -> None:
        """Insert a way point on the curve, near the middle of the leg after the selected one."""
        draft = self._versions.draft
        last = len(draft.way_points) - 1
        leg = min(self._selected, last - 1)
        ends_m = draft.xy_m[[leg, leg + 1]]
        path_m = self._around.outlook(draft).path_m[:, :2]
        gap_m = np.abs(path_m - ends_m.mean(axis=0)).sum(axis=1)
        self._insert(*path_m[gap_m.argmin()].tolist())

    def _insert(self, x_m: float, y_m: float) -> None:
        draft, self._selected = self._versions.draft.insert(x_m, y_m)
        self._versions.change(draft)

    def _delete(self) -> None:
        self._versions.change(self._versions.draft.remove(self._selected))

    def _simplify(self) -> None:
        tolerance_m = _clip(self._tolerance.value, 0.05, 20.0)
        self._versions.change(self._versions.draft.simplify(tolerance_m))

    def _read_panel(self) -> None:
        """Change the draft to the values of the panel."""
        draft = self._versions.draft
        speed_m_s = _clip(self._speed.value, 0.1, 10.0)
        run_time_s: float | None = _clip(self._time.value, 0.0, 7 * 86_400)
        if not run_time_s or speed_m_s != draft.speed_m_s:  # a new speed replaces the run time
            run_time_s = None
        draft = replace(
            draft.set_stop(self._selected, _clip(self._pause.value, 0.0, 86_400)),
            speed_m_s=speed_m_s,
            run_time_s=run_time_s,
            laps=int(_clip(self._laps.value, 1, 1000)),
            back_and_forth=self._return.value is True,
            is_whole=self._record_all.value is True,
        )
        self._versions.change(draft.set_loop(is_loop=self._loop.value is True))

    def _save(self) -> None:
        scene = self._scene
        draft = self._versions.draft
        if scene.to is None:
            return
        changed = self._around.settings(draft)
        write_scene(scene.to, scene.file, scene.settings, changed, inputs=scene.inputs)
        self._saved_draft = draft
        self._note = f"Saved as {scene.to}"

    def _begin_preview(self) -> None:
        draft = self._versions.draft
        settings = self._around.settings(draft)
        if not self._is_growing:
            self._is_growing = True
            Thread(target=self._grow, args=(draft, settings), name="preview", daemon=True).start()

    def _grow(self, draft: Draft, settings: dict[str, object]) -> None:
        """Grow the stand around a draft, and show it with its sweeps."""
        note = ""
        try:
            walk_s = self._around.outlook(replace(draft, is_whole=True)).recorded_s
            duration_s = max(self._around.outlook(draft).recorded_s, min(walk_s, _PREVIEW_S))
            scenario = load(self._scene.scenario, settings | {"duration_s": duration_s})
            emulator = Emulator(scenario, threads=self._emulator.engine.threads, like=self._emulator)
            stand = self._show_stand(emulator)
            around = Surroundings(self._scene.scenario, emulator.parts.units, stand)
            self._requests.put(lambda: self._adopt_stand(draft, emulator, around))
        except Vlp16emuError as error:
            note = str(error)
        self._is_growing = False
        self._requests.put(lambda: self._set_note(note) if note else None)

    def _adopt_stand(self, draft: Draft, emulator: Emulator, around: Surroundings) -> None:
        """Compare later drafts with the stand that was grown around a draft."""
        self._grown_draft = draft
        self._emulator = emulator
        self._around = around

    def _set_note(self, note: str) -> None:
        self._note = note

    def _show(self) -> None:
        """Draw the draft, and set the panel to its values."""
        draft = self._dragged or self._versions.draft
        self._selected = min(max(self._selected, 0), len(draft.way_points) - 1)
        outlook = self._around.outlook(draft)
        with self._server.atomic():
            self._show_path(outlook)
            self._show_way_points(draft)
        self._text.content = self._summary(draft, outlook)
        selected = draft.way_points[self._selected]
        values: list[tuple[Any, object]] = [
            (self._number, self._selected + 1),
            (self._pause, selected.pause_s),
            (self._loop, draft.is_loop),
            (self._return, draft.back_and_forth),
            (self._laps, draft.laps),
            (self._speed, draft.speed_m_s),
            (self._time, draft.run_time_s or 0.0),
            (self._record_all, draft.is_whole),
        ]
        for control, value in values:
            if control.value != value:
                control.value = value

    def _summary(self, draft: Draft, outlook: Outlook) -> str:
        """Return the text of the panel as HTML."""
        count = f"{len(draft.way_points) - draft.is_loop} way points"
        lines = [f"<b>{outlook.length_m:.1f} m in {outlook.run_time_s:.1f} s</b>, {count}"]
        if not outlook.length_m:
            lines = [f"<b>nobody can walk this</b>, {count}"]
        else:
            is_whole = outlook.run_time_s - outlook.recorded_s < 1 / PER_S
            part = "all of it" if is_whole else f"the first {outlook.recorded_s:.1f} s"
            data = count_text(outlook.data_packets)
            position = count_text(outlook.position_packets)
            lines.append(f"recorded: {part}, {count_text(round(outlook.revolutions))} revolutions,")
            lines.append(f"{data} data and {position} position packets")
        if self._is_growing:
            lines.append("growing the stand along the path ...")
        elif draft != self._grown_draft:
            lines.append("stand and sweeps are those of an earlier path: see preview")
        if self._scene.to is None:
            lines.append("to save it, start with --save FILE.toml")
        elif draft != self._saved_draft:
            lines.append("not saved")
        if self._note:
            lines.append(f"<b>{escape(self._note)}</b>")
        return html_box(lines) + _list_of_marks(outlook)

    def _show_path(self, outlook: Outlook) -> None:
        line_m = outlook.path_m + np.array([0.0, 0.0, _RAISED_M])
        rgb = np.tile(np.array(_CLEAR, np.uint8), (len(line_m), 1))
        for kind, colour in _RGB.items():
            for mark in outlook.marks:
                if mark.kind == kind:
                    rgb[mark.rows] = colour
        segments_m = np.stack([line_m[:-1], line_m[1:]], axis=1)
        colours = np.stack([rgb[:-1], rgb[1:]], axis=1)
        scene = self._server.scene
        scene.add_line_segments("/draft", segments_m, colours, thickness=5.0, thickness_units="screen")
        rows = np.linspace(0, len(line_m) - 1, _DOTS + 2).astype(np.int64)[1:-1]
        self._dots = self._draw_balls("/dots", self._dots, line_m[rows], _DOT_M, rgb[rows], self._click_dot)

    def _show_way_points(self, draft: Draft) -> None:
        shown_m = self._around.on_ground(draft.xy_m[:-1] if draft.is_loop else draft.xy_m)
        shown_m[:, 2] += _RAISED_M
        rgb = np.tile(np.array(_CLEAR, np.uint8), (len(shown_m), 1))
        rgb[[way_point.pause_s > 0 for way_point in draft.way_points[: len(shown_m)]]] = (0, 190, 190)
        rgb[self._selected % len(shown_m)] = _SELECTED
        radius_m = min(_BALL_M, 20.0 * _BALL_M / len(shown_m))  # of many way points no ball hides the path
        self._balls = self._draw_balls("/way_points", self._balls, shown_m, radius_m, rgb, self._choose)
        is_few = len(shown_m) <= _GIZMOS
        count = len(shown_m) if is_few else 1
        first = 0 if is_few else self._selected % len(shown_m)
        while len(self._gizmos) > count:
            self._gizmos.pop().remove()
            self._names.pop()
        while len(self._gizmos) < count:
            self._add_gizmo(len(self._gizmos))
        for index, gizmo in enumerate(self._gizmos):
            is_selected = first + index == self._selected
            self._names[index].text = f"{first + index + 1}{' chosen' if is_selected else ''}"
            if self._dragged is None or not is_selected:
                gizmo.position = shown_m[first + index]
        self._first_gizmo = first

    def _draw_balls(
        self,
        name: str,
        balls_before: viser.BatchedMeshHandle | None,
        positions_m: F8,
        radius_m: float,
        rgb: U1,
        request: Callable[[int], None],
    ) -> viser.BatchedMeshHandle:
        """Draw balls that can be clicked, or move the earlier ones if their number is the same."""
        if balls_before is not None and len(balls_before.batched_positions) == len(positions_m):
            balls_before.batched_positions = positions_m.astype(np.float32)
            balls_before.batched_colors = rgb
            return balls_before
        upright = np.tile(np.array([1.0, 0.0, 0.0, 0.0], np.float32), (len(positions_m), 1))
        look: Tree = {"lod": "off", "flat_shading": True}
        look |= dict.fromkeys(("cast_shadow", "receive_shadow"), False)
        faces: NDArray[np.uint32] = np.array(_BALL_FACES, np.uint32)
        balls = self._server.scene.add_batched_meshes_simple(
            name, radius_m * _BALL, faces, upright, positions_m, batched_colors=rgb, **look
        )

        def on_click(event: viser.SceneNodePointerEvent[Any]) -> None:
            if event.instance_index is not None:
                self._requests.put(partial(request, event.instance_index))

        balls.on_click(on_click)
        return balls

    def _click_dot(self, number: int) -> None:
        assert self._dots is not None
        x_m, y_m, _ = self._dots.batched_positions[number].tolist()
        self._insert(x_m, y_m)

    def _add_gizmo(self, index: int) -> None:
        """Add arrows that drag a way point horizontally; it drops to the ground when it is released."""
        scene = self._server.scene
        name = f"/gizmos/{index}"
        look: Tree = {"scale": 1.6, "line_width": 4.0}
        look |= {"disable_rotations": True, "depth_test": False}
        gizmo = scene.add_transform_controls(name, active_axes=(True, True, False), **look)

        async def on_drag(event: viser.TransformControlsEvent) -> None:  # coroutines stay in order
            x_m, y_m, _ = gizmo.position.tolist()
            number = self._first_gizmo + index
            is_end = event.phase == "end"
            self._requests.put(lambda: self._drag(number, x_m, y_m, is_end=is_end))

        gizmo.on_update(on_drag)
        self._gizmos.append(gizmo)
        self._names.append(scene.add_label(f"{name}/name", str(index + 1)))

    def _drag(self, number: int, x_m: float, y_m: float, *, is_end: bool) -> None:
        if not (abs(x_m) <= _FARTHEST_M and abs(y_m) <= _FARTHEST_M):  # False for NaN
            return
        draft = self._versions.draft.move(number, x_m, y_m)
        self._selected = number
        self._dragged = None if is_end else draft
        if is_end:
            self._versions.change(draft)


def _list_of_marks(outlook: Outlook) -> str:
    """Return the marks as HTML, listed by kind, the most serious first."""
    parts = []
    for kind in reversed(_RGB):
        words = [escape(mark.words) for mark in outlook.marks if mark.kind == kind]
        if words:
            style = f"color:rgb{_RGB[kind]};font-weight:bold"
            parts.append(html_box([f'<span style="{style}">{len(words)} {_MEANING[kind]}</span>', *words]))
    return f'<div style="max-height:{_LISTED_EM}em;overflow-y:auto">{"".join(parts)}</div>' if parts else ""


def _clip(value: object, low: float, high: float) -> float:
    """Return a number that a client sent, within limits; the lower one for NaN."""
    assert isinstance(value, int | float)
    return float(min(max(low, value), high)) if math.isfinite(value) else low
