"""Check of a bag from any recorder for a SLAM program; findings name the parameter to set."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vlp16emu.errors import CaptureError
from vlp16emu.extras.slam.configure import Program, pose_names, programs_named
from vlp16emu.libraries import of_extra
from vlp16emu.trees import Tree
from vlp16emu.types import F8, AnyArray
from vlp16emu.units import S_NS

TIME_NAMES = ("time", "t", "timestamp", "time_stamp", "timestamps", "stamps", "offset_time")
"""Names of the time field in the programs of the table."""
_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # of sensor_msgs/PointField
_CLOUD = "sensor_msgs/msg/PointCloud2"
_IMU = "sensor_msgs/msg/Imu"
_RING_SCANS = 20  # scans whose rings are checked
_SMOOTHED_S = 0.1  # IMU samples are averaged over this time to find rest
_RESTS_RAD_S = 0.15
_RESTS_SHARE = 0.05
"""Highest angular rate, and relative deviation of the specific force from 1 g, of a standing person."""


@dataclass(slots=True)
class Facts:
    """Contents of a bag: clouds and IMU samples of the topics closest to ours, and transforms."""

    topic: str
    imu_topic: str  # empty if there is no inertial unit
    frame: str = ""
    imu_frame: str = ""
    fields: Mapping[str, np.dtype[Any]] = field(default_factory=dict)
    time_name: str = ""
    clouds: list[tuple[float, ...]] = field(default_factory=list)
    """Rows: stamp in s since the first message; earliest, latest, last point time in the field's unit;
    points; 1 if not dense."""
    rings: dict[int, list[float]] = field(
        default_factory=dict
    )  # by ring: sum and number of the sines of elevation
    samples: list[tuple[float, ...]] = field(default_factory=list)
    """Rows: stamp as in `clouds`, angular rate (3), acceleration (3), norm of the quaternion, first
    covariance of attitude, angular rate and acceleration."""
    fixed: dict[str, tuple[str, F8]] = field(
        default_factory=dict
    )  # parent and pose of each frame of /tf_static
    parents: dict[str, set[str]] = field(default_factory=dict)  # all parents of each frame, fixed or moving

    def pose(self, frame: str, of: str) -> F8 | None:
        """Return the fixed pose (4, 4) of `frame` in `of`; None if they are not connected."""
        chains = [dict(self.up(name)) for name in (of, frame)]
        common = next((name for name in chains[1] if name in chains[0]), None)
        return None if common is None else np.linalg.inv(chains[0][common]) @ chains[1][common]

    def up(self, frame: str) -> Iterator[tuple[str, F8]]:
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
    where = str(path)
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            facts = Facts(_topic(reader, _CLOUD, "velodyne_points"), _topic(reader, _IMU, "imu/data"))
            start_s = reader.start_time // S_NS
            read = {
                facts.topic: _add_cloud,
                facts.imu_topic: _add_sample,
                "/tf": _add_moving,
                "/tf_static": _add_fixed,
            }
            for connection, _, raw in reader.messages(
                [one for one in reader.connections if one.topic in read]
            ):
                where = f"{path}, {connection.topic}"
                read[connection.topic](facts, reader.deserialize(raw, connection.msgtype), start_s)
    except Exception as error:  # noqa: BLE001  # rosbags raises errors of any type for damage
        reason = str(error) or type(error).__name__
        raise CaptureError(where, f"no bag: {reason}", "a bag: .mcap, .bag or a folder of ROS 2") from None
    if not facts.clouds:
        where = f" on {facts.topic}" if facts.topic else ""
        raise CaptureError(str(path), f"no point clouds{where}", "messages of sensor_msgs/PointCloud2")
    return facts


def _topic(reader: Any, kind: str, ours: str) -> str:
    """Return the topic of a type that ends with `ours`, else the first; empty if there is none."""
    names = [connection.topic for connection in reader.connections if connection.msgtype == kind]
    return next((name for name in names if name.endswith(ours)), names[0] if names else "")


def _stamp_s(message: Any, start_s: int) -> float:
    return float(message.header.stamp.sec - start_s + message.header.stamp.nanosec / S_NS)


def _add_sample(facts: Facts, message: Any, start_s: int) -> None:
    w = message.angular_velocity
    a = message.linear_acceleration
    q = message.orientation
    kinds = "orientation", "angular_velocity", "linear_acceleration"
    covariances = (float(getattr(message, f"{kind}_covariance")[0]) for kind in kinds)
    length = float(np.sqrt(q.x**2 + q.y**2 + q.z**2 + q.w**2))
    facts.imu_frame = message.header.frame_id
    facts.samples.append((_stamp_s(message, start_s), w.x, w.y, w.z, a.x, a.y, a.z, length, *covariances))


def _add_cloud(facts: Facts, message: Any, start_s: int) -> None:
    names = [number.name for number in message.fields]
    end = "><"[not message.is_bigendian]
    kinds = [np.dtype(end + _KINDS.get(number.datatype, "u1")) for number in message.fields]
    layout: Any = {"names": names, "formats": kinds, "offsets": [number.offset for number in message.fields]}
    layout["itemsize"] = message.point_step
    points: AnyArray = np.frombuffer(message.data, np.dtype(layout))
    facts.frame = message.header.frame_id
    facts.fields = dict(zip(names, kinds, strict=True))
    facts.time_name = next((name for name in TIME_NAMES if name in names), "")
    xyz = np.stack([points[axis] for axis in "xyz"], axis=1)
    holes = np.isnan(xyz).any(axis=1)
    times = points[facts.time_name].astype(np.float64) if len(points) and facts.time_name else np.zeros(1)
    is_sparse = not message.is_dense or holes.any()
    numbers = _stamp_s(message, start_s), times.min(), times.max(), times[-1], len(points), is_sparse
    facts.clouds.append(tuple(map(float, numbers)))
    if "ring" in names and len(facts.clouds) <= _RING_SCANS:
        xyz = xyz[~holes]
        ring = points["ring"][~holes]
        sine = xyz[:, 2] / np.maximum(np.linalg.norm(xyz, axis=1), 1e-9)
        for number in np.unique(ring).tolist():
            total = facts.rings.setdefault(int(number), [0.0, 0.0])
            total[0] += float(sine[ring == number].sum())
            total[1] += int((ring == number).sum())


def _add_moving(facts: Facts, message: Any, _: int) -> None:
    for transform in message.transforms:
        facts.parents.setdefault(transform.child_frame_id.lstrip("/"), set()).add(
            transform.header.frame_id.lstrip("/")
        )


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


def rest_s(imu: F8, rate_hz: float) -> float:
    """Return the time at rest at the start, in seconds, from IMU samples (n, 11)."""
    block = max(round(rate_hz * _SMOOTHED_S), 1)
    rows = len(imu) // block * block
    means = imu[:rows, 1:7].reshape(-1, block, 6).mean(axis=1)
    force = np.linalg.norm(means[:, 3:], axis=1)
    usual = np.median(np.linalg.norm(imu[:, 4:7], axis=1))
    moves = np.abs(means[:, :3]).max(axis=1) > _RESTS_RAD_S
    moves |= np.abs(force - usual) > _RESTS_SHARE * usual
    first = int(np.argmax(moves)) if moves.any() else len(moves)
    return first * block / rate_hz


_UNITS = (("s", 1.0, 0), ("ms", 1e-3, 1), ("us", 1e-6, 2), ("ns", 1e-9, 3))
"""Units of times, and their numbers in FAST-LIO2 and Point-LIO (src/preprocess.h)."""
_EARLY_S = 1e-3  # longest time before the stamp that counts as rounding
_GRAVITY_M_S2 = 9.80665
_TILT_DEG = 30.0  # largest tilt of a body that a person carries
_SWEEP_S = 0.1
_IMU_HZ = 200.0
_SLOW_HZ = 100.0
_BEAMS = 16
"""Rig of the configurations in `protocol/slam`, and the IMU rate below which programs deskew poorly."""


@dataclass(frozen=True, slots=True)
class Unfit:
    """One reason why a bag is not fit for a program with the configuration of `protocol/slam`."""

    program: str
    rule: str
    found: str
    needs: str  # parameter to set, or requirement of the bag; after a semicolon the consequence otherwise

    def __str__(self) -> str:
        remedy, _, otherwise = self.needs.partition("; ")
        return f"{self.program}: {self.rule}: {self.found}; needs {remedy}, otherwise {otherwise}"


@dataclass(frozen=True, slots=True)
class Fitness:
    """Summary of a bag, and its fitness for programs."""

    summary: Tree
    programs: tuple[str, ...]
    findings: tuple[Unfit, ...]

    def of(self, program: str) -> list[Unfit]:
        """Return the findings of a program."""
        return [finding for finding in self.findings if finding.program == program]


class _Row(NamedTuple):
    """A row of the table of rules."""

    rule: str
    broken: Callable[[Any, Program], Any]  # true if values of `_cloud_values` and others break it
    found: str  # format string of the finding, with names of values


ROWS = (
    _Row("cloud-topic", lambda v, _: v["topic"] != "/velodyne_points", "point clouds are on {topic}"),
    _Row("imu-topic", lambda v, _: v["imu"] not in ("", "/imu/data"), "IMU messages are on {imu}"),
    _Row("no-imu", lambda v, _: not v["samples"], "there are no IMU messages"),
    _Row("no-time", lambda v, _: not v["name"], "points have no time field, only {fields}"),
    _Row("time-name", lambda v, _: v["name"] not in ("", "time"), "point times are in the field `{name}`"),
    _Row("time-type", lambda v, _: v["name"] and v["time_type"] != "float32", "point times are {time_type}"),
    _Row(
        "time-unit",
        lambda v, _: v["name"] and v["unit"] != "s",
        "point times are in {unit}: a sweep spans {span:g}",
    ),
    _Row(
        "time-zero",
        lambda v, _: v["name"] and abs(v["early_s"]) > _EARLY_S,
        "point times begin {early_s:+.4g} s from the stamp instead of at 0",
    ),
    _Row(
        "time-last",
        lambda v, _: v["name"] and v["late_scans"],
        "in {late_scans} scans the last point is not the latest",
    ),
    _Row("ring", lambda v, _: v["ring_type"] != "uint16", "`ring` is {ring_type} instead of uint16"),
    _Row("ring-order", lambda v, _: v["misordered"], "ring {misordered}"),
    _Row("beams", lambda v, _: v["rings"] not in (0, _BEAMS), "there are {rings} rings"),
    _Row("density", lambda v, _: v["sparse"], "{sparse} clouds hold NaN, or are not marked as dense"),
    _Row(
        "sweep",
        lambda v, _: abs(v["sweep_s"] / _SWEEP_S - 1) > 0.05,
        "a sweep takes {sweep_s:.4g} s instead of 0.1",
    ),
    _Row("cloud-gaps", lambda v, _: v["gaps"], "{gaps} gaps between scans, up to {gap_s:.3g} s"),
    _Row(
        "gravity-unit",
        lambda v, _: v["samples"] and not 8 < v["norm"] < 12,
        "accelerations have the median {norm:.3g} instead of 9.8",
    ),
    _Row(
        "gyro-unit",
        lambda v, _: v["rate_95"] > 12,
        "angular rates reach {rate_95:.3g}, as in degrees per second",
    ),
    _Row(
        "gravity-axis",
        lambda v, _: v["lean_deg"] > _TILT_DEG,
        "gravity is {lean_deg:.0f} deg off the body's vertical",
    ),
    _Row(
        "imu-rate",
        lambda v, _: v["samples"] and abs(v["hz_imu"] / _IMU_HZ - 1) > 0.02,
        "the IMU has {hz_imu:.1f} samples a second",
    ),
    _Row(
        "imu-slow",
        lambda v, _: v["samples"] and v["hz_imu"] < _SLOW_HZ * 0.98,
        "the IMU has {hz_imu:.1f} samples a second",
    ),
    _Row(
        "imu-gaps",
        lambda v, _: v["imu_gaps"] or v["imu_back"],
        "{imu_gaps} gaps between IMU samples, up to {imu_gap_s:.3g} s, and {imu_back} steps back in time",
    ),
    _Row("attitude", lambda v, _: v["samples"] and v["levelled"] < 1, "IMU messages have no orientation"),
    _Row("covariance", lambda v, _: v["unknown"], "covariances of rate or acceleration begin with -1"),
    _Row(
        "clock",
        lambda v, _: v["samples"] and (v["inside"] < 0.5 or v["back"]),
        "{inside:.0%} of the scans lie within the time of the IMU, which begins {offset_s:+.3f} s after them;"
        " {back} stamps go back",
    ),
    _Row(
        "extrinsics",
        lambda v, _: v["apart_m"] > 1e-3 or v["turned_deg"] > 0.1,
        "lidar and IMU are {apart_m:.3f} m and {turned_deg:.1f} deg apart",
    ),
    _Row("frames", lambda v, _: v["tree"], "{tree}"),
    _Row(
        "frame-base",
        lambda v, _: v["root"] != "base_link",
        "the root of the frames is {root} instead of base_link",
    ),
    _Row("tf-map", lambda v, _: v["edge"], "/tf holds {edge}, which a SLAM program publishes too"),
    _Row(
        "rest",
        lambda v, p: v["samples"] and v["rest_s"] < p.rest_s - 0.2,
        "{rest_s:.1f} s of rest at the start",
    ),
)
"""Rules in the order of findings; a rule applies to the programs that have a text for it in
`programs.toml`."""


def fitness(path: Path, name: str) -> Fitness:
    """Check a bag against the needs of one program, or of all, with the configurations of `protocol/slam`.

    Raises InputError if there is no such program; CaptureError, MissingExtraError as in `read_facts`.
    """
    programs = programs_named(name)
    facts = read_facts(path)
    values = _cloud_values(facts) | _imu_values(facts) | _frame_values(facts)
    keys = ("topic", "clouds", "points", "sweep_s", "imu", "samples", "hz_imu", "norm", "rest_s", "root")
    findings = tuple(
        Unfit(
            program.name, row.rule, row.found.format_map(values), program.needs[row.rule].format_map(values)
        )
        for program in programs
        for row in ROWS
        if row.rule in program.needs and row.broken(values, program)
    )
    return Fitness({key: values[key] for key in keys}, tuple(one.name for one in programs), findings)


def _cloud_values(facts: Facts) -> Tree:
    stamp_s, earliest, latest, last, points, sparse = np.array(facts.clouds).T
    steps_s = np.diff(stamp_s)
    sweep_s = float(np.median(steps_s)) if len(steps_s) else _SWEEP_S
    span = float(np.median(latest - earliest))
    unit, scale, code = min(
        _UNITS, key=lambda row: abs(math.log(max(span, 1e-12) * row[1] / max(sweep_s, 1e-6)))
    )
    kinds = {name: kind.name for name, kind in facts.fields.items()}
    sines = [(ring, total / n) for ring, (total, n) in sorted(facts.rings.items()) if n]
    wrong = (f"{a[0]} is above ring {b[0]}" for a, b in pairwise(sines) if a[1] >= b[1])
    gaps_s = steps_s[steps_s > 1.5 * sweep_s]
    return {
        "topic": facts.topic,
        "clouds": len(stamp_s),
        "points": float(np.median(points)),
        "fields": ", ".join(kinds),
        "name": facts.time_name,
        "time_type": kinds.get(facts.time_name, ""),
        "ring_type": kinds.get("ring", "missing"),
        "unit": unit,
        "scale": scale,
        "code": code,
        "span": span,
        "early_s": float(np.median(earliest)) * scale,
        "late_scans": int(((latest - last) * scale > _EARLY_S).sum()),
        "rings": max(facts.rings, default=-1) + 1,
        "misordered": next(wrong, ""),
        "sparse": int(sparse.sum()),
        "sweep_s": sweep_s,
        "hz": 1.0 / max(sweep_s, 1e-6),
        "columns": 1800 * sweep_s / _SWEEP_S,
        "gaps": len(gaps_s),
        "gap_s": float(gaps_s.max(initial=0.0)),
        "back": int((steps_s <= 0).sum()),
    }


def _imu_values(facts: Facts) -> Tree:
    imu = np.array(facts.samples).reshape(-1, 11)
    stamp_s = np.array([row[0] for row in facts.clouds])
    n = len(imu)
    steps_s = np.diff(imu[:, 0]) if n > 1 else np.full(1, 1.0 / _IMU_HZ)
    usual_s = max(float(np.median(steps_s)), 1e-6)
    quiet_s = rest_s(imu, 1.0 / usual_s) if n else 0.0
    quiet = imu[: max(round(quiet_s / usual_s), 1)] if quiet_s >= 1.0 else imu
    force = quiet[:, 4:7].mean(axis=0) if n else np.array([0.0, 0.0, _GRAVITY_M_S2])
    turn = facts.pose(facts.imu_frame, "base_link")
    up = (force if turn is None else turn[:3, :3] @ force) / max(float(np.linalg.norm(force)), 1e-9)
    inside = ((stamp_s >= imu[0, 0] - usual_s) & (stamp_s <= imu[-1, 0])).mean() if n else 1.0
    return {
        "imu": facts.imu_topic,
        "samples": n,
        "hz_imu": 1.0 / usual_s,
        "imu_s": usual_s,
        "norm": float(np.median(np.linalg.norm(imu[:, 4:7], axis=1))) if n else _GRAVITY_M_S2,
        "rate_95": float(np.quantile(np.abs(imu[:, 1:4]), 0.95)) if n else 0.0,
        "lean_deg": math.degrees(math.acos(float(up[2].clip(-1.0, 1.0)))),
        "imu_gaps": int((steps_s > 3 * usual_s).sum()),
        "imu_gap_s": float(steps_s.max()),
        "imu_back": int((steps_s <= 0).sum()),
        "levelled": int(((imu[:, 7] > 0.5) & (imu[:, 8] != -1)).sum()),
        "unknown": bool((imu[:, 9:11] == -1).any()),
        "inside": float(inside),
        "offset_s": float(imu[0, 0] - stamp_s[0]) if n else 0.0,
        "rest_s": quiet_s,
    }


def _frame_values(facts: Facts) -> Tree:
    lidar = facts.frame
    unit = facts.imu_frame
    roots = [list(facts.up(frame))[-1][0] for frame in (lidar, unit) if frame]
    twice = [(child, parents) for child, parents in facts.parents.items() if len(parents) > 1]
    if twice:
        tree = f"{twice[0][0]} has the parents {' and '.join(sorted(twice[0][1]))}"
    elif len(set(roots)) > 1:
        tree = f"{lidar} and {unit} are not connected"
    else:
        tree = "" if lidar in facts.fixed or lidar == "base_link" else f"no transform leads to {lidar}"
    edges = (
        f"{min(facts.parents[child])} -> {child}"
        for child in ("base_link", lidar, unit)
        if child in facts.parents and child not in facts.fixed
    )
    T = facts.pose(unit, lidar) if unit else None
    apart = np.eye(4) if T is None else T
    return {
        "tree": tree,
        "root": roots[0],
        "edge": next(edges, ""),
        "apart_m": float(np.linalg.norm(apart[:3, 3])),
        "turned_deg": math.degrees(math.acos(((np.trace(apart[:3, :3]) - 1) / 2).clip(-1.0, 1.0))),
        **pose_names("lidar", "imu", apart),
        **pose_names("imu", "lidar", np.linalg.inv(apart)),
    }
