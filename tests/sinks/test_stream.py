"""Packets in real time."""

import itertools
import os
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from vlp16emu.errors import RunError
from vlp16emu.sinks import TOLERANCE_NS, Late, MemorySink, Pacer, stream
from vlp16emu.sinks.look_ahead import LookAhead
from vlp16emu.sinks.pacing import prompt_sleeps
from vlp16emu.sinks.stream import Sender
from vlp16emu.types import Packet, PacketKind

FAST = 1000.0
PERIOD_NS = 1_327_104


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
        yield Packet(PacketKind.DATA, i * 1_327_104, b"")


def threads():
    """Count the look-ahead threads that are alive."""
    return sum(thread.name == "look-ahead" for thread in threading.enumerate())


@pytest.mark.parametrize("look_ahead", [1, 7, 2048])
def test_all_packets_arrive_in_order(make_packets, look_ahead):
    """Whatever the buffer's size, a sink gets the very packets, in their order, and the report counts them."""
    packets = make_packets(300)
    with MemorySink() as sink:
        report = stream(iter(packets), sink, Pacer(FAST), look_ahead_packets=look_ahead)
    assert sink.packets == packets
    assert report.lateness.packets == 300
    assert report.simulated_s == pytest.approx(299 * 1.327104e-3)
    assert not report.interrupted
    assert threads() == 0


def test_packets_leave_in_real_time(make_packets):
    """At speed 1 a quarter of a second of packets takes that time, and at speed 5 a fifth of it."""
    packets = make_packets(190)
    for speed in (1.0, 5.0):
        report = stream(packets, MemorySink(), Pacer(speed))
        assert report.wall_s >= report.simulated_s / speed - 1e-9  # deadlines are whole nanoseconds
        assert speed / 3 < report.real_time_factor <= speed * (1 + 1e-6)  # other programs may take the cores


def test_stream_without_packets_ends():
    """No packets, no time, no lateness, and a factor of 0 rather than a division by it."""
    report = stream([], MemorySink(), Pacer(1.0))
    assert (report.lateness.packets, report.wall_s, report.real_time_factor) == (0, 0.0, 0.0)


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


def test_error_of_the_engine_comes_after_the_packets_before_it(make_packets):
    """What the engine raises is raised to the caller, once all earlier packets have been sent."""

    def failing():
        yield from make_packets(20)
        raise RunError("the engine is broken")

    sink = MemorySink()
    with pytest.raises(RunError, match="the engine is broken"):
        stream(failing(), sink, Pacer(FAST))
    assert sink.packets == make_packets(20)
    assert threads() == 0


def test_error_of_the_sink_ends_the_stream():
    """A sink that fails ends the stream at once, and the endless engine with it."""
    with pytest.raises(RunError, match="link is down"):
        stream(endless([]), BreakingSink(5, RunError("link is down")), Pacer(FAST))
    assert threads() == 0


def test_ctrl_c_ends_with_a_report():
    """A KeyboardInterrupt ends the stream cleanly; the report says what has been sent until then."""
    sink = BreakingSink(25, KeyboardInterrupt())
    report = stream(endless([]), sink, Pacer(FAST))
    assert report.interrupted
    assert report.lateness.packets == 26
    assert threads() == 0


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


def test_stop_event_is_left_as_it_was(make_packets):
    """A stream that ends by itself does not set the caller's event."""
    stop = threading.Event()
    assert not stream(make_packets(3), MemorySink(), Pacer(FAST), stop=stop).interrupted
    assert not stop.is_set()


def test_switch_interval_is_put_back(make_packets):
    """The interpreter's switch interval is short while packets are sent, and as before afterwards."""
    before_s, during_s = sys.getswitchinterval(), set()

    class Looking(MemorySink):
        def send(self, packet):
            super().send(packet)
            during_s.add(sys.getswitchinterval())

    stream(make_packets(3), Looking(), Pacer(FAST))
    assert sys.getswitchinterval() == before_s
    assert max(during_s) < before_s


def test_a_slow_engine_is_reported_at_once(make_packets):
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


def test_a_packet_that_does_not_come_is_notified_before_it_comes(make_packets):
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


def shortest_ns(left_ns, count):
    """Shortest time in which so many packets left."""
    left_ns = np.array(left_ns)
    return (left_ns[count:] - left_ns[:-count]).min()


class Sending:
    """A sender whose clock runs only while it sleeps, or when a test says so."""

    def __init__(self, late, go_on_from=None):
        self.now_ns, self.times, self.left_ns = 0, [], []
        self.sink = MemorySink()
        pacer = Pacer(1.0, clock_ns=lambda: self.now_ns, sleep=self.sleep)
        self.sender = Sender(self.sink, pacer, late=late, notify=self.times.append, go_on_from=go_on_from)

    def sleep(self, seconds):
        """Let time pass, to the nanosecond."""
        self.now_ns += round(seconds * 1e9)

    def send(self, due_ns, *, had_to_wait=False, kind=PacketKind.DATA):
        """Send a packet, and note when it left."""
        before = len(self.sink.packets)
        self.sender.send(Packet(kind, due_ns, b""), had_to_wait=had_to_wait, engine_speed=0.8)
        if len(self.sink.packets) > before:
            self.left_ns.append(self.now_ns)

    @property
    def report(self):
        """The report so far."""
        return self.sender.report(interrupted=False)


def test_after_a_stop_packets_keep_the_pace_and_the_delay():
    """Stopped for 5 s with `pace`, all packets leave, each at its spacing, and the stream stays 5 s late."""
    sending = Sending(Late.PACE)
    for i in range(4000):
        if i == 100:
            sending.now_ns += 5_000_000_000
        sending.send(i * PERIOD_NS)
    spacing_ns = np.diff(sending.left_ns)
    assert len(sending.left_ns) == 4000
    assert spacing_ns.min() == PERIOD_NS
    assert (spacing_ns > PERIOD_NS).sum() == 1
    report = sending.report
    assert report.delay_s == pytest.approx(5 - PERIOD_NS * 1e-9)
    assert [(times.at_s, times.engine) for times in report.behind] == [(100 * PERIOD_NS * 1e-9, False)]
    assert report.lateness.p99_ns == 0
    assert report.lateness.max_ns == pytest.approx(5e9, rel=1e-3)


def test_after_a_stop_packets_are_skipped_until_now():
    """Stopped for 5 s with `skip`, late packets are dropped and counted by kind, and the next ones are in time."""
    sending = Sending(Late.SKIP)
    for i in range(8000):
        if i == 100:
            sending.now_ns += 5_000_000_000
        sending.send(i * PERIOD_NS)
        if i % 5 == 0:
            sending.send(i * PERIOD_NS, kind=PacketKind.POSITION)
    report = sending.report
    skipped = int((5_000_000_000 - TOLERANCE_NS) / PERIOD_NS)
    assert report.skipped[PacketKind.DATA] == pytest.approx(skipped, abs=2)
    assert report.skipped[PacketKind.POSITION] == pytest.approx(skipped / 5, abs=2)
    assert report.skipped.total() + len(sending.sink.packets) == 8000 + 1600
    assert report.delay_s == 0
    assert sending.now_ns == 7999 * PERIOD_NS
    assert len(report.behind) == 1


@pytest.mark.parametrize("late", Late)
def test_lateness_within_the_tolerance_neither_drops_nor_delays(late):
    """Pauses of 45 ms, again and again, leave no delay, drop nothing, and do not count as falling behind."""
    sending = Sending(late)
    for i in range(4000):
        if i % 1000 == 100:
            sending.now_ns += 45_000_000
        sending.send(i * PERIOD_NS)
    report = sending.report
    assert len(sending.sink.packets) == 4000
    assert (report.behind, report.delay_s, report.skipped.total()) == ((), 0, 0)
    assert sending.now_ns == 3999 * PERIOD_NS
    assert shortest_ns(sending.left_ns, 20) >= 0.94 * 20 * PERIOD_NS - 10_000_000


def test_an_engine_that_is_too_slow_falls_behind_once_and_never_bursts():
    """At 0.8 x real time the whole stream is one time behind, and its delay a quarter of what it simulates."""
    sending = Sending(Late.PACE)
    for i in range(10_000):
        made_ns = round(i * PERIOD_NS / 0.8)
        late = made_ns > sending.now_ns
        sending.now_ns = max(sending.now_ns, made_ns)
        sending.send(i * PERIOD_NS, had_to_wait=late)
    report = sending.report
    assert len(sending.times) == len(report.behind) == 1
    assert report.behind[0].engine
    assert report.behind[0].engine_speed == 0.8
    assert report.delay_s == pytest.approx(report.simulated_s / 4, abs=0.06)
    assert shortest_ns(sending.left_ns, 20) >= 0.94 * 20 * PERIOD_NS - 10_000_000


def test_two_stops_far_apart_are_two_times():
    """A stream that was in time for more than 5 s falls behind a second time, and is notified of it."""
    sending = Sending(Late.PACE)
    for i in range(10_000):
        if i in (1000, 6000):
            sending.now_ns += 1_000_000_000
        sending.send(i * PERIOD_NS)
    assert len(sending.times) == 2
    assert [times.total_s for times in sending.times] == pytest.approx([1.0, 1.0], abs=0.002)


def test_a_slow_engine_is_asked_to_go_on_further_ahead():
    """With `skip`, an engine that gives nothing but late packets for 0.25 s goes on ahead of now, ever further."""
    from_ns, ahead_ns = [0], []

    def go_on_from(due_ns):
        from_ns.append(due_ns)
        ahead_ns.append(due_ns - sending.now_ns)

    sending = Sending(Late.SKIP, go_on_from)
    sending.send(0)
    for jumps in range(1, 4):
        while len(from_ns) == jumps:  # packets 60 ms late, and more and more so
            sending.now_ns = max(sending.now_ns + 10_000_000, from_ns[-1] + 60_000_000)
            sending.send(from_ns[-1], had_to_wait=True)
    assert ahead_ns == [1_000_000_000, 2_000_000_000, 4_000_000_000]
    sending.send(from_ns[-2], had_to_wait=True)  # still of before
    sending.now_ns += 10**9
    sending.send(from_ns[-2], had_to_wait=True)
    assert len(ahead_ns) == 3
    assert len(sending.sink.packets) == 1
    sending.send(from_ns[-1], had_to_wait=True)
    assert len(sending.sink.packets) == 2
    assert sending.now_ns == from_ns[-1]


def test_the_first_packet_after_a_gap_is_punctual():
    """Stopped for 5 s while a packet waits, that one leaves late, and the next one that is not skipped on time."""
    sending = Sending(Late.SKIP)
    sending.send(0)
    pacer = sending.sender._pacer
    pacer._sleep = lambda seconds: setattr(sending, "now_ns", sending.now_ns + 5_000_000_000)
    sending.send(PERIOD_NS)
    pacer._sleep = lambda seconds: setattr(sending, "now_ns", sending.now_ns + round(seconds * 1e9))
    sending.send(2 * PERIOD_NS)
    sending.send(6_000_000_000)
    assert sending.left_ns == [0, 5_000_000_000, 6_000_000_000]


def test_the_timer_slack_is_put_back():
    """The calling thread's sleeps are prompt inside, and as before afterwards."""
    if sys.platform != "linux":
        pytest.skip("prctl is Linux's")
    slack_ns = Path(f"/proc/self/task/{threading.get_native_id()}/timerslack_ns")
    slack_ns = slack_ns if slack_ns.exists() else Path("/proc/self/timerslack_ns")
    before = slack_ns.read_text()
    with prompt_sleeps():
        assert slack_ns.read_text() == "1\n"
    assert slack_ns.read_text() == before
