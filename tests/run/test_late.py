"""What a stream does that has fallen behind, on a clock of its own."""

import numpy as np
import pytest
from listening import MemorySink
from sinks.kit import PERIOD_NS

from vlp16emu.run.part import StreamPart
from vlp16emu.run.stream import Stream
from vlp16emu.sinks import TOLERANCE_NS, Late, Pacer
from vlp16emu.types import Packet, PacketKind


def shortest_ns(left_ns, count):
    """Shortest time in which so many packets left."""
    left_ns = np.array(left_ns)
    return (left_ns[count:] - left_ns[:-count]).min()


class Sending(Stream, StreamPart):
    """A stream whose clock runs only while it sleeps, or when a test says so, and which watches itself."""

    def __init__(self, late, go_on_from=None):
        self.now_ns, self.lines, self.left_ns = 0, [], []
        self.sink = MemorySink()
        pacer = Pacer(1.0, clock_ns=lambda: self.now_ns, sleep=self.sleep)
        super().__init__((), dict.fromkeys(PacketKind, self.sink), pacer, late=late)
        self.news = self.lines.append
        self._go_on_from = go_on_from or self._go_on_from
        self.add(self)

    def sleep(self, seconds):
        """Let time pass, to the nanosecond."""
        self.now_ns += round(seconds * 1e9)

    def send(self, due_ns, *, had_to_wait=False, kind=PacketKind.DATA):
        """Send a packet, and note when it left."""
        before = len(self.sink.packets)
        self._send(Packet(kind, due_ns, b""), had_to_wait=had_to_wait, engine_speed=0.8)
        if len(self.sink.packets) > before:
            self.left_ns.append(self.now_ns)


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
    """Stopped for 5 s with `skip`, late packets are dropped and counted by kind, and the next ones are in
    time."""
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
    """At 0.8 x real time the whole stream is one time behind, and its delay a quarter of what it
    simulates."""
    sending = Sending(Late.PACE)
    for i in range(10_000):
        made_ns = round(i * PERIOD_NS / 0.8)
        late = made_ns > sending.now_ns
        sending.now_ns = max(sending.now_ns, made_ns)
        sending.send(i * PERIOD_NS, had_to_wait=late)
    report = sending.report
    assert len(sending.lines) == len(report.behind) == 1
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
    assert len(sending.lines) == 2
    assert [times.total_s for times in sending.report.behind] == pytest.approx([1.0, 1.0], abs=0.002)


def test_a_slow_engine_is_asked_to_go_on_further_ahead():
    """With `skip`, an engine that gives nothing but late packets for 0.25 s goes on ahead of now, further
    each time until one is in time."""
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
    assert ahead_ns == [250_000_000, 500_000_000, 1_000_000_000]
    sending.send(from_ns[-2], had_to_wait=True)  # still of before
    sending.now_ns += 10**9
    sending.send(from_ns[-2], had_to_wait=True)
    assert len(ahead_ns) == 3
    assert len(sending.sink.packets) == 1
    sending.send(from_ns[-1], had_to_wait=True)
    assert len(sending.sink.packets) == 2
    assert sending.now_ns == from_ns[-1]
    due_ns = sending.now_ns + PERIOD_NS
    while len(from_ns) == 4:  # another time, which begins anew
        sending.now_ns = max(sending.now_ns + 10_000_000, due_ns + 60_000_000)
        sending.send(due_ns, had_to_wait=True)
    assert ahead_ns[-1] == 250_000_000


def test_the_first_packet_after_a_gap_is_punctual():
    """Stopped for 5 s while a packet waits, that one leaves late, and the next one that is not skipped on
    time."""
    sending = Sending(Late.SKIP)
    sending.send(0)
    pacer = sending.pacer
    pacer._sleep = lambda seconds: setattr(sending, "now_ns", sending.now_ns + 5_000_000_000)
    sending.send(PERIOD_NS)
    pacer._sleep = lambda seconds: setattr(sending, "now_ns", sending.now_ns + round(seconds * 1e9))
    sending.send(2 * PERIOD_NS)
    sending.send(6_000_000_000)
    assert sending.left_ns == [0, 5_000_000_000, 6_000_000_000]
