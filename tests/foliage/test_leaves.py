"""Leaves in voxels have one place in space, and let light through as random leaves do."""

import itertools
import math
from functools import cache
from types import MappingProxyType

import numpy as np
import pytest
from raycast import lab

from vlp16emu.foliage import leaves as room
from vlp16emu.foliage.far import FarCaster
from vlp16emu.foliage.lanes import empty_lanes
from vlp16emu.foliage.leaves import weights_of
from vlp16emu.foliage.stems import room_for_stems
from vlp16emu.foliage.voxel import KNOTS, QUANTILES, VOXEL_M
from vlp16emu.forest.plants.species import flora
from vlp16emu.types import NO_SURFACE, PlantPart


def one_voxel(empty, code, cell=(2, 1, 3), corner=(40, -7, 11)):
    """Medium of one brick with foliage in one of its voxels, the same for light of any elevation."""
    bit = 16 * cell[0] + 4 * cell[1] + cell[2]
    return empty._replace(
        corner=corner,
        brick=np.array([[[[1 << bit, 0]]]], "u8"),
        record=np.array([code | code << 7 | code << 14], "u4"),
        first_owner=np.zeros(1, "u4"),
        owner=np.array([255 << 56 | 5], "u8"),
        cosine=np.ones((1, 3, QUANTILES), "f4"),
        seed=7,
    )


LANES, NO_STEMS = (
    empty_lanes(),
    room_for_stems(lab.no_medium().stems),
)  # made once: thousands of rays go through them


def met_m(medium, origin_m, direction, far_m=60.0):
    """Range of one ray, inf where it meets nothing."""
    L = LANES
    L.origin_m[:, 0], L.direction[:, 0], L.range_m[0], L.surface[0] = origin_m, direction, far_m, NO_SURFACE
    lab.march_through(medium, L, 1, [*origin_m, *direction], far_m, ahead=NO_STEMS)
    return float(L.range_m[0]) if L.surface[0] != NO_SURFACE else np.inf


def murmur(place, seed):
    """Mixture of three whole numbers and a seed, with a finaliser of MurmurHash3's form."""
    h = seed
    for at, factor in zip(place, (0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D), strict=True):
        h ^= at * factor % 2**32
    h = (h ^ h >> 16) * 0x7FEB352D % 2**32
    h = (h ^ h >> 15) * 0x846CA68B % 2**32
    return h ^ h >> 16


def test_a_voxels_hash_depends_on_its_place_alone():
    """Along whichever axis a pulse passes, a voxel has the hash of x, y and z in arithmetic without limits,
    at negative places too."""
    rng = np.random.default_rng(6)
    for place in rng.integers(-(2**20), 2**20, (20, 3)).tolist():
        words = np.array(place).astype(np.uint32)
        for axes in ((0, 1, 2), (1, 0, 2), (2, 0, 1)):
            found = room.hash_of(*words[[*axes]], room.hash_factors(axes), np.uint32(7))
            assert found == murmur(place, 7)


@pytest.mark.parametrize("code", [10, 40, 90])
@pytest.mark.parametrize("corner", [(40, -7, 11), (0, 0, 0), (-3, 5, -900)])
def test_a_voxels_leaves_have_one_place_in_space(code, corner):
    """Rays through all columns of a voxel, along x, y and z and both ways, meet leaves at the same places,
    to 0.1 mm."""
    cell = np.array([2, 1, 3])
    medium = one_voxel(lab.no_medium(), code, tuple(cell.tolist()), corner)
    low_m = cell * VOXEL_M
    found = []
    for axis in range(3):
        one, two = (other for other in range(3) if other != axis)
        for way in (1.0, -1.0):
            places = []
            for a, b in itertools.product(range(16), repeat=2):
                origin_m, direction = np.zeros(3, "f4"), np.zeros(3, "f4")
                origin_m[one], origin_m[two] = low_m[[one, two]] + (np.array([a, b]) + 0.5) * VOXEL_M / 16
                origin_m[axis], direction[axis] = low_m[axis] - 3.0 * way, way
                if np.isfinite(range_m := met_m(medium, origin_m, direction)):
                    place = origin_m.astype(float)
                    place[axis] += way * range_m
                    places.append(place)
            places = np.array(places)
            found.append(places[np.lexsort(np.floor((places - low_m) / VOXEL_M * 16).T)])
    assert len(found[0]) > (1 if code == 10 else 15)
    for axis in range(3):
        assert np.abs(found[2 * axis] - found[2 * axis + 1]).max() < 1e-4
    cells = [np.floor((places - low_m) / VOXEL_M * 16).astype(int) for places in found]
    for other in cells[1:]:
        assert (other == cells[0]).all()


def test_a_voxel_has_one_leaf_in_each_column_along_each_axis():
    """In all variants of all kinds, every column along every axis has a leaf of its own, and a leaf is in the
    column that its position is in."""
    for variant, place in enumerate(room._PLACE // 16):
        for axis, (a, b) in enumerate(((1, 2), (0, 2), (0, 1))):
            leaf = room._LEAF_OF[axis, variant]
            assert sorted(leaf) == list(range(256))
            assert (leaf[16 * place[:, a].astype(int) + place[:, b]] == np.arange(256)).all()


@pytest.mark.parametrize(
    ("kind", "low", "high"), [(0, 0.4, 0.6), (1, 0.4, 0.6), (2, 0.3, 0.4), (3, 0.7, 0.9)]
)
def test_leaves_come_in_clumps_of_their_kind(kind, low, high):
    """Half the variance of low plants and crowns lies between squares of 125 mm, of 16 columns each, a third
    of that of level leaves, and four fifths of that of tufts, where a fifth of the columns have a leaf; of
    single leaves it is 1 / 16."""
    own = room._LEAF_OF[:, 16 * kind : 16 * (kind + 1)].reshape(-1, 4, 4, 4, 4)
    squares = (own < 256 // 5).mean(axis=(2, 4))
    mean = (256 // 5) / 256
    assert low < np.square(squares - mean).mean() / (mean * (1 - mean)) < high


def test_a_pair_of_leaves_is_side_by_side_from_the_side():
    """All pairs have two leaves at one height, which along x and along y are in neighbouring columns."""
    for pair, place in zip(room._PAIR, room._PLACE // 16, strict=True):
        cells = place[np.argsort(pair, kind="stable")].reshape(128, 2, 3).astype(int)
        assert (np.diff(np.sort(pair))[::2] == 0).all()
        assert (np.abs(cells[:, 0] - cells[:, 1]) == [1, 1, 0]).all()


BROADLEAVES = {
    name: plant.foliage
    for name, plant in {**flora().trees, **flora().shrubs}.items()
    if plant.foliage is not None and plant.foliage.kind == "leaf"
}


@pytest.mark.parametrize("name", BROADLEAVES)
def test_leaves_between_knots_are_as_wide_as_their_published_inclinations_make_them(name):
    """Between the knots, projected areas are those of the beta distribution of the leaves' inclination
    (Goel and Strebel 1984), integrated, to 1.5 % up to 17 degrees and to 5.5 % above."""
    mu, nu = BROADLEAVES[name].inclination
    tilt = np.random.default_rng(1).beta(nu, mu, 4000) * (np.pi / 2)
    azimuth = (np.arange(128) + 0.5) * (np.pi / 128)

    def area(sine):
        level = np.sqrt(1 - sine * sine) * np.sin(tilt)[:, None] * np.cos(azimuth)
        return np.abs(level + sine * np.cos(tilt)[:, None]).mean()

    knots = [area(sine) for sine in KNOTS]
    for sine, within in [(s, 0.015) for s in (0.05, 0.1, 0.2, 0.25)] + [(s, 0.055) for s in (0.4, 0.6, 0.8)]:
        weights = weights_of(np.float32(sine), np.float32(1.0))
        lower = int(weights.bits) // 7
        found = weights.low * knots[lower] + weights.high * knots[lower + 1]
        assert found == pytest.approx(area(sine), rel=within)


@pytest.mark.parametrize("name", BROADLEAVES)
def test_light_meets_leaves_between_knots_at_the_cosine_of_their_published_inclinations(name):
    """Between the knots, mean cosines of incidence are those of the beta distribution of the leaves'
    inclination, integrated, to 4 % up to 17 degrees and to 5 % above; those of the nearest knot depart by up
    to 15 %."""
    mu, nu = BROADLEAVES[name].inclination
    tilt = np.random.default_rng(1).beta(nu, mu, 4000) * (np.pi / 2)
    azimuth = (np.arange(128) + 0.5) * (np.pi / 128)

    def cosine(sine):
        level = np.sqrt(1 - sine * sine) * np.sin(tilt)[:, None] * np.cos(azimuth)
        met = np.abs(level + sine * np.cos(tilt)[:, None])
        return np.square(met).sum() / met.sum()

    knots = [cosine(sine) for sine in KNOTS]
    for sine, within in [(s, 0.04) for s in (0.05, 0.1, 0.15, 0.2, 0.25)] + [
        (s, 0.05) for s in (0.4, 0.6, 0.8)
    ]:
        weights = weights_of(np.float32(sine), np.float32(1.0))
        upper = int(weights.chance) / 256
        found = (1 - upper) * knots[weights.knot] + upper * knots[weights.knot + 1]
        assert found == pytest.approx(cosine(sine), rel=within)


NEAR_M = 0.5


def slab(lad, leaf_m=0.06, size_m=(16.0, 16.0, 8.0)):
    """Square leaves of all directions evenly in a box that begins at the origin, `lad` m2 per m3."""
    rng = np.random.default_rng(3)
    n = round(lad * np.prod(size_m) / leaf_m**2)
    return lab.square_leaves(rng, rng.random((n, 3)) * size_m, leaf_m / 2)


class Slab(lab.Tiles):
    """A tile with such a box 4 m over its level ground, and bare ones around it."""

    parts = MappingProxyType({"slab": (PlantPart.LEAF,)})

    def __init__(self, lad):
        super().__init__(NEAR_M, per_tile=0, things=False, height_m=lambda x, y: 0.0 * x + 0.0 * y, seed=3)
        self._shapes["slab"] = (slab(lad),)

    def tile(self, ix, iy):
        """Describe the tile, or a bare one."""
        stems, placed, first, surfaces = super().tile(ix, iy)
        if (ix, iy) != (0, 0):
            return stems, placed, first, surfaces
        surfaces = np.concatenate([surfaces, surfaces])
        surfaces["part"][1] = PlantPart.LEAF
        return (
            stems,
            [("slab", np.column_stack([np.eye(3), [2.0, 2.0, 4.0]]))],
            np.ones(1, np.int64),
            surfaces,
        )


@pytest.fixture(scope="module")
def leaves(workers):
    """Medium of a slab by its density of leaves, each made once."""

    @cache
    def of(lad):
        world = Slab(lad)
        far, window = FarCaster(world, workers), world.window(np.zeros((1, 3)), tiles=[(0, 0)])
        return far.medium(window, far.tiles(window))

    return of


@pytest.mark.parametrize("elevation_deg", [0.0, 17.46, 90.0])
@pytest.mark.parametrize("lad", [0.2, 0.5, 1.0])
def test_light_is_let_through_as_by_random_leaves(leaves, lad, elevation_deg):
    """Through 4 m of leaves of all directions goes exp(-LAD / 2 * 4), within three standard errors and 4 %
    of the depth."""
    medium, near_m = leaves(lad), NEAR_M
    rng, way_m, n = np.random.default_rng(7), 4.0, 5000
    sine = math.sin(math.radians(elevation_deg))
    level = math.sqrt(1 - sine * sine)
    through = np.zeros(n)
    for number in range(n):
        azimuth = rng.uniform(0, 2 * np.pi)
        direction = np.array([level * math.cos(azimuth), level * math.sin(azimuth), sine])
        start_m = rng.uniform([6.5, 6.5, 4.2], [13.5, 13.5, 7.8])  # all of the way lies within the box
        if sine > 0.9:
            start_m[2] = 6.0
        origin_m = start_m - near_m * direction
        through[number] = np.isinf(met_m(medium, origin_m, direction, near_m + way_m))
    # Rays share voxels: the error is that of groups of places.
    error = through.std() / np.sqrt(n)
    depth = -math.log(through.mean())
    assert depth == pytest.approx(lad / 2 * way_m, abs=3 * error / through.mean(), rel=0.04)
