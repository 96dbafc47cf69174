"""Deadlines, and the lateness behind them."""

import numpy as np
import pytest
from sinks.kit import PERIOD_NS

from vlp16emu.sinks import LatenessHistogram, Pacer
from vlp16emu.types import Packet, PacketKind


class Clock:
    """A clock that runs only while somebody sleeps or looks at it; sleeps end late."""

    def __init__(self, oversleep_ns=0):
        self.now_ns = 5_000_000_000
        self.oversleep_ns = oversleep_ns
        self.slept = self.looked = 0

    def read(self):
        """Looking takes 10 us."""
        self.looked += 1
        self.now_ns += 10_000
        return self.now_ns

    def sleep(self, seconds):
        """Sleep too long."""
        self.slept += 1
        self.now_ns += round(seconds * 1e9) + self.oversleep_ns

    def pacer(self, speed=1.0):
        """Make a pacer that lives by this clock."""
        return Pacer(speed, clock_ns=self.read, sleep=self.sleep)


def leave(clock, pacer, dues_ns, pause_ns=None):
    """Let data packets leave, with pauses before some of them; returns instants and lateness in ns."""
    left_ns, late_ns = [], []
    for i, due_ns in enumerate(dues_ns):
        packet = Packet(PacketKind.DATA, due_ns, b"")
        deadline_ns = pacer.deadline_ns(due_ns)
        clock.now_ns += (pause_ns or {}).get(i, 0)
        late_ns.append(pacer.wait(packet, deadline_ns))
        pacer.left(packet)
        left_ns.append(clock.now_ns)
    return np.array(left_ns), late_ns


@pytest.mark.parametrize("oversleep_ns", [0, 50_000, 119_000])
def test_oversleeping_does_not_add_up(oversleep_ns):
    """With sleeps that end late, the 5000th packet is as punctual as the first: late by that one sleep."""
    clock = Clock(oversleep_ns)
    pacer = clock.pacer()
    start_ns = clock.now_ns
    left_ns, late_ns = leave(clock, pacer, range(0, 5000 * PERIOD_NS, PERIOD_NS))
    assert max(late_ns) <= oversleep_ns + 20_000
    assert abs(left_ns[-1] - start_ns - 4999 * PERIOD_NS) <= oversleep_ns + 30_000


def test_a_packet_takes_one_wake_up():
    """Each packet but the first is slept for once, and the clock is not asked again and again meanwhile."""
    clock = Clock(50_000)
    pacer = clock.pacer()
    leave(clock, pacer, range(0, 100 * PERIOD_NS, PERIOD_NS))
    assert clock.slept == 99
    assert clock.looked <= 4 * 100


def test_late_packets_catch_up_without_a_burst():
    """After a pause of 45 ms n packets take at least 0.94 of their time less 10 ms, until deadlines are
    ahead again."""
    clock = Clock()
    left_ns, late_ns = leave(clock, clock.pacer(), range(0, 1000 * PERIOD_NS, PERIOD_NS), {10: 45_000_000})
    assert late_ns[10] > 43_000_000
    for n in (1, 5, 20, 100):
        assert (left_ns[n:] - left_ns[:-n]).min() >= 0.94 * n * PERIOD_NS - 10_000_000
    assert np.median(np.diff(left_ns)[30:300]) < 0.96 * PERIOD_NS
    assert max(late_ns[700:]) <= 20_000


def test_sleeps_that_end_milliseconds_late_do_not_slow_the_stream():
    """Where each sleep ends 5 ms late, four packets leave at each wake-up, and the stream keeps its pace."""
    clock = Clock(5_000_000)
    left_ns, late_ns = leave(clock, clock.pacer(), range(0, 2000 * PERIOD_NS, PERIOD_NS))
    assert left_ns[-1] - left_ns[0] == pytest.approx(1999 * PERIOD_NS, abs=6_000_000)
    assert max(late_ns) <= 5_100_000
    assert clock.slept == pytest.approx(2000 / 4, rel=0.1)


def test_kinds_and_units_keep_their_own_spacing():
    """A position packet and another unit's packet leave at their deadlines, right behind a data packet."""
    clock = Clock()
    pacer = clock.pacer()
    data = Packet(PacketKind.DATA, 0, b"")
    others = [Packet(PacketKind.POSITION, 1000, b""), Packet(PacketKind.DATA, 2000, b"", 1)]
    for packet in (data, *others):
        assert pacer.wait(packet, pacer.deadline_ns(packet.due_ns)) <= 100_000
        pacer.left(packet)


def test_deadlines_are_exact():
    """A delay is added to all deadlines to come, after 24 h they are exact to the nanosecond, and elapsed
    times are reported, zeros before."""
    clock = Clock()
    pacer = clock.pacer(2.0)
    first_ns, before_ns = pacer.deadline_ns(0), pacer.deadline_ns(10**9)
    pacer.delay_ns += 7_000_000
    assert pacer.deadline_ns(10**9) == before_ns + 7_000_000
    clock.now_ns = first_ns + 7_000_000 - 10_000  # looking takes 10 us
    assert pacer.due_in_ns(500_000_000) == 10**9
    pacer = Clock().pacer()
    begin = pacer.deadline_ns(1_732_000_000_123_456_789)
    day_ns = 86_400 * 10**9 + 1
    assert pacer.deadline_ns(1_732_000_000_123_456_789 + day_ns) - begin == day_ns
    clock = Clock()
    pacer = clock.pacer(2.0)
    assert pacer.elapsed_ns == (0, 0)
    leave(clock, pacer, [0, 10**9])
    simulated_ns, wall_ns = pacer.elapsed_ns
    assert simulated_ns == 10**9
    assert wall_ns == pytest.approx(5 * 10**8, abs=100_000)


@pytest.mark.parametrize(("speed", "wall_ns"), [(0.5, 2_000_000_000), (1.0, 10**9), (4.0, 250_000_000)])
def test_speed_scales_time(speed, wall_ns):
    """A simulated second lasts 1 / speed seconds, to the nanosecond."""
    pacer = Clock().pacer(speed)
    begin = pacer.deadline_ns(17)
    assert pacer.deadline_ns(17 + 10**9) - begin == wall_ns


def test_histogram_agrees_with_numpy():
    """Quantiles lie within 1.6 % of those of the sorted list, the maximum is exact, small values too; an
    hour of lateness has fewer than 1400 bins."""
    late_ns = np.random.default_rng(5).lognormal(10, 2, 20_001).astype(int)
    histogram = LatenessHistogram()
    for ns in late_ns:
        histogram.add(int(ns))
    summary = histogram.summary
    assert summary.packets == 20_001
    assert summary.median_ns == pytest.approx(np.quantile(late_ns, 0.5), rel=0.016)
    assert summary.p99_ns == pytest.approx(np.quantile(late_ns, 0.99, method="inverted_cdf"), rel=0.016)
    assert summary.max_ns == late_ns.max()
    histogram = LatenessHistogram()
    for exponent in np.linspace(0, 41.7, 50_000):
        histogram.add(int(2**exponent))
    assert len(histogram._counts) < 1400
    histogram = LatenessHistogram()
    assert histogram.summary == type(histogram.summary)(0, 0, 0, 0)
    for ns in (3, 1, 2):
        histogram.add(ns)
    assert histogram.summary == type(histogram.summary)(3, 2, 3, 3)
