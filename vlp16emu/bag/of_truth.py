"""The truth of a run as messages of ROS: odometry, transforms, inertial unit and receiver."""

import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import InputError, readable
from vlp16emu.sinks.bag import BagFile, Beat
from vlp16emu.units import S_NS

_UNKNOWN_M2 = 1e6
"""Variance of the height, which an RMC sentence does not have."""


def true_streams(bag: BagFile, folder: Path, frames: list[str], begin_ns: int) -> list[Iterator[Beat]]:
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


def _fixed(bag: BagFile, rig: dict[str, Any], frames: list[str], begin_ns: int) -> Iterator[Beat]:
    """Yield the fixed transforms, once: body in the first unit, inertial unit in the body; what spins has none."""
    from scipy.spatial.transform import Rotation

    def one(parent: str, child: str, T: NDArray[np.float64]) -> Any:
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


def _odometry(bag: BagFile, path: Path, frame: str, begin_ns: int) -> Iterator[Beat]:
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

    for t_ns, pose, rates in _poses(path, begin_ns):
        yield t_ns, partial(write, t_ns, pose, rates)


def _poses(path: Path, begin_ns: int) -> Iterator[tuple[int, list[float], list[list[float]]]]:
    """Yield poses from an instant on, and velocity and angular rate until the next one; the last one keeps those before."""
    from scipy.spatial.transform import Rotation

    before: tuple[int, list[float]] | None = None
    rates = [[0.0] * 3] * 2
    for number, line in _lines(path):
        if line.startswith("#"):
            continue
        try:
            stamp, *numbers = line.split()
            t_ns, pose = _ns(stamp), [float(number) for number in numbers]
            turn = Rotation.from_quat(pose[3:])
        except ValueError:
            expected = "a time, a place and a quaternion"
            raise InputError(f"{path}, line {number}", f"found {line.strip()[:60]}", expected) from None
        if before is not None:
            (t0_ns, pose0), turn0 = before, Rotation.from_quat(before[1][3:])
            step_s = (t_ns - t0_ns) / S_NS
            moved_m = turn0.inv().apply(np.subtract(pose[:3], pose0[:3]))
            turned_rad = (turn0.inv() * turn).as_rotvec()
            rates = [(moved_m / step_s).tolist(), (turned_rad / step_s).tolist()]
            if t0_ns >= begin_ns:
                yield t0_ns, pose0, rates
        before = t_ns, pose
    if before is None or before[0] < begin_ns:
        found = "no poses" if before is None else f"poses until {before[0] / S_NS:.3f} s"
        raise InputError(
            str(path), found, f"poses from the capture's first pulse on, {begin_ns / S_NS:.3f} s"
        )
    yield *before, rates


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the lines of a file of the truth, numbered from 1."""
    with readable(path, "a file of a --truth folder", InputError, most_bytes=2**62), path.open() as lines:
        yield from enumerate(lines, 1)


def _rows(path: Path, begin_ns: int, columns: tuple[str, ...]) -> Iterator[tuple[int, dict[str, float]]]:
    """Yield the numbers in columns of a table from an instant on."""
    lines = _lines(path)
    _, head = next(lines, (0, ""))
    names = head.strip().split(",")
    if missing := {"t_utc_s", *columns} - set(names):
        raise InputError(f"{path}, line 1", f"no column {min(missing)}", f"the columns {', '.join(columns)}")
    for number, line in lines:
        row = dict(zip(names, line.strip().split(","), strict=False))
        try:
            t_ns, values = _ns(row["t_utc_s"]), {name: float(row[name]) for name in columns}
        except (KeyError, ValueError):
            raise InputError(f"{path}, line {number}", f"found {line.strip()[:60]}", "numbers") from None
        if t_ns >= begin_ns:
            yield t_ns, values


def _inertial(bag: BagFile, path: Path, imu: dict[str, Any], begin_ns: int) -> Iterator[Beat]:
    """Yield the readings of the inertial unit, whose white noise makes their covariance; it has no orientation."""
    make, topic, none = bag.make, "/imu/data", np.zeros(9)
    axes = ["w{}_rad_s", "f{}_m_s2"]
    none[0] = -1  # sensor_msgs/Imu: no estimate
    keys = ("gyro_noise_rad_s_sqrt_hz", "accel_noise_m_s2_sqrt_hz")
    rate, force = (np.eye(3).ravel() * imu[key] ** 2 * imu["rate_hz"] for key in keys)

    def write(t_ns: int, row: dict[str, float]) -> None:
        vectors = (
            make("geometry_msgs/msg/Vector3", **{axis: row[name.format(axis)] for axis in "xyz"})
            for name in axes
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

    for t_ns, row in _rows(path, begin_ns, tuple(name.format(axis) for name in axes for axis in "xyz")):
        yield t_ns, partial(write, t_ns, row)


def _fixes(bag: BagFile, path: Path, gps: dict[str, Any], begin_ns: int) -> Iterator[Beat]:
    """Yield what the receiver says, under open sky this exact; its sentences have no height."""
    topic, level_m2 = "/fix", gps["position_noise_m"] ** 2 + gps["wander_m"] ** 2
    covariance = np.diag([level_m2, level_m2, _UNKNOWN_M2]).ravel()

    def write(t_ns: int, row: dict[str, float]) -> None:
        """Write one fix; status -1 is none, service 1 is GPS, covariance 1 is approximated."""
        status = bag.make("sensor_msgs/msg/NavSatStatus", status=int(row["valid"]) - 1, service=1)
        message = bag.make(
            "sensor_msgs/msg/NavSatFix",
            header=bag.header(t_ns, "gps", topic),
            status=status,
            latitude=row["latitude_deg"],
            longitude=row["longitude_deg"],
            altitude=float("nan"),
            position_covariance=covariance,
            position_covariance_type=1,
        )
        bag.write(topic, t_ns, message)

    for t_ns, row in _rows(path, begin_ns, ("latitude_deg", "longitude_deg", "valid")):
        yield t_ns, partial(write, t_ns, row)
