"""Recorded poses that turn fast, through the gimbal's pole, with any sign; and mounts."""

import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from mpmath import cos as mp_cos
from mpmath import matrix, mp, mpf
from mpmath import sin as mp_sin
from scipy.spatial.transform import Rotation

from stability_cases.case import Row, case, refusal
from vlp16emu.extras.recorded.files import RecordedPoses, read_kitti
from vlp16emu.extras.recorded.motion import RecordedMotion
from vlp16emu.extras.recorded.settings import Recorded
from vlp16emu.motion.mount import device_motion
from vlp16emu.motion.pose import Motion, StaticMotion
from vlp16emu.motion.settings import Mount
from vlp16emu.types import F8
from vlp16emu.units import S_NS

_STEP_NS = 500_000
_FALL_M = 20.0 * (_STEP_NS / S_NS) ** 2 / 2  # what twice the acceleration of a fall makes of a step
_EPSILON = 2.0**-52
_STAGE_RAD = 2 * np.pi * 6e6 * _EPSILON  # six million turns, of which float64 knows that much


def motion_through(t_s: F8, quaternion: F8, position_m: F8 | None = None) -> RecordedMotion:
    """Return the motion through poses (n,) from time 0 on."""
    t_ns = np.rint(t_s * S_NS).astype(np.int64)
    where = [f"pose {i + 1}" for i in range(len(t_s))]
    place_m = np.zeros((len(t_s), 3)) if position_m is None else position_m
    section = Recorded(kind="recorded", file="poses.txt", format="tum")
    return RecordedMotion(section, RecordedPoses(where, t_ns, place_m, quaternion), start_ns=0)


def _angle_rad(a: F8, b: F8) -> F8:
    """Return the angles (n,) between rotations (n, 3, 3), also tiny ones."""
    return np.asarray(Rotation.from_matrix(np.swapaxes(a, 1, 2) @ b).magnitude())


def smooth(motion: Motion, start_ns: int, span_s: float) -> Iterator[Row]:
    """Yield rows of a motion that must be finite and without a jump; NaN fails them."""
    t_ns = start_ns + np.arange(0, round(span_s * S_NS), _STEP_NS, dtype=np.int64)
    poses = motion.poses_at(t_ns)
    rates = motion.kinematics_at(t_ns)
    hops_m = np.diff(poses.world_p_body_m, axis=0) - rates.world_v_body_m_s[:-1] * (_STEP_NS / S_NS)
    yield Row("step of 0.5 ms less velocity, m", float(np.abs(hops_m).max()), _FALL_M)
    jump_rad_s = np.abs(np.diff(rates.body_w_rad_s, axis=0)).max()
    yield Row("jump of angular rate in 0.5 ms, rad/s", float(jump_rad_s), 0.01)
    turns = poses.world_R_body
    off = np.abs(turns.swapaxes(1, 2) @ turns - np.eye(3)).max()
    yield Row("rotation off orthonormal", float(off), 1e-12)


def _over_the_pole(t_s: F8) -> Rotation:
    """Yaw of 40 deg/s, and pitch that swings by 100 degrees about the nadir: through 90 degrees and back."""
    pitch_deg = 90.0 + 100.0 * np.sin(0.6 * t_s)
    angles_deg = np.column_stack([40.0 * t_s, pitch_deg, 20.0 * np.sin(t_s)])
    return Rotation.from_euler("ZYX", angles_deg, degrees=True)


def gimbal_errors(rate_hz: int) -> tuple[F8, F8, F8]:
    """Return pitch (n,) in degrees, and errors (n,) of rotation, in rad, and of angular rate, in rad/s."""
    t_s = np.arange(10 * rate_hz + 1) / rate_hz
    motion = motion_through(t_s, _over_the_pole(t_s).as_quat())
    look_ns = np.arange(1 * S_NS, 9 * S_NS, 4_999_999, dtype=np.int64)
    look_s = look_ns / S_NS
    found = motion.kinematics_at(look_ns)
    true = _over_the_pole(look_s)
    step_s = 1e-4
    turned = (_over_the_pole(look_s - step_s).inv() * _over_the_pole(look_s + step_s)).as_rotvec()
    rate_rad_s = np.linalg.norm(found.body_w_rad_s - turned / (2 * step_s), axis=1)
    return 90.0 + 100.0 * np.sin(0.6 * look_s), _angle_rad(true.as_matrix(), found.world_R_body), rate_rad_s


@case("closed form: the rotation at that time, by scipy")
def over_the_pole() -> Iterator[Row]:
    """Poses at 20 and 100 Hz whose pitch passes 90 degrees again and again, where Euler angles jump."""
    for rate_hz, bound_rad, bound_rad_s in ((20, 2e-7, 1e-5), (100, 3e-10, 2e-8)):
        pitch_deg, error_rad, error_rad_s = gimbal_errors(rate_hz)
        at_the_pole = np.abs(np.cos(np.radians(pitch_deg))) < np.sin(np.radians(5.0))
        for name, which in (("within 5 deg of the pole", at_the_pole), ("elsewhere", ~at_the_pole)):
            where = f"{rate_hz} Hz, {name}"
            yield Row(f"{where}: rotation, rad", float(error_rad[which].max()), bound_rad)
            yield Row(f"{where}: angular rate, rad/s", float(error_rad_s[which].max()), bound_rad_s)


def _about_z(angle_rad: F8) -> F8:
    """Return quaternions (n, 4) of turns about the vertical."""
    zero = np.zeros_like(angle_rad)
    return np.column_stack([zero, zero, np.sin(angle_rad / 2), np.cos(angle_rad / 2)])


@case("closed form: the steady turn")
def fast_recording() -> Iterator[Row]:
    """A turn of 500 deg/s at 20 poses a second: 25 degrees from pose to pose."""
    t_s = np.arange(61) / 20
    rate_rad_s = np.radians(500.0)
    steady = motion_through(t_s, _about_z(rate_rad_s * t_s))
    look_ns = np.arange(500_000_000, 2_500_000_000, 100_003, dtype=np.int64)
    true = Rotation.from_quat(_about_z(rate_rad_s * look_ns / S_NS)).as_matrix()
    yield Row("rotation, rad", float(_angle_rad(true, steady.poses_at(look_ns).world_R_body).max()), 2e-6)
    yield from smooth(steady, 0, 3.0)


@case("the same poses with one sign")
def signs_of_quaternions() -> Iterator[Row]:
    """Each quaternion with a random sign, as programs write them, and with turns of up to 80 degrees."""
    rng = np.random.default_rng(5)
    t_s = np.arange(200) / 20
    look_ns = np.arange(0, 9_900_000_000, 3_000_017, dtype=np.int64)
    for name, most_deg in (("small turns", 5.0), ("turns of 80 degrees", 80.0)):
        steps = rng.normal(size=(200, 3))
        steps *= np.radians(most_deg) / np.linalg.norm(steps, axis=1)[:, None]
        turn = [Rotation.identity()]
        for step in steps[1:]:
            turn.append(turn[-1] * Rotation.from_rotvec(step))
        quaternion = np.array([r.as_quat() for r in turn])
        one = motion_through(t_s, quaternion).poses_at(look_ns).world_R_body
        moved = 0.0
        for _ in range(20):
            signs = rng.choice([-1.0, 1.0], 200)[:, None]
            other = motion_through(t_s, quaternion * signs).poses_at(look_ns).world_R_body
            moved = max(moved, float(np.abs(one - other).max()))
        yield Row(f"{name}: rotation moved by the signs", moved, 0.0)


@case("refusal")
def impossible_recordings() -> Iterator[Row]:
    """Steps whose sense of turning is in doubt, and a gap."""
    for step_deg in (180.0, 91.0):
        follow = partial(motion_through, np.arange(4) / 20, _about_z(np.radians(step_deg) * np.arange(4)))
        yield refusal(f"a step of {step_deg:g} degrees", follow, f"turns by {step_deg:.1f} degrees")
    gap = partial(motion_through, np.array([0, 2.0]), _about_z(np.zeros(2)))
    yield refusal("a gap of 2 s", gap, "a gap of 2 s")


@case("closed form: the sine that the poses sample")
def sparse_and_dense_recordings() -> Iterator[Row]:
    """A sway at 10 Hz, at 1 kHz and over a gap of 0.9 s, in 2038, where float64 has steps of 0.2 us."""
    late_s = 2_147_483_648.0
    for name, rate_hz, bound_m in (("10 Hz", 10, 5e-6), ("1 kHz", 1000, 1e-11), ("gap of 0.9 s", 20, 5e-3)):
        since_s = np.arange(4 * rate_hz + 1) / rate_hz
        if name.startswith("gap"):
            since_s = since_s[(since_s <= 1.5) | (since_s >= 2.4)]
        t_ns = round(late_s) * S_NS + np.rint(since_s * S_NS).astype(np.int64)
        place_m = np.column_stack([0.3 * since_s, 0.02 * np.sin(2 * since_s), 0.01 * np.cos(3 * since_s)])
        still = np.tile([0.0, 0.0, 0.0, 1.0], (len(since_s), 1))
        section = Recorded(kind="recorded", file="poses.txt", format="tum")
        poses = RecordedPoses([f"pose {i}" for i in range(len(since_s))], t_ns, place_m, still)
        look_ns = np.arange(S_NS, 3 * S_NS, 1_234_567, dtype=np.int64)
        start_ns = round(late_s) * S_NS
        found = RecordedMotion(section, poses, start_ns=start_ns).poses_at(start_ns + look_ns)
        t = look_ns / S_NS
        true_m = np.column_stack([0.3 * t, 0.02 * np.sin(2 * t), 0.01 * np.cos(3 * t)])
        yield Row(f"{name}: position, m", float(np.abs(found.world_p_body_m - true_m).max()), bound_m)


def _exact_turn(axis: str, angle_rad: mpf) -> matrix:
    c, s = mp_cos(angle_rad), mp_sin(angle_rad)
    rows = {
        "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
        "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
        "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
    }
    return matrix(rows[axis])


def _exact_mount(mount: Mount, elapsed_ns: int) -> matrix:
    """Rotation of a device on a stage that spins about z, with 40 digits."""
    turn = matrix([[1, 0, 0], [0, 1, 0], [0, 0, 1]])
    for axis, angle_deg in (("z", mount.yaw_deg), ("y", mount.pitch_deg), ("x", mount.roll_deg)):
        turn = turn * _exact_turn(axis, mpf(angle_deg) * mp.pi / 180)
    return _exact_turn("z", 2 * mp.pi * mpf(mount.spin_hz) * elapsed_ns / S_NS) * turn


@case("mpmath, 40 digits")
def mounts() -> Iterator[Row]:
    """Mounts at pitch 90 and -90 degrees, and on a stage of 9.7 Hz after seven days: six million turns."""
    start_ns = 1_780_000_000 * S_NS
    base = StaticMotion(np.array([1.0, 2.0, 3.0]), 0.0, 0.0, 0.0)
    week_ns = 7 * 86_400 * S_NS
    times_ns = np.array([0, 1, week_ns - 1, week_ns, week_ns + 123_456_789], np.int64)
    for name, mount in (
        ("pitch of 90 degrees", Mount(yaw_deg=30.0, pitch_deg=90.0, roll_deg=-20.0)),
        ("pitch of -90 degrees", Mount(yaw_deg=-170.0, pitch_deg=-90.0, roll_deg=179.9)),
        ("stage of 9.7 Hz, seven days", Mount(pitch_deg=90.0, roll_deg=3.0, spin_hz=9.7)),
    ):
        found = device_motion(base, mount, start_ns).poses_at(start_ns + times_ns).world_R_body
        with mp.workdps(40):
            worst = max(
                abs(float(_exact_mount(mount, t)[i, j] - mpf(float(turn[i, j]))))
                for t, turn in zip(times_ns.tolist(), np.broadcast_to(found, (5, 3, 3)), strict=True)
                for i in range(3)
                for j in range(3)
            )
        yield Row(f"{name}: rotation", worst, _STAGE_RAD if mount.spin_hz else 4 * _EPSILON)


@case("closed form: the rotation that made the matrix")
def half_turns() -> Iterator[Row]:
    """Matrices of KITTI for turns of 180 degrees or nearly so, where the trace formula divides by 0."""
    rng = np.random.default_rng(6)
    axes = np.concatenate([np.eye(3), rng.normal(size=(97, 3))])
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    angles = np.pi - np.concatenate([np.zeros(40), np.geomspace(1e-15, 1e-3, 60)])
    turns = Rotation.from_rotvec(axes * angles[:, None])
    rows = np.concatenate([turns.as_matrix(), np.zeros((100, 3, 1))], axis=2).reshape(100, 12)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "poses.txt"
        lines = [" ".join(f"{x:.17g}" for x in row) + "\n" for row in rows]
        path.write_text("".join(lines), encoding="utf-8")
        found = Rotation.from_quat(read_kitti(path, 10.0).quaternion)
    yield Row("rotation, rad", float((turns.inv() * found).magnitude().max()), 1e-15 * 4)
