"""Our packets as velodyne_decoder reads them, and its points against ours.

velodyne_decoder 3.1 is by Martin Valgur and others; its axes are ours. It
rounds azimuths to 0.01 deg, which is 9 mm at 100 m.
"""

import numpy as np
import pytest
import velodyne_decoder as vd
from packets.kit import make_returns, random_returns

from vlp16emu.packets import (
    data_fields,
    data_payloads,
    decode_data,
    pack_position,
    points_in,
    rmc,
    scan_starts,
)
from vlp16emu.types import GnssFix, PpsState, ReturnMode, SensorModel

RETURN_TYPES = {ReturnMode.STRONGEST: {1}, ReturnMode.LAST: {2}, ReturnMode.DUAL: {1, 2, 3}}


def their_points(payloads):
    """Points of all packets as one scan, in order of time, with absolute times in seconds."""
    config = vd.Config()
    config.min_range, config.max_range = 0, 200
    packets = [vd.VelodynePacket(i * 1e-3, payload.tobytes()) for i, payload in enumerate(payloads)]
    stamp, points = vd.ScanDecoder(config).decode(packets, as_pcl_structs=True)
    return stamp.device + points["time"].astype(np.float64), points


def compare(payloads, tolerance_m):
    """Hold every point of theirs against its twin of ours: both have each echo once."""
    times_s, theirs = their_points(payloads)
    ours = points_in(data_fields(payloads))
    assert len(theirs) == len(ours.slot)
    index = np.lexsort((ours.is_last, ours.time_ns))
    their_order = np.lexsort((theirs["return_type"], times_s.round(7)))
    theirs = theirs[their_order]
    np.testing.assert_array_equal(theirs["ring"], ours.ring[index])
    np.testing.assert_array_equal(theirs["intensity"], ours.reflectivity[index])
    # Their times are float32 seconds within a scan: 0.2 us at most apart.
    np.testing.assert_allclose(times_s[their_order], ours.time_ns[index] / 1e9, atol=2e-7)
    xyz_m = np.stack([theirs[axis] for axis in "xyz"], axis=1)
    off_m = np.linalg.norm(xyz_m - ours.xyz_m[index], axis=1)
    assert off_m.max() < tolerance_m
    return theirs


@pytest.mark.parametrize("mode", ReturnMode)
@pytest.mark.parametrize("model", [SensorModel.VLP_16, SensorModel.PUCK_HI_RES])
def test_points(mode, model):
    """Rings, reflectivities and times are equal, and no point is more than 15 mm apart."""
    returns = random_returns(24 * 30, seed=31)
    near = make_returns(
        24 * 30,
        clock_ns=12_345_678_901,
        reading_deg=returns.firings.reading_deg,
        distance_m=np.where(returns.distance_m < 100, returns.distance_m, 0),
        reflectivity=returns.reflectivity,
    )
    theirs = compare(data_payloads(near, mode, model), tolerance_m=0.015)
    assert set(theirs["return_type"]) == RETURN_TYPES[mode]


@pytest.mark.parametrize("capture", ["real_single", "real_dual"])
def test_points_of_real_units(request, capture):
    """The same holds for real captures, whose targets are near."""
    compare(request.getfixturevalue(capture)[:200], tolerance_m=0.015)


def test_scans():
    """Told to cut at 0 deg, its stream decoder cuts scans where ours are cut, to whole packets."""
    packets = 450
    returns = make_returns(
        24 * packets,
        reading_deg=(np.arange(24 * packets) * 0.1990656) % 360,
        distance_m=np.full((24 * packets, 16, 3), 10, np.float32),
    )
    payloads = data_payloads(returns, ReturnMode.STRONGEST, SensorModel.VLP_16)
    config = vd.Config()
    config.cut_angle = 0.0
    decoder = vd.StreamDecoder(config)
    results = [decoder.decode(i * 1.327104e-3, p.tobytes(), False) for i, p in enumerate(payloads)]
    lengths = [len(result[1]) for result in [*results, decoder.finish(False)] if result is not None]
    theirs = np.cumsum([0, *lengths[:-1]])
    ours = scan_starts(decode_data(payloads, keep_no_returns=True).azimuth_deg)
    assert len(ours) == 6
    np.testing.assert_array_equal(theirs, -(-ours // 384) * 384)


@pytest.mark.parametrize(
    ("latitude_deg", "longitude_deg"), [(62.24, 25.75), (-33.85, 151.21), (37.1, -121.65)]
)
@pytest.mark.parametrize("valid", [True, False])
def test_position(latitude_deg, longitude_deg, valid):
    """It finds state, time and place in our position packets."""
    fix = GnssFix(1_779_267_600 * 10**9, valid, latitude_deg, longitude_deg, 1.2, 90.0)
    packet = vd.TelemetryPacket(pack_position(342_001_999, PpsState.LOCKED, rmc(fix)))
    nmea = packet.parse_nmea()
    assert packet.usec_since_toh == 342_001
    assert packet.pps_status == vd.TelemetryPacket.PpsStatus.LOCKED
    assert packet.nmea_sentence == rmc(fix).decode()
    assert packet.nmea_time.timestamp() == 1_779_267_600  # a naive datetime in local time
    assert packet.pps_time.timestamp() == pytest.approx(1_779_267_600.342001, abs=1e-6)
    assert (nmea.fix_available, nmea.utc_year, nmea.utc_month, nmea.utc_day) == (valid, 2026, 5, 20)
    assert (nmea.latitude, nmea.longitude) == pytest.approx((latitude_deg, longitude_deg), abs=1e-8)
