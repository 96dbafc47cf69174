"""What prototypes of crowns, saplings and shrubs have in common, and the size of shrubs."""

from dataclasses import replace

import numpy as np
import pytest
from forest.kit import areas_m2, corners, zeniths
from scipy import stats

from vlp16emu.forest.plants.prototypes import (
    SHRUB_PARTS,
    CrownKey,
    SaplingKey,
    ShrubKey,
    crown_meshes,
    sapling_meshes,
    shrub_meshes,
)
from vlp16emu.forest.plants.species import flora
from vlp16emu.types import PlantPart

PLANTS = {**flora().trees, **flora().shrubs}
CROWNS = [CrownKey(name, 0, 0.24, 21.0, 9.0, 4.5, 90.0) for name, one in flora().trees.items() if one.foliage]
SAPLINGS = [SaplingKey(name, 1, 3.0, "leaf_on") for name in ("european_beech", "norway_spruce")]
SHRUBS = [
    ShrubKey(name, 1, 0.7 * one.height_m[1], 0.7 * one.height_m[1] * one.width_share, "leaf_on")
    for name, one in flora().shrubs.items()
]


def grown(key, seed=4):
    makers = {CrownKey: crown_meshes, SaplingKey: sapling_meshes, ShrubKey: shrub_meshes}
    meshes = makers[type(key)](seed, key)
    return meshes[:-1] if len(meshes) == 4 and isinstance(key, CrownKey) else meshes  # without dead branches


def bytes_of(meshes):
    return [mesh.vertices_m.tobytes() + mesh.faces.tobytes() for mesh in meshes]


@pytest.mark.parametrize(
    ("keys", "leaf_m2", "share"),
    [
        (CROWNS, lambda key: key.leaf_area_m2, 1e-3),
        (SAPLINGS, lambda key: 2 * np.pi / 4 * (key.height_m / 2) ** 2, 0.02),
        (SHRUBS, lambda key: PLANTS[key.species].leaf_area_index * np.pi / 4 * key.width_m**2, 1e-3),
    ],
    ids=["crowns", "saplings", "shrubs"],
)
def test_leaf_area_is_that_of_the_plant(keys, leaf_m2, share):
    """Quads have the leaf area of the crown, twice the projection of a sapling, or the index of a shrub,
    over their clumping."""
    for key in keys:
        target = leaf_m2(key) / PLANTS[key.species].foliage.clumping
        assert areas_m2(corners(grown(key)[-1])).sum() == pytest.approx(target, rel=share), key


@pytest.mark.parametrize(
    "key", [key for key in CROWNS + SHRUBS if PLANTS[key.species].foliage.kind == "leaf"]
)
def test_leaves_are_inclined_as_measured(key):
    """Leaf inclination passes a chi-square test with 20 equally likely classes against its beta
    distribution."""
    zenith = zeniths(corners(grown(key)[-1]))
    mu, nu = PLANTS[key.species].foliage.inclination
    # Far more leaves than were ever measured would find the rounding of mu and nu.
    likely = stats.beta(nu, mu).cdf(zenith[:: 1 + len(zenith) // 5000] / (np.pi / 2))
    assert stats.chisquare(np.histogram(likely, 20, (0, 1))[0]).pvalue > 0.001


@pytest.mark.parametrize("key", CROWNS + SAPLINGS + SHRUBS)
def test_winter_takes_the_leaves_of_broadleaves_and_nothing_else(key):
    """Leaf-off a broadleaf has no leaf face, a conifer keeps its shoots, and the wood is the same to the
    byte."""
    summer, winter = grown(key), grown(replace(key, season="leaf_off"))
    assert bytes_of(winter[:-1]) == bytes_of(summer[:-1])
    if PLANTS[key.species].foliage.kind == "shoot":
        assert bytes_of(winter) == bytes_of(summer)
    else:
        assert len(winter[-1].faces) == 0


@pytest.mark.parametrize("key", CROWNS[:4] + SAPLINGS + SHRUBS[:1])
def test_a_prototype_depends_on_seed_and_key_alone(key):
    """The same seed and key give the same bytes; another seed, variant or size gives another plant."""
    others = [
        replace(key, variant=2),
        replace(key, **({"dbh_m": 0.26} if key in CROWNS else {"height_m": 1.9})),
    ]
    assert bytes_of(grown(key)) == bytes_of(grown(replace(key)))
    assert (
        len({b"".join(bytes_of(one)) for one in (grown(key), grown(key, seed=5), *map(grown, others))}) == 4
    )


def test_a_shrub_has_its_size():
    """It stands on the ground, reaches its height within a quarter, and is no wider than a quarter more
    than its width."""
    for key in SHRUBS:
        vertices = np.concatenate([mesh.vertices_m for mesh in shrub_meshes(9, key)])
        assert -0.25 * key.height_m < vertices[:, 2].min() < 0, key.species
        assert vertices[:, 2].max() == pytest.approx(key.height_m, rel=0.25), key.species
        width_m = np.ptp(vertices[:, :2], axis=0)
        assert (width_m > 0.6 * key.width_m).all(), key.species
        assert (width_m < 1.25 * key.width_m).all(), key.species


def test_stems_come_out_of_the_ground_side_by_side():
    """There are as many stems as the kind has, all within a tenth of the width of the middle, below the
    ground."""
    for key in SHRUBS:
        assert SHRUB_PARTS == (PlantPart.STEM, PlantPart.BRANCH_FIRST_ORDER, PlantPart.LEAF), key.species
        stems = shrub_meshes(9, key)[0].vertices_m.reshape(-1, 49, 3)
        assert len(stems) == flora().shrubs[key.species].stems, key.species
        foot = stems[:, :6].mean(axis=1)
        assert (np.hypot(foot[:, 0], foot[:, 1]) < 0.1 * key.width_m).all(), key.species
        assert (foot[:, 2] < 0).all(), key.species
