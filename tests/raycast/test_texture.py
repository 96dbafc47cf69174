"""Patches of brighter and darker surface, and relief."""

from copy import deepcopy

import numpy as np
import pytest

from vlp16emu.raycast.texture import _STRENGTH, add_texture
from vlp16emu.types import SURFACE, Firings, Hits, PlantPart

FAR_M = 30.0


def pulses(at_m, origin_m=(0.0, 0.0, 0.0)):
    """One sub-ray each (k, 1) from a place to points (k, 3), all on surface 0."""
    away = at_m - np.array(origin_m)
    range_m = np.linalg.norm(away, axis=1)
    firings = Firings.rays(0, np.array(origin_m), (away / range_m[:, None])[:, None])
    met = np.zeros((len(at_m), 1), np.uint32), np.full((len(at_m), 1), 0.5, np.float32)
    return firings, Hits.one_ray_each(range_m.astype(np.float32)[:, None], *met)


def textured(firings, hits, surfaces, seed):
    varied = deepcopy(hits)
    add_texture(firings, varied, surfaces, seed)
    return varied


def factors(at_m, texture=0.1, *, reflectance=0.4, seed=3, part=PlantPart.NONE, **more):
    surfaces = np.zeros(1, SURFACE)
    surfaces["part"] = part
    surfaces["texture"], surfaces["reflectance"] = texture, reflectance
    firings, hits = pulses(at_m, **more)
    return textured(firings, hits, surfaces, seed).cos_incidence / hits.cos_incidence


@pytest.fixture(scope="module")
def places_m():
    return np.random.default_rng(1).uniform(-FAR_M, FAR_M, (200_000, 3))


def test_brightness_varies_by_the_texture(places_m):
    """At 60 degrees of incidence patches deviate 1.5 times as much as asked for, brighter ones by a factor
    and darker ones by its inverse."""
    factor = factors(places_m, 0.03)
    assert factor.mean() == pytest.approx(1.0, abs=0.003)
    even = np.sqrt(3.0) * np.linspace(-1.0, 1.0, 2001)
    more = 0.045 * _STRENGTH[:, None] * even
    assert factor.std() == pytest.approx(np.where(more > 0, 1 + more, 1 / (1 + np.abs(more))).std(), rel=0.04)


def test_pieces_of_a_surface_differ_in_their_contrast():
    """Over pieces of 1.6 m the logarithm of the deviation of the patches has a spread near one, as over
    the surfaces of real rooms."""
    rng = np.random.default_rng(4)
    middles_m = rng.uniform(-FAR_M, FAR_M, (300, 1, 3))
    factor = factors((middles_m + rng.uniform(-0.4, 0.4, (300, 200, 3))).reshape(-1, 3), 0.03).reshape(
        300, 200
    )
    assert 0.6 < np.log(factor.std(axis=1)).std() < 1.1


@pytest.mark.parametrize("away_m", [0.0, 1e7])
@pytest.mark.parametrize(("part", "size_m"), [(PlantPart.NONE, 0.1), (PlantPart.STEM, 0.05)])
def test_patches_have_the_size_of_what_they_are_on(places_m, away_m, part, size_m):
    """Places a twentieth of 0.1 m, on bark of 0.05 m, apart are mostly of one patch, places that far apart
    mostly not, places five times that apart have nothing to do with each other; far from the world's
    origin too."""
    origin_m = np.full(3, away_m)
    step = np.random.default_rng(2).normal(size=places_m.shape)
    step *= size_m / np.linalg.norm(step, axis=1, keepdims=True)

    def at(steps):
        return factors(places_m + origin_m + steps * step, origin_m=origin_m, part=part)

    one = at(0.0)
    same = {steps: np.isclose(at(steps), one, atol=1e-4).mean() for steps in (0.05, 1.0)}
    assert same[0.05] > 0.9
    assert 0.2 < same[1.0] < 0.5
    assert abs(np.corrcoef(one, at(5.0))[0, 1]) < 0.03


def test_a_patch_looks_the_same_from_everywhere(places_m):
    """From two places 50 m apart the same points are as bright, but for those at a border; another seed
    gives other patches."""
    here, there = (factors(places_m, origin_m=at_m) for at_m in ((0.0, 0.0, 0.0), (40.0, -30.0, 2.0)))
    assert np.isclose(here, there, atol=1e-4).mean() > 0.9999
    assert abs(np.corrcoef(here, factors(places_m, seed=4))[0, 1]) < 0.03


def test_nothing_is_brighter_than_white(places_m):
    """A reflectance of 0.95 never exceeds 1; of a retroreflector nothing grows; without texture nothing
    changes."""
    assert (0.95 * factors(places_m, 0.3, reflectance=0.95)).max() <= 1 + 1e-6
    assert factors(places_m, 0.3, reflectance=2.0).max() <= 1
    assert (factors(places_m, 0.0) == 1).all()


def test_a_sub_ray_that_meets_nothing_stays_so():
    """Sub-rays without a hit keep no range and a cosine of 0; the others of the pulse are varied, each by
    its own surface."""
    surfaces = np.zeros(2, SURFACE)
    surfaces["texture"], surfaces["relief_m"], surfaces["reflectance"] = (0.1, 0.0), (0.01, 0.0), 0.4
    firings, _ = pulses(np.array([[10.0, 0.0, 0.0]]))
    nothing = np.uint32(0xFFFFFFFF)
    hits = Hits(
        np.array([[3]], np.uint16),
        np.array([11.0, np.inf, 12.0], np.float32),
        np.array([0, nothing, 1], np.uint32),
        np.array([0.5, 0.0, 0.5], np.float32),
    )
    varied = textured(firings, hits, surfaces, 3)
    assert varied.cos_incidence[0] != 0.5
    assert varied.range_m[0] != 11.0
    assert varied.cos_incidence[1:].tolist() == [0.0, 0.5]
    assert varied.range_m[1:].tolist() == [np.inf, 12.0]


def test_texture_alone_is_that_beside_other_looks():
    """Cosines are the same to the last bit whether or not another surface, which nothing meets, has relief
    and is processed with all looks; also where sub-rays of a pulse meet nothing."""
    rng = np.random.default_rng(5)
    firings, _ = pulses(rng.uniform(-FAR_M, FAR_M, (500, 3)))
    count = rng.integers(1, 12, (500, 1)).astype(np.uint16)
    n = int(count.sum())
    range_m = rng.uniform(2.0, 40.0, n).astype(np.float32)
    met = rng.integers(0, 3, n).astype(np.uint32)
    range_m[rng.random(n) < 0.1] = np.inf
    met[np.isinf(range_m)] = 0xFFFFFFFF
    cosine = np.where(np.isinf(range_m), 0.0, rng.uniform(0.0, 1.0, n)).astype(np.float32)
    surfaces = np.zeros(4, SURFACE)
    surfaces["texture"], surfaces["reflectance"] = (0.1, 0.0, 0.3, 0.0), (0.4, 0.2, 0.95, 0.0)
    surfaces["part"] = (PlantPart.NONE, PlantPart.LEAF, PlantPart.STEM, PlantPart.NONE)
    hits = Hits(count, range_m, met, cosine)
    alone = textured(firings, hits, surfaces, 3)
    with_relief = surfaces.copy()
    with_relief["relief_m"][3] = 0.01
    assert (alone.cos_incidence != cosine).any()
    assert alone.cos_incidence.tobytes() == textured(firings, hits, with_relief, 3).cos_incidence.tobytes()
    assert (alone.range_m == range_m).all()


def test_relief_moves_what_is_met(places_m):
    """Ranges on a surface with relief are off by it, one sigma, with mean 0, alike within 1 cm and not at
    0.5 m; brightness stays."""
    surfaces = np.zeros(1, SURFACE)
    surfaces["relief_m"], surfaces["reflectance"] = 0.004, 0.4

    def off_m(at_m):
        firings, hits = pulses(at_m)
        raised = textured(firings, hits, surfaces, 3)
        assert (raised.cos_incidence == hits.cos_incidence).all()
        return raised.range_m.astype(float) - hits.range_m

    one_m = off_m(places_m)
    assert one_m.mean() == pytest.approx(0.0, abs=0.0002)
    assert one_m.std() == pytest.approx(0.004, rel=0.05)
    assert np.corrcoef(one_m, off_m(places_m + [0.01, 0.0, 0.0]))[0, 1] > 0.7
    assert abs(np.corrcoef(one_m, off_m(places_m + [0.5, 0.0, 0.0]))[0, 1]) < 0.03


def shine(cosine, roughness, reflectance=0.3):
    """Return the increase of the cosine of incidence by a coat."""
    surfaces = np.zeros(1, SURFACE)
    surfaces["roughness"], surfaces["reflectance"] = roughness, reflectance
    firings, hits = pulses(np.full((len(cosine), 3), 5.0))
    hits.cos_incidence[:] = cosine
    return textured(firings, hits, surfaces, 3).cos_incidence - hits.cos_incidence


def test_gloss_is_the_light_of_the_facets_that_face_the_sensor():
    """Gloss equals the light of random facets within 1.5 degrees of the pulse, which reflect 4 % of it
    into a cone four times as large."""
    slope, within_rad = (
        np.random.default_rng(5).normal(0.0, 0.2 / np.sqrt(2.0), (2_000_000, 2)),
        np.radians(1.5),
    )
    normal = np.concatenate([-slope, np.ones((len(slope), 1))], axis=1) / np.sqrt(
        1.0 + (slope**2).sum(axis=1, keepdims=True)
    )
    cone_sr = 2.0 * np.pi * (1.0 - np.cos(within_rad))
    angle = np.radians([0.0, 5.0, 10.0, 15.0, 20.0])
    for at, found in zip(angle, 0.3 * shine(np.cos(angle), 0.2), strict=True):
        faces = normal @ [np.sin(at), 0.0, np.cos(at)] > np.cos(within_rad)
        area = (faces / normal[:, 2]).mean() / np.cos(at)
        assert found == pytest.approx(np.pi * 0.04 * area / (4.0 * cone_sr), rel=0.05)


def test_gloss_ends_at_white():
    """A smooth coat makes a surface white where it is seen straight on, and leaves retroreflectors, black
    and slanted surfaces as they are."""
    assert shine(np.array([1.0]), 0.05) == pytest.approx(1.0 / 0.3 - 1.0)
    for reflectance in (0.0, 200.0):
        assert not shine(np.array([1.0]), 0.05, reflectance=reflectance).any()
    assert not shine(np.array([0.01, 0.5]), 0.05).any()


def shaded(at_m, shading, *, reflectance=0.2):
    surfaces = np.zeros(1, SURFACE)
    surfaces["shading"], surfaces["reflectance"] = shading, reflectance
    firings, hits = pulses(at_m)
    return textured(firings, hits, surfaces, 3).cos_incidence / hits.cos_incidence


def test_shading_is_smooth_and_as_wide_as_asked_for(places_m):
    """Brightness deviates by the shading over a room of places, and by less than a fiftieth of it between
    pulses 1 cm apart: it has no edges, at any ring."""
    factor = shaded(places_m, 0.03)
    assert factor.mean() == pytest.approx(1.0, abs=0.002)
    assert factor.std() == pytest.approx(0.03, rel=0.05)
    beside = shaded(places_m + np.array([0.01, 0.0, 0.0]), 0.03)
    assert np.abs(beside - factor).max() < 0.03 / 15
    assert np.abs(beside - factor).mean() < 0.03 / 50


def test_shading_ends_at_white(places_m):
    """Shading makes no surface brighter than white, and leaves a surface without it as it is."""
    assert shaded(places_m, 1.0, reflectance=0.8).max() <= 1.0 / 0.8 + 1e-6
    assert (shaded(places_m, 0.0) == 1.0).all()
