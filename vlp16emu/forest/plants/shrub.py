"""Shrub prototypes: stems from the ground, twigs and leaves, grown once for a kind, size and variant."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vlp16emu.forest.plants.branches import ground_stems, side_branches, tubes
from vlp16emu.forest.plants.flora import shrub_table
from vlp16emu.forest.plants.foliage import foliage_mesh
from vlp16emu.forest.plants.meshes import NO_LEAVES
from vlp16emu.forest.plants.settings import Season
from vlp16emu.forest.plants.species import Shrub
from vlp16emu.forest.purpose import Growth
from vlp16emu.random import generator
from vlp16emu.types import Mesh, PlantPart

SHRUB_PARTS = (PlantPart.STEM, PlantPart.BRANCH_FIRST_ORDER, PlantPart.LEAF)
"""Of the meshes of a shrub, in order. A mesh without faces stands where it has no such part."""

_STEM_SIDES, _TWIG_SIDES = 6, 3


@dataclass(frozen=True, slots=True)
class ShrubKey:
    """Name of a shrub's shape, and with the seed all that it is grown from."""

    species: str
    variant: int
    height_m: float
    width_m: float
    season: Season

    @property
    def projection_m2(self) -> float:
        """Ground that it covers."""
        return np.pi / 4 * self.width_m * self.width_m


def shrub_meshes(seed: int, key: ShrubKey, *, table: Mapping[str, Shrub] | None = None) -> tuple[Mesh, Mesh, Mesh]:
    """Meshes of `SHRUB_PARTS`, its origin on the ground and z up, with its kind's leaf area index on the ground that it covers."""
    shrub = (table or shrub_table())[key.species]
    size = round(key.height_m * 1e3), round(key.width_m * 1e3)
    rng = generator(seed, Growth.SHRUB, shrub.number, key.variant, *size)
    bend_deg = shrub.droop_deg, shrub.crook_deg
    stems = ground_stems(rng, (key.height_m, key.width_m), shrub.stems, shrub.rise_deg, bend_deg, shrub.slenderness)
    twigs = side_branches(rng, shrub.twigs, stems, 2)
    leaves = NO_LEAVES
    if shrub.foliage.is_borne(key.season):
        leaf_area_m2 = shrub.leaf_area_index * key.projection_m2
        leaves = foliage_mesh(rng, shrub.foliage, twigs, leaf_area_m2)
    return tubes(stems, _STEM_SIDES), tubes(twigs, _TWIG_SIDES), leaves
