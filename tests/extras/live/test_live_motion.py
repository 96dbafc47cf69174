"""Poses that come in: how they are followed, timed and refused, and that what was flown is read back bit
by bit."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from vlp16emu.engine.windows import STEP_NS
from vlp16emu.errors import TrajectoryError
from vlp16emu.extras.live.flown import FLOWN_HEADER, FlownMotion, flown_rows, read_flown
from vlp16emu.extras.live.knots import STATE, Knots, follow
from vlp16emu.extras.live.motion import LiveMotion, PoseInput
from vlp16emu.extras.live.settings import Live
from vlp16emu.extras.recorded.files import read_trajectory_csv

START_NS = 1_779_267_600_000_000_000
STEP_S = STEP_NS * 1e-9
LEVEL = (0.0, 0.0, 0.0, 1.0)


class Bench:
    """A live motion with a clock of its own, and whoever moves it."""

    def __init__(self, smoothing_s=0.02):
        self.now_ns = 5_000_000_000
        self.motion = LiveMotion(
            Live(kind="live", smoothing_s=smoothing_s),
            start_ns=START_NS,
            clock_ns=lambda: self.now_ns,
            sleep=self.sleep,
        )
        self.motion.is_open = True
        self.put = self.motion.poses.put

    def sleep(self, seconds):
        self.now_ns += max(round(seconds * 1e9), 1)

    def fly(self, pose_of, duration_s, *, rate_hz=100, silent=(9e9, 9e9)):
        """Send poses as time goes on, and give knots (n, 13) and their times."""
        begin_ns, step_ns = self.now_ns, round(1e9 / rate_hz)
        self.put(*pose_of(0.0))
        if self.motion.knots is None:
            self.motion.begin(begin_ns)
        first = self.motion.knots.last
        for number in range(1, int(duration_s * rate_hz)):
            self.now_ns = begin_ns + number * step_ns
            t_s = number / rate_hz
            if not silent[0] <= t_s < silent[1]:
                self.put(*pose_of(t_s))
            self.motion.poses_at(np.array([START_NS + self.now_ns - 5_000_000_000]))
        knots = self.motion.knots
        return knots.states(first, knots.last + 1), (np.arange(first, knots.last + 1)) * STEP_S


def at_speed(t_s, speed_m_s=3.0):
    return (speed_m_s * t_s, 1.0, 2.0), LEVEL


def turning(t_s, rate_rad_s=1.0):
    return (0.0, 0.0, 2.0), (0.0, 0.0, math.sin(rate_rad_s * t_s / 2), math.cos(rate_rad_s * t_s / 2))


def test_correction_is_the_exact_answer_of_a_damped_oscillator():
    """A step agrees with an integrator of the differential equation, in place to 1e-9 m, and in turn to
    1e-5 rad."""
    seen, state = np.zeros(STATE), np.zeros(STATE)
    seen[3:7], seen[7:10], seen[12] = LEVEL, (1.0, -2.0, 0.5), 0.7
    state[:3], state[7:10] = (0.02, -0.01, 0.03), (0.5, 0.1, 0.0)
    state[3:7], state[12] = (0.0, 0.0, math.sin(0.025), math.cos(0.025)), -0.4
    out = follow(state, seen, 0.004, STEP_S, 0.02)

    def pull(_t, y):
        return [y[1], -2500.0 * y[0] - 100.0 * y[1]]

    def settled(error, change):
        return solve_ivp(pull, (0.0, STEP_S), [error, change], rtol=1e-12, atol=1e-14).y[:, -1]

    for a in range(3):
        error, change = settled(state[a] - 0.004 * seen[7 + a], state[7 + a] - seen[7 + a])
        assert out[a] == pytest.approx((0.004 + STEP_S) * seen[7 + a] + error, abs=1e-9)
        assert out[7 + a] == pytest.approx(seen[7 + a] + change, abs=1e-7)
    error, change = settled(0.05 - 0.004 * 0.7, -0.4 - 0.7)
    yaw_rad = Rotation.from_quat(out[3:7]).as_euler("zyx")[0]
    assert yaw_rad == pytest.approx((0.004 + STEP_S) * 0.7 + error, abs=1e-5)
    assert out[12] == pytest.approx(0.7 + change, abs=1e-3)


def test_steady_motion_is_followed_without_lag():
    """At 3 m/s, and at 1 rad/s, the body is where the sender's clock says, to 0.01 mm and 0.01 mrad."""
    states, t_s = Bench().fly(at_speed, 2.0)
    np.testing.assert_allclose(states[-50:, 0], 3.0 * t_s[-50:], atol=1e-5)
    states, t_s = Bench().fly(turning, 2.0)
    yaw_rad = Rotation.from_quat(states[-50:, 3:7]).as_euler("zyx")[:, 0]
    np.testing.assert_allclose(yaw_rad, t_s[-50:], atol=1e-5)


def test_a_jump_of_poses_is_no_jump_of_the_body():
    """A pose 3 m aside, or turned by 3 rad, is approached at 4 m/s or 6 rad/s at most, and reached within
    3 s, with 5 cm of overshoot at most."""
    states, t_s = Bench().fly(lambda t: ((3.0 if t >= 1.0 else 0.0, 0.0, 2.0), LEVEL), 5.0)
    x_m = states[:, 0]
    assert np.abs(np.diff(x_m)).max() < 4.0 * STEP_S
    assert x_m.max() < 3.05
    assert x_m[t_s > 4.0] == pytest.approx(3.0, abs=1e-3)
    states, t_s = Bench().fly(lambda t: turning(3.0 if t >= 1.0 else 0.0), 5.0)
    assert np.linalg.norm(states[:, 10:], axis=1).max() < 6.0
    assert Rotation.from_quat(states[t_s > 4.0, 3:7]).magnitude() == pytest.approx(3.0, abs=1e-3)


def test_without_poses_the_body_comes_to_rest_and_goes_on_without_a_jump():
    """Poses end for a second at 3 m/s: rest after 0.9 m, then no step over what 6 m/s make, and the lost
    time is on record."""
    bench = Bench()
    states, t_s = bench.fly(at_speed, 5.0, silent=(1.0, 2.2))
    x_m, v_m_s = states[:, 0], states[:, 7]
    rest = (t_s > 2.05) & (t_s < 2.15)
    assert np.abs(v_m_s[rest]).max() < 0.02
    assert x_m[rest].max() - 3.0 == pytest.approx(0.9, abs=0.05)
    assert np.abs(np.diff(x_m)).max() < 9.0 * STEP_S
    assert np.abs(np.diff(v_m_s)).max() < 1.5
    assert x_m[-1] == pytest.approx(3.0 * t_s[-1], abs=1e-3)
    ((begin_ns, end_ns),) = bench.motion.poses.gaps_ns
    assert (end_ns - begin_ns) * 1e-9 == pytest.approx(1.21, abs=1e-6)


def test_old_knots_are_dropped_and_young_ones_stay():
    """Over 100 s of knots the memory stays that of 44 s, and the last 20 s are as they were."""
    rng = np.random.default_rng(1)
    states = rng.normal(size=(38_000, STATE))
    states[:, 3:7] /= np.linalg.norm(states[:, 3:7], axis=1)[:, None]
    whole, growing = Knots(START_NS, states), Knots(START_NS, states[:2])
    for state in states[2:]:
        growing.append(state)
    t_ns = START_NS + whole.last_ns - np.arange(0, 20_000_000_000, 7_654_321)
    assert growing.poses_at(t_ns).world_p_body_m.tobytes() == whole.poses_at(t_ns).world_p_body_m.tobytes()
    assert growing.last == whole.last
    assert len(growing._states) * STEP_NS == pytest.approx(44e9, abs=STEP_NS)


def test_what_was_flown_is_read_back_bit_by_bit(tmp_path):
    """Poses and rates of the table are those of the run to the last bit, and the table is a CSV of
    recorded poses too."""
    bench = Bench()
    states, _ = bench.fly(turning, 1.5)
    path = tmp_path / "flown.csv"
    path.write_text(FLOWN_HEADER + flown_rows(0, states))
    read = FlownMotion(path, start_ns=START_NS)
    t_ns = START_NS + np.arange(-1_000_000_000, 1_400_000_000, 333_333)
    was, now = bench.motion.kinematics_at(t_ns), read.kinematics_at(t_ns)
    for name in ("world_p_body_m", "world_R_body", "world_a_body_m_s2", "body_alpha_rad_s2"):
        assert getattr(was, name).tobytes() == getattr(now, name).tobytes()
    assert read_trajectory_csv(path).position_m.shape == (len(states), 3)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("0.002654208,", "0.002654209,", "line 3, column t_s: found 0.002654209; expected 0.002654208"),
        ("2.0,", "nan,", "column z_m: found nan; expected a number"),
    ],
)
def test_a_table_that_is_not_whole_is_refused(tmp_path, old, new, message):
    """Missing knots and numbers are named by line and column."""
    state = np.array([[0.5, 0.25, 2.0, *LEVEL, *[0.125] * 6]])
    text = FLOWN_HEADER + flown_rows(0, np.repeat(state, 3, axis=0))
    path = tmp_path / "flown.csv"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(TrajectoryError, match=message):
        read_flown(path)


@pytest.mark.parametrize(
    ("position_m", "quaternion", "message"),
    [
        ((math.nan, 0, 0), LEVEL, "expected finite numbers"),
        ((0, 0, 0), (0, 0, math.inf, 1), "expected finite numbers"),
        ((0, 0, 0), (0, 0, 0, 0), "a quaternion of length 0; expected length 1"),
        ((0, 2e6, 0), LEVEL, "at most 1e\\+06 m"),
        ((0, 0), LEVEL, "found 2 and 4 numbers; expected 3 and 4"),
    ],
)
def test_what_is_no_pose_is_refused_and_counted(position_m, quaternion, message):
    """NaN, quaternions that are no rotation, places out of the world: refused, counted, and nothing is
    moved."""
    poses = PoseInput()
    with pytest.raises(TrajectoryError, match=message):
        poses.put(position_m, quaternion)
    assert (poses.refused, poses.received, poses.last) == (1, 0, None)


def test_a_pose_beyond_the_world_is_refused_and_the_body_stays():
    """A place without windows is refused with a line and counted, and the pose before it holds."""
    poses = PoseInput(is_in_world=lambda place_m: place_m[0] < 7e3)
    assert poses.put((1.0, 2.0, 3.0), LEVEL)
    with pytest.raises(TrajectoryError, match=r"place at \(35000, 0, 0\) m, beyond the world"):
        poses.put((35e3, 0.0, 0.0), LEVEL)
    assert (poses.refused, poses.received) == (1, 1)
    assert poses.last.state[:3].tolist() == [1.0, 2.0, 3.0]


def test_stamps_of_a_sender_are_put_on_our_clock_by_the_quickest_pose():
    """With delays of 1 to 9 ms a stamp is off by the least of them; an old stamp is left out, a new clock
    is taken."""
    now_ns = 0
    poses = PoseInput(lambda: now_ns)
    for number in range(100):
        now_ns = 10_000_000 * number + 1_000_000 * (1 + number * 7 % 9)
        assert poses.put((0.0, 0.0, 0.0), LEVEL, 777_000_000_000 + 10_000_000 * number)
    assert poses.last.at_ns == pytest.approx(10_000_000 * 99 + 1_000_000, abs=120_000)
    assert not poses.put((0.0, 0.0, 0.0), LEVEL, 777_000_000_000)
    assert poses.out_of_order == 1
    now_ns += 50_000_000
    assert poses.put((0.0, 0.0, 0.0), LEVEL, 5_000_000_000)  # the sender has started again
    assert poses.last.at_ns == now_ns
