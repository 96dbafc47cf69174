"""The page of a running stream, in a process of its own: packets go there without a wait."""

import os
import pickle
import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from multiprocessing import get_context
from typing import Any, NamedTuple

import numpy as np
import viser

from vlp16emu.errors import OutputError, PacketError, RunError
from vlp16emu.extras.live.settings import Live
from vlp16emu.extras.sheets.survey import survey
from vlp16emu.extras.viewer.guard import guarded_server
from vlp16emu.extras.viewer.layers import MEASURED
from vlp16emu.extras.viewer.page import SweepView, draw_stand
from vlp16emu.extras.viewer.stand import Piece, pieces_of
from vlp16emu.extras.viewer.sweeps import Sweep, placed
from vlp16emu.packets import DATA_BYTES, decode_data
from vlp16emu.run.emulator import Emulator
from vlp16emu.sinks import Lateness, LatenessHistogram, Pacer, PacketSink
from vlp16emu.types import F8, I8, Packet, PacketKind, Scan
from vlp16emu.units import S_NS

_HOST, _PORT = "127.0.0.1", 8016  # port of `vlp16emu view`; any other if it is in use
_NICE = 10  # added to the niceness of the page: the stream then gets nine tenths of a core that both want
_RADIUS_M, _LIVE_RADIUS_M = 25.0, 35.0
"""How far from the path the stand is drawn; in a live scene as far as the body may go."""
_EVERY_NS = 50_000_000  # time between glimpses: some 40 packets, half a revolution at 600 rpm
_MOST = 100  # most packets of a glimpse: with their poses they fit into a message
_DRAW_S = 0.1  # time between pictures
_BEHIND_M, _OVER_M = 9.0, 5.0  # place of the camera at first
_NEAR_M = 0.05  # the camera follows a sensor that is farther from the point that it looks at


_MESSAGE_BYTES = 150_000  # limit of a message; a socket holds 212 992 unless net.core.wmem_default is less


def offer(end: socket.socket, message: object) -> None:
    """Send a message to the other process; it is lost if there is no room now, as that is slow, hangs, or is gone."""
    with suppress(OSError):
        end.send(pickle.dumps(message), socket.MSG_DONTWAIT)


def take(end: socket.socket, timeout_s: float | None = None) -> Any:
    """Return the next message; raise TimeoutError if none comes in time, EOFError if the other process is gone."""
    end.settimeout(timeout_s)
    data = b""
    with suppress(ConnectionError):
        data = end.recv(_MESSAGE_BYTES)
    if not data:
        raise EOFError
    return pickle.loads(data)  # noqa: S301  # the other end is a process of ours


class Backdrop(NamedTuple):
    """Content of the page before the first packet is sent."""

    pieces: list[Piece]
    path_m: F8  # (n, 3) of the sensor, in a live scene the expected one; one if the sensor stands still
    hall: bool
    turn_s: float  # time of a revolution


class Glimpse(NamedTuple):
    """Points that a sensor sent in some 50 ms, and how punctual the stream is."""

    payloads: bytes  # (n, 1206) bytes of its data packets
    since_ns: I8  # (n,) time of each packet's first pulse, since the first pulse of the run
    world_T_sensor: F8  # (n, 4, 4) poses at these times
    late: Lateness  # lateness of all packets so far
    worst_ns: int  # greatest lateness since the last glimpse
    delay_ns: int  # time by which deadlines have been moved in all


class WatchedSink(PacketSink):
    """A sink that passes packets on, and offers glimpses of the first sensor's packets once they are sent.

    The sending thread makes a glimpse after a packet: it then has a millisecond until the next one.
    """

    def __init__(self, sink: PacketSink, pacer: Pacer, emulator: Emulator, page: socket.socket) -> None:
        self._sink, self._pacer, self._emulator, self._page = sink, pacer, emulator, page
        self._late, self._worst_ns, self._offered_ns = LatenessHistogram(), 0, 0
        self._held: list[tuple[bytes, int]] = []

    def send(self, packet: Packet) -> None:
        """Send one packet."""
        self._sink.send(packet)
        late_ns = self._pacer.late_ns
        self._late.add(late_ns)
        self._worst_ns = max(self._worst_ns, late_ns)
        if packet.unit or packet.kind is not PacketKind.DATA or len(packet.payload) != DATA_BYTES:
            return
        # A run prepared in a capture does not know first pulses: 1 ms more or less is not seen.
        self._held.append((packet.payload, packet.fired_ns or packet.due_ns))
        now_ns = time.monotonic_ns()
        if now_ns - self._offered_ns < _EVERY_NS and len(self._held) < _MOST:
            return
        self._offered_ns = now_ns
        payloads, fired_ns = zip(*self._held, strict=True)
        t_ns = np.array(fired_ns)
        since_ns, poses = t_ns - self._emulator.scenario.start_ns, self._emulator.world_T_sensor(t_ns)
        late = self._late.summary, self._worst_ns, self._pacer.delay_ns
        offer(self._page, Glimpse(b"".join(payloads), since_ns, poses, *late))
        self._held.clear()
        self._worst_ns = 0


class Watch(NamedTuple):
    """A page that shows a stream."""

    url: str
    sink: Callable[[PacketSink, Pacer], PacketSink]  # wrap a sink so that the page sees its packets


def backdrop_of(emulator: Emulator, duration_s: float) -> Backdrop:
    """Grow what stands near the path of a stream's duration, with few faces; InputError if a part cannot be made."""
    scenario, motion = emulator.scenario, emulator.scenario.motion
    expected_m = np.array(motion.path_m) if isinstance(motion, Live) and motion.takes_poses else None
    radius_m = _RADIUS_M if expected_m is None else _LIVE_RADIUS_M
    walked = scenario.model_copy(update={"duration_s": duration_s})
    seen = survey(walked, min(radius_m, scenario.sensor.max_range_m), emulator.parts, expected_m)
    return Backdrop(list(pieces_of(seen)), seen.path_m, seen.hall is not None, 60.0 / scenario.sensor.rpm)


@contextmanager
def watching(emulator: Emulator, backdrop: Backdrop) -> Iterator[Watch]:
    """Start the page, and end it with the context; OutputError or RunError if it cannot be served."""
    # SOCK_SEQPACKET keeps messages apart, and a reader learns that the writer is gone (unix(7)).
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    page = get_context("spawn").Process(target=serve, args=(backdrop, theirs), name="page", daemon=True)
    # What is blocked here is blocked there too, for good: Ctrl-C is for the stream, and the page ends with it.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        page.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    theirs.close()
    try:
        try:
            answer = take(ours)
        except EOFError:
            raise RunError("the page in the browser has ended before it began") from None
        yield Watch(str(answer), partial(WatchedSink, emulator=emulator, page=ours))
    finally:
        ours.close()
        page.kill()  # it has nothing to finish, and may hang
        page.join()


def serve(backdrop: Backdrop, stream: socket.socket) -> None:
    """Serve the page until the stream is over, and send its address when it is there."""
    os.nice(_NICE)
    with ExitStack() as stack:
        try:
            server = stack.enter_context(guarded_server(_HOST, _PORT, "vlp16emu"))
        except OutputError:
            server = stack.enter_context(guarded_server(_HOST, 0, "vlp16emu"))
        page = LivePage(server, backdrop)
        offer(stream, f"http://{_HOST}:{server.get_port()}/")
        page.run(stream)


class LivePage:
    """The stand, and what a stream is sending."""

    def __init__(self, server: viser.ViserServer, backdrop: Backdrop) -> None:
        self._server, self._backdrop = server, backdrop
        self._parts: list[Sweep] = []
        way_m = backdrop.path_m
        root = draw_stand(server, backdrop.pieces, way_m, hall=backdrop.hall)
        server.initial_camera.position = way_m[0] + np.array([-_BEHIND_M, 0.0, _OVER_M])
        server.initial_camera.look_at = way_m[0]
        with server.gui.add_folder("Stream"):
            self._text = server.gui.add_markdown("no packet has left yet")
            self._view = SweepView(server, MEASURED, {}, root)
            self._follow = server.gui.add_checkbox("follow the sensor", initial_value=True)

    def run(self, stream: socket.socket) -> None:
        """Draw glimpses, as often as there is time for it, until the stream is over."""
        draw_s = 0.0
        while True:
            try:
                glimpse: Glimpse = take(stream, _DRAW_S)
            except TimeoutError:
                continue
            except EOFError:
                return
            self._add(glimpse)
            if (now_s := time.monotonic()) >= draw_s and self._server.get_clients():
                draw_s = now_s + _DRAW_S
                self._draw(glimpse)

    def _add(self, glimpse: Glimpse) -> None:
        """Place points in the world, and forget those older than a revolution."""
        payloads = np.frombuffer(glimpse.payloads, np.uint8).reshape(-1, DATA_BYTES)
        try:
            points = decode_data(payloads, keep_no_returns=False)
        except PacketError:  # by an event of the scene
            return
        kept = ("xyz_m", "distance_m", "azimuth_deg", "reflectivity", "is_last")
        scan = Scan(
            start_ns=int(glimpse.since_ns[0]),
            t_ns=glimpse.since_ns[points.packet],
            ring=points.ring.astype(np.uint16),
            world_T_sensor=glimpse.world_T_sensor[-1],
            **{name: getattr(points, name) for name in kept},
        )
        sweep = Sweep(scan, placed(points.xyz_m, glimpse.world_T_sensor[points.packet]))
        oldest_ns = int(glimpse.since_ns[-1]) - round(self._backdrop.turn_s * S_NS)
        self._parts = [part for part in self._parts if part.scan.start_ns >= oldest_ns] + [sweep]

    def _draw(self, glimpse: Glimpse) -> None:
        if not self._parts:
            return
        with self._server.atomic():
            self._view.draw(self._parts)
        place_m, late = glimpse.world_T_sensor[-1][:3, 3], glimpse.late
        # Cameras move with the sensor, and keep direction and distance.
        for client in self._server.get_clients().values() if self._follow.value is True else ():
            camera = client.camera
            away_m = camera.position - camera.look_at
            if np.linalg.norm(camera.look_at - place_m) > _NEAR_M:
                with client.atomic():  # or a slow browser answers between the two, and comes nearer each time
                    camera.position, camera.look_at = place_m + away_m, place_m
        at_most = f"at most {late.max_ns / 1e6:.1f} ms; now {glimpse.worst_ns / 1e6:.2f} ms"
        lines = [
            f"{glimpse.since_ns[-1] / S_NS:.1f} s, {late.packets} packets",
            f"{sum(len(part.world_m) for part in self._parts)} points in the last turn",
            f"lateness: median {late.median_ns / 1e3:.0f} us, 99 % within {late.p99_ns / 1e3:.0f} us, {at_most}",
            *([f"**late by {glimpse.delay_ns / S_NS:.2f} s**"] if glimpse.delay_ns else []),
        ]
        self._text.content = "  \n".join(lines)
