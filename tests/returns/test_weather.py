"""Fog and rain."""

import numpy as np
import pytest
from returns.kit import detector, firings, pulses, table

from vlp16emu.returns.detect import detect
from vlp16emu.returns.weather import fog_extinction_per_m, rain_extinction_per_m
from vlp16emu.types import NO_SURFACE

K = 2000


def through(range_m, **weather):
    """Returns of a wall of 50 % in some weather, or of nothing."""
    hits = pulses(K, [range_m], [NO_SURFACE if np.isinf(range_m) else 0])
    return detect(firings(K), hits, table(0.5), detector(**weather), truth=True)


def test_extinction_of_fog_and_rain():
    """Thick fog is grey and follows Koschmieder, haze takes less at 903 nm than in visible light, and 10
    mm/h of rain some 5 dB per km."""
    assert fog_extinction_per_m(100) == pytest.approx(3.912 / 100)
    assert fog_extinction_per_m(10_000) == pytest.approx(3.912e-4 * (903 / 550) ** -1.3)
    visibilities = np.geomspace(10, 1e5, 200)
    assert (np.diff([fog_extinction_per_m(v) for v in visibilities]) < 0).all()
    assert rain_extinction_per_m(10.0) * 1000 * 10 / np.log(10) == pytest.approx(5.03, abs=0.01)
    assert rain_extinction_per_m(0.0) == 0


def test_what_comes_through_is_dimmed_on_both_ways():
    """The reflectivity of a wall behind haze is that of a clear day times the transmission there and back."""
    extinction_per_m = fog_extinction_per_m(1000.0)
    out = through(60.0, visibility_m=1000.0)
    wall = (out.distance_m[..., 1] == 60) & (out.reflectivity[..., 1] > 0)
    assert wall.mean() > 0.95
    assert (out.reflectivity[..., 1][wall] == np.rint(50 * np.exp(-2 * extinction_per_m * 60))).all()


def test_fog_echoes_follow_the_lidar_equation():
    """With nothing behind, echoes are as many, and as far, as an integral over their law says."""
    visibility_m = 50.0
    a = fog_extinction_per_m(visibility_m)
    sigma_m = 0.299792458 / 2 * 6.0 / 2.3548200450309493
    wall = np.pi * a / 18.2 * np.sqrt(2 * np.pi) * sigma_m
    r = np.linspace(0.5, 100, 200_001)
    density = a * np.exp(-a * r) * np.exp(-(0.1 / 40**2) * r**2 * np.exp(2 * a * r) / wall)
    out = through(np.inf, visibility_m=visibility_m)
    hit = out.distance_m[..., 0] > 0
    share = np.trapezoid(density, r)
    assert hit.mean() == pytest.approx(share, abs=4 * np.sqrt(share * (1 - share) / hit.size))
    mean_m = np.trapezoid(density * r, r) / share
    assert out.distance_m[..., 0][hit].mean() == pytest.approx(mean_m, rel=0.03)
    assert (out.surface[..., 0] == NO_SURFACE).all()


def test_no_fog_shines_through_a_wall():
    """No echo of the air is farther than what stands in its way, and rain gives less clutter than fog."""
    fog, rain = through(3.0, visibility_m=40.0), through(20.0, rain_mm_h=20.0)
    assert fog.distance_m.max() <= 3.001
    assert (fog.surface[..., 1][fog.distance_m[..., 1] == 3] == 0).all()
    near = (rain.distance_m[..., 1] > 0) & (rain.distance_m[..., 0] < 19)
    assert 0 < near.mean() < 0.02
