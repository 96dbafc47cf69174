"""The page in the browser: its server, the stand, the path, and the sweep at the cursor's time.

By default viser listens on all interfaces, answers any page that is open in a browser, and requests a public
address if a page asks.
"""

import logging
import math
import time
from asyncio import all_tasks
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stdout, suppress
from html import escape
from http import HTTPStatus
from io import StringIO
from pathlib import Path
from threading import Event
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import viser
from scipy.spatial.transform import Rotation
from websockets.asyncio.server import Server, ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from vlp16emu.extras.survey import Survey, survey
from vlp16emu.extras.viewer.editor import Editor, OpenScene
from vlp16emu.extras.viewer.layers import colours_of, html_box, layers_of_scan, legend_of
from vlp16emu.extras.viewer.stand import BEHIND_M, pieces_of
from vlp16emu.extras.viewer.sweeps import CaptureSweeps, SceneSweeps, Sweep
from vlp16emu.extras.walk.settings import Walk
from vlp16emu.foliage.polyline import distance_m
from vlp16emu.hosts import free_address, is_address, is_wildcard, place_of
from vlp16emu.run.emulator import Emulator
from vlp16emu.types import F8, U1
from vlp16emu.units import count_text
from vlp16emu.world.vectors import places_m

LOOPBACK = frozenset({"127.0.0.1", "localhost"})
_MOST_SWEEPS = 50  # sweeps drawn together: 1.2 million points
_LISTED = 6  # greatest number of faults listed for a sweep
_PATH_RGB = (220, 60, 40)
_AMBIENT = 1.4  # light from everywhere, so that no side of a stem is black
_ABOVE_M = 2.5
_ASIDE_DEG = (0, 10, -10, 20, -20, 30, -30, 40, -40, 50, -50)
"""Bearings of the camera from straight behind: the first of those with the freest view is taken."""
_FREE_M = 0.6  # a view with more room beside it is no better


@contextmanager
def guarded_server(host: str, port: int) -> Iterator[viser.ViserServer]:
    """Serve the page until the end of the context.

    Raises OutputError if the address does not belong to this machine, or the port is in use.

    Parameters
    ----------
    host : address or name to listen on, 0.0.0.0 or :: for all addresses of a family; requests may use only
        this name, its address and loopback, and then any address
    port : 0 for any that is free
    """
    # viser would try the next thousand ports, and wait without end if there is no such address.
    address = free_address(host, port, place_of(host, port))
    with redirect_stdout(StringIO()):
        server = viser.ViserServer(host=address, port=port, label="vlp16emu", verbose=False)
    try:
        server.request_share_url = lambda verbose=True: None  # noqa: ARG005  # no public tunnel
        _check_requests(server, LOOPBACK | {host, address}, takes_addresses=is_wildcard(address))
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        yield server
    finally:
        with redirect_stdout(StringIO()):
            server.stop()


def _check_requests(
    server: viser.ViserServer, names: frozenset[str], *, takes_addresses: bool = False
) -> None:
    """Let a server answer requests of our own page only, for its `names`; others are forbidden."""
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL + 1)  # bad requests fill no log
    loop = server.get_event_loop()
    # viser's websocket server is a local variable of a task.
    frames = [frame for task in all_tasks(loop) for frame in task.get_stack()]
    values = [value for frame in frames for value in frame.f_locals.values()]
    web = next(value for value in values if isinstance(value, Server))
    answer = web.process_request
    assert answer is not None

    def check_origin(connection: ServerConnection, request: Request) -> Response | None:
        if not is_ours(request.headers, names, takes_addresses=takes_addresses):
            return Response(HTTPStatus.FORBIDDEN, "Forbidden", Headers({"Content-Length": "0"}))
        return answer(connection, request)  # type: ignore[return-value]  # viser's function is no coroutine

    def drop_unchecked() -> None:
        """Close connections that came before the check."""
        for connection in web.handlers:
            connection.transport.abort()

    web.process_request = check_origin
    loop.call_soon_threadsafe(drop_unchecked)  # clients that connected before the check was installed


def is_ours(headers: Headers, names: frozenset[str], *, takes_addresses: bool = False) -> bool:
    """Return True if a request is for one of our names and comes from our own page.

    A page of another origin sends that origin in `Origin` (RFC 6454, section 7); a foreign name that resolves
    to this machine is in `Host`. With `takes_addresses` any address may stand for a name: only a name can be
    made to resolve to this machine.
    """
    hosts = headers.get_all("Host")
    origins = headers.get_all("Origin")
    with suppress(ValueError):  # from a malformed address
        name = urlsplit(f"//{hosts[0]}").hostname if len(hosts) == 1 else None
        if name in names or (takes_addresses and name is not None and is_address(name)):
            return not origins or origins == [f"http://{hosts[0]}"]
    return False


def scene_page(
    server: viser.ViserServer, emulator: Emulator, open_scene: OpenScene, unit: int, radius_m: float
) -> "Page":
    """Grow a scene and draw it up to a radius around its path, which can be edited if it is a walk.

    Raises InputError if there is no such unit, or the stand cannot be grown.
    """
    sweeps = SceneSweeps(emulator, unit)  # first: a wrong number should not wait for the stand
    text = server.gui.add_markdown("growing the world")
    stand = _stand_of(emulator, radius_m)
    path_m = stand.path_m
    _look_from(server, path_m[0], path_m[min(len(path_m) - 1, 60)] - path_m[0], stand)
    page = Page(server, sweeps, stand.species, _draw_stand(server, stand, is_first=True))
    if not isinstance(open_scene.scenario.motion, Walk):
        if len(path_m) > 1:
            segments_m = np.stack([path_m[:-1], path_m[1:]], axis=1)
            server.scene.add_line_segments("/walk", segments_m, _PATH_RGB, thickness=0.06)
        text.content = f"path not to be edited: `motion.kind` is {open_scene.scenario.motion.kind}, not walk"
        return page

    def show(other_emulator: Emulator) -> Survey:
        """Show another scene, and return its stand."""
        page.change(SceneSweeps(other_emulator, unit))
        stand = _stand_of(other_emulator, radius_m)
        page.root = _draw_stand(server, stand)
        return stand

    text.content = ""
    Editor(server, open_scene, emulator, stand, show)
    return page


def _stand_of(emulator: Emulator, radius_m: float) -> Survey:
    scenario = emulator.scenario
    return survey(scenario, min(radius_m, scenario.sensor.max_range_m), emulator.parts)


def capture_page(server: viser.ViserServer, capture: Path, truth: Path | None, unit: int) -> "Page":
    """Show the sweeps of a capture, and the faults of its packets.

    Parameters and errors as in `CaptureSweeps`.
    """
    text = server.gui.add_markdown("reading the capture")
    sweeps = CaptureSweeps(capture, truth, unit)
    text.content = "  \n".join(sweeps.health or ["packets as a sensor sends them"])
    pose = sweeps.at(0.0).scan.world_T_sensor
    world_T_sensor = np.eye(4) if pose is None else pose
    _look_from(server, world_T_sensor[:3, 3], world_T_sensor[:3, 0])
    return Page(server, sweeps, sweeps.species)


def _draw_stand(server: viser.ViserServer, stand: Survey, *, is_first: bool = False) -> viser.FrameHandle:
    """Draw the stand along the path in place of an earlier one, and return the parent node.

    The first one appears piece by piece, ground first.
    """
    scene = server.scene
    pieces = pieces_of(stand)
    if not is_first:
        pieces = iter([*pieces])  # it takes seconds, during which the earlier stand stays
    scene.remove_by_name("/stand")
    root = scene.add_frame("/stand", show_axes=False)
    scene.configure_default_lights(enabled=True, cast_shadow=False)
    scene.configure_environment_map(None)  # image-based light is slow; two lamps and grey light are enough
    scene.add_light_ambient("/stand/light", intensity=_AMBIENT)
    look: dict[str, Any] = {
        "lod": "off",
        "flat_shading": stand.hall is not None,  # of a forest, clumps and stems are round
        "material": "standard",
        "cast_shadow": False,
        "receive_shadow": False,
        "side": "double" if stand.hall is None else "front",  # a hall is seen through its ceiling
    }
    for name, piece in pieces:
        scene.add_batched_meshes_simple(f"/stand/{name}", **piece, **look)
    return root


def _look_from(server: viser.ViserServer, place_m: F8, ahead_m: F8, stand: Survey | None = None) -> None:
    """Let the camera begin behind the sensor, where no tree hides it and stems fill little of the view."""
    away_m = math.hypot(*ahead_m[:2])
    ahead = ahead_m[:2] / away_m if away_m > 0 else np.array([1.0, 0.0])
    aside = np.radians(_ASIDE_DEG)
    behind_m = -BEHIND_M * np.column_stack(
        [
            ahead[0] * np.cos(aside) - ahead[1] * np.sin(aside),
            ahead[0] * np.sin(aside) + ahead[1] * np.cos(aside),
        ]
    )
    cameras_m = place_m + np.column_stack([behind_m, np.full(len(aside), _ABOVE_M)])
    look_at_m = place_m + BEHIND_M * np.array([*ahead, 0.0])
    rooms_m = np.array([_room_m(camera_m, place_m, stand) for camera_m in cameras_m])
    filled = np.array([_filled(camera_m, look_at_m, stand) for camera_m in cameras_m])
    camera = server.initial_camera
    free_dm = np.round(
        10 * np.minimum(rooms_m, _FREE_M)
    )  # a low crown about the sensor is in all views alike
    camera.position = tuple(cameras_m[np.lexsort([filled, -free_dm])[0]])
    camera.look_at = tuple(look_at_m)


def _room_m(camera_m: F8, place_m: F8, stand: Survey | None) -> float:
    """Return the room beside the line from a camera to a place: to the nearest stem, or low crown."""
    if stand is None or not len(stand.near):
        return math.inf
    trees = stand.near
    is_low = trees["z_m"] + trees["crown_base_m"] < camera_m[2] + 1.0
    radius_m = np.where(is_low, trees["crown_width_m"], trees["dbh_m"]) / 2
    gap_m = distance_m(places_m(trees, "xy"), np.stack([camera_m[:2], place_m[:2]]))
    return float((gap_m - radius_m).min())


def _filled(camera_m: F8, look_at_m: F8, stand: Survey | None) -> float:
    """Return the width of the stems between a camera and the sensor over the width of the view, about."""
    if stand is None:
        return 0.0
    ahead = (look_at_m - camera_m)[:2] / math.hypot(*(look_at_m - camera_m)[:2])
    x_m, y_m = (places_m(stand.near, "xy") - camera_m[:2]).T
    along_m = x_m * ahead[0] + y_m * ahead[1]
    across_m = np.abs(y_m * ahead[0] - x_m * ahead[1])
    radius_m = stand.near["dbh_m"] / 2
    seen = (along_m > 0.0) & (along_m < BEHIND_M) & (across_m - radius_m < along_m)
    return float((radius_m / np.maximum(along_m, radius_m))[seen].sum())


def draw_points(
    server: viser.ViserServer, name: str, world_m: F8, rgb: U1, size_m: float
) -> viser.PointCloudHandle:
    """Draw points (n, 3) in colours (n, 3) as discs, about their middle: browsers compute in float32."""
    middle_m = world_m.mean(axis=0) if len(world_m) else np.zeros(3)
    return server.scene.add_point_cloud(
        name,
        (world_m - middle_m).astype(np.float32),
        rgb,
        point_size=size_m,
        point_shape="circle",
        point_shading="flat",
        precision="float32",
        position=middle_m,
    )


def set_pose(frame: viser.FrameHandle, world_T_frame: F8) -> None:
    """Move the axes of a frame to a pose (4, 4)."""
    frame.position = world_T_frame[:3, 3]
    frame.wxyz = Rotation.from_matrix(world_T_frame[:3, :3]).as_quat(scalar_first=True)


class Page:
    """Points of sweeps and the axes of their sensor, with their controls.

    Parameters
    ----------
    species : names of species by number
    root : node of the stand, which a control hides; None without a stand
    """

    def __init__(
        self,
        server: viser.ViserServer,
        sweeps: SceneSweeps | CaptureSweeps,
        species: Mapping[int, str],
        root: viser.FrameHandle | None = None,
    ) -> None:
        self._server = server
        self._sweeps = sweeps
        self._species = species
        self.root = root
        self._next: SceneSweeps | None = None
        self._wake = Event()
        self._wake.set()
        self._time_s = 0.0
        self._drawn_sweeps = deque[Sweep]([sweeps.at(0.0)], maxlen=_MOST_SWEEPS)
        self._layers = layers_of_scan(self._drawn_sweeps[0].scan)
        self._frame = server.scene.add_frame("/sensor", axes_length=0.6, axes_radius=0.02)
        gui = server.gui
        last_s = max(sweeps.last_s, sweeps.step_s)
        with gui.add_folder("Sweep"):
            self._slider = gui.add_slider("time, s", 0.0, last_s, min(0.1, last_s), 0.0)
            self._play = gui.add_checkbox("play", initial_value=False)
            self._layer = gui.add_dropdown("colour by", self._layers, initial_value=self._layers[0])
            self._legend = gui.add_html("")
            self._size = gui.add_slider("point, cm", 1.0, 20.0, 1.0, 6.0)
            self._stand = gui.add_checkbox("stand", initial_value=True, visible=root is not None)
            self._together = gui.add_slider(
                "sweeps", 1, _MOST_SWEEPS, 1, 1, hint="how many stay as they are played"
            )
            self._text = gui.add_markdown("")
            self._faults = gui.add_html("")
        for control in (self._slider, self._play, self._layer, self._size, self._stand, self._together):
            control.on_update(lambda _: self._wake.set())

    def change(self, sweeps: SceneSweeps) -> None:
        """Show other sweeps from now on, from any thread."""
        self._next = sweeps
        self._wake.set()

    def run(self) -> None:
        """Draw what the controls select, without end."""
        while self._wake.wait():
            self._wake.clear()
            began_s = time.monotonic()
            self._draw()
            if self._play.value:
                self._advance(began_s)

    def _draw(self) -> None:
        if self._next is not None:
            self._sweeps = self._next
            self._next = None
            self._time_s = math.nan
            self._slider.max = max(self._sweeps.last_s, self._sweeps.step_s)
        # A client may send any number; NaN becomes the least.
        time_s = min(max(0.0, self._slider.value), self._sweeps.last_s)
        size_m = min(max(0.01, self._size.value / 100), 0.2)
        layer = self._layer.value if self._layer.value in self._layers else self._layers[0]
        if time_s != self._time_s:
            if not 0.0 < time_s - self._time_s < 1.5 * self._sweeps.step_s:
                self._drawn_sweeps.clear()
            self._drawn_sweeps.append(self._sweeps.at(time_s))
            self._time_s = time_s
        sweeps = list(self._drawn_sweeps)[-max(self._together.value, 1) :]
        points_m = np.concatenate([sweep.world_m for sweep in sweeps])
        layers = [colours_of(sweep.scan, layer, self._species) for sweep in sweeps]
        rgb = np.concatenate([colours for colours, _ in layers])
        with self._server.atomic():
            draw_points(self._server, "/sweep", points_m, rgb, size_m)
            if (world_T_sensor := sweeps[-1].scan.world_T_sensor) is not None:
                set_pose(self._frame, world_T_sensor)
            if self.root is not None:
                self.root.visible = self._stand.value
        self._legend.content = legend_of(layers[-1][1])
        self._text.content = f"{count_text(len(points_m))} points by {layer}, sweep at {time_s:.1f} s"
        self._faults.content = html_box(map(escape, sweeps[-1].faults[:_LISTED]))

    def _advance(self, began_s: float) -> None:
        """Move the cursor to the next sweep, no faster than in real time."""
        time_s = self._time_s + self._sweeps.step_s
        if time_s > self._sweeps.last_s:
            self._play.value = False
            return
        time.sleep(max(began_s + self._sweeps.step_s - time.monotonic(), 0.0))
        self._slider.value = time_s
        self._wake.set()
