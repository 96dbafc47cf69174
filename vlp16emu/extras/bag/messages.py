"""ROS messages of a sensor, its carrier, an inertial unit, a GNSS receiver and a camera."""

import math
import struct
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from vlp16emu.elementary import inverse, matvec
from vlp16emu.errors import PacketError
from vlp16emu.extras.bag.bag_file import BagFile
from vlp16emu.extras.imu.sampler import GRAVITY_M_S2
from vlp16emu.extras.truth.tables import Rows, columns
from vlp16emu.extras.truth.truth import given_mount, transform
from vlp16emu.packets import (
    DATA_BYTES,
    JUMP_NS,
    PacketClock,
    PacketTable,
    decode_position,
    faults_in,
    packet_row,
    packet_table,
    points_in,
    scan_starts,
    utc_ns_of,
)
from vlp16emu.trees import Table
from vlp16emu.types import AnyArray
from vlp16emu.units import S_NS, US_NS

if TYPE_CHECKING:  # bags without images load no camera
    from vlp16emu.extras.camera.lens import Lens
    from vlp16emu.extras.camera.shot import Shot

_POINT = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")]
)
"""PointXYZIRT of velodyne_pointcloud (pointcloudXYZIRT.cpp, ros-drivers/velodyne): packed, 22 bytes."""
_FLOAT32 = 7  # types of sensor_msgs/PointField
_UINT16 = 4
_FIELDS = [
    (name, offset, _FLOAT32 if kind.kind == "f" else _UINT16, 1)
    for name, (kind, offset, *_) in (_POINT.fields or {}).items()
]
_NO_ESTIMATE = np.array([-1.0, *[0.0] * 8])
"""Covariance of the orientation of an inertial unit that reports none (sensor_msgs/Imu)."""
_EXACT = np.zeros(36)
_CAMERA = "camera_optical_frame"  # its axes are x right, y down, z forward (REP 103)
_UNKNOWN_M2 = 1e6  # variance of the altitude: an RMC sentence has none
_UNKNOWN_RAD2 = math.pi**2 / 3.0  # variance of a uniformly distributed heading, the limit of drift


_ROW_HEAD = struct.Struct("<4q2H")  # `DATA_ROW` up to the azimuth of the first block
_LEAST_STEP_DEG = -1.0
_MOST_STEP_DEG = 180.0
"""Steps of the azimuth within one revolution, whatever the times: `scan_starts` looks at others."""


class _Place(NamedTuple):
    """Where the rotor is at the first pulse of a packet, and when."""

    azimuth_deg: float
    sensor_ns: int
    utc_ns: int

    def is_far(self, other: "_Place") -> bool:
        """Return whether one of the clocks jumps between two packets."""
        return max(abs(other.sensor_ns - self.sensor_ns), abs(other.utc_ns - self.utc_ns)) > JUMP_NS

    def ends_before(self, other: "_Place") -> bool:
        """Return whether a revolution ends between two packets that are not far from each other."""
        if _LEAST_STEP_DEG <= other.azimuth_deg - self.azimuth_deg <= _MOST_STEP_DEG:
            return False
        azimuths_deg = np.array([self.azimuth_deg, other.azimuth_deg])
        return len(scan_starts(azimuths_deg, np.array([self.sensor_ns, other.sensor_ns]))) > 1


class UnitMessages:
    """Writer of the messages that the ROS driver makes from the packets of one sensor.

    A scan ends with the packet that passes azimuth 0, as with the driver's default `cut_angle`, or before a
    jump of a clock. Its stamp is the time of its first packet by `clock`, as with the driver's setting
    `timestamp_first_packet`. Packets after the last cut are no scan.
    """

    def __init__(self, bag: BagFile, frame: str, clock: PacketClock) -> None:
        self._bag = bag
        self._frame = frame
        self._clock = clock
        self._space = f"/{frame}".removesuffix("/velodyne")
        self._last: _Place | None = None  # of the latest packet
        self._factory: int | None = None
        self._sentence = b""
        self._held = list[bytes]()  # rows of the scan so far

    def data(self, stamp_ns: int, payload: bytes, number: int) -> int:
        """Take a data packet, and return UTC of its first pulse; errors of `check`."""
        content = packet_row(number, stamp_ns, payload, self._clock)
        _, _, sensor_ns, utc_ns, _, azimuth_cdeg = _ROW_HEAD.unpack_from(content)
        place = _Place(azimuth_cdeg / 100, sensor_ns, utc_ns)
        ends = False
        if self._last is not None:
            if self._last.is_far(place):
                self._write_scan()
            else:
                ends = self._last.ends_before(place)
        self._held.append(content)
        if ends:
            self._write_scan()
        # A late packet ends no scan.
        if self._last is None or not 0 < self._last.sensor_ns - sensor_ns <= JUMP_NS:
            self._last = place
        return place.utc_ns

    def position(self, stamp_ns: int, payload: bytes) -> int:
        """Take a position packet, and return its UTC; a new sentence becomes a message."""
        fields = decode_position(payload)
        topic = f"{self._space}/nmea_sentence"
        t_ns = self._clock.position_ns(stamp_ns, fields.time_ns // US_NS)
        if fields.sentence not in (b"", self._sentence):
            text = fields.sentence.decode("ascii", "replace").strip()
            self._bag.write(topic, t_ns, "nmea_msgs/msg/Sentence", self._bag.header(t_ns, "gps", topic), text)
        self._sentence = fields.sentence
        return t_ns

    def check(self) -> PacketTable | None:
        """Return the packets of the scan so far, None without any; PacketError if one is no VLP-16 packet."""
        if not self._held:
            return None
        table = packet_table(self._held)
        for fault in faults_in(table, self._factory):
            raise PacketError(f"frame {table['number'][fault.packet]}: {fault.what}", *fault[2:])
        self._factory = int(table["factory"][0])
        return table

    def _write_scan(self) -> None:
        bag = self._bag
        table = self.check()
        if table is None:
            return
        self._held = []
        begin_ns, end_ns = int(table["utc_ns"][0]), int(table["utc_ns"][-1])
        topics = [f"{self._space}/velodyne_{name}" for name in ("packets", "points")]
        payloads = table.view(np.uint8).reshape(len(table), -1)[:, -DATA_BYTES:]
        raw = [
            (bag.time(at_ns), payload)
            for at_ns, payload in zip(table["utc_ns"].tolist(), payloads, strict=True)
        ]
        header = bag.header(begin_ns, self._frame, topics[0])
        bag.write(topics[0], end_ns, "velodyne_msgs/msg/VelodyneScan", header, raw)
        found = points_in(table, keep_repeats=True)  # as the driver does
        points = np.zeros(len(found.ring), _POINT)
        points["x"], points["y"], points["z"] = found.xyz_m.T
        points["intensity"] = found.reflectivity
        points["ring"] = found.ring
        points["time"] = (utc_ns_of(table, found) - begin_ns) / S_NS
        size = len(points), _POINT.itemsize
        header = bag.header(begin_ns, self._frame, topics[1])
        data = points.view(np.uint8)
        what = (header, 1, size[0], _FIELDS, False, size[1], size[0] * size[1], data, True)
        bag.write(topics[1], end_ns, "sensor_msgs/msg/PointCloud2", *what)


class TrueMessages:
    """Writer of the ground truth of a run, from rows of its tables.

    Frames follow REP 105 and REP 103: mounted devices are children of `base_link`, the body of `rig.json`.
    The ground truth has frames of its own, so that a SLAM program can publish `map` to `odom` to `base_link`.

    Parameters
    ----------
    bag : bag to write
    rig : `rig.json`, with the units that are written
    scenario : `scenario.json`; its errors of inertial unit and receiver give the covariances
    frames : frames of these units; the ground truth belongs to the first unit's carrier
    tf : `truth` if the true pose moves `base_link` itself, to view clouds without SLAM
    """

    def __init__(self, bag: BagFile, rig: Table, scenario: Table, frames: Sequence[str], tf: str) -> None:
        self._bag = bag
        self._rig = rig
        self._frames = frames
        imu = scenario.get("imu")
        gps = scenario["gps"]
        keys = ("gyro_noise_rad_s_sqrt_hz", "accel_noise_m_s2_sqrt_hz")
        self._imu = [np.eye(3).ravel() * imu[key] ** 2 * imu["rate_hz"] for key in keys] if imu else []
        tilt_rad2 = (imu["accel_bias_m_s2"] / GRAVITY_M_S2) ** 2 if imu else 0.0
        self._reports_attitude = bool(imu and imu["attitude"])
        self._attitude_rad2 = np.diag([tilt_rad2, tilt_rad2, _UNKNOWN_RAD2 if tilt_rad2 else 0.0]).ravel()
        level_m2 = gps["position_noise_m"] ** 2 + gps["wander_m"] ** 2  # under open sky
        self._place = np.diag([level_m2, level_m2, _UNKNOWN_M2]).ravel()
        body = given_mount(rig["units"][0], "body_T_sensor", true=True)
        followed = "base_link" if body is not None else frames[0]
        self._child = followed if tf == "truth" else f"{followed}_truth"
        self._sensor_T_base = None if body is None or np.array_equal(body, np.eye(4)) else inverse(body)

    def fixed(self, t_ns: int) -> None:
        """Write the fixed transforms from `base_link` to all devices; a spinning device has none."""
        mounts = [given_mount(unit, "body_T_sensor") for unit in self._rig["units"]]
        placed = dict(zip(self._frames, mounts, strict=True))
        if mounts[0] is not None:
            antenna_m = mounts[0][:3, 3] + [0.0, 0.0, self._rig["antenna"]["above_sensor_m"]]
            placed["gps"] = np.column_stack([np.eye(4, 3), [*antenna_m, 1.0]])
        if "imu" in self._rig:
            placed["imu"] = given_mount(self._rig["imu"], "body_T_imu")
        if "camera" in self._rig:
            placed[_CAMERA] = given_mount(self._rig["camera"], "body_T_camera")
        header = self._bag.header(t_ns, "base_link", "/tf_static")
        poses = {child: transform(T[:3, :3], T[:3, 3]) for child, T in placed.items() if T is not None}
        moved = [(header, child, (T["translation_m"], T["quaternion_xyzw"])) for child, T in poses.items()]
        if moved:
            self._bag.write("/tf_static", t_ns, "tf2_msgs/msg/TFMessage", moved)

    def odometry(self, poses: Rows) -> None:
        """Write odometry and transforms of the carrier from poses of the first sensor."""
        if self._sensor_T_base is not None and len(poses):
            poses = _moved_to_base(poses, self._sensor_T_base)
        topic = "/ground_truth/odom"
        names = ("t_ns", "position_m", "quaternion_xyzw", "velocity_m_s", "rate_rad_s")
        for t_ns, *pose_and_rates in columns(poses, *names):
            pose = tuple(pose_and_rates[:2])
            rates = tuple(pose_and_rates[2:])
            what = self._child, (pose, _EXACT), (rates, _EXACT)
            header = self._bag.header(t_ns, "map", topic)
            self._bag.write(topic, t_ns, "nav_msgs/msg/Odometry", header, *what)
            moved = self._bag.header(t_ns, "map", "/tf"), self._child, pose
            self._bag.write("/tf", t_ns, "tf2_msgs/msg/TFMessage", [moved])

    def inertial(self, readings: Rows) -> None:
        """Write measured values at the unit's time stamps, with the covariance of their white noise."""
        attitude_rad2 = self._attitude_rad2 if self._reports_attitude else _NO_ESTIMATE
        names = ("stamp_ns", "attitude_xyzw", "rate_rad_s", "force_m_s2")
        for t_ns, attitude, rate, force in columns(readings, *names):
            what = attitude, attitude_rad2, rate, self._imu[0], force, self._imu[1]
            header = self._bag.header(t_ns, "imu", "/imu/data")
            self._bag.write("/imu/data", t_ns, "sensor_msgs/msg/Imu", header, *what)

    def fixes(self, fixes: Rows) -> None:
        """Write latitude, longitude and validity as the receiver reports; its sentences have no altitude."""
        names = ("t_ns", "valid", "latitude_deg", "longitude_deg")
        for t_ns, valid, *position_deg in columns(fixes, *names):
            # Status -1 is none, service 1 is GPS, covariance 1 is approximated.
            what = (valid - 1, 1), *position_deg, math.nan, self._place, 1
            header = self._bag.header(t_ns, "gps", "/fix")
            self._bag.write("/fix", t_ns, "sensor_msgs/msg/NavSatFix", header, *what)

    def image(self, lens: "Lens", shot: "Shot") -> None:
        """Write the layers of an image, each with its intrinsics as drivers of depth cameras publish them.

        Depth is in metres, NaN where nothing is met (REP 118); instances are those of points, as signed
        numbers.
        """
        depth_m = np.where(shot.depth_m > 0.0, shot.depth_m, np.float32(np.nan))
        instance = shot.instance.view(np.int32)
        layers = {
            "rgb": ("rgb8", shot.rgb),
            "depth": ("32FC1", depth_m),
            "semantic": ("8UC1", shot.semantic),
            "part": ("8UC1", shot.part),
            "instance": ("32SC1", instance),
        }
        size = lens.height, lens.width
        straight = np.column_stack([lens.matrix, np.zeros(3)])  # of images whose distortion is removed
        matrices = np.array(lens.distortion), lens.matrix.ravel(), np.eye(3).ravel(), straight.ravel()
        whole = 0, 0, 0, 0, False  # region of interest
        for layer, (encoding, pixels) in layers.items():
            topic = f"/camera/{layer}/image_raw"
            header = self._bag.header(shot.t_ns, _CAMERA, topic)
            data = np.ascontiguousarray(pixels).view(np.uint8).ravel()
            what = header, *size, encoding, False, len(data) // lens.height, data
            self._bag.write(topic, shot.t_ns, "sensor_msgs/msg/Image", *what)
            topic = f"/camera/{layer}/camera_info"
            header = self._bag.header(shot.t_ns, _CAMERA, topic)
            info = header, *size, "plumb_bob", *matrices, 0, 0, whole
            self._bag.write(topic, shot.t_ns, "sensor_msgs/msg/CameraInfo", *info)


def _moved_to_base(poses: Rows, sensor_T_base: AnyArray) -> Rows:
    """Return the poses and rates of a base from those of a sensor that is fixed to it."""
    from scipy.spatial.transform import Rotation

    # Products of our own: those of `Rotation.apply` differ by processor.
    sensor_R_base = sensor_T_base[:3, :3]
    arm_m = sensor_T_base[:3, 3]
    world_R_sensor = Rotation.from_quat(poses["quaternion_xyzw"])
    velocity_m_s = poses["velocity_m_s"] + np.cross(poses["rate_rad_s"], arm_m)
    turned = world_R_sensor * Rotation.from_matrix(sensor_R_base)
    moved = poses.copy()
    moved["position_m"] += matvec(world_R_sensor.as_matrix(), arm_m)
    moved["quaternion_xyzw"] = turned.as_quat(canonical=True)
    moved["velocity_m_s"] = matvec(sensor_R_base.T, velocity_m_s)
    moved["rate_rad_s"] = matvec(sensor_R_base.T, poses["rate_rad_s"])
    return moved
