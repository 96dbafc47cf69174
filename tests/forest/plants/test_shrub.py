"""Shrub prototypes."""

from functools import cache

import numpy as np
import pytest

from vlp16emu.forest.plants.flora import shrub_table
from vlp16emu.forest.plants.undergrowth import SHRUB_PARTS, ShrubKey, shrub_meshes
from vlp16emu.types import PlantPart

KEYS = {
    name: ShrubKey(name, 1, 0.7 * shrub.height_m[1], 0.7 * shrub.height_m[1] * shrub.width_share, "leaf_on")
    for name, shrub in shrub_table().items()
}


@cache
def grown(key):
    return shrub_meshes(9, key)


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
