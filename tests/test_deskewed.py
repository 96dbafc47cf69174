"""Captures put into the world by `vlp16emu points` with a trajectory, and their labels from the truth
behind each record."""

from threading import Event

import dpkt
import numpy as np
import pytest
from woods import THIN

from vlp16emu import Emulator
from vlp16emu.cli.app import run
from vlp16emu.errors import InputError
from vlp16emu.extras.clouds.deskew import Trajectory, write_deskewed
from vlp16emu.extras.clouds.points import write_points
from vlp16emu.extras.options import TrajectoryErrors
from vlp16emu.extras.recorded.files import read_tum
from vlp16emu.packets import DATA_BYTES, DISTANCE_LSB_M
from vlp16emu.run.options import TruthTo

pytest.importorskip("pyarrow", reason="pyarrow is in the extra data")

pytestmark = pytest.mark.usefixtures("kept_woods")

SETTINGS = THIN | {
    "sensor.return_mode": "dual",
    "beam.model": "fixed",
    "beam.rays": 8,
    # So that the places on the wire are those of the pulses, and the echoes of one pulse keep their order.
    "sensor.preset": "steady",
    "sensor.eccentricity_deg": 0.0,
    "sensor.azimuth_noise_deg": 0.0,
    "noise.preset": "ideal",
    "capture.preset": "ideal",
}
LABELS = ("semantic", "part", "leaf_wood", "instance", "species", "label", "tree_id")


def points(*words):
    """Run `vlp16emu points` with these words, the second of them the file, and read that; its name ends in
    .npz."""
    assert run(["points", *map(str, words)]) == 0
    with np.load(words[1]) as arrays:
        return dict(arrays)


def deskewed(capture, trajectory, out, unit=1, truth=None, **errors):
    """Arrays of a capture's points in the world, and the report."""
    way = Trajectory(trajectory, unit, TrajectoryErrors(**errors))
    report = write_deskewed(capture, out, way, truth, stop=Event())
    with np.load(out) as arrays:
        return dict(arrays), report


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    """Folder with walk.pcap of 0.3 s and its truth, in more than one row group; the emulator; and labelled
    points of the scene itself."""
    folder, emulator = tmp_path_factory.mktemp("walk"), Emulator("birch_walk", SETTINGS)
    to = TruthTo(folder / "truth", per_return=True)
    emulator.record(folder / "walk.pcap", duration_s=0.3, truth=to)
    write_points(emulator, folder / "own.npz", duration_s=0.3, truth=True, labels="for-instance")
    with np.load(folder / "own.npz") as own:
        return folder, emulator, dict(own)


@pytest.fixture(scope="module")
def true(walk):
    """Points of the capture by the true trajectory."""
    folder, _, _ = walk
    return deskewed(folder / "walk.pcap", folder / "truth", folder / "true.npz")


def test_the_true_trajectory_gives_the_points_of_the_scene(walk, true):
    """Every echo is there once, at its own time, where `points` of the scene has it but for the steps of
    the wire."""
    _, _, own = walk
    points, report = true
    assert report["without_pose"] == 0
    assert report["points"] == len(points["t_ns"]) > 18_000
    # The first packet has begun before the span, and at its end the last one is not full.
    inside = points["t_ns"] > own["t_ns"][0] - 1_100
    held = own["t_ns"] < points["t_ns"][-1] + 1_100
    order, own_order = (
        np.lexsort((of["distance_m"][which], of["laser"][which], of["t_ns"][which]))
        for of, which in ((points, inside), (own, held))
    )
    points = {name: array[inside][order] for name, array in points.items()}
    own = {name: array[held][own_order] for name, array in own.items()}
    late_ns = own["t_ns"] - points["t_ns"]
    assert 0 <= late_ns.min() <= late_ns.max() < 1_100  # whole microseconds, cut off
    gap_m = np.linalg.norm(own["world_m"] - points["world_m"], axis=1)
    bound_m = DISTANCE_LSB_M / 2 + np.radians(0.012) * own["distance_m"] + 2e-5
    assert (gap_m < bound_m).all()
    assert gap_m.max() > 0.5 * bound_m.max()  # or the steps would not be seen at all


def test_a_time_offset_takes_later_poses(walk):
    """With 50 ms each pulse has the pose of 50 ms later; pulses that have none there are left out and
    counted."""
    folder, emulator, _ = walk
    late, report = deskewed(folder / "walk.pcap", folder / "truth", folder / "w.npz", time_offset_s=0.05)
    truth = emulator.world_T_sensor(late["t_ns"] + 50_000_000)
    assert np.abs(late["viewpoint_m"] - truth[:, :3, 3]).max() < 1e-5
    assert 0.1 < report["without_pose"] / (report["without_pose"] + report["points"]) < 0.2


@pytest.mark.parametrize(
    ("epoch_s", "clock"),
    [(-315_964_782, "GPS time"), (18, "GPS time since 1970"), (None, "both begin together")],
)
def test_the_clock_of_a_trajectory_is_found(walk, true, tmp_path, epoch_s, clock):
    """With stamps in GPS time, 18 s ahead of UTC since 2017 (IERS Bulletin C), or from zero, `auto` finds the
    offset, and no point moves; as a number the same offset gives the same points."""
    folder, _, _ = walk
    rows = np.loadtxt(folder / "truth" / "trajectory.tum")
    added_s = -rows[0, 0] if epoch_s is None else epoch_s
    rows[:, 0] += added_s
    np.savetxt(tmp_path / "moved.tum", rows, fmt="%.9f")
    capture = folder / "walk.pcap"
    found, report = deskewed(capture, tmp_path / "moved.tum", tmp_path / "a.npz", time_offset_s=None)
    assert report["clock_of_poses"] == clock
    # From zero, the trajectory begins with the run, and the first packet less than a millisecond later.
    assert report["time_offset_s"] == pytest.approx(added_s, abs=2e-3)
    known, _ = true
    assert np.abs(found["world_m"] - known["world_m"][: len(found["t_ns"])]).max() < 5e-3
    given, _ = deskewed(
        capture, tmp_path / "moved.tum", tmp_path / "b.npz", time_offset_s=report["time_offset_s"]
    )
    np.testing.assert_allclose(given["world_m"], found["world_m"], atol=1e-5)


def test_a_wrong_mount_moves_points_in_the_sensor(walk, true):
    """A boresight error of 2 degrees of yaw and a lever arm of 0.1 m move points in the frame of the body."""
    folder, emulator, _ = walk
    mount = 0.1, 0.0, 0.0, 0.0, 0.0, 2.0
    wrong, _ = deskewed(folder / "walk.pcap", folder / "truth", folder / "w.npz", mount=mount)
    points, _ = true
    cos, sin = np.cos(np.radians(2.0)), np.sin(np.radians(2.0))
    x, y, z = points["sensor_m"].astype(float).T
    in_body_m = np.column_stack([cos * x - sin * y + 0.1, sin * x + cos * y, z])
    poses = emulator.world_T_sensor(points["t_ns"])
    expected_m = np.einsum("nij,nj->ni", poses[:, :3, :3], in_body_m) + poses[:, :3, 3]
    np.testing.assert_allclose(wrong["world_m"], expected_m, atol=1e-4)


def test_drift_grows_with_time(walk, true):
    """Drifts of 6 m to the east and of 60 degrees per minute grow with the time since the first pose."""
    folder, _, _ = walk
    wrong, _ = deskewed(folder / "walk.pcap", folder / "truth", folder / "w.npz", drift=(6.0, 0.0, 0.0, 60.0))
    points, _ = true
    first = read_tum(folder / "truth" / "trajectory.tum")
    since_s = (points["t_ns"] - first.t_ns[0]) / 1e9
    angle = np.radians(since_s)  # 60 degrees per minute
    x, y, z = (points["world_m"] - first.position_m[0]).T
    east = np.cos(angle) * x - np.sin(angle) * y + 0.1 * since_s
    north = np.sin(angle) * x + np.cos(angle) * y
    expected_m = np.column_stack([east, north, z]) + first.position_m[0]
    assert np.abs(expected_m - points["world_m"]).max() > 0.05
    np.testing.assert_allclose(wrong["world_m"], expected_m, atol=1e-5)


def test_laz_of_a_capture_has_returns_time_and_place(walk, true):
    """Of a capture too, LAZ has numbered returns, GPS time and the coordinate system of the scene."""
    laspy = pytest.importorskip("laspy")
    folder, _, _ = walk
    points, _ = true
    arguments = ["points", folder / "walk.pcap", folder / "a.laz", "--trajectory", folder / "truth"]
    assert run([str(argument) for argument in arguments]) == 0
    read = laspy.read(folder / "a.laz")
    assert set(np.unique(np.asarray(read.number_of_returns))) == {1, 2}
    assert (np.asarray(read.return_number)[np.asarray(read.number_of_returns) == 1] == 1).all()
    assert read.gps_time[0] == pytest.approx(points["t_ns"][0] / 1e9 - 315_964_800 + 18 - 1e9, abs=3e-7)
    assert "62.24" in read.header.vlrs.get("WktCoordinateSystemVlr")[0].string
    assert set(np.unique(np.asarray(read.user_data))) == {0, 1}


def test_each_unit_of_a_rig_has_its_own_trajectory(tmp_path):
    """Of two sensors in one capture the second's points are found by its address, and placed by its own
    trajectory."""
    rig = [{"mount": {"lever_arm_m": [0.5, 0.0, 0.0], "yaw_deg": 90.0}}]
    emulator = Emulator("static_bench", {"rig": rig, "sensor.max_range_m": 20.0})
    emulator.record(tmp_path / "two.pcap", duration_s=0.1, truth=tmp_path / "truth")
    write_points(emulator, tmp_path / "own.npz", duration_s=0.1, unit=2)
    points, _ = deskewed(tmp_path / "two.pcap", tmp_path / "truth", tmp_path / "b.npz", unit=2)
    with np.load(tmp_path / "own.npz") as own:
        n = len(points["t_ns"])
        gap_m = np.linalg.norm(own["world_m"][:n] - points["world_m"], axis=1)
    assert n > 20_000
    assert gap_m.max() < 0.005
    with pytest.raises(InputError, match="--unit: found 3; expected at most 2"):
        Trajectory(tmp_path / "truth", 3)
    (tmp_path / "rig.json").write_text('{"units": 3}')
    with pytest.raises(InputError, match="world, antenna: missing"):
        Trajectory(tmp_path, 1)


@pytest.fixture(scope="module")
def labelled(walk):
    """Points of the capture with labels."""
    folder, _, _ = walk
    return points(
        folder / "walk.pcap", folder / "a.npz", "--trajectory", folder / "truth", "--labels", "for-instance"
    )


def by_pulse(arrays, count):
    """Arrays of the first points in order of pulse, laser and distance."""
    order = np.lexsort((arrays["distance_m"], arrays["laser"], arrays["t_ns"]))[:count]
    return {name: array[order] for name, array in arrays.items()}


def test_points_have_the_labels_that_the_scene_gives_them(walk, labelled):
    """Every point of the capture, also of the second row group, has the class, part, instance, species and
    tree of the same echo of the scene."""
    _, _, own = walk
    count = min(len(own["t_ns"]), len(labelled["t_ns"]))
    assert count > 22_000
    own, ours = by_pulse(own, count), by_pulse(labelled, count)
    same = (ours["laser"] == own["laser"]) & (np.abs(ours["distance_m"] - own["distance_m"]) < 0.0011)
    assert same.all()
    for name in LABELS:
        assert (ours[name] == own[name]).all(), name
    assert len(np.unique(ours["label"])) >= 4
    assert np.abs(ours["height_m"] - own["height_m"]).max() < 0.002


def test_labels_do_not_depend_on_the_trajectory(walk, labelled):
    """With an estimate in TUM format that is off by 0.5 m the places move, and the labels stay, height
    above the ground with them."""
    folder, _, _ = walk
    rows = np.loadtxt(folder / "truth" / "trajectory.tum")
    np.savetxt(folder / "estimate.tum", rows + [0, 0.5, *np.zeros(6)], fmt="%.9f")
    words = ["--trajectory", folder / "estimate.tum", "--truth-folder", folder / "truth"]
    moved = points(folder / "walk.pcap", folder / "b.npz", *words, "--labels", "for-instance")
    assert np.abs(moved["world_m"] - labelled["world_m"]).max() > 0.3
    for name in (*LABELS, "height_m"):
        assert (moved[name] == labelled[name]).all(), name


def copy(capture, out, keep):
    """Write the frames of a capture whose numbers `keep` gives, in that order."""
    with capture.open("rb") as file:
        frames = list(dpkt.pcap.Reader(file))
    data = [n for n, (_, frame) in enumerate(frames) if len(frame) == 42 + DATA_BYTES]
    with out.open("wb") as file:
        writer = dpkt.pcap.Writer(file, snaplen=65535)
        for n in keep(data):
            writer.writepkt(frames[n][1], frames[n][0])


def test_lost_late_and_doubled_packets_find_their_rows(walk, labelled, tmp_path):
    """Of a capture that lacks its first packets and some more, has one twice and one late, each point has
    the labels that it has in the whole."""
    folder, _, _ = walk

    def keep(data):
        kept = [n for i, n in enumerate(data) if i >= 20 and i % 7]
        kept[30:30] = [kept[29]]
        kept[50], kept[53] = kept[53], kept[50]
        return kept

    copy(folder / "walk.pcap", tmp_path / "cut.pcap", keep)
    some = points(
        tmp_path / "cut.pcap",
        tmp_path / "c.npz",
        "--trajectory",
        folder / "truth",
        "--labels",
        "for-instance",
    )
    assert 0.7 * len(labelled["t_ns"]) < len(some["t_ns"]) < 0.9 * len(labelled["t_ns"])
    names = ("t_ns", "laser", "is_last", "semantic", "part", "instance", "label")

    def rows(arrays):
        """Each point as a row."""
        return {
            tuple(row) for row in np.column_stack([arrays[name].astype(np.int64) for name in names]).tolist()
        }

    assert rows(some) < rows(labelled)


@pytest.mark.parametrize(
    ("truth", "line"),
    [
        ("other", "no return in packet "),
        ("later", "no packet of time stamp "),
        ("plain", "no such file"),
        ("damaged", ""),
    ],
)
def test_the_truth_of_another_run_is_refused(walk, tmp_path, refused, truth, line):
    """Truth of another scene, of another time, without returns or damaged gives one line and exit code 2."""
    folder, _, _ = walk
    scene, settings = "static_bench", {"sensor.return_mode": "dual"}
    if truth == "other":  # at the same time, by the same clock
        own = {key: value for key, value in SETTINGS.items() if not key.startswith("world")}
        hall = {"kind": "hall", "length_m": 20.0, "width_m": 16.0, "height_m": 5.0}
        scene, settings = "birch_walk", own | {"world": hall, "sensor.max_range_m": 3.0}
    to = TruthTo(tmp_path / truth, per_return=truth != "plain")
    Emulator(scene, settings).record(tmp_path / "x.pcap", duration_s=0.1, truth=to)
    if truth == "damaged":
        (to.folder / "returns.parquet").write_bytes(b"PAR1 no table PAR1")
    words = ["--trajectory", folder / "truth", "--truth-folder", to.folder, "--truth"]
    error = refused(["points", folder / "walk.pcap", tmp_path / "out.npz", *words])
    assert error.startswith(f"error: {to.folder}/returns.parquet: {line}")
