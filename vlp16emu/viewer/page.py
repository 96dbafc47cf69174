"""The page: the stand, the path, and the sweep at the cursor's time."""

import math
import time
from collections import deque
from collections.abc import Iterable
from threading import Event

import numpy as np
import viser
from numpy.typing import NDArray

from vlp16emu.viewer.editor import Editor
from vlp16emu.viewer.layers import LAYERS, colours_of, entries_of, layers_of_scan
from vlp16emu.viewer.legend import legend_of, list_of
from vlp16emu.viewer.sensor import DrawnSensor
from vlp16emu.viewer.stand import Piece
from vlp16emu.viewer.sweeps import Sweep, Sweeps

_POLL_S = 0.1
"""How often the page looks whether it shall end."""
_MOST_KEPT = 50
"""Sweeps drawn together: 1.2 million points."""
_LISTED = 6
"""Faults of a sweep, line by line."""
_PATH_COLOUR = (220, 60, 40)


def draw_stand(
    server: viser.ViserServer, pieces: Iterable[Piece], way_m: NDArray[np.float64], *, hall: bool
) -> viser.FrameHandle:
    """Draw what stands along a path (n, 3), look at it from behind the start, and give the node above it."""
    scene = server.scene
    root = scene.add_frame("/stand", show_axes=False)
    scene.configure_default_lights(enabled=True, cast_shadow=False)
    scene.configure_environment_map(None)  # light of its own on each pixel, where a stand needs two lamps
    for piece in pieces:
        scene.add_batched_meshes_simple(
            f"/stand/{piece.name}",
            piece.vertices_m,
            piece.faces,
            piece.wxyz,
            piece.position_m,
            batched_scales=piece.scale,
            batched_colors=piece.colour,
            lod="off",
            flat_shading=True,
            material="toon5",
            side="front" if hall else "double",  # a hall is looked into through its ceiling
            cast_shadow=False,
            receive_shadow=False,
        )
    if len(way_m) > 1:
        scene.add_line_segments(
            "/walk", np.stack([way_m[:-1], way_m[1:]], axis=1), _PATH_COLOUR, thickness=0.06
        )
    look_from(server, way_m[0], way_m[min(len(way_m) - 1, 60)] - way_m[0])
    return root


def look_from(server: viser.ViserServer, place_m: NDArray[np.float64], ahead_m: NDArray[np.float64]) -> None:
    """Put the camera of whoever comes behind a place, and over it."""
    away_m = math.hypot(*ahead_m[:2])
    east, north = ahead_m[:2] / away_m if away_m > 0 else (1.0, 0.0)
    camera = server.initial_camera
    camera.position = (place_m[0] - 22 * east, place_m[1] - 22 * north, place_m[2] + 16)
    camera.look_at = (place_m[0] + 6 * east, place_m[1] + 6 * north, place_m[2])


class Page:
    """Controls over sweeps, and the points of the present one.

    Parameters
    ----------
    sweeps : where they come from
    species : names by number
    root : node of what stands there, where anything is drawn
    editor : of the path, where there is one
    """

    def __init__(
        self,
        server: viser.ViserServer,
        sweeps: Sweeps,
        species: dict[int, str],
        root: viser.FrameHandle | None = None,
        editor: Editor | None = None,
    ) -> None:
        self._server, self._sweeps, self._species = server, sweeps, species
        self._root, self._editor = root, editor
        self._wake = Event()
        self._wake.set()
        self._time_s = 0.0
        self._kept = deque[Sweep]([sweeps.at(0.0)], maxlen=_MOST_KEPT)
        self._sensor = DrawnSensor(server, sweeps.beams)
        self._panel()
        if editor is not None:
            editor.wake = self._wake.set

    def turn_to(self, sweeps: Sweeps, species: dict[int, str], root: viser.FrameHandle | None) -> None:
        """Show the sweeps of another stand from now on."""
        self._sweeps, self._species, self._root = sweeps, species, root
        self._time_s = min(self._time_s, sweeps.last_s)
        self._slider.value = self._time_s
        self._slider.max = max(sweeps.last_s, sweeps.step_s)
        self._kept = deque[Sweep]([sweeps.at(self._time_s)], maxlen=_MOST_KEPT)

    def _panel(self) -> None:
        """Lay out the controls."""
        gui, sweeps = self._server.gui, self._sweeps
        layers = layers_of_scan(self._kept[-1].scan)
        with gui.add_folder("Sweep"):
            last_s = max(sweeps.last_s, sweeps.step_s)
            self._slider = gui.add_slider("time, s", 0.0, last_s, min(0.1, last_s), 0.0)
            self._play = gui.add_checkbox("play", initial_value=False)
            self._layer = gui.add_dropdown("colour by", layers, initial_value=layers[0])
            self._legend = gui.add_html("")
            self._together = gui.add_slider(
                "sweeps", 1, _MOST_KEPT, 1, 1, hint="how many stay as they are played"
            )
            self._size = gui.add_slider("point, cm", 1.0, 20.0, 1.0, 5.0)
            self._beams = gui.add_checkbox("beams", initial_value=True)
            self._stand = gui.add_checkbox("stand", initial_value=True, visible=self._root is not None)
            self._text = gui.add_markdown("")
            self._faults = gui.add_html("")
        for control in (
            *(self._slider, self._play, self._layer, self._together),
            *(self._size, self._beams, self._stand),
        ):
            control.on_update(lambda _: self._wake.set())

    def run(self, stop: Event) -> None:
        """Draw what is wanted, until the end."""
        while not stop.is_set():
            if not self._wake.wait(_POLL_S):
                continue
            self._wake.clear()
            began_s = time.monotonic()
            if self._editor is not None and self._editor.step():
                self._wake.set()  # the path first: it follows a hand
                continue
            self._draw()
            if self._play.value is True:
                self._go_on(began_s, stop)

    def _draw(self) -> None:
        """Draw the sweeps at the cursor, if the controls have values that they can have."""
        time_s, size_cm, together = self._slider.value, self._size.value, self._together.value
        layer = self._layer.value
        if not all(map(_is_number, (time_s, size_cm, together))) or layer not in LAYERS:
            return
        if time_s != self._time_s:
            if not 0.0 < time_s - self._time_s < 1.5 * self._sweeps.step_s:
                self._kept.clear()
            self._kept.append(self._sweeps.at(float(time_s)))
            self._time_s = time_s
        if layer not in layers_of_scan(self._kept[-1].scan):
            return
        shown = list(self._kept)[-max(int(together), 1) :]
        with self._server.atomic():
            self._draw_points(shown, layer, max(float(size_cm), 0.1) / 100)
            self._sensor.show(shown[-1], with_beams=self._beams.value is True)
            if self._root is not None:
                self._root.visible = self._stand.value is True
        points = sum(len(sweep.world_m) for sweep in shown)
        counted = f"{points:,}".replace(",", " ")
        self._text.content = f"{counted} points by {layer}, sweep at {time_s:.1f} s"
        self._legend.content = legend_of(entries_of(shown[-1].scan, layer, self._species))
        self._faults.content = list_of([mark.what for mark in shown[-1].marks[:_LISTED]])

    def _draw_points(self, shown: list[Sweep], layer: str, size_m: float) -> None:
        points_m = np.concatenate([sweep.world_m for sweep in shown])
        middle_m = points_m.mean(axis=0) if len(points_m) else np.zeros(3)
        self._server.scene.add_point_cloud(
            "/sweep",
            (points_m - middle_m).astype(np.float32),
            np.concatenate([colours_of(sweep.scan, layer, self._species) for sweep in shown]),
            point_size=size_m,
            precision="float32",
            point_shape="circle",
            point_shading="flat",
            position=middle_m,
        )

    def _go_on(self, began_s: float, stop: Event) -> None:
        """Set the cursor to the next sweep, no faster than in real time."""
        time_s = self._time_s + self._sweeps.step_s
        if time_s > self._sweeps.last_s:
            self._play.value = False
            return
        stop.wait(began_s + self._sweeps.step_s - time.monotonic())
        self._slider.value = time_s
        self._wake.set()


def _is_number(value: object) -> bool:
    """Whether a value is a finite number; a stranger's message may say anything."""
    return isinstance(value, int | float) and math.isfinite(value)
