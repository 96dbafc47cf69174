"""A capture, with or without its truth, as the messages that ROS has of such a sensor."""

import csv
import heapq
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from operator import itemgetter
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import InputError, readable, spare
from vlp16emu.packets import (
    POSITION_BYTES,
    Capture,
    CapturedUnit,
    CaptureReader,
    PacketChunk,
    decode_position,
    units_in,
)
from vlp16emu.sinks.bag import BagFile
from vlp16emu.units import HOUR_NS, S_NS

__all__ = ["BagResult", "write_bag"]

_POINT = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")]
)
"""PointXYZIRT of velodyne_pointcloud (pointcloudXYZIRT.cpp, ros-drivers/velodyne): packed, 22 bytes."""
_FIELD_TYPES = {"f4": 7, "u2": 4}
"""FLOAT32 and UINT16 of sensor_msgs/PointField."""
_UNKNOWN_M2 = 1e6
"""Variance of the height, which an RMC sentence does not have."""

_Beat = tuple[int, Callable[[], None]]
"""UTC of a message, and what writes it."""


@dataclass(frozen=True, slots=True)
class BagResult:
    """What a bag holds."""

    file: str
    messages: dict[str, int]
    """By topic."""
    duration_s: float
    """From the first message to the last."""
    interrupted: bool


def write_bag(capture: Path, out: Path, truth: Path | None = None, *, stop: Event | None = None) -> BagResult:
    """Write the bag of a capture; memory does not grow with its length.

    Each unit of several has its topics and its frame under `/unit_1` and so on. A scan ends with the packet that passes
    azimuth 0, as the driver's default `cut_angle` has it, and has the stamp of its first packet by the sensor's clock, as with
    its settings `gps_time` and `timestamp_first_packet`; what is left after the last cut is no scan.

    Parameters
    ----------
    capture : a classic pcap file of VLP-16 packets, also of a real sensor
    out : .mcap, .bag or a folder, as `BagFile` takes it
    truth : folder with the truth of the run: true odometry, transforms, inertial unit and receiver
    stop : ends the bag between two messages; it is valid

    Raises
    ------
    CaptureError, PacketError
        where the capture is none, or is damaged
    InputError
        where the truth cannot be read, or is not of as many units
    OutputError, MissingExtraError, RunError
        as `BagFile`
    """
    spare([capture], out)
    stop = stop or Event()
    units = units_in(capture)
    frames = [f"unit_{number}/velodyne" for number in range(1, len(units) + 1)]
    frames = frames if len(units) > 1 else ["velodyne"]
    with BagFile(out) as bag:
        streams: list[Iterator[_Beat]] = []
        for unit, frame in zip(units, frames, strict=True):
            space = f"/{frame}".removesuffix("/velodyne")
            streams += [_scans(bag, capture, unit, space, frame), _sentences(bag, capture, unit, space)]
        if truth is not None:
            streams += _true(bag, truth, frames, _first_ns(capture))
        for _, write in heapq.merge(*streams, key=itemgetter(0)):
            if stop.is_set():
                break
            write()
    first_ns, last_ns = bag.span_ns or (0, 0)
    return BagResult(str(out), dict(sorted(bag.counts.items())), (last_ns - first_ns) / S_NS, stop.is_set())


def _first_ns(capture: Path) -> int:
    """UTC of the first data packet's first pulse in a capture, to the microsecond."""
    with CaptureReader(capture) as reader:
        chunk = next(reader.points())
        return int(chunk.packet_ns[0]) + _zero_ns(reader, chunk)


def _zero_ns(reader: CaptureReader, chunk: PacketChunk) -> int:
    """UTC of the hour from which the clock of a first chunk counts: the one nearest to the capture's stamp."""
    return round((reader.first_stamp_ns - int(chunk.packet_ns[0])) / HOUR_NS) * HOUR_NS


def _scans(bag: BagFile, capture: Path, unit: CapturedUnit, space: str, frame: str) -> Iterator[_Beat]:
    """Yield the scans of a unit, each at its last packet: the packets, then the points."""
    with CaptureReader(capture, unit) as reader:
        zero_ns: int | None = None
        packets: list[tuple[int, NDArray[np.uint8]]] = []
        points: list[NDArray[np.void]] = []
        clocks_ns: list[NDArray[np.int64]] = []
        last_cdeg = -1
        for chunk in reader.points():
            zero_ns = _zero_ns(reader, chunk) if zero_ns is None else zero_ns
            bounds = np.searchsorted(chunk.points.packet, np.arange(len(chunk.fields) + 1))
            arrays, clock_ns = _points(chunk), chunk.clock_ns + zero_ns
            for at, (begin, end) in enumerate(pairwise(bounds.tolist())):
                stamp_ns = int(chunk.packet_ns[at]) + zero_ns
                packets.append((stamp_ns, np.frombuffer(chunk.fields[at].tobytes(), np.uint8)))
                points.append(arrays[begin:end])
                clocks_ns.append(clock_ns[begin:end])
                azimuth_cdeg = int(chunk.fields["blocks"]["azimuth_cdeg"][at, 0])
                if azimuth_cdeg < last_cdeg:
                    cloud, t_ns = np.concatenate(points), np.concatenate(clocks_ns)
                    cloud["time"] = (t_ns - packets[0][0]) / S_NS
                    yield stamp_ns, partial(_write_scan, bag, packets, cloud, (space, frame))
                    packets, points, clocks_ns = [], [], []
                last_cdeg = azimuth_cdeg


def _points(chunk: PacketChunk) -> NDArray[np.void]:
    """(n,) `_POINT`, without times."""
    points = np.zeros(len(chunk.points.ring), _POINT)
    for number, axis in enumerate("xyz"):
        points[axis] = chunk.points.xyz_m[:, number]
    points["intensity"], points["ring"] = chunk.points.reflectivity, chunk.points.ring
    return points


def _write_scan(
    bag: BagFile,
    packets: list[tuple[int, NDArray[np.uint8]]],
    points: NDArray[np.void],
    names: tuple[str, str],
) -> None:
    """Write both messages of a scan."""
    (space, frame), begin_ns, end_ns = names, packets[0][0], packets[-1][0]
    topic = f"{space}/velodyne_packets"
    raw = [
        bag.make("velodyne_msgs/msg/VelodynePacket", stamp=bag.time(t_ns), data=data)
        for t_ns, data in packets
    ]
    header = bag.header(begin_ns, frame, topic)
    bag.write(topic, end_ns, bag.make("velodyne_msgs/msg/VelodyneScan", header=header, packets=raw))
    topic = topic.replace("velodyne_packets", "velodyne_points")
    fields = [
        bag.make(
            "sensor_msgs/msg/PointField",
            name=name,
            offset=offset,
            datatype=_FIELD_TYPES[kind.str[1:]],
            count=1,
        )
        for name, (kind, offset, *_) in (_POINT.fields or {}).items()
    ]
    cloud = bag.make(
        "sensor_msgs/msg/PointCloud2",
        header=bag.header(begin_ns, frame, topic),
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=_POINT.itemsize,
        row_step=_POINT.itemsize * len(points),
        data=points.view(np.uint8),
        is_dense=True,
    )
    bag.write(topic, end_ns, cloud)


def _sentences(bag: BagFile, capture: Path, unit: CapturedUnit, space: str) -> Iterator[_Beat]:
    """Yield each sentence of a unit's position packets, at the first one that has it."""
    topic, before = f"{space}/nmea_sentence", b""

    def write(t_ns: int, sentence: bytes) -> None:
        """Write one, without its line end, as nmea_topic_driver takes it."""
        text = sentence.decode("ascii", "replace").strip()
        header = bag.header(t_ns, "gps", topic)
        bag.write(topic, t_ns, bag.make("nmea_msgs/msg/Sentence", header=header, sentence=text))

    with Capture(capture) as datagrams:
        for datagram in datagrams:
            if len(datagram.payload) != POSITION_BYTES or not unit.owns(datagram):
                continue
            sentence = decode_position(datagram.payload).sentence
            if sentence not in (b"", before):
                yield datagram.stamp_ns, partial(write, datagram.stamp_ns, sentence)
            before = sentence


def _true(bag: BagFile, folder: Path, frames: list[str], begin_ns: int) -> list[Iterator[_Beat]]:
    """Give the streams of a folder of truth, from an instant UTC on."""
    rig, scenario = (_json(folder / name) for name in ("rig.json", "scenario.json"))
    if len(rig["units"]) != len(frames):
        expected = f"{len(frames)}, as in the capture"
        raise InputError(str(folder / "rig.json"), f"found {len(rig['units'])} units", expected)
    streams = [
        _odometry(bag, folder / unit["trajectory"], frame, begin_ns)
        for unit, frame in zip(rig["units"], frames, strict=True)
    ]
    streams.append(_fixed(bag, rig, frames, begin_ns))
    if (folder / "imu.csv").exists():
        streams.append(_inertial(bag, folder / "imu.csv", scenario["imu"], begin_ns))
    if (folder / "gnss.csv").exists():
        streams.append(_fixes(bag, folder / "gnss.csv", scenario["gps"], begin_ns))
    return streams


def _json(path: Path) -> Any:
    """Read a file of the truth."""
    with readable(path, "a file of a --truth folder", InputError):
        try:
            return json.loads(path.read_text(encoding="utf-8"))
        except ValueError:
            raise InputError(str(path), "no JSON", "a file of a --truth folder") from None


def _ns(text: str) -> int:
    """Read seconds with nine decimals exactly."""
    return int(text.replace(".", ""))


def _transform(bag: BagFile, header: Any, child: str, p_m: list[float], q: list[float]) -> Any:
    """Make a transform from the frame of a header to its child, with a quaternion x y z w."""
    make = bag.make
    moved = make("geometry_msgs/msg/Vector3", **dict(zip("xyz", p_m, strict=True)))
    turned = make("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", q, strict=True)))
    transform = make("geometry_msgs/msg/Transform", translation=moved, rotation=turned)
    return make(
        "geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child, transform=transform
    )


def _fixed(bag: BagFile, rig: dict[str, Any], frames: list[str], begin_ns: int) -> Iterator[_Beat]:
    """Yield the fixed transforms, once: body in the first unit, inertial unit in the body; what spins has none."""
    from scipy.spatial.transform import Rotation

    def one(parent: str, child: str, T: NDArray[np.float64]) -> Any:
        """Make one from a matrix."""
        q = Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True) + 0.0
        return _transform(
            bag, bag.header(begin_ns, parent, "/tf_static"), child, T[:3, 3].tolist(), q.tolist()
        )

    body, found = rig["units"][0]["body_T_sensor"], []
    if "spin_hz" not in body:
        found.append(one(frames[0], "base_link", np.linalg.inv(np.array(body["matrix"]))))
        if "imu" in rig and "spin_hz" not in rig["imu"]["body_T_imu"]:
            found.append(one("base_link", "imu", np.array(rig["imu"]["body_T_imu"]["matrix"])))
    if found:
        message = bag.make("tf2_msgs/msg/TFMessage", transforms=found)
        yield begin_ns, partial(bag.write, "/tf_static", begin_ns, message)


def _odometry(bag: BagFile, path: Path, frame: str, begin_ns: int) -> Iterator[_Beat]:
    """Yield true poses as odometry and as transform; the velocity is that to the next pose, in the sensor's axes."""
    topic = f"/{frame}".removesuffix("/velodyne") + "/ground_truth/odom"
    make, exact = bag.make, np.zeros(36)

    def write(t_ns: int, pose: list[float], rates: list[list[float]]) -> None:
        """Write one pose: x y z and quaternion x y z w, and its velocity and angular rate."""
        header = bag.header(t_ns, "map", topic)
        point = make("geometry_msgs/msg/Point", **dict(zip("xyz", pose[:3], strict=True)))
        turned = make("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", pose[3:], strict=True)))
        linear, angular = (
            make("geometry_msgs/msg/Vector3", **dict(zip("xyz", rate, strict=True))) for rate in rates
        )
        odometry = make(
            "nav_msgs/msg/Odometry",
            header=header,
            child_frame_id=frame,
            pose=make(
                "geometry_msgs/msg/PoseWithCovariance",
                pose=make("geometry_msgs/msg/Pose", position=point, orientation=turned),
                covariance=exact,
            ),
            twist=make(
                "geometry_msgs/msg/TwistWithCovariance",
                twist=make("geometry_msgs/msg/Twist", linear=linear, angular=angular),
                covariance=exact,
            ),
        )
        bag.write(topic, t_ns, odometry)
        moved = _transform(bag, bag.header(t_ns, "map", "/tf"), frame, pose[:3], pose[3:])
        bag.write("/tf", t_ns, make("tf2_msgs/msg/TFMessage", transforms=[moved]))

    for t_ns, pose, rates in _poses(path):
        if t_ns >= begin_ns:
            yield t_ns, partial(write, t_ns, pose, rates)


def _poses(path: Path) -> Iterator[tuple[int, list[float], list[list[float]]]]:
    """Yield poses, and velocity and angular rate until the next one; the last one keeps those before."""
    from scipy.spatial.transform import Rotation

    before: tuple[int, list[float]] | None = None
    rates = [[0.0] * 3] * 2
    with (
        readable(path, "a trajectory of a --truth folder", InputError, most_bytes=2**62),
        path.open() as lines,
    ):
        for line in lines:
            if line.startswith("#"):
                continue
            stamp, *numbers = line.split()
            t_ns, pose = _ns(stamp), [float(number) for number in numbers]
            if before is not None:
                (t0_ns, pose0), turn = before, Rotation.from_quat(before[1][3:])
                step_s = (t_ns - t0_ns) / S_NS
                moved_m = turn.inv().apply(np.subtract(pose[:3], pose0[:3]))
                turned_rad = (turn.inv() * Rotation.from_quat(pose[3:])).as_rotvec()
                rates = [(moved_m / step_s).tolist(), (turned_rad / step_s).tolist()]
                yield t0_ns, pose0, rates
            before = t_ns, pose
    if before is not None:
        yield *before, rates


def _rows(path: Path, begin_ns: int) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield the lines of a table from an instant on."""
    with readable(path, "a table of a --truth folder", InputError, most_bytes=2**62), path.open() as lines:
        for row in csv.DictReader(lines):
            if (t_ns := _ns(row["t_utc_s"])) >= begin_ns:
                yield t_ns, row


def _inertial(bag: BagFile, path: Path, imu: dict[str, Any], begin_ns: int) -> Iterator[_Beat]:
    """Yield the readings of the inertial unit, whose white noise makes their covariance; it has no orientation."""
    make, topic, none = bag.make, "/imu/data", np.zeros(9)
    none[0] = -1  # sensor_msgs/Imu: no estimate
    keys = ("gyro_noise_rad_s_sqrt_hz", "accel_noise_m_s2_sqrt_hz")
    rate, force = (np.eye(3).ravel() * imu[key] ** 2 * imu["rate_hz"] for key in keys)

    def write(t_ns: int, row: dict[str, str]) -> None:
        """Write one reading."""
        vectors = (
            make("geometry_msgs/msg/Vector3", **{axis: float(row[name.format(axis)]) for axis in "xyz"})
            for name in ("w{}_rad_s", "f{}_m_s2")
        )
        message = make(
            "sensor_msgs/msg/Imu",
            header=bag.header(t_ns, "imu", topic),
            orientation=make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
            orientation_covariance=none,
            angular_velocity=next(vectors),
            angular_velocity_covariance=rate,
            linear_acceleration=next(vectors),
            linear_acceleration_covariance=force,
        )
        bag.write(topic, t_ns, message)

    for t_ns, row in _rows(path, begin_ns):
        yield t_ns, partial(write, t_ns, row)


def _fixes(bag: BagFile, path: Path, gps: dict[str, Any], begin_ns: int) -> Iterator[_Beat]:
    """Yield what the receiver says, under open sky this exact; its sentences have no height."""
    topic, level_m2 = "/fix", gps["position_noise_m"] ** 2 + gps["wander_m"] ** 2
    covariance = np.diag([level_m2, level_m2, _UNKNOWN_M2]).ravel()

    def write(t_ns: int, row: dict[str, str]) -> None:
        """Write one fix; status -1 is none, service 1 is GPS, covariance 1 is approximated."""
        status = bag.make("sensor_msgs/msg/NavSatStatus", status=int(row["valid"]) - 1, service=1)
        message = bag.make(
            "sensor_msgs/msg/NavSatFix",
            header=bag.header(t_ns, "gps", topic),
            status=status,
            latitude=float(row["latitude_deg"]),
            longitude=float(row["longitude_deg"]),
            altitude=float("nan"),
            position_covariance=covariance,
            position_covariance_type=1,
        )
        bag.write(topic, t_ns, message)

    for t_ns, row in _rows(path, begin_ns):
        yield t_ns, partial(write, t_ns, row)
