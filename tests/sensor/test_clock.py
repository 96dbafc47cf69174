"""The top-of-hour counter."""

import numpy as np

from vlp16emu.sensor.rotor import Clock, ClockSpan
from vlp16emu.units import HOUR_NS

TEN_O_CLOCK_NS = 1_780_000_000 * 10**9 // HOUR_NS * HOUR_NS


def test_locked_clock_shows_the_utc_hour():
    """Locked to GPS, the counter is the time past the UTC hour and rolls over with it."""
    clock = Clock((ClockSpan(TEN_O_CLOCK_NS - 17),))
    t_ns = TEN_O_CLOCK_NS + np.array([-1, 0, 1])
    assert clock.reading_ns(t_ns).tolist() == [HOUR_NS - 1, 0, 1]


def test_free_clock_counts_from_power_up():
    """Without GPS the counter is unrelated to UTC: zero at power-up and again every hour."""
    clock = Clock((ClockSpan(TEN_O_CLOCK_NS + 123, 0, 0.0),))
    t_ns = TEN_O_CLOCK_NS + 123 + np.array([0, HOUR_NS - 1, HOUR_NS, 25 * HOUR_NS + 5])
    assert clock.reading_ns(t_ns).tolist() == [0, HOUR_NS - 1, 0, 5]


def test_free_clock_shows_nothing_before_power_up():
    """Before power-up the counter stands at zero; it does not wrap to the end of an hour."""
    clock = Clock((ClockSpan(TEN_O_CLOCK_NS, 0, -100.0),))
    t_ns = TEN_O_CLOCK_NS + np.array([-350_000, -1, 0, 10**9])
    assert clock.reading_ns(t_ns).tolist() == [0, 0, 0, 10**9 - 100_000]


def test_free_clock_runs_fast_by_its_error():
    """20 ppm are 20 microseconds in a second and 72 milliseconds in an hour."""
    clock = Clock((ClockSpan(0, 0, 20.0),))
    assert clock.reading_ns(np.array([10**9, HOUR_NS])).tolist() == [10**9 + 20_000, 72_000_000]
