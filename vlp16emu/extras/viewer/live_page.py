"""The process of the page beside a stream.

It shows the last sweeps, decoded from the packets that were sent, and the state of the stream.
"""

import os
import pickle
import socket
import sys
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from html import escape
from threading import Event, Thread
from typing import Any

import numpy as np
import viser

from vlp16emu.errors import OutputError, PacketError
from vlp16emu.extras.clouds.scan import Chunk, chunk_of_packets, cut_scans
from vlp16emu.extras.viewer.layers import colours_of, html_box, layers_of_scan, legend_of
from vlp16emu.extras.viewer.live import Batch, PageSetup, instant_ns, receive
from vlp16emu.extras.viewer.live_settings import SettingsPanel
from vlp16emu.extras.viewer.page import draw_points, guarded_server, set_pose
from vlp16emu.extras.viewer.sweeps import Sweep, to_world
from vlp16emu.hosts import LOOPBACK, url_of
from vlp16emu.packets import DATA_BYTES, DATA_PAYLOAD, RETURN_MODE_BYTE, decode_position
from vlp16emu.sinks import TOLERANCE_NS
from vlp16emu.types import F8, I8, Packet, PacketKind, Scan
from vlp16emu.units import S_NS

_NICE = 10  # added to the niceness of this process: the stream gets nine tenths of a core that both need
_DRAW_S = 0.1  # time between pictures
_MOST_SWEEPS = 20
_SWEEPS_AT_FIRST = 5
_POSES = 128  # messages whose poses are kept: 2000 packets, more than the slowest revolution has
_PATH_STEP_M = 0.2  # spacing of the points of the path; doubled each time that there are `_MOST_PATH`
_MOST_PATH = 4000
_PATH_RGB = (220, 60, 40)
_NAME_STYLE = "white-space:nowrap;vertical-align:top;padding-right:0.8em;opacity:0.7"
"""Style of a name in the table."""
_CAMERA_M = (-11.0, -6.0, 6.0)  # first place of the camera, seen from the sensor


class LiveView:
    """The last sweeps of a stream, its state and its path.

    A reading thread cuts packets into sweeps, and a drawing thread draws the last ones.

    Parameters
    ----------
    server : page
    setup : constants of the stream
    """

    def __init__(self, server: viser.ViserServer, setup: PageSetup) -> None:
        self._server = server
        self._setup = setup
        self._over = Event()
        self._origin_m: F8 | None = None  # the page has its origin here: browsers compute in float32
        self._place_m = np.zeros(3)
        self._path_m = list[F8]()
        self._path_step_m = _PATH_STEP_M
        self._batch: Batch | None = None
        self._data_packets = 0  # number of data packets that have come here
        self._latest = dict[PacketKind, bytes]()  # payloads of the selected sensor
        self._poses = deque[tuple[I8, F8]](maxlen=_POSES)
        self._sweeps = deque[tuple[int, Sweep]](maxlen=_MOST_SWEEPS)  # numbered
        self._rpm: float | None = None  # of the last two sweeps
        self._points = dict[int, tuple[Any, Any]]()
        """Content and handle of viser of the drawn sweeps, by their number modulo `_MOST_SWEEPS`."""
        self._drawn_path = 0  # number of points of the path that is drawn
        self._build()

    def _build(self) -> None:
        """Make the controls and the fixed nodes."""
        gui = self._server.gui
        scene = self._server.scene
        units = [str(number) for number in range(1, self._setup.units + 1)]
        with gui.add_folder(self._setup.scene):
            self._text = gui.add_html(html_box(["no packet has been sent yet"]))
            self._unit = gui.add_dropdown("sensor", units, visible=self._setup.units > 1)
        with gui.add_folder("Points"):
            self._layer = gui.add_dropdown("colour by", ("reflectivity", "ring", "range", "time"))
            self._legend = gui.add_html("")
            self._count = gui.add_slider("sweeps", 1, _MOST_SWEEPS, 1, _SWEEPS_AT_FIRST)
            self._size = gui.add_slider("point, cm", 1.0, 20.0, 1.0, 4.0)
            self._follow = gui.add_checkbox("follow the sensor", initial_value=True)
        self._settings = SettingsPanel(self._server)
        self._world = scene.add_frame("/world", show_axes=False)
        self._sensor = scene.add_frame("/world/sensor", axes_length=0.6, axes_radius=0.02)
        self._server.initial_camera.position = _CAMERA_M
        self._server.initial_camera.look_at = (0.0, 0.0, 0.0)

    def run(self, channel: socket.socket) -> None:
        """Show the packets that come from a channel, until its other end is gone."""
        drawing = Thread(target=self._draw_repeatedly, name="drawing", daemon=True)
        drawing.start()
        number = 0
        while not self._over.is_set():
            before_ns = None
            for scan in cut_scans(self._chunks(channel, self._number)):
                if before_ns is not None:
                    self._rpm = 60.0 * S_NS / (scan.start_ns - before_ns)
                before_ns = scan.start_ns
                self._sweeps.append((number, self._sweep(scan)))
                number += 1
            if not self._over.is_set():
                self._forget()
        drawing.join()
        self._settings.end()

    def _forget(self) -> None:
        """Forget the sensor that was selected before."""
        self._sweeps.clear()
        self._poses.clear()
        self._latest.clear()
        self._rpm = None

    @property
    def _number(self) -> int:
        """Index of the selected sensor; a client may send any text."""
        text = self._unit.value
        return int(text) - 1 if text in self._unit.options else 0

    def _chunks(self, channel: socket.socket, unit: int) -> Iterator[Chunk]:
        """Yield the points of a sensor as its packets come.

        They end when another sensor is selected or the stream ends.
        """
        while unit == self._number:
            try:
                batch: Batch = receive(channel)
            except EOFError:
                self._over.set()
                return
            rows = [row for row, packet in enumerate(batch.packets) if packet.unit == unit]
            packets = [batch.packets[row] for row in rows]
            self._data_packets += sum(packet.kind is PacketKind.DATA for packet in batch.packets)
            self._batch = batch
            if packets:
                self._record(packets, batch.world_T_sensor[rows])
            data = [packet for packet in packets if packet.kind is PacketKind.DATA]
            try:
                chunk = chunk_of_packets(data)
            except PacketError:  # an event of the scene has damaged them
                continue
            if chunk is not None:
                yield chunk

    def _record(self, packets: list[Packet], world_T_sensor: F8) -> None:
        """Keep the poses of packets, their place on the path, and the last payload of each kind."""
        if self._origin_m is None:
            self._origin_m = world_T_sensor[0, :3, 3].copy()
        world_T_sensor[:, :3, 3] -= self._origin_m
        self._poses.append((np.array([instant_ns(packet) for packet in packets]), world_T_sensor))
        self._latest |= {packet.kind: packet.payload for packet in packets}
        self._place_m = world_T_sensor[-1, :3, 3]
        if not self._path_m or np.linalg.norm(self._place_m - self._path_m[-1]) >= self._path_step_m:
            self._path_m.append(self._place_m)
        if len(self._path_m) > _MOST_PATH:
            self._path_m = self._path_m[::2]
            self._path_step_m *= 2.0

    def _sweep(self, scan: Scan) -> Sweep:
        """Transform each point by the pose of its packet."""
        t_ns, poses = (np.concatenate(parts) for parts in zip(*self._poses, strict=True))
        order = np.argsort(t_ns, kind="stable")  # events of the scene reorder packets
        rows = np.searchsorted(t_ns[order], np.append(scan.t_ns, scan.start_ns), side="right") - 1
        world_T_sensor = poses[order[np.maximum(rows, 0)]]
        scan = replace(scan, world_T_sensor=world_T_sensor[-1])
        return Sweep(scan, to_world(scan.xyz_m, world_T_sensor[:-1]))

    def _draw_repeatedly(self) -> None:
        while not self._over.wait(_DRAW_S):
            batch = self._batch
            if batch is None or not self._server.get_clients():
                continue
            with self._server.atomic():
                self._draw_sweeps()
                self._draw_path()
                if self._follow.value:  # the world moves, not the camera, which the user turns meanwhile
                    self._world.position = -self._place_m
            unit = self._number
            self._settings.connect(batch.web[unit] if unit < len(batch.web) else None)
            self._text.content = self._status(batch)

    def _draw_sweeps(self) -> None:
        """Draw those of the last sweeps that are new or look different; remove all others."""
        # A client may send any number or text; NaN becomes the least.
        count = int(min(max(1, self._count.value), _MOST_SWEEPS))
        size_m = min(max(0.01, self._size.value / 100.0), 0.2)
        sweeps = list(self._sweeps)[-count:]
        if not sweeps:
            return
        layers = layers_of_scan(sweeps[-1][1].scan)
        if set(layers) != set(self._layer.options):
            self._layer.options = layers
        layer = self._layer.value if self._layer.value in layers else layers[0]
        contents = {number % _MOST_SWEEPS: (number, layer, size_m) for number, _ in sweeps}
        for number, sweep in sweeps:
            slot = number % _MOST_SWEEPS
            if self._points.get(slot, (None, None))[0] != contents[slot]:
                self._points[slot] = contents[slot], self._draw_points(slot, sweep, layer, size_m)
        for slot in self._points.keys() - contents.keys():
            self._points.pop(slot)[1].remove()
        if (world_T_sensor := sweeps[-1][1].scan.world_T_sensor) is not None:
            set_pose(self._sensor, world_T_sensor)

    def _draw_points(self, slot: int, sweep: Sweep, layer: str, size_m: float) -> viser.PointCloudHandle:
        colours, entries = colours_of(sweep.scan, layer, self._setup.species)
        self._legend.content = legend_of(entries)
        return draw_points(self._server, f"/world/sweep/{slot}", sweep.world_m, colours, size_m)

    def _draw_path(self) -> None:
        path_m = np.array([*self._path_m, self._place_m])
        if len(path_m) > 2 and len(self._path_m) != self._drawn_path:
            self._drawn_path = len(self._path_m)
            lines_m = np.stack([path_m[:-1], path_m[1:]], axis=1)
            self._server.scene.add_line_segments("/world/path", lines_m, _PATH_RGB, thickness=0.06)

    def _status(self, batch: Batch) -> str:
        """Return the table of the stream's state, and of the state that packets report."""
        lateness = batch.lateness
        data = batch.sent.get(PacketKind.DATA, 0)
        rows = {
            "time": f"{batch.since_s:.1f} s",
            "packets sent": f"{data} data, {batch.sent.get(PacketKind.POSITION, 0)} position",
            f"over {TOLERANCE_NS // 1_000_000} ms late": f"{batch.late}, delay {batch.delay_s:.2f} s",
            "lateness": f"99 % in {lateness.p99_ns / 1e6:.1f} ms, all in {lateness.max_ns / 1e6:.1f} ms",
            "GPS": gps_text(self._latest.get(PacketKind.POSITION, b"")),
            "rotor": "no revolution" if self._rpm is None else f"{self._rpm:.1f} rpm",
            "return mode": mode_text(self._latest.get(PacketKind.DATA, b"")),
            "on this page": f"{self._data_packets / max(data, 1):.0%} of data packets",
        }
        cells = (
            f'<tr><td style="{_NAME_STYLE}">{escape(name)}</td><td>{escape(text)}</td></tr>'
            for name, text in rows.items()
        )
        return html_box([f"<table>{''.join(cells)}</table>"])


def gps_text(payload: bytes) -> str:
    """Return the state of pulse and fix that a position packet reports, in words."""
    try:
        fields = decode_position(payload)
    except PacketError:
        return "no position packet"
    words = fields.sentence.split(b",")
    fix = {b"A": "fix valid", b"V": "no fix"}.get(words[2] if len(words) > 2 else b"", "no sentence")
    return f"PPS {fields.pps.name.lower()}, {fix}"


def mode_text(payload: bytes) -> str:
    """Return the return mode of a data packet in words, with its byte."""
    if len(payload) != DATA_BYTES:
        return "no data packet"
    byte = int(np.frombuffer(payload, DATA_PAYLOAD)[0]["return_mode"])
    names = {code: mode for mode, code in RETURN_MODE_BYTE.items()}
    return f"{names.get(byte, 'unknown')} (0x{byte:02x})"


def main() -> None:
    """Serve the page of the stream at the other end of the socket whose descriptor is the argument."""
    os.nice(_NICE)
    channel = socket.socket(fileno=int(sys.argv[1]))
    setup: PageSetup = receive(channel)
    try:
        with guarded_server(LOOPBACK, setup.port) as server:
            view = LiveView(server, setup)
            channel.send(pickle.dumps(url_of(LOOPBACK, server.get_port())))
            view.run(channel)
    except OutputError as error:
        channel.send(pickle.dumps(error))


if __name__ == "__main__":
    main()
