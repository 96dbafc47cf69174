"""The rotor's true angle, the encoder's errors, and the top-of-hour counter."""

from fractions import Fraction

import numpy as np
import pytest
from scipy import stats

from vlp16emu.sensor.beams import SEQUENCE_NS
from vlp16emu.sensor.clock import Clock, ClockSpan
from vlp16emu.sensor.rotor import Encoder, Rotor, Spin, Swing, _speeds
from vlp16emu.sensor.settings import Sensor
from vlp16emu.units import HOUR_NS


def rotor_of(rpm=600, *, angle_deg=0.0, swings=()):
    return Rotor((Spin(0, angle_deg, rpm),), Encoder(1), swings=swings)


def angles_deg(count):
    """True angles (n,) of a steady rotor at the first sequence of each block."""
    return rotor_of().angle_deg(np.arange(count) * 2 * SEQUENCE_NS)


@pytest.mark.parametrize("rpm", [61, 300, 420, 600, 1140, 3599])
def test_any_whole_speed_is_exact_after_years(rpm):
    """The angle is the exact fraction of the manual's rpm * 6 per second, years later too, and at speeds
    without whole turns in a second."""
    rotor = rotor_of(rpm)
    elapsed_ns = np.array([1, 999_999_999, 59 * 10**9 + 1, 10 * 365 * 86_400 * 10**9 + 1_234_567_891])
    exact = [float(Fraction(int(ns) * rpm * 6, 10**9) % 360) for ns in elapsed_ns]
    np.testing.assert_allclose(rotor.angle_deg(elapsed_ns), exact, rtol=0, atol=1e-9)


def test_readings_without_errors_are_true_and_others_in_the_circle():
    """Without errors the reading is the angle itself, bit by bit; errors at the wrap lead to readings in
    [0, 360)."""
    angle_deg = angles_deg(1000)
    assert (Encoder(1).read(angle_deg, np.arange(len(angle_deg)), *EVEN) == angle_deg).all()
    reading = Encoder(5, noise_deg=0.02).read(np.zeros(1000), np.arange(1000), *EVEN)
    assert ((reading >= 0) & (reading < 360)).all()
    assert (reading > 359).any()
    assert (reading < 1).any()


def test_noise_is_white_and_as_wide_as_set():
    """Reading errors are normal with the sigma that was set, not correlated with their neighbours, and cut
    at the limit."""
    error = Encoder(3, noise_deg=0.005).read(np.full(20_000, 180.0), np.arange(20_000), *EVEN) - 180.0
    assert stats.kstest(error / 0.005, "norm").pvalue > 0.01
    assert abs(np.corrcoef(error[1:], error[:-1])[0, 1]) < 0.02
    error = (
        Encoder(3, noise_deg=0.005, noise_limit_deg=0.01).read(
            np.full(20_000, 90.0), np.arange(20_000), *EVEN
        )
        - 90.0
    )
    assert np.abs(error).max() == pytest.approx(0.01)
    assert (np.abs(error) > 0.00999).mean() == pytest.approx(2 * stats.norm.sf(2), rel=0.15)


EVEN = 0, 600.0  # clock and speed of an encoder that is read at any time
LINES = {"pitch_deg": 0.05, "rate_error": 0.2464, "first_deg": 0.02}


@pytest.mark.parametrize("errors", [{"noise_deg": 0.005}, {"hum_deg": 0.002}, {"noise_deg": 0.0024, **LINES}])
def test_errors_belong_to_the_firing_sequence(errors):
    """A reading has the same bits whether its sequence is asked for alone or among others."""
    encoder, angle_deg = Encoder(3, **errors), angles_deg(100)
    clock_ns = 55_296 * np.arange(100)
    whole, piece = (
        encoder.read(angle_deg, np.arange(5, 105), clock_ns, 600.0),
        encoder.read(angle_deg[60:70], np.arange(65, 75), clock_ns[60:70], 600.0),
    )
    assert (whole[60:70] == piece).all()


@pytest.mark.parametrize("cycles", [1, 2])
def test_errors_of_the_turn_are_sines_of_the_angle(cycles):
    """The error once, or twice, per revolution is a sine of the angle with the amplitude and phase that
    were set."""
    angle_deg = np.linspace(1.0, 359.0, 500)
    error = (
        Encoder(1, **{("once", "twice")[cycles - 1]: (0.06, 40.0)}).read(
            angle_deg, np.arange(len(angle_deg)), *EVEN
        )
        - angle_deg
    )
    np.testing.assert_allclose(error, 0.06 * np.sin(np.radians(cycles * angle_deg - 40.0)), atol=1e-12)


@pytest.mark.parametrize("rpm", [300, 600, 1200])
def test_the_reading_is_that_of_the_last_tick(rpm):
    """It falls behind for 1.2 us, by 1.05 us of the speed, and jumps at 0.5 us of the stamp."""
    clock_ns = np.arange(7_200)
    off = (
        Encoder(1, hum_deg=0.0019).read(np.full(7_200, 90.0), np.arange(5, 7_205), clock_ns, float(rpm))
        - 90.0
    )
    np.testing.assert_allclose(off[:1_200], off[1_200:2_400], atol=1e-12)
    assert np.flatnonzero(np.diff(off) > 0).tolist() == [499 + 1_200 * i for i in range(6)]
    assert np.ptp(off) == pytest.approx(6 * rpm * 1.055e-6, rel=0.01)


def test_units_differ_by_their_spread():
    """Without `rotation_spread` a unit is as set; with it amplitudes are even within that share, phases
    anywhere (KS)."""
    assert Encoder.of_unit(Sensor(rotation_spread=0.0), 3).once == (0.06, 40.0)
    units = [Encoder.of_unit(Sensor(preset="unit", rotation_spread=0.45), seed) for seed in range(400)]
    for amplitude_deg, waves in ((0.06, [u.once for u in units]), (0.0078, [u.twice for u in units])):
        share, phase = np.array(waves).T
        assert stats.kstest(share / amplitude_deg, "uniform", args=(0.55, 0.9)).pvalue > 0.01
        assert stats.kstest(phase / 360.0, "uniform").pvalue > 0.01


def test_a_motor_swings_about_its_speed():
    """It begins where a steady one does, is ahead by the integral of its speed, comes back after a period,
    and rests where it stands."""
    swing = Swing(amplitude_ns=50_000.0, period_ns=1e9, phase_rad=0.5)
    steady, swinging = (rotor_of(angle_deg=10.0, swings=swings) for swings in ((), (swing,)))
    t_ns = np.arange(0, 10**9 + 1, 10**6)
    ahead_deg = (swinging.angle_deg(t_ns) - steady.angle_deg(t_ns) + 180) % 360 - 180
    assert ahead_deg[0] == 0
    assert ahead_deg[-1] == pytest.approx(0, abs=1e-5)
    expected_deg = 3600 * 50e-6 * (np.sin(2e-9 * np.pi * t_ns + 0.5) - np.sin(0.5))
    np.testing.assert_allclose(ahead_deg, expected_deg, atol=2e-5)
    assert swinging.rpm_at(0) == pytest.approx(600 * (1 + 50e-6 * 2 * np.pi * np.cos(0.5)))
    np.testing.assert_array_equal(swinging.angle_deg(t_ns[500:]), swinging.angle_deg(t_ns)[500:])
    resting = rotor_of(0, angle_deg=10.0, swings=(swing,))
    assert set(resting.angle_deg(np.arange(0, 10**9, 10**7))) == {10.0}


def test_an_encoder_of_lines_reads_as_real_ones_do():
    """Codes modulo five and twenty and steps between blocks have the shares of real units, and on a line
    readings are exact."""
    clock_ns = 110_592 * np.arange(60_000)
    read_deg = Encoder(1, noise_deg=0.00145, hum_deg=0.0019, **LINES).read(
        angles_deg(60_000), np.arange(60_000), clock_ns, 600.0
    )
    code = np.floor(read_deg * 100 + 1e-6).astype(int)
    shares = np.bincount((code - 2) % 5) / len(code)
    np.testing.assert_allclose(
        shares, [0.223, 0.225, 0.215, 0.194, 0.143], atol=0.012
    )  # mean of mrpt, nebula, einride
    last_of_four = np.bincount((code - 2) % 20)[4::5] / len(code)
    np.testing.assert_allclose(
        20 * last_of_four, [0.08, 0.56, 1.28, 0.94], atol=0.12
    )  # the same three: 0.17, 0.03, 0.04; 0.50, 0.67, 0.51; 1.13, 1.27, 1.44; 0.92, 0.82, 1.08
    steps = np.diff(code) % 36_000
    assert (steps == 37).mean() < 1e-4  # none in 24 500 of real units
    found = [(steps == step).mean() for step in (38, 39, 40, 41, 42)]
    np.testing.assert_allclose(found, [0.079, 0.224, 0.548, 0.124, 0.025], atol=0.03)
    on_lines_deg = 0.02 + 0.05 * np.arange(1, 50) + 1e-9
    np.testing.assert_allclose(
        Encoder(1, **LINES).read(on_lines_deg, np.arange(len(on_lines_deg)), *EVEN), on_lines_deg, atol=1e-8
    )


def test_no_unit_has_steps_that_real_units_lack():
    """Each of 60 units has a variance of steps within that of real ones (0.518 to 0.567 over an even ruler's,
    widened by half), and hardly a step of 37.

    No speed is further off than the slowest real one's, by 0.16 %.
    """
    clock_ns, section = 110_592 * np.arange(24_000), Sensor(preset="unit")
    short = 0
    for seed in range(60):
        swings = Swing.sample(seed, section.speed_error_rpm, section.speed_wander_rpm)
        assert abs(swings[0].rate_at(0)) <= 0.95 / 600
        true_deg = rotor_of(swings=swings).angle_deg(clock_ns)
        step = (
            np.diff(
                np.floor(
                    Encoder.of_unit(section, seed).read(true_deg, np.arange(24_000), clock_ns, 600.0) * 100
                )
            )
            % 36_000
        )
        part = step.mean() % 1
        assert 0.494 < step.var() - part * (1 - part) < 0.592
        assert (step < 38).mean() < 2.5e-4
        short += (step < 38).sum()
    assert short < 60 * len(clock_ns) * 4e-5  # 0.64 in 10 000 with lines that scatter over 1.6 us


TEN_O_CLOCK_NS = 1_780_000_000 * 10**9 // HOUR_NS * HOUR_NS


@pytest.mark.parametrize(
    ("rpm", "slow", "fast", "share"),
    [(300, 0.375, 0.5, 0.15), (500, 0.625, 1.0, 0.06), (600, 0.625, 1.0, 0.43), (1200, 1.25, 2.0, 0.93)],
)
def test_the_two_speeds_between_lines_are_those_of_real_units(rpm, slow, fast, share):
    """Hundredths of a degree in 2.304 us, and the share of the faster, at the speeds at which units were
    recorded."""
    true_cdeg = rpm * 6 * 2.304e-4
    low, high, slow_share = (float(x) for x in _speeds(np.array(float(rpm))))
    assert (low * true_cdeg, high * true_cdeg) == pytest.approx((slow, fast))
    assert 1 - slow_share == pytest.approx(share, abs=0.025)


def test_a_locked_clock_shows_the_utc_hour():
    """It rolls over with the UTC hour; by its rate it is right at each even second, ahead at odd ones, and
    never steps."""
    clock = Clock((ClockSpan(0, None, 0.5),))
    t_ns = np.arange(0, 4 * 10**9, 10**7)
    ahead_ns = clock.reading_ns(t_ns) - t_ns
    assert ahead_ns[[0, 100, 200, 300]].tolist() == [0, 500, 0, 500]
    assert np.abs(np.diff(ahead_ns)).max() == 5
    clock = Clock((ClockSpan(TEN_O_CLOCK_NS - 17),))
    t_ns = TEN_O_CLOCK_NS + np.array([-1, 0, 1])
    assert clock.reading_ns(t_ns).tolist() == [HOUR_NS - 1, 0, 1]


@pytest.mark.parametrize(
    ("error_ppm", "since_ns", "shown_ns"),
    [
        (0.0, (0, HOUR_NS - 1, HOUR_NS, 25 * HOUR_NS + 5), (0, HOUR_NS - 1, 0, 5)),
        (-100.0, (-350_000, -1, 0, 10**9), (0, 0, 0, 10**9 - 100_000)),
        (20.0, (10**9, HOUR_NS), (10**9 + 20_000, 72_000_000)),
    ],
)
def test_free_clock_counts_from_power_up(error_ppm, since_ns, shown_ns):
    """Without GPS the counter is zero until power-up and again every hour, and fast by its error: 20 ppm
    are 72 ms an hour."""
    clock = Clock((ClockSpan(TEN_O_CLOCK_NS + 123, 0, error_ppm),))
    assert clock.reading_ns(TEN_O_CLOCK_NS + 123 + np.array(since_ns)).tolist() == list(shown_ns)
