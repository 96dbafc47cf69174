"""Straps: the trunk's spline, and the exact swing about it; and the trunk of a walking person."""

import numpy as np
import pytest
from extras.walk.kit import gait, straps
from scipy import stats

from vlp16emu.errors import TrajectoryError
from vlp16emu.extras.walk.gait import Trunk, step_rate_hz
from vlp16emu.extras.walk.pack import KNOTS_PER_S, Pack
from vlp16emu.extras.walk.settings import Gait, Walk
from vlp16emu.motion.settings import Gps
from vlp16emu.world.hall import HallWorld
from vlp16emu.world.settings import Hall

NODES_S = np.arange(1001) / 1000


def sines(first, count):
    """Six axes of different frequencies, at rest until the first knot and swelling over a second."""
    t = np.arange(first, first + count) / KNOTS_PER_S
    x = np.clip(t, 0.0, 1.0)
    rates = np.array([1.8, 0.9, 3.6, 0.9, 1.8, 7.0])
    return 0.02 * (x**3 * (10 - 15 * x + 6 * x * x))[:, None] * np.sin(2 * np.pi * t[:, None] * rates)


@pytest.mark.parametrize(("hz", "damping", "found"), [(2.0, 0.0, "for ever"), (1.0, 1e-3, "6230 s")])
def test_undamped_straps_are_refused(hz, damping, found):
    """Straps that would swing for more than ten minutes are refused in one line that says for how long."""
    with pytest.raises(TrajectoryError, match=f"harness: swings .*{found}.*more damping"):
        Pack(sines, straps(hz, damping))


T = np.linspace(0.0, 60.0, 12_001)
WALKS = np.ones_like(T)


def test_step_rate_follows_speed_as_measured():
    """People take 111 steps a minute at 1.19 m/s and half as many at 1.19 * 0.5 ** (1 / 0.58) m/s."""
    assert step_rate_hz(1.19) * 60 == pytest.approx(111.0)
    assert step_rate_hz(1.19 * 0.5 ** (1 / 0.58)) * 60 == pytest.approx(55.5)


def test_heel_strikes_are_short_dips_at_the_lowest_point():
    """With a heel strike only, the trunk dips once per step by the given depth where the step is lowest."""
    own = dict.fromkeys(("vertical_m", "second_harmonic_m"), 0.0)
    u = Trunk(gait(**own, variation=0.0), 1.2, 1).at(T, WALKS)[:, 2]
    phase = (1.85 * T) % 1.0
    assert u.min() == pytest.approx(-0.001, rel=1e-4)
    assert abs(phase[np.argmin(u)] - 0.75) < 0.01
    assert np.abs(u[np.abs(phase - 0.75) > 0.2]).max() < 1e-6


def test_one_who_stands_does_not_bob():
    """Effort zero is no motion at all, and half of it half the motion."""
    trunk = Trunk(gait(), 1.2, 1)
    assert not trunk.at(T, 0.0 * WALKS).any()
    np.testing.assert_allclose(trunk.at(T, 0.5 * WALKS), 0.5 * trunk.at(T, WALKS), rtol=1e-12, atol=1e-18)


def test_trunk_leans_over_the_leg_it_stands_on():
    """Where the trunk is farthest to the left it rolls to the left, and it is highest there."""
    u = Trunk(gait(variation=0.0, second_harmonic_m=0.0, heel_strike_m=0.0), 1.2, 1).at(T, WALKS)
    left = np.argmax(u[:, 1])
    assert u[left, 3] < -0.029
    assert u[left, 2] > 0.0199


def test_amplitudes_vary_as_published():
    """Over many walkers the amplitude at an instant is normal about one with the set deviation."""
    t, one = np.array([100.0]), np.ones(1)
    fixed = {"step_hz": 1e-12, "variation": 0.1}  # the phase stands, so only the amplitude varies
    sway = np.array([Trunk(gait(**fixed), 1.2, seed).at(t, one)[0] for seed in range(600)])
    for axis in (0, 1, 5):
        factor = sway[:, axis] / (0.01, 0.02 * np.sqrt(0.5), 0, 0, 0, np.radians(3.5) * np.sqrt(0.5))[axis]
        assert stats.kstest((factor - 1.0) / 0.1, "norm").pvalue > 0.01


def test_stride_times_vary_as_published_and_with_long_memory():
    """Stride times deviate by the set share, and neighbours resemble each other as those of people do."""
    t = np.linspace(0.0, 1200.0, 160_001)
    u = Trunk(gait(variation=0.03), 1.2, 5).at(t, np.ones_like(t))[:, 1]
    up = np.flatnonzero((u[:-1] < 0) & (u[1:] >= 0))
    strides = np.diff(t[up] - u[up] * (t[1] - t[0]) / (u[up + 1] - u[up]))
    assert strides.std() / strides.mean() == pytest.approx(0.03, rel=0.35)
    centred = strides - strides.mean()
    assert (centred[1:] * centred[:-1]).mean() / centred.var() > 0.4


@pytest.mark.parametrize(("vertical_m", "warned"), [(0.3, False), (1.0, True)])
def test_a_gait_that_leads_into_the_ground_is_named(tmp_path, caplog, vertical_m, warned):
    """A person who carries the sensor lower than the steps are deep is warned of it; the walk has it under
    the ground."""
    gait = Gait(preset="none", step_hz=1.8, vertical_m=vertical_m)
    walk = Walk(kind="walk", way_points_m=[(0.0, 0.0), (20.0, 0.0)], sensor_height_m=0.4, gait=gait)
    site = HallWorld(Hall(kind="hall", length_m=50.0, width_m=50.0, height_m=5.0))
    motion, _ = walk.carrier(site, gps=Gps(), reach_m=50.0, start_ns=0, seed=1)
    lowest_m = motion.poses_at(np.arange(3_000_000_000, 6_000_000_000, 5_000_000)).world_p_body_m[:, 2].min()
    assert (lowest_m < 0) == warned == ("motion.gait: lowers the sensor by" in caplog.text)
