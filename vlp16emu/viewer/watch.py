"""A stream looked on: what leaves goes, without a wait, to a page in a process of its own."""

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.emulator import Emulator
from vlp16emu.errors import RunError, Vlp16emuError
from vlp16emu.motion.live_settings import Live, takes_poses
from vlp16emu.motion.settings import Walk
from vlp16emu.packets import DATA_BYTES
from vlp16emu.report.forest.survey import survey
from vlp16emu.sinks import Channel, Lateness, LatenessHistogram, Pacer, PacketSink
from vlp16emu.types import HeightField, Packet, PacketKind
from vlp16emu.viewer.stand import Piece, pieces_of

_RADIUS_M, _LIVE_RADIUS_M = 25.0, 35.0
"""How far from the path the stand is drawn; of a live scene as far as the body may go."""
_EVERY_NS = 50_000_000
"""From one glimpse to the next: some 40 packets, half a revolution at 600 rpm."""
_MOST = 100
"""Packets of a glimpse: with their poses they fit into a message of the channel."""


class Backdrop(NamedTuple):
    """What the page knows before the first packet leaves."""

    pieces: list[Piece]
    path_m: NDArray[np.float64]
    """(n, 3) of the sensor, or where a live scene expects it; one where it stands."""
    hall: bool
    turn_s: float
    """Of the rotor."""
    walks: bool
    """A person carries the sensor."""
    height_m: HeightField
    """Of the ground."""
    seed: int


class Steering(NamedTuple):
    """How the page leads the sensor of a live scene."""

    where: str
    """Poses come in."""
    gamepad: Path | None
    """Its device, beside the keys of the page."""


class Glimpse(NamedTuple):
    """What a sensor sent in some 50 ms, and how punctual the stream is."""

    payloads: bytes
    """(n, 1206) of its data packets."""
    since_ns: NDArray[np.int64]
    """(n,) of each from the first pulse of the run to its own first pulse."""
    world_T_sensor: NDArray[np.float64]
    """(n, 4, 4) then."""
    late: Lateness
    """Of all packets so far."""
    worst_ns: int
    """Greatest lateness since the last glimpse."""
    delay_ns: int
    """Time by which deadlines have been moved in all."""


class WatchedSink(PacketSink):
    """Passes packets on, and offers glimpses of those that have left.

    A glimpse is made by the thread that sends, once a packet has left: it has then a millisecond until the next one.

    Parameters
    ----------
    sink : where packets go
    pacer : by which they leave
    emulator : whose first sensor is looked at
    channel : takes the glimpses, or loses them
    """

    def __init__(self, sink: PacketSink, pacer: Pacer, emulator: Emulator, channel: Channel) -> None:
        self._sink, self._pacer, self._emulator, self._channel = sink, pacer, emulator, channel
        self._late, self._worst_ns, self._offered_ns = LatenessHistogram(), 0, 0
        self._held: list[tuple[bytes, int]] = []

    def send(self, packet: Packet) -> None:
        """Send one packet.

        Raises
        ------
        RunError
            as of the sink
        """
        self._sink.send(packet)
        late_ns = self._pacer.late_ns
        self._late.add(late_ns)
        self._worst_ns = max(self._worst_ns, late_ns)
        if packet.unit or packet.kind is not PacketKind.DATA or len(packet.payload) != DATA_BYTES:
            return
        # Of a capture that a run was prepared in, first pulses are not known: 1 ms more or less is not seen.
        self._held.append((packet.payload, packet.fired_ns or packet.due_ns))
        if (now_ns := time.monotonic_ns()) - self._offered_ns >= _EVERY_NS or len(self._held) == _MOST:
            self._offered_ns = now_ns
            self._offer()

    def _offer(self) -> None:
        payloads, fired_ns = zip(*self._held, strict=True)
        t_ns = np.array(fired_ns)
        glimpse = Glimpse(
            b"".join(payloads),
            t_ns - self._emulator.scenario.start_ns,
            self._emulator.world_T_sensor(t_ns),
            self._late.summary,
            self._worst_ns,
            self._pacer.delay_ns,
        )
        self._held.clear()
        self._worst_ns = 0
        self._channel.offer(glimpse)


class Watch:
    """A page that shows a stream.

    Parameters
    ----------
    url : of the page
    emulator : whose stream it shows
    channel : to the page
    gamepad : device that leads the sensor of a live scene
    """

    def __init__(self, url: str, emulator: Emulator, channel: Channel, gamepad: Path | None) -> None:
        self.url, self._emulator, self._channel, self._gamepad = url, emulator, channel, gamepad

    def sink(self, sink: PacketSink, pacer: Pacer) -> WatchedSink:
        """Look on at a sink; as `watched` of `Emulator.stream`."""
        return WatchedSink(sink, pacer, self._emulator, self._channel)

    def steer(self, where: str) -> None:
        """Let keys of the page, and a gamepad, send poses to where they come in; as `PosesIn.opened`."""
        self._channel.offer(Steering(where, self._gamepad))


def backdrop_of(emulator: Emulator, duration_s: float) -> Backdrop:
    """Grow what stands near the path of a stream's duration, as few faces.

    Raises
    ------
    InputError
        where a part of the world cannot be made
    """
    scenario, motion = emulator.scenario, emulator.scenario.motion
    expected_m = np.array(motion.path_m) if isinstance(motion, Live) and takes_poses(motion) else None
    radius_m = _RADIUS_M if expected_m is None else _LIVE_RADIUS_M
    seen = survey(
        scenario.model_copy(update={"duration_s": duration_s}),
        min(radius_m, scenario.sensor.max_range_m),
        emulator.parts,
        expected_m,
    )
    return Backdrop(
        pieces=list(pieces_of(seen)),
        path_m=seen.path_m,
        hall=seen.hall is not None,
        turn_s=60.0 / scenario.sensor.rpm,
        walks=isinstance(motion, Walk),
        height_m=seen.height_m,
        seed=scenario.seed,
    )


@contextmanager
def watching(emulator: Emulator, backdrop: Backdrop, *, gamepad: Path | None = None) -> Iterator[Watch]:
    """Start the page, and end it with the context.

    Parameters
    ----------
    gamepad : device that leads the sensor of a live scene, beside the keys of the page

    Raises
    ------
    OutputError, MissingExtraError, RunError
        where the page cannot be served
    """
    from vlp16emu.viewer.live import serve

    ours, theirs = Channel.pair()
    page = get_context("spawn").Process(target=serve, args=(backdrop, theirs), name="page", daemon=True)
    # What is blocked here is blocked there too, for good: Ctrl-C is for the stream, and the page ends with it.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        page.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    theirs.close()
    try:
        yield Watch(_url(ours), emulator, ours, gamepad)
    finally:
        ours.close()
        page.kill()  # it has nothing to finish, and may hang
        page.join()


def _url(channel: Channel) -> str:
    """Wait until the page is there."""
    try:
        answer = channel.take()
    except EOFError:
        raise RunError("the page in the browser has ended before it began") from None
    if isinstance(answer, Vlp16emuError):
        raise answer
    return str(answer)
