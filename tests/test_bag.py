"""Bags, read back by software of others."""

import hashlib
import json
import math
import os
import shutil
from datetime import UTC, datetime
from functools import reduce
from operator import getitem
from pathlib import Path

import numpy as np
import pytest

from vlp16emu import Emulator
from vlp16emu.captures import CaptureReader
from vlp16emu.cli.app import run
from vlp16emu.extras.bag.write import write_bag
from vlp16emu.packets import points_in, utc_ns_of

pytest.importorskip("rosbags", reason="the extra ros is not installed")
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

SETTINGS = {"beam.model": "none", "gps.connected": True, "imu.preset": "consumer"}
TOPICS = [
    "/fix",
    "/ground_truth/odom",
    "/imu/data",
    "/nmea_sentence",
    "/tf",
    "/tf_static",
    "/velodyne_packets",
]
KINDS = ("walk.mcap", "walk.bag", "walk")
WORDS = [
    word for key, value in SETTINGS.items() for word in ("--set", f"{key}={value}".replace("True", "true"))
]


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    """Folder with a capture of 0.5 s, its truth, and a bag of each kind."""
    folder = tmp_path_factory.mktemp("bags")
    emulator = Emulator("static_bench", SETTINGS)
    emulator.record(folder / "walk.pcap", duration_s=0.5, truth=folder / "truth")
    for name in KINDS:
        write_bag(folder / "walk.pcap", folder / name, folder / "truth")
    return folder


@pytest.fixture(scope="module", params=KINDS)
def bag(request, walk):
    """Name of a bag, and its messages by topic in the order of the file."""
    return request.param, messages(walk / request.param)


def messages(path: Path) -> dict[str, list]:
    """Messages by topic."""
    found = {}
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append(message)
    return found


def values(vector, axes="xyz") -> list[float]:
    return [getattr(vector, axis) for axis in axes]


def stamp_ns(message) -> int:
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def test_points_and_packets_are_those_of_the_capture(walk, bag):
    """Packets are the capture's, bit by bit, and points are our decoder's, in the driver's layout and with
    its times."""
    _, found = bag
    assert sorted(found) == [*TOPICS, "/velodyne_points"]
    (table,) = CaptureReader(walk / "walk.pcap").tables()
    packets = [packet for scan in found["/velodyne_packets"] for packet in scan.packets]
    sent = table.view(np.uint8).reshape(len(table), -1)[:, -1206:]
    assert np.array_equal(np.array([packet.data for packet in packets]), sent[: len(packets)])
    assert len(sent) - len(packets) < 76
    kinds = {7: "<f4", 4: "<u2"}
    clouds = found["/velodyne_points"]
    fields = [(one.name, one.offset, kinds[one.datatype], one.count) for one in clouds[0].fields]
    assert fields == [
        ("x", 0, "<f4", 1), ("y", 4, "<f4", 1), ("z", 8, "<f4", 1),
        ("intensity", 12, "<f4", 1), ("ring", 16, "<u2", 1), ("time", 18, "<f4", 1),
    ]  # fmt: skip
    layout = np.dtype([(name, kind) for name, _, kind, _ in fields])
    points = [cloud.data.view(layout) for cloud in clouds]
    assert all(
        (c.point_step, c.row_step, c.height, c.width, c.is_dense, c.header.frame_id)
        == (22, 22 * len(p), 1, len(p), True, "velodyne")
        for c, p in zip(clouds, points, strict=True)
    )
    hour_ns = 3600 * 10**9
    t_ns = [
        stamp_ns(c) % hour_ns + p["time"].astype(float) * 1e9 for c, p in zip(clouds, points, strict=True)
    ]
    joined, n = np.concatenate(points), sum(map(len, points))
    decoded = points_in(table)
    assert np.array_equal(np.stack([joined[axis] for axis in "xyz"], axis=1), decoded.xyz_m[:n])
    assert np.array_equal(joined["ring"], decoded.ring[:n])
    assert np.array_equal(joined["intensity"], decoded.reflectivity[:n])
    assert np.abs(np.concatenate(t_ns) - utc_ns_of(table, decoded)[:n] % hour_ns).max() < 10
    assert min(point["time"].min() for point in points) >= 0


def test_truth_is_in_the_bag(walk, bag):
    """Odometry, transforms, inertial readings and fixes have the numbers of the tables of the truth, bit
    for bit."""
    name, found = bag
    poses, imu, fixes = (np.load(walk / "truth" / f"{table}.npy") for table in ("trajectory", "imu", "gnss"))
    odometry = [one.pose.pose for one in found["/ground_truth/odom"]]
    said = [values(one.position, "xyz") for one in odometry]
    turned = [values(one.orientation, "xyzw") for one in odometry]
    poses = poses[poses["t_ns"] >= stamp_ns(found["/ground_truth/odom"][0])][: len(said)]
    assert len(said) >= 100
    assert np.array_equal(said, poses["position_m"])
    assert np.array_equal(turned, poses["quaternion_xyzw"])
    moved = [one.transforms[0] for one in found["/tf"]]
    assert {(one.header.frame_id, one.child_frame_id) for one in moved} == {("map", "base_link_truth")}
    assert [one.transform.translation.x for one in moved] == [row[0] for row in said]
    read = found["/imu/data"]
    imu = imu[imu["stamp_ns"] >= stamp_ns(read[0])][: len(read)]
    assert np.array_equal([values(one.linear_acceleration) for one in read], imu["force_m_s2"])
    assert np.array_equal([values(one.angular_velocity) for one in read], imu["rate_rad_s"])
    assert [one.latitude for one in found["/fix"]] == fixes["latitude_deg"][-len(found["/fix"]) :].tolist()
    assert all(one.orientation_covariance[0] == -1 and one.orientation.w == 0 for one in found["/imu/data"])
    assert all(one.sentence.startswith("$GPRMC,") for one in found["/nmea_sentence"])
    assert hasattr(found["/imu/data"][0].header, "seq") == name.endswith(".bag")


def test_mcap_reader(walk):
    """The MCAP project's own reader finds the messages in the order of their times, and the fixed
    transforms' durability."""
    reading = pytest.importorskip("mcap.reader", reason="mcap is not installed")
    with (walk / "walk.mcap").open("rb") as file:
        summary = reading.make_reader(file, validate_crcs=True).get_summary()
        counts = {summary.channels[n].topic: c for n, c in summary.statistics.channel_message_counts.items()}
        times_ns = [m.log_time for *_, m in reading.make_reader(file).iter_messages(log_time_order=False)]
    assert counts == {topic: len(found) for topic, found in messages(walk / "walk.mcap").items()}
    assert len(times_ns) == summary.statistics.message_count
    assert times_ns == sorted(times_ns)
    offered = {one.topic: one.metadata["offered_qos_profiles"] for one in summary.channels.values()}
    assert "durability: 1" in offered["/tf_static"]
    assert "durability: 2" in offered["/tf"]


def test_same_bytes_again(walk, tmp_path):
    """A bag of the same name has the same bytes."""
    for name in KINDS[:2]:
        write_bag(walk / "walk.pcap", tmp_path / name, walk / "truth")
        assert (tmp_path / name).read_bytes() == (walk / name).read_bytes()


def frames(found) -> tuple[dict[str, str], dict[str, str]]:
    """Parents of the frames that are fixed and of those that move; each child has one."""
    parents = {}
    for topic in ("/tf_static", "/tf"):
        edges = {
            (one.child_frame_id, one.header.frame_id)
            for message in found[topic]
            for one in message.transforms
        }
        parents[topic] = dict(edges)
        assert len(parents[topic]) == len(edges), topic
    assert not parents["/tf_static"].keys() & parents["/tf"].keys()
    return parents["/tf_static"], parents["/tf"]


def root_of(frame: str, parents: dict[str, str]) -> str:
    while frame in parents:
        frame = parents[frame]
    return frame


def test_frames_are_a_tree_as_tf2_wants_it(bag):
    """Each frame has one parent, fixed or moving but not both.

    All frames of messages hang on base_link, so that a SLAM program connects them with map by one edge; and
    transforms are in the bag before what needs them.
    """
    _, found = bag
    fixed, moving = frames(found)
    assert fixed == {"velodyne": "base_link", "imu": "base_link", "gps": "base_link"}
    assert moving == {"base_link_truth": "map"}
    topics = ("/velodyne_points", "/imu/data", "/fix", "/nmea_sentence")
    used = {one.header.frame_id for topic in topics for one in found[topic]}
    slam = fixed | moving | {"odom": "map", "base_link": "odom"}
    assert {root_of(frame, fixed) for frame in used} == {"base_link"}
    assert {root_of(frame, slam) for frame in used} == {"map"}
    assert (
        next(topic for topic in found if topic in ("/tf_static", "/velodyne_points", "/tf")) == "/tf_static"
    )


def test_the_truth_may_move_the_body(walk, tmp_path):
    """With --tf truth the tree is whole without SLAM: map, base_link, and what is mounted on it."""
    truth = ["--truth", str(walk / "truth"), "--tf", "truth"]
    assert run(["bag", str(walk / "walk.pcap"), f"{tmp_path}/a.mcap", *truth]) == 0
    fixed, moving = frames(messages(tmp_path / "a.mcap"))
    assert moving == {"base_link": "map"}
    assert {root_of(frame, fixed | moving) for frame in ("velodyne", "imu", "gps")} == {"map"}


MOUNTS = {
    "motion.mount": {"lever_arm_m": [0.1, -0.2, 0.4], "yaw_deg": 40.0, "pitch_deg": 10.0},
    "imu": {"preset": "consumer", "mount": {"lever_arm_m": [0.0, 0.1, 0.0], "roll_deg": 90.0}},
}


def test_units_have_topics_of_their_own(tmp_path):
    """Each of two sensors has its topics and its frame, whose fixed pose on base_link is that of the rig.

    The truth is that of the body, from a run and from its files alike, and with the fixed transform it is the
    trajectory of the sensor.
    """
    rig = {"rig": [{"mount": {"lever_arm_m": [0.0, 0.0, 1.0]}}]}
    emulator = Emulator("static_bench", SETTINGS | MOUNTS | rig)
    emulator.record(tmp_path / "rig.pcap", duration_s=0.3, truth=tmp_path / "truth")
    emulator.record(tmp_path / "run.mcap", duration_s=0.3)
    write_bag(tmp_path / "rig.pcap", tmp_path / "rig.mcap", tmp_path / "truth")
    found, ran = messages(tmp_path / "rig.mcap"), messages(tmp_path / "run.mcap")
    for number in (1, 2):
        assert found[f"/unit_{number}/velodyne_points"][0].header.frame_id == f"unit_{number}/velodyne"
    fixed = {
        one.child_frame_id: matrix(values(one.transform.translation), values(one.transform.rotation, "xyzw"))
        for one in found["/tf_static"][0].transforms
    }
    assert fixed.keys() == {"unit_1/velodyne", "unit_2/velodyne", "imu", "gps"}
    devices = json.loads((tmp_path / "truth" / "rig.json").read_text())
    for n in (1, 2):
        given = devices["units"][n - 1]["body_T_sensor"]["matrix"]
        np.testing.assert_allclose(fixed[f"unit_{n}/velodyne"], given, atol=1e-12)
    np.testing.assert_allclose(fixed["imu"], devices["imu"]["body_T_imu"]["matrix"], atol=1e-12)
    np.testing.assert_allclose(fixed["gps"][:3, 3], fixed["unit_1/velodyne"][:3, 3] + [0, 0, 0.2], atol=1e-12)
    for bag in (found, ran):
        poses = [one.pose.pose for one in bag["/ground_truth/odom"]]
        turns = [matrix(values(one.position), values(one.orientation, "xyzw")) for one in poses]
        np.testing.assert_allclose(turns, turns[:1] * len(turns), atol=1e-9)
        assert {one.child_frame_id for one in bag["/ground_truth/odom"]} == {"base_link_truth"}
        pose = np.loadtxt(tmp_path / "truth" / "trajectory.tum")[0, 1:]
        np.testing.assert_allclose(turns[0] @ fixed["unit_1/velodyne"], matrix(pose[:3], pose[3:]), atol=1e-8)


def matrix(place, turn):
    """Pose (4, 4) of a translation and a quaternion."""
    T = np.eye(4)
    T[:3, 3], T[:3, :3] = place, Rotation.from_quat(turn).as_matrix()
    return T


def test_an_attitude_is_that_of_the_truth(tmp_path):
    """With imu.attitude the orientation of /imu/data is that of the table, and its covariance no longer
    says that there is none."""
    settings = SETTINGS | {"imu.attitude": True, "motion.yaw_deg": 30.0}
    Emulator("static_bench", settings).record(tmp_path / "a.pcap", duration_s=0.2, truth=tmp_path / "truth")
    write_bag(tmp_path / "a.pcap", tmp_path / "a.mcap", tmp_path / "truth")
    rows = np.load(tmp_path / "truth" / "imu.npy")
    found = messages(tmp_path / "a.mcap")["/imu/data"]
    said = [values(one.orientation, "xyzw") for one in found]
    rows = rows[rows["stamp_ns"] >= stamp_ns(found[0])][: len(found)]
    assert np.array_equal(said, rows["attitude_xyzw"])
    assert np.degrees(Rotation.from_quat(said).as_euler("zyx")[:, 0]) == pytest.approx(30.0, abs=0.1)
    assert all(one.orientation_covariance[0] > 0 for one in found)


def test_a_configuration_is_written_beside_the_bag(walk, tmp_path, refused):
    """--for writes the files of a program under the bag's name, from a capture, its truth and a run alike;
    an edited one is left alone."""
    assert (
        run(
            [
                "bag",
                str(walk / "walk.pcap"),
                f"{tmp_path}/a.mcap",
                "--truth",
                f"{walk}/truth",
                "--for",
                "dlio",
            ]
        )
        == 0
    )
    assert run(["bag", str(walk / "walk.pcap"), f"{tmp_path}/b.mcap", "--for", "dlio"]) == 0
    assert (
        run(["record", "static_bench", f"{tmp_path}/c.mcap", "--duration", "0.2", *WORDS, "--for", "dlio"])
        == 0
    )
    texts = [
        [(tmp_path / f"{one}.{file}").read_text() for file in ("dlio.yaml", "dlio_params.yaml")]
        for one in "abc"
    ]
    assert texts[0] == texts[1] == texts[2]
    (tmp_path / "a.dlio.yaml").write_text("mine")
    line = refused(["bag", walk / "walk.pcap", tmp_path / "a.mcap", "--for", "dlio"])
    assert "a.dlio.yaml: is there already, with other values" in line
    assert (tmp_path / "a.dlio.yaml").read_text() == "mine"


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("bag {walk}/walk.pcap {walk}/walk.db", "found the ending '.db'"),
        ("bag {walk}/walk.pcap {walk}/walk", "is there already"),
        ("bag {walk}/walk.pcap {walk}/new.mcap --truth {walk}/nothing", "rig.json"),
        ("bag {walk}/walk.pcap {walk}/new.mcap --unit 2", "--unit: found 2"),
        ("bag {walk}/walk.pcap {walk}/new.mcap --clock moon", "--clock: found moon"),
        ("record static_bench {walk}/walk/", "is there already"),
        ("record static_bench {walk}/b.mcap --split", "one bag for all sensors"),
        ("bag {walk}/walk.pcap {walk}/new.mcap --for lio", "--for: found lio; expected fast-lio2"),
        ("record static_bench {walk}/new.mcap --for lio", "--for: found lio; expected fast-lio2"),
        ("record static_bench {walk}/new.pcap --for lio-sam", "--for and --tf: found the capture"),
    ],
)
def test_what_no_bag_can_be_made_of_is_refused(walk, refused, words, line):
    """A wrong ending, a folder that is there, no truth, unit or clock of that name: one line before any
    work, and nothing is written."""
    before = sorted(walk.iterdir())
    assert line in refused(word.format(walk=walk) for word in words.split())
    assert sorted(walk.iterdir()) == before


def test_a_run_goes_straight_into_a_bag(bag, tmp_path):
    """`record` with the name of a bag writes what `bag` makes of the capture and truth of the same run,
    bit for bit, and nothing beside it."""
    name, theirs = bag
    out = f"{tmp_path}/{name}" + "/" * (name == "walk")
    assert run(["record", "static_bench", out, "--duration", "0.5", *WORDS, "--json"]) == 0
    ours = messages(tmp_path / name)
    assert ours.keys() == theirs.keys()
    for topic, found in ours.items():
        left = len(found) - len(theirs[topic])
        assert left in ((0, 1) if topic == "/imu/data" else (0,)), topic  # imu.npy ends with the last packet
        assert list(map(repr, found[: len(theirs[topic])])) == list(map(repr, theirs[topic]))
    assert [one.name for one in tmp_path.iterdir()] == [name]


def test_a_capture_shorter_than_a_revolution_is_named(tmp_path, caplog):
    """A bag without messages is written, with a line that says why."""
    capture, out = tmp_path / "short.pcap", tmp_path / "short.mcap"
    Emulator("static_bench").record(capture, duration_s=0.02)
    assert write_bag(capture, out)["messages"] == {}
    assert "no revolution is whole" in caplog.text


def test_odometry_of_a_run_has_the_rates_of_its_motion(tmp_path):
    """Velocity and angular rate in a bag of a run are those of the motion at the same instant, in the
    sensor's axes.

    The report of `record` is of the bag: bytes, sha256, and messages by topic.
    """
    walk = {"motion": {"kind": "walk", "way_points_m": [[-8, 0], [4, 0], [4, 3]]}, "duration_s": 2.0}
    emulator = Emulator("static_bench", SETTINGS | walk)
    result = emulator.record(tmp_path / "a.mcap", start_s=1.0, duration_s=0.5)
    found = messages(tmp_path / "a.mcap")
    data = (tmp_path / "a.mcap").read_bytes()
    assert (result.bytes, result.sha256) == (len(data), hashlib.sha256(data).hexdigest())
    assert result.messages["/velodyne_packets"] == len(found["/velodyne_packets"])
    found = found["/ground_truth/odom"]
    true = emulator.parts.units[0].motion.kinematics_at(np.array([stamp_ns(one) for one in found]))
    linear, angular = (
        [values(getattr(one.twist.twist, kind)) for one in found] for kind in ("linear", "angular")
    )
    own_m_s = np.einsum("nji,nj->ni", true.world_R_body, true.world_v_body_m_s)
    assert np.linalg.norm(own_m_s, axis=1).min() > 0.1
    np.testing.assert_allclose(linear, own_m_s, atol=1e-12)
    np.testing.assert_allclose(angular, true.body_w_rad_s, atol=1e-12)


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("trajectory.npy", None, "trajectory.npy: no such file or directory; expected a table"),
        ("trajectory.npy", b"x y z", "trajectory.npy: cannot be read: "),
        ("imu.npy", b"\x93NUMPY", "imu.npy: cannot be read: "),
        ("gnss.npy", "imu.npy", "gnss.npy: found columns "),
        ("rig.json", b"{", "rig.json: no JSON"),
    ],
)
def test_damaged_truth_is_named_by_its_file(walk, tmp_path, refused, file, content, message):
    """A table that is missing, as in folders of earlier versions, damaged or another one is named; exit
    code 2 and no bag."""
    shutil.copytree(walk / "truth", tmp_path / "truth")
    place = tmp_path / "truth" / file
    place.unlink()
    if content is not None:
        place.write_bytes(content if isinstance(content, bytes) else (walk / "truth" / content).read_bytes())
    assert message in refused(["bag", walk / "walk.pcap", tmp_path / "a.mcap", "--truth", tmp_path / "truth"])
    assert not (tmp_path / "a.mcap").exists()


@pytest.mark.parametrize(
    ("file", "keys", "value", "message"),
    [
        ("rig.json", ["units"], [], "rig.json: units: found a list of 0"),
        ("rig.json", ["units", 0], None, "rig.json: units[0]: found None"),
        ("rig.json", ["units", 0, "trajectory"], "../truth/trajectory.tum", "expected the name of a file"),
        ("rig.json", ["units", 0, "body_T_sensor", "matrix", 1, 1], -1.0, "a rotation and a translation"),
        ("rig.json", ["units", 0, "body_T_sensor", "matrix", 0], [1.0], "four rows of four numbers"),
        ("rig.json", ["antenna", "above_sensor_m"], "high", 'rig.json: antenna.above_sensor_m: found "high"'),
        ("rig.json", ["antenna", "above_sensor_m"], math.nan, "rig.json: antenna.above_sensor_m: found"),
        ("rig.json", ["world", "latitude_deg"], 10**400, "rig.json: world.latitude_deg: "),
        ("scenario.json", ["sensor", "rpm"], 0, "scenario.json: sensor.rpm: found 0"),
        ("scenario.json", ["gps", "wander_m"], True, "scenario.json: gps.wander_m: found true"),
        ("scenario.json", ["imu"], {}, "scenario.json: imu.rate_hz, "),
    ],
)
def test_a_damaged_description_is_named_by_its_member(walk, tmp_path, refused, file, keys, value, message):
    """A member of a wrong type, out of bounds, of no rigid transform, or that leads out of the folder is one
    line with its name."""
    shutil.copytree(walk / "truth", tmp_path / "truth")
    place = tmp_path / "truth" / file
    tree = json.loads(place.read_text())
    *path, last = keys
    reduce(getitem, path, tree)[last] = value
    place.write_text(json.dumps(tree))
    line = refused(["bag", walk / "walk.pcap", tmp_path / "a.mcap", "--truth", tmp_path / "truth"])
    assert message in line
    assert sorted(path.name for path in tmp_path.iterdir()) == ["truth"]


@pytest.mark.parametrize("file", ["trajectory.npy", "imu.npy", "gnss.npy"])
@pytest.mark.parametrize("damage", ["nan", "times", "fifo", "loop", "sparse"])
def test_damaged_rows_of_truth_are_refused(walk, tmp_path, refused, file, damage):
    """A NaN, times that do not ascend, a special file, a loop of links, and a table of gigabytes that holds
    no rows of a run are refused with the file's name, and no bag is made."""
    shutil.copytree(walk / "truth", tmp_path / "truth")
    place = tmp_path / "truth" / file
    rows = np.load(place)
    place.unlink()
    if damage == "fifo":
        os.mkfifo(place)
    elif damage == "loop":
        place.symlink_to(place)
    elif damage == "sparse":
        np.lib.format.open_memmap(place, "w+", rows.dtype, (3_000_000_000 // rows.dtype.itemsize,))
    else:
        if damage == "nan":
            rows[rows.dtype.names[-2]][-1] = np.nan
        np.save(place, rows if damage == "nan" else np.concatenate([rows, rows]))
    line = refused(["bag", walk / "walk.pcap", tmp_path / "a.mcap", "--truth", tmp_path / "truth"])
    assert f"{file}: " in line
    assert sorted(path.name for path in tmp_path.iterdir()) == ["truth"]


def test_a_bag_needs_no_text_of_the_truth(walk, tmp_path):
    """Bags read the tables: a folder without their text gives the same bytes."""
    shutil.copytree(walk / "truth", tmp_path / "truth", ignore=shutil.ignore_patterns("*.tum", "*.csv"))
    write_bag(walk / "walk.pcap", tmp_path / "walk.mcap", tmp_path / "truth")
    assert (tmp_path / "walk.mcap").read_bytes() == (walk / "walk.mcap").read_bytes()


def test_truth_after_the_capture_is_not_in_its_bag(walk, tmp_path):
    """Of the truth of a longer run a bag has what is as late as the last packet, and no more."""
    Emulator("static_bench", SETTINGS).record(tmp_path / "x.pcap", duration_s=1.0, truth=tmp_path / "truth")
    write_bag(walk / "walk.pcap", tmp_path / "walk.mcap", tmp_path / "truth")
    found, shorter = messages(tmp_path / "walk.mcap"), messages(walk / "walk.mcap")
    assert repr(found["/ground_truth/odom"]) == repr(shorter["/ground_truth/odom"])
    assert len(found["/imu/data"]) - len(shorter["/imu/data"]) in (0, 1)


def test_the_truth_of_an_earlier_run_is_refused(walk, tmp_path, refused):
    """Poses that end before the capture begins are named with both times."""
    earlier = Emulator("static_bench", {**SETTINGS, "start_utc": datetime(2020, 1, 1, tzinfo=UTC)})
    earlier.record(tmp_path / "old.pcap", duration_s=0.1, truth=tmp_path / "truth")
    line = refused(["bag", walk / "walk.pcap", tmp_path / "a.mcap", "--truth", tmp_path / "truth"])
    assert "expected poses from the capture's first pulse on" in line
