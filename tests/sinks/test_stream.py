"""Packets in real time."""

import itertools
import sys
import threading
import time

import pytest

from vlp16emu.errors import RunError
from vlp16emu.sinks import MemorySink, Pacer, stream
from vlp16emu.sinks.look_ahead import LookAhead
from vlp16emu.sinks.stream import _Sender
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
        assert report.real_time_factor == pytest.approx(speed, rel=0.2)
        assert report.fell_behind == 0


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
    """A KeyboardInterrupt ends the stream cleanly; the report tells what has been sent until then."""
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


def test_slow_engine_is_told(make_packets):
    """An engine that pauses for 0.2 s after the buffer has run dry is reported once, with most of that time."""

    def pausing():
        for i, packet in enumerate(make_packets(100)):
            if i == 30:
                time.sleep(0.2)
            yield packet

    report = stream(pausing(), MemorySink(), Pacer(1.0), look_ahead_packets=8)
    assert report.fell_behind == 1
    assert 0.1 < report.most_behind_s < 1.0
    assert report.lateness.max_ns >= report.most_behind_s * 1e9


def test_falling_behind_is_counted_from_the_first_late_packet_to_the_next_punctual_one():
    """Two pauses of the engine with punctual packets between them count twice; a late sender does not count."""
    now_ns = [0]

    def sleep(seconds):
        now_ns[0] += round(seconds * 1e9)

    def clock_ns():
        now_ns[0] += 1000
        return now_ns[0]

    sender = _Sender(MemorySink(), Pacer(1.0, clock_ns=clock_ns, sleep=sleep))

    def send(due_ms, pause_ms=0, *, had_to_wait=False):
        now_ns[0] += pause_ms * 1_000_000
        sender.send(Packet(PacketKind.DATA, due_ms * 1_000_000, b""), had_to_wait=had_to_wait)

    send(0)
    send(10)
    send(20, 50, had_to_wait=True)  # due at 20, made at 60: 40 ms behind
    send(30, had_to_wait=True)
    send(100)  # punctual
    send(110, 50)  # 40 ms late, although it was ready
    send(300)
    send(310, 40, had_to_wait=True)  # 30 ms behind
    report = sender.report(interrupted=False)
    assert report.fell_behind == 2
    assert report.most_behind_s == pytest.approx(0.040, abs=0.001)
    assert report.lateness.packets == 8
