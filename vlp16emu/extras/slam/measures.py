"""Numbers of a bag by name, for the rules of fitness, each from all its messages."""

import math
from itertools import pairwise

import numpy as np

from vlp16emu.extras.slam.configure import pose_names
from vlp16emu.extras.slam.facts import SECTORS, CloudRow, Facts
from vlp16emu.trees import Tree
from vlp16emu.types import F8

SWEEP_S = 0.1
IMU_HZ = 200.0
"""Sweep and IMU rate of the configurations in `protocol/slam`."""
EARLY_S = 1e-3  # longest time before the stamp that counts as rounding
_GRAVITY_M_S2 = 9.80665
_COLUMNS = 1800  # of a sweep of 0.1 s, as in LIO-SAM and LeGO-LOAM
_SMOOTHED_S = 0.1  # IMU samples are averaged over this time to find rest
_REST_RAD_S = 0.15
_REST_SHARE = 0.05
"""Highest angular rate, and relative deviation of the specific force from 1 g, of a standing person."""
_UNITS = (("s", 1.0, 0), ("ms", 1e-3, 1), ("us", 1e-6, 2), ("ns", 1e-9, 3))
"""Units of times, and their numbers in FAST-LIO2 and Point-LIO (src/preprocess.h)."""
_ALIKE = 1.5
"""Ratio up to which the span of point times is that of a sweep, and a step that of its neighbours."""
_WHOLE = 0.1  # deviation of a step between stamps from a whole number of sweeps
_ROUNDED = 0.02  # deviation of a sweep rate from a whole number per second, as sensors have it
_PART = 0.8  # share of the sectors of two messages that each has, if it is part of a turn
_SECTOR_POINTS = 6  # least number of points of a cloud per sector
_MOST_TURNED_DEG = 540.0
_MOST_RINGS = 128  # of the largest sensors
_BIAS_RAD_S = 0.035  # a mean angular rate below 2 deg/s may be a bias
TURNS_DEG = 5.0  # turn of a unit, by its gyroscopes, that an attitude shows
_FIXED = 1e-6  # greatest difference between quaternions of an attitude that never changes


def cloud_values(facts: Facts) -> Tree:
    """Return the values of clouds by the names that the rules use."""
    rows = [row for row in facts.clouds if row.points]
    stamp_s = np.array([row.stamp_s for row in facts.clouds])
    steps_s = np.diff(stamp_s)
    kinds = {name: kind.name for name, kind in facts.fields.items()}
    timed = [row for row in rows if row.has_times]
    span = _median([row.latest - row.earliest for row in timed])
    turned_deg = _median([row.turned_deg for row in rows])
    step_s = _median(steps_s[steps_s > 0], SWEEP_S)
    turns = max(turned_deg / 360.0, 1.0 / SECTORS)
    unit, scale, code = min(_UNITS, key=lambda row: abs(math.log(max(span, 1e-12) * row[1] / step_s)))
    turn_s = span * scale / turns if timed and span else step_s / turns
    sweeps = step_s / turn_s
    is_rare = sweeps > _ALIKE and abs(sweeps - round(sweeps)) < _WHOLE  # scans are missing
    sweep_s = _at_whole_rate(turn_s if is_rare else step_s)
    gaps_s = steps_s[steps_s > _ALIKE * sweep_s]
    return {
        "topic": facts.topic,
        "clouds": len(stamp_s),
        "empty": len(stamp_s) - len(rows),
        "points": _median([row.points for row in facts.clouds]),
        "range_m": _median([row.range_m for row in rows]),
        "fields": ", ".join(kinds),
        "name": facts.time_name,
        "time_type": kinds.get(facts.time_name, ""),
        "times": _times_fault(rows) if facts.time_name else "",
        "unit": unit,
        "scale": scale,
        "code": code,
        "span": span,
        "step_s": step_s,
        "is_other_span": bool(timed) and not is_rare and not 1 / _ALIKE < sweeps < _ALIKE,
        "early_s": _median([row.earliest for row in timed]) * scale,
        "late_scans": sum((row.latest - row.last) * scale > EARLY_S for row in timed),
        "message_deg": turned_deg,
        "is_no_turn": turned_deg > _MOST_TURNED_DEG or _is_part(rows),
        "ring_type": kinds.get("ring", "missing"),
        "sparse": sum(row.is_sparse for row in facts.clouds),
        "sweep_s": sweep_s,
        "hz": 1.0 / sweep_s,
        "columns": _COLUMNS * sweep_s / SWEEP_S,
        "gaps": len(gaps_s),
        "gap_s": float(gaps_s.max(initial=0.0)),
        "same": int((steps_s == 0).sum()),
        "back": int((steps_s < 0).sum()),
        **_ring_values(facts),
    }


def _ring_values(facts: Facts) -> Tree:
    """Return the values of rings: their number, and what is wrong with their numbers or their order."""
    numbers = sorted(facts.rings)
    sines = [(ring, total / n) for ring, (total, n) in sorted(facts.rings.items()) if n]
    misordered = (f"{low[0]} is above ring {high[0]}" for low, high in pairwise(sines) if low[1] >= high[1])
    rings = max(numbers, default=-1) + 1
    is_sound = not numbers or (numbers[0] >= 0 and 2 <= rings <= min(_MOST_RINGS, 2 * len(numbers)))
    return {
        "rings": rings,
        "misordered": next(misordered, ""),
        "rings_fault": "" if is_sound else f"{len(numbers)} different values, up to {rings - 1}",
    }


def _median(values: "F8 | list[float]", otherwise: float = 0.0) -> float:
    return float(np.median(values)) if len(values) else otherwise


def _at_whole_rate(sweep_s: float) -> float:
    """Return the time of a sweep at a whole number per second if near, as revolutions end between packets."""
    hz = max(round(1.0 / sweep_s), 1)
    return 1.0 / hz if abs(sweep_s * hz - 1.0) < _ROUNDED else sweep_s


def _times_fault(rows: list[CloudRow]) -> str:
    """Return what is wrong with the point times of all messages; empty if they may be times."""
    damaged = sum(not row.has_times for row in rows)
    if damaged:
        return f"point times are NaN or infinite in {damaged} clouds"
    equal = [row for row in rows if row.points > 1 and row.earliest == row.latest]
    if 2 * len(equal) <= len(rows):
        return ""
    if any(row.latest for row in equal):
        return "all points of a message have one time"
    return "all point times are 0"


def _is_part(rows: list[CloudRow]) -> bool:
    """Return True if messages that follow one another cover different parts of a turn.

    A restricted field of view is in the same place in each message.
    """
    distinct = SECTORS
    while distinct > SECTORS // 8 and _median([row.points for row in rows]) < _SECTOR_POINTS * distinct:
        distinct //= 2
    covered = [_joined(row.sectors, SECTORS // distinct) for row in rows]
    shares = [
        (first.bit_count() + second.bit_count()) / 2 / (first | second).bit_count()
        for first, second in pairwise(covered)
    ]
    return bool(shares) and _median(shares) < _PART


def _joined(sectors: int, group_size: int) -> int:
    """Return sectors, as bits, joined to groups; bit i is set if any sector of group i is covered."""
    mask = (1 << group_size) - 1
    groups = range(SECTORS // group_size)
    return sum(1 << group for group in groups if sectors >> (group * group_size) & mask)


def imu_values(facts: Facts) -> Tree:
    """Return the values of IMU samples by the names that the rules use.

    Samples that repeat a stamp or hold NaN count for themselves alone.
    """
    stamp_s = np.array([row.stamp_s for row in facts.samples])
    motion = np.array([row.rate + row.force for row in facts.samples]).reshape(-1, 6)
    attitude = np.array([row.attitude for row in facts.samples]).reshape(-1, 4)
    covariances = np.array([row.covariances for row in facts.samples]).reshape(-1, 3)
    cloud_stamp_s = np.array([row.stamp_s for row in facts.clouds])
    n = len(stamp_s)
    steps_s = np.diff(stamp_s)
    is_repeat = np.append(False, steps_s == 0)[:n]
    is_number = np.isfinite(motion).all(axis=1)
    motion = motion[is_number & ~is_repeat]
    steps_s = np.diff(stamp_s[~is_repeat])
    usual_s = max(_median(steps_s, 1.0 / IMU_HZ), 1e-6)
    quiet_s = rest_s(motion, 1.0 / usual_s) if len(motion) else 0.0
    quiet = motion[: max(round(quiet_s / usual_s), 1)] if quiet_s >= 1.0 else motion
    force = quiet[:, 3:].mean(axis=0) if len(quiet) else np.array([0.0, 0.0, _GRAVITY_M_S2])
    base_T_imu = facts.pose(facts.imu_frame, "base_link")
    base_force = force if base_T_imu is None else base_T_imu[:3, :3] @ force
    up = base_force / max(float(np.linalg.norm(force)), 1e-9)
    is_inside = (cloud_stamp_s >= stamp_s[0] - usual_s) & (cloud_stamp_s <= stamp_s[-1]) if n else np.ones(1)
    return {
        "imu": facts.imu_topic,
        "samples": n,
        "no_numbers": int(n - is_number.sum()),
        "imu_same": int(is_repeat.sum()),
        "hz_imu": 1.0 / usual_s,
        "imu_s": usual_s,
        "norm": _median(np.linalg.norm(motion[:, 3:], axis=1), _GRAVITY_M_S2),
        "rate_95": float(np.quantile(np.abs(motion[:, :3]), 0.95)) if len(motion) else 0.0,
        "lean_deg": math.degrees(math.acos(float(up[2].clip(-1.0, 1.0)))),
        "imu_gaps": int((steps_s > 3 * usual_s).sum()),
        "imu_gap_s": float(steps_s.max(initial=0.0)),
        "imu_back": int((steps_s < 0).sum()),
        "levelled": int(((np.linalg.norm(attitude, axis=1) > 0.5) & (covariances[:, 0] != -1)).sum()),
        "turned_imu_deg": _turned_imu_deg(motion[:, :3], usual_s),
        "is_fixed_attitude": bool(n and np.ptp(attitude, axis=0).max() < _FIXED),
        "unknown": bool((covariances[:, 1:] == -1).any()),
        "inside": float(is_inside.mean()),
        "offset_s": float(stamp_s[0] - cloud_stamp_s[0]) if n else 0.0,
        "rest_s": quiet_s,
    }


def _turned_imu_deg(rate: F8, step_s: float) -> float:
    """Return the greatest turn about an axis, from angular rates (n, 3) at even steps."""
    if not len(rate):
        return 0.0
    usual = np.median(rate, axis=0)
    turned = np.cumsum(rate - np.where(np.abs(usual) < _BIAS_RAD_S, usual, 0.0), axis=0) * step_s
    return math.degrees(float(np.ptp(turned, axis=0).max()))


def rest_s(motion: F8, rate_hz: float) -> float:
    """Return the time at rest at the start, in seconds, from angular rates and specific forces (n, 6)."""
    block = max(round(rate_hz * _SMOOTHED_S), 1)
    rows = len(motion) // block * block
    means = motion[:rows].reshape(-1, block, 6).mean(axis=1)
    force = np.linalg.norm(means[:, 3:], axis=1)
    usual = np.median(np.linalg.norm(motion[:, 3:], axis=1))
    moves = np.abs(means[:, :3]).max(axis=1) > _REST_RAD_S
    moves |= np.abs(force - usual) > _REST_SHARE * usual
    first = int(np.argmax(moves)) if moves.any() else len(moves)
    return first * block / rate_hz


def frame_values(facts: Facts) -> Tree:
    """Return the values of transforms by the names that the rules use."""
    lidar = facts.frame
    unit = facts.imu_frame
    roots = [list(facts.ancestors(frame))[-1][0] for frame in (lidar, unit) if frame] or [""]
    edges = (
        f"{min(facts.parents[child])} -> {child}"
        for child in ("base_link", lidar, unit)
        if child in facts.parents and child not in facts.fixed
    )
    apart = _pose(facts, unit, lidar)
    return {
        "tree": _tree_fault(facts, set(roots)),
        "root": roots[0],
        "edge": next(edges, ""),
        "is_apart": unit not in ("", lidar) and facts.pose(unit, lidar) is None,
        "lidar": lidar,
        "imu_frame": unit,
        "apart_m": float(np.linalg.norm(apart[:3, 3])),
        "turned_deg": math.degrees(math.acos(((np.trace(apart[:3, :3]) - 1) / 2).clip(-1.0, 1.0))),
        **pose_names("lidar", "imu", apart),
        **pose_names("imu", "lidar", np.linalg.inv(apart)),
        **pose_names("base", "lidar", _pose(facts, lidar, roots[0])),
        **pose_names("base", "imu", _pose(facts, unit, roots[0])),
    }


def _tree_fault(facts: Facts, roots: set[str]) -> str:
    """Return what is wrong with the tree of frames, whose lidar and IMU have these roots; empty if sound."""
    lidar = facts.frame
    for child, parents in facts.parents.items():
        if len(parents) > 1:
            return f"{child} has the parents {' and '.join(sorted(parents))}"
    if len(roots) > 1:
        return f"{lidar} and {facts.imu_frame} are not connected"
    if lidar in facts.fixed or lidar == "base_link":
        return ""
    return f"no transform leads to {lidar}"


def _pose(facts: Facts, frame: str, parent: str) -> F8:
    """Return the fixed pose (4, 4) of a frame in a parent; the identity if they are not connected."""
    pose = facts.pose(frame, parent)
    return np.eye(4) if pose is None else pose
