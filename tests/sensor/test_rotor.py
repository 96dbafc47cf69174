"""The rotor's true angle, the encoder's errors, and the top-of-hour counter."""

from fractions import Fraction

import numpy as np
import pytest
from scipy import stats

from vlp16emu.sensor.beams import SEQUENCE_NS
from vlp16emu.sensor.rotor import Clock, ClockSpan, EncoderLines, Pattern, Rotor, Spin, Swing
from vlp16emu.units import HOUR_NS


def rotor_of(rpm=600, *, angle_deg=0.0, seed=1, **errors):
    """Make a rotor at constant speed that has these errors alone."""
    none = {"eccentricity_deg": 0.0, "eccentricity_phase_deg": 0.0, "noise_deg": 0.0}
    return Rotor(spins=(Spin(0, angle_deg, rpm),), seed=seed, **none | errors)


@pytest.mark.parametrize("rpm", [300, 420, 600, 1200])
def test_a_block_turns_by_the_manuals_angle(rpm):
    """Two firing sequences turn the head by rpm * 6 * 110.592 us."""
    rotor = rotor_of(rpm)
    step = np.diff(rotor.angle_deg(np.arange(3) * 2 * SEQUENCE_NS))
    np.testing.assert_allclose(step, rpm * 6 * 110.592e-6, rtol=1e-12)


@pytest.mark.parametrize("rpm", [300, 420, 1140])
def test_angle_is_exact_after_a_day(rpm):
    """A day and a millisecond after the start the angle is that of the millisecond, to the last bit."""
    rotor = rotor_of(rpm)
    day = np.array([1_000_000, 86_400 * 10**9 + 1_000_000])
    first, later = rotor.angle_deg(day)
    assert first == later


@pytest.mark.parametrize("rpm", [61, 90, 750, 3599])
def test_any_whole_speed_is_exact_after_years(rpm):
    """At a speed that makes no whole turns in a second the angle still is the exact fraction, years later too."""
    rotor = rotor_of(rpm)
    elapsed_ns = np.array([1, 999_999_999, 59 * 10**9 + 1, 10 * 365 * 86_400 * 10**9 + 1_234_567_891])
    exact = [float(Fraction(int(ns) * rpm * 6, 10**9) % 360) for ns in elapsed_ns]
    np.testing.assert_allclose(rotor.angle_deg(elapsed_ns), exact, rtol=0, atol=1e-9)


def test_ideal_encoder_reads_the_truth():
    """With both errors off the reading is the angle itself."""
    rotor = rotor_of()
    angle = rotor.angle_deg(np.arange(1000) * SEQUENCE_NS)
    assert (rotor.reading_deg(angle, 0) == angle).all()


def test_noise_is_white_and_as_wide_as_set():
    """Reading errors are normal with the sigma that was set, and not correlated with their neighbours."""
    rotor = rotor_of(seed=3, noise_deg=0.005)
    angle = np.full(20_000, 180.0)
    error = rotor.reading_deg(angle, 0) - angle
    assert stats.kstest(error / 0.005, "norm").pvalue > 0.01
    assert abs(np.corrcoef(error[1:], error[:-1])[0, 1]) < 0.02


def test_noise_belongs_to_the_firing_sequence():
    """A reading is the same whether its sequence is asked for alone or among others."""
    rotor = rotor_of(seed=3, noise_deg=0.005)
    angle = rotor.angle_deg(np.arange(100) * SEQUENCE_NS)
    assert (rotor.reading_deg(angle, 0)[60:70] == rotor.reading_deg(angle[60:70], 60)).all()


def test_eccentricity_is_one_cycle_per_revolution():
    """The angle-locked error is a sine of the angle with the amplitude and phase that were set."""
    rotor = rotor_of(eccentricity_deg=0.06, eccentricity_phase_deg=40.0)
    angle = np.linspace(1.0, 359.0, 500)
    error = rotor.reading_deg(angle, 0) - angle
    np.testing.assert_allclose(error, 0.06 * np.sin(np.radians(angle - 40.0)), atol=1e-12)


def test_readings_stay_in_the_circle():
    """Errors at the wrap lead to readings in [0, 360), never to 360 or less than 0."""
    rotor = rotor_of(seed=5, noise_deg=0.02)
    reading = rotor.reading_deg(np.zeros(1000), 0)
    assert ((reading >= 0) & (reading < 360)).all()
    assert (reading > 359).any()
    assert (reading < 1).any()


def test_a_motor_swings_about_its_speed():
    """It begins where a steady one does, is ahead by the integral of its speed, and comes back after a period."""
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


def test_a_stopped_motor_does_not_swing():
    """Where the rotor is at rest its angle is one."""
    swing = Swing(amplitude_ns=50_000.0, period_ns=1e9, phase_rad=0.5)
    rotor = rotor_of(0, angle_deg=10.0, swings=(swing,))
    assert set(rotor.angle_deg(np.arange(0, 10**9, 10**7))) == {10.0}


def test_readings_hum_and_are_cut():
    """The hum repeats every 25 sequences wherever a window begins, and no reading is farther off than the limit."""
    pattern = Pattern(0.0, 0.0, 0.002, 30.0)
    rotor = rotor_of(pattern=pattern)
    off = rotor.reading_deg(np.full(100, 90.0), 5) - 90.0
    np.testing.assert_allclose(off[:25], off[25:50], atol=1e-12)
    assert np.ptp(off) == pytest.approx(0.004, rel=0.02)
    np.testing.assert_array_equal(off[10:], rotor.reading_deg(np.full(90, 90.0), 15) - 90.0)
    noisy = rotor_of(noise_limit_deg=0.01, noise_deg=0.005)
    off = noisy.reading_deg(np.full(20_000, 90.0), 0) - 90.0
    assert np.abs(off).max() == pytest.approx(0.01)
    assert (np.abs(off) > 0.00999).mean() == pytest.approx(2 * stats.norm.sf(2), rel=0.15)


def test_an_encoder_of_lines_reads_as_real_ones_do():
    """Codes modulo five and twenty and steps between blocks have the shares of real units, cut anywhere, and on a line readings are exact."""
    lines = EncoderLines(pitch_deg=0.05, rate_error=0.24, first_deg=0.02)
    rotor = rotor_of(lines=lines, noise_deg=0.0024)
    angle_deg = rotor.angle_deg(np.arange(60_000) * 2 * SEQUENCE_NS)
    read_deg = rotor.reading_deg(angle_deg, 0)
    code = np.floor(read_deg * 100 + 1e-6).astype(int)
    shares = np.bincount((code - 2) % 5) / len(code)
    np.testing.assert_allclose(shares, [0.223, 0.225, 0.215, 0.194, 0.143], atol=0.012)  # mean of mrpt, nebula, einride
    last_of_four = np.bincount((code - 2) % 20)[4::5] / len(code)
    np.testing.assert_allclose(
        20 * last_of_four, [0.08, 0.56, 1.28, 0.94], atol=0.12
    )  # the same three: 0.17, 0.03, 0.04; 0.50, 0.67, 0.51; 1.13, 1.27, 1.44; 0.92, 0.82, 1.08
    steps = np.diff(code) % 36_000
    found = [(steps == step).mean() for step in (38, 39, 40, 41, 42)]
    np.testing.assert_allclose(found, [0.079, 0.224, 0.548, 0.124, 0.025], atol=0.03)
    np.testing.assert_array_equal(read_deg[777:], rotor.reading_deg(angle_deg[777:], 777))
    exact = rotor_of(lines=lines)
    on_lines_deg = 0.02 + 0.05 * np.arange(1, 50) + 1e-9
    np.testing.assert_allclose(exact.reading_deg(on_lines_deg, 0), on_lines_deg, atol=1e-8)


def test_an_even_encoder_draws_nothing():
    """Without lines readings are those of before, bit by bit."""
    plain = rotor_of(noise_deg=0.005)
    even = rotor_of(lines=EncoderLines.drawn(1, 0.0, 0.2, 0.0), noise_deg=0.005)
    angle_deg = plain.angle_deg(np.arange(1000) * SEQUENCE_NS)
    np.testing.assert_array_equal(plain.reading_deg(angle_deg, 0), even.reading_deg(angle_deg, 0))


TEN_O_CLOCK_NS = 1_780_000_000 * 10**9 // HOUR_NS * HOUR_NS


def test_locked_clock_shows_the_utc_hour():
    """Locked to GPS, the counter is the time past the UTC hour and rolls over with it."""
    clock = Clock((ClockSpan(TEN_O_CLOCK_NS - 17),))
    t_ns = TEN_O_CLOCK_NS + np.array([-1, 0, 1])
    assert clock.reading_ns(t_ns).tolist() == [HOUR_NS - 1, 0, 1]


def test_free_clock_counts_from_power_up():
    """Without GPS the counter is unrelated to UTC: zero at power-up and again every hour."""
    clock = Clock((ClockSpan(TEN_O_CLOCK_NS + 123, 0, 0.0),))
    t_ns = TEN_O_CLOCK_NS + 123 + np.array([0, HOUR_NS - 1, HOUR_NS, 25 * HOUR_NS + 5])
    assert clock.reading_ns(t_ns).tolist() == [0, HOUR_NS - 1, 0, 5]


def test_free_clock_shows_nothing_before_power_up():
    """Before power-up the counter stands at zero; it does not wrap to the end of an hour."""
    clock = Clock((ClockSpan(TEN_O_CLOCK_NS, 0, -100.0),))
    t_ns = TEN_O_CLOCK_NS + np.array([-350_000, -1, 0, 10**9])
    assert clock.reading_ns(t_ns).tolist() == [0, 0, 0, 10**9 - 100_000]


def test_free_clock_runs_fast_by_its_error():
    """20 ppm are 20 microseconds in a second and 72 milliseconds in an hour."""
    clock = Clock((ClockSpan(0, 0, 20.0),))
    assert clock.reading_ns(np.array([10**9, HOUR_NS])).tolist() == [10**9 + 20_000, 72_000_000]
