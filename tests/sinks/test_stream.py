"""Packets in real time."""

import concurrent.futures
import itertools
import os
import sys
import threading
import time
from pathlib import Path

import pytest
from listening import MemorySink
from sinks.kit import PERIOD_NS, make_packets

from vlp16emu.errors import RunError
from vlp16emu.sinks import Pacer, stream
from vlp16emu.sinks.pacing import prompt
from vlp16emu.sinks.stream import LookAhead
from vlp16emu.types import Packet, PacketKind

FAST = 1000.0


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
    """Whatever the buffer's size, a sink gets the very packets, in their order, and the report counts them."""
    packets = make_packets(300)
    with MemorySink() as sink:
        report = stream(iter(packets), sink, Pacer(FAST), look_ahead_packets=look_ahead)
    assert sink.packets == packets
    assert report.lateness.packets == 300
    assert report.simulated_s == pytest.approx(299 * 1.327104e-3)
    assert not report.interrupted
    assert threads() == 0


def test_packets_leave_in_real_time():
    """At speed 1 a quarter of a second of packets takes that time, and at speed 5 a fifth of it."""
    packets = make_packets(190)
    for speed in (1.0, 5.0):
        report = stream(packets, MemorySink(), Pacer(speed))
        assert report.wall_s >= report.simulated_s / speed - 1e-9  # deadlines are whole nanoseconds
        assert speed / 3 < report.real_time_factor <= speed * (1 + 1e-6)  # other programs may take the cores


def test_look_ahead_is_bounded():
    """The thread computes the buffer and one packet more, then waits until one is taken."""
    made = []
    with LookAhead(endless(made), 10, threading.Event()) as ahead:
        ahead.fill()
        first = ahead.take()
        ahead.fill()
        ahead.fill()
        assert first.due_ns == 0
        assert len(made) <= 12


@pytest.mark.skipif(sys.platform != "linux", reason="a thread has a priority of its own on Linux alone")
def test_threads_that_compute_give_way():
    """The thread that computes and one that it starts are nicer by 3 than the one that sends, which stays as it was."""
    before, nice = os.getpriority(os.PRIO_PROCESS, 0), []

    def note():
        nice.append(os.getpriority(os.PRIO_PROCESS, 0))

    def computing():
        note()
        worker = threading.Thread(target=note)
        worker.start()
        worker.join()
        yield Packet(PacketKind.DATA, 0, b"")

    stream(computing(), MemorySink(), Pacer(FAST))
    assert nice == [min(before + 3, 19)] * 2
    assert os.getpriority(os.PRIO_PROCESS, 0) == before


class Numbered:
    """Packets that carry the number of a generation, which begin again on demand."""

    def __init__(self, count):
        self.count, self.next, self.generation = count, 0, 0

    def __iter__(self):
        return self

    def __next__(self):
        if self.next == self.count:
            raise StopIteration
        self.next += 1
        return Packet(PacketKind.DATA, (self.next - 1) * PERIOD_NS, bytes([self.generation]))

    def restart(self, due_ns):
        """Go on from a time, or from where they are if that is earlier."""
        self.next, self.generation = min(self.next, -(-due_ns // PERIOD_NS)), self.generation + 1


@pytest.mark.parametrize("capacity", [8, 64, 500])
@pytest.mark.parametrize("cuts", [[40], [40, 40], [90, 60], [60, 90], [299]])
def test_what_is_made_anew_follows_what_is_sent_without_a_gap(cuts, capacity):
    """From each cut on packets are of a later generation; none is lost, none comes twice, also where all had been computed."""
    packets, stop = Numbered(300), threading.Event()
    with LookAhead(packets, capacity, stop) as ahead:
        ahead.fill()
        taken = []
        while len(taken) < 30:
            taken.append(ahead.take())
        for cut in cuts:
            ahead.redo(cut * PERIOD_NS, packets.restart)
        while (packet := ahead.take()) is not None:
            taken.append(packet)
    assert [packet.due_ns for packet in taken] == [i * PERIOD_NS for i in range(300)]
    generations = [packet.payload[0] for packet in taken]
    assert generations == sorted(generations)
    assert set(generations[:30]) == {0}
    assert min(generations[max(cuts) :]) > 0


def test_errors_and_ctrl_c_end_a_stream():
    """What the engine raises comes after the packets before it, and a sink that fails ends the stream and its endless engine.

    Ctrl-C ends it with a report of what was sent, and no packets are a factor of 0.
    """

    def failing():
        yield from make_packets(20)
        raise RunError("the engine is broken")

    sink = MemorySink()
    with pytest.raises(RunError, match="the engine is broken"):
        stream(failing(), sink, Pacer(FAST))
    assert sink.packets == make_packets(20)
    assert threads() == 0
    with pytest.raises(RunError, match="link is down"):
        stream(endless([]), BreakingSink(5, RunError("link is down")), Pacer(FAST))
    assert threads() == 0
    sink = BreakingSink(25, KeyboardInterrupt())
    report = stream(endless([]), sink, Pacer(FAST))
    assert report.interrupted
    assert report.lateness.packets == 26
    assert threads() == 0
    report = stream([], MemorySink(), Pacer(1.0))
    assert (report.lateness.packets, report.wall_s, report.real_time_factor) == (0, 0.0, 0.0)


def test_stop_event_ends_even_a_stream_that_waits_for_its_engine():
    """Setting the event ends a stream whose engine gives nothing for a while, and marks the report."""
    stop = threading.Event()

    def stuck():
        yield Packet(PacketKind.DATA, 0, b"")
        stop.set()
        time.sleep(0.2)
        yield Packet(PacketKind.DATA, 1, b"")

    report = stream(stuck(), MemorySink(), Pacer(1.0), stop=stop)
    assert report.interrupted
    assert threads() == 0


def test_stop_event_ends_a_stream_whose_receivers_wait_for_a_world():
    """A stream that is stopped before its first packet, while what begins beside it waits for a world, has a report."""
    stop, sink = threading.Event(), MemorySink()

    def begun(_):
        stop.set()
        raise concurrent.futures.CancelledError

    assert stream(make_packets(3), sink, Pacer(1.0), stop=stop, begun=begun).interrupted
    assert sink.packets == []


def test_stop_event_and_switch_interval_are_left_as_they_were():
    """A stream that ends by itself does not set the caller's event; the interpreter's switch interval is short while it sends, and as before afterwards."""
    stop = threading.Event()
    assert not stream(make_packets(3), MemorySink(), Pacer(FAST), stop=stop).interrupted
    assert not stop.is_set()
    before_s, during_s = sys.getswitchinterval(), set()

    class Looking(MemorySink):
        def send(self, packet):
            super().send(packet)
            during_s.add(sys.getswitchinterval())

    stream(make_packets(3), Looking(), Pacer(FAST))
    assert sys.getswitchinterval() == before_s
    assert max(during_s) < before_s


def test_a_slow_engine_is_reported_at_once():
    """An engine that pauses for 0.2 s after the buffer has run dry is notified once, while the stream runs."""
    times, sink = [], MemorySink()

    def pausing():
        for i, packet in enumerate(make_packets(100)):
            if i == 30:
                time.sleep(0.2)
            yield packet

    def notify(_behind):
        times.append(len(sink.packets))

    report = stream(pausing(), sink, Pacer(1.0), look_ahead_packets=8, notify=notify)
    assert len(times) == len(report.behind) == 1
    assert times[0] <= 30
    assert report.delay_s == pytest.approx(sum(behind.total_s for behind in report.behind))
    assert 0.1 < report.delay_s < 2.0
    assert report.lateness.packets == 100


def test_a_packet_that_does_not_come_is_notified_before_it_comes():
    """An engine that stands still is notified while the stream waits for it, and is one time with its delay."""
    notified = threading.Event()

    def stuck():
        packets = make_packets(100)
        yield from packets[:30]
        assert notified.wait(30)
        yield from packets[30:]

    report = stream(stuck(), MemorySink(), Pacer(1.0), look_ahead_packets=8, notify=lambda _: notified.set())
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
    """It stays short until the last of two streams ends, whichever begins first, and is then as before both."""
    before_s, first, second = sys.getswitchinterval(), prompt(), prompt()
    first.__enter__()
    short_s = sys.getswitchinterval()
    second.__enter__()
    first.__exit__(None, None, None)
    assert sys.getswitchinterval() == short_s < before_s
    second.__exit__(None, None, None)
    assert sys.getswitchinterval() == before_s
