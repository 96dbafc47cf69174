"""Bags held against what SLAM programs need: ours, damaged ones, and one of a real sensor."""

import json
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from vlp16emu import Emulator
from vlp16emu.cli.app import run
from vlp16emu.extras.bag.write import write_bag
from vlp16emu.extras.slam.configure import programs
from vlp16emu.extras.slam.fitness import fitness

pytest.importorskip("rosbags", reason="the extra ros is not installed")
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

SETTINGS = {"beam.model": "none", "imu.preset": "consumer", "imu.attitude": True}
CAPTURE = Path(__file__).resolve().parents[4] / "shared" / "captures" / "mrpt_vlp16_gps.pcap"
POINT = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")]
)
STORE = get_typestore(Stores.ROS2_HUMBLE)
NONE = lambda _: np.array([-1.0, *[0.0] * 8])  # noqa: E731  # covariance that says that there is no estimate
TYPES = ("sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Imu", "tf2_msgs/msg/TFMessage")


@pytest.fixture(scope="module")
def rest(tmp_path_factory):
    """Messages of a bag of a sensor at rest, as (topic, time, message): 0.6 s of clouds, and 3.2 s of the
    inertial unit around them."""
    folder = tmp_path_factory.mktemp("rest")
    emulator = Emulator("static_bench", SETTINGS)
    emulator.record(folder / "rest.mcap", start_s=2.5, duration_s=0.6)
    with AnyReader([folder / "rest.mcap"]) as reader:
        found = [
            (c.topic, t_ns, reader.deserialize(raw, c.msgtype))
            for c, t_ns, raw in reader.messages()
            if c.msgtype in TYPES
        ]
    samples = [one for one in found if one[0] == "/imu/data"]
    first_ns = samples[0][1]
    for n in range(1, 520):  # the same rest before
        _, _, sample = samples[n % len(samples)]
        found.append(moved(("/imu/data", first_ns - n * 5_000_000, sample)))
    return sorted(found, key=lambda one: one[1])


def moved(one, by_ns=0):
    """Stamp a message with the time at which it is in the bag, less or more."""
    topic, t_ns, message = one
    sec, nanosec = divmod(t_ns + by_ns, 10**9)
    header = replace(message.header, stamp=replace(message.header.stamp, sec=sec, nanosec=nanosec))
    return topic, t_ns, replace(message, header=header)


def write(path, found):
    """Write messages as a bag of ROS 2 by rosbags alone."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {}
        for topic, t_ns, message in found:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=STORE)
            writer.write(connections[topic], t_ns, STORE.serialize_cdr(message, message.__msgtype__))
    return path


def on(topic, change):
    """Damage of a topic: `change` takes and returns its messages."""
    return lambda one: (*one[:2], change(one[2])) if one[0] == topic else one


def points(change=lambda made: made, **fields):
    """Damage of all clouds: `change` takes and returns their points; fields are those of PointField that
    change."""

    def damage(message):
        made = change(message.data.view(POINT).copy())
        described = [replace(field, **fields.get(field.name, {})) for field in message.fields]
        data = made.view(np.uint8)
        return replace(message, data=data, fields=described, width=len(made), row_step=len(data))

    return on("/velodyne_points", damage)


def column(name, change):
    def damage(made):
        made[name] = change(made[name])
        return made

    return points(damage)


def samples(**fields):
    return on(
        "/imu/data", lambda message: replace(message, **{name: of(message) for name, of in fields.items()})
    )


def vector(name, **axes):
    """New vector of a sample: functions of the components that change."""

    def of(message):
        old = getattr(message, name)
        return replace(old, **{axis: change(getattr(old, axis)) for axis, change in axes.items()})

    return of


def scaled(factor):
    return samples(
        linear_acceleration=vector("linear_acceleration", **dict.fromkeys("xyz", lambda a: a * factor))
    )


def renamed(topic, other):
    return lambda one: (other, *one[1:]) if one[0] == topic else one


def second_parent(message):
    first = message.transforms[0]
    return replace(
        message,
        transforms=[*message.transforms, replace(first, header=replace(first.header, frame_id="map"))],
    )


def apart(message):
    def shifted(one):
        T = one.transform
        return replace(one, transform=replace(T, translation=replace(T.translation, x=0.05)))

    return replace(
        message, transforms=[shifted(t) if t.child_frame_id == "imu" else t for t in message.transforms]
    )


def moving_body(message):
    return replace(message, transforms=[replace(t, child_frame_id="base_link") for t in message.transforms])


def kept(topic, keep):
    """Leave out messages of a topic: `keep` takes their number, from 1."""
    numbers = count(1)
    return lambda one: one if one[0] != topic or keep(next(numbers)) else None


DAMAGES = {
    "us": (column("time", lambda t: t * 1e6), "time-unit", {"fast-lio2": "preprocess/timestamp_unit: 2", "rko-lio": "multiplier_to_seconds: 1e-06"}),
    "ns": (column("time", lambda t: t * 1e9), "time-unit", {"point-lio": "preprocess/timestamp_unit: 3", "lio-sam": "seconds"}),
    "stamp of the last point": (column("time", lambda t: t - 0.1), "time-zero", {"fast-lio2": "timestamp_first_packet", "dlio": "timestamp_first_packet"}),
    "unsorted": (points(lambda made: made[::-1].copy()), "time-last", {"cartographer": "a CHECK aborts it", "a-loam": "azimuth"}),
    "other name": (points(time={"name": "t"}), "time-name", {"dlio": "instead of `t`"}),
    "no times": (points(time={"name": "age"}), "no-time", {"mola": "without a message", "kiss-icp": "nothing is deskewed"}),
    "rings upside down": (column("ring", lambda ring: 15 - ring), "ring-order", {"lio-sam": "across beams", "lego-loam": "in the sky"}),
    "signed rings": (points(ring={"datatype": 3}), "ring", {"lio-sam": "uint16"}),
    "holes": (column("x", lambda x: np.where(np.arange(len(x)) == 7, np.nan, x)), "density", {"lio-sam": "it stops", "kiss-icp": "not their times"}),
    "clouds elsewhere": (renamed("/velodyne_points", "/points"), "cloud-topic", {"glim": "points_topic: /points", "kiss-icp": "--topic /points"}),
    "unit elsewhere": (renamed("/imu/data", "/imu"), "imu-topic", {"fast-lio2": "common/imu_topic: /imu", "cartographer": "imu:=/imu"}),
    "half the scans": (kept("/velodyne_points", lambda n: n % 2 == 0), "sweep", {"lio-sam": "Horizon_SCAN: 36", "hdl-graph-slam": "scan_period: 0.2"}),
    "a gap": (kept("/velodyne_points", lambda n: n not in (3, 4)), "cloud-gaps", {"kiss-icp": "every scan"}),
    "no unit": (kept("/imu/data", lambda n: False), "no-imu", {"fast-lio2": "6 axes", "lio-sam": "9 axes"}),
    "in g": (scaled(1 / 9.81), "gravity-unit", {"point-lio": "mapping/acc_norm: 1", "glim": "acc_scale: 9.8"}),
    "upside down": (scaled(-1.0), "gravity-axis", {"fast-lio2": "mapping/extrinsic_R", "lio-sam": "extrinsicRot"}),
    "100 Hz": (kept("/imu/data", lambda n: n % 2 == 0), "imu-rate", {"point-lio": "mapping/imu_time_inte: 0.01"}),
    "6 axes": (
        samples(orientation=vector("orientation", **dict.fromkeys("xyzw", lambda _: 0.0)), orientation_covariance=NONE),
        "attitude",
        {"lio-sam": "Invalid quaternion"},
    ),
    "no covariance": (samples(angular_velocity_covariance=NONE), "covariance", {"cartographer": "a CHECK aborts it"}),
    "another clock": (lambda one: moved(one, 3600 * 10**9) if one[0] == "/imu/data" else one, "clock", {"fast-lio2": "common/time_offset_lidar_to_imu"}),
    "lever arm": (on("/tf_static", apart), "extrinsics", {"fast-lio2": "[-0.05, 0.0, 0.0]", "lio-sam": "[0.05, 0.0, 0.0]", "glim": "[0.05, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]"}),
    "two parents": (on("/tf_static", second_parent), "frames", {"cartographer": "one tree", "mola": "one tree"}),
    "truth moves base_link": (on("/tf", moving_body), "tf-map", {"cartographer": "map -> base_link", "hdl-graph-slam": "map -> base_link"}),
    "walks at once": (samples(angular_velocity=vector("angular_velocity", z=lambda _: 0.6)), "rest", {"dlio": "3 s of rest", "rko-lio": "initialization_phase: false"}),
}  # fmt: skip
"""Damage, the rule that it breaks, and what is reported for each program."""


def test_our_bag_is_fit_for_all(rest, tmp_path):
    """A bag with rest, an attitude and the default rig is what all 13 configurations are for."""
    found = fitness(write(tmp_path / "bag", rest), "all")
    assert [str(one) for one in found.findings] == []
    assert list(found.programs) == list(programs())
    assert found.summary["samples"] > 600


@pytest.mark.parametrize("name", DAMAGES)
def test_each_damage_is_found(rest, tmp_path, name):
    """A damaged bag has the one finding, with the parameter of each program; programs that do not mind
    have none."""
    damage, rule, reported = DAMAGES[name]
    found = fitness(write(tmp_path / "bag", [made for one in rest if (made := damage(one))]), "all")
    assert {one.rule for one in found.findings} == {rule}
    assert {one.program for one in found.findings} == {
        one.name for one in programs().values() if rule in one.needs
    }
    for program, words in reported.items():
        (finding,) = found.of(program)
        assert words in str(finding)
        assert "\n" not in str(finding)


def test_a_bag_of_a_real_sensor(tmp_path, capsys):
    """A capture of a real unit becomes a bag that is fit for what needs no inertial unit and no
    transforms, and the others say which."""
    if not CAPTURE.exists():
        pytest.skip("no real captures beside the repository")
    write_bag(CAPTURE, tmp_path / "real.mcap")
    assert run(["verify", f"{tmp_path}/real.mcap", "--for", "all", "--json"]) == 1
    programs_found = json.loads(capsys.readouterr().out)["programs"]
    fit = {name for name, one in programs_found.items() if one["fit"]}
    assert fit == {"lego-loam", "a-loam", "genz-icp"}
    rules = {finding["rule"] for one in programs_found.values() for finding in one["findings"]}
    assert rules == {"no-imu", "frames", "frame-base"}
    assert run(["verify", f"{tmp_path}/real.mcap", "--for", "a-loam"]) == 0


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("verify {bag} --for slam", "--for: found slam; expected fast-lio2"),
        ("verify {folder}/blind", "a bag without packets; expected messages of velodyne_msgs/VelodyneScan"),
        ("verify {bag} --for all --unit 1", "--unit: found 1"),
        ("verify {folder}/none.mcap --for all", "none.mcap: no bag"),
        ("verify {folder}/empty.mcap --for all", "empty.mcap: no bag"),
        ("verify {folder}/blind --for all", "no point clouds"),
        ("verify {folder}/turnless --for all", "turnless, /tf_static: no bag: Found zero norm quaternions"),
        ("verify {folder}/flat --for all", "flat, /velodyne_points: no bag: no field of name z"),
        ("verify {folder}/torn/torn.mcap --for all", "torn.mcap: no bag: "),
    ],
)
def test_what_is_no_bag_is_one_line(rest, tmp_path, refused, words, line):
    """No bag, an empty, blind or damaged one, and a program of another name give one line and exit code 2."""
    (tmp_path / "empty.mcap").write_bytes(b"")
    bag = write(tmp_path / "bag", rest[:50])
    write(tmp_path / "blind", [one for one in rest[:50] if one[0] == "/imu/data"])
    (tf,) = (message for topic, _, message in rest if topic == "/tf_static")
    zero = replace(tf.transforms[0].transform.rotation, w=0.0)
    turnless = replace(tf.transforms[0], transform=replace(tf.transforms[0].transform, rotation=zero))
    write(
        tmp_path / "turnless",
        map(on("/tf_static", lambda message: replace(message, transforms=[turnless])), rest),
    )
    write(tmp_path / "flat", map(points(z={"name": "height"}), rest))
    torn = write(tmp_path / "torn", rest) / "torn.mcap"
    torn.write_bytes(torn.read_bytes().replace(b"/imu/data", b"/imu/\xe4ata"))
    assert line in refused(word.format(bag=bag, folder=tmp_path) for word in words.split())
