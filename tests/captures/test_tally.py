"""Running figures of a capture are those of all its packets at once."""

import pickle
from itertools import pairwise

import numpy as np
import pytest

from vlp16emu.captures.tally import Duration, ModeTurns, Scans
from vlp16emu.packets.decode import scan_starts
from vlp16emu.packets.layout import layout_of
from vlp16emu.types import ReturnMode, SensorModel

S_NS = 1_000_000_000
BLOCK_NS = 110_592  # two firing sequences of 55.296 us (63-9243 Rev D, section 8.3)


def in_pieces(count, rng, pieces=40):
    """Slices of a sequence, the first of one element."""
    ends = {0, 1, count, *rng.choice(count, pieces).tolist()}
    return [slice(*span) for span in pairwise(sorted(ends))]


@pytest.mark.parametrize("seed", range(8))
def test_scans_in_pieces_are_those_of_the_whole(seed):
    """With noise, packets out of order, gaps of time and steps back across the wrap, the number of
    revolutions and their lengths are those that `scan_starts` gives for all readings."""
    rng = np.random.default_rng(seed)
    count = 20_000
    t_ns = np.arange(count) * BLOCK_NS
    for at in rng.choice(count, 3):
        t_ns[at:] += S_NS
    azimuth_deg = (rng.uniform(0, 360) + np.arange(count) * 0.4 + rng.normal(0, 0.005, count)) % 360
    late = rng.choice(count - 20, 10)
    for values in (azimuth_deg, t_ns):
        for at in late.tolist():
            values[at : at + 12], values[at + 12] = values[at + 1 : at + 13].copy(), values[at]
    scans = Scans()
    for part in in_pieces(count, rng):
        scans.take(azimuth_deg[part], t_ns[part])
    starts = scan_starts(azimuth_deg, t_ns)
    assert scans.count == len(starts)
    assert sorted(scans.lengths) == sorted(np.diff(starts)[1:])


def test_the_duration_follows_the_host_where_the_sensors_clock_jumps():
    """Steps back, and steps that the host does not see, count as long as they are on the host's clock."""
    rng = np.random.default_rng(1)
    sensor_ns = np.array([0, 1, 2, -3600, 3, 4, 5, 1805, 1806]) * S_NS
    host_ns = np.arange(9) * S_NS + rng.integers(0, 1000, 9)
    for part in (slice(0, 9), slice(0, 1)):
        duration = Duration()
        steps = [duration.take(sensor_ns[part], host_ns[part])]
        if part.stop == 1:
            steps += [duration.take(sensor_ns[a : a + 1], host_ns[a : a + 1]) for a in range(1, 9)]
        np.testing.assert_array_equal(np.concatenate(steps), np.diff(sensor_ns))
        assert duration.total_ns == pytest.approx(8 * S_NS, abs=5000)


@pytest.mark.parametrize("gap_cdeg", [0, 9000])
@pytest.mark.parametrize("model", [SensorModel.VLP_16, SensorModel.HDL_32E, SensorModel.VLS_128])
@pytest.mark.parametrize("mode", [ReturnMode.STRONGEST, ReturnMode.DUAL])
def test_the_speed_of_a_rotor_is_that_of_its_readings(model, mode, gap_cdeg):
    """Packets of one reading or several, in pieces, have the even steps of all packets at once; without a gap
    in each revolution they give the speed with which the azimuths were made."""
    layout = layout_of(model, mode)
    packets = 4000
    reading = np.arange(packets * layout.readings)
    turned_cdeg = reading * 600 * 360 * 100 / 60 * layout.reading_ns / S_NS
    turned_cdeg += gap_cdeg * (turned_cdeg // (36_000 - gap_cdeg))
    azimuth_cdeg = np.zeros((packets, 12), np.uint16)
    own_cdeg = (turned_cdeg.astype(np.int64) % 36_000).reshape(packets, layout.readings)
    layout.by_reading(azimuth_cdeg)[:] = own_cdeg[:, :, None, None]
    turns = ModeTurns(layout)
    step_ns = np.full(packets - 1, layout.period_ns)
    for part in in_pieces(packets, np.random.default_rng(2)):
        turns.take(azimuth_cdeg[part], step_ns[max(part.start - 1, 0) : part.stop - 1])
    step_cdeg = np.diff(own_cdeg.T if layout.readings == 1 else own_cdeg) % 36_000
    even = step_cdeg <= 2 * np.median(step_cdeg, axis=1, keepdims=True)
    period_ns = layout.measured_period_ns(step_ns // 1000)
    assert turns.turned_cdeg == step_cdeg[even].sum()
    assert turns.turning_ns == even.sum() * period_ns // layout.readings
    if not gap_cdeg:
        rpm = turns.turned_cdeg / 36_000 / (turns.turning_ns / S_NS) * 60
        assert rpm == pytest.approx(600, rel=1e-2)


def test_running_figures_do_not_grow():
    """Ten times as many packets have figures of the same size, within a tenth."""

    def bytes_of(packets):
        figures = scans, duration, turns = (
            Scans(),
            Duration(),
            ModeTurns(layout_of(SensorModel.VLP_16, ReturnMode.STRONGEST)),
        )
        rng = np.random.default_rng(4)
        for begin in range(0, packets, 1000):
            block = 12 * begin + np.arange(12_000)
            azimuth_deg = (block * 0.4 + rng.normal(0, 0.005, len(block))) % 360
            scans.take(azimuth_deg, block * BLOCK_NS)
            t_ns = block[::12] * BLOCK_NS
            step_ns = duration.take(t_ns, t_ns)
            turns.take((100 * azimuth_deg).astype(np.uint16).reshape(-1, 12), step_ns)
        return len(pickle.dumps(figures))

    assert bytes_of(100_000) == pytest.approx(bytes_of(10_000), rel=0.1)
