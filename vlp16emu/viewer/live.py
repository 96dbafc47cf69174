"""The page of a stream, in a process of its own: walker, present sweep and lateness, and keys that steer a live scene."""

import os
import threading
import time
from contextlib import ExitStack
from functools import partial

import numpy as np
import viser
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vlp16emu.device.poses import PoseSender
from vlp16emu.errors import OutputError, PacketError
from vlp16emu.packets import DATA_BYTES, decode_data
from vlp16emu.scan import Scan
from vlp16emu.sinks import Channel
from vlp16emu.units import S_NS
from vlp16emu.viewer.guard import guarded_server
from vlp16emu.viewer.layers import colours_of, layers_of_scan
from vlp16emu.viewer.page import draw_stand
from vlp16emu.viewer.stroll import KEYS, Stroll, gamepad_on, stroll_on
from vlp16emu.viewer.watch import Backdrop, Glimpse, Steering

_HOST, _PORT = "127.0.0.1", 8016
"""The port of `vlp16emu view`; another one where that is in use."""
_NICE = 10
"""By how much the page is nicer than the stream, which then gets nine tenths of a core that both want."""
_DRAW_S = 0.1
"""From picture to picture."""
_BEHIND_M, _OVER_M = 9.0, 5.0
"""Of the camera at first."""
_NEAR_M = 0.05
"""The camera follows a walker that is farther from where it looks."""
_PERSON_RADIUS_M, _PERSON_RGB = 0.2, (40, 70, 160)


def serve(backdrop: Backdrop, channel: Channel) -> None:
    """Serve the page until the stream is over, and say where it is when it is there."""
    os.nice(_NICE)
    with ExitStack() as stack:
        try:
            server = stack.enter_context(guarded_server(_HOST, _PORT, "vlp16emu"))
        except OutputError:
            server = stack.enter_context(guarded_server(_HOST, 0, "vlp16emu"))
        page = LivePage(server, backdrop)
        channel.offer(f"http://{_HOST}:{server.get_port()}/")
        page.run(channel)


class LivePage:
    """The stand, and what a stream sends just now.

    Parameters
    ----------
    backdrop : what is known before the first packet leaves
    """

    def __init__(self, server: viser.ViserServer, backdrop: Backdrop) -> None:
        self._server, self._backdrop = server, backdrop
        self._parts: list[tuple[Scan, NDArray[np.float64]]] = []
        self._latest: Glimpse | None = None
        self._stroll: Stroll | None = None
        pieces, way_m = backdrop.pieces, backdrop.path_m
        self._root = draw_stand(server, pieces, way_m, hall=backdrop.hall)
        server.initial_camera.position = way_m[0] + np.array([-_BEHIND_M, 0.0, _OVER_M])
        server.initial_camera.look_at = way_m[0]
        self._frame = server.scene.add_frame("/sensor", axes_length=0.6, axes_radius=0.02)
        with server.gui.add_folder("Stream"):
            self._text = server.gui.add_markdown("no packet has left yet")
            self._layer = server.gui.add_dropdown("colour by", ("range",))
            self._size = server.gui.add_slider("point, cm", 1.0, 20.0, 1.0, 5.0)
            self._stand = server.gui.add_checkbox("stand", initial_value=True)
            self._follow = server.gui.add_checkbox("follow the sensor", initial_value=True)

    def run(self, channel: Channel) -> None:
        """Show what comes, as often as there is time for it, until the stream is over."""
        draw_s = 0.0
        while True:
            try:
                self._take(channel.take(_DRAW_S))
            except TimeoutError:
                continue
            except EOFError:
                return
            if (now_s := time.monotonic()) >= draw_s and self._server.get_clients():
                draw_s = now_s + _DRAW_S
                self._draw()

    def _take(self, message: object) -> None:
        """Take a glimpse, or where poses come in."""
        if isinstance(message, Steering):
            self._steer(message)
        elif isinstance(message, Glimpse):
            self._latest = message
            self._add(message)

    def _add(self, glimpse: Glimpse) -> None:
        """Put points into the world, and forget those that are more than a turn old."""
        payloads = np.frombuffer(glimpse.payloads, np.uint8).reshape(-1, DATA_BYTES)
        try:
            points = decode_data(payloads, keep_no_returns=False)
        except PacketError:  # by an event of the scene
            return
        scan = Scan(
            start_ns=int(glimpse.since_ns[0]),
            t_ns=glimpse.since_ns[points.packet],
            xyz_m=points.xyz_m,
            distance_m=points.distance_m,
            azimuth_deg=points.azimuth_deg,
            ring=points.ring.astype(np.uint16),
            reflectivity=points.reflectivity,
            is_last=points.is_last,
        )
        world_T = glimpse.world_T_sensor[points.packet]
        world_m = np.einsum("nij,nj->ni", world_T[:, :3, :3], points.xyz_m) + world_T[:, :3, 3]
        oldest_ns = int(glimpse.since_ns[-1]) - round(self._backdrop.turn_s * S_NS)
        self._parts = [part for part in self._parts if part[0].start_ns >= oldest_ns] + [(scan, world_m)]

    def _draw(self) -> None:
        """Draw the last turn, the sensor and the person, and say how punctual the stream is."""
        if self._latest is None or not self._parts:
            return
        layers, layer = layers_of_scan(self._parts[0][0]), self._layer.value
        if self._layer.options != layers:
            self._layer.options = layers
        layer = layer if layer in layers else layers[0]
        points_m = np.concatenate([world_m for _, world_m in self._parts])
        rgb = np.concatenate([colours_of(scan, layer, {}) for scan, _ in self._parts])
        world_T_sensor = self._latest.world_T_sensor[-1]
        place_m = world_T_sensor[:3, 3]
        turn = Rotation.from_matrix(world_T_sensor[:3, :3]).as_quat(scalar_first=True)
        with self._server.atomic():
            self._server.scene.add_point_cloud(
                "/sweep",
                (points_m - place_m).astype(np.float32),
                rgb,
                point_size=self._size.value / 100,
                precision="float32",
                point_shape="circle",
                point_shading="flat",
                position=place_m,
            )
            self._frame.position, self._frame.wxyz = place_m, turn
            self._root.visible = self._stand.value is True
            if self._backdrop.walks or self._stroll:
                self._draw_person(place_m)
        self._look_at(place_m)
        self._text.content = "  \n".join(_lines(self._latest, len(points_m), self._stroll))

    def _draw_person(self, place_m: NDArray[np.float64]) -> None:
        ground_m = float(self._backdrop.height_m(place_m[:1], place_m[1:2])[0])
        self._server.scene.add_cylinder(
            "/person",
            _PERSON_RADIUS_M,
            max(float(place_m[2]) - ground_m - 2 * _PERSON_RADIUS_M, 0.1),
            _PERSON_RGB,
            cast_shadow=False,
            position=(place_m[0], place_m[1], (ground_m + place_m[2]) / 2 - _PERSON_RADIUS_M),
        )

    def _look_at(self, place_m: NDArray[np.float64]) -> None:
        """Let cameras go with the sensor, as they are turned and as near as they are."""
        if self._follow.value is not True:
            return
        for client in self._server.get_clients().values():
            camera = client.camera
            away_m = camera.position - camera.look_at
            if np.linalg.norm(camera.look_at - place_m) > _NEAR_M:
                with client.atomic():  # or a slow browser answers between the two, and comes nearer each time
                    camera.position, camera.look_at = place_m + away_m, place_m

    def _steer(self, by: Steering) -> None:
        """Walk by keys, buttons and a gamepad, from when somebody has opened the page."""
        self._stroll = stroll = Stroll(
            self._backdrop.path_m[:, :2], self._backdrop.height_m, self._backdrop.seed
        )
        gui, begin = self._server.gui, threading.Event()
        with gui.add_folder("Walk"):
            for what, keys in KEYS.items():
                button = gui.add_button(f"{what} ({keys[0]})")
                button.on_click(lambda _, what=what: stroll.press(what))
                for key in keys:
                    command = gui.add_command(f"walk: {what} ({key})", hotkey=key)
                    command.on_trigger(lambda _, what=what: stroll.press(what))
        self._server.on_client_connect(lambda _: begin.set())
        leaders = [partial(stroll_on, stroll, PoseSender(by.where), begin)]
        leaders += [partial(gamepad_on, stroll, by.gamepad)] if by.gamepad else []
        for leader in leaders:
            threading.Thread(target=leader, name="stroll", daemon=True).start()


def _lines(glimpse: Glimpse, points: int, stroll: Stroll | None) -> list[str]:
    """Say how the stream goes."""
    late = glimpse.late
    at_most = f"at most {late.max_ns / 1e6:.1f} ms; now {glimpse.worst_ns / 1e6:.2f} ms"
    lines = [
        f"{glimpse.since_ns[-1] / S_NS:.1f} s, {late.packets} packets",
        f"{points} points in the last turn",
        f"lateness: median {late.median_ns / 1e3:.0f} us, 99 % within {late.p99_ns / 1e3:.0f} us, {at_most}",
    ]
    lines += [f"**late by {glimpse.delay_ns / S_NS:.2f} s**"] if glimpse.delay_ns else []
    return [*lines, stroll.summary] if stroll else lines
