"""Scans: whole revolutions, of a scene and of the capture of the same scene alike."""

from datetime import UTC, datetime
from itertools import pairwise

import numpy as np
import pytest
from woods import THIN

from vlp16emu import Emulator, Scenario, decode
from vlp16emu.errors import CaptureError, InputError, PacketError
from vlp16emu.extras.clouds.points import write_points
from vlp16emu.extras.clouds.scan import Chunk, cut_scans
from vlp16emu.packets import DISTANCE_LSB_M

pytestmark = pytest.mark.usefixtures("kept_woods")

SPAN_S = 0.35
BLOCK_NS = 110_592
FREE = {"sensor.model": "free", "sensor.beams": 4, "sensor.azimuth_resolution_deg": 2.0}


@pytest.fixture(scope="module")
def hall():
    """Make an emulator of the hall, in which every pulse has a return."""

    def make(**settings):
        return Emulator(
            "static_bench", {f"sensor.{key}": value for key, value in settings.items()}, threads=1
        )

    return make


def off_deg(one, other):
    """Difference of azimuths, -180 to 180."""
    return (one - other + 180.0) % 360.0 - 180.0


@pytest.mark.parametrize(("rpm", "start_deg"), [(600, 0.0), (1200, 200.0)])
def test_a_scan_is_a_whole_revolution(hall, rpm, start_deg):
    """First and last firing are at azimuth 0, to a block; scans follow each other without a gap; begun
    ones are left out."""
    step_deg = rpm * 6 * BLOCK_NS * 1e-9
    emulator = hall(rpm=rpm, start_azimuth_deg=start_deg)
    scans = list(emulator.scans(duration_s=SPAN_S))
    assert len(scans) == int(SPAN_S * rpm / 60 - (360 - start_deg) % 360 / 360)
    for scan in scans:
        assert scan.azimuth_deg[0] < step_deg
        assert -0.01 < off_deg(scan.azimuth_deg[-1], 0.0) < step_deg
        assert scan.start_ns == scan.t_ns[0]
        assert len(scan.t_ns) == len(scan.xyz_m) == pytest.approx(16 * 60e9 / rpm / 55_296, abs=32)
    for one, other in pairwise(scans):
        assert other.start_ns - one.t_ns[-1] == 55_296 - 15 * 2_304


@pytest.mark.parametrize("mode", ["strongest", "last", "dual"])
def test_scans_are_those_of_the_capture(each_unit, tmp_path, mode):
    """Point by point a scan of the scene is that of its recording, to the steps of the wire."""
    emulator = Emulator(
        each_unit,
        {
            "sensor.return_mode": mode,
            "beam.model": "fixed",
            "beam.rays": 8,
            "gps.connected": True,
            "start_utc": datetime(2026, 5, 20, 8, 59, 59, 900_000, UTC),
        },
        threads=1,
    )
    recorded = emulator.record(tmp_path / "x.pcap", duration_s=SPAN_S)
    own, wire = list(emulator.scans(duration_s=SPAN_S)), list(decode(tmp_path / "x.pcap"))
    assert len(own) == len(wire) == 3
    encoder_deg = (
        0.02 if emulator.scenario.sensor.preset == "unit" else 0.0
    )  # of readings that are not on the wire
    assert (
        sum(len(scan.ring) for scan in wire) == pytest.approx(recorded.returns * 0.3 / SPAN_S, rel=0.01)
        or mode == "dual"
    )
    for one, other in zip(own, wire, strict=True):
        for name in ("ring", "reflectivity", "is_last"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        late_ns = one.t_ns - other.t_ns
        assert -300 <= late_ns.min() <= late_ns.max() < 1_000  # a locked clock errs by 0.3 ppm in a second
        assert abs(one.start_ns - other.start_ns) < 1_000
        turned_deg = off_deg(one.azimuth_deg, other.azimuth_deg)
        assert -0.002 - encoder_deg < turned_deg.min() <= turned_deg.max() < 0.012 + encoder_deg
        assert np.abs(one.distance_m - other.distance_m).max() <= DISTANCE_LSB_M / 2 + 1e-5
        reach_m = DISTANCE_LSB_M / 2 + np.radians(0.012 + encoder_deg) * one.distance_m + 1e-5
        assert (np.linalg.norm(one.xyz_m - other.xyz_m, axis=1) < reach_m).all()
    assert all((scan.world_T_sensor, scan.labels) == (None, None) for scan in wire)


def test_in_dual_return_each_echo_is_there_once(hall):
    """Pulses with two echoes have two points, the last one first; a lone echo is one point, the last."""
    scan = next(
        Emulator("static_bench", {"sensor.return_mode": "dual", "beam.model": "fixed"}, threads=1).scans(
            duration_s=0.11
        )
    )
    pulses, first, count = np.unique(scan.t_ns, return_index=True, return_counts=True)
    assert set(count) == {1, 2}
    assert scan.is_last[first].sum() > 0.99 * len(pulses)
    twice = first[count == 2]
    assert (scan.distance_m[twice] != scan.distance_m[twice + 1]).all()
    assert not scan.is_last[twice + 1].any()


def test_poses_take_points_to_the_world(tmp_path):
    """On a walk each point, put by the pose of its own instant, is where `write_points` has it; the scan's
    is that of its start."""
    emulator = Emulator("birch_walk", THIN, threads=1)
    scan = next(emulator.scans(start_s=2.0, duration_s=0.25))
    np.testing.assert_array_equal(scan.world_T_sensor, emulator.world_T_sensor(np.array([scan.start_ns]))[0])
    T = emulator.world_T_sensor(scan.t_ns)
    assert 0.05 < np.linalg.norm(T[-1, :3, 3] - scan.world_T_sensor[:3, 3]) < 0.5
    write_points(emulator, tmp_path / "x.npz", start_s=2.0, duration_s=0.25)
    with np.load(tmp_path / "x.npz") as points:
        same = np.isin(points["t_ns"], scan.t_ns)
        world_m = np.einsum("nij,nj->ni", T[:, :3, :3], scan.xyz_m) + T[:, :3, 3]
        np.testing.assert_allclose(world_m, points["world_m"][same], atol=1e-5)


def test_spans_that_begin_anywhere_give_the_same_scans(each_unit):
    """The scans of a later span are those of the whole run."""
    emulator = Emulator(each_unit, {"sensor.rpm": 1200}, threads=1)
    whole, later = list(emulator.scans(duration_s=0.3)), list(emulator.scans(start_s=0.12, duration_s=0.18))
    assert len(later) >= 2
    for one, other in zip(whole[-len(later) :], later, strict=True):
        np.testing.assert_array_equal(one.t_ns, other.t_ns)
        np.testing.assert_array_equal(one.xyz_m, other.xyz_m)


def test_a_free_sensor_has_scans_of_its_own_table():
    """A sensor without packets has scans of all its beams."""
    scan = next(Emulator("static_bench", FREE, threads=1).scans(duration_s=0.11))
    assert set(scan.ring) == {0, 1, 2, 3}
    assert len(scan.ring) == 4 * 180


def test_chunks_leave_no_trace(each_unit, tmp_path, monkeypatch):
    """Read packet by packet the scans are those of the file read at once."""
    Emulator(each_unit, {"sensor.rpm": 1200}, threads=1).record(tmp_path / "x.pcap", duration_s=0.16)
    whole = list(decode(tmp_path / "x.pcap"))
    monkeypatch.setattr("vlp16emu.captures.reading._CHUNK", 3)
    for one, other in zip(whole, decode(tmp_path / "x.pcap"), strict=True):
        np.testing.assert_array_equal(one.xyz_m, other.xyz_m)
        np.testing.assert_array_equal(one.t_ns, other.t_ns)


def chunk(azimuth_deg):
    """Make a chunk with a point for each reading."""
    number = np.arange(len(azimuth_deg))
    names = "t_ns", "xyz_m", "distance_m", "azimuth_deg", "ring", "reflectivity", "is_last"
    return Chunk(number, np.array(azimuth_deg), number, dict.fromkeys(names, np.array(azimuth_deg)))


def test_a_noisy_reading_at_zero_begins_one_scan():
    """Where the reading falls back over 0 by its noise, one revolution ends there and none has a single
    reading."""
    turn = np.arange(0.2, 360.0, 0.4)
    noisy = np.concatenate([turn, [0.002, 359.999, 0.4], turn[1:], [0.1, 0.5]])
    scans = list(cut_scans([chunk(noisy)]))
    assert [len(scan.t_ns) for scan in scans] == [len(turn), len(turn) + 2]


def test_errors_come_before_the_first_scan(hall, tmp_path):
    """A span beyond the walk, a unit that is not there and a file that is none are refused when asked for."""
    with pytest.raises(InputError, match=r"unit: found 2; expected 1"):
        hall().scans(unit=2)
    with pytest.raises(InputError, match=r"start_s: found 11; expected less than the scene's 10 s"):
        hall().scans(start_s=11.0)
    (tmp_path / "x.pcap").write_bytes(b"no capture")
    for path in (tmp_path / "x.pcap", tmp_path / "absent.pcap"):
        with pytest.raises(CaptureError):
            decode(path)


def test_scans_before_a_broken_packet_come_first(hall, tmp_path):
    """A packet at fault is raised after the scans before it."""
    path = tmp_path / "x.pcap"
    hall(rpm=1200).record(path, duration_s=0.2)
    content = bytearray(path.read_bytes())
    content[-1] = 0x21
    path.write_bytes(content)
    scans = decode(path)
    assert len(next(scans).t_ns) > 10_000
    with pytest.raises(PacketError, match="product: 0x21"):
        list(scans)


def test_a_scene_may_be_a_name_a_file_a_dictionary_or_a_scenario(tmp_path):
    """All of them with the same settings are the same scene; the dictionary stays as it was."""
    import tomllib

    from vlp16emu.scenario import find

    text = find("static_bench").read_text(encoding="utf-8")
    (tmp_path / "own.toml").write_text(text)
    tables, settings = tomllib.loads(text), {"sensor.rpm": 1200, "seed": 7}
    scenes = ["static_bench", tmp_path / "own.toml", tables, Emulator("static_bench").scenario]
    scenarios = [Emulator(scene, settings).scenario for scene in scenes]
    assert all(isinstance(scenario, Scenario) for scenario in scenarios)
    assert scenarios[1:] == scenarios[:-1]
    assert (scenarios[0].sensor.rpm, scenarios[0].seed) == (1200, 7)
    assert tables == tomllib.loads(text)
