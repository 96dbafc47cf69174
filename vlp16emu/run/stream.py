"""A stream: packets computed ahead by one thread, and sent at their deadlines by another, in named states."""

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from enum import Enum
from threading import Event
from typing import Protocol, Self

from vlp16emu.doors import Part
from vlp16emu.errors import InputError
from vlp16emu.packets import Link
from vlp16emu.run.options import SendOptions
from vlp16emu.run.part import StreamPart
from vlp16emu.sinks import (
    LOOK_AHEAD_PACKETS,
    TOLERANCE_NS,
    FellBehind,
    Late,
    Lateness,
    LatenessHistogram,
    LookAhead,
    Pacer,
    PacketSink,
    UdpSink,
)
from vlp16emu.sinks.pacing import prompt, settle_memory
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import S_NS

_SPACING_NS = 1_327_104
"""Spacing of data packets in single return, the longest (VLP-16 manual 63-9243 Rev D, section 8.2)."""
_PATIENCE_NS = 250_000_000
"""Time of computing dropped packets before the engine is asked to skip further ahead."""
_LEAD_NS = 250_000_000
"""First lead of the engine: most engines have ended their blocks and started new ones by then; else it
doubles."""
_SETTLED_NS = 5 * S_NS
"""Time without late packets after which the next late packet counts as falling behind again."""


class State(Enum):
    """What a stream is doing."""

    # Ports and sockets are open, and parts can be added; nothing is computed.
    OPENED = "opened"
    # The speed of this machine is measured, and settings are chosen with which the stream keeps up.
    MEASURING = "measuring"
    # A live scene waits for its first pose, and the first packets are computed.
    PREPARING = "preparing"
    # The clock runs, and each packet leaves at its deadline.
    SENDING = "sending"
    # No more packets leave: threads end, files are completed, ports are given back.
    SETTLING = "settling"
    # The report is final.
    CLOSED = "closed"


TRANSITIONS = {
    State.OPENED: {State.MEASURING, State.PREPARING, State.SETTLING},  # `measure`, `prepare`, or an early end
    State.MEASURING: {State.OPENED, State.SETTLING},  # settings are chosen, or an error
    State.PREPARING: {State.SENDING, State.SETTLING},  # `run`, or an error
    State.SENDING: {State.SETTLING},  # the last packet, a stop or an error
    State.SETTLING: {State.CLOSED},  # always, also after an error of what ends
    State.CLOSED: set[State](),
}
"""States that may follow each state, and what leads there."""


class Present(Protocol):
    """Moves packets by whole seconds into the present."""

    moved_s: int

    def start(self, first: Packet, pacer: Pacer, stop: Event) -> None:
        """Start the clock of a stream before its first packet."""

    def shift(self, packet: Packet) -> Packet:
        """Return a packet of the present."""

    def utc_ns(self, due_ns: int) -> int:
        """Return the UTC by the sensor's clock at which a packet with a due time leaves."""


PRESENT = Part[Callable[[], Present]]("vlp16emu.extras.bench.retime:Present")


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
    behind: tuple[FellBehind, ...]
    """Each time that packets were late by more than the tolerance, from any cause."""
    delay_s: float  # Total shift of deadlines; 0 if late packets are skipped
    skipped: Counter[PacketKind]  # Packets dropped because they were late
    moved_s: int  # Whole seconds by which packets were moved into the present; 0 if not moved
    first: FirstPacket | None  # None if no packet left
    interrupted: bool  # True if ended by Ctrl-C or the stop event

    @property
    def real_time_factor(self) -> float:
        """Simulated seconds per second; the requested speed if the engine kept up. 0 for an empty stream."""
        return self.simulated_s / self.wall_s if self.wall_s > 0 else 0.0


class Stream:
    """Packets that leave at their deadlines; a context manager, which is open once it is made.

    `run` does all that is left to do; `prepare` may be called before, on the same thread. Other threads set
    `stop`. Packets are never sent in a burst: see `Pacer.wait`.

    Parameters
    ----------
    packets : packets in order of sending; computed by a separate thread
    sinks : destination of the packets of each kind; they stay open
    pacer : new pacer with the speed
    late : treatment of packets late by more than `TOLERANCE_NS`
    now : move stamps and sentences by whole seconds into the present
    look_ahead : packets that are computed before the first one is sent
    stop : ends the stream from another thread

    Raises InputError if `now` is combined with a speed other than 1.
    """

    def __init__(
        self,
        packets: Iterable[Packet],
        sinks: Mapping[PacketKind, PacketSink],
        pacer: Pacer,
        *,
        late: Late = Late.PACE,
        now: bool = False,
        look_ahead: int = LOOK_AHEAD_PACKETS,
        stop: Event | None = None,
    ) -> None:
        if now and pacer.speed != 1.0:
            raise InputError("--now", f"a speed of {pacer.speed:g}", "a speed of 1, the speed of the clock")
        self.state = State.OPENED
        self.stop = stop or Event()
        self.pacer = pacer
        self.late = late
        self.parts: list[StreamPart] = []
        self._packets = packets
        self._sinks = dict(sinks)
        self._present = PRESENT.load()() if now else None
        self._look_ahead = look_ahead
        self._opened = ExitStack()  # all that ends with the stream
        self._ahead: LookAhead | None = None
        self._first: Packet | None = None
        self._first_sent: FirstPacket | None = None
        self._interrupted = False
        self._lateness = LatenessHistogram()
        self._behind = list[FellBehind]()
        self._last_late_ns = 0
        self._skipped = Counter[PacketKind]()
        self._skipping_since_ns: int | None = None
        self._lead_ns = 0
        self._gone_on_from_ns = 0
        self._next_due_ns: int | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        """Settle and close, unless that is done."""
        if self.state is State.CLOSED:
            return
        self._enter(State.SETTLING)
        try:
            self._opened.__exit__(*raised)  # type: ignore[arg-type]  # type, error and trace, or nothing
        finally:
            self._enter(State.CLOSED)

    def add(self, part: StreamPart) -> None:
        """Add a part, which ends with the stream, before `prepare`."""

        def ended(_kind: object, error: BaseException | None, _trace: object) -> None:
            part.end(error)

        self.parts.append(part)
        self._opened.push(ended)

    def prepare(self, progress: Callable[[float], None] = lambda _: None) -> None:
        """Compute packets until the first one can leave.

        `progress` is called with the simulated seconds so far if the whole run is computed before it is sent.
        """
        self._enter(State.PREPARING)
        packets = self._opened.enter_context(self._source(progress))
        for part in self.parts:
            part.begin()
        self._opened.enter_context(prompt())
        self._ahead = self._opened.enter_context(LookAhead(packets, self._look_ahead, self.stop))
        with self._interruptible():
            self._ahead.fill()
            self._first = self._ahead.first
            if self.pacer.first_due_ns is None:  # else the clock runs
                settle_memory()
            for part in self.parts if self._first else ():
                part.ready()

    def run(self) -> StreamReport:
        """Send packets until they end, `stop` is set, or Ctrl-C is pressed; close the stream, and report.

        Raises errors of packets, parts and sinks, such as RunError if the system can no longer send. An
        InputError of packets after the first ends the stream as an interrupt does, with a line, and all that
        was made is kept.
        """
        with self:
            if self.state is State.OPENED:
                self.prepare()
            self._enter(State.SENDING)
            with self._interruptible():
                self._send_all()
        return self.report

    @property
    def report(self) -> StreamReport:
        """Report so far; final once the stream is closed."""
        simulated_ns, wall_ns = self.pacer.elapsed_ns
        return StreamReport(
            lateness=self._lateness.summary,
            simulated_s=simulated_ns / S_NS,
            wall_s=wall_ns / S_NS,
            behind=tuple(self._behind),
            delay_s=self.pacer.delay_ns / S_NS,
            skipped=self._skipped,
            moved_s=self._present.moved_s if self._present else 0,
            first=self._first_sent,
            interrupted=self._interrupted,
        )

    def say(self, line: str) -> None:
        """Pass a line on to all parts."""
        for part in self.parts:
            part.news(line)

    def due_in_ns(self, ahead_ns: int) -> int:
        """Due time, UTC, of a packet that is sent `ahead_ns` after now; once the first packet is ready."""
        if self.pacer.first_due_ns is None:
            assert self._first is not None
            return self._first.due_ns + round(ahead_ns * self.pacer.speed)
        return self.pacer.due_in_ns(ahead_ns)

    @property
    def made_until_ns(self) -> int:
        """Due time, UTC, up to which packets are computed; far in the future once all are."""
        assert self._ahead is not None
        return self._ahead.made_until_ns

    def redo(self, due_ns: int, restart: Callable[[int], None]) -> None:
        """Compute packets again, as in `LookAhead.redo`."""
        assert self._ahead is not None
        self._ahead.redo(due_ns, restart)

    @contextmanager
    def _opening(self) -> Iterator[None]:
        """Close what is open if an error comes while a stream is made."""
        with ExitStack() as failed:
            failed.push(self)
            yield
            failed.pop_all()

    def _open_udp(self, links: Sequence[Link], options: SendOptions) -> UdpSink:
        """Open the sockets of sensors."""
        host, _ = options.receiver
        udp = UdpSink(links, host, as_sensor=options.is_from_sensor, interface=options.interface)
        self._opened.push(udp)
        self._sinks |= {PacketKind.DATA: udp, PacketKind.POSITION: udp}
        return udp

    def _enter(self, state: State) -> None:
        if state not in TRANSITIONS[self.state]:
            raise RuntimeError(
                f"found a stream that is {self.state.value}, which cannot be {state.value} next"
            )
        self.state = state

    def _source(self, _progress: Callable[[float], None]) -> AbstractContextManager[Iterable[Packet]]:
        """Return the packets, as a context manager that ends their computation."""
        return nullcontext(self._packets)

    def _behind_line(self, behind: FellBehind) -> str:
        """Return the line for people when the stream falls behind."""
        return f"behind: {behind.behind_s:.3f} s late at {behind.at_s:.1f} s"

    def _go_on_from(self, due_ns: int) -> None:
        """Leave out packets due before a UTC time in ns, if the packets are computed at once."""

    @contextmanager
    def _interruptible(self) -> Iterator[None]:
        try:
            yield
        except (KeyboardInterrupt, CancelledError):  # the latter if what waits for a world is stopped
            self._interrupted = True

    def _send_all(self) -> None:
        ahead = self._ahead
        if ahead is None or self._interrupted:
            return
        if self._present and self._first:
            self._present.start(self._first, self.pacer, self.stop)
        had_to_wait = False
        while (packet := self._next(ahead)) is not None:
            self._send(packet, had_to_wait=had_to_wait, engine_speed=ahead.engine_speed)
            had_to_wait = ahead.first is None  # read before the wait, which would hide it
        if self.stop.is_set():
            self._interrupted = True

    def _next(self, ahead: LookAhead) -> Packet | None:
        """Return the next packet; None at the end, or once the world cannot be cast any more."""
        try:
            return ahead.take(self._watch)
        except InputError as error:
            if self._first_sent is None:
                raise
            self.say(f"ended: {error}")
            self._interrupted = True
            return None

    def _send(self, packet: Packet, *, had_to_wait: bool, engine_speed: float | None) -> None:
        """Send or drop a packet at its deadline; `had_to_wait` is True if it was not ready when requested."""
        pacer = self.pacer
        self._next_due_ns = packet.due_ns + _SPACING_NS
        deadline_ns = pacer.deadline_ns(packet.due_ns)
        late_ns = pacer.now_ns() - deadline_ns
        if late_ns > TOLERANCE_NS:
            behind = self._falls_behind(late_ns, deadline_ns, engine_speed, engine=had_to_wait)
            late_s = late_ns / S_NS
            if self.late is Late.SKIP:
                behind.total_s = max(behind.total_s, late_s)
                self._skip(packet, deadline_ns + late_ns, had_to_wait=had_to_wait)
                return
            behind.total_s += late_s
            pacer.delay_ns += late_ns  # permanently: catching up would be a burst, which no sensor sends
        self._skipping_since_ns = None
        self._lead_ns = 0
        late_ns = pacer.wait(packet, deadline_ns, is_over=self.stop.is_set)
        if self.stop.is_set():
            return
        self._lateness.add(late_ns)
        self._deliver(packet)
        pacer.left(packet)

    def _deliver(self, packet: Packet) -> None:
        due_ns = packet.due_ns
        if self._present:
            packet = self._present.shift(packet)
        for part in self.parts:
            packet = part.leaving(packet)
        self._sinks[packet.kind].send(packet)
        if self._first_sent is None:
            sensor_ns = self._present.utc_ns(due_ns) if self._present else None
            self._first_sent = FirstPacket(due_ns, sensor_ns, time.time_ns())
        for part in self.parts:
            part.sent(packet)

    def _watch(self, engine_speed: float | None) -> None:
        """Say if the awaited packet is late by more than the tolerance.

        Its delay is added when it is sent.
        """
        if self._next_due_ns is None:
            return
        deadline_ns = self.pacer.deadline_ns(self._next_due_ns)
        late_ns = self.pacer.now_ns() - deadline_ns
        if late_ns > TOLERANCE_NS:
            self._falls_behind(late_ns, deadline_ns, engine_speed, engine=True)

    def _falls_behind(
        self, late_ns: int, deadline_ns: int, engine_speed: float | None, *, engine: bool
    ) -> FellBehind:
        """Return the present period behind, or start one and say so."""
        before_ns = self._last_late_ns
        self._last_late_ns = deadline_ns + late_ns
        if not self._behind or self._last_late_ns - before_ns > _SETTLED_NS:
            at_s = (deadline_ns - self.pacer.start_ns) / S_NS
            behind = FellBehind(at_s, late_ns / S_NS, engine, engine_speed, self.pacer.speed)
            self._behind.append(behind)
            self.say(self._behind_line(behind))
        elif engine:
            self._behind[-1].engine_speed = engine_speed
        return self._behind[-1]

    def _skip(self, packet: Packet, now_ns: int, *, had_to_wait: bool) -> None:
        """Drop a packet, and if that goes on because the engine is too slow, let it skip further ahead.

        The lead doubles until the engine's first packet from there on is in time.
        """
        self._skipped[packet.kind] += 1
        self.pacer.break_off()
        if self._skipping_since_ns is None:
            self._skipping_since_ns = now_ns
        lasts = now_ns - self._skipping_since_ns > _PATIENCE_NS
        if had_to_wait and lasts and packet.due_ns >= self._gone_on_from_ns:
            self._lead_ns = 2 * self._lead_ns or _LEAD_NS
            self._gone_on_from_ns = self.pacer.due_in_ns(self._lead_ns)
            self._go_on_from(self._gone_on_from_ns)
            self._skipping_since_ns = now_ns
