"""Bags held against what SLAM programs need: ours, damaged ones, and one of a real sensor."""

import json
import os
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from vlp16emu import Emulator
from vlp16emu.cli.app import run
from vlp16emu.extras.bag.write import write_bag
from vlp16emu.extras.slam.configure import Rig, programs, written_beside
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
    "us": (
        column("time", lambda t: t * 1e6),
        "time-unit",
        {"fast-lio2": "preprocess/timestamp_unit: 2", "rko-lio": "multiplier_to_seconds: 1e-06"},
    ),
    "ns": (
        column("time", lambda t: t * 1e9),
        "time-unit",
        {"point-lio": "preprocess/timestamp_unit: 3", "lio-sam": "seconds"},
    ),
    "stamp of the last point": (
        column("time", lambda t: t - 0.1),
        "time-zero",
        {"fast-lio2": "timestamp_first_packet", "dlio": "timestamp_first_packet"},
    ),
    "unsorted": (
        points(lambda made: made[::-1].copy()),
        "time-last",
        {"cartographer": "a CHECK aborts it", "a-loam": "azimuth"},
    ),
    "other name": (points(time={"name": "t"}), "time-name", {"dlio": "instead of `t`"}),
    "no times": (
        points(time={"name": "age"}),
        "no-time",
        {"mola": "without a message", "kiss-icp": "nothing is deskewed"},
    ),
    "rings upside down": (
        column("ring", lambda ring: 15 - ring),
        "ring-order",
        {"lio-sam": "across beams", "lego-loam": "in the sky"},
    ),
    "signed rings": (points(ring={"datatype": 3}), "ring", {"lio-sam": "uint16"}),
    "holes": (
        column("x", lambda x: np.where(np.arange(len(x)) == 7, np.nan, x)),
        "density",
        {"lio-sam": "it stops", "kiss-icp": "not their times"},
    ),
    "clouds elsewhere": (
        renamed("/velodyne_points", "/points"),
        "cloud-topic",
        {"glim": "points_topic: /points", "kiss-icp": "--topic /points"},
    ),
    "unit elsewhere": (
        renamed("/imu/data", "/imu"),
        "imu-topic",
        {"fast-lio2": "common/imu_topic: /imu", "cartographer": "imu:=/imu"},
    ),
    "half the scans": (
        kept("/velodyne_points", lambda n: n % 2 == 0),
        "cloud-gaps",
        {"kiss-icp": "every scan"},
    ),
    "a gap": (kept("/velodyne_points", lambda n: n not in (3, 4)), "cloud-gaps", {"kiss-icp": "every scan"}),
    "no unit": (kept("/imu/data", lambda n: False), "no-imu", {"fast-lio2": "6 axes", "lio-sam": "9 axes"}),
    "in g": (
        scaled(1 / 9.81),
        "gravity-unit",
        {"point-lio": "mapping/acc_norm: 1", "glim": "acc_scale: 9.8"},
    ),
    "upside down": (
        scaled(-1.0),
        "gravity-axis",
        {"fast-lio2": "mapping/extrinsic_R", "lio-sam": "extrinsicRot"},
    ),
    "100 Hz": (
        kept("/imu/data", lambda n: n % 2 == 0),
        "imu-rate",
        {"point-lio": "mapping/imu_time_inte: 0.01"},
    ),
    "6 axes": (
        samples(
            orientation=vector("orientation", **dict.fromkeys("xyzw", lambda _: 0.0)),
            orientation_covariance=NONE,
        ),
        "attitude",
        {"lio-sam": "Invalid quaternion"},
    ),
    "no covariance": (
        samples(angular_velocity_covariance=NONE),
        "covariance",
        {"cartographer": "a CHECK aborts it"},
    ),
    "another clock": (
        lambda one: moved(one, 3600 * 10**9) if one[0] == "/imu/data" else one,
        "clock",
        {"fast-lio2": "common/time_offset_lidar_to_imu"},
    ),
    "lever arm": (
        on("/tf_static", apart),
        "extrinsics",
        {
            "fast-lio2": "[-0.05, 0.0, 0.0]",
            "lio-sam": "[0.05, 0.0, 0.0]",
            "glim": "[0.05, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]",
        },
    ),
    "two parents": (
        on("/tf_static", second_parent),
        "frames",
        {"cartographer": "one tree", "mola": "one tree"},
    ),
    "truth moves base_link": (
        on("/tf", moving_body),
        "tf-map",
        {"cartographer": "map -> base_link", "hdl-graph-slam": "map -> base_link"},
    ),
    "walks at once": (
        samples(angular_velocity=vector("angular_velocity", z=lambda _: 0.6)),
        "rest",
        {"dlio": "3 s of rest", "rko-lio": "initialization_phase: false"},
    ),
}
"""Damage, the rule that it breaks, and what is reported for each program."""


def each(change):
    return lambda found: [made for one in found if (made := change(one))]


def of_topic(topic, change):
    """Damage of the list of messages of a topic."""

    def damage(found):
        rest = [one for one in found if one[0] != topic]
        return sorted([*rest, *change([one for one in found if one[0] == topic])], key=lambda one: one[1])

    return damage


def with_points(one, made):
    topic, t_ns, message = one
    data = made.view(np.uint8)
    return topic, t_ns, replace(message, data=data, width=len(made), row_step=len(data))


def stamped(one, t_ns):
    return moved((one[0], t_ns, one[2]))


def parts(number):
    """Messages that each cover a part of a turn."""

    def split(clouds):
        for one in clouds:
            made = one[2].data.view(POINT)
            cuts = np.array_split(made[np.argsort(made["time"], kind="stable")], number)
            for cut in filter(len, cuts):
                begin_s = cut["time"].min()
                later = cut.copy()
                later["time"] -= begin_s
                yield stamped(with_points(one, later), one[1] + int(begin_s * 1e9))

    return of_topic("/velodyne_points", split)


def two_turns(clouds):
    for first, second in zip(clouds[::2], clouds[1::2], strict=True):
        later = second[2].data.view(POINT).copy()
        later["time"] += (second[1] - first[1]) / 1e9
        yield with_points(first, np.concatenate([first[2].data.view(POINT), later]))


def coordinates(change):
    return each(points(lambda made: _changed(made, change)))


def _changed(made, change):
    for axis in "xyz":
        made[axis] = change(made[axis])
    return made


def turning(**fields):
    """An IMU that turns by 0.1 rad/s, too slowly for a body that does not rest."""
    return samples(angular_velocity=vector("angular_velocity", z=lambda _: 0.1), **fields)


def elsewhere(message):
    return replace(message, header=replace(message.header, frame_id="mti"))


TWICE = lambda found: [one for one in found for _ in range(2)]  # noqa: E731
CLOUDS = "/velodyne_points"
IMU = "/imu/data"
SICK = {
    "times of 0": (each(column("time", lambda t: 0 * t)), {"times": "all point times are 0"}),
    "times of the end": (each(column("time", lambda t: 0 * t + 0.1)), {"times": "one time"}),
    "times of NaN": (each(column("time", lambda t: t * np.nan)), {"times": "NaN or infinite in 6 clouds"}),
    "a time of infinity": (
        each(column("time", lambda t: np.where(np.arange(len(t)) == 9, np.inf, t))),
        {"times": "infinite"},
    ),
    "times three times too long": (
        each(column("time", lambda t: 3 * t)),
        {"time-span": "point times span 0.298"},
    ),
    "one stamp": (
        of_topic(CLOUDS, lambda found: [(*one[:2], found[0][2]) for one in found]),
        {"stamps": "5 of 6 clouds"},
    ),
    "clouds twice": (of_topic(CLOUDS, TWICE), {"stamps": "6 of 12 clouds"}),
    "half turns": (parts(2), {"turn": "covers 179 deg"}),
    "thirds of turns": (parts(3), {"turn": "covers 119 deg"}),
    "half turns without times": (
        lambda found: each(points(time={"name": "age"}))(parts(2)(found)),
        {"turn": "covers 1", "no-time": "only"},
    ),
    "packets": (parts(75), {"turn": "covers 5 deg"}),
    "two turns": (of_topic(CLOUDS, two_turns), {"turn": "covers 717 deg"}),
    "one ring": (each(column("ring", lambda ring: 0 * ring)), {"rings": "1 different values, up to 0"}),
    "numbers of points as rings": (
        each(column("ring", lambda ring: np.arange(len(ring)) % 60_000)),
        {"rings": "up to"},
    ),
    "no points": (each(points(lambda made: made[:0])), {"no-points": "no cloud"}),
    "a cloud without points": (
        of_topic(
            CLOUDS,
            lambda found: [
                with_points(one, one[2].data.view(POINT)[: 10**6 * (n != 3)]) for n, one in enumerate(found)
            ],
        ),
        {"empty-clouds": "1 of 6"},
    ),
    "all at the origin": (coordinates(lambda x: 0 * x), {"no-points": "coordinates"}),
    "all NaN": (
        coordinates(lambda x: x * np.nan),
        {"no-points": "coordinates", "density": "6 clouds hold NaN"},
    ),
    "millimetres": (coordinates(lambda x: 1e3 * x), {"point-unit": "millimetres"}),
    "samples twice": (of_topic(IMU, TWICE), {"imu-stamps": "have the stamp of the message before"}),
    "samples of one stamp": (
        of_topic(IMU, lambda found: [(*one[:2], found[0][2]) for one in found]),
        {"imu-stamps": "stamp"},
    ),
    "samples of NaN": (
        each(samples(linear_acceleration=vector("linear_acceleration", x=lambda _: np.nan))),
        {"imu-values": "NaN"},
    ),
    "attitude that stays": (
        each(
            turning(
                orientation=vector(
                    "orientation", x=lambda _: 0.0, y=lambda _: 0.0, z=lambda _: 0.0, w=lambda _: 1.0
                )
            )
        ),
        {"attitude-fixed": "turn by"},
    ),
    "frame that TF lacks": (
        each(on(IMU, elsewhere)),
        {"imu-frame": "velodyne and mti", "frames": "velodyne and mti"},
    ),
}
"""Bags whose measurements cannot be taken: the change of a list of messages, and what is found, by rule."""


@pytest.mark.parametrize("name", SICK)
def test_what_cannot_be_measured_is_its_own_finding(rest, tmp_path, name):
    """A measurement that cannot be sound is named, and no parameter is computed from it."""
    damage, expected = SICK[name]
    found = fitness(write(tmp_path / "bag", damage(rest)), "all")
    assert {one.rule for one in found.findings} == set(expected)
    for rule, words in expected.items():
        texts = [one.found for one in found.findings if one.rule == rule]
        assert texts
        assert all(words in text for text in texts)


def test_a_slow_turn_shows_in_a_sound_attitude(rest, tmp_path):
    """An attitude that turns with the angular rates is no finding, nor one that stays while they are zero."""
    angles = count()

    def turned(one):
        if one[0] != IMU:
            return one
        half = next(angles) * 0.1 * 0.005 / 2
        z, w = np.sin(half), np.cos(half)
        return turning(orientation=vector("orientation", z=lambda _: z, w=lambda _: w))(one)

    assert fitness(write(tmp_path / "bag", [turned(one) for one in rest]), "lio-sam").findings == ()


def test_cartographer_takes_times_before_the_stamp(rest, tmp_path):
    """The ROS driver stamps by the last point: Cartographer adds the last point's time to the stamp
    (cartographer_ros/msg_conversion.cc), which is right for either, and others mind."""
    found = fitness(
        write(tmp_path / "bag", [column("time", lambda t: t - t.max())(one) for one in rest]), "all"
    )
    assert found.findings_of("cartographer") == []
    assert [one.rule for one in found.findings_of("lio-sam")] == ["time-zero"]


def faster(found):
    """The same bag, with everything twice as fast: 1200 rpm."""
    begin_ns = found[0][1]
    quick = each(column("time", lambda t: t / 2))(found)
    return [stamped(one, begin_ns + (one[1] - begin_ns) // 2) if one[0] == CLOUDS else one for one in quick]


def test_the_configuration_beside_a_bag_counts(rest, tmp_path):
    """Parameters that the configuration beside a bag holds are no finding, and wrong ones are, also where
    the rig is that of protocol/slam."""
    base_T_imu = np.eye(4)
    base_T_imu[0, 3] = 0.05
    fast = Rig(rpm=1200.0, base_T_imu=base_T_imu)
    bag = write(tmp_path / "bag", each(on("/tf_static", apart))(faster(rest)))
    rules = {"extrinsics", "sweep", "clock"}
    for program in programs().values():
        before = {one.rule for one in fitness(bag, program.name).findings} - {"clock"}
        assert before == {rule for rule in ("extrinsics", "sweep") if rule in program.needs}
    with written_beside(bag, "all", lambda: fast):
        pass
    for name in ("fast-lio2", "point-lio", "lio-sam", "rko-lio", "dlio", "glim", "hdl-graph-slam"):
        assert not rules & {one.rule for one in fitness(bag, name).findings} - {"clock"}
    with written_beside(tmp_path / "slow", "all", Rig):
        pass
    write(tmp_path / "slow", rest)
    assert fitness(tmp_path / "slow", "all").findings == ()
    config = tmp_path / "slow.fast-lio2.yaml"
    config.write_text(
        config.read_text()
        .replace("scan_rate: 10", "scan_rate: 20")
        .replace("[0.0, 0.0, 0.0]", "[0.1, 0.0, 0.0]")
    )
    found = {one.rule: one.found for one in fitness(tmp_path / "slow", "fast-lio2").findings}
    assert set(found) == {"sweep", "extrinsics"}
    assert "slow.fast-lio2.yaml has preprocess/scan_rate: 20" in found["sweep"]
    assert "extrinsic_T: [0.1, 0.0, 0.0]" in found["extrinsics"]


def test_files_that_would_wait_are_one_line(rest, tmp_path, refused):
    """A pipe or a device in the place of a bag, or of a file of a folder, is refused at once."""
    os.mkfifo(tmp_path / "m.mcap")
    (tmp_path / "wd").mkdir()
    (tmp_path / "wd" / "metadata.yaml").write_text("{}")
    os.mkfifo(tmp_path / "wd" / "wd.db3")
    zero = write(tmp_path / "zero", rest[:20])
    (zero / "metadata.yaml").unlink()
    (zero / "metadata.yaml").symlink_to("/dev/zero")
    for name, line in (("m.mcap", "m.mcap: is a FIFO"), ("wd", "wd.db3: is a FIFO"), ("zero", "is a device")):
        assert line in refused(["verify", f"{tmp_path}/{name}", "--for", "all"])


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
        (finding,) = found.findings_of(program)
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
        ("verify {folder}/none.mcap --for all", "none.mcap: no such file"),
        ("verify {folder}/empty.mcap --for all", "empty.mcap: an empty file"),
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
