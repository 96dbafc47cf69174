"""The messages that ROS has of such a sensor, its carrier, an inertial unit and a receiver."""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import PacketError
from vlp16emu.extras.bag.bag_file import BagFile
from vlp16emu.packets import (
    DATA_PAYLOAD,
    JUMP_NS,
    PacketClock,
    data_fields,
    decode_data,
    decode_position,
    faults_in,
    scan_starts,
)
from vlp16emu.units import HOUR_NS, S_NS, US_NS

_POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")])
"""PointXYZIRT of velodyne_pointcloud (pointcloudXYZIRT.cpp, ros-drivers/velodyne): packed, 22 bytes."""
_FLOAT32, _UINT16 = 7, 4
"""Types of sensor_msgs/PointField."""
_FIELDS = [
    (name, offset, _FLOAT32 if kind.kind == "f" else _UINT16, 1)
    for name, (kind, offset, *_) in (_POINT.fields or {}).items()
]
_LEVEL, _NO_ESTIMATE = (0.0, 0.0, 0.0, 1.0), np.array([-1.0, *[0.0] * 8])
"""Orientation of an inertial unit that knows none, and the covariance that says so (sensor_msgs/Imu)."""
_EXACT = np.zeros(36)
_UNKNOWN_M2 = 1e6
"""Variance of the height, which an RMC sentence does not have."""


class UnitMessages:
    """Writes what the driver makes of the packets of one sensor.

    A scan ends with the packet that passes azimuth 0, as the driver's default `cut_angle` has it, or before a jump of a clock. It
    has the stamp of its first packet, as with the driver's setting `timestamp_first_packet`, by `clock`. What is left after the
    last cut is no scan.
    """

    def __init__(self, bag: BagFile, frame: str, clock: PacketClock) -> None:
        self._bag, self._frame, self._clock = bag, frame, clock
        self._space = f"/{frame}".removesuffix("/velodyne")
        self._last: tuple[float, int, int] | None = None
        """Azimuth of the latest packet, and its time by the sensor's clock and by the chosen one."""
        self._factory: int | None = None
        self._sentence = b""
        self._held: list[tuple[int, bytes, int]] = []

    def data(self, stamp_ns: int, payload: bytes, number: int) -> int:
        """Take a data packet, and return UTC of its first pulse; errors as of `check`."""
        fields = np.frombuffer(payload, DATA_PAYLOAD)[0]
        stamps = stamp_ns, int(fields["timestamp_us"]), int(fields["return_mode"])
        azimuth_deg, (sensor_ns, t_ns) = fields["blocks"]["azimuth_cdeg"][0] / 100, self._clock.packet_ns(*stamps)
        ends = False
        if self._last is not None:
            last_deg, last_ns, last_t_ns = self._last
            if max(abs(sensor_ns - last_ns), abs(t_ns - last_t_ns)) > JUMP_NS:
                self._write_scan()
            else:
                ends = len(scan_starts(np.array([last_deg, azimuth_deg]), np.array([last_ns, sensor_ns]))) > 1
        self._held.append((t_ns, payload, number))
        if ends:
            self._write_scan()
        if self._last is None or not 0 < self._last[1] - sensor_ns <= JUMP_NS:  # a packet that comes late ends no scan
            self._last = azimuth_deg, sensor_ns, t_ns
        return t_ns

    def position(self, stamp_ns: int, payload: bytes) -> int:
        """Take a position packet, and return its UTC; a new sentence becomes a message."""
        fields, topic = decode_position(payload), f"{self._space}/nmea_sentence"
        t_ns = self._clock.position_ns(stamp_ns, fields.time_ns // US_NS)
        if fields.sentence not in (b"", self._sentence):
            text = fields.sentence.decode("ascii", "replace").strip()
            self._bag.write(topic, t_ns, "nmea_msgs/msg/Sentence", self._bag.header(t_ns, "gps", topic), text)
        self._sentence = fields.sentence
        return t_ns

    def check(self) -> NDArray[np.uint8]:
        """Return the payloads (n, 1206) of the scan so far; PacketError if one of them is not a VLP-16's."""
        payloads = np.frombuffer(b"".join(payload for _, payload, _ in self._held), np.uint8)
        payloads = payloads.reshape(len(self._held), DATA_PAYLOAD.itemsize)
        if len(payloads):
            fields = data_fields(payloads)
            for fault in faults_in(fields, self._factory):
                raise PacketError(f"frame {self._held[fault.packet][2]}: {fault.what}", *fault[2:])
            self._factory = int(fields["factory"][0])
        return payloads

    def _write_scan(self) -> None:
        """Write the packets of a scan, and their points."""
        bag, payloads, t_ns = self._bag, self.check(), np.array([t_ns for t_ns, _, _ in self._held])
        if not self._held:
            return
        self._held = []
        begin_ns, end_ns = int(t_ns[0]), int(t_ns[-1])
        topics = [f"{self._space}/velodyne_{name}" for name in ("packets", "points")]
        raw = [(bag.time(at_ns), payload) for at_ns, payload in zip(t_ns.tolist(), payloads, strict=True)]
        header = bag.header(begin_ns, self._frame, topics[0])
        bag.write(topics[0], end_ns, "velodyne_msgs/msg/VelodyneScan", header, raw)
        found = decode_data(payloads, keep_no_returns=False)
        clock_ns = data_fields(payloads)["timestamp_us"].astype(np.int64) * US_NS
        since_packet_ns = (found.time_ns - clock_ns[found.packet]) % HOUR_NS
        points = np.zeros(len(found.ring), _POINT)
        points["x"], points["y"], points["z"] = found.xyz_m.T
        points["intensity"], points["ring"] = found.reflectivity, found.ring
        points["time"] = (t_ns[found.packet] + since_packet_ns - begin_ns) / S_NS
        size = len(points), _POINT.itemsize
        header, data = bag.header(begin_ns, self._frame, topics[1]), points.view(np.uint8)
        what = (header, 1, size[0], _FIELDS, False, size[1], size[0] * size[1], data, True)
        bag.write(topics[1], end_ns, "sensor_msgs/msg/PointCloud2", *what)


class TrueMessages:
    """Writes what was true of a run; poses are x y z and quaternion x y z w.

    Parameters
    ----------
    bag : to be written
    imu, gps : sections of the scene, by whose errors messages have their covariance; None of what is not there
    """

    def __init__(self, bag: BagFile, imu: dict[str, Any] | None, gps: dict[str, Any]) -> None:
        self._bag = bag
        keys = ("gyro_noise_rad_s_sqrt_hz", "accel_noise_m_s2_sqrt_hz")
        self._imu = [np.eye(3).ravel() * imu[key] ** 2 * imu["rate_hz"] for key in keys] if imu else []
        level_m2 = gps["position_noise_m"] ** 2 + gps["wander_m"] ** 2  # under open sky
        self._place = np.diag([level_m2, level_m2, _UNKNOWN_M2]).ravel()

    def fixed(self, t_ns: int, rig: dict[str, Any], frame: str) -> None:
        """Write the fixed transforms: body in the first unit, inertial unit in the body; what spins has none."""
        body, found = rig["units"][0]["body_T_sensor"], []
        if "spin_hz" not in body:
            found.append((frame, "base_link", np.linalg.inv(np.array(body["matrix"]))))
            if "imu" in rig and "spin_hz" not in rig["imu"]["body_T_imu"]:
                found.append(("base_link", "imu", np.array(rig["imu"]["body_T_imu"]["matrix"])))
        header = partial(self._bag.header, t_ns, topic="/tf_static")
        moved = [(header(frame=parent), child, _placed(T)) for parent, child, T in found]
        if found:
            self._bag.write("/tf_static", t_ns, "tf2_msgs/msg/TFMessage", moved)

    def odometry(self, frame: str, t_ns: int, numbers: Sequence[float]) -> None:
        """Write a pose (7,) as odometry, with velocity and angular rate (6,) in its own axes, and as transform."""
        topic = f"/{frame}".removesuffix("/velodyne") + "/ground_truth/odom"
        placed, header = (numbers[:3], numbers[3:7]), self._bag.header(t_ns, "map", topic)
        twist = (numbers[7:10], numbers[10:]), _EXACT
        self._bag.write(topic, t_ns, "nav_msgs/msg/Odometry", header, frame, (placed, _EXACT), twist)
        moved = self._bag.header(t_ns, "map", "/tf"), frame, placed
        self._bag.write("/tf", t_ns, "tf2_msgs/msg/TFMessage", [moved])

    def inertial(self, t_ns: int, rates: Sequence[float]) -> None:
        """Write angular rate and specific force, whose white noise makes their covariance; there is no orientation."""
        what = _LEVEL, _NO_ESTIMATE, rates[:3], self._imu[0], rates[3:], self._imu[1]
        header = self._bag.header(t_ns, "imu", "/imu/data")
        self._bag.write("/imu/data", t_ns, "sensor_msgs/msg/Imu", header, *what)

    def fix(self, t_ns: int, said: Sequence[float]) -> None:
        """Write latitude, longitude and validity as the receiver says; its sentences have no height."""
        latitude_deg, longitude_deg, valid = said
        # Status -1 is none, service 1 is GPS, covariance 1 is approximated.
        what = (int(valid) - 1, 1), latitude_deg, longitude_deg, math.nan, self._place, 1
        header = self._bag.header(t_ns, "gps", "/fix")
        self._bag.write("/fix", t_ns, "sensor_msgs/msg/NavSatFix", header, *what)


def _placed(T: NDArray[np.float64]) -> tuple[list[float], list[float]]:
    """Return translation and quaternion of a rigid transform."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True) + 0.0  # no -0.0
    return T[:3, 3].tolist(), turn.tolist()
