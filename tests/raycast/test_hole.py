"""A plate with a hole of one centimetre, 10 m away, and a wall 5 m behind it."""

import numpy as np
import pytest
from raycast import lab
from scipy.stats import norm

HALF_M, PLATE_M, WALL_M = 0.005, 10.0, 15.0
SIGMA_M = np.array([0.0127 + 0.003 * PLATE_M, 0.0095 + 0.0015 * PLATE_M]) / 4
OFFSETS_M = np.array([-30, -20, -14, -9, -6, -3, 0, 2, 4, 7, 12, 18, 25]) / 1000
PULSES = 800


def scene(workers):
    plate = (
        (PLATE_M, -5.0, -HALF_M, -5.0, 5.0),
        (PLATE_M, HALF_M, 5.0, -5.0, 5.0),
        (PLATE_M, -HALF_M, HALF_M, HALF_M, 5.0),
        (PLATE_M, -HALF_M, HALF_M, -5.0, -HALF_M),
    )
    return lab.opened(workers, *lab.upright(*plate, (WALL_M, -9.0, 9.0, -9.0, 9.0)))


def expected():
    """Integral of the profile over the hole, for a beam whose middle is beside the hole's by each offset."""
    across = norm.cdf((HALF_M - OFFSETS_M) / SIGMA_M[0]) - norm.cdf((-HALF_M - OFFSETS_M) / SIGMA_M[0])
    return across * (2 * norm.cdf(HALF_M / SIGMA_M[1]) - 1)


def shares(workers, beam):
    """Share of the light that meets the wall, by offset, of all sub-rays: (offsets, pulses)."""
    firings = lab.level_pulses(np.repeat(OFFSETS_M, PULSES))
    hits = scene(workers).cast(firings, np.array([0.04]), 100.0, beam)
    assert (hits.count == hits.count[0]).all()
    assert np.isfinite(hits.range_m).all()
    behind = hits.range_m > (PLATE_M + WALL_M) / 2
    return behind.reshape(len(OFFSETS_M), PULSES, -1).mean(2)


def test_sub_rays_see_through_the_hole_what_the_profile_says(workers):
    """The share of energy on the wall equals the integral over the hole, across the blurred edge, within
    error."""
    seen = shares(workers, lab.beam("fixed", rays=64))
    assert 0.2 < expected().max() < 0.22
    error = seen.std(1) / np.sqrt(PULSES) + 1e-4
    assert (np.abs(seen.mean(1) - expected()) < 4 * error).all()


def test_the_error_of_angle_is_drawn_from_the_same_profile(workers):
    """With one disturbed ray per pulse, the share of pulses that see the wall is binomial with that
    probability."""
    seen, p = shares(workers, lab.beam("angle")).mean(1), expected()
    assert (np.abs(seen - p) < 4 * np.sqrt(p * (1 - p) / PULSES) + 1e-3).all()


@pytest.mark.parametrize("model", ["fixed", "angle"])
def test_without_spot_and_divergence_the_hole_is_sharp(workers, model):
    """A beam without width sees the wall exactly where its middle passes the hole."""
    seen = shares(workers, lab.beam(model, rays=8, spot_mm=(0.0, 0.0), divergence_mrad=(0.0, 0.0)))
    inside = np.abs(OFFSETS_M) < HALF_M
    assert (seen[inside] == 1).all()
    assert (seen[np.abs(OFFSETS_M) > HALF_M] == 0).all()


def test_an_adaptive_beam_sees_the_hole_too(workers):
    """Sub-rays of an adaptive beam see the wall only where its profile passes the hole, all in all as
    often as they should."""
    firings = lab.level_pulses(np.repeat([*OFFSETS_M, 0.2], PULSES))
    hits = scene(workers).cast(firings, np.array([0.04]), 100.0, lab.beam("adaptive", rays=8))
    assert (hits.count == 8).all()
    behind = (hits.range_m > (PLATE_M + WALL_M) / 2).reshape(len(OFFSETS_M) + 1, PULSES, 8).mean(2)
    assert behind[:-1].mean() == pytest.approx(expected().mean(), rel=0.1)
    assert (np.abs(behind.mean(1)[:-1] - expected()) < 0.08).all()  # eight points have gaps
    assert (behind[-1] == 0).all()
