"""The real captures: read, packed again to the same bytes, and what was measured on them."""

import itertools

import numpy as np
import pytest
from listening import parse_rmc
from packets.kit import make_returns
from scipy import stats

from vlp16emu.packets import (
    data_fields,
    data_payloads,
    decode_data,
    decode_position,
    pack_position,
    position_due_ns,
    rmc,
)
from vlp16emu.types import ReturnMode, SensorModel


def repacked(payloads, mode):
    """Decode, rebuild what the sensor measured, and pack."""
    points = decode_data(payloads, keep_no_returns=True)
    shape = (-1, 16, 2) if mode is ReturnMode.DUAL else (-1, 16, 1)
    distance_m, reflectivity = points.distance_m.reshape(shape), points.reflectivity.reshape(shape)
    # Even block: last. Odd block: strongest. Where both are equal there is no second strongest.
    order = [1, 0] if mode is ReturnMode.DUAL else [0, 0]
    none = np.zeros_like(distance_m[..., :1])
    returns = make_returns(
        len(distance_m),
        distance_m=np.concatenate([distance_m[..., order], none], axis=2),
        reflectivity=np.concatenate([reflectivity[..., order], none.astype(np.uint8)], axis=2),
        reading_deg=np.repeat(
            data_fields(payloads)["blocks"]["azimuth_cdeg"][:, :: shape[2]].ravel() / 100, 2
        ),
    )
    stamps_ns = data_fields(payloads)["timestamp_us"].astype(np.int64) * 1000
    returns.firings.clock_ns[:: len(distance_m) // len(payloads)] = stamps_ns
    return data_payloads(returns, mode, SensorModel.VLP_16)


@pytest.mark.parametrize(
    ("capture", "mode"), [("real_single", ReturnMode.STRONGEST), ("real_dual", ReturnMode.DUAL)]
)
def test_packed_again(request, capture, mode):
    """Decoded and packed again the payloads of real units are the same, to the last byte."""
    payloads = request.getfixturevalue(capture)
    np.testing.assert_array_equal(repacked(payloads, mode), payloads)


def test_time_steps(real_single, real_dual):
    """Stamps of single return step by 1327 (261 times) or 1328 us (31), within 1 us of 1327.104 us; those
    of dual return by 663.552 us to 1 ns."""
    stamps_us = data_fields(real_single)["timestamp_us"].astype(np.int64)
    steps, counts = np.unique(np.diff(stamps_us), return_counts=True)
    assert dict(zip(steps.tolist(), counts.tolist(), strict=True)) == {1327: 261, 1328: 31}
    off_us = stamps_us - stamps_us[0] - np.arange(len(stamps_us)) * 1327.104
    assert np.ptp(off_us) <= 2
    stamps_us = data_fields(real_dual)["timestamp_us"].astype(np.int64)
    assert set(np.diff(stamps_us)) == {663, 664}
    assert np.diff(stamps_us).mean() == pytest.approx(663.552, abs=0.001)


@pytest.mark.parametrize(("capture", "stride"), [("real_single", 1), ("real_dual", 2)])
def test_azimuth_steps(request, capture, stride):
    """Azimuths step by 37 to 42 hundredths with a standard deviation of 0.86, within and between packets."""
    blocks = data_fields(request.getfixturevalue(capture))["blocks"]
    azimuth = blocks["azimuth_cdeg"][:, ::stride].astype(np.int64)
    step = np.diff(azimuth.ravel()) % 36_000
    assert step.min() >= 37
    assert step.max() <= 42
    assert step.mean() == pytest.approx(39.8, abs=0.06)
    assert step.std() == pytest.approx(0.86, abs=0.03)
    between = step[azimuth.shape[1] - 1 :: azimuth.shape[1]]
    assert between.mean() == pytest.approx(step.mean(), abs=0.15)
    # White noise on each reading gives steps a correlation of -0.5 with their neighbours.
    assert np.corrcoef(step[:-1], step[1:])[0, 1] == pytest.approx(-0.48, abs=0.05)


def test_pairs_of_dual_return(real_dual):
    """Both blocks of a pair show one azimuth; half of the pairs are misses, half repeat one return."""
    blocks = data_fields(real_dual)["blocks"]
    np.testing.assert_array_equal(blocks["azimuth_cdeg"][:, 0::2], blocks["azimuth_cdeg"][:, 1::2])
    records = blocks["records"]
    even, odd = (records["distance_lsb"][:, first::2].astype(int).ravel() for first in (0, 1))
    both = (even > 0) & (odd > 0)
    shares = [np.mean((even == 0) & (odd == 0)), np.mean(both & (even == odd)), np.mean(both & (even != odd))]
    assert shares == pytest.approx([0.493, 0.496, 0.0061], abs=0.001)
    apart_m = (even - odd)[both & (even != odd)] * 0.002
    assert apart_m.min() == pytest.approx(1.19, abs=0.01)


def test_positions(real_position):
    """Position packets and their sentences are packed again to the same bytes; a sentence names the second
    whose edge came last before the stamp."""
    for _, payload in real_position:
        fields = decode_position(payload)
        assert rmc(parse_rmc(fields.sentence)) == fields.sentence
        assert pack_position(fields.time_ns, fields.pps, fields.sentence) == payload
    for _, payload in real_position:
        fields = decode_position(payload)
        behind_ns = fields.time_ns - parse_rmc(fields.sentence).t_ns % (3_600 * 10**9)
        assert 0 < behind_ns < 10**9


def test_position_schedule(real_position):
    """Our intervals between position packets could be those of the real unit.

    The largest distance between the cumulative shares stays under 0.21, the critical value of Kolmogorov and
    Smirnov for 56 against many intervals at 1 percent.
    """
    stamps_us = [decode_position(payload).time_ns / 1000 for _, payload in real_position]
    real_us = np.array([after - before for before, after in itertools.pairwise(stamps_us)])
    ours_us = np.diff(position_due_ns("measured", 1, 0, 0, 5000)) / 1000
    assert real_us.mean() == pytest.approx(ours_us.mean(), rel=0.005)
    assert real_us.std() == pytest.approx(ours_us.std(), rel=0.05)
    assert stats.ks_2samp(real_us, ours_us).statistic < 0.21
