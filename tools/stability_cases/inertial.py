"""Inertial samples integrated for an hour: what dead reckoning without errors of the unit must give back."""

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from stability_cases.case import Row, case
from vlp16emu.engine import assemble
from vlp16emu.extras.imu.sampler import GRAVITY_M_S2, ImuSampler
from vlp16emu.extras.imu.settings import Imu
from vlp16emu.motion.pose import Kinematics, Motion
from vlp16emu.rotation import rotations
from vlp16emu.scenario import load
from vlp16emu.types import F8, I8, Poses
from vlp16emu.units import S_NS

_LIMITS = (
    "step_hz=5.0,vertical_m=1.0,second_harmonic_m=1.0,heel_strike_m=1.0,sideways_m=1.0,fore_aft_m=1.0,"
    "roll_deg=45.0,pitch_deg=45.0,yaw_deg=45.0,variation=1.0"
)
_CHUNK = 20_000  # samples that are read together


class Circle:
    """A body that goes round a circle of 8 m at 1.2 m/s, without beginning or end."""

    run_time_s = np.inf
    moves = True

    def __init__(self, start_ns: int) -> None:
        self._start_ns = start_ns

    def poses_at(self, t_ns: I8) -> Poses:
        """Return poses at UTC instants (n,)."""
        return self.kinematics_at(t_ns)

    def kinematics_at(self, t_ns: I8) -> Kinematics:
        """Return poses at UTC instants (n,) with their derivatives."""
        count = len(t_ns)
        angle = 0.15 * ((t_ns - self._start_ns) / S_NS)
        turns = rotations(angle, 0.0, 0.0)
        rate = np.broadcast_to([0.0, 0.0, 0.15], (count, 3))
        ahead = turns[..., 0]
        left = turns[..., 1]
        return Kinematics(t_ns, turns, -8.0 * left, 1.2 * ahead, 0.18 * left, rate, np.zeros((count, 3)))


def _turns(rates: F8, step_s: float) -> Rotation:
    """Return the turns over two steps each from rates (2 n + 1, 3), by Magnus' expansion to the fourth order.

    Source: Iserles et al., "Lie-group methods", Acta Numerica 9 (2000), section 5; Simpson for integrals.
    """
    begin = rates[:-2:2]
    middle = rates[1:-1:2]
    end = rates[2::2]
    mean = step_s / 3 * (begin + 4 * middle + end)
    return Rotation.from_rotvec(mean + (2 * step_s) ** 2 / 12 * np.cross(begin, end))


def _simpson(values: F8, step_s: float) -> F8:
    """Return the cumulative integral (n + 1, 3) at every other of the samples (2 n + 1, 3)."""
    pieces = step_s / 3 * (values[:-2:2] + 4 * values[1:-1:2] + values[2::2])
    return np.concatenate([np.zeros((1, 3)), np.cumsum(pieces, axis=0)])


def integrate(motion: Motion, start_ns: int, rate_hz: int, seconds: int) -> tuple[float, float, float]:
    """Integrate ideal samples, and return the errors at the end: attitude, rad, velocity, m/s, position, m.

    The attitude is that of the integrated rates; velocity and position are of the integrated force, turned by
    the true attitude, so that they are not those of a tilted gravity.
    """
    sampler = ImuSampler(motion, Imu(rate_hz=rate_hz), start_ns=start_ns, seed=1)
    step_s = 1 / rate_hz
    first = motion.kinematics_at(np.array([start_ns]))
    attitude = Rotation.from_matrix(first.world_R_body[0])
    velocity = first.world_v_body_m_s[0].copy()
    place = first.world_p_body_m[0].copy()
    for begin in range(0, seconds * rate_hz, _CHUNK):
        read = sampler.read(begin, _CHUNK + 1)
        turns = _turns(read.angular_rate_rad_s, step_s).as_quat()
        attitude = attitude * _product(turns)
        true = motion.kinematics_at(read.t_ns)
        push = np.einsum("nij,nj->ni", true.world_R_body, read.specific_force_m_s2) - [0, 0, GRAVITY_M_S2]
        gained = velocity + _simpson(push, step_s)
        # The integral of a cubic between samples with its ends' slopes.
        even = gained[:-1], gained[1:], push[:-2:2], push[2::2]
        place = place + (step_s * (even[0] + even[1]) + step_s**2 / 3 * (even[2] - even[3])).sum(axis=0)
        velocity = gained[-1]
    last = motion.kinematics_at(np.array([start_ns + seconds * S_NS]))
    turned = float((Rotation.from_matrix(last.world_R_body[0]).inv() * attitude).magnitude())
    off_m_s = float(np.linalg.norm(velocity - last.world_v_body_m_s[0]))
    return turned, off_m_s, float(np.linalg.norm(place - last.world_p_body_m[0]))


def _product(quaternions: F8) -> Rotation:
    """Return the product of rotations (n, 4) in their order, pair by pair."""
    turns = Rotation.from_quat(quaternions)
    while len(turns) > 1:
        even = turns[: len(turns) // 2 * 2]
        pairs = even[::2] * even[1::2]
        turns = pairs if len(turns) % 2 == 0 else Rotation.concatenate([pairs, turns[-1:]])
    return turns[0]


def _rows(name: str, errors: tuple[float, float, float], bounds: tuple[float, float, float]) -> Iterator[Row]:
    what = "attitude, rad", "velocity, m/s", "position, m"
    for quantity, error, bound in zip(what, errors, bounds, strict=True):
        yield Row(f"{name}: {quantity}", error, bound)


@case("closed form: a circle; the pose of the walk at the end")
def imu_over_seconds() -> Iterator[Row]:
    """Twenty seconds of ideal samples at 1 kHz, integrated: a circle, and a walk with loose straps."""
    start_ns = 1_780_000_000 * S_NS
    yield from _rows("circle", integrate(Circle(start_ns), start_ns, 1000, 20), (1e-13, 1e-12, 1e-11))
    motion, start_ns = _walk("harness={}")
    yield from _rows("walk", integrate(motion, start_ns, 1000, 20), (1e-9, 1e-9, 1e-9))


@case("closed form: a circle; the pose of the walk at the end", is_slow=True)
def imu_over_an_hour() -> Iterator[Row]:
    """An hour of ideal samples at 1 kHz, integrated: an error of 1e-9 m/s2 would grow to 6 mm."""
    start_ns = 1_780_000_000 * S_NS
    yield from _rows("circle", integrate(Circle(start_ns), start_ns, 1000, 3600), (1e-12, 1e-12, 1e-9))
    motion, start_ns = _walk("harness={}")
    yield from _rows("walk", integrate(motion, start_ns, 1000, 3600), (1e-7, 1e-8, 1e-5))


@case("the pose of the walk at the end")
def imu_of_violent_walks() -> Iterator[Row]:
    """Four seconds of a run at 10 m/s, and of a gait with all amplitudes at their limits."""
    still = "stand_s=0.0,harness={}"
    for name, keys, bounds in (
        ("running at 10 m/s", f"speed_m_s=10.0,acceleration_m_s2=10.0,{still}", (1e-10, 1e-9, 1e-9)),
        ("every amplitude at its limit", f"gait={{{_LIMITS}}}", (1e-6, 1e-4, 1e-3)),
    ):
        motion, start_ns = _walk(keys)
        yield from _rows(name, integrate(motion, start_ns, 5000, 4), bounds)


def _walk(keys: str) -> tuple[Motion, int]:
    way = "[[0, 0], [8, 8], [0, 16], [-8, 8], [0, 0]]"
    motion = f'motion={{kind="walk",way_points_m={way},laps=1000,sensor_height_m=9.0,{keys}}}'
    room = "world.length_m=60.0", "world.width_m=60.0", "world.height_m=20.0"
    scenario = load("static_bench", [motion, *room])
    return assemble(scenario).motion, scenario.start_ns
