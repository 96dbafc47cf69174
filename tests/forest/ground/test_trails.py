"""Trails and their ruts."""

import math

import numpy as np
import pytest
from pydantic import ValidationError

from vlp16emu.forest.ground.settings import Terrain
from vlp16emu.forest.ground.terrain import TerrainHeights, Trails
from vlp16emu.forest.ground.triangles import ground_triangles
from vlp16emu.forest.purpose import Growth
from vlp16emu.random import philox4x32

SPACING_M, TOWARDS_DEG = 25.0, 30.0
ALONG = np.array([math.cos(math.radians(TOWARDS_DEG)), math.sin(math.radians(TOWARDS_DEG))])
LEFT = np.array([-ALONG[1], ALONG[0]])


def flat_with_trails(*, seed=3):
    """Flat ground with nothing but ruts."""
    section = Terrain(hill_rms_m=0.0, rough_rms_m=0.0, trail_spacing_m=SPACING_M, trail_towards_deg=TOWARDS_DEG)
    return TerrainHeights(section, seed=seed)


def words_of(trail, kind=0, seed=3):
    return [int(w) for w in philox4x32(trail % 2**32, 0, kind, Growth.RUT, seed, 0)]


def test_a_rut_is_what_its_random_numbers_say():
    """The kernel agrees to 1e-12 with the ruts of trails over 120 m, each worked out in plain Python."""
    x, y = np.random.default_rng(7).uniform(-60, 60, (2, 4000))
    along, across = np.array([ALONG, LEFT]) @ np.array([x, y])
    twin, first = np.zeros(4000), words_of(0, 1)[0] / 2**32 * SPACING_M
    for trail in range(-5, 5):
        words = words_of(trail)
        track, width = 1.8 + 0.4 * words[0] / 2**32, 0.5 + 0.2 * words[1] / 2**32
        for side, bits in ((1, words[2]), (-1, words[3])):
            phases = (bits >> 16) / 2**16, bits % 2**16 / 2**16
            waves = [np.cos(2 * math.pi * (along / m + p)) for m, p in zip((7, 19), phases, strict=True)]
            depth = 0.125 + 0.15 * sum(waves) / 4
            u = (across - first - trail * SPACING_M - side * track / 2) / (0.75 * width)
            twin -= depth * np.where(abs(u) < 1, (1 - u**2) ** 2 * (1 - 2.25 * u**2), 0.0)
    assert flat_with_trails().height_m(x, y) == pytest.approx(twin, abs=1e-12)
    assert np.count_nonzero(twin) > 200


def test_triangles_follow_ruts_to_millimetres():
    """On trails one place in a thousand is off the ground by 5 mm and none by 7."""
    terrain = flat_with_trails()
    points_m, faces = ground_triangles((0.0, 0.0), 40.0, terrain.height_m)
    share = np.random.default_rng(1).dirichlet([1.0, 1.0, 1.0], (len(faces), 20))
    places = np.einsum("fkc,fcd->fkd", share, points_m[faces]).reshape(-1, 3)
    places = places[~terrain.trails.are_free(places[:, :2])]
    off_m = np.abs(places[:, 2] - terrain.height_m(places[:, 0].copy(), places[:, 1].copy()))
    assert np.quantile(off_m, 0.999) < 0.005
    assert off_m.max() < 0.007


def test_the_ground_is_free_but_for_a_strip_along_each_trail():
    """Of scattered points the share off trails is 1 - 4 m / 25 m, and no rut reaches where trees may stand."""
    xy_m = np.random.default_rng(2).uniform(-500, 500, (40_000, 2))
    terrain = flat_with_trails()
    free = terrain.trails.are_free(xy_m)
    assert terrain.trails.free_share == pytest.approx(1 - 4 / 25)
    assert free.mean() == pytest.approx(terrain.trails.free_share, abs=0.006)
    assert np.abs(terrain.height_m(xy_m[free, 0].copy(), xy_m[free, 1].copy())).max() == 0


def test_without_trails_the_ground_is_as_it_was():
    """By default no ground is taken by trails, and heights are the same numbers whatever the direction says."""
    x, y = np.random.default_rng(4).uniform(-100, 100, (2, 500))
    plain, turned = (TerrainHeights(Terrain(trail_towards_deg=a), seed=3) for a in (0.0, 77.0))
    assert np.array_equal(plain.height_m(x, y), turned.height_m(x, y))
    assert Trails(Terrain(), seed=3).free_share == 1
    assert Trails(Terrain(), seed=3).are_free(np.column_stack([x, y])).all()


def test_trails_that_would_overlap_are_refused():
    """A spacing between 0 and 10 m is an error of its key."""
    with pytest.raises(ValidationError, match="0 for none, or 10 or more") as caught:
        Terrain(trail_spacing_m=4.0)
    assert [error["loc"] for error in caught.value.errors()] == [("trail_spacing_m",)]
