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
_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # types of sensor_msgs/PointField
_CLOUD, _IMU = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Imu"
_RING_SCANS = 20  # scans whose rings are looked at
_SMOOTHED_S = 0.1  # samples of an inertial unit are averaged over this time before rest is looked for
_RESTS_RAD_S, _RESTS_SHARE = 0.15, 0.05
"""A person who stands turns more slowly than this, and feels 1 g within this share."""


@dataclass(slots=True)
class Facts:
    """Contents of a bag: the clouds and the samples of the topics that are most like ours, and the transforms."""

    topic: str
    imu_topic: str  # empty if there is no inertial unit
    frame: str = ""
    imu_frame: str = ""
    fields: Mapping[str, np.dtype[Any]] = field(default_factory=dict)
    time_name: str = ""
    clouds: list[tuple[float, ...]] = field(default_factory=list)
    """Stamp in s since the first message; earliest, latest and last time in the field's own unit; points; 1 if NaN or not dense."""
    rings: dict[int, list[float]] = field(default_factory=dict)  # sums and numbers of sines of the elevation by ring
    samples: list[tuple[float, ...]] = field(default_factory=list)
    """Stamp as those of clouds, angular rate, acceleration, length of the quaternion, first covariances of attitude, angular rate
    and acceleration."""
    fixed: dict[str, tuple[str, NDArray[np.float64]]] = field(default_factory=dict)
    """Parent and pose of each frame of /tf_static."""
    parents: dict[str, set[str]] = field(default_factory=dict)  # all parents of each frame, fixed or moving

    def pose(self, frame: str, of: str) -> NDArray[np.float64] | None:
        """Return the fixed pose (4, 4) of one frame in another; None if they are not connected."""
        chains = [dict(self.up(name)) for name in (of, frame)]
        common = next((name for name in chains[1] if name in chains[0]), None)
        return None if common is None else np.linalg.inv(chains[0][common]) @ chains[1][common]

    def up(self, frame: str) -> Iterator[tuple[str, NDArray[np.float64]]]:
        """Yield the frame and those above it, with its pose in each."""
        T, seen = np.eye(4), set[str]()
        while frame not in seen:
            yield frame, T
            seen.add(frame)
            if frame in self.fixed:
                frame, step = self.fixed[frame]
                T = step @ T


def read_facts(path: Path) -> Facts:
    """Read a bag of ROS 1 or ROS 2 once, message by message.

    Raises CaptureError if it is no bag, is damaged, or holds no point cloud; MissingExtraError if rosbags is not
    installed.
    """
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise MissingExtraError("rosbags", "ros", "reading bags") from None
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            facts = Facts(_topic(reader, _CLOUD, "velodyne_points"), _topic(reader, _IMU, "imu/data"))
            start_s = reader.start_time // S_NS
            read = {facts.topic: _add_cloud, facts.imu_topic: _add_sample, "/tf": _add_moving, "/tf_static": _add_fixed}
            for connection, _, raw in reader.messages([one for one in reader.connections if one.topic in read]):
                read[connection.topic](facts, reader.deserialize(raw, connection.msgtype), start_s)
    except (AnyReaderError, OSError) as error:
        raise CaptureError(str(path), f"no bag: {error}", "a bag: .mcap, .bag or a folder of ROS 2") from None
    if not facts.clouds:
        where = f" on {facts.topic}" if facts.topic else ""
        raise CaptureError(str(path), f"no point clouds{where}", "messages of sensor_msgs/PointCloud2")
    return facts


def _topic(reader: Any, kind: str, ours: str) -> str:
    """Return the topic of a type whose name ends as ours does, else the first; empty without any."""
    names = [one.topic for one in reader.connections if one.msgtype == kind]
    return next((name for name in names if name.endswith(ours)), names[0] if names else "")


def _stamp_s(message: Any, start_s: int) -> float:
    return float(message.header.stamp.sec - start_s + message.header.stamp.nanosec / S_NS)


def _add_sample(facts: Facts, message: Any, start_s: int) -> None:
    w, a, q = message.angular_velocity, message.linear_acceleration, message.orientation
    kinds = "orientation", "angular_velocity", "linear_acceleration"
    covariances = (float(getattr(message, f"{kind}_covariance")[0]) for kind in kinds)
    length = float(np.sqrt(q.x**2 + q.y**2 + q.z**2 + q.w**2))
    facts.imu_frame = message.header.frame_id
    facts.samples.append((_stamp_s(message, start_s), w.x, w.y, w.z, a.x, a.y, a.z, length, *covariances))


def _add_cloud(facts: Facts, message: Any, start_s: int) -> None:
    names, end = [one.name for one in message.fields], "><"[not message.is_bigendian]
    kinds = [np.dtype(end + _KINDS.get(one.datatype, "u1")) for one in message.fields]
    layout: Any = {"names": names, "formats": kinds, "offsets": [one.offset for one in message.fields]}
    layout["itemsize"] = message.point_step
    points: NDArray[Any] = np.frombuffer(message.data, np.dtype(layout))
    facts.frame, facts.fields = message.header.frame_id, dict(zip(names, kinds, strict=True))
    facts.time_name = next((name for name in TIME_NAMES if name in names), "")
    xyz = np.stack([points[axis] for axis in "xyz"], axis=1)
    holes = np.isnan(xyz).any(axis=1)
    times = points[facts.time_name].astype(np.float64) if len(points) and facts.time_name else np.zeros(1)
    is_sparse = not message.is_dense or holes.any()
    numbers = _stamp_s(message, start_s), times.min(), times.max(), times[-1], len(points), is_sparse
    facts.clouds.append(tuple(map(float, numbers)))
    if "ring" in names and len(facts.clouds) <= _RING_SCANS:
        xyz, ring = xyz[~holes], points["ring"][~holes]
        sine = xyz[:, 2] / np.maximum(np.linalg.norm(xyz, axis=1), 1e-9)
        for one in np.unique(ring).tolist():
            total = facts.rings.setdefault(int(one), [0.0, 0.0])
            total[0] += float(sine[ring == one].sum())
            total[1] += int((ring == one).sum())


def _add_moving(facts: Facts, message: Any, _: int) -> None:
    for one in message.transforms:
        facts.parents.setdefault(one.child_frame_id.lstrip("/"), set()).add(one.header.frame_id.lstrip("/"))


def _add_fixed(facts: Facts, message: Any, start_s: int) -> None:
    from scipy.spatial.transform import Rotation

    _add_moving(facts, message, start_s)
    for one in message.transforms:
        p, q, T = one.transform.translation, one.transform.rotation, np.eye(4)
        T[:3, :3], T[:3, 3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), (p.x, p.y, p.z)
        # A second parent is a finding of its own.
        facts.fixed.setdefault(one.child_frame_id.lstrip("/"), (one.header.frame_id.lstrip("/"), T))


def rest_s(imu: NDArray[np.float64], rate_hz: float) -> float:
    """Return for how long a unit rests at the start, from its samples (n, 11)."""
    block = max(round(rate_hz * _SMOOTHED_S), 1)
    rows = len(imu) // block * block
    means = imu[:rows, 1:7].reshape(-1, block, 6).mean(axis=1)
    force, usual = np.linalg.norm(means[:, 3:], axis=1), np.median(np.linalg.norm(imu[:, 4:7], axis=1))
    moves = np.abs(means[:, :3]).max(axis=1) > _RESTS_RAD_S
    moves |= np.abs(force - usual) > _RESTS_SHARE * usual
    first = int(np.argmax(moves)) if moves.any() else len(moves)
    return first * block / rate_hz
