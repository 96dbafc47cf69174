"""The host's clock fitted to the sensor's, and stamps that are no pace."""

import pickle
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from vlp16emu.packets.arrival import ArrivalRecord, HostStamps, fit_arrivals

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


def whole_fit(number, sensor_ns, host_ns):
    """The fit from all arrivals at once: parts, greatest and median delay, with scipy's convex hull."""
    parts, late_ns = [], []
    cuts = cuts_of(sensor_ns, host_ns)
    spans = list(pairwise([0, *cuts, len(number)]))
    lengths_s = [(sensor_ns[end - 1] - sensor_ns[begin]) / S_NS for begin, end in spans]
    longest = int(np.argmax(lengths_s))
    rates = [
        rate_of(sensor_ns[slice(*span)], host_ns[slice(*span)]) if length_s >= 10.0 else None
        for span, length_s in zip(spans, lengths_s, strict=True)
    ]
    for (begin, end), own in zip(spans, rates, strict=True):
        rate = own or rates[longest] or 1.0
        since_ns = sensor_ns[begin:end] - sensor_ns[begin]
        off_ns = host_ns[begin:end] - host_ns[begin] - since_ns - (rate - 1.0) * since_ns
        parts.append((number[begin], sensor_ns[begin], host_ns[begin] + round(off_ns.min()), rate))
        late_ns.append(off_ns - round(off_ns.min()))
    late_ns = np.concatenate(late_ns)
    return parts, late_ns.max() / 1e6, np.median(late_ns) / 1e6


def cuts_of(sensor_ns, host_ns):
    """Places of the packets before which a clock steps, or after a gap."""
    gaps = [i for i in range(1, len(sensor_ns)) if abs(sensor_ns[i] - sensor_ns[i - 1]) > S_NS]
    cuts = set(gaps)
    for begin, end in pairwise([0, *gaps, len(sensor_ns)]):
        second = (sensor_ns[begin:end] - sensor_ns[begin]) // S_NS
        starts = [0, *(i for i in range(1, end - begin) if second[i] > second[i - 1])]
        ahead_ns = host_ns[begin:end] - sensor_ns[begin:end]
        for first, middle, last in zip(starts, starts[1:], [*starts[2:], end - begin], strict=False):
            change_ns = ahead_ns[middle:last].min() - ahead_ns[first:middle].min()
            if abs(change_ns) > 20_000_000:
                step_ns = np.diff(ahead_ns[first:last]) * np.sign(change_ns)
                cuts.add(begin + first + int(np.argmax(step_ns)) + 1)
    return sorted(cuts)


def rate_of(sensor_ns, host_ns):
    """Rate of the edge below the mean time of the lower hull that scipy finds."""
    x = (sensor_ns - sensor_ns[0]) / S_NS
    y = (host_ns - host_ns[0] - (sensor_ns - sensor_ns[0])) / 1e6
    hull = ConvexHull(np.column_stack([x, y]))
    at = x.mean()
    slopes = [
        (y[b] - y[a]) / (x[b] - x[a])
        for (a, b), (_, up, _) in zip(hull.simplices, hull.equations, strict=True)
        if up < 0 and min(x[a], x[b]) <= at <= max(x[a], x[b])
    ]
    return 1.0 + slopes[0] * 1e-3


@pytest.mark.parametrize("seed", range(6))
def test_arrivals_in_pieces_are_fitted_as_all_at_once(seed):
    """Taken in pieces of any length, over gaps, steps of both clocks and packets out of order, arrivals have
    the parts and delays of a fit to all of them, and the same judgement."""
    rng = np.random.default_rng(seed)
    count = 40_000
    step_ns = np.full(count, STEP_NS)
    step_ns[rng.choice(count, 2)] = rng.choice([-3 * S_NS, 4 * S_NS, 900_000_000], 2)
    sensor_ns = 3 * S_NS + np.cumsum(step_ns)
    host_ns = sensor_ns + round(rng.uniform(-9, 9)) * S_NS + rng.exponential(8e5, count).astype(np.int64)
    host_ns += (np.arange(count) * STEP_NS * rng.uniform(-5e-5, 5e-5)).astype(np.int64)
    for at in rng.choice(count, 3):
        host_ns[at:] += round(rng.choice([-0.5, 0.03, 0.5]) * S_NS)
    late = rng.choice(count - 1, 30)
    for times_ns in (sensor_ns, host_ns):
        times_ns[late], times_ns[late + 1] = times_ns[late + 1].copy(), times_ns[late].copy()
    number = np.arange(count) + 1
    record = ArrivalRecord()
    ends = [0, *np.sort(rng.choice(count, 60, replace=False)).tolist(), count]
    for begin, end in pairwise(sorted(set(ends))):
        record.take(number[begin:end], sensor_ns[begin:end], host_ns[begin:end])
    found = record.fit()
    parts, most_ms, median_ms = whole_fit(number, sensor_ns, host_ns)
    assert [(part.first, part.sensor_ns) for part in found.parts] == [part[:2] for part in parts]
    for part, (_, _, own_ns, rate) in zip(found.parts, parts, strict=True):
        assert part.rate == pytest.approx(rate, abs=1e-12)
        assert abs(part.host_ns - own_ns) <= 1
    assert found.residual_ms[1] == pytest.approx(most_ms, abs=1e-3)
    assert found.residual_ms[0] == pytest.approx(median_ms, rel=0.02, abs=1e-3)
    assert record.stamps == HostStamps.of(host_ns, sensor_ns)


def test_a_record_of_arrivals_does_not_grow():
    """Ten times as many packets, with the same delays, have a record of the same size within a tenth."""

    def bytes_of(count):
        rng = np.random.default_rng(3)
        record = ArrivalRecord()
        for begin in range(0, count, 1000):
            sensor_ns = 3 * S_NS + (begin + np.arange(1000)) * STEP_NS
            record.take(begin + np.arange(1000), sensor_ns, sensor_ns + rng.integers(0, 10**6, 1000))
        return len(pickle.dumps(record))

    assert bytes_of(400_000) == pytest.approx(bytes_of(40_000), rel=0.1)
