"""Packets in real time: computed ahead by one thread, sent at their deadlines by another."""

import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from vlp16emu.errors import InputError
from vlp16emu.packets.retime import age_ns, has_stamp, moved, stamp_ns
from vlp16emu.sinks.look_ahead import LookAhead
from vlp16emu.sinks.pacing import (
    TOLERANCE_NS,
    DelayLog,
    FellBehind,
    Late,
    Lateness,
    LatenessHistogram,
    Pacer,
    prompt_sleeps,
)
from vlp16emu.sinks.sink import PacketSink
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import HOUR_NS, S_NS

LOOK_AHEAD_PACKETS = 2048
"""About 2.3 s of single return with its position packets, 1.2 s of dual; 2.6 MB."""

_SWITCH_INTERVAL_S = 0.000_2
"""Longest time for which the thread that computes may keep the interpreter from the one that sends. Python's own
5 ms would be four packets late."""
_SPACING_NS = 1_327_104
"""Spacing of data packets in single return, the longest there is (VLP-16 manual 63-9243 Rev D, section 8.2)."""
_PATIENCE_NS = 250_000_000
"""Time of computing packets that are dropped, before the engine is asked to go on further ahead."""
_LEAD_NS = 250_000_000
"""First lead of the engine: most engines have ended the blocks under way and begun new ones by then; it doubles for others."""
_ASLEEP_NS = 20_000_000
"""Last part of the wait for an instant, in which only the clock is looked at and no longer the stop event."""


@dataclass(frozen=True, slots=True)
class UnderWay:
    """A stream that is being sent, for those who change it."""

    _ahead: LookAhead
    _pacer: Pacer
    _first_due_ns: int

    def due_in_ns(self, ahead_ns: int) -> int:
        """Due time, UTC, of a packet that leaves some time ahead of now."""
        if not self._pacer.has_begun:
            return self._first_due_ns + round(ahead_ns * self._pacer.speed)
        return self._pacer.due_in_ns(ahead_ns)

    @property
    def made_until_ns(self) -> int:
        """Due time, UTC, up to which packets have been computed; far off once all have been."""
        return self._ahead.made_until_ns

    def redo(self, due_ns: int, restart: Callable[[int], None]) -> None:
        """Compute packets again, as `LookAhead.redo`."""
        self._ahead.redo(due_ns, restart)


@dataclass(frozen=True, slots=True)
class FirstPacket:
    """Times at which the first packet of a stream left, by each clock in UTC ns since 1970."""

    truth_ns: int
    """Time in the scene or the capture: the time of the ground truth."""
    sensor_ns: int | None
    """Time by the sensor's clock, as moved into the present; None if it was not moved."""
    host_ns: int
    """Time by the clock of this system, read as soon as it had left."""


@dataclass(frozen=True, slots=True)
class StreamReport:
    """Punctuality and extent of a stream."""

    lateness: Lateness
    """Against deadlines as they were when each packet came to its turn."""
    simulated_s: float
    """Time that the packets span."""
    wall_s: float
    """Time from sending the first to sending the last."""
    behind: tuple[FellBehind, ...]
    """Each time that packets were late by more than the tolerance, whatever the cause."""
    delay_s: float
    """Time by which deadlines have been moved in all; 0 where late packets are skipped."""
    skipped: Counter[PacketKind]
    """Packets dropped because they were late."""
    moved_s: int
    """Whole seconds by which packets were moved into the present; 0 where they were not."""
    first: FirstPacket | None
    """None if no packet left."""
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
    late: Late = Late.PACE,
    notify: Callable[[FellBehind], None] = lambda _: None,
    go_on_from: Callable[[int], None] | None = None,
    now: bool = False,
    begun: Callable[[UnderWay], None] = lambda _: None,
    stop: threading.Event | None = None,
    look_ahead_packets: int = LOOK_AHEAD_PACKETS,
) -> StreamReport:
    """Send packets at their deadlines until they end, `stop` is set, or Ctrl-C is pressed.

    The clock starts when the look-ahead buffer is full. Packets never leave in a burst: see `Pacer.wait`.

    Parameters
    ----------
    packets : in order of sending; computed by a thread of their own
    sink : where they go; stays open
    pacer : fresh, with the speed
    late : what happens to packets late by more than `TOLERANCE_NS`
    notify : called by the sending thread each time that the stream falls behind
    go_on_from : with `skip`, makes `packets` leave out those that are due before a UTC time in ns
    now : send packets as of the present, as `NowSink` does
    begun : called before the first packet leaves
    stop : ends the stream from another thread
    look_ahead_packets : size of the buffer

    Raises
    ------
    InputError : If the present is wanted at another speed than its own.
    RunError : If the sink cannot send.
    """
    if now and pacer.speed != 1.0:
        raise InputError("--now", f"a speed of {pacer.speed:g}", "a speed of 1, which is that of the clock")
    stop = stop or threading.Event()
    present = NowSink(sink) if now else None
    sender = Sender(present or sink, pacer, late=late, notify=notify, go_on_from=go_on_from, is_over=stop.is_set)
    left, interrupted = None, False
    try:
        with _prompt_switching(), prompt_sleeps(), LookAhead(packets, look_ahead_packets, stop) as ahead:
            ahead.fill()
            if first := ahead.first:
                begun(UnderWay(ahead, pacer, first.due_ns))
                if present and pacer.has_begun:
                    present.join(first, pacer.left_ns(first.due_ns))
                elif present:
                    pacer.begin(first.due_ns, present.begin(first, stop))
            had_to_wait = False
            while (packet := ahead.take(sender.watch)) is not None:
                sender.send(packet, had_to_wait=had_to_wait, engine_speed=ahead.engine_speed)
                if left is None and not stop.is_set():
                    left = FirstPacket(packet.due_ns, present.began_ns if present else None, time.time_ns())
                had_to_wait = ahead.is_empty
            interrupted = stop.is_set()
    except KeyboardInterrupt:
        interrupted = True
    return sender.report(interrupted=interrupted, moved_s=present.moved_s if present else 0, first=left)


@contextmanager
def _prompt_switching() -> Iterator[None]:
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    try:
        yield
    finally:
        sys.setswitchinterval(before_s)


class Sender:
    """Sends or drops packet by packet until `is_over`, and keeps the figures of the report; parameters as `stream`."""

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
        self._sink, self._pacer, self._is_over = sink, pacer, is_over
        self._late, self._go_on_from = late, go_on_from
        self._log = DelayLog(late, notify)
        self._lateness = LatenessHistogram()
        self._skipped = Counter[PacketKind]()
        self._skipping_since_ns: int | None = None
        self._lead_ns = self._gone_on_from_ns = 0
        self._next_due_ns: int | None = None

    def send(self, packet: Packet, *, had_to_wait: bool, engine_speed: float | None = None) -> None:
        """Send at the deadline; `had_to_wait` says that the packet was not ready when it was asked for."""
        self._next_due_ns = packet.due_ns + _SPACING_NS
        deadline_ns = self._pacer.deadline_ns(packet.due_ns)
        behind_ns = self._pacer.behind_ns(deadline_ns)
        if behind_ns > TOLERANCE_NS:
            since_ns = self._pacer.since_start_ns(deadline_ns)
            self._log.add(behind_ns, since_ns, engine=had_to_wait, engine_speed=engine_speed)
            if self._late is Late.SKIP:
                self._skip(packet, since_ns + behind_ns, had_to_wait=had_to_wait)
                return
            self._pacer.delay(behind_ns)
        self._skipping_since_ns, self._lead_ns = None, 0
        late_ns = self._pacer.wait(packet, deadline_ns, is_over=self._is_over)
        if self._is_over():
            return
        self._lateness.add(late_ns)
        self._sink.send(packet)
        self._pacer.left(packet)

    def watch(self, engine_speed: float | None) -> None:
        """Notify if the next packet, which is waited for, is late by more than the tolerance already."""
        if self._next_due_ns is None:
            return
        deadline_ns = self._pacer.deadline_ns(self._next_due_ns)
        behind_ns = self._pacer.behind_ns(deadline_ns)
        if behind_ns > TOLERANCE_NS:
            since_ns = self._pacer.since_start_ns(deadline_ns)
            self._log.overdue(behind_ns, since_ns, engine_speed=engine_speed)

    def report(self, *, interrupted: bool, moved_s: int = 0, first: FirstPacket | None = None) -> StreamReport:
        """Sum up."""
        simulated_ns, wall_ns = self._pacer.elapsed_ns
        return StreamReport(
            lateness=self._lateness.summary,
            simulated_s=simulated_ns / S_NS,
            wall_s=wall_ns / S_NS,
            behind=tuple(self._log.times),
            delay_s=self._pacer.delay_ns / S_NS,
            skipped=self._skipped,
            interrupted=interrupted,
            moved_s=moved_s,
            first=first,
        )

    def _skip(self, packet: Packet, now_ns: int, *, had_to_wait: bool) -> None:
        """Drop a packet; where dropping does not end, because the engine is too slow, let it go on further ahead.

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


class NowSink(PacketSink):
    """Passes packets on, moved by a whole number of seconds into the present of the system's clock.

    Because seconds stay whole, the pulses of the receiver, its sentences and the stamps stay as far apart as they were. For that
    the stream begins at the instant that has the first packet's fraction of a second: it waits for less than one.

    Parameters
    ----------
    sink : where they go
    clock_ns : UTC
    sleep : suspends the thread for some seconds
    """

    def __init__(
        self,
        sink: PacketSink,
        *,
        clock_ns: Callable[[], int] = time.time_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._sink, self._clock_ns, self._sleep = sink, clock_ns, sleep
        self._ahead_ns = 0
        self.moved_s = 0
        """Whole seconds from the time of the packets to the present; known when the first one leaves, as `began_ns`."""
        self.began_ns = 0
        """UTC at which that is by the sensor's clock."""

    def begin(self, first: Packet, stop: threading.Event) -> int:
        """Wait for the instant at which the first packet leaves, or until the stream is to stop.

        Returns
        -------
        Time since the instant, in ns; negative before it
        """
        sent_ns, now_ns = self._sent_ns(first), self._clock_ns()
        at_ns = now_ns + (sent_ns - now_ns) % S_NS
        if (left_ns := at_ns - self._clock_ns()) > _ASLEEP_NS:
            stop.wait((left_ns - _ASLEEP_NS) / S_NS)
        while not stop.is_set() and (left_ns := at_ns - self._clock_ns()) > 0:
            self._sleep(left_ns / S_NS)
        self._start(first, sent_ns, at_ns)
        return self._clock_ns() - at_ns

    def join(self, first: Packet, left_ns: int) -> None:
        """Begin where a clock runs already, by which the first packet leaves in some time, or left some time ago."""
        sent_ns, due_ns = self._sent_ns(first), self._clock_ns() + left_ns
        self._start(first, sent_ns, sent_ns + round((due_ns - sent_ns) / S_NS) * S_NS)

    def _sent_ns(self, first: Packet) -> int:
        """Return the UTC at which a packet leaves by its own stamp, or is due without one."""
        if not has_stamp(first):
            return first.due_ns
        moved(first, 0, first.due_ns)  # Python loads what parses dates in the first one's time, 3 ms
        made_ns = stamp_ns(first)
        hour_ns = (first.due_ns - age_ns(first) - made_ns + HOUR_NS // 2) // HOUR_NS * HOUR_NS
        return hour_ns + made_ns + age_ns(first)

    def _start(self, first: Packet, sent_ns: int, at_ns: int) -> None:
        self.moved_s, self.began_ns, self._ahead_ns = (at_ns - sent_ns) // S_NS, at_ns, at_ns - first.due_ns

    def send(self, packet: Packet) -> None:
        """Send one packet; errors are the sink's."""
        self._sink.send(moved(packet, self.moved_s, packet.due_ns + self._ahead_ns))
