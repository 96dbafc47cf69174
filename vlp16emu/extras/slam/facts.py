"""Contents of a bag that matter to SLAM programs, as numbers of each message."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import CaptureError
from vlp16emu.inputs import open_input, parsing
from vlp16emu.libraries import of_extra
from vlp16emu.types import F8, AnyArray
from vlp16emu.units import S_NS

TIME_NAMES = ("time", "t", "timestamp", "time_stamp", "timestamps", "stamps", "offset_time")
"""Names of the time field in the programs of the table."""
SECTORS = 72  # of a turn, for the part of it that a message covers
_EXPECTED = "a bag: .mcap, .bag or a folder of ROS 2"
_ROS1_HEAD = b"#ROSBAG V"  # wiki.ros.org/Bags/Format/2.0
_LONGEST_METADATA_BYTES = 10_000_000
_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # of sensor_msgs/PointField
_CLOUD = "sensor_msgs/msg/PointCloud2"
_IMU = "sensor_msgs/msg/Imu"
_RING_SCANS = 20  # scans whose rings are checked
_RING_POINTS = 8  # fewer points of a ring do not show how far it has turned


class CloudRow(NamedTuple):
    """Numbers of one cloud; points without coordinates, or at the origin, count for `is_sparse` alone."""

    stamp_s: float  # since the first message of the bag
    points: int
    is_sparse: bool  # it holds NaN, or is not marked as dense
    has_times: bool  # all point times are finite; False also without a time field
    earliest: float  # point times in the field's unit; 0 without times
    latest: float
    last: float  # time of the last point
    turned_deg: float  # azimuth that the points pass through, more than 360 for several turns
    range_m: float  # median; 0 without points
    sectors: int  # bit i is set if there is a point in sector i of `SECTORS`


class SampleRow(NamedTuple):
    """Numbers of one IMU message."""

    stamp_s: float  # as of clouds
    rate: tuple[float, float, float]
    force: tuple[float, float, float]
    attitude: tuple[float, float, float, float]  # quaternion x, y, z, w
    covariances: tuple[float, float, float]  # the first one of attitude, angular rate and acceleration


@dataclass(slots=True)
class Facts:
    """Contents of a bag: clouds and IMU samples of the topics closest to ours, and transforms."""

    topic: str
    imu_topic: str  # empty if there is no inertial unit
    frame: str = ""  # of the lidar
    imu_frame: str = ""
    fields: Mapping[str, np.dtype[Any]] = field(default_factory=dict)  # types of the fields of points by name
    time_name: str = ""  # name of the time field; empty if there is none
    clouds: list[CloudRow] = field(default_factory=list)
    rings: dict[int, list[float]] = field(default_factory=dict)
    """Sum and number of the sines of elevation by ring."""
    samples: list[SampleRow] = field(default_factory=list)
    fixed: dict[str, tuple[str, F8]] = field(default_factory=dict)
    """Parent and pose of each frame of /tf_static."""
    parents: dict[str, set[str]] = field(default_factory=dict)
    """All parents of each frame, fixed or moving."""

    def pose(self, frame: str, parent: str) -> F8 | None:
        """Return the fixed pose (4, 4) of `frame` in `parent`; None if they are not connected."""
        parent_chain = dict(self.ancestors(parent))
        chain = dict(self.ancestors(frame))
        common = next((name for name in chain if name in parent_chain), None)
        return None if common is None else np.linalg.inv(parent_chain[common]) @ chain[common]

    def ancestors(self, frame: str) -> Iterator[tuple[str, F8]]:
        """Yield the frame and its ancestors, with its pose in each."""
        T = np.eye(4)
        seen = set[str]()
        while frame not in seen:
            yield frame, T
            seen.add(frame)
            if frame in self.fixed:
                frame, step = self.fixed[frame]
                T = step @ T


def read_facts(path: Path) -> Facts:
    """Read a bag of ROS 1 or ROS 2 once, message by message.

    Raises CaptureError if it is no bag, is damaged, or holds no point cloud; MissingExtraError if rosbags is
    not installed.
    """
    with of_extra("ros", "reading bags"):
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    _check_files(path)
    where = str(path)
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            facts = Facts(_topic(reader, _CLOUD, "velodyne_points"), _topic(reader, _IMU, "imu/data"))
            start_s = reader.start_time // S_NS
            adders = {
                facts.topic: _add_cloud,
                facts.imu_topic: _add_sample,
                "/tf": _add_moving,
                "/tf_static": _add_fixed,
            }
            wanted = [connection for connection in reader.connections if connection.topic in adders]
            for connection, _, raw in reader.messages(wanted) if wanted else ():
                where = f"{path}, {connection.topic}"
                adders[connection.topic](facts, reader.deserialize(raw, connection.msgtype), start_s)
    except Exception as error:  # noqa: BLE001  # rosbags raises errors of any type for damage
        reason = str(error) or type(error).__name__
        raise CaptureError(where, f"no bag: {reason}", _EXPECTED) from None
    if not facts.clouds:
        topic = f" on {facts.topic}" if facts.topic else ""
        raise CaptureError(str(path), f"no point clouds{topic}", "messages of sensor_msgs/PointCloud2")
    return facts


def _check_files(path: Path) -> None:
    """Raise CaptureError if a bag, or a file of a folder, is no regular file or begins as no bag.

    rosbags waits for a FIFO, and reads the first line of a `.bag` however long it is.
    """
    names = [path]
    if path.is_dir():
        with parsing(path, _EXPECTED, CaptureError):
            names = sorted(path.iterdir())
    for name in names:
        most_bytes = _LONGEST_METADATA_BYTES if name.suffix == ".yaml" else None
        if name is path or name.suffix in (".yaml", ".mcap", ".db3", ".zstd"):
            with open_input(name, _EXPECTED, CaptureError, most_bytes=most_bytes) as file:
                head = file.peek(len(_ROS1_HEAD))[: len(_ROS1_HEAD)]
            if name.suffix == ".bag" and head != _ROS1_HEAD:
                raise CaptureError(str(name), f"no bag: it begins with {head.hex(' ')}", _EXPECTED)


def _topic(reader: Any, message_type: str, ending: str) -> str:
    """Return the topic of a type with an ending, else the first of this type; empty if there is none."""
    names = [connection.topic for connection in reader.connections if connection.msgtype == message_type]
    return next((name for name in names if name.endswith(ending)), names[0] if names else "")


def _stamp_s(message: Any, start_s: int) -> float:
    """Return the stamp of a message since the first message of the bag."""
    return float(message.header.stamp.sec - start_s + message.header.stamp.nanosec / S_NS)


def _add_sample(facts: Facts, message: Any, start_s: int) -> None:
    rate = message.angular_velocity
    force = message.linear_acceleration
    attitude = message.orientation
    facts.imu_frame = message.header.frame_id
    facts.samples.append(
        SampleRow(
            _stamp_s(message, start_s),
            (rate.x, rate.y, rate.z),
            (force.x, force.y, force.z),
            (attitude.x, attitude.y, attitude.z, attitude.w),
            (
                float(message.orientation_covariance[0]),
                float(message.angular_velocity_covariance[0]),
                float(message.linear_acceleration_covariance[0]),
            ),
        )
    )


def _add_cloud(facts: Facts, message: Any, start_s: int) -> None:
    names = [column.name for column in message.fields]
    order = ">" if message.is_bigendian else "<"
    kinds = [np.dtype(order + _KINDS.get(column.datatype, "u1")) for column in message.fields]
    layout: Any = {"names": names, "formats": kinds, "offsets": [column.offset for column in message.fields]}
    layout["itemsize"] = message.point_step
    points: AnyArray = np.frombuffer(message.data, np.dtype(layout))
    facts.frame = message.header.frame_id
    facts.fields = dict(zip(names, kinds, strict=True))
    facts.time_name = next((name for name in TIME_NAMES if name in names), "")
    xyz = np.stack([points[axis] for axis in "xyz"], axis=1).astype(np.float64)
    is_finite: NDArray[np.bool_] = np.asarray(np.isfinite(xyz).all(axis=1))
    range_m: F8 = np.linalg.norm(np.where(is_finite[:, None], xyz, 0.0), axis=1)
    is_hit: NDArray[np.bool_] = np.asarray(range_m > 0.0)
    times = points[facts.time_name].astype(np.float64) if facts.time_name else np.empty(0)
    has_times = bool(len(times) and np.isfinite(times).all())
    ring: AnyArray = points["ring"] if "ring" in names else np.zeros(len(points))
    azimuth_deg = np.degrees(np.arctan2(xyz[is_hit, 1], xyz[is_hit, 0]))
    hit_times = times[is_hit] if has_times else np.zeros(len(azimuth_deg))
    facts.clouds.append(
        CloudRow(
            _stamp_s(message, start_s),
            points=len(azimuth_deg),
            is_sparse=not message.is_dense or not is_finite.all(),
            has_times=has_times,
            earliest=float(times.min()) if has_times else 0.0,
            latest=float(times.max()) if has_times else 0.0,
            last=float(times[-1]) if has_times else 0.0,
            turned_deg=_turned_deg(azimuth_deg, hit_times, ring[is_hit]),
            range_m=float(np.median(range_m[is_hit])) if is_hit.any() else 0.0,
            sectors=_sectors(azimuth_deg),
        )
    )
    if "ring" in names and len(facts.clouds) <= _RING_SCANS:
        _add_rings(facts, ring[is_hit], xyz[is_hit, 2] / range_m[is_hit])


def _add_rings(facts: Facts, ring: AnyArray, sine: F8) -> None:
    """Add the sines of elevation (n,) of points to the sums of their rings (n,)."""
    numbers: AnyArray = np.where(np.isfinite(ring), ring, -1)
    for number in np.unique(numbers).tolist():
        in_ring = np.equal(numbers, number)
        total = facts.rings.setdefault(int(number), [0.0, 0.0])
        total[0] += float(sine[in_ring].sum())
        total[1] += int(in_ring.sum())


def _turned_deg(azimuth_deg: F8, times: F8, ring: AnyArray) -> float:
    """Return the azimuth that the points (n,) of a message pass through.

    The order is that of their times; without times, that of the message within a ring, as messages may be
    sorted by ring.
    """
    if len(times) and np.ptp(times) > 0:
        return _winding_deg(azimuth_deg[np.argsort(times, kind="stable")])
    parts_deg = (azimuth_deg[np.asarray(ring == number)] for number in np.unique(ring))
    windings_deg = [_winding_deg(part_deg) for part_deg in parts_deg if len(part_deg) >= _RING_POINTS]
    return float(np.median(windings_deg)) if windings_deg else 0.0


def _winding_deg(azimuth_deg: F8) -> float:
    """Return the size of the sum of steps in azimuth, each of at most half a turn."""
    step_deg = (np.diff(azimuth_deg) + 180.0) % 360.0 - 180.0
    return abs(float(step_deg.sum()))


def _sectors(azimuth_deg: F8) -> int:
    """Return the sectors that hold a point, as bits."""
    numbers = np.unique(np.floor(azimuth_deg * (SECTORS / 360.0)).astype(np.int64) % SECTORS)
    return sum(1 << number for number in numbers.tolist())


def _add_moving(facts: Facts, message: Any, _: int) -> None:
    for edge in message.transforms:
        parents = facts.parents.setdefault(edge.child_frame_id.lstrip("/"), set())
        parents.add(edge.header.frame_id.lstrip("/"))


def _add_fixed(facts: Facts, message: Any, start_s: int) -> None:
    from scipy.spatial.transform import Rotation

    _add_moving(facts, message, start_s)
    for edge in message.transforms:
        p = edge.transform.translation
        q = edge.transform.rotation
        T = np.eye(4)
        T[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
        T[:3, 3] = (p.x, p.y, p.z)
        # A second parent gives a separate finding.
        facts.fixed.setdefault(edge.child_frame_id.lstrip("/"), (edge.header.frame_id.lstrip("/"), T))
