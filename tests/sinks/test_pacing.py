"""Deadlines, and the lateness behind them."""

import math

import numpy as np
import pytest

from vlp16emu.errors import InputError
from vlp16emu.sinks import LatenessHistogram, Pacer

PERIOD_NS = 1_327_104


class Clock:
    """A clock that runs only while somebody sleeps or looks at it; sleeps end late."""

    def __init__(self, oversleep_ns=0):
        self.now_ns = 5_000_000_000
        self.oversleep_ns = oversleep_ns
        self.slept = 0

    def read(self):
        """Looking takes 10 us."""
        self.now_ns += 10_000
        return self.now_ns

    def sleep(self, seconds):
        """Sleep too long."""
        self.slept += 1
        self.now_ns += round(seconds * 1e9) + self.oversleep_ns

    def pacer(self, speed=1.0):
        """Make a pacer that lives by this clock."""
        return Pacer(speed, clock_ns=self.read, sleep=self.sleep)


def leave(clock, pacer, dues_ns):
    """Wait for every packet; returns instants and lateness in ns."""
    late = [pacer.wait(pacer.deadline_ns(due_ns)) for due_ns in dues_ns]
    return clock.now_ns, late


@pytest.mark.parametrize("oversleep_ns", [0, 50_000, 119_000])
def test_oversleeping_does_not_add_up(oversleep_ns):
    """With sleeps that end late, the 5000th packet is as punctual as the first."""
    clock = Clock(oversleep_ns)
    pacer = clock.pacer()
    start_ns = clock.now_ns
    end_ns, late = leave(clock, pacer, range(0, 5000 * PERIOD_NS, PERIOD_NS))
    assert max(late) <= 20_000
    assert abs(end_ns - start_ns - 4999 * PERIOD_NS) <= 30_000


def test_late_packet_leaves_at_once_and_moves_no_deadline():
    """After a pause of 10 ms packets follow without waiting until their deadlines are ahead again."""
    clock = Clock()
    pacer = clock.pacer()
    deadlines = [pacer.deadline_ns(i * PERIOD_NS) for i in range(20)]
    assert np.diff(deadlines).tolist() == [PERIOD_NS] * 19
    clock.now_ns += 10_000_000
    late = [pacer.wait(deadline) for deadline in deadlines]
    assert [ns > 10_000 for ns in late] == [i * PERIOD_NS < 10_000_000 for i in range(20)]
    assert clock.slept > 0


@pytest.mark.parametrize(("speed", "wall_ns"), [(0.5, 2_000_000_000), (1.0, 10**9), (4.0, 250_000_000)])
def test_speed_scales_time(speed, wall_ns):
    """A simulated second lasts 1 / speed seconds, to the nanosecond."""
    pacer = Clock().pacer(speed)
    begin = pacer.deadline_ns(17)
    assert pacer.deadline_ns(17 + 10**9) - begin == wall_ns


def test_day_long_stream_stays_exact():
    """At the end of 24 h deadlines are still exact to the nanosecond."""
    pacer = Clock().pacer()
    begin = pacer.deadline_ns(1_732_000_000_123_456_789)
    day_ns = 86_400 * 10**9 + 1
    assert pacer.deadline_ns(1_732_000_000_123_456_789 + day_ns) - begin == day_ns


def test_elapsed_times_are_told():
    """The pacer tells simulated and clock time since its start, and zeros before."""
    clock = Clock()
    pacer = clock.pacer(2.0)
    assert pacer.elapsed_ns == (0, 0)
    leave(clock, pacer, [0, 10**9])
    simulated_ns, wall_ns = pacer.elapsed_ns
    assert simulated_ns == 10**9
    assert wall_ns == pytest.approx(5 * 10**8, abs=100_000)


@pytest.mark.parametrize("speed", [0.0, -1.0, math.nan, math.inf])
def test_impossible_speed_is_refused(speed):
    """A speed that is no finite number above 0 is bad input."""
    with pytest.raises(InputError, match=r"speed: .*; expected a finite number above 0"):
        Pacer(speed)


def test_histogram_agrees_with_numpy():
    """Median and 99th percentile lie within 1.6 % of those of the sorted list, and the maximum is exact."""
    late_ns = np.random.default_rng(5).lognormal(10, 2, 20_001).astype(int)
    histogram = LatenessHistogram()
    for ns in late_ns:
        histogram.add(int(ns))
    summary = histogram.summary
    assert summary.packets == 20_001
    assert summary.median_ns == pytest.approx(np.quantile(late_ns, 0.5), rel=0.016)
    assert summary.p99_ns == pytest.approx(np.quantile(late_ns, 0.99, method="inverted_cdf"), rel=0.016)
    assert summary.max_ns == late_ns.max()


def test_histogram_stays_small():
    """From 0 to an hour of lateness there are fewer than 1400 bins, so a day of packets needs no more."""
    histogram = LatenessHistogram()
    for exponent in np.linspace(0, 41.7, 50_000):
        histogram.add(int(2**exponent))
    assert len(histogram._counts) < 1400


def test_nothing_sent_is_never_late():
    """Without packets all figures are 0, and small ones are exact."""
    histogram = LatenessHistogram()
    assert histogram.summary == type(histogram.summary)(0, 0, 0, 0)
    for ns in (3, 1, 2):
        histogram.add(ns)
    assert histogram.summary == type(histogram.summary)(3, 2, 3, 3)
