"""What an inertial measurement unit reads."""

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from vlp16emu.extras.imu.sampler import GRAVITY_M_S2, ImuSampler
from vlp16emu.extras.imu.settings import Imu
from vlp16emu.extras.walk.settings import Harness, Walk
from vlp16emu.motion.mount import device_motion
from vlp16emu.motion.pose import Kinematics, StaticMotion
from vlp16emu.motion.settings import Gps, Mount
from vlp16emu.rotation import rotations
from vlp16emu.world.hall import HallWorld
from vlp16emu.world.settings import Hall

START_NS = 1_780_000_000 * 10**9


class Circle:
    """A body that has always been going round a circle of 8 m at 1.2 m/s."""

    run_time_s, moves = np.inf, True

    def kinematics_at(self, t_ns):
        n, angle = len(t_ns), 0.15 * (t_ns - START_NS) / 1e9
        turns = rotations(angle, 0.0, 0.0)
        rate = np.broadcast_to([0.0, 0.0, 0.15], (n, 3))
        ahead, left = turns[..., 0], turns[..., 1]
        return Kinematics(t_ns, turns, -8.0 * left, 1.2 * ahead, 0.18 * left, rate, np.zeros((n, 3)))


@pytest.fixture
def unit():
    """Make a unit, on a tripod unless another motion is given."""

    def make(motion=None, seed=1, **own):
        motion = motion or StaticMotion(np.zeros(3), 0.0, 0.0, 0.0)
        return ImuSampler(motion, Imu(**own), start_ns=START_NS, seed=seed)

    return make


def test_at_rest_it_reads_gravity_upwards(unit):
    """Level it reads 1 g up; tilted 30 degrees nose down, half of it backwards."""
    level = unit().read(0, 10)
    np.testing.assert_allclose(level.specific_force_m_s2, [[0, 0, 9.80665]] * 10, atol=1e-15)
    assert not level.angular_rate_rad_s.any()
    tilted = unit(motion=StaticMotion(np.zeros(3), 45.0, 30.0, 0.0)).read(0, 1)
    np.testing.assert_allclose(
        tilted.specific_force_m_s2[0], GRAVITY_M_S2 * np.array([-0.5, 0, np.sqrt(0.75)])
    )


def test_on_a_circle_it_reads_the_turn_and_the_pull_inwards(unit):
    """At 1.2 m/s on 8 m it turns 0.15 rad/s and is pulled 0.18 m/s2 to the left; 1 m farther left, less."""
    carrier = Circle()
    read = unit(motion=carrier).read(1000, 400)
    np.testing.assert_allclose(read.angular_rate_rad_s, [[0, 0, 0.15]] * 400, atol=1e-8)
    np.testing.assert_allclose(read.specific_force_m_s2, [[0, 0.18, GRAVITY_M_S2]] * 400, atol=1e-8)
    inner = device_motion(carrier, Mount(lever_arm_m=(0.0, 1.0, 0.0)), START_NS)
    np.testing.assert_allclose(
        unit(motion=inner).read(1000, 9).specific_force_m_s2[:, 1], 0.18 * 7 / 8, atol=1e-8
    )


def test_samples_come_at_the_exact_rate(unit):
    """Also at a rate that does not divide a second, no nanosecond is lost over a day."""
    t_ns = unit(rate_hz=300).read(300 * 86_400, 4).t_ns - START_NS
    assert t_ns.tolist() == [86_400 * 10**9 + ns for ns in (0, 3_333_333, 6_666_666, 10_000_000)]


def test_white_noise_has_its_density(unit):
    """Samples are normal, with the density times the root of the rate as deviation, and independent."""
    noise = unit(gyro_noise_rad_s_sqrt_hz=1e-3, accel_noise_m_s2_sqrt_hz=2e-2, rate_hz=400).read(0, 20_000)
    gyro = noise.angular_rate_rad_s / (1e-3 * 20)
    accel = (noise.specific_force_m_s2 - [0, 0, GRAVITY_M_S2]) / (2e-2 * 20)
    for axis in range(3):
        assert stats.kstest(gyro[:, axis], "norm").pvalue > 0.001
        assert stats.kstest(accel[:, axis], "norm").pvalue > 0.001
    both = np.corrcoef(np.hstack([gyro, accel]).T)
    assert np.abs(both - np.eye(6)).max() < 0.03


def test_random_walk_has_independent_normal_steps(unit):
    """Steps of the bias are normal with density over root of rate, also where stretches of 4096 samples
    meet."""
    walk = unit(gyro_walk_rad_s2_sqrt_hz=1e-3, rate_hz=100).read(0, 40_000).angular_rate_rad_s
    steps = np.diff(walk, axis=0) / (1e-3 / 10)
    for axis in range(3):
        assert stats.kstest(steps[:, axis], "norm").pvalue > 0.001
        assert abs(np.corrcoef(steps[1:, axis], steps[:-1, axis])[0, 1]) < 0.02
    assert not walk[0].any()


def test_random_walk_spreads_with_the_root_of_time(unit):
    """Over many units the bias after n samples is normal with the root of n, within and beyond a stretch."""
    for sample in (900, 4096, 100_000):
        ends = [
            unit(gyro_walk_rad_s2_sqrt_hz=1.0, rate_hz=1, seed=s).read(sample, 1).angular_rate_rad_s
            for s in range(150)
        ]
        assert stats.kstest(np.ravel(ends) / np.sqrt(sample), "norm").pvalue > 0.001


def test_readings_do_not_depend_on_what_was_read_before(unit):
    """Ten thousand samples, read 3000 at a time, have the bits of any single one of them."""
    one = unit(preset="field")
    parts = [one.read(first, min(3000, 10_000 - first)) for first in range(0, 10_000, 3000)]
    rates = np.concatenate([part.angular_rate_rad_s for part in parts])
    forces = np.concatenate([part.specific_force_m_s2 for part in parts])
    for sample in (0, 4095, 4096, 9_999):
        alone = unit(preset="field").read(sample, 1)
        assert (alone.angular_rate_rad_s[0] == rates[sample]).all()
        assert (alone.specific_force_m_s2[0] == forces[sample]).all()


def test_bias_is_constant_and_differs_by_axis_and_seed(unit):
    """The bias at switch-on is one number for each axis, normal over seeds."""
    first, second = (unit(gyro_bias_rad_s=0.1, seed=s).read(0, 5).angular_rate_rad_s for s in (0, 1))
    assert (first == first[0]).all()
    assert len(np.unique(np.concatenate([first[0], second[0]]))) == 6
    many = [unit(gyro_bias_rad_s=0.1, seed=s).read(0, 1).angular_rate_rad_s / 0.1 for s in range(300)]
    assert stats.kstest(np.ravel(many), "norm").pvalue > 0.001


def test_one_who_stands_reads_gravity_alone(unit):
    """While the person stands before the first step, gait and straps are at rest: no turn, and 1 g along
    one axis."""
    walk = Walk(kind="walk", way_points_m=[[0, 0], [30, 0]], stand_s=4.0, harness=Harness())
    site = HallWorld(Hall(kind="hall", length_m=50.0, width_m=50.0, height_m=5.0))
    motion, _ = walk.carrier(site, gps=Gps(), reach_m=50.0, start_ns=START_NS, seed=3)
    read = unit(motion=motion)
    standing, walking = read.read(0, 800), read.read(900, 800)
    np.testing.assert_allclose(standing.angular_rate_rad_s, 0.0, atol=1e-12)  # straps are solved to rounding
    np.testing.assert_allclose(standing.specific_force_m_s2, [[0, 0, GRAVITY_M_S2]] * 800, atol=1e-11)
    assert np.ptp(walking.specific_force_m_s2[:, 2]) > 1.0


def test_an_attitude_without_errors_is_the_true_one(unit):
    """An ideal unit that reports its attitude is levelled and turned as it hangs; one that does not has
    none."""
    tilted = StaticMotion(np.zeros(3), 50.0, 20.0, -10.0)
    read = unit(motion=tilted, attitude=True).read(0, 3)
    np.testing.assert_allclose(
        read.world_R_imu,
        np.broadcast_to(tilted.poses_at(np.zeros(1, np.int64)).world_R_body, (3, 3, 3)),
        atol=1e-15,
    )
    assert unit().read(0, 3).world_R_imu is None


def test_an_attitude_is_levelled_by_what_the_unit_feels(unit):
    """What a resting unit with a bias reports turns the acceleration that it feels to the vertical, and no
    farther than the bias asks."""
    tilted = StaticMotion(np.zeros(3), 50.0, 20.0, -10.0)
    read = unit(motion=tilted, attitude=True, accel_bias_m_s2=0.2).read(0, 2)
    up = np.einsum("nij,nj->ni", read.world_R_imu, read.specific_force_m_s2)
    np.testing.assert_allclose(up[:, :2], 0.0, atol=1e-12)
    true = tilted.poses_at(np.zeros(1, np.int64)).world_R_body[0]
    off_rad = Rotation.from_matrix(read.world_R_imu[0] @ true.T).magnitude()
    assert off_rad == pytest.approx(np.hypot(*(true @ read.accel_bias_m_s2[0])[:2]) / GRAVITY_M_S2, rel=0.05)


def test_the_heading_drifts_with_the_gyroscopes(unit):
    """The heading is off by bias times time, also if the unit sways, and by a random walk of the density
    of the noise; the same however it is read."""
    biased = unit(attitude=True, gyro_bias_rad_s=1e-3)
    late = biased.read(200 * 60, 1)
    heading = Rotation.from_matrix(late.world_R_imu).as_euler("zyx")[0, 0]
    assert heading == pytest.approx(60 * late.gyro_bias_rad_s[0, 2], abs=1e-12)
    sway = device_motion(
        StaticMotion(np.zeros(3), 0.0, 0.0, 0.0), Mount(spin_hz=2.0, spin_axis=(0.04, 0.0, 1.0)), START_NS
    )
    late = unit(motion=sway, attitude=True, gyro_bias_rad_s=1e-3).read(200 * 600, 200)
    off = late.world_R_imu @ sway.poses_at(late.t_ns).world_R_body.swapaxes(1, 2)
    assert np.ptp(np.diff(Rotation.from_matrix(off).as_euler("zyx")[:, 0])) < 1e-9
    ends = []
    for seed in range(60):
        noisy = unit(attitude=True, gyro_noise_rad_s_sqrt_hz=1e-3, seed=seed)
        ends.append(Rotation.from_matrix(noisy.read(200 * 25, 1).world_R_imu).as_euler("zyx")[0, 0])
        np.testing.assert_array_equal(noisy.read(0, 60).world_R_imu[40:], noisy.read(40, 20).world_R_imu)
    assert stats.kstest(np.array(ends) / (1e-3 * 5.0), "norm").pvalue > 0.001
