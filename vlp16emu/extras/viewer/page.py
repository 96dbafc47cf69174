"""The page: the stand, the path, and the sweep at the cursor's time."""

import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from vlp16emu.extras.sheets.survey import survey, way_m
from vlp16emu.extras.viewer.editor import Draft, Editor
from vlp16emu.extras.viewer.layers import boxed, coloured, layers_of_scan, legend_of
from vlp16emu.extras.viewer.stand import Piece, pieces_of
from vlp16emu.extras.viewer.sweeps import SceneSweeps, Sweep, Sweeps
from vlp16emu.extras.walk import Walk
from vlp16emu.forest.stand.forest import ForestWorld
from vlp16emu.run.emulator import Emulator
from vlp16emu.types import F8

_MOST_KEPT = 50  # sweeps drawn together: 1.2 million points
_LISTED = 6  # most faults of a sweep that are listed
_PATH = (220, 60, 40)


def draw_stand(server: viser.ViserServer, pieces: Iterable[Piece], way_m: F8, *, hall: bool) -> viser.FrameHandle:
    """Draw what stands along a path (n, 3), look at it from behind the start, and return the node above it."""
    scene = server.scene
    root = scene.add_frame("/stand", show_axes=False)
    scene.configure_default_lights(enabled=True, cast_shadow=False)
    scene.configure_environment_map(None)  # light of its own on each pixel, where a stand needs two lamps
    # A hall is looked into through its ceiling.
    look: dict[str, Any] = {"lod": "off", "flat_shading": True, "material": "toon5"}
    look |= {"cast_shadow": False, "receive_shadow": False, "side": "front" if hall else "double"}
    for piece in pieces:
        mesh = piece.vertices_m, piece.faces, piece.wxyz, piece.position_m
        own: dict[str, Any] = {"batched_scales": piece.scale, "batched_colors": piece.colour}
        scene.add_batched_meshes_simple(f"/stand/{piece.name}", *mesh, **own, **look)
    if len(way_m) > 1:
        scene.add_line_segments("/walk", np.stack([way_m[:-1], way_m[1:]], axis=1), _PATH, thickness=0.06)
    look_from(server, way_m[0], way_m[min(len(way_m) - 1, 60)] - way_m[0])
    return root


def look_from(server: viser.ViserServer, place_m: F8, ahead_m: F8) -> None:
    """Put the initial camera behind a place and over it."""
    away_m = math.hypot(*ahead_m[:2])
    east, north = ahead_m[:2] / away_m if away_m > 0 else (1.0, 0.0)
    camera = server.initial_camera
    camera.position = (place_m[0] - 22 * east, place_m[1] - 22 * north, place_m[2] + 16)
    camera.look_at = (place_m[0] + 6 * east, place_m[1] + 6 * north, place_m[2])


def scene_page(
    server: viser.ViserServer,
    scene: str,
    emulator: Emulator,
    *,
    unit: int = 1,
    radius_m: float = 25.0,
    save: Path | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> "Page":
    """Grow and draw a scene to a radius from its path; a walk's path can be drawn anew, and saved to a file.

    `progress` is called with the share of the stand that has grown. InputError if there is no such unit, or the stand
    cannot be grown.
    """
    text, scenario, parts = server.gui.add_markdown("growing the world"), emulator.scenario, emulator.parts
    bare = getattr(parts.world, "bare", parts.world)
    for share in bare.growing(way_m(scenario, parts.motion)) if isinstance(bare, ForestWorld) else ():
        progress(share)
        text.content = f"growing the world, {share:.0%} of its tiles"
    seen = survey(scenario, min(radius_m, scenario.sensor.max_range_m), parts)
    root = draw_stand(server, pieces_of(seen), seen.path_m, hall=seen.hall is not None)
    text.content, editor = "", None
    if isinstance(scenario.motion, Walk):
        editor = Editor(server, Draft(scene, scenario, seen), scenario.duration_s, save)
    return Page(server, SceneSweeps(emulator, unit), seen.species, root, editor)


class SweepView:
    """Points of sweeps by `layers` and the axes of their sensor, with their controls; `root` is the node of the stand."""

    def __init__(
        self,
        server: viser.ViserServer,
        layers: Sequence[str],
        species: Mapping[int, str],
        root: viser.FrameHandle | None,
    ) -> None:
        gui = server.gui
        self._scene, self._layers, self._species, self._root = server.scene, layers, species, root
        self._frame = server.scene.add_frame("/sensor", axes_length=0.6, axes_radius=0.02)
        self._layer = gui.add_dropdown("colour by", layers, initial_value=layers[0])
        self._legend = gui.add_html("")
        self._size = gui.add_slider("point, cm", 1.0, 20.0, 1.0, 5.0)
        self._stand = gui.add_checkbox("stand", initial_value=True, visible=root is not None)
        self.controls = self._layer, self._size, self._stand

    def draw(self, sweeps: Sequence[Sweep]) -> str:
        """Draw sweeps and the sensor's pose in the last one, and return what is drawn, in words.

        A value that a control cannot have, which only a hostile message sets, leaves the picture as it was.
        """
        size_cm, layer, scan = within(self._size.value, 0.1, 100.0), self._layer.value, sweeps[-1].scan
        if size_cm is None or layer not in self._layers:
            return ""
        points_m = np.concatenate([sweep.world_m for sweep in sweeps])
        middle_m = points_m.mean(axis=0) if len(points_m) else np.zeros(3)
        made = [coloured(sweep.scan, layer, self._species) for sweep in sweeps]
        look: dict[str, Any] = {"precision": "float32", "point_shape": "circle", "point_shading": "flat"}
        look |= {"point_size": size_cm / 100, "position": middle_m}
        rgb, shown_m = np.concatenate([colours for colours, _ in made]), (points_m - middle_m).astype(np.float32)
        self._scene.add_point_cloud("/sweep", shown_m, rgb, **look)
        if (world_T_sensor := scan.world_T_sensor) is not None:
            self._frame.position = world_T_sensor[:3, 3]
            self._frame.wxyz = Rotation.from_matrix(world_T_sensor[:3, :3]).as_quat(scalar_first=True)
        if self._root is not None:
            self._root.visible = self._stand.value is True
        legend = legend_of(made[-1][1])
        if legend != self._legend.content:
            self._legend.content = legend
        return f"{len(points_m):,} points by {layer}".replace(",", " ")


class Page:
    """Controls of sweeps, and the points of the current one; `root` is the node of the stand."""

    def __init__(
        self,
        server: viser.ViserServer,
        sweeps: Sweeps,
        species: Mapping[int, str],
        root: viser.FrameHandle | None = None,
        editor: Editor | None = None,
    ) -> None:
        self._server, self._sweeps, self._editor = server, sweeps, editor
        self._wake = Event() if editor is None else editor.wake
        self._wake.set()
        self._time_s = 0.0
        self._kept = deque[Sweep]([sweeps.at(0.0)], maxlen=_MOST_KEPT)
        gui, last_s = server.gui, max(sweeps.last_s, sweeps.step_s)
        with gui.add_folder("Sweep"):
            self._slider = gui.add_slider("time, s", 0.0, last_s, min(0.1, last_s), 0.0)
            self._play = gui.add_checkbox("play", initial_value=False)
            self._view = SweepView(server, layers_of_scan(self._kept[0].scan), species, root)
            self._together = gui.add_slider("sweeps", 1, _MOST_KEPT, 1, 1, hint="how many stay as they are played")
            self._text = gui.add_markdown("")
            self._faults = gui.add_html("")
        for control in (self._slider, self._play, self._together, *self._view.controls):
            control.on_update(lambda _: self._wake.set())

    def run(self) -> None:
        """Draw what the controls ask for, for ever."""
        while self._wake.wait():
            self._wake.clear()
            began_s = time.monotonic()
            if self._editor is not None and self._editor.step():
                self._wake.set()  # the path first: it follows a hand
                continue
            self._draw()
            if self._play.value is True:
                self._go_on(began_s)

    def _draw(self) -> None:
        time_s = within(self._slider.value, 0.0, self._slider.max)
        together = within(self._together.value, 1, _MOST_KEPT)
        if time_s is None or together is None:
            return
        if time_s != self._time_s:
            if not 0.0 < time_s - self._time_s < 1.5 * self._sweeps.step_s:
                self._kept.clear()
            self._kept.append(self._sweeps.at(time_s))
            self._time_s = time_s
        shown = list(self._kept)[-int(together) :]
        with self._server.atomic():
            text = self._view.draw(shown)
        if text:
            self._text.content = f"{text}, sweep at {time_s:.1f} s"
        self._faults.content = boxed(map(escape, shown[-1].faults[:_LISTED]))

    def _go_on(self, began_s: float) -> None:
        """Move the cursor to the next sweep, no faster than in real time."""
        time_s = self._time_s + self._sweeps.step_s
        if time_s > self._sweeps.last_s:
            self._play.value = False
            return
        time.sleep(max(began_s + self._sweeps.step_s - time.monotonic(), 0.0))
        self._slider.value = time_s
        self._wake.set()


def within(value: object, low: float, high: float) -> float | None:
    """Return a control's value clipped to its range, or None if it is no finite number: a hostile message may set anything."""
    return min(max(float(value), low), high) if isinstance(value, int | float) and math.isfinite(value) else None
