"""Real-time streaming: packets are computed ahead by one thread and sent at their deadlines by another."""

import os
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from dataclasses import dataclass
from typing import Any, Self

from vlp16emu.doors import door
from vlp16emu.errors import InputError
from vlp16emu.sinks.pacing import TOLERANCE_NS, FellBehind, Late, Lateness, LatenessHistogram, Pacer, prompt
from vlp16emu.types import Packet, PacketKind, PacketSink
from vlp16emu.units import S_NS

LOOK_AHEAD_PACKETS = 2048  # About 2.3 s of single return with its position packets, 1.2 s of dual; 2.6 MB

_SPACING_NS = 1_327_104
"""Spacing of data packets in single return, the longest (VLP-16 manual 63-9243 Rev D, section 8.2)."""
_PATIENCE_NS = 250_000_000
"""Time of computing dropped packets before the engine is asked to skip further ahead."""
_LEAD_NS = 250_000_000
"""First lead of the engine: most engines have ended their blocks and started new ones by then; else it
doubles."""
_SETTLED_NS = 5 * S_NS
"""Time without late packets after which the next late packet counts as falling behind again."""
_POLL_S = 0.05  # interval at which a waiting thread checks for a stop
_REFILLS = 8
"""Share of the full buffer that is taken before it is filled again: waking the computing thread for each
packet would cost the sending thread as much as sending."""
_NICE = 3
"""Niceness added to computing threads. A driver that shares a core with one of them gets two thirds of it; at
equal priority it gets half, and a driver that needs half loses packets. More niceness would cost speed beside
other programs, and the sending thread would be late more often: it waits for the interpreter, which a thread
without a core may hold."""


class LookAhead:
    """Iterates over packets in its own thread, at most `capacity` of them ahead of `take`.

    A context manager; leaving it stops the thread after the current packet. The thread is a daemon, so a
    second Ctrl-C need not wait for it. On Linux it and the threads that it starts have a lower priority,
    which new threads inherit; on other systems the priority belongs to the process.

    Parameters
    ----------
    packets : packets in order of sending; from now on used by the thread alone
    capacity : greatest number of packets held
    stop : event that ends the wait of both sides
    """

    def __init__(self, packets: Iterable[Packet], capacity: int, stop: threading.Event) -> None:
        self._capacity = capacity
        self._stop = stop
        self._room_at = capacity - max(capacity // _REFILLS, 1)
        self._ready = deque[Packet]()
        self._changed = threading.Condition()
        self._done = self._ended = False
        self._left = False
        self._error: BaseException | None = None
        self._made_due_ns = 0
        self._full: tuple[int, int] | None = None
        self._redo: tuple[int, Callable[[int], None]] | None = None
        self._thread = threading.Thread(
            target=self._run, args=(iter(packets),), name="look-ahead", daemon=True
        )

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._changed:
            self._left = True
            self._changed.notify_all()
        self._thread.join()

    @property
    def first(self) -> Packet | None:
        """Packet that `take` returns next, if it is ready."""
        return self._ready[0] if self._ready else None

    @property
    def made_until_ns(self) -> int:
        """Due time of the last computed packet; far in the future once all are computed."""
        return 2**63 if self._done else self._made_due_ns

    @property
    def engine_speed(self) -> float | None:
        """Simulated time per computing time since the buffer was last full; None before."""
        if (full := self._full) is None:
            return None
        clock_ns, due_ns = full
        return (self._made_due_ns - due_ns) / max(time.monotonic_ns() - clock_ns, 1)

    def fill(self) -> None:
        """Wait until the buffer is full, the packets have ended, or `stop` is set."""
        with self._changed:
            while len(self._ready) < self._capacity and not self._done and not self._over:
                self._changed.wait(_POLL_S)

    def take(self, waiting: Callable[[float | None], None] = lambda _: None) -> Packet | None:
        """Next packet; None at the end or when `stop` is set. While it waits, it calls `waiting` with the engine's speed every 50 ms.

        Raises
        ------
        BaseException : Error of the packet iterator, raised once the packets before it have been taken.
        """
        with self._changed:
            while not self._ready and not self._done and not self._over:
                if not self._changed.wait(_POLL_S):
                    waiting(self.engine_speed)
            if self._over:
                return None
            if self._ready:
                packet = self._ready.popleft()
                if len(self._ready) == self._room_at or not self._ready:
                    self._changed.notify_all()
                return packet
        if self._error is not None:
            raise self._error
        return None

    def redo(self, due_ns: int, restart: Callable[[int], None]) -> None:
        """Compute again the packets due from `due_ns` on that are not taken yet; from any thread. No effect after the last packet.

        `restart` makes the packet iterator start again at a due time; the computing thread calls it.
        """
        with self._changed:
            if self._ended:
                return
            earliest_ns = min(due_ns, self._redo[0]) if self._redo else due_ns
            while self._ready and self._ready[-1].due_ns >= earliest_ns:
                self._ready.pop()
            # A finished thread waits until its buffer is empty, so that it can still start again.
            self._redo = (earliest_ns, restart)
            self._done = False
            self._made_due_ns = min(self._made_due_ns, earliest_ns)
            self._changed.notify_all()

    @property
    def _over(self) -> bool:
        return self._left or self._stop.is_set()

    def _wait_for_room(self, packet: Packet | None) -> None:
        """Wait until a share of the full buffer has been taken, after the last packet all of it; holds the lock.

        It also ends at a stop, or if the buffer must be computed again.
        """
        most = self._room_at
        if packet is None:
            most = 0
            self._done = True
            self._changed.notify_all()
        elif len(self._ready) < self._capacity:
            return
        while len(self._ready) > most and not self._over and self._redo is None:
            self._changed.wait(_POLL_S)
        if packet is not None:
            self._full = time.monotonic_ns(), packet.due_ns

    def _run(self, packets: Iterator[Packet]) -> None:
        if sys.platform == "linux":
            os.nice(_NICE)
        try:
            while True:
                packet = next(packets, None)
                with self._changed:
                    self._wait_for_room(packet)
                    redo = self._redo
                    self._redo = None
                    if self._over or (packet is None and redo is None):
                        return
                    if packet is not None and (redo is None or packet.due_ns < redo[0]):
                        self._made_due_ns = packet.due_ns
                        self._ready.append(packet)
                        self._changed.notify_all()
                if redo is not None:
                    due_ns, restart = redo
                    restart(due_ns)
        except BaseException as error:  # noqa: BLE001  # raised in the taking thread
            self._error = error
        finally:
            with self._changed:
                self._done = self._ended = True
                self._changed.notify_all()


@dataclass(frozen=True, slots=True)
class UnderWay:
    """An active stream, for code that changes it."""

    _ahead: LookAhead
    _pacer: Pacer
    _first_due_ns: int

    def due_in_ns(self, ahead_ns: int) -> int:
        """Due time, UTC, of a packet that is sent `ahead_ns` after now."""
        if self._pacer.first_due_ns is None:
            return self._first_due_ns + round(ahead_ns * self._pacer.speed)
        return self._pacer.due_in_ns(ahead_ns)

    @property
    def made_until_ns(self) -> int:
        """Due time, UTC, up to which packets are computed; far in the future once all are."""
        return self._ahead.made_until_ns

    def redo(self, due_ns: int, restart: Callable[[int], None]) -> None:
        """Compute packets again, as in `LookAhead.redo`."""
        self._ahead.redo(due_ns, restart)


@dataclass(frozen=True, slots=True)
class FirstPacket:
    """Send time of the first packet of a stream, by each clock, in UTC ns since 1970."""

    truth_ns: int  # Time in the scene or the capture: the time of the ground truth
    sensor_ns: int | None  # Time by the sensor's clock, moved into the present; None if not moved
    host_ns: int  # Time by this system's clock, read right after sending


@dataclass(frozen=True, slots=True)
class StreamReport:
    """Punctuality and duration of a stream."""

    lateness: Lateness  # Relative to the deadlines valid when each packet was handled
    simulated_s: float  # Time that the packets span
    wall_s: float  # Time from sending the first to sending the last
    behind: tuple[
        FellBehind, ...
    ]  # Each time that packets were late by more than the tolerance, from any cause
    delay_s: float  # Total shift of deadlines; 0 if late packets are skipped
    skipped: Counter[PacketKind]  # Packets dropped because they were late
    moved_s: int  # Whole seconds by which packets were moved into the present; 0 if not moved
    first: FirstPacket | None  # None if no packet left
    interrupted: bool  # True if ended by Ctrl-C or the stop event

    @property
    def real_time_factor(self) -> float:
        """Simulated seconds per second; the requested speed if the engine kept up. 0 for an empty stream."""
        return self.simulated_s / self.wall_s if self.wall_s > 0 else 0.0


def stream(
    packets: Iterable[Packet],
    sink: PacketSink,
    pacer: Pacer,
    *,
    late: Late = Late.PACE,
    notify: Callable[[FellBehind], None] = lambda _: None,
    go_on_from: Callable[[int], None] | None = None,
    now: bool = False,
    begun: Callable[[UnderWay], None] = lambda _: None,
    stop: threading.Event | None = None,
    look_ahead_packets: int = LOOK_AHEAD_PACKETS,
) -> StreamReport:
    """Send packets at their deadlines until they end, `stop` is set, or Ctrl-C is pressed.

    The clock starts when the look-ahead buffer is full. Packets are never sent in a burst: see `Pacer.wait`.

    Parameters
    ----------
    packets : packets in order of sending; computed by a separate thread
    sink : destination; stays open
    pacer : new pacer with the speed
    late : treatment of packets late by more than `TOLERANCE_NS`
    notify : called by the sending thread each time that the stream falls behind
    go_on_from : with `skip`, makes `packets` leave out packets due before a UTC time in ns
    now : move stamps and sentences by whole seconds into the present
    begun : called before the first packet is sent
    stop : ends the stream from another thread
    look_ahead_packets : size of the buffer

    Raises InputError if `now` is combined with a speed other than 1; RunError if the sink cannot send.
    """
    if now and pacer.speed != 1.0:
        raise InputError("--now", f"a speed of {pacer.speed:g}", "a speed of 1, the speed of the clock")
    stop = stop or threading.Event()
    present: Any = door("present")(sink) if now else None
    sender = Sender(
        present or sink, pacer, late=late, notify=notify, go_on_from=go_on_from, is_over=stop.is_set
    )
    left = None
    interrupted = False
    try:
        with prompt(), LookAhead(packets, look_ahead_packets, stop) as ahead:
            ahead.fill()
            if first := ahead.first:
                begun(UnderWay(ahead, pacer, first.due_ns))
                if present and pacer.first_due_ns is not None:
                    present.join(first, pacer.deadline_ns(first.due_ns) - pacer.now_ns())
                elif present:
                    pacer.begin(first.due_ns, present.begin(first, stop))
            had_to_wait = False
            while (packet := ahead.take(sender.watch)) is not None:
                sender.send(packet, had_to_wait=had_to_wait, engine_speed=ahead.engine_speed)
                if left is None and not stop.is_set():
                    left = FirstPacket(packet.due_ns, present.began_ns if present else None, time.time_ns())
                had_to_wait = ahead.first is None  # read before the wait, which would hide it
            interrupted = stop.is_set()
    except (KeyboardInterrupt, CancelledError):  # the latter if `begun` waits for a world and `stop` is set
        interrupted = True
    return sender.report(interrupted=interrupted, moved_s=present.moved_s if present else 0, first=left)


class Sender:
    """Sends or drops packet by packet until `is_over`, and collects the report; parameters as in `stream`."""

    def __init__(
        self,
        sink: PacketSink,
        pacer: Pacer,
        *,
        late: Late,
        notify: Callable[[FellBehind], None],
        go_on_from: Callable[[int], None] | None,
        is_over: Callable[[], bool] = lambda: False,
    ) -> None:
        self._sink = sink
        self._pacer = pacer
        self._is_over = is_over
        self._late = late
        self._go_on_from = go_on_from
        self._notify = notify
        self._last_ns = 0
        self._behind = list[FellBehind]()
        self._lateness = LatenessHistogram()
        self._skipped = Counter[PacketKind]()
        self._skipping_since_ns: int | None = None
        self._lead_ns = self._gone_on_from_ns = 0
        self._next_due_ns: int | None = None

    def send(self, packet: Packet, *, had_to_wait: bool, engine_speed: float | None = None) -> None:
        """Send at the deadline; `had_to_wait` is True if the packet was not ready when requested."""
        pacer = self._pacer
        self._next_due_ns = packet.due_ns + _SPACING_NS
        deadline_ns = pacer.deadline_ns(packet.due_ns)
        late_ns = pacer.now_ns() - deadline_ns
        if late_ns > TOLERANCE_NS:
            behind = self._fell_behind(late_ns, deadline_ns, engine_speed, engine=had_to_wait)
            late_s = late_ns / S_NS
            if self._late is Late.SKIP:
                behind.total_s = max(behind.total_s, late_s)
                self._skip(packet, deadline_ns + late_ns, had_to_wait=had_to_wait)
                return
            behind.total_s += late_s
            pacer.delay_ns += late_ns  # permanently: catching up would be a burst, which no sensor sends
        self._skipping_since_ns = None
        self._lead_ns = 0
        late_ns = pacer.wait(packet, deadline_ns, is_over=self._is_over)
        if self._is_over():
            return
        self._lateness.add(late_ns)
        self._sink.send(packet)
        pacer.left(packet)

    def watch(self, engine_speed: float | None) -> None:
        """Notify if the awaited packet is already late by more than the tolerance; its delay is added when it is sent."""
        if self._next_due_ns is not None:
            deadline_ns = self._pacer.deadline_ns(self._next_due_ns)
            if (late_ns := self._pacer.now_ns() - deadline_ns) > TOLERANCE_NS:
                self._fell_behind(late_ns, deadline_ns, engine_speed, engine=True)

    def _fell_behind(
        self, late_ns: int, deadline_ns: int, engine_speed: float | None, *, engine: bool
    ) -> FellBehind:
        """Return the present period behind, or start one and notify of it."""
        before_ns = self._last_ns
        self._last_ns = deadline_ns + late_ns
        if not self._behind or self._last_ns - before_ns > _SETTLED_NS:
            at_s = (deadline_ns - self._pacer.start_ns) / S_NS
            self._behind.append(FellBehind(at_s, late_ns / S_NS, engine, engine_speed, self._pacer.speed))
            self._notify(self._behind[-1])
        elif engine:
            self._behind[-1].engine_speed = engine_speed
        return self._behind[-1]

    def report(
        self, *, interrupted: bool, moved_s: int = 0, first: FirstPacket | None = None
    ) -> StreamReport:
        """Sum up."""
        simulated_ns, wall_ns = self._pacer.elapsed_ns
        return StreamReport(
            lateness=self._lateness.summary,
            simulated_s=simulated_ns / S_NS,
            wall_s=wall_ns / S_NS,
            behind=tuple(self._behind),
            delay_s=self._pacer.delay_ns / S_NS,
            skipped=self._skipped,
            interrupted=interrupted,
            moved_s=moved_s,
            first=first,
        )

    def _skip(self, packet: Packet, now_ns: int, *, had_to_wait: bool) -> None:
        """Drop a packet; if dropping continues because the engine is too slow, let the engine skip further ahead.

        The lead doubles until the engine's first packet from there on is in time.
        """
        self._skipped[packet.kind] += 1
        self._pacer.break_off()
        if self._skipping_since_ns is None:
            self._skipping_since_ns = now_ns
        lasts = now_ns - self._skipping_since_ns > _PATIENCE_NS
        if self._go_on_from and had_to_wait and lasts and packet.due_ns >= self._gone_on_from_ns:
            self._lead_ns = 2 * self._lead_ns or _LEAD_NS
            self._gone_on_from_ns = self._pacer.due_in_ns(self._lead_ns)
            self._go_on_from(self._gone_on_from_ns)
            self._skipping_since_ns = now_ns
