"""Tables of data packets."""

import doctest

import numpy as np
import pytest
from packets.kit import random_returns

from vlp16emu.elementary import matvec
from vlp16emu.packets import (
    DATA_PAYLOAD,
    SENSOR_R_MANUAL,
    Clock,
    PacketClock,
    PointFrame,
    data_payloads,
    decode_data,
    packet_row,
    packet_table,
    points_in,
    table,
    utc_ns_of,
)
from vlp16emu.types import ReturnMode, SensorModel
from vlp16emu.units import HOUR_NS, US_NS

PERIOD_NS = {ReturnMode.STRONGEST: 1_327_104, ReturnMode.LAST: 1_327_104, ReturnMode.DUAL: 663_552}
ARRIVAL_NS = 1_779_267_600_000_000_000  # 2026-05-20 09:00 UTC


def made(mode, clock):
    """Give payloads of random returns, and their table; the first packet arrives at the full hour."""
    payloads = data_payloads(random_returns(120, seed=1), mode, SensorModel.VLP_16)
    rows = (
        packet_row(7 + i, ARRIVAL_NS + i * PERIOD_NS[mode], payload.tobytes(), clock)
        for i, payload in enumerate(payloads)
    )
    return payloads, packet_table(rows)


@pytest.mark.parametrize("mode", ReturnMode)
def test_a_row_has_the_fields_of_its_payload(mode):
    """Each field of a payload is a column, the last bytes of a row are the payload, and number and arrival
    stand before."""
    payloads, packets = made(mode, PacketClock())
    fields = payloads.view(DATA_PAYLOAD)[:, 0]
    for name in DATA_PAYLOAD.names:
        np.testing.assert_array_equal(packets[name], fields[name])
    assert np.array_equal(packets.view(np.uint8).reshape(len(packets), -1)[:, -1206:], payloads)
    assert packets["number"].tolist() == list(range(7, 7 + len(payloads)))
    assert set(np.diff(packets["arrival_ns"])) == {PERIOD_NS[mode]}


@pytest.mark.parametrize("mode", ReturnMode)
def test_points_are_decoded_with_the_utc_of_each_pulse(mode):
    """Points of a table are those of its payloads; their UTC in whole hours is the time that the manual
    gives each pulse."""
    payloads, packets = made(mode, PacketClock())
    points = points_in(packets, keep_repeats=True)
    expected = decode_data(payloads, keep_no_returns=False)
    for name in expected.__slots__:
        np.testing.assert_array_equal(getattr(points, name), getattr(expected, name))
    assert np.array_equal(utc_ns_of(packets, points) % HOUR_NS, expected.time_ns)
    turned_m = points_in(packets, frame=PointFrame.MANUAL, keep_repeats=True).xyz_m
    assert np.array_equal(matvec(SENSOR_R_MANUAL, turned_m.astype(np.float64)), points.xyz_m)


@pytest.mark.parametrize("mode", ReturnMode)
def test_the_clock_of_the_host_dates_the_first_pulse_a_packet_before_its_arrival(mode):
    """UTC by the host is the stamp minus the duration of a packet; the sensor's clock stays beside it."""
    clock = PacketClock(Clock.HOST)
    _, packets = made(mode, clock)
    assert set(packets["arrival_ns"] - packets["utc_ns"]) == {PERIOD_NS[mode]}
    assert np.array_equal(packets["sensor_ns"] % HOUR_NS, packets["timestamp_us"].astype(np.int64) * US_NS)
    assert clock.host_ahead_ns == packets["utc_ns"][0] - packets["sensor_ns"][0]


def test_doctest():
    """The example shows UTC over the full hour."""
    assert doctest.testmod(table) == (0, 9)
