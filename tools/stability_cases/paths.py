"""Paths that hardly can be walked, and recordings that hardly can be followed."""

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from stability_cases.row import Row, refused
from vlp16emu.engine import assemble
from vlp16emu.extras.recorded.files import RecordedPoses
from vlp16emu.extras.recorded.motion import RecordedMotion
from vlp16emu.extras.recorded.settings import Recorded
from vlp16emu.extras.walk.path import Path
from vlp16emu.motion.pose import Motion
from vlp16emu.scenario import load
from vlp16emu.units import S_NS

Array = NDArray[np.float64]

Points = Sequence[tuple[float, float]]

_STEP_NS = 500_000
_FALL_M = 20.0 * (_STEP_NS / S_NS) ** 2 / 2
"""What twice the acceleration of a fall makes of a step."""


def _walk(points_m: Points, *settings: str) -> tuple[Motion, int]:
    motion = f'motion={{kind="walk",harness={{}},way_points_m={[list(point) for point in points_m]}}}'
    scenario = load("static_bench", [motion, *settings])
    return assemble(scenario).motion, scenario.start_ns


def impossible_paths() -> Iterator[Row]:
    """Try paths that no person takes."""
    for name, points_m, says in (
        ("waypoints that coincide", [(0, 0), (5, 0), (5, 0), (9, 1)], "coincides with the one before it"),
        ("path of one point", [(1, 2)], "a list of at least 2"),
        ("path back on itself", [(0, 0), (9, 0), (0, 0)], "at least 0.1 m"),
        ("path of a million kilometres", [(0, 0), (1e9, 0)], "within 1e+06 m"),
        ("path of 150 km", [(0, 0), (150_000, 0)], "at most 100 km"),
    ):
        yield refused(name, partial(_walk, points_m), says)
    one = partial(Path, np.array([[1.0, 2.0]]), lambda x_m, _: 0 * x_m)
    yield refused("path of one point, in Python", one, "at least 2 of them")


def _smooth(name: str, motion: Motion, start_ns: int, span_s: float) -> Iterator[Row]:
    """Rows of a motion that must be finite and without a jump; the largest of what is not a number is none either."""
    t_ns = start_ns + np.arange(0, round(span_s * S_NS), _STEP_NS, dtype=np.int64)
    poses, rates = motion.poses_at(t_ns), motion.kinematics_at(t_ns)
    hops_m = np.diff(poses.world_p_body_m, axis=0) - rates.world_v_body_m_s[:-1] * (_STEP_NS / S_NS)
    yield Row(name, "step of 0.5 ms less velocity, m", float(np.abs(hops_m).max()), _FALL_M)
    jump_rad_s = np.abs(np.diff(rates.body_w_rad_s, axis=0)).max()
    yield Row(name, "jump of angular rate in 0.5 ms, rad/s", float(jump_rad_s), 0.01)
    turns = poses.world_R_body
    off = np.abs(turns.swapaxes(1, 2) @ turns - np.eye(3)).max()
    yield Row(name, "rotation off orthonormal", float(off), 1e-12)


def _hairpin(width_m: float, away_m: float = 0.0) -> list[tuple[float, float]]:
    half_m = width_m / 2
    way = [(0.0, 0.0), (6.0, 0.0), (6.0 + half_m, half_m), (6.0, width_m), (0.0, width_m)]
    return [(x + away_m, y + away_m) for x, y in way]


def hairpins() -> Iterator[Row]:
    """Turn back within two feet, with gait and loose straps, here and 100 km away; and one that is too tight."""
    for away_m in (0.0, 1e5):
        motion, start_ns = _walk(_hairpin(0.6, away_m))
        yield from _smooth(f"hairpin of 0.6 m, {away_m / 1000:g} km away", motion, start_ns, motion.run_time_s)
    yield refused("hairpin of 0.2 m", partial(_walk, _hairpin(0.2)), "at least 0.1 m")


def _recorded(t_s: Array, quaternion: Array) -> RecordedMotion:
    """Body that turns by poses from time 0 on."""
    t_ns, count = np.rint(t_s * S_NS).astype(np.int64), len(t_s)
    poses = RecordedPoses([f"pose {i + 1}" for i in range(count)], t_ns, np.zeros((count, 3)), quaternion)
    return RecordedMotion(Recorded(kind="recorded", file="poses.txt", format="tum"), poses, start_ns=0)


def _about_z(angle_rad: Array) -> Array:
    """Quaternions (n, 4) of turns about the vertical."""
    zero = np.zeros_like(angle_rad)
    return np.column_stack([zero, zero, np.sin(angle_rad / 2), np.cos(angle_rad / 2)])


def recordings() -> Iterator[Row]:
    """Follow turns of 500 deg/s at 20 poses a second, quaternions of either sign, and steps without a sense."""
    t_s = np.arange(61) / 20
    rate_rad_s = np.radians(500.0)
    turn = _about_z(rate_rad_s * t_s)
    steady = _recorded(t_s, turn)
    look_ns = np.arange(500_000_000, 2_500_000_000, 100_003, dtype=np.int64)
    yaw_rad = np.arctan2(*(steady.poses_at(look_ns).world_R_body[:, i, 0] for i in (1, 0)))
    off_rad = np.angle(np.exp(1j * (yaw_rad - rate_rad_s * look_ns / S_NS)))
    yield Row("20 Hz poses, 500 deg/s", "rotation off the true one, rad", float(np.abs(off_rad).max()), 2e-6)
    yield from _smooth("20 Hz poses, 500 deg/s", steady, 0, 3.0)
    signs = np.where(np.arange(61) % 3 == 1, -1.0, 1.0)[:, None]
    flipped = _recorded(t_s, turn * signs).poses_at(look_ns).world_R_body
    differ = np.abs(flipped - steady.poses_at(look_ns).world_R_body).max()
    yield Row("antiparallel quaternions", "rotation moved by their sign", float(differ), 1e-12)
    for step_deg, says in ((180.0, "turns by 180.0 degrees"), (91.0, "turns by 91.0 degrees")):
        steps = np.radians(step_deg) * np.arange(4)
        follow = partial(_recorded, np.arange(4) / 20, _about_z(steps))
        yield refused(f"steps of {step_deg:g} degrees", follow, says)
    yield refused("gap of 2 s", partial(_recorded, np.array([0, 2.0]), _about_z(np.zeros(2))), "a gap of 2 s")
