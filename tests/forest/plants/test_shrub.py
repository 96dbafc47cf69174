"""Shrub prototypes."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import stats

from vlp16emu.forest.plants.flora import shrub_table
from vlp16emu.forest.plants.shrub import SHRUB_PARTS, ShrubKey, shrub_meshes
from vlp16emu.types import PlantPart

KEYS = {
    name: ShrubKey(name, 1, 0.7 * shrub.height_m[1], 0.7 * shrub.height_m[1] * shrub.width_share, "leaf_on")
    for name, shrub in shrub_table().items()
}


@cache
def grown(key):
    return shrub_meshes(9, key)


def corners(mesh):
    return np.moveaxis(mesh.vertices_m[mesh.faces].astype(np.float64), 1, 0)


def test_leaf_area_is_that_of_the_covered_ground():
    """Quads have the kind's leaf area index times the ground that the shrub covers, within 0.1 %."""
    for name, key in KEYS.items():
        a, b, c, d = corners(grown(key)[2])
        area_m2 = np.linalg.norm(np.cross(c - a, d - b), axis=1).sum() / 2
        expected = shrub_table()[key.species].leaf_area_index * np.pi / 4 * key.width_m**2
        assert area_m2 == pytest.approx(expected, rel=1e-3), name


def test_leaves_are_inclined_as_measured():
    """Leaf inclination passes a chi-square test with 20 equally likely classes against its beta distribution."""
    for name, key in KEYS.items():
        a, b, c, d = corners(grown(key)[2])
        normal = np.cross(c - a, d - b)
        zenith = np.arccos(np.abs(normal[:, 2]) / np.linalg.norm(normal, axis=1))
        mu, nu = shrub_table()[key.species].foliage.inclination
        likely = stats.beta(nu, mu).cdf(zenith / (np.pi / 2))
        assert stats.chisquare(np.histogram(likely, 20, (0, 1))[0]).pvalue > 0.001, name


def test_a_shrub_has_its_size():
    """It stands on the ground, reaches its height within a quarter, and is no wider than a quarter more than its width."""
    for name, key in KEYS.items():
        vertices = np.concatenate([mesh.vertices_m for mesh in grown(key)])
        assert -0.25 * key.height_m < vertices[:, 2].min() < 0, name
        assert vertices[:, 2].max() == pytest.approx(key.height_m, rel=0.25), name
        width_m = np.ptp(vertices[:, :2], axis=0)
        assert (width_m > 0.6 * key.width_m).all(), name
        assert (width_m < 1.25 * key.width_m).all(), name


def test_stems_come_out_of_the_ground_side_by_side():
    """There are as many stems as the kind has, all within a tenth of the width of the middle, below the ground."""
    for name, key in KEYS.items():
        assert SHRUB_PARTS == (PlantPart.STEM, PlantPart.BRANCH_FIRST_ORDER, PlantPart.LEAF), name
        stems = grown(key)[0].vertices_m.reshape(-1, 49, 3)
        assert len(stems) == shrub_table()[key.species].stems, name
        foot = stems[:, :6].mean(axis=1)
        assert (np.hypot(foot[:, 0], foot[:, 1]) < 0.1 * key.width_m).all(), name
        assert (foot[:, 2] < 0).all(), name


def test_winter_takes_the_leaves_only():
    """Leaf-off a shrub has no leaf face and the same stems and twigs."""
    for name, key in KEYS.items():
        winter = grown(replace(key, season="leaf_off"))
        assert len(winter[2].faces) == 0, name
        for cold, warm in zip(winter[:2], grown(key)[:2], strict=True):
            assert cold.vertices_m.tobytes() == warm.vertices_m.tobytes(), name


def test_a_shrub_depends_on_seed_and_key_alone():
    """The same seed and key give the same bytes; another seed, variant or size gives another shrub."""
    key = KEYS["hazel"]

    def bytes_of(seed, which):
        return b"".join(m.vertices_m.tobytes() + m.faces.tobytes() for m in shrub_meshes(seed, which))

    assert bytes_of(4, key) == bytes_of(4, replace(key))
    others = [(4, key), (5, key), (4, replace(key, variant=0)), (4, replace(key, height_m=1.9))]
    assert len({bytes_of(*other) for other in others}) == 4
