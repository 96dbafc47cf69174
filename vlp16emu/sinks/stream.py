"""Packets in real time: computed ahead by one thread, sent at their deadlines by another."""

import sys
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from vlp16emu.sinks.look_ahead import LookAhead
from vlp16emu.sinks.pacing import Lateness, LatenessHistogram, Pacer
from vlp16emu.sinks.sink import PacketSink
from vlp16emu.types import Packet
from vlp16emu.units import S_NS

__all__ = ["LOOK_AHEAD_PACKETS", "StreamReport", "stream"]

LOOK_AHEAD_PACKETS = 2048
"""About 2.3 s of single return with its position packets, 1.2 s of dual; 2.6 MB."""

_SWITCH_INTERVAL_S = 0.000_2
"""For how long the thread that computes may keep the interpreter from the one that sends. Python's own
5 ms would be four packets late."""


@dataclass(frozen=True, slots=True)
class StreamReport:
    """How a stream went."""

    lateness: Lateness
    simulated_s: float
    """Time that the packets span."""
    wall_s: float
    """Time from sending the first to sending the last."""
    fell_behind: int
    """Times the sender had to wait for a packet until after its deadline."""
    most_behind_s: float
    """Longest such delay."""
    interrupted: bool
    """Ended by Ctrl-C or the stop event, not by the last packet."""

    @property
    def real_time_factor(self) -> float:
        """Simulated seconds per second; the speed asked for, if the engine kept up. 0 for an empty stream."""
        return self.simulated_s / self.wall_s if self.wall_s > 0 else 0.0


def stream(
    packets: Iterable[Packet],
    sink: PacketSink,
    pacer: Pacer,
    *,
    stop: threading.Event | None = None,
    look_ahead_packets: int = LOOK_AHEAD_PACKETS,
) -> StreamReport:
    """Send packets at their deadlines until they end, `stop` is set, or Ctrl-C is pressed.

    The clock starts when the look-ahead buffer is full. Deadlines are never moved: a packet that was
    computed too late leaves at once, and those behind it follow until the stream has caught up.

    Parameters
    ----------
    packets : in order of sending; computed by a thread of their own
    sink : where they go; stays open
    pacer : fresh, with the speed
    stop : ends the stream from another thread
    look_ahead_packets : size of the buffer

    Raises
    ------
    RunError
        If the sink cannot send.
    """
    stop = stop or threading.Event()
    sender = _Sender(sink, pacer)
    interrupted = False
    try:
        with _prompt_switching(), LookAhead(packets, look_ahead_packets, stop) as ahead:
            ahead.fill()
            had_to_wait = False
            while (packet := ahead.take()) is not None:
                sender.send(packet, had_to_wait=had_to_wait)
                had_to_wait = ahead.is_empty
            interrupted = stop.is_set()
    except KeyboardInterrupt:
        interrupted = True
    return sender.report(interrupted=interrupted)


@contextmanager
def _prompt_switching() -> Iterator[None]:
    """Let threads take turns quickly; as before afterwards."""
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    try:
        yield
    finally:
        sys.setswitchinterval(before_s)


class _Sender:
    """Sends packet by packet and keeps the books."""

    def __init__(self, sink: PacketSink, pacer: Pacer) -> None:
        self._sink, self._pacer = sink, pacer
        self._late = LatenessHistogram()
        self._fell_behind = 0
        self._most_behind_ns = 0
        self._is_behind = False

    def send(self, packet: Packet, *, had_to_wait: bool) -> None:
        """Send at the deadline; `had_to_wait` says that the packet was not ready when it was asked for."""
        deadline_ns = self._pacer.deadline_ns(packet.due_ns)
        self._watch_engine(self._pacer.behind_ns(deadline_ns), had_to_wait=had_to_wait)
        self._late.add(self._pacer.wait(deadline_ns))
        self._sink.send(packet)

    def report(self, *, interrupted: bool) -> StreamReport:
        """Sum up."""
        simulated_ns, wall_ns = self._pacer.elapsed_ns
        return StreamReport(
            lateness=self._late.summary,
            simulated_s=simulated_ns / S_NS,
            wall_s=wall_ns / S_NS,
            fell_behind=self._fell_behind,
            most_behind_s=self._most_behind_ns / S_NS,
            interrupted=interrupted,
        )

    def _watch_engine(self, behind_ns: int, *, had_to_wait: bool) -> None:
        """Tell an engine that is too slow, from the first late packet until one is in time again."""
        if behind_ns == 0:
            self._is_behind = False
        elif had_to_wait and not self._is_behind:
            self._is_behind = True
            self._fell_behind += 1
        if self._is_behind:
            self._most_behind_ns = max(self._most_behind_ns, behind_ns)
