"""Packets in real time."""

import concurrent.futures
import gc
import itertools
import os
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
from listening import MemorySink
from sinks.kit import PERIOD_NS, make_packets

from vlp16emu.errors import GeometryError, RunError
from vlp16emu.run.part import StreamPart
from vlp16emu.run.stream import TRANSITIONS, State, Stream
from vlp16emu.sinks import Pacer
from vlp16emu.sinks.pacing import prompt, settle_memory
from vlp16emu.types import Packet, PacketKind

FAST = 1000.0


def stream(packets, sink, *, speed=FAST, parts=(), **options):
    """Send packets of all kinds to one sink, and return the report."""
    made = Stream(packets, dict.fromkeys(PacketKind, sink), Pacer(speed), **options)
    for part in parts:
        made.add(part)
    return made.run()


class Notified(StreamPart):
    """Calls a function with each line of its stream."""

    def __init__(self, notify):
        self.news = notify


class BreakingSink(MemorySink):
    """Raises an error at the n-th packet."""

    def __init__(self, at, error):
        super().__init__()
        self.at, self.error = at, error

    def send(self, packet):
        """Keep the packet, or raise."""
        if len(self.packets) == self.at:
            raise self.error
        super().send(packet)


def endless(made):
    """Make packets without end, and count them in a list."""
    for i in itertools.count():
        made.append(i)
        yield Packet(PacketKind.DATA, i * PERIOD_NS, b"")


def threads():
    """Count the look-ahead threads that are alive."""
    return sum(thread.name == "look-ahead" for thread in threading.enumerate())


@pytest.mark.parametrize("look_ahead", [1, 7, 2048])
def test_all_packets_arrive_in_order(look_ahead):
    """Whatever the buffer's size, a sink gets the very packets, in their order, and the report counts
    them."""
    packets = make_packets(300)
    with MemorySink() as sink:
        report = stream(iter(packets), sink, look_ahead=look_ahead)
    assert sink.packets == packets
    assert report.lateness.packets == 300
    assert report.simulated_s == pytest.approx(299 * 1.327104e-3)
    assert not report.interrupted
    assert threads() == 0


def test_packets_leave_in_real_time():
    """At speed 1 a quarter of a second of packets takes that time, and at speed 5 a fifth of it."""
    packets = make_packets(190)
    for speed in (1.0, 5.0):
        report = stream(packets, MemorySink(), speed=speed)
        assert report.wall_s >= report.simulated_s / speed - 1e-9  # deadlines are whole nanoseconds
        assert speed / 3 < report.real_time_factor <= speed * (1 + 1e-6)  # other programs may take the cores


@pytest.mark.skipif(sys.platform != "linux", reason="a thread has a priority of its own on Linux alone")
def test_threads_that_compute_give_way():
    """The computing thread and those that it starts have a nice value 3 above the sending thread, whose own
    is unchanged."""
    before, nice = os.getpriority(os.PRIO_PROCESS, 0), []

    def note():
        nice.append(os.getpriority(os.PRIO_PROCESS, 0))

    def computing():
        note()
        worker = threading.Thread(target=note)
        worker.start()
        worker.join()
        yield Packet(PacketKind.DATA, 0, b"")

    stream(computing(), MemorySink())
    assert nice == [min(before + 3, 19)] * 2
    assert os.getpriority(os.PRIO_PROCESS, 0) == before


def test_errors_and_ctrl_c_end_a_stream():
    """What the engine raises comes after the packets before it, and a sink that fails ends the stream and its
    endless engine.

    Ctrl-C ends it with a report of what was sent, and no packets are a factor of 0.
    """

    def failing():
        yield from make_packets(20)
        raise RunError("the engine is broken")

    sink = MemorySink()
    with pytest.raises(RunError, match="the engine is broken"):
        stream(failing(), sink)
    assert sink.packets == make_packets(20)
    assert threads() == 0
    with pytest.raises(RunError, match="link is down"):
        stream(endless([]), BreakingSink(5, RunError("link is down")))
    assert threads() == 0
    sink = BreakingSink(25, KeyboardInterrupt())
    report = stream(endless([]), sink)
    assert report.interrupted
    assert report.lateness.packets == 26
    assert threads() == 0
    report = stream([], MemorySink(), speed=1.0)
    assert (report.lateness.packets, report.wall_s, report.real_time_factor) == (0, 0.0, 0.0)


def test_a_world_that_ends_during_a_run_keeps_what_was_sent():
    """An InputError after the first packet ends the stream as an interrupt, with its line; one before it,
    where nothing is made yet, is raised."""

    def ending(count):
        yield from make_packets(count)
        raise GeometryError("track", "reaches the edge", "ground")

    sink, lines = MemorySink(), []
    report = stream(ending(20), sink, parts=[Notified(lines.append)])
    assert report.interrupted
    assert sink.packets == make_packets(20)
    assert lines == ["ended: track: reaches the edge; expected ground"]
    with pytest.raises(GeometryError, match="reaches the edge"):
        stream(ending(0), MemorySink())


def test_stop_event_ends_even_a_stream_that_waits_for_its_engine():
    """Setting the event ends a stream whose engine gives nothing for a while, and marks the report."""
    stop = threading.Event()

    def stuck():
        yield Packet(PacketKind.DATA, 0, b"")
        stop.set()
        time.sleep(0.2)
        yield Packet(PacketKind.DATA, 1, b"")

    report = stream(stuck(), MemorySink(), speed=1.0, stop=stop)
    assert report.interrupted
    assert threads() == 0


def test_stop_event_ends_a_stream_whose_receivers_wait_for_a_world():
    """A stream that is stopped before its first packet, while what begins beside it waits for a world, has
    a report."""
    stop, sink = threading.Event(), MemorySink()

    class Waiting(StreamPart):
        def ready(self):
            stop.set()
            raise concurrent.futures.CancelledError

    assert stream(make_packets(3), sink, speed=1.0, stop=stop, parts=[Waiting()]).interrupted
    assert sink.packets == []


def test_stop_event_and_switch_interval_are_left_as_they_were():
    """A stream that ends by itself does not set the caller's event; the interpreter's switch interval is
    short while it sends, and as before afterwards."""
    stop = threading.Event()
    assert not stream(make_packets(3), MemorySink(), stop=stop).interrupted
    assert not stop.is_set()
    before_s, during_s = sys.getswitchinterval(), set()

    class Looking(MemorySink):
        def send(self, packet):
            super().send(packet)
            during_s.add(sys.getswitchinterval())

    stream(make_packets(3), Looking())
    assert sys.getswitchinterval() == before_s
    assert max(during_s) < before_s


def test_a_slow_engine_is_reported_at_once():
    """An engine that pauses for 0.2 s after the buffer has run dry is notified once, while the stream
    runs."""
    times, sink = [], MemorySink()

    def pausing():
        for i, packet in enumerate(make_packets(100)):
            if i == 30:
                time.sleep(0.2)
            yield packet

    def notify(line):
        assert line.startswith("behind: ")
        times.append(len(sink.packets))

    report = stream(pausing(), sink, speed=1.0, look_ahead=8, parts=[Notified(notify)])
    assert len(times) == len(report.behind) == 1
    assert times[0] <= 30
    assert report.delay_s == pytest.approx(sum(behind.total_s for behind in report.behind))
    assert 0.1 < report.delay_s < 2.0
    assert report.lateness.packets == 100


def test_a_packet_that_does_not_come_is_notified_before_it_comes():
    """An engine that stands still is notified while the stream waits for it, and is one time with its
    delay."""
    notified = threading.Event()

    def stuck():
        packets = make_packets(100)
        yield from packets[:30]
        assert notified.wait(30)
        yield from packets[30:]

    report = stream(
        stuck(), MemorySink(), speed=1.0, look_ahead=8, parts=[Notified(lambda _: notified.set())]
    )
    assert len(report.behind) == 1
    assert report.behind[0].total_s == pytest.approx(report.delay_s)


def test_the_timer_slack_is_put_back():
    """The calling thread's sleeps are prompt inside, and as before afterwards."""
    if sys.platform != "linux":
        pytest.skip("prctl is Linux's")
    slack_ns = Path(f"/proc/self/task/{threading.get_native_id()}/timerslack_ns")
    slack_ns = slack_ns if slack_ns.exists() else Path("/proc/self/timerslack_ns")
    before = slack_ns.read_text()
    with prompt():
        assert slack_ns.read_text() == "1\n"
    assert slack_ns.read_text() == before


def test_streams_that_overlap_leave_the_switch_interval_as_it_was():
    """It stays short until the last of two streams ends, whichever begins first, and is then as before
    both."""
    before_s, first, second = sys.getswitchinterval(), prompt(), prompt()
    first.__enter__()
    short_s = sys.getswitchinterval()
    second.__enter__()
    first.__exit__(None, None, None)
    assert sys.getswitchinterval() == short_s < before_s
    second.__exit__(None, None, None)
    assert sys.getswitchinterval() == before_s


def test_collections_spare_what_was_alive_until_the_last_stream_ends():
    """Objects that are alive when memory is settled are out of all collections while any stream is active."""
    first, second = prompt(), prompt()
    first.__enter__()
    second.__enter__()
    settle_memory()
    first.__exit__(None, None, None)
    assert gc.get_freeze_count() > 1000
    second.__exit__(None, None, None)
    assert gc.get_freeze_count() == 0


class Noted(StreamPart):
    """Notes what its stream asks of it, and the state of the stream then."""

    def __init__(self, made, name, notes, *, fails_at=None):
        self.made, self.name, self.notes, self.fails_at = made, name, notes, fails_at
        made.add(self)

    def note(self, what):
        """Note a call, and fail if that is asked for."""
        self.notes.append((self.name, what, self.made.state))
        if what == self.fails_at:
            raise RunError(what)

    def begin(self):
        self.note("begin")

    def ready(self):
        self.note("ready")

    def leaving(self, packet):
        self.note("leaving")
        return replace(packet, payload=packet.payload + self.name.encode())

    def sent(self, packet):  # noqa: ARG002
        self.note("sent")

    def end(self, error):
        self.error = error
        self.note("end")


def test_parts_are_called_in_their_order_and_end_in_the_reverse_order():
    """Each part gets the packet of the part before it, in the states that the base names; the last ends
    first."""
    sink, notes = MemorySink(), []
    made = Stream(make_packets(1), dict.fromkeys(PacketKind, sink), Pacer(FAST))
    for name in "ab":
        Noted(made, name, notes)
    made.run()
    called = [
        *[(what, State.PREPARING) for what in ("begin", "ready")],
        *[(what, State.SENDING) for what in ("leaving", "sent")],
    ]
    assert notes == [
        *[(name, what, state) for what, state in called for name in "ab"],
        *[(name, "end", State.SETTLING) for name in "ba"],
    ]
    assert sink.packets[0].payload.endswith(b"ab")
    assert made.state is State.CLOSED


@pytest.mark.parametrize("fails_at", ["begin", "ready", "leaving", "sent", "end"])
def test_a_part_that_fails_closes_the_stream_and_ends_the_others(fails_at):
    """Its error is raised, the other part has ended, no thread is left, and the stream cannot run again."""
    notes = []
    made = Stream(make_packets(9), dict.fromkeys(PacketKind, MemorySink()), Pacer(FAST))
    other = Noted(made, "other", notes)
    Noted(made, "failing", notes, fails_at=fails_at)
    with pytest.raises(RunError, match=fails_at):
        made.run()
    assert notes[-1] == ("other", "end", State.SETTLING)
    assert str(other.error) == fails_at
    assert (made.state, threads()) == (State.CLOSED, 0)
    with pytest.raises(RuntimeError, match="closed, which cannot be"):
        made.prepare()


def test_every_state_leads_to_the_end():
    """From each state a stream can settle and close, and no state leads back but from measuring to opened."""
    order = list(State)
    for state, following in TRANSITIONS.items():
        back = {after for after in following if order.index(after) <= order.index(state)}
        assert back == ({State.OPENED} if state is State.MEASURING else set())
        reached = set(following)
        while more := {after for each in reached for after in TRANSITIONS[each]} - reached:
            reached |= more
        assert state is State.CLOSED or State.CLOSED in reached
    assert set(TRANSITIONS) == set(State)
