"""Tables of data packets."""

import doctest

import numpy as np
import pytest
from packets.kit import random_returns

from vlp16emu.elementary import matvec
from vlp16emu.packets import (
    SENSOR_R_MANUAL,
    Clock,
    PacketClock,
    PacketTable,
    PointFrame,
    data_fields,
    data_payloads,
    decode_data,
    table,
)
from vlp16emu.types import ReturnMode, SensorModel
from vlp16emu.units import HOUR_NS, US_NS

PERIOD_NS = {ReturnMode.STRONGEST: 1_327_104, ReturnMode.LAST: 1_327_104, ReturnMode.DUAL: 663_552}
ARRIVAL_NS = 1_779_267_600_000_000_000  # 2026-05-20 09:00 UTC


def made(mode, clock):
    """Give payloads of random returns, and their table; packets arrive at the full hour."""
    payloads = data_payloads(random_returns(120, seed=1), mode, SensorModel.VLP_16)
    fields = data_fields(payloads)
    number = np.arange(len(fields))
    return payloads, PacketTable.of(fields, number, ARRIVAL_NS + number * PERIOD_NS[mode], clock)


@pytest.mark.parametrize("mode", ReturnMode)
def test_columns_are_those_of_the_payloads(mode):
    """Stamps, modes, azimuths and records are the fields of each payload at the offsets of table 9-2."""
    payloads, packets = made(mode, PacketClock())
    assert packets.timestamp_us.tolist() == payloads[:, 1200:1204].copy().view("<u4")[:, 0].tolist()
    assert packets.mode.tolist() == payloads[:, 1204].tolist()
    assert packets.product.tolist() == payloads[:, 1205].tolist()
    assert packets.is_dual.all() == (mode is ReturnMode.DUAL)
    first = payloads[:, :1200].reshape(-1, 12, 100)
    assert np.array_equal(packets.azimuth_cdeg, first[..., 2:4].copy().view("<u2")[..., 0])
    records = first[..., 4:].reshape(-1, 12, 2, 16, 3)
    assert np.array_equal(packets.distance_lsb, records[..., :2].copy().view("<u2")[..., 0])
    assert np.array_equal(packets.reflectivity, records[..., 2])


@pytest.mark.parametrize("mode", ReturnMode)
def test_points_are_decoded_with_the_utc_of_each_pulse(mode):
    """Points are those of `decode_data`; their UTC in whole hours is the time that the manual gives each pulse."""
    payloads, packets = made(mode, PacketClock())
    points = packets.points()
    expected = decode_data(payloads, keep_no_returns=False)
    for name in expected.__slots__:
        np.testing.assert_array_equal(getattr(points, name), getattr(expected, name))
    assert np.array_equal(packets.t_ns(points) % HOUR_NS, expected.time_ns)
    turned_m = packets.points(PointFrame.MANUAL).xyz_m
    np.testing.assert_allclose(matvec(SENSOR_R_MANUAL, turned_m), points.xyz_m, atol=1e-6)
    assert np.array_equal(packets.block_ns[:, 0], packets.utc_ns)


@pytest.mark.parametrize("mode", ReturnMode)
def test_the_clock_of_the_host_dates_the_first_pulse_a_packet_before_its_arrival(mode):
    """UTC by the host is the stamp minus the duration of a packet; the sensor's clock stays beside it."""
    clock = PacketClock(Clock.HOST)
    _, packets = made(mode, clock)
    assert set(packets.arrival_ns - packets.utc_ns) == {PERIOD_NS[mode]}
    assert np.array_equal(packets.sensor_ns % HOUR_NS, packets.timestamp_us * US_NS)
    assert clock.host_ahead_ns == packets.utc_ns[0] - packets.sensor_ns[0]


def test_parts_and_their_joining_are_the_table():
    """A slice and a mask have the rows of all columns; parts that are joined are the whole."""
    _, whole = made(ReturnMode.STRONGEST, PacketClock())
    parts = [whole[:2], whole[np.arange(len(whole)) >= 2]]
    assert [len(part) for part in parts] == [2, 3]
    joined = PacketTable.joined(parts)
    for name in ("number", "arrival_ns", "sensor_ns", "utc_ns", "fields"):
        np.testing.assert_array_equal(getattr(joined, name), getattr(whole, name))


def test_doctest():
    """The example shows UTC over the full hour."""
    assert doctest.testmod(table) == (0, 6)
