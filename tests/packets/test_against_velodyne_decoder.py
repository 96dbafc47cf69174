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
from vlp16emu.packets.decode import is_dual, layouts_of
from vlp16emu.sensor.beams import MODELS
from vlp16emu.types import GnssFix, PpsState, ReturnMode, SensorModel

RETURN_TYPES = {ReturnMode.STRONGEST: {1}, ReturnMode.LAST: {2}, ReturnMode.DUAL: {1, 2, 3}}
MODELS_OF_OTHERS = [model for model in SensorModel if model is not SensorModel.PUCK_LITE]  # one is a VLP-16
TURNED_DEG = {SensorModel.VLS_128: 0.02}
"""Greatest angle between points: of a VLS-128 it has a slot more of maintenance, and turns on by the packet
before. Of others it rounds azimuths to 0.01 deg, and vertical corrections of a Puck are not the manual's."""


def their_points(payloads):
    """Points of all packets as one scan, in order of packets, with absolute times in seconds."""
    config = vd.Config()
    config.min_range, config.max_range = 0, 300
    packets = [vd.VelodynePacket(i * 1e-3, payload.tobytes()) for i, payload in enumerate(payloads)]
    stamp, points = vd.ScanDecoder(config).decode(packets, as_pcl_structs=True)
    return stamp.device + points["time"].astype(np.float64), points


def compare(payloads, *, leaves_out=()):
    """Hold every point of theirs against its twin of ours, but those of some packets: both have each echo
    once, in the order of blocks and records, of a pair the last one first."""
    times_s, theirs = their_points(payloads)
    fields = data_fields(payloads)
    ours = points_in(fields)
    of_mode = layouts_of(fields)[int(is_dual(fields)[0])]
    model, block = of_mode.model.name, ours.slot // 32
    keys = block % of_mode.copies, ours.slot % 32, block // of_mode.copies, ours.packet
    order = np.lexsort(keys)
    assert len(theirs) == len(order)
    kept = ~np.isin(ours.packet[order], leaves_out)
    order, theirs, times_s = order[kept], theirs[kept], times_s[kept]
    np.testing.assert_array_equal(theirs["ring"], ours.ring[order])
    np.testing.assert_array_equal(theirs["intensity"], ours.reflectivity[order])
    # Their times are float32 seconds within a scan; of a VLS-128 they have other offsets and a longer slot.
    close_s = 7e-6 if model is SensorModel.VLS_128 else 2e-7
    np.testing.assert_allclose(times_s, ours.time_ns[order] / 1e9, atol=close_s)
    xyz_m = np.stack([theirs[axis] for axis in "xyz"], axis=1)
    off_m = np.linalg.norm(xyz_m - ours.xyz_m[order], axis=1)
    turned_m = np.radians(TURNED_DEG.get(model, 0.0055)) * ours.distance_m[order]
    assert (off_m <= (0.015 if of_mode.per_reading == 2 else turned_m)).all()
    return theirs


@pytest.mark.parametrize("mode", ReturnMode)
@pytest.mark.parametrize("model", MODELS_OF_OTHERS)
def test_points(mode, model):
    """Rings, reflectivities and times are equal, and no point is more than 15 mm apart on a Puck, or more
    than 0.0055 deg on others, 0.02 deg on a VLS-128."""
    lasers = MODELS[model].lasers
    returns = random_returns(24 * 30 if lasers == 16 else 96, seed=31, lasers=lasers)
    near = make_returns(
        len(returns.distance_m),
        clock_ns=12_345_678_901,
        reading_deg=returns.firings.reading_deg,
        distance_m=np.where(returns.distance_m < 100, returns.distance_m, 0),
        reflectivity=returns.reflectivity,
        lasers=lasers,
    )
    # Of a VLS-128 it knows no speed in the first packet.
    theirs = compare(data_payloads(near, mode, model), leaves_out=[0] * (model is SensorModel.VLS_128))
    assert set(theirs["return_type"]) == RETURN_TYPES[mode]


@pytest.mark.parametrize("capture", ["real_single", "real_dual", "real_hdl_32e"])
def test_points_of_real_units(request, capture):
    """The same holds for real captures, whose targets are near."""
    compare(request.getfixturevalue(capture)[:200])


def test_points_of_a_real_vlp_32c(real_vlp_32c):
    """Points of a real VLP-32C are the same, except in packets with a gap of azimuths, which velodyne_decoder
    takes for speed."""
    azimuth = data_fields(real_vlp_32c)["blocks"]["azimuth_cdeg"].astype(int)
    has_gap = np.flatnonzero((np.diff(azimuth) % 36_000).max(axis=1) > 100)
    assert len(has_gap) == 5
    compare(real_vlp_32c, leaves_out=has_gap)


def test_points_of_a_real_vls_128(real_vls_128):
    """Points of a real VLS-128 are the same, except in the first packet: velodyne_decoder lacks its
    speed."""
    compare(real_vls_128[:300], leaves_out=[0])


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
