"""What the receiver says of the walk, and the globe around the world's metres."""

import dataclasses
import math

import numpy as np
import pymap3d
import pytest
from scipy import stats

from vlp16emu.motion.gnss import Receiver, to_geodetic, to_local, wander
from vlp16emu.motion.pose import Kinematics
from vlp16emu.motion.settings import Gps
from vlp16emu.units import S_NS

START_NS = 1_780_000_000 * S_NS
EXACT = Gps(
    latitude_deg=62.0,
    longitude_deg=25.0,
    height_m=100.0,
    position_noise_m=0.0,
    wander_m=0.0,
    velocity_noise_m_s=0.0,
    canopy_error_factor=3.0,
    canopy_half_cover=0.9,
)
NOISY = EXACT.model_copy(update={"position_noise_m": 0.3, "wander_m": 1.2, "velocity_noise_m_s": 0.05})


class Straight:
    """A body that has always been going one way."""

    run_time_s, moves = math.inf, True

    def __init__(self, velocity_m_s):
        self.velocity_m_s = np.array(velocity_m_s)

    def kinematics_at(self, t_ns):
        """Poses and velocities at instants (n,)."""
        n, still = len(t_ns), np.zeros((len(t_ns), 3))
        p = ((t_ns - START_NS) / S_NS)[:, None] * self.velocity_m_s
        turns = np.broadcast_to(np.eye(3), (n, 3, 3))
        return Kinematics(t_ns, turns, p, still + self.velocity_m_s, still, still, still)


def receiver(errors=EXACT, *, velocity_m_s=(0.0, 0.0, 0.0), seed=1, sky=None):
    return Receiver(Straight(velocity_m_s), errors, seed=seed, sky=sky)


def at(second):
    return START_NS + second * S_NS


def test_without_errors_the_fix_is_the_truth():
    """Place, speed and course are those of the antenna at the second itself, to the micrometre."""
    fix = receiver(velocity_m_s=(0.6, 0.8, 0.1)).fix(at(10))
    there = to_geodetic(np.array([[6.0, 8.0, 1.2]]), EXACT)[0]
    back_m = to_local(np.array([[fix.latitude_deg, fix.longitude_deg, there[2]]]), EXACT)[0]
    np.testing.assert_allclose(back_m, [6.0, 8.0, 1.2], atol=1e-6)
    assert fix.t_ns == at(10)
    assert fix.valid
    assert fix.speed_m_s == pytest.approx(1.0)
    assert fix.course_deg == pytest.approx(math.degrees(math.atan2(0.6, 0.8)))


@pytest.mark.parametrize(("speed_m_s", "reported_m_s"), [(500.0, 500.0), (515.0, 513.93), (1e300, 513.93)])
def test_a_receiver_reports_at_most_999_knots(speed_m_s, reported_m_s):
    """Whatever makes it believe to be faster, the speed that is reported ends where receivers end."""
    assert receiver(velocity_m_s=(0.0, speed_m_s, 0.0)).fix(START_NS).speed_m_s == pytest.approx(reported_m_s)


@pytest.mark.parametrize("lag_s", [0, 30, 120, 600])
def test_wander_has_the_autocovariance_it_states(lag_s):
    """Over 2000 seeds the product of two seconds a lag apart has the mean exp(-lag / 120 s), within 5
    sigma."""
    first_s = 1_780_000_000
    pairs = [
        wander(seed, 0, first_s, 120.0) * wander(seed, 0, first_s + lag_s, 120.0) for seed in range(2000)
    ]
    # The product of two standard normal numbers with correlation r has the variance 1 + r^2.
    r = math.exp(-lag_s / 120.0)
    assert np.mean(pairs) == pytest.approx(r, abs=5 * math.sqrt((1 + r * r) / 2000))


@pytest.mark.parametrize(("cover", "factor"), [(0.0, 1.0), (0.5, 2.0), (1.0, 3.0)])
def test_errors_have_their_sigmas_and_grow_with_cover(cover, factor):
    """Over 1000 seeds position and velocity errors are normal with the stated sigma times the factor of
    the cover, and of each axis its own."""
    readings = [receiver(NOISY, seed=seed, sky=lambda _t, _p: cover).reading(at(0)) for seed in range(1000)]
    position_m = np.array([r.measured_m[:2] - r.antenna_m[:2] for r in readings])
    velocity_m_s = np.array([r.measured_m_s - r.velocity_m_s[:2] for r in readings])
    assert abs(np.corrcoef(position_m.T)[0, 1]) < 5 / math.sqrt(1000)
    for axis in (0, 1):
        for errors, sigma in ((position_m, math.hypot(0.3, 1.2)), (velocity_m_s, 0.05)):
            assert stats.kstest(errors[:, axis] / (factor * sigma), "norm").pvalue > 1e-4
    assert all(r.measured_m[2] == r.antenna_m[2] == 0.2 for r in readings)


def test_consecutive_seconds_share_what_wanders_only():
    """From one second to the next the error changes by the white noise, not by the wander."""
    steady = NOISY.model_copy(update={"wander_s": 1e6})
    east_m = np.array([receiver(steady).reading(at(s)).measured_m[0] for s in range(600)])
    assert np.diff(east_m).std() == pytest.approx(0.3 * math.sqrt(2), rel=0.12)


@pytest.mark.parametrize(("cover", "lost"), [(0.8, 0.1192), (0.9, 0.5), (1.0, 0.8808)])
def test_fixes_fail_as_the_logistic_curve_says(cover, lost):
    """Over 1000 seeds the share of seconds without fix is 1 / (1 + exp(-(cover - 0.9) / 0.05)), within 5
    sigma."""
    valid = [receiver(seed=seed, sky=lambda _t, _p: cover).reading(at(0)).valid for seed in range(1000)]
    assert 1 - np.mean(valid) == pytest.approx(lost, abs=5 * math.sqrt(lost * (1 - lost) / 1000))


def test_fixes_fail_in_spells():
    """The second after one without fix has none either in 1/2 + asin(exp(-0.1)) / pi of all cases, over 10
    seeds."""
    again = []
    for seed in range(10):
        there = receiver(seed=seed, sky=lambda _t, _p: 0.9)
        lost = ~np.array([there.reading(at(s)).valid for s in range(200)])
        again += lost[1:][lost[:-1]].tolist()
    assert np.mean(again) == pytest.approx(0.5 + math.asin(math.exp(-0.1)) / math.pi, abs=0.05)


def test_a_lost_fix_repeats_the_last_one():
    """Under a roof that is entered at second 100 the numbers stay those of second 99, and the status says
    so."""
    hidden = NOISY.model_copy(update={"canopy_half_cover": 0.5})
    walk = receiver(hidden, velocity_m_s=(1.0, 0.0, 0.0), sky=lambda t_ns, _p: float(t_ns >= at(100)))
    last = walk.fix(at(99))
    assert last.valid
    for second in (100, 105, 109):
        fix = walk.fix(at(second))
        assert fix == dataclasses.replace(last, t_ns=at(second), valid=False)


def test_after_ten_seconds_the_track_is_carried_on():
    """Where ten seconds have no fix the numbers are those measured ten seconds ago."""
    hidden = EXACT.model_copy(update={"canopy_half_cover": 0.5})
    roof = receiver(hidden, velocity_m_s=(1.0, 0.0, 0.0), sky=lambda _t, _p: 1.0)
    free = receiver(velocity_m_s=(1.0, 0.0, 0.0))
    assert roof.fix(at(50)) == dataclasses.replace(free.fix(at(40)), t_ns=at(50), valid=False)


def test_any_second_can_be_had_alone():
    """A second asked for first, last or twice gives the same fix; its sky is looked at once."""
    looks = []

    def sky(t_ns, antenna_m):
        looks.append(t_ns)
        return 0.85 + 0.1 * math.sin(antenna_m[0])

    forward = receiver(NOISY, velocity_m_s=(1.0, 0.5, 0.0), sky=sky)
    fixes = [forward.fix(at(s)) for s in range(40) for _ in range(2)][::2]
    assert len(looks) == len(set(looks))
    assert not all(fix.valid for fix in fixes)
    backward = [
        receiver(NOISY, velocity_m_s=(1.0, 0.5, 0.0), sky=sky).fix(at(s)) for s in reversed(range(40))
    ]
    assert backward[::-1] == fixes


ORIGINS = [
    Gps(latitude_deg=62.24, longitude_deg=25.75, height_m=120.0),
    Gps(latitude_deg=-33.5, longitude_deg=-70.6, height_m=900.0),
    Gps(latitude_deg=0.0, longitude_deg=179.9999, height_m=0.0),
    Gps(latitude_deg=89.9, longitude_deg=10.0, height_m=0.0),
]


@pytest.mark.parametrize("origin", ORIGINS)
@pytest.mark.parametrize(
    "offset_m", [(300.0, 0.0, 2.0), (0.0, 30_000.0, -40.0), (-100_000.0, 100_000.0, 9000.0)]
)
def test_a_point_lies_where_pymap3d_puts_it(origin, offset_m):
    """The geodetic point of an offset to the east, north and up is that of pymap3d, and leads back to it,
    within 1 um."""
    place = pymap3d.enu2geodetic(*offset_m, origin.latitude_deg, origin.longitude_deg, origin.height_m)
    found = to_geodetic(np.array([offset_m]), origin)[0]
    gap_m = np.array(pymap3d.geodetic2ecef(*found)) - pymap3d.geodetic2ecef(*place)
    np.testing.assert_allclose(gap_m, 0.0, atol=1e-6)
    np.testing.assert_allclose(to_local(found[None], origin), [offset_m], rtol=0, atol=1e-6)
