"""What an inertial measurement unit reads."""

import numpy as np
import pytest
from scipy import stats

from vlp16emu.motion import Imu, ImuErrors, Mount, Standing, mounted
from vlp16emu.motion.imu import GRAVITY_M_S2

IDEAL = ImuErrors(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.fixture
def unit(start_ns):
    """Make a unit, on a tripod unless told otherwise."""

    def make(errors=IDEAL, motion=None, rate_hz=200, seed=1, number=0):
        motion = motion or Standing(np.zeros(3), 0.0, 0.0, 0.0)
        return Imu(motion, start_ns=start_ns, rate_hz=rate_hz, errors=errors, seed=seed, unit=number)

    return make


def test_at_rest_it_reads_gravity_upwards(unit, start_ns):
    """Level it reads 1 g up; tilted 30 degrees nose down, half of it backwards."""
    level = unit().read(0, 10)
    np.testing.assert_allclose(level.specific_force_m_s2, [[0, 0, 9.80665]] * 10, atol=1e-15)
    assert not level.angular_rate_rad_s.any()
    tilted = unit(motion=Standing(np.zeros(3), 45.0, 30.0, 0.0)).read(0, 1)
    np.testing.assert_allclose(
        tilted.specific_force_m_s2[0], GRAVITY_M_S2 * np.array([-0.5, 0, np.sqrt(0.75)])
    )


def test_on_a_circle_it_reads_the_turn_and_the_pull_inwards(unit, walking, circle, still, start_ns):
    """At 1.2 m/s on 8 m it turns 0.15 rad/s and is pulled 0.18 m/s2 to the left; 1 m farther left, less."""
    carrier = walking(circle(), still)
    read = unit(motion=carrier).read(1000, 400)
    np.testing.assert_allclose(read.angular_rate_rad_s, [[0, 0, 0.15]] * 400, atol=1e-8)
    np.testing.assert_allclose(read.specific_force_m_s2, [[0, 0.18, GRAVITY_M_S2]] * 400, atol=1e-8)
    inner = mounted(carrier, Mount((0.0, 1.0, 0.0), 0.0, 0.0, 0.0, 0.0, (0.0, 0.0, 1.0)), start_ns)
    np.testing.assert_allclose(
        unit(motion=inner).read(1000, 9).specific_force_m_s2[:, 1], 0.18 * 7 / 8, atol=1e-8
    )


def test_samples_come_at_the_exact_rate(unit, start_ns):
    """Also at a rate that does not divide a second, no nanosecond is lost over a day."""
    t_ns = unit(rate_hz=300).read(300 * 86_400, 4).t_ns - start_ns
    assert t_ns.tolist() == [86_400 * 10**9 + ns for ns in (0, 3_333_333, 6_666_666, 10_000_000)]


def test_white_noise_has_its_density(unit):
    """Samples are normal, with the density times the root of the rate as deviation, and independent."""
    noise = unit(ImuErrors(0.0, 1e-3, 0.0, 0.0, 2e-2, 0.0), rate_hz=400).read(0, 20_000)
    gyro = noise.angular_rate_rad_s / (1e-3 * 20)
    accel = (noise.specific_force_m_s2 - [0, 0, GRAVITY_M_S2]) / (2e-2 * 20)
    for axis in range(3):
        assert stats.kstest(gyro[:, axis], "norm").pvalue > 0.001
        assert stats.kstest(accel[:, axis], "norm").pvalue > 0.001
    both = np.corrcoef(np.hstack([gyro, accel]).T)
    assert np.abs(both - np.eye(6)).max() < 0.03


def test_random_walk_has_independent_normal_steps(unit):
    """Steps of the bias are normal with density over root of rate, also where stretches of 4096 samples meet."""
    walk = unit(ImuErrors(0.0, 0.0, 1e-3, 0.0, 0.0, 0.0), rate_hz=100).read(0, 40_000).angular_rate_rad_s
    steps = np.diff(walk, axis=0) / (1e-3 / 10)
    for axis in range(3):
        assert stats.kstest(steps[:, axis], "norm").pvalue > 0.001
        assert abs(np.corrcoef(steps[1:, axis], steps[:-1, axis])[0, 1]) < 0.02
    assert not walk[0].any()


def test_random_walk_spreads_with_the_root_of_time(unit):
    """Over many units the bias after n samples is normal with the root of n, within and beyond a stretch."""
    for sample in (900, 4096, 100_000):
        ends = [
            unit(ImuErrors(0.0, 0.0, 1.0, 0.0, 0.0, 0.0), rate_hz=1, seed=s)
            .read(sample, 1)
            .angular_rate_rad_s
            for s in range(150)
        ]
        assert stats.kstest(np.ravel(ends) / np.sqrt(sample), "norm").pvalue > 0.001


def test_readings_do_not_depend_on_what_was_read_before(unit, start_ns):
    """A stream of ten thousand samples has the bits of any single one of them, and ends before its end."""
    errors = ImuErrors(1e-2, 1e-3, 1e-4, 1e-1, 1e-2, 1e-3)
    stream = list(unit(errors).stream(start_ns + 50 * 10**9 + 1))
    assert sum(len(part.t_ns) for part in stream) == 10_001
    rates = np.concatenate([part.angular_rate_rad_s for part in stream])
    forces = np.concatenate([part.specific_force_m_s2 for part in stream])
    for sample in (0, 4095, 4096, 9_999):
        alone = unit(errors).read(sample, 1)
        assert (alone.angular_rate_rad_s[0] == rates[sample]).all()
        assert (alone.specific_force_m_s2[0] == forces[sample]).all()


def test_bias_is_constant_and_differs_by_unit_and_seed(unit):
    """The bias at switch-on is one number for each axis of each unit, normal over seeds."""
    errors = ImuErrors(0.1, 0.0, 0.0, 0.0, 0.0, 0.0)
    first, second = (unit(errors, number=n).read(0, 5).angular_rate_rad_s for n in (0, 1))
    assert (first == first[0]).all()
    assert len(np.unique(np.concatenate([first[0], second[0]]))) == 6
    many = [unit(errors, seed=s).read(0, 1).angular_rate_rad_s / 0.1 for s in range(300)]
    assert stats.kstest(np.ravel(many), "norm").pvalue > 0.001
