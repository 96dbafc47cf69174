"""Where sub-rays go."""

import numpy as np
import pytest
from raycast import lab
from raycast.reference import sub_rays
from scipy.stats import kstest, norm, spearmanr

from vlp16emu.extras.displace import displace, offset_tangents


def unit_points(pulses, rays, first=0, seed=7, model="fixed"):
    """Standard normal coordinates (pulses, rays, 2) of sub-rays: the spot of a beam 4 m wide at the lens."""
    beam = lab.beam(model, spot_mm=(4000.0, 4000.0), divergence_mrad=(0.0, 0.0), seed=seed)
    firings = lab.level_pulses(np.zeros(pulses))
    before = first % 8  # rounds begin at multiples of eight
    origin_m, _ = sub_rays(firings, beam, np.zeros(3), first - before, before + rays)
    return origin_m[:, 0, before:, 1:].astype(float) * [-1, 1]


def times_better_on_an_edge(points):
    """RMS error of the share beyond a straight edge by random points, over that by points (pulses, rays,
    2)."""
    pulses, rays, _ = points.shape
    rng = np.random.default_rng(1)
    tilt, edge = rng.uniform(0, 2 * np.pi, (pulses, 1)), rng.uniform(-1.5, 1.5, (pulses, 1))
    beyond = points[..., 0] * np.cos(tilt) + points[..., 1] * np.sin(tilt) > edge
    share = norm.sf(edge)
    error = np.sqrt(((beyond.mean(1, keepdims=True) - share) ** 2).mean())
    return np.sqrt((share * (1 - share) / rays).mean()) / error


@pytest.mark.parametrize("i", [0, 1, 31])
def test_each_sub_ray_alone_is_a_fair_draw_from_the_profile(i):
    """Over pulses, sub-ray i has two independent standard normal coordinates."""
    x, y = unit_points(20_000, 1, first=i)[:, 0].T
    assert kstest(x, "norm").pvalue > 0.001
    assert kstest(y, "norm").pvalue > 0.001
    assert kstest(np.hypot(x, y), "chi", args=(2,)).pvalue > 0.001
    assert spearmanr(np.abs(x), y).pvalue > 0.001


@pytest.mark.parametrize(
    ("model", "rays", "times"),
    [
        *(("fixed", *pair) for pair in ((8, 1.5), (16, 1.8), (32, 2.2), (33, 2.2), (64, 2.6))),
        *(("adaptive", *pair) for pair in ((8, 2.2), (16, 2.4), (32, 2.8), (64, 3.3))),
    ],
)
def test_means_over_any_first_sub_rays_are_nearer_than_random_ones(model, rays, times):
    """The RMS error of the share beyond a straight edge is below that of random points by a factor that
    grows."""
    assert times_better_on_an_edge(unit_points(3000, rays, model=model)) > times


def test_support_points_are_turned_and_mirrored():
    """Pulses have one pattern at angles that are evenly spread, and each of its mirror images half of the
    time."""
    points = unit_points(4000, 8, model="adaptive")
    assert np.ptp(np.linalg.norm(points, axis=-1), axis=0).max() < 1e-5
    angle = np.arctan2(points[..., 1], points[..., 0])
    assert kstest(angle[:, 0] / (2 * np.pi) + 0.5, "uniform").pvalue > 0.001
    # From the first sub-ray to the third it turns one way or the other.
    turn = np.sin(angle[:, 2] - angle[:, 0])
    assert np.ptp(np.abs(turn)) < 0.01
    assert 0.46 < (turn > 0).mean() < 0.54


@pytest.mark.parametrize("distance_m", [0.0, 10.0, 50.0])
def test_the_beam_is_as_wide_as_said(distance_m):
    """Four standard deviations are spot + divergence * distance, across and up, and directions have unit
    length."""
    firings = lab.pulses(64)
    laid = sub_rays(firings, lab.beam("fixed"), lab.UTM_M, 0, 64)
    origin_m, direction = (array.astype(float) for array in laid)
    assert np.abs(np.linalg.norm(direction, axis=-1) - 1).max() < 3e-7
    # Where sub-rays pierce the plane square to the beam at that distance.
    along = np.einsum("klsa,kla->kls", direction, firings.direction)
    offset_m = (
        origin_m + lab.UTM_M - firings.origin_m[:, :, None] + direction * (distance_m / along)[..., None]
    )
    up = np.cross(firings.direction, firings.beam_axis)
    for axis, width_m in (
        (firings.beam_axis, 0.0127 + 0.003 * distance_m),
        (up, 0.0095 + 0.0015 * distance_m),
    ):
        assert 4 * np.einsum("klsa,kla->kls", offset_m, axis).std() == pytest.approx(width_m, rel=0.01)


def test_offset_displaces_evenly_inside_the_beam():
    """Along the beam and to both sides a point even in an ellipsoid has the distribution (2 + 3z - z^3) /
    4; misses stay misses."""
    range_m = np.full((20_000, 2), 20.0, np.float32)
    range_m[:, 1] = np.inf
    displace(range_m, lab.beam("offset"), 5)
    assert np.isinf(range_m[:, 1]).all()
    sequence, laser = 5 + np.arange(20_000), np.zeros(20_000, np.int64)
    sideways_m = 20.0 * offset_tangents(
        np.full(20_000, 20.0, np.float32), lab.beam("offset"), sequence, laser, 2
    )
    half_m = np.array([0.0127 + 0.06, 0.0095 + 0.03]) / 2
    along_m = np.sqrt(range_m[:, 0].astype(float) ** 2 - (sideways_m**2).sum(axis=1)) - 20.0
    parts = np.column_stack([sideways_m / half_m, along_m / np.sqrt(half_m.prod())])
    assert (parts**2).sum(axis=1).max() <= 1.001
    for part in parts.T:
        assert kstest(part, lambda z: (2 + 3 * z - z**3).clip(0, 4) / 4).pvalue > 0.001
