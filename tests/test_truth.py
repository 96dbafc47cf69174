"""What is written beside a run."""

import itertools
import json
import math
import re
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import velodyne_decoder
from listening import parse_rmc
from scipy.spatial.transform import Rotation, Slerp

from vlp16emu import Emulator
from vlp16emu.cli.app import run
from vlp16emu.errors import ScenarioError
from vlp16emu.extras.clouds.scan import decode
from vlp16emu.extras.truth.tables import FIXES, POSES, inertial_table
from vlp16emu.extras.truth.truth import Truth, _scenario_tree, write_truth
from vlp16emu.motion.gnss import to_geodetic
from vlp16emu.output import write_json
from vlp16emu.packets import decode_position
from vlp16emu.run.options import TruthTo
from vlp16emu.scenario import load, scene_files
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import HOUR_NS, S_NS

pytestmark = pytest.mark.usefixtures("kept_woods")


@pytest.fixture(scope="module")
def walk(each_unit):
    """An emulator of a walk in a world that is quickly built."""
    settings = [
        'motion={kind="walk", way_points_m=[[-10, 0], [0, 3], [10, 0]]}',
        "gps.connected=true",
        "gps.canopy_half_cover=0.5",
        "start_utc=2026-05-20T09:00:00.25Z",
        "beam.model=none",
    ]
    return Emulator(load(each_unit, settings))


def written(emulator, folder, start_s=0.0, stop_s=2.0, *, rate_hz=200, per_packet=False, most=None):
    """Run, and give the packets and the folder."""
    with Truth(TruthTo(folder, rate_hz, per_packet), emulator, (start_s, stop_s)) as truth:
        return list(itertools.islice(truth.beside(emulator.packets(start_s, stop_s)), most))


def tum(path):
    """Times in whole nanoseconds and the other seven columns."""
    rows = [line.split() for line in path.read_text().splitlines() if not line.startswith("#")]
    t_ns = [int(row[0].replace(".", "")) for row in rows]
    return np.array(t_ns), np.array([[float(word) for word in row[1:]] for row in rows])


def test_the_trajectory_is_that_of_the_sensor(walk, tmp_path):
    """Rows from before the first firing until after the last packet, on the pose at each time; each data
    packet has its own.

    At a rate whose period is no whole nanosecond sample i still lies i / rate after the first pulse.
    """
    packets = written(walk, tmp_path, 0.5, 2.0, rate_hz=300, per_packet=True)
    t_ns, poses = tum(tmp_path / "trajectory.tum")
    start_ns = walk.scenario.start_ns
    first = -(-(t_ns[0] - start_ns) * 300 // S_NS)
    assert (t_ns - start_ns == np.arange(first, first + len(t_ns)) * S_NS // 300).all()
    assert start_ns + S_NS // 2 - 10_000_000 < t_ns[0] <= start_ns + S_NS // 2 - 1_327_104
    assert 0 <= t_ns[-1] - packets[-1].due_ns < 10_000_000
    true = walk.parts.motion.poses_at(t_ns)
    np.testing.assert_allclose(poses[:, :3], true.world_p_body_m, rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        Rotation.from_quat(poses[:, 3:]).as_matrix(), true.world_R_body, rtol=0, atol=1e-11
    )
    assert (poses[:, 6] >= 0).all()
    t_ns, poses = tum(tmp_path / "packets.tum")
    assert (t_ns == [packet.due_ns - 1_327_104 for packet in packets if packet.kind is PacketKind.DATA]).all()
    np.testing.assert_allclose(poses[:, :3], walk.parts.motion.poses_at(t_ns).world_p_body_m, atol=1e-9)


def test_gnss_rows_are_what_the_sentences_say(walk, tmp_path):
    """Each sentence of the run has its row with the same place and status; the truth in it is the
    antenna's."""
    packets = written(walk, tmp_path, 0.0, 3.0)
    lines = (tmp_path / "gnss.csv").read_text().splitlines()
    rows = [dict(zip(lines[0].split(","), line.split(","), strict=True)) for line in lines[1:]]
    by_second = {int(row["t_utc_s"].split(".")[0]): row for row in rows}
    sentences = {decode_position(p.payload).sentence for p in packets if p.kind is PacketKind.POSITION}
    fixes = [parse_rmc(sentence) for sentence in sentences]
    assert len(fixes) >= 3
    for fix in fixes:
        row = by_second[fix.t_ns // S_NS]
        assert fix.valid == bool(int(row["valid"]))
        assert fix.latitude_deg == pytest.approx(float(row["latitude_deg"]), abs=2e-9)
        assert fix.longitude_deg == pytest.approx(float(row["longitude_deg"]), abs=2e-9)
    gps = walk.scenario.gps
    t_ns = (walk.scenario.start_ns // S_NS + 2) * S_NS
    antenna_m = walk.parts.motion.poses_at(np.array([t_ns])).world_p_body_m + [0, 0, gps.antenna_above_m]
    place = to_geodetic(antenna_m, gps)[0]
    row = by_second[t_ns // S_NS]
    assert [float(row[f"true_{name}"]) for name in ("latitude_deg", "longitude_deg")] == pytest.approx(
        place[:2].tolist(), abs=1e-10
    )
    assert float(row["cover"]) == 1.0  # a hall has a ceiling


def test_the_inertial_unit_is_written_whole(tmp_path):
    """Every sample from the first pulse on stands in imu.csv as the unit reads it, at the unit's own rate."""
    emulator = Emulator(load("static_bench", ["imu.rate_hz=130", "imu.preset=consumer", "beam.model=none"]))
    packets = written(emulator, tmp_path, 0.0, 1.5)
    lines = (tmp_path / "imu.csv").read_text().splitlines()
    axes = "wx_rad_s", "wy_rad_s", "wz_rad_s", "fx_m_s2", "fy_m_s2", "fz_m_s2"
    columns = [f"{kind}{axis}" for kind in ("", "true_", "bias_") for axis in axes]
    assert lines[0].split(",") == ["t_utc_s", *columns]
    rows = np.array([[float(word) for word in line.split(",")[1:]] for line in lines[1:]])
    t_ns = np.array([int(line.split(",")[0].replace(".", "")) for line in lines[1:]])
    read = emulator.parts.imu.read(0, len(rows))
    assert (t_ns == read.t_ns).all()
    assert packets[-1].due_ns - t_ns[-1] < S_NS / 130
    said = np.column_stack([read.angular_rate_rad_s, read.specific_force_m_s2])
    np.testing.assert_allclose(rows[:, :6], said, rtol=0, atol=1e-9)
    np.testing.assert_allclose(rows[:, 6:12], [[0, 0, 0, 0, 0, 9.80665]] * len(rows), rtol=0, atol=1e-9)
    white = rows[:, :6] - rows[:, 6:12] - rows[:, 12:]
    sigma = np.array([2.4e-4] * 3 + [1.2e-3] * 3) * math.sqrt(130)
    np.testing.assert_allclose(white.std(axis=0), sigma, rtol=0.3)
    assert (np.abs(rows[0, 12:]) > 1e-5).all()


def test_the_same_run_in_two_parts_has_the_same_truth(walk, tmp_path):
    """Where two spans overlap their rows are the same, character by character."""
    written(walk, tmp_path / "whole", 0.0, 2.0, per_packet=True)
    written(walk, tmp_path / "part", 1.0, 2.0, per_packet=True)
    for name in ("trajectory.tum", "packets.tum", "gnss.csv"):
        whole, part = ((tmp_path / run / name).read_text() for run in ("whole", "part"))
        assert whole.endswith("\n".join(part.splitlines()[1:]) + "\n"), name
        assert part.count("\n") > 1, name


def test_truth_grows_with_the_run_and_not_in_memory(walk, tmp_path):
    """What is a second old stands in the file; after a minute no more is held than after half a one."""

    def empty():
        for step in range(60 * 10):
            yield Packet(PacketKind.DATA, walk.scenario.start_ns + step * S_NS // 10, b"")

    held = []
    tracemalloc.start()
    try:
        with Truth(TruthTo(tmp_path / "t", 20, per_packet=True), walk, (0.0, 60.0)) as truth:
            (growing,) = tmp_path.glob("t.*.part/trajectory.tum")
            for number, packet in enumerate(truth.beside(empty())):
                if number in {300, 599}:
                    held.append(tracemalloc.get_traced_memory()[0])
                    t_ns, _ = tum(growing)
                    assert packet.due_ns - t_ns[-1] < 1.1 * S_NS
    finally:
        tracemalloc.stop()
    assert held[1] - held[0] < 500_000


@pytest.mark.parametrize("name", scene_files())
def test_the_resolved_scenario_is_a_scene(name, tmp_path):
    """Every scene of ours, written with all its values and read again, is the same scenario."""
    scenario = load(name, ["seed=77", "title=ä"])
    write_json(tmp_path / "scenario.json", _scenario_tree(scenario, (0.0, scenario.duration_s)))
    assert load(str(tmp_path / "scenario.json")) == scenario


@pytest.mark.parametrize("setting", ["world.near_m=7.5", "world.near_m=inf", "motion.run_time_s=120.0"])
def test_what_json_or_a_scene_cannot_have_is_not_written(setting, tmp_path):
    """JSON has no infinite number, and a scene no speed beside its run time; what is written without them
    is read as the same scenario."""
    scenario, path = load("birch_walk", [setting]), tmp_path / "scenario.json"
    path.write_text(json.dumps(_scenario_tree(scenario, (0.0, scenario.duration_s)), allow_nan=False))
    assert load(str(path)) == scenario
    assert load(str(path), ["world.near_m=inf"]).world.near_m == math.inf


def test_the_resolved_scenario_names_its_program_and_takes_settings(walk, tmp_path):
    """Version, seed and defaults that nobody wrote stand in it; what --set gives wins over it, also a
    date, which JSON does not have."""
    written(walk, tmp_path, stop_s=0.05)
    tree = json.loads((tmp_path / "scenario.json").read_text())
    assert tree["written_by"].startswith("vlp16emu ")
    assert tree["seed"] == walk.scenario.seed
    assert tree["gps"]["wander_s"] == 300.0
    settings = ["sensor.rpm=1200", "start_utc=2026-05-20T10:00:00.5+01:00"]
    scenario = load(str(tmp_path / "scenario.json"), settings)
    assert (scenario.sensor.rpm, scenario.start_ns) == (1200, 1_779_267_600_500_000_000)


def test_texts_are_those_of_the_tables(tmp_path):
    """Each table has the rows of its text, for all units, with attitude and stamps; velocities are those
    of the motion, in the sensor's axes."""
    settings = {
        "motion": {"kind": "walk", "way_points_m": [[-8, 0], [4, 0]], "mount": {"yaw_deg": 40.0}},
        "imu": {"preset": "consumer", "attitude": True, "jitter_s": 0.001},
        "gps.connected": True,
        "rig": [{"mount": {"lever_arm_m": [0.0, 0.0, 1.0]}}],
        "duration_s": 2.0,
    }
    emulator = Emulator("static_bench", settings)
    write_truth(emulator, TruthTo(tmp_path / "t", per_packet=True), start_s=1.0, duration_s=0.2)
    tables = dict.fromkeys(("trajectory", "trajectory_2", "packets", "packets_2"), POSES)
    tables |= {"imu": inertial_table(emulator.scenario.imu), "gnss": FIXES}
    assert {path.stem for path in (tmp_path / "t").glob("*.npy")} == set(tables)
    for name, table in tables.items():
        rows = np.load(tmp_path / "t" / f"{name}.npy")
        assert (tmp_path / "t" / f"{name}{table.suffix}").read_text() == table.header + table.text(rows)
        assert len(rows) > 0
    rows = np.load(tmp_path / "t" / "trajectory_2.npy")
    true = emulator.parts.units[1].motion.kinematics_at(rows["t_ns"])
    own_m_s = np.einsum("nji,nj->ni", true.world_R_body, true.world_v_body_m_s)
    assert np.linalg.norm(own_m_s, axis=1).min() > 0.1
    np.testing.assert_allclose(rows["velocity_m_s"], own_m_s, atol=1e-12)
    assert np.array_equal(rows["rate_rad_s"], true.body_w_rad_s)


def test_a_sensor_without_packets_has_truth(tmp_path):
    """A free sensor has trajectory, rig and scenario; poses of packets, which it has not, are refused
    before any file."""
    emulator = Emulator(load("static_bench", ["sensor.model=free", "sensor.beams=32"]))
    write_truth(emulator, tmp_path / "t", duration_s=0.5)
    t_ns, _ = tum(tmp_path / "t" / "trajectory.tum")
    assert len(t_ns) in {101, 102}
    assert json.loads((tmp_path / "t" / "rig.json").read_text())["units"][0]["model"] == "free"
    assert not (tmp_path / "t" / "events.csv").exists()  # without events
    with pytest.raises(ScenarioError, match=r'found "free", which has no packets'):
        write_truth(emulator, TruthTo(tmp_path / "no", per_packet=True), duration_s=0.5)
    assert not (tmp_path / "no").exists()


def test_a_run_that_is_left_can_be_repeated(walk, tmp_path):
    """The scenario of a run that is ended early ends behind its last packet, and gives these packets again;
    so do poses, in whole lines.

    The packet that was taken last and not sent, as by a recording that Ctrl-C ends, has no row.
    """
    packets = written(walk, tmp_path, 0.5, 10.0, per_packet=True, most=300)
    assert len(tum(tmp_path / "packets.tum")[0]) == sum(
        packet.kind is PacketKind.DATA for packet in packets[:-1]
    )
    t_ns, _ = tum(tmp_path / "trajectory.tum")
    assert packets[-1].due_ns <= t_ns[-1] < packets[-1].due_ns + 10_000_000
    assert (tmp_path / "trajectory.tum").read_text().endswith("\n")
    tree = json.loads((tmp_path / "scenario.json").read_text())
    assert tree["written_by"].endswith(", --start 0.5")
    again = Emulator(load(str(tmp_path / "scenario.json")))
    assert list(again.packets(0.5)) == packets[:-1]  # the last was taken and not sent


OUTPUTS = (Path(__file__).resolve().parents[1] / "scenes" / "OUTPUTS.md").read_text(encoding="utf-8")
EXACT = ("sensor.eccentricity_deg=0.0", "sensor.azimuth_noise_deg=0.0")


def command_points(capture, *options):
    """Times since the start of the hour and points, as `vlp16emu decode` writes them."""
    out = capture.with_suffix(".npz")
    assert run(["decode", str(capture), "--out", str(out), *options]) == 0
    points = np.load(out)
    return points["clock_ns"], points["xyz_m"]


def python_points(capture, frame):
    """Times UTC and points of all whole scans."""
    scans = list(decode(capture, frame=frame))
    return np.concatenate([s.t_ns for s in scans]), np.concatenate([s.xyz_m for s in scans])


def velodyne_decoder_points(capture):
    """Times past the full hour and points of all scans of velodyne-decoder."""
    scans = list(velodyne_decoder.read_pcap(str(capture), as_pcl_structs=True))
    t_ns = [np.round(stamp.device % 3600 * 1e6) * 1e3 + np.rint(p["time"] * 1e9) for stamp, p in scans]
    xyz_m = [np.stack([p[axis] for axis in "xyz"], axis=1) for _, p in scans]
    return np.concatenate(t_ns).astype(np.int64), np.concatenate(xyz_m)


READERS = {
    "`vlp16emu decode`": command_points,
    "`vlp16emu decode --frame manual`": lambda capture: command_points(capture, "--frame", "manual"),
    "`decode(path)` in Python": lambda capture: python_points(capture, "sensor"),
    '`decode(path, frame="manual")` in Python': lambda capture: python_points(capture, "manual"),
    "velodyne-decoder 3.1": velodyne_decoder_points,
}


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """A walk in the hall without errors of the sensor: its capture, times and places of all echoes, and
    its trajectory."""
    folder = tmp_path_factory.mktemp("seen")
    motion = '{kind="walk", way_points_m=[[-4, -1], [-1, 0], [3, 4]]}'
    settings = [f"motion={motion}", "noise.preset=ideal", "beam.model=none", *EXACT]
    walk = Emulator(load("static_bench", [*settings, "gps.connected=true"]))
    walk.record(folder / "walk.pcap", duration_s=0.5, truth=TruthTo(folder / "truth", 2000))
    blocks = list(walk.returns(0.0, 0.5))
    origin_m, along, t_ns = (
        np.concatenate([getattr(r.firings, name).reshape(-1, *shape) for r in blocks])
        for name, shape in (("origin_m", (3,)), ("direction", (3,)), ("t_ns", ()))
    )
    distance_m = np.concatenate([r.distance_m[..., 0].ravel() for r in blocks])
    met = distance_m > 0
    return folder, t_ns[met], (origin_m + along * distance_m[:, None])[met]


@pytest.mark.parametrize("reader", READERS)
def test_poses_take_points_of_each_reader_into_the_world_as_documented(seen, reader):
    """By the formula of `scenes/OUTPUTS.md` with the pose of `trajectory.tum` points are where light met
    something, to the error there."""
    folder, true_ns, true_m = seen
    row = next(line.split(" | ") for line in OUTPUTS.splitlines() if line.startswith(f"| {reader} | "))
    formula, most_mm = row[2].strip("`"), float(row[3].removesuffix(" mm |"))
    past_ns, xyz_m = READERS[reader](folder / "walk.pcap")
    pulse_ns = true_ns[0] // HOUR_NS * HOUR_NS + past_ns % HOUR_NS
    t_ns, poses = tum(folder / "truth" / "trajectory.tum")
    at_s, of_s = (pulse_ns - t_ns[0]) / 1e9, (t_ns - t_ns[0]) / 1e9
    turns = Slerp(of_s, Rotation.from_quat(poses[:, 3:]))(at_s)
    places_m = np.column_stack([np.interp(at_s, of_s, poses[:, axis]) for axis in range(3)])
    x, y, z = xyz_m.T
    rotated = re.fullmatch(r"R @ \((-?[xyz]), (-?[xyz]), z\) \+ t", formula)
    axes = {"x": x, "y": y, "-x": -x, "-y": -y}
    world_m = turns.apply(np.column_stack([axes[rotated[1]], axes[rotated[2]], z])) + places_m
    # Stamps are cut off to whole microseconds; pulses are 2.304 us apart.
    pulse = np.searchsorted(true_ns, pulse_ns - 300)
    assert np.abs(true_ns[pulse] - pulse_ns).max() < 1_500
    gap_mm = 1000 * np.linalg.norm(world_m - true_m[pulse], axis=1)
    assert len(gap_mm) > 100_000
    assert 0.7 * most_mm < gap_mm.max() <= most_mm


def test_frames_turn_points_and_nothing_else(seen):
    """The manual's frame is the sensor's turned: x right for -y, y forward for x; and `rig.json` has that
    turn."""
    folder, _, _ = seen
    ours, manual = (next(decode(folder / "walk.pcap", frame=frame)) for frame in ("sensor", "manual"))
    x, y, z = ours.xyz_m.T
    np.testing.assert_array_equal(manual.xyz_m, np.column_stack([-y, x, z]))
    rig = json.loads((folder / "truth" / "rig.json").read_text())["manual"]["sensor_T_manual"]
    R = np.array(rig["matrix"])[:3, :3]
    np.testing.assert_array_equal(manual.xyz_m @ R.T, ours.xyz_m)
    np.testing.assert_allclose(Rotation.from_quat(rig["quaternion_xyzw"]).as_matrix(), R, atol=1e-15)
