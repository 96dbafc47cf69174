"""A recorded walk, read by a driver that is not ours."""

from datetime import UTC, timedelta

import numpy as np
import pytest
import velodyne_decoder

from vlp16emu.emulator import Emulator
from vlp16emu.packets import DATA_BYTES, POSITION_BYTES, Capture, decode_data
from vlp16emu.scenario import load
from vlp16emu.sinks import PcapSink

pytestmark = pytest.mark.usefixtures("kept_woods")

DURATION_S = 2.0
SCANS = 20


@pytest.fixture(scope="module", params=["strongest", "dual"])
def walk(request, tmp_path_factory):
    """Two seconds of a thin birch stand with the encoder's errors off: scenario, file, and what was cast."""
    settings = [
        "world.stems_per_ha=200",
        "sensor.eccentricity_deg=0.0",
        "sensor.azimuth_noise_deg=0.0",
        f"sensor.return_mode={request.param}",
        "beam.model=none",
    ]
    scenario = load("birch_walk", settings)
    path = tmp_path_factory.mktemp("walk") / "walk.pcap"
    with PcapSink(path) as sink:
        for packet in Emulator(scenario).packets(0.0, DURATION_S):
            sink.send(packet)
    return scenario, path


@pytest.fixture(scope="module")
def scans(walk):
    """What the other decoder makes of the file: host stamp and points per scan."""
    return list(velodyne_decoder.read_pcap(str(walk[1]), as_pcl_structs=True))


@pytest.fixture(scope="module")
def payloads(walk):
    """Payloads of the file by their length."""
    found = {DATA_BYTES: [], POSITION_BYTES: []}
    with Capture(walk[1]) as capture:
        for datagram in capture:
            found[len(datagram.payload)].append(datagram.payload)
    return found


def test_the_other_decoder_sees_every_revolution(scans):
    """Ten scans per second with all sixteen rings and nothing beyond 100 m."""
    assert abs(len(scans) - SCANS) <= 1
    for _, points in scans:
        assert set(points["ring"].tolist()) == set(range(16))
        assert np.sqrt(points["x"] ** 2 + points["y"] ** 2 + points["z"] ** 2).max() < 100.1


def test_both_decoders_find_the_same_points(scans, payloads):
    """Point by point, in order of firing, ring and reflectivity are equal and positions agree within 15 mm."""
    theirs = np.concatenate([points for _, points in scans])
    data = np.frombuffer(b"".join(payloads[DATA_BYTES]), np.uint8).reshape(-1, DATA_BYTES)
    ours = decode_data(data, keep_no_returns=False)
    # The other decoder leaves out a record of dual return that repeats the one before it.
    repeats = (np.diff(ours.time_ns, prepend=-1) == 0) & (np.diff(ours.distance_m, prepend=-1) == 0)
    assert len(theirs) == (~repeats).sum()
    assert (theirs["ring"] == ours.ring[~repeats]).all()
    assert (theirs["intensity"] == ours.reflectivity[~repeats]).all()
    their_m = np.stack([theirs[axis] for axis in "xyz"], axis=1)
    gap_m = np.linalg.norm(their_m - ours.xyz_m[~repeats], axis=1)
    assert gap_m.max() < 0.015


def test_position_packets_are_read_as_telemetry(walk, payloads):
    """The other decoder finds the pulse locked, and the time of pulse and sentence within the second of sending."""
    scenario, _ = walk
    assert len(payloads[POSITION_BYTES]) > 250
    for payload in payloads[POSITION_BYTES]:
        telemetry = velodyne_decoder.TelemetryPacket(list(payload))
        assert telemetry.pps_status == velodyne_decoder.TelemetryPacket.PpsStatus.LOCKED
        pps_time = telemetry.pps_time.replace(tzinfo=UTC)
        assert scenario.start_utc <= pps_time < scenario.start_utc + timedelta(seconds=DURATION_S)
        sentence_age_s = (pps_time - telemetry.nmea_time.replace(tzinfo=UTC)).total_seconds()
        assert 0.34 < sentence_age_s < 1.36
        longitude_deg, latitude_deg, _ = telemetry.gps_position
        assert latitude_deg == pytest.approx(scenario.gps.latitude_deg, abs=1e-4)
        assert longitude_deg == pytest.approx(scenario.gps.longitude_deg, abs=1e-4)
