"""The stream's side of its page in the browser.

It copies sent packets for a process that no packet waits for.

    sending thread --deque of bounded length--> copying thread --socket that drops--> page, at a lower
    priority

The sending thread does one `append`; if the copying thread is behind, the oldest packets fall out. The
copying thread adds poses, and sends without waiting; if the page is slow, stopped or gone, its message is
dropped. The page changes settings as any other client does: over the web interface of the sensor.
"""

import math
import os
import pickle
import socket
import subprocess
import sys
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from threading import Event, Thread
from typing import Any

import numpy as np
from numpy.lib.recfunctions import repack_fields

from vlp16emu.errors import RunError, Vlp16emuError
from vlp16emu.run.emulator import Emulator
from vlp16emu.run.part import StreamPart
from vlp16emu.run.scene_stream import SceneStream
from vlp16emu.sinks import TOLERANCE_NS, Lateness, LatenessHistogram
from vlp16emu.types import F8, Labels, Packet, PacketKind
from vlp16emu.units import S_NS

PAGE_PORT = 8016  # port of the page, as of `vlp16emu view`
_MOST_WAITING = 512  # packets that wait for the copying thread: half a second of single return
_COPY_PERIOD_S = 0.05  # time between copies: half a revolution at 600 rpm
_MESSAGE_PACKETS = 16  # packets of a message: 100 kB with labels; a socket holds 208 KiB by default
_MESSAGE_BYTES = 200_000
_PAGE_KINDS = (PacketKind.DATA, PacketKind.POSITION)


@dataclass(frozen=True, slots=True)
class PageSetup:
    """Constants of a page, sent to its process at the start."""

    scene: str  # name, path or title of the scene
    port: int  # port of the page; 0 for any that is free
    units: int  # number of sensors
    species: Mapping[int, str]  # names by number


@dataclass(frozen=True, slots=True)
class Batch:
    """Sent packets, and the state of the stream after the last of them."""

    packets: tuple[Packet, ...]
    """Data and position packets of all sensors; data packets with labels if they are at hand."""
    world_T_sensor: F8  # (n, 4, 4) pose of the sensor of each packet at its first pulse
    since_s: float  # time of the last packet since the first pulse
    sent: Mapping[PacketKind, int]  # packets so far, by kind
    late: int  # of them, those that were late by more than `TOLERANCE_NS`
    lateness: Lateness
    delay_s: float  # shift of all deadlines so far
    web: tuple[tuple[str, int], ...]  # host and port of the web interface of each sensor; empty without


def instant_ns(packet: Packet) -> int:
    """Return the UTC of a packet's first pulse in ns.

    A packet without pulses, or of a prepared run, has its due time.
    """
    return packet.due_ns if packet.fired_ns is None else packet.fired_ns


def offer(channel: socket.socket, message: object) -> bool:
    """Send a message without waiting, and return False if the other end is gone.

    The message is lost if there is no room for it now.
    """
    try:
        channel.send(pickle.dumps(message), socket.MSG_DONTWAIT)
    except ConnectionError:
        return False
    except OSError:  # no room, or no memory for the message
        pass
    return True


def receive(channel: socket.socket) -> Any:
    """Wait for the next message, and return it; raises EOFError if the other end is gone."""
    data = b""
    with suppress(ConnectionError):
        data = channel.recv(_MESSAGE_BYTES)
    if not data:
        raise EOFError
    return pickle.loads(data)  # noqa: S301  # the other end is a process of ours


class LivePage(StreamPart):
    """The page of one stream, which keeps the last packets for a thread that copies them to its process.

    Parameters
    ----------
    url : address of the page
    channel : socket to its process
    """

    def __init__(self, url: str, channel: socket.socket) -> None:
        self.url = url
        self.waiting = deque[tuple[Packet, int]](maxlen=_MOST_WAITING)
        """Packets for the copying thread, with their lateness in ns."""
        self.counts = Counter[PacketKind]()
        """Number of packets so far, by kind."""
        self.late = 0
        """Number of those that were late by more than `TOLERANCE_NS`."""
        self._channel = channel
        self._lateness = LatenessHistogram()
        self._over = Event()
        self._thread = Thread(target=self._copy, name="page", daemon=True)
        self._stream: SceneStream

    def follow(self, stream: SceneStream) -> None:
        """Join a stream as one of its parts."""
        self._stream = stream
        stream.add(self)

    def begin(self) -> None:
        """Start the copying thread."""
        self._thread.start()

    def sent(self, packet: Packet) -> None:
        """Keep a packet for the copying thread."""
        late_ns = self._stream.pacer.late_ns
        self.counts[packet.kind] += 1
        self.late += late_ns > TOLERANCE_NS
        self.waiting.append((packet, late_ns))

    def end(self, _error: BaseException | None) -> None:
        """Stop the copying thread."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()

    def _copy(self) -> None:
        """Send the packets that wait, until the stream or the page ends."""
        while not self._over.wait(_COPY_PERIOD_S):
            for _ in range(math.ceil(len(self.waiting) / _MESSAGE_PACKETS)):
                count = min(_MESSAGE_PACKETS, len(self.waiting))
                oldest = [self.waiting.popleft() for _ in range(count)]
                for _, late_ns in oldest:
                    self._lateness.add(late_ns)
                packets = [packet for packet, _ in oldest if packet.kind in _PAGE_KINDS]
                try:
                    batch = self._batch(packets)
                except (Vlp16emuError, CancelledError):  # a live run has just ended, and has no more poses
                    return
                if batch and not offer(self._channel, batch):
                    self._stream.say("the page in the browser has ended; the stream goes on")
                    return

    def _batch(self, packets: Sequence[Packet]) -> Batch | None:
        """Return packets with their poses and the state of the stream; None without packets."""
        if not packets:
            return None
        stream = self._stream
        t_ns = np.array([instant_ns(packet) for packet in packets])
        unit_numbers = np.array([packet.unit for packet in packets])
        poses = np.empty((len(packets), 4, 4))
        for unit in stream.emulator.parts.units:
            is_of_unit = unit_numbers == unit.number
            if is_of_unit.any():
                poses[is_of_unit] = unit.world_T_sensor(t_ns[is_of_unit])
        return Batch(
            packets=tuple(with_labels(packet) for packet in packets),
            world_T_sensor=poses,
            since_s=(packets[-1].due_ns - stream.emulator.scenario.start_ns) / S_NS,
            sent=dict(self.counts),
            late=self.late,
            lateness=self._lateness.summary,
            delay_s=stream.pacer.delay_ns / S_NS,
            web=tuple(stream.web.places) if stream.web else (),
        )


def with_labels(packet: Packet) -> Packet:
    """Return a packet with only the labels of its ground truth, a sixth of the bytes."""
    if packet.slots is None:
        return packet
    return replace(packet, slots=repack_fields(packet.slots[list(Labels.__slots__)]))


@contextmanager
def live_page(emulator: Emulator, port: int) -> Iterator[LivePage]:
    """Start the process of a page, and kill it at the end of the context.

    Parameters
    ----------
    emulator : scene of the stream
    port : port of the page on this machine; 0 for any that is free

    Raises OutputError if the port is in use; RunError if the process ends before it serves the page.
    """
    from vlp16emu.extras.viewer.sweeps import species_of

    scenario = emulator.scenario
    setup = PageSetup(emulator.name, port, len(emulator.parts.units), species_of(scenario))
    # Packets of bytes: messages stay apart, and a reader learns that the writer is gone (unix(7)).
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours:
        with theirs:
            # -P: no module of the current folder. A session of its own: Ctrl-C is for the stream.
            process = subprocess.Popen(  # noqa: S603  # a module of ours
                [sys.executable, "-P", "-m", "vlp16emu.extras.viewer.live_page", str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                start_new_session=True,
                env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
            )
        try:
            yield LivePage(_url(ours, setup), ours)
        finally:
            process.kill()  # it has nothing to finish, and may hang
            process.wait()


def _url(channel: socket.socket, setup: PageSetup) -> str:
    """Send the constants of the page, and return its address when it is served; errors as `live_page`."""
    offer(channel, setup)
    try:
        answer = receive(channel)
    except EOFError:
        raise RunError("the page in the browser has ended before it began") from None
    if isinstance(answer, Vlp16emuError):
        raise answer
    return str(answer)
