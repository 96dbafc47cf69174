"""Conditions as in the field: what a real walk is harder by, and that the ground truth knows all of it."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vlp16emu import Emulator, load, write_truth
from vlp16emu.extras.truth.truth import given_mount
from vlp16emu.extras.walk.gait import Trunk
from vlp16emu.extras.walk.settings import Gait, Harness
from vlp16emu.motion.mount import true_mount
from vlp16emu.motion.settings import Mount

HALL = {
    "schema": 1,
    "seed": 3,
    "beam": {"model": "none"},
    "motion": {"kind": "walk", "way_points_m": [[-12, -1], [0, 1], [12, 0]]},
    "world": {"kind": "hall", "length_m": 40.0, "width_m": 16.0, "height_m": 6.0},
}
TOOLS = Path(__file__).resolve().parents[1] / "tools"
FIELD = HALL | {"conditions": "field"}
COMPANION, PASSER = 0xFFFFFFF0, 0xFFFFFFF1


@pytest.fixture(scope="module")
def field():
    """A walk in the hall, as in the field; somebody passes in its first ten seconds."""
    return Emulator(FIELD, {"people.passes_every_s": 10.0})


def test_keys_of_the_field_are_those_that_are_not_given():
    """What the scene says stays; what it does not say is that of the field; without the word all is
    perfect."""
    field = load(
        FIELD, {"imu.preset": "tactical", "motion.mast.bending_hz": 5.0, "motion.mount.error_mm": 1.0}
    )
    assert (field.imu.preset, field.imu.mount.error_deg) == ("tactical", 0.3)
    assert (field.motion.mast.bending_hz, field.motion.mast.damping_ratio) == (5.0, 0.05)
    assert (field.motion.mount.error_mm, field.motion.mount.error_deg) == (1.0, 0.3)
    assert set(field.motion.harness.frequency_hz) == {4.0}
    assert load(FIELD, ["imu.delay_s=[0,0]", "motion.harness.yaw_hz=9"]).imu.delay_s == (0.0, 0.0)
    assert field.wind is None  # in a hall
    assert load("birch_walk", ["conditions=field"]).wind.speed_m_s == 2.0
    assert (field.motion.gait.preset, field.motion.gait.variation) == ("uneven", 0.082)
    given = load(FIELD, ["motion.gait=paper"]).motion.gait
    assert (given.preset, given.variation) == ("paper", 0.0)
    perfect = load(HALL)
    assert (perfect.imu, perfect.motion.mast, perfect.people) == (None, None, None)
    assert load(field) == field
    assert load(json.loads(field.model_dump_json(by_alias=True, exclude_none=True))) == field


def test_true_mounts_differ_as_far_as_they_shall():
    """Over 400 seeds the true mount is turned by 0.3 degrees and moved by 5 mm about each axis, one sigma;
    devices differ."""
    given = Mount(yaw_deg=30.0, lever_arm_m=(0.0, 0.1, 0.2), error_deg=0.3, error_mm=5.0)
    true = [true_mount(given, seed, 0) for seed in range(400)]
    turned = np.array([[one.yaw_deg - 30.0, one.pitch_deg, one.roll_deg] for one in true])
    moved_m = np.array([one.lever_arm_m for one in true]) - [0.0, 0.1, 0.2]
    assert turned.std(axis=0) == pytest.approx(0.3, rel=0.12)
    assert moved_m.std(axis=0) == pytest.approx(0.005, rel=0.12)
    assert true_mount(given, 1, 0) != true_mount(given, 1, 1)


def test_truth_has_the_true_extrinsics_and_what_users_are_given(field, tmp_path):
    """`rig.json` has both, the trajectory is that of the true mount, and stamps of the inertial unit are
    beside true times."""
    write_truth(field, tmp_path / "truth", duration_s=1.0)
    rig = json.loads((tmp_path / "truth" / "rig.json").read_text())
    for device, key in ((rig["units"][0], "body_T_sensor"), (rig["imu"], "body_T_imu")):
        np.testing.assert_array_equal(given_mount(device, key), np.eye(4))
        off = given_mount(device, key, true=True)
        assert 0.05 < np.degrees(Rotation.from_matrix(off[:3, :3]).magnitude()) < 1.5
        assert 0.001 < np.linalg.norm(off[:3, 3]) < 0.02
    table = np.genfromtxt(tmp_path / "truth" / "imu.csv", delimiter=",", names=True)
    late_s = table["stamp_utc_s"] - table["t_utc_s"]
    assert late_s.min() > 0.0159
    assert late_s.max() < 0.0241
    assert late_s.mean() == pytest.approx(0.020, abs=0.0021)


def test_readings_are_late_scaled_and_warm_up(field):
    """Stamps rise, 16 to 24 ms late; readings are a matrix near the identity times the truth, plus a bias
    that drifts as it warms up."""
    imu = field.parts.imu
    read = imu.read(0, 4000)
    late_ms = (read.stamp_ns - read.t_ns) / 1e6
    assert 16.0 <= late_ms.min() < late_ms.max() <= 24.0
    assert np.ptp(late_ms) == pytest.approx(4.0, abs=0.1)
    assert (np.diff(read.stamp_ns) > 0).all()
    for true, found, bias in (
        (read.true_angular_rate_rad_s, read.angular_rate_rad_s, read.gyro_bias_rad_s),
        (read.true_specific_force_m_s2, read.specific_force_m_s2, read.accel_bias_m_s2),
    ):
        response = np.linalg.lstsq(true, found - bias, rcond=None)[0].T
        assert 0.001 < np.abs(response - np.eye(3)).max() < 0.025
    drift = imu.read(240_000, 1).accel_bias_m_s2 - imu.read(0, 1).accel_bias_m_s2
    walk = 1.5e-4 * np.sqrt(1200.0)
    assert np.abs(drift).max() > 0.003
    assert np.abs(drift).max() < 4 * (0.02 + walk)
    part = imu.read(1500, 7)
    np.testing.assert_array_equal(part.stamp_ns, read.stamp_ns[1500:1507])
    np.testing.assert_array_equal(part.specific_force_m_s2, read.specific_force_m_s2[1500:1507])


def test_a_walk_in_the_field_has_no_flight(field):
    """A walking person always has a foot on the ground, so that the pack never falls freely, and is pushed by
    less than 1 g beside its weight; `motion.gait = "strong"` pushes it by more than that."""
    strong = Emulator(HALL, {"imu.preset": "ideal", "motion.gait": "strong"}).parts.imu
    (peak, beyond) = (
        np.abs(np.linalg.norm(imu.read(0, 4000).true_specific_force_m_s2, axis=1) - 9.81).max()
        for imu in (field.parts.imu, strong)
    )
    assert 4.0 < peak < 9.81 < beyond


@pytest.mark.parametrize("clock_ppm", [10_000.0, -10_000.0, 40.0])
def test_the_clock_of_the_inertial_unit_drifts(clock_ppm):
    """A fit of stamps on true times has the slope of the clock, from the first sample on; readings are those
    of the same instants, and a unit that is also late is late by as much as without the drift."""
    late = {"imu.preset": "field", "seed": 3}
    drift, steady = (
        Emulator(HALL, late | {"imu.clock_ppm": ppm}).parts.imu.read(0, 2001) for ppm in (clock_ppm, 0.0)
    )
    elapsed_s = (drift.t_ns - drift.t_ns[0]) * 1e-9
    gained_us = (drift.stamp_ns - steady.stamp_ns) / 1e3
    assert np.polyfit(elapsed_s, gained_us, 1) == pytest.approx([clock_ppm, 0.0], abs=1e-3)
    assert gained_us[0] == 0.0
    assert gained_us[-1] == pytest.approx(10.0 * clock_ppm, abs=1e-3)
    assert (np.diff(drift.stamp_ns) > 0).all()
    np.testing.assert_array_equal(drift.specific_force_m_s2, steady.specific_force_m_s2)
    np.testing.assert_array_equal(drift.angular_rate_rad_s, steady.angular_rate_rad_s)


def test_a_drift_of_the_clock_is_in_the_ground_truth(tmp_path):
    """`imu.csv` has stamps beside true times, 1 % apart per second, where only the clock drifts."""
    write_truth(Emulator(HALL, {"imu.clock_ppm": 10_000.0}), tmp_path / "truth", duration_s=2.0)
    table = np.genfromtxt(tmp_path / "truth" / "imu.csv", delimiter=",", names=True)
    elapsed_s = table["t_utc_s"] - table["t_utc_s"][0]
    gained_s = table["stamp_utc_s"] - table["t_utc_s"]
    np.testing.assert_allclose(gained_s, 0.01 * elapsed_s, atol=2e-6)


def test_steps_vary_as_on_uneven_ground():
    """Times of steps of the gait `uneven` vary by 8.2 % and those of the default by 4.0 %, as step times of
    young adults on uneven and flat ground (Downey et al., PLOS ONE 17, e0278646); the trunk rises as far."""
    spread, rise_m = {}, {}
    for preset in ("natural", "uneven"):
        height_m = np.concatenate([_heights_m(preset, seed) for seed in range(3)])
        peaks = [np.flatnonzero((z[1:-1] > z[:-2]) & (z[1:-1] >= z[2:])) for z in height_m]
        steps = np.concatenate([np.diff(each) for each in peaks])
        spread[preset] = steps.std() / steps.mean()
        rise_m[preset] = height_m.std()
    assert spread["natural"] == pytest.approx(0.040, rel=0.25)
    assert spread["uneven"] == pytest.approx(0.082, rel=0.25)
    assert rise_m["uneven"] == pytest.approx(rise_m["natural"], rel=0.05)


def _heights_m(preset, seed):
    """Rise (1, n) of the trunk in 300 s of walking, every 5 ms, with one harmonic."""
    plain = {"second_harmonic_m": 0.0, "heel_strike_m": 0.0}
    trunk = Trunk(Gait(preset=preset, **plain), 1.2, seed)
    elapsed_s = np.arange(0.0, 300.0, 0.005)
    return trunk.at(elapsed_s, np.ones(len(elapsed_s)))[None, :, 2]


def test_the_mast_leans_with_each_step(field):
    """Sensors lean on the pack by tenths of a degree at the rate of steps, are rigid on a stiff mast, and
    have derivatives of their own."""
    carrier, start_ns = field.parts.carrier, field.scenario.start_ns
    t_ns = start_ns + np.arange(4_000_000_000, 9_000_000_000, 5_000_000)
    pack, top = carrier.poses_at(t_ns), carrier.mast_top(field.scenario.motion.mast).poses_at(t_ns)
    lean = Rotation.from_matrix(pack.world_R_body).inv() * Rotation.from_matrix(top.world_R_body)
    lean_deg = np.degrees(lean.as_rotvec())
    assert 0.05 < np.abs(lean_deg).max() < 0.5
    spectrum = np.abs(np.fft.rfft(lean_deg[:, 1] - lean_deg[:, 1].mean()))
    assert np.fft.rfftfreq(len(t_ns), 0.005)[spectrum.argmax()] == pytest.approx(
        1.85, abs=0.3
    )  # steps per second
    axes = ("fore_aft", "sideways", "vertical", "roll", "pitch", "yaw")
    stiff = carrier.mast_top(Harness(**{f"{axis}_hz": 1e6 for axis in axes}))
    np.testing.assert_allclose(stiff.poses_at(t_ns).world_p_body_m, pack.world_p_body_m, atol=1e-8)
    moving, step_ns = carrier.mast_top(field.scenario.motion.mast), 1_000_000
    before, after = (moving.poses_at(t_ns[:50] + d).world_p_body_m for d in (-step_ns, step_ns))
    np.testing.assert_allclose(
        moving.kinematics_at(t_ns[:50]).world_v_body_m_s, (after - before) / 2e-3, atol=2e-3
    )


@pytest.fixture(scope="module")
def scans(field):
    """Five seconds of revolutions with labels."""
    return list(field.scans(duration_s=5.0, truth=True))


def test_people_stand_in_the_way(field, scans):
    """Points of people lie on their cylinders: the companion behind the carrier in each scan, the other
    one in some."""
    for instance, least in ((COMPANION, 45), (PASSER, 5)):
        seen = [scan for scan in scans if (scan.labels.instance == instance).sum() > 3]
        assert len(seen) >= least
        for scan in seen[::10]:
            mine = scan.labels.instance == instance
            poses = field.world_T_sensor(scan.t_ns[mine])
            sensor_m = scan.xyz_m[mine] / scan.distance_m[mine][:, None] * scan.labels.range_m[mine][:, None]
            world_m = np.einsum("nij,nj->ni", poses[:, :3, :3], sensor_m) + poses[:, :3, 3]
            assert world_m[:, 2].max() <= 1.75
            assert np.ptp(world_m[:, :2], axis=0).max() < 0.9  # 0.5 m of shoulders, and 0.1 s of walking
            assert set(scan.labels.semantic[mine].tolist()) == {7}
    behind = scans[40].xyz_m[scans[40].labels.instance == COMPANION]
    assert np.abs(np.degrees(np.arctan2(behind[:, 1], -behind[:, 0]))).max() < 25  # a sector, straight behind
    assert np.hypot(behind[:, 0], behind[:, 1]).min() == pytest.approx(1.5 - 0.25, abs=0.15)


def test_bytes_are_those_of_seed_and_scene(field):
    """Packets of a walk in the field are the same on one thread and on three, and in parts; another seed
    has others."""
    whole = [
        packet.payload
        for packet in Emulator(FIELD, {"people.passes_every_s": 10.0}, threads=3).packets(4.0, 4.4)
    ]
    assert [packet.payload for packet in field.packets(4.0, 4.4)] == whole
    parts = [packet.payload for span in ((4.0, 4.2), (4.2, 4.4)) for packet in field.packets(*span)]
    assert parts == whole
    assert [packet.payload for packet in Emulator(FIELD, {"seed": 4}).packets(4.0, 4.4)] != whole


def test_factors_of_the_field_are_scenes(tool_named, monkeypatch):
    """Each factor of `tools/field_factors` is a change that a scene takes, with the source of its strength;
    those of the inertial unit change nothing else, so the pulses of the walk without them serve them too."""
    monkeypatch.syspath_prepend(str(TOOLS))
    given = tool_named("odometry.py").SETTINGS
    perfect = load("reference_forest", given)
    for factor in tool_named("field_factors").FACTORS:
        changed = load("reference_forest", [*given, *factor.settings])
        assert (changed != perfect) == bool(factor.settings), factor.name
        assert bool(factor.source) == bool(factor.settings), factor.name
        if factor.is_inertial:
            assert changed.model_copy(update={"imu": perfect.imu}) == perfect, factor.name
