"""One hit per pulse becomes its return."""

import numpy as np
import pytest

from vlp16emu.returns import detect
from vlp16emu.types import NO_SURFACE, SURFACE, Firings, Hits

K, L = 8, 16


def firings():
    zeros = np.zeros((K, L, 3))
    return Firings(
        0,
        np.zeros((K, L), np.int64),
        np.zeros(K, np.int64),
        np.zeros((K, L)),
        np.zeros(K),
        zeros,
        zeros,
        None,
    )


def hits(range_m, surface=0, cosine=1.0):
    shape = (K, L)
    return Hits.one_ray_each(
        np.full(shape, range_m, np.float32),
        np.full(shape, surface, np.uint32),
        np.full(shape, cosine, np.float32),
    )


def table(reflectance):
    surfaces = np.zeros(1, SURFACE)
    surfaces["reflectance"] = reflectance
    return surfaces


@pytest.mark.parametrize(
    ("range_m", "distance_m"),
    [(0.49, 0), (0.5, 0.5), (20, 20), (100, 100), (100.01, 0), (np.inf, 0)],
)
def test_range_limits(range_m, distance_m):
    """What is nearer than the least range, farther than the greatest, or nowhere gives no return."""
    surface = NO_SURFACE if np.isinf(range_m) else 0
    out = detect(firings(), hits(range_m, surface), table(0.5), 0.5, 100.0, truth=False)
    assert (out.distance_m[..., :2] == np.float32(distance_m)).all()
    assert ((out.reflectivity[..., 0] > 0) == (distance_m > 0)).all()


def test_lone_echo_is_strongest_and_last():
    """One echo stands as strongest and as last, and there is no second strongest."""
    out = detect(firings(), hits(7.0), table(0.5), 0.5, 100.0, truth=False)
    assert (out.distance_m[..., 0] == out.distance_m[..., 1]).all()
    assert (out.distance_m[..., 2] == 0).all()


@pytest.mark.parametrize(
    ("reflectance", "cosine", "byte"), [(0.5, 1.0, 50), (0.5, 0.5, 25), (1.0, 1.0, 100), (0, 1, 0)]
)
def test_reflectivity_is_lambertian(reflectance, cosine, byte):
    """The byte is reflectance times the cosine of incidence, in percent."""
    out = detect(firings(), hits(7.0, cosine=cosine), table(reflectance), 0.5, 100.0, truth=False)
    assert (out.reflectivity[..., 0] == byte).all()


def test_truth_is_kept_only_on_request():
    """Surfaces travel along only when asked for, and are `NO_SURFACE` where there is no return."""
    assert detect(firings(), hits(7.0), table(0.5), 0.5, 100.0, truth=False).surface is None
    kept = detect(firings(), hits(7.0), table(0.5), 0.5, 100.0, truth=True)
    assert (kept.surface[..., :2] == 0).all()
    assert (kept.surface[..., 2] == NO_SURFACE).all()
