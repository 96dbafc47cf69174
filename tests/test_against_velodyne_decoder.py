"""A recorded walk, read by a driver that is not ours; `tests/packets` holds both decoders against each other packet by packet."""

from datetime import UTC, datetime

import numpy as np
import pytest
import velodyne_decoder
from woods import LINES

from vlp16emu import Emulator
from vlp16emu.captures import Capture
from vlp16emu.packets import DATA_BYTES, POSITION_BYTES, decode_data
from vlp16emu.scenario import load

pytestmark = pytest.mark.usefixtures("kept_woods")

DURATION_S = 0.6
SETTINGS = [*LINES, "sensor.eccentricity_deg=0.0", "sensor.azimuth_noise_deg=0.0", "beam.model=none"]


@pytest.mark.parametrize("mode", ["strongest", "dual"])
def test_a_walk_is_read_by_another_driver(tmp_path, mode):
    """Ten scans a second of the same points in order of firing, and position packets locked within the second of sending."""
    scenario, path = load("birch_walk", [*SETTINGS, f"sensor.return_mode={mode}"]), tmp_path / "walk.pcap"
    Emulator(scenario).record(path, duration_s=DURATION_S)
    with Capture(path) as capture:
        payloads = [datagram.payload for datagram in capture]
    scans = [points for _, points in velodyne_decoder.read_pcap(str(path), as_pcl_structs=True)]
    assert abs(len(scans) - 10 * DURATION_S) <= 1
    assert all(set(points["ring"].tolist()) == set(range(16)) for points in scans)
    theirs = np.concatenate(scans)
    data = np.frombuffer(b"".join(one for one in payloads if len(one) == DATA_BYTES), np.uint8)
    ours = decode_data(data.reshape(-1, DATA_BYTES), keep_no_returns=False)
    # The other decoder leaves out a record of dual return that repeats the one before it.
    own = ~((np.diff(ours.time_ns, prepend=-1) == 0) & (np.diff(ours.distance_m, prepend=-1) == 0))
    np.testing.assert_array_equal(theirs["ring"], ours.ring[own])
    np.testing.assert_array_equal(theirs["intensity"], ours.reflectivity[own])
    their_m = np.stack([theirs[axis] for axis in "xyz"], axis=1)
    assert np.linalg.norm(their_m - ours.xyz_m[own], axis=1).max() < 0.015
    telemetry = [velodyne_decoder.TelemetryPacket(list(one)) for one in payloads if len(one) == POSITION_BYTES]
    assert len(telemetry) > 125 * DURATION_S
    for packet in telemetry:
        assert packet.pps_status == velodyne_decoder.TelemetryPacket.PpsStatus.LOCKED
        pps_time = packet.pps_time.replace(tzinfo=UTC)
        assert scenario.start_utc <= pps_time < datetime.fromtimestamp(scenario.start_ns * 1e-9 + DURATION_S, UTC)
        assert 0.34 < (pps_time - packet.nmea_time.replace(tzinfo=UTC)).total_seconds() < 1.36
        longitude_deg, latitude_deg, _ = packet.gps_position
        place = scenario.gps.latitude_deg, scenario.gps.longitude_deg
        assert (latitude_deg, longitude_deg) == pytest.approx(place, abs=1e-4)
