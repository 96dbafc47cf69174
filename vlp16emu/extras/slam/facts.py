"""What is in a bag that a SLAM program is to read, whoever recorded it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import CaptureError, MissingExtraError
from vlp16emu.units import S_NS

TIME_NAMES = ("time", "t", "timestamp", "time_stamp", "timestamps", "stamps", "offset_time")
"""Fields of times, as the programs of the table name them."""
_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""Types of sensor_msgs/PointField."""
_CLOUD, _IMU = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Imu"
_RING_SCANS = 20
"""Scans whose rings are looked at."""
_SMOOTHED_S = 0.1
"""Samples of an inertial unit are averaged over this time before rest is looked for."""
_RESTS_RAD_S, _RESTS_SHARE = 0.15, 0.05
"""A person who stands turns more slowly than this, and feels 1 g within this share."""


@dataclass(slots=True)
class Clouds:
    """Columns of the n clouds of the topic that is most like ours."""

    topic: str = ""
    frame: str = ""
    fields: Mapping[str, np.dtype[Any]] = field(default_factory=dict)
    time_name: str | None = None
    rows: list[tuple[float, ...]] = field(default_factory=list)
    """Stamp in s since the first message; first, earliest, latest and last time in the field's own unit; points; NaN or not dense."""
    rings: dict[int, list[float]] = field(default_factory=dict)
    """Sums and numbers of sines of the elevation by ring."""


@dataclass(slots=True)
class Facts:
    """Contents of a bag."""

    clouds: Clouds
    imu_topic: str
    imu_frame: str
    imu: NDArray[np.float64]
    """(n, 11): stamp in s as those of clouds, angular rate, acceleration, length of the quaternion, first covariances of
    attitude, angular rate and acceleration."""
    fixed: dict[str, tuple[str, NDArray[np.float64]]]
    """Parent and pose of each frame of /tf_static."""
    parents: dict[str, set[str]]
    """All parents of each frame, fixed or moving."""

    def pose(self, frame: str, of: str) -> NDArray[np.float64] | None:
        """Return the fixed pose (4, 4) of one frame in another; None if they are not connected."""
        chains = [dict(self.up(name)) for name in (of, frame)]
        if not (common := [name for name in chains[1] if name in chains[0]]):
            return None
        return np.linalg.inv(chains[0][common[0]]) @ chains[1][common[0]]

    def up(self, frame: str) -> Iterator[tuple[str, NDArray[np.float64]]]:
        """Yield the frame and those above it, with its pose in each."""
        T, seen = np.eye(4), set[str]()
        while frame not in seen:
            yield frame, T
            seen.add(frame)
            if frame not in self.fixed:
                return
            frame, step = self.fixed[frame]
            T = step @ T

    def rest_s(self) -> float:
        """Return for how long the unit rests at the start."""
        if len(self.imu) < 2:
            return 0.0
        rate_hz = 1.0 / max(float(np.median(np.diff(self.imu[:, 0]))), 1e-6)
        block = max(round(rate_hz * _SMOOTHED_S), 1)
        rows = len(self.imu) // block * block
        means = self.imu[:rows, 1:7].reshape(-1, block, 6).mean(axis=1)
        force, usual = np.linalg.norm(means[:, 3:], axis=1), np.median(np.linalg.norm(self.imu[:, 4:7], axis=1))
        moves = np.abs(means[:, :3]).max(axis=1) > _RESTS_RAD_S
        moves |= np.abs(force - usual) > _RESTS_SHARE * usual
        first = int(np.argmax(moves)) if moves.any() else len(moves)
        return first * block / rate_hz


def read_facts(path: Path) -> Facts:
    """Read a bag of ROS 1 or ROS 2 once, message by message.

    Raises
    ------
    CaptureError
        If it is no bag, is damaged, or holds no point cloud
    MissingExtraError
        If rosbags is not installed
    """
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise MissingExtraError("rosbags", "ros", "reading bags") from None
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            return _read(path, reader)
    except (AnyReaderError, OSError) as error:
        raise CaptureError(str(path), f"no bag: {error}", "a bag: .mcap, .bag or a folder of ROS 2") from None


def _read(path: Path, reader: Any) -> Facts:
    topics = {kind: [one.topic for one in reader.connections if one.msgtype == kind] for kind in (_CLOUD, _IMU)}
    topics = {kind: list(dict.fromkeys(names)) for kind, names in topics.items()}
    if not topics[_CLOUD]:
        raise CaptureError(str(path), "no point clouds", "messages of sensor_msgs/PointCloud2")
    cloud, imu = (
        _likest(names, ours) for names, ours in zip(topics.values(), ("velodyne_points", "imu/data"), strict=True)
    )
    facts = Facts(Clouds(topic=cloud), imu, "", np.empty((0, 11)), {}, {})
    wanted, samples = {cloud, imu, "/tf", "/tf_static"}, []
    start_s = reader.start_time // S_NS
    for connection, _, raw in reader.messages([one for one in reader.connections if one.topic in wanted]):
        message = reader.deserialize(raw, connection.msgtype)
        if connection.topic == cloud:
            _add_cloud(facts.clouds, message, start_s)
        elif connection.topic == imu:
            facts.imu_frame = message.header.frame_id
            samples.append(_sample(message, start_s))
        else:
            _add_transforms(facts, message, fixed=connection.topic == "/tf_static")
    if not facts.clouds.rows:
        raise CaptureError(str(path), f"no point clouds on {cloud}", "messages of sensor_msgs/PointCloud2")
    facts.imu = np.array(samples) if samples else facts.imu
    return facts


def _likest(names: list[str], ours: str) -> str:
    """Return the name that ends as ours does, else the first; empty without names."""
    return next((name for name in names if name.endswith(ours)), names[0] if names else "")


def _stamp_s(message: Any, start_s: int) -> float:
    return float(message.header.stamp.sec - start_s + message.header.stamp.nanosec / S_NS)


def _sample(message: Any, start_s: int) -> list[float]:
    w, a, q = message.angular_velocity, message.linear_acceleration, message.orientation
    covariances = (
        message.orientation_covariance,
        message.angular_velocity_covariance,
        message.linear_acceleration_covariance,
    )
    length = float(np.sqrt(q.x**2 + q.y**2 + q.z**2 + q.w**2))
    return [_stamp_s(message, start_s), w.x, w.y, w.z, a.x, a.y, a.z, length, *(float(one[0]) for one in covariances)]


def _add_cloud(clouds: Clouds, message: Any, start_s: int) -> None:
    names, end = [one.name for one in message.fields], "><"[not message.is_bigendian]
    kinds = [np.dtype(end + _KINDS.get(one.datatype, "u1")) for one in message.fields]
    layout: Any = {"names": names, "formats": kinds, "offsets": [one.offset for one in message.fields]}
    layout["itemsize"] = message.point_step
    points: NDArray[Any] = np.frombuffer(message.data, np.dtype(layout))
    clouds.frame, clouds.fields = message.header.frame_id, dict(zip(names, kinds, strict=True))
    clouds.time_name = next((name for name in TIME_NAMES if name in names), None)
    xyz = np.stack([points[axis] for axis in "xyz"], axis=1)
    holes = np.isnan(xyz).any(axis=1)
    times = np.zeros(4)
    if len(points) and clouds.time_name:
        column = points[clouds.time_name].astype(np.float64)
        times = np.array([column[0], column.min(), column.max(), column[-1]])
    is_sparse = not message.is_dense or holes.any()
    clouds.rows.append((_stamp_s(message, start_s), *times.tolist(), float(len(points)), float(is_sparse)))
    if "ring" in names and len(clouds.rows) <= _RING_SCANS:
        xyz, ring = xyz[~holes], points["ring"][~holes]
        sine = xyz[:, 2] / np.maximum(np.linalg.norm(xyz, axis=1), 1e-9)
        for one in np.unique(ring).tolist():
            total = clouds.rings.setdefault(int(one), [0.0, 0.0])
            total[0] += float(sine[ring == one].sum())
            total[1] += int((ring == one).sum())


def _add_transforms(facts: Facts, message: Any, *, fixed: bool) -> None:
    from scipy.spatial.transform import Rotation

    for one in message.transforms:
        child, parent = one.child_frame_id.lstrip("/"), one.header.frame_id.lstrip("/")
        facts.parents.setdefault(child, set()).add(parent)
        if fixed:
            p, q = one.transform.translation, one.transform.rotation
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), (p.x, p.y, p.z)
            facts.fixed.setdefault(child, (parent, T))  # a second parent is a finding of its own
