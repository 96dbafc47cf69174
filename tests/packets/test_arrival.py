"""The host's clock fitted to the sensor's, and stamps that are no pace."""

import numpy as np
import pytest
from scipy.optimize import linprog

from vlp16emu.packets.arrival import HostStamps, fit_arrivals

S_NS = 1_000_000_000
STEP_NS = 1_327_104  # 24 firing sequences of 55.296 us (63-9243 Rev D, section 8.3)


def sensor_times(count):
    return np.arange(count, dtype=np.int64) * STEP_NS + 3 * S_NS


def in_batches(times_ns, batch_ns):
    """Arrival of packets that a host sees at the end of batches."""
    return -(-times_ns // batch_ns) * batch_ns


def fit(sensor_ns, host_ns):
    return fit_arrivals(np.arange(len(sensor_ns)) + 1, sensor_ns, host_ns)


def test_the_line_is_that_of_a_linear_program():
    """The line of least total delay under all arrivals is found by scipy's linear program, too (Moon, Skelly
    and Towsley 1999)."""
    rng = np.random.default_rng(1)
    sensor_ns = sensor_times(9000)
    delay_ns = rng.exponential(800_000, len(sensor_ns)).astype(np.int64)
    host_ns = sensor_ns + 7 * S_NS + (sensor_ns * 42e-6).astype(np.int64) + delay_ns
    found = fit(sensor_ns, host_ns)
    x = (sensor_ns - sensor_ns[0]) / S_NS
    y = (host_ns - sensor_ns - 7 * S_NS) / 1e6
    right = linprog(
        [-len(x), -x.sum()], A_ub=np.column_stack([np.ones(len(x)), x]), b_ub=y, bounds=(None, None)
    )
    offset_ms, rate = right.x
    assert found.rate_ppm == pytest.approx(rate * 1000, abs=0.01)
    at_ns = [found.host_at(1, int(t)) for t in sensor_ns[[0, -1]]]
    line_ms = offset_ms + rate * x[[0, -1]]
    assert (np.array(at_ns) - sensor_ns[[0, -1]] - 7 * S_NS) / 1e6 == pytest.approx(line_ms, abs=1e-3)


@pytest.mark.parametrize("batch_ms", [40, 200])
def test_batches_have_the_spacing_of_the_sensor(batch_ms):
    """Packets that arrive in batches get times one period apart, behind the true ones by less than a
    period."""
    sensor_ns = sensor_times(3000)
    found = fit(sensor_ns, in_batches(sensor_ns + 11 * S_NS, batch_ms * 1_000_000))
    times_ns = np.array([found.host_at(i + 1, int(t)) for i, t in enumerate(sensor_ns)])
    assert set(np.diff(times_ns)) == {STEP_NS}
    assert len(found.parts) == 1
    assert np.abs(times_ns - sensor_ns - 11 * S_NS).max() < STEP_NS


@pytest.mark.parametrize("by_s", [5 * 3600, -5 * 3600, 0.5, -0.5])
def test_a_clock_that_is_set_begins_a_new_line(by_s):
    """From the packet on at which the host's clock is set, times have its new offset."""
    sensor_ns = sensor_times(6000)
    by_ns = np.where(np.arange(6000) < 3500, 0, round(by_s * S_NS))
    found = fit(sensor_ns, sensor_ns + by_ns + 9 * S_NS)
    times_ns = np.array([found.host_at(i + 1, int(t)) for i, t in enumerate(sensor_ns)])
    np.testing.assert_array_equal(times_ns, sensor_ns + by_ns + 9 * S_NS)
    assert len(found.parts) == 2


def test_a_gap_begins_a_new_line():
    """After a sensor was off, its clock counts from anew."""
    sensor_ns = np.concatenate([sensor_times(2000), sensor_times(2000) - S_NS])
    host_ns = np.concatenate([sensor_times(2000), sensor_times(2000) + 60 * S_NS])
    found = fit(sensor_ns, host_ns)
    times_ns = [found.host_at(i + 1, int(t)) for i, t in enumerate(sensor_ns)]
    np.testing.assert_array_equal(times_ns, host_ns)


@pytest.mark.parametrize(
    ("stamps", "words", "runs"),
    [
        (lambda t: t * 0, "all host stamps are equal", False),
        (lambda t: np.arange(len(t)) * 1000, "1 us apart", False),
        (lambda t: t // S_NS * S_NS, "in batches 1", True),
        (lambda t: in_batches(t, 40_000_000), "in batches 40", True),
        (lambda t: in_batches(t, 200_000_000), "in batches 20", True),
        (lambda t: np.arange(len(t)) * 10_000_000, "1e+04 us apart", False),
    ],
)
def test_stamps_that_are_no_pace_are_named(stamps, words, runs):
    """Stamps that are equal, too close, too far apart, rounded or in batches cannot be the sensor's pace."""
    sensor_ns = sensor_times(5000)
    found = HostStamps.of(stamps(sensor_ns), sensor_ns)
    assert words in found.fault
    assert found.runs == runs


@pytest.mark.parametrize("jitter_us", [0, 300, 900])
def test_stamps_of_a_host_are_a_pace(jitter_us):
    """Late interrupts, milliseconds as the unit, and a clock that is set leave a pace."""
    rng = np.random.default_rng(2)
    sensor_ns = sensor_times(5000)
    host_ns = sensor_ns + (rng.uniform(0, jitter_us, len(sensor_ns)) * 1000).astype(np.int64)
    assert HostStamps.of(host_ns, sensor_ns).fault is None
    assert HostStamps.of(host_ns // 1_000_000 * 1_000_000, sensor_ns).fault is None
    assert HostStamps.of(host_ns + np.where(np.arange(5000) < 900, 0, 3600 * S_NS), sensor_ns).fault is None
