"""Ground with relief, and trails of machines on it."""

import math

import numpy as np
import pytest
from pydantic import ValidationError

from vlp16emu.errors import GeometryError
from vlp16emu.forest.ground.terrain import TerrainHeights, Trails
from vlp16emu.forest.purpose import Growth
from vlp16emu.forest.settings import Terrain
from vlp16emu.random import philox4x32


def drawn(*counter_and_key):
    """The random words for a counter and a key."""
    return [int(word) for word in philox4x32(*map(np.uint32, counter_and_key))]


def flat_but(*, seed=3, **changes):
    return TerrainHeights(Terrain(**{"hill_rms_m": 0.0, "rough_rms_m": 0.0, **changes}), seed=seed)


@pytest.mark.parametrize("band", ["hill_rms_m", "rough_rms_m"])
def test_relief_has_the_rms_that_was_set(band):
    """Over a wide area the height of one band has mean zero and the set standard deviation; that of
    another seed has no part in it."""
    x, y = np.random.default_rng(1).uniform(-1e5, 1e5, (2, 100_000))
    height, other = (flat_but(seed=seed, **{band: 0.4}).height_m(x, y) for seed in (3, 4))
    assert abs(np.corrcoef(height, other)[0, 1]) < 0.02
    assert abs(height.mean()) < 0.012
    assert height.std() == pytest.approx(0.4, rel=0.02)


@pytest.mark.parametrize(
    ("band", "shortest_m", "longest_m"), [("hill_rms_m", 30, 300), ("rough_rms_m", 1, 12)]
)
def test_relief_keeps_to_its_wavelengths(band, shortest_m, longest_m):
    """The rms gradient equals that of a spectrum falling with the third power between the band's limits."""
    x, y = np.random.default_rng(2).uniform(-1e5, 1e5, (2, 50_000))
    terrain, step = flat_but(**{band: 0.5}), shortest_m / 1000
    gradient = (terrain.height_m(x + step, y) - terrain.height_m(x - step, y)) / (2 * step)
    # Variance per log wavelength ~ wavelength, gradient variance (2 pi / wavelength)^2 / 2 of it in one axis.
    expected = math.pi / math.sqrt(2 * shortest_m * longest_m)
    assert gradient.std() == pytest.approx(expected, rel=0.15)


def test_a_mound_is_what_its_random_numbers_say():
    """The kernel agrees to 1e-12 with the sum of all mounds of a square of 40 m, each worked out in plain
    Python."""
    mounds = []
    for ix in range(-11, 11):
        for iy in range(-11, 11):
            words = drawn(ix % 2**32, iy % 2**32, 0, Growth.MOUND, 3, 0)
            if words[0] / 2**32 < 600 * 4 / 10_000:
                radius = (1 + (words[3] >> 16) / 2**16) / 2
                height = (2 * (words[3] % 2**16) / 2**16 - 1) * 0.15
                mounds.append((2 * (ix + words[1] / 2**32), 2 * (iy + words[2] / 2**32), radius, height))
    x, y = np.random.default_rng(7).uniform(-20, 20, (2, 400))
    twin = np.zeros(400)
    for mound_x, mound_y, radius, height in mounds:
        twin += height * np.maximum(1 - ((x - mound_x) ** 2 + (y - mound_y) ** 2) / radius**2, 0) ** 3
    assert flat_but(mounds_per_ha=600.0).height_m(x, y) == pytest.approx(twin, abs=1e-12)
    assert np.count_nonzero(twin) > 40


def test_a_pit_is_what_its_random_numbers_say():
    """The kernel agrees to 1e-12 with the sum of all pits and mounds of a square of 40 m, each worked out
    in plain Python."""
    x, y = np.random.default_rng(7).uniform(-20, 20, (2, 400))
    twin = np.zeros(400)
    for ix in range(-7, 7):
        for iy in range(-7, 7):
            words = drawn(ix % 2**32, iy % 2**32, 0, Growth.PIT, 3, 0)
            if words[0] / 2**32 < 400 * 16 / 10_000:
                size, turn = (words[3] >> 16) / 2**16, 2 * math.pi * (words[3] % 2**16) / 2**16
                middle = 4 * (ix + words[1] / 2**32), 4 * (iy + words[2] / 2**32)
                for side in (1, -1):
                    aside = side * 0.8 * (1 + size / 2)
                    px, py = middle[0] + aside * math.cos(turn), middle[1] + aside * math.sin(turn)
                    inside = np.maximum(1 - ((x - px) ** 2 + (y - py) ** 2) / (1 + size / 2) ** 2, 0)
                    twin += side * (0.2 + 0.2 * size) * inside**2
    assert flat_but(pits_per_ha=400.0).height_m(x, y) == pytest.approx(twin, abs=1e-12)
    assert np.count_nonzero(twin) > 100


def test_far_from_the_origin_heights_are_still_exact():
    """At 1e6 m the kernel agrees with a sum in extended precision to a nanometre."""
    terrain = flat_but(hill_rms_m=1.0, rough_rms_m=0.1)
    x, y = 1e6 + np.random.default_rng(4).uniform(0, 50, (2, 40))
    wide = np.longdouble
    waves = terrain._waves.astype(wide)
    phase = np.outer(x.astype(wide), waves[:, 0]) + np.outer(y.astype(wide), waves[:, 1]) + waves[:, 3]
    twin = (waves[:, 2] * np.cos(phase)).sum(axis=1)
    assert np.abs(terrain.height_m(x, y) - twin).max() < 1e-9


def test_slope_rises_towards_its_direction():
    """A plane of 10 degrees towards north-west gains tan(10) per metre that way and nothing across."""
    terrain = flat_but(slope_deg=10.0, slope_towards_deg=135.0)
    x, y = 100 * math.sqrt(0.5) * np.array([[-1.0, 1.0], [1.0, 1.0]])
    along, across = terrain.height_m(x, y)
    assert along == pytest.approx(100 * math.tan(math.radians(10)))
    assert across == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(
    ("band", "rms_m", "steep_deg"), [("rough_rms_m", 100.0, 89.7), ("hill_rms_m", 20.0, 53.0)]
)
def test_ground_steeper_than_soil_is_refused(band, rms_m, steep_deg):
    """Loose soil slides from 30 to 45 degrees on; the rms slope of a band is that of its spectrum (the
    gradient above, along both axes)."""
    with pytest.raises(
        GeometryError, match=rf"{band} = {rms_m:g}.* slope by (\d+\.\d) degrees rms; expected at most 45"
    ) as caught:
        flat_but(**{band: rms_m})
    found_deg = float(str(caught.value).split(" slope by ")[1].split()[0])
    assert found_deg == pytest.approx(steep_deg, abs=4.0)


SPACING_M, TOWARDS_DEG = 25.0, 30.0
ALONG = np.array([math.cos(math.radians(TOWARDS_DEG)), math.sin(math.radians(TOWARDS_DEG))])
LEFT = np.array([-ALONG[1], ALONG[0]])
TRAILS = {"trail_spacing_m": SPACING_M, "trail_towards_deg": TOWARDS_DEG}


def words_of(trail, kind=0, seed=3):
    return drawn(trail % 2**32, 0, kind, Growth.RUT, seed, 0)


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
    assert flat_but(**TRAILS).height_m(x, y) == pytest.approx(twin, abs=1e-12)
    assert np.count_nonzero(twin) > 200


def test_the_ground_is_free_but_for_a_strip_along_each_trail():
    """The share of scattered points off trails is 1 - 4 m / 25 m, and no rut reaches where trees may
    stand; without trails all are free."""
    xy_m = np.random.default_rng(2).uniform(-500, 500, (40_000, 2))
    terrain = flat_but(**TRAILS)
    free = terrain.trails.are_free(xy_m)
    assert Trails(Terrain(), seed=3).free_share == 1
    assert Trails(Terrain(), seed=3).are_free(xy_m).all()
    assert terrain.trails.free_share == pytest.approx(1 - 4 / 25)
    assert free.mean() == pytest.approx(terrain.trails.free_share, abs=0.006)
    assert np.abs(terrain.height_m(xy_m[free, 0].copy(), xy_m[free, 1].copy())).max() == 0


def test_trails_that_would_overlap_are_refused():
    """A spacing between 0 and 10 m is an error of its key."""
    with pytest.raises(ValidationError, match="0 for none, or 10 or more") as caught:
        Terrain(trail_spacing_m=4.0)
    assert [error["loc"] for error in caught.value.errors()] == [("trail_spacing_m",)]
