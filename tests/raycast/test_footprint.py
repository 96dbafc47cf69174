"""Where sub-rays go."""

import numpy as np
import pytest
from scipy.stats import kstest, norm, spearmanr

from vlp16emu.raycast.footprint import displace, sub_rays


def unit_points(lab, pulses, rays, first=0, seed=7, model="fixed"):
    """Standard normal coordinates (pulses, rays, 2) of sub-rays: the spot of a beam 4 m wide at the lens."""
    beam = lab.beam(model, spot_m=(4.0, 4.0), divergence_rad=(0.0, 0.0), seed=seed)
    firings = lab.level_pulses(np.zeros(pulses))
    begin = np.full((pulses, 1), first)
    origin_m, _ = sub_rays(firings, beam, begin, begin + rays)
    return origin_m[:, 1:].reshape(pulses, rays, 2) * [-1, 1]


def times_better_on_an_edge(points):
    """RMS error of the share beyond a straight edge by random points, over that by points (pulses, rays, 2)."""
    pulses, rays, _ = points.shape
    rng = np.random.default_rng(1)
    tilt, edge = rng.uniform(0, 2 * np.pi, (pulses, 1)), rng.uniform(-1.5, 1.5, (pulses, 1))
    beyond = points[..., 0] * np.cos(tilt) + points[..., 1] * np.sin(tilt) > edge
    share = norm.sf(edge)
    error = np.sqrt(((beyond.mean(1, keepdims=True) - share) ** 2).mean())
    return np.sqrt((share * (1 - share) / rays).mean()) / error


@pytest.mark.parametrize("i", [0, 1, 31])
def test_each_sub_ray_alone_is_a_fair_draw_from_the_profile(lab, i):
    """Over pulses, sub-ray i has two independent standard normal coordinates."""
    x, y = unit_points(lab, 20_000, 1, first=i)[:, 0].T
    assert kstest(x, "norm").pvalue > 0.001
    assert kstest(y, "norm").pvalue > 0.001
    assert kstest(np.hypot(x, y), "chi", args=(2,)).pvalue > 0.001
    assert spearmanr(np.abs(x), y).pvalue > 0.001


@pytest.mark.parametrize(("rays", "times"), [(8, 1.5), (16, 1.8), (32, 2.2), (33, 2.2), (64, 2.6)])
def test_means_over_any_first_sub_rays_are_nearer_than_random_ones(lab, rays, times):
    """The RMS error of the share beyond a straight edge is below that of random points by a factor that grows."""
    assert times_better_on_an_edge(unit_points(lab, 3000, rays)) > times


def test_rounds_of_an_adaptive_beam_lie_by_eighths(lab):
    """The first ray is the middle; later rounds begin with one of the innermost eighth, the others are fair draws outside it."""
    points = unit_points(lab, 20_000, 24, model="adaptive")
    inside = 1 - np.exp(-(points**2).sum(-1) / 2)  # share of the light nearer to the middle
    first = np.arange(24) % 8 == 0
    assert (points[:, 0] == 0).all()
    for i in range(1, 24):
        share = inside[:, i] * 8 if first[i] else (inside[:, i] * 8 - 1) / 7
        assert kstest(share, "uniform").pvalue > 0.001
    angle = np.arctan2(points[:, 8, 1], points[:, 8, 0])
    assert kstest(angle / (2 * np.pi) + 0.5, "uniform").pvalue > 0.001
    assert (inside[:, first] <= 1 / 8).all()
    assert (inside[:, ~first] >= 1 / 8).all()


@pytest.mark.parametrize(("rays", "times"), [(8, 1.7), (16, 1.7), (32, 1.9), (64, 2.2)])
def test_rounds_with_the_middle_are_as_good(lab, rays, times):
    """Whole rounds that begin with the middle of the light tell the share beyond an edge as well as other points."""
    points = unit_points(lab, 3000, rays, model="adaptive")
    assert times_better_on_an_edge(points) > times


def test_pulses_are_turned_differently(lab):
    """No two pulses, lasers or seeds share a pattern; the same pulse always has the same."""
    points = unit_points(lab, 500, 1)[:, 0]
    assert len(np.unique(points.round(6), axis=0)) > 490
    assert (points == unit_points(lab, 500, 1)[:, 0]).all()
    assert (points != unit_points(lab, 500, 1, seed=8)[:, 0]).any(axis=1).mean() > 0.99


@pytest.mark.parametrize("distance_m", [0.0, 10.0, 50.0])
def test_the_beam_is_as_wide_as_said(lab, distance_m):
    """Four standard deviations are spot + divergence * distance, across and up, and directions have unit length."""
    firings, none = lab.pulses(64), np.zeros((64, 16), np.int64)
    origin_m, direction = (
        r.reshape(64, 16, 64, 3) for r in sub_rays(firings, lab.beam("fixed"), none, none + 64)
    )
    assert np.abs(np.linalg.norm(direction, axis=-1) - 1).max() < 1e-12
    # Where sub-rays pierce the plane square to the beam at that distance.
    along = np.einsum("klsa,kla->kls", direction, firings.direction)
    offset_m = origin_m - firings.origin_m[:, :, None] + direction * (distance_m / along)[..., None]
    up = np.cross(firings.direction, firings.across)
    for axis, width_m in (
        (firings.across, 0.0127 + 0.003 * distance_m),
        (up, 0.0095 + 0.0015 * distance_m),
    ):
        assert 4 * np.einsum("klsa,kla->kls", offset_m, axis).std() == pytest.approx(width_m, rel=0.01)


def test_firings_without_a_width_are_refused(lab):
    """Sub-rays of firings that were aimed as lines are a programming error and named."""
    from dataclasses import replace

    none = np.zeros((8, 16), np.int64)
    with pytest.raises(ValueError, match="found firings without `across`, expected them for a beam of fixed"):
        sub_rays(replace(lab.pulses(8), across=None), lab.beam("fixed"), none, none + 1)


def test_offset_displaces_evenly_inside_the_beam(lab):
    """Along the beam a point even in a ball has the distribution function (2 + 3z - z^3) / 4; misses stay misses."""
    range_m = np.full((20_000, 2), 20.0, np.float32)
    range_m[:, 1] = np.inf
    displace(range_m, lab.beam("offset"), 0)
    assert np.isinf(range_m[:, 1]).all()
    half_m = np.sqrt((0.0127 + 0.06) * (0.0095 + 0.03)) / 2
    z = (range_m[:, 0].astype(float) - 20.0) / half_m
    assert np.abs(z).max() <= 1.01
    assert kstest(z, lambda z: (2 + 3 * z - z**3).clip(0, 4) / 4).pvalue > 0.001
