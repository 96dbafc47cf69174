"""UTC of packets by the sensor's clock, the receiver's sentences and the host; kinds of captures that
people reported."""

from pathlib import Path

import numpy as np
import pytest

from vlp16emu.captures import UnitClock, unit_clocks
from vlp16emu.errors import CaptureError, InputError
from vlp16emu.extras.bag.write import _check_stamps
from vlp16emu.packets import Clock, PacketClock, pack_position, rmc, scan_starts
from vlp16emu.packets.layout import DATA_PAYLOAD
from vlp16emu.sinks import PcapSink
from vlp16emu.types import GnssFix, Packet, PacketKind, PpsState, SensorModel
from vlp16emu.units import HOUR_NS, S_NS

NINE = 1_779_267_600 * S_NS  # 2026-05-20 09:00 UTC
REAL = Path(__file__).resolve().parents[3] / "shared" / "captures" / "mrpt_vlp16_gps.pcap"


@pytest.mark.parametrize(
    ("stamps_s", "past_hour_s", "utc_s"),
    [
        ([3599.9, 3600.1], [3599.9, 0.1], [3599.9, 3600.1]),  # over the hour
        ([3600.04, 3600.05], [3599.98, 3599.99], [3599.98, 3599.99]),  # velodyne#462: 60 ms behind the host
        ([3599.9, 3600.1], [3599.9, 3600.02], [3599.9, 3600.02]),  # velodyne#218: stamps that run on
        (
            [1799.9, 1800.1, 1799.95],
            [0.0, 0.2, 0.3],
            [0.0, 0.2, 0.3],
        ),  # velodyne#524: host jitters across half an hour
        ([10.0, 9010.0], [10.0, 1810.0], [10.0, 9010.0]),  # suspended: both clocks go on by 2.5 h
        ([10.0, 18010.1], [10.0, 10.1], [10.0, 10.1]),  # ouster-sdk#176: NTP steps the host by 5 h
        ([10.0, 10.1, 10.2], [10.1, 10.0, 10.2], [10.1, 10.0, 10.2]),  # a packet that comes late
    ],
)
def test_the_hour_is_the_one_that_both_clocks_allow(stamps_s, past_hour_s, utc_s):
    """Steps up to a second are the sensor's; after longer ones the hour is nearest to where the host has
    gone (velodyne#384)."""
    clock = PacketClock()
    pairs = zip(stamps_s, past_hour_s, strict=True)
    found = [clock.sensor_ns(NINE + round(stamp * 1e9), round(past * 1e6)) - NINE for stamp, past in pairs]
    assert np.array(found) / S_NS == pytest.approx(utc_s, abs=1e-9)


def captured(path, pps, named_ns=None, past_hour_s=2747.198, host_ns=NINE + 1783 * S_NS):
    """Capture of a data and, unless `pps` is None, a position packet."""
    data = np.zeros(1, DATA_PAYLOAD)
    data["timestamp_us"], data["return_mode"] = round(past_hour_s * 1e6), 0x37
    with PcapSink(path) as sink:
        sink.send(Packet(PacketKind.DATA, host_ns, data.tobytes()))
        if pps is not None:
            sentence = rmc(GnssFix(named_ns, True, 62.0, 25.0, 0.0, 0.0)) if named_ns else b""
            payload = pack_position(round(past_hour_s * S_NS), pps, sentence)
            sink.send(Packet(PacketKind.POSITION, host_ns, payload))
    return path


@pytest.mark.parametrize(
    ("pps", "past_hour_s", "clock"),
    [
        (PpsState.LOCKED, 2747.198, Clock.SENSOR),
        (PpsState.ABSENT, 2747.198, Clock.FITTED),  # velodyne#183, #524
        (PpsState.SYNCHRONIZING, 1783.0, Clock.FITTED),
        (None, 2747.198, Clock.FITTED),
        (None, 1782.9, Clock.SENSOR),
    ],
)
def test_the_default_is_the_clock_that_follows_utc(tmp_path, pps, past_hour_s, clock):
    """A locked sensor's clock is UTC (63-9243 Rev D, section 7); without lock it counts from power-up, and
    the host's is the best."""
    (found,) = unit_clocks(captured(tmp_path / "a.pcap", pps, past_hour_s=past_hour_s), [None])
    assert found.clock.clock == clock


@pytest.mark.parametrize(
    ("host_s", "clock"), [([0.0, 1e-3 * 1.327, 2e-3 * 1.327], Clock.FITTED), ([0.0, 0.0, 0.0], Clock.SENSOR)]
)
def test_the_clock_of_a_prototype_knows_its_model(tmp_path, host_s, clock):
    """It is that of a VLP-16 also where the stamps of the host stand still and the sensor's clock is taken,
    as packets of an HDL-32E, whose product byte it has, are younger."""
    model = SensorModel("vlp-16")
    data = np.zeros(3, DATA_PAYLOAD)
    data["timestamp_us"], data["return_mode"] = 5_000_000 + 1327 * np.arange(3), 0x37
    data["factory"] = 0x21
    with PcapSink(tmp_path / "a.pcap") as sink:
        for at_s, row in zip(host_s, data, strict=True):
            sink.send(Packet(PacketKind.DATA, NINE + round(at_s * S_NS), row.tobytes()))
    (found,) = unit_clocks(tmp_path / "a.pcap", [None], model=model)
    assert (found.clock.clock, found.clock.model) == (clock, model)


def test_sentences_name_date_and_hour_for_a_host_without_a_clock(tmp_path):
    """A board whose clock begins in 1970 (WendyOS#1171) has its packets in the hour of GPRMC; without a
    sentence that is refused."""
    path = captured(tmp_path / "a.pcap", PpsState.LOCKED, NINE + 2746 * S_NS, host_ns=12 * S_NS)
    (found,) = unit_clocks(path, [None], "gps")
    assert found.first_ns == NINE + round(2747.198 * S_NS)
    with pytest.raises(InputError, match="no valid sentence"):
        unit_clocks(captured(tmp_path / "b.pcap", PpsState.ABSENT), [None], "gps")
    with pytest.raises(CaptureError, match="expected 0 to 2147483647 s; --clock chooses another"):
        _check_stamps(path, [UnitClock(PacketClock(), -HOUR_NS)])


@pytest.mark.skipif(not REAL.is_file(), reason="no real captures beside the repository")
def test_a_real_locked_unit_has_one_time_by_its_clock_and_its_sentences():
    """A unit of 2016 with GPS: its clock is the default, and its sentences name the same hour as the host."""
    by = {name: unit_clocks(REAL, [None], name)[0] for name in (None, "gps")}
    assert by[None].clock.clock == Clock.SENSOR
    assert by[None].first_ns == by["gps"].first_ns


@pytest.mark.parametrize(
    ("azimuth_deg", "ms", "starts"),
    [
        ([350, 359.6, 9.2, 18.8], [0, 1.3, 2.6, 3.9], [0, 2]),
        ([100, 109.6, 104.6, 114.2], [0, 1.3, 2.6, 3.9], [0]),  # a small step back
        ([359, 5, 2, 8], [0, 1.3, 0.7, 2.6], [0, 1]),  # a late packet behind the cut
        ([357, 5, 359.5, 9], [0, 1.3, 0.7, 2.6], [0, 1]),  # and one from before it
        ([10, 19.6, 12, 18], [0, 1.3, 50, 51], [0, 2]),  # a field of view of 10 deg
        ([100, 110, 120], [0, 1.3, 9000e3], [0, 2]),  # a jump of the clock
    ],
)
def test_a_revolution_ends_where_the_rotor_can_have_turned(azimuth_deg, ms, starts):
    """At 1200 rpm (63-9243 Rev D, section 8.3) 1.3 ms are 9.4 deg: a fall that needs more is no turn."""
    t_ns = (np.array(ms) * 1e6).astype(np.int64)
    assert scan_starts(np.array(azimuth_deg, np.float64), t_ns).tolist() == starts
