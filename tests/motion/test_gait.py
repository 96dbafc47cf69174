"""The trunk of a walking person."""

import numpy as np
import pytest
from scipy import stats

from vlp16emu.motion import Gait, Gps, Walk
from vlp16emu.motion.carrier import make_carrier
from vlp16emu.motion.gait import Trunk, step_rate_hz

T = np.linspace(0.0, 60.0, 12_001)
WALKS = np.ones_like(T)


def test_step_rate_follows_speed_as_measured():
    """People take 111 steps a minute at 1.19 m/s and half as many at 1.19 * 0.5 ** (1 / 0.58) m/s."""
    assert step_rate_hz(1.19) * 60 == pytest.approx(111.0)
    assert step_rate_hz(1.19 * 0.5 ** (1 / 0.58)) * 60 == pytest.approx(55.5)


def test_two_amplitudes_alone_are_two_plain_sines(gait):
    """Vertical is a sine at step rate, sideways one at stride rate, and nothing else moves."""
    own = dict.fromkeys(("second_harmonic_m", "heel_strike_m", "fore_aft_m", "roll_deg", "pitch_deg", "yaw_deg"), 0.0)
    u = Trunk(gait(**own, variation=0.0), 1.2, 1).at(T, WALKS)
    np.testing.assert_allclose(u[:, 2], 0.02 * np.sin(2 * np.pi * 1.85 * T), atol=1e-13)
    np.testing.assert_allclose(u[:, 1], 0.02 * np.sin(np.pi * 1.85 * T + np.pi / 4), atol=1e-13)
    assert not u[:, [0, 3, 4, 5]].any()


def test_heel_strikes_are_short_dips_at_the_lowest_point(gait):
    """With a heel strike only, the trunk dips once per step by the given depth where the step is lowest."""
    own = dict.fromkeys(("vertical_m", "second_harmonic_m"), 0.0)
    u = Trunk(gait(**own, variation=0.0), 1.2, 1).at(T, WALKS)[:, 2]
    phase = (1.85 * T) % 1.0
    assert u.min() == pytest.approx(-0.001, rel=1e-4)
    assert abs(phase[np.argmin(u)] - 0.75) < 0.01
    assert np.abs(u[np.abs(phase - 0.75) > 0.2]).max() < 1e-6


def test_one_who_stands_does_not_bob(gait):
    """Effort zero is no motion at all, and half of it half the motion."""
    trunk = Trunk(gait(), 1.2, 1)
    assert not trunk.at(T, 0.0 * WALKS).any()
    np.testing.assert_allclose(trunk.at(T, 0.5 * WALKS), 0.5 * trunk.at(T, WALKS), rtol=1e-12, atol=1e-18)


def test_trunk_leans_over_the_leg_it_stands_on(gait):
    """Where the trunk is farthest to the left it rolls to the left, and it is highest there."""
    u = Trunk(gait(variation=0.0, second_harmonic_m=0.0, heel_strike_m=0.0), 1.2, 1).at(T, WALKS)
    left = np.argmax(u[:, 1])
    assert u[left, 3] < -0.029
    assert u[left, 2] > 0.0199


def test_amplitudes_vary_as_published(gait):
    """Over many walkers the amplitude at an instant is normal about one with the set deviation."""
    t, one = np.array([100.0]), np.ones(1)
    fixed = {"step_hz": 1e-12, "variation": 0.1}  # the phase stands, so only the amplitude varies
    sway = np.array([Trunk(gait(**fixed), 1.2, seed).at(t, one)[0] for seed in range(600)])
    for axis in (0, 1, 5):
        factor = sway[:, axis] / (0.01, 0.02 * np.sqrt(0.5), 0, 0, 0, np.radians(3.5) * np.sqrt(0.5))[axis]
        assert stats.kstest((factor - 1.0) / 0.1, "norm").pvalue > 0.01


def test_stride_times_vary_as_published_and_with_long_memory(gait):
    """Stride times deviate by the set share, and neighbours resemble each other as those of people do."""
    t = np.linspace(0.0, 1200.0, 240_001)
    u = Trunk(gait(variation=0.03), 1.2, 5).at(t, np.ones_like(t))[:, 1]
    up = np.flatnonzero((u[:-1] < 0) & (u[1:] >= 0))
    strides = np.diff(t[up] - u[up] * (t[1] - t[0]) / (u[up + 1] - u[up]))
    assert strides.std() / strides.mean() == pytest.approx(0.03, rel=0.35)
    centred = strides - strides.mean()
    assert (centred[1:] * centred[:-1]).mean() / centred.var() > 0.4


def test_samples_do_not_depend_on_their_company(gait):
    """A sample taken alone has the bits that it has among others; another seed has others."""
    among = Trunk(gait(), 1.2, 7).at(T, WALKS)
    alone = Trunk(gait(), 1.2, 7).at(T[9_999:10_000], np.ones(1))
    assert (among[9_999] == alone[0]).all()
    assert (Trunk(gait(), 1.2, 8).at(T, WALKS) != among).any()


@pytest.mark.parametrize(("vertical_m", "warned"), [(0.3, False), (1.0, True)])
def test_a_gait_that_leads_into_the_ground_is_named(tmp_path, caplog, vertical_m, warned):
    """A person who carries the sensor lower than the steps are deep is warned of it; the walk has it under the ground."""
    gait = Gait(preset="none", step_hz=1.8, vertical_m=vertical_m)
    walk = Walk(kind="walk", way_points_m=[(0.0, 0.0), (20.0, 0.0)], sensor_height_m=0.4, gait=gait)
    world = {"origin_m": (0.0, 0.0, 0.0), "gps": Gps(), "reach_m": 50.0, "start_ns": 0, "seed": 1}
    motion, _ = make_carrier(walk, lambda x, _y: 0.0 * x, "", **world)
    lowest_m = motion.poses_at(np.arange(3_000_000_000, 6_000_000_000, 5_000_000)).world_p_body_m[:, 2].min()
    assert (lowest_m < 0) == warned == ("motion.gait: lowers the sensor by" in caplog.text)
