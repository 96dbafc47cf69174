"""Crown prototypes: grown once for a species, diameter class, variant and level of detail, then instanced."""

from dataclasses import dataclass

import numpy as np

from vlp16emu.random import Purpose, generator
from vlp16emu.types import Mesh
from vlp16emu.world.branches import Branches, first_order, second_order, tubes
from vlp16emu.world.foliage import foliage_mesh
from vlp16emu.world.species import species_table, taper_radius_m

__all__ = ["VARIANTS", "CrownKey", "crown_meshes"]

VARIANTS = 3
"""Different crowns of the same species and diameter class."""


@dataclass(frozen=True, slots=True)
class CrownKey:
    """Name of a crown's shape, and with the seed all that it is grown from."""

    species: str
    variant: int
    level: int
    """Of detail, 0 is the finest."""
    dbh_m: float
    height_m: float
    crown_base_m: float
    crown_width_m: float
    leaf_area_m2: float
    """One-sided."""

    @property
    def crown_length_m(self) -> float:
        """From the lowest branch to the tip."""
        return self.height_m - self.crown_base_m


@dataclass(frozen=True, slots=True)
class _Detail:
    """How finely crowns are drawn at one level."""

    every: int
    """Of the nodes of a branch's curve, the share that is used."""
    first_sides: int
    second_sides: int
    second_share: int
    """One in so many second-order branches is drawn."""
    merged: int
    """Leaves or shoots that one quad stands for."""


_DETAIL = (_Detail(1, 6, 4, 1, 1), _Detail(2, 4, 3, 1, 3), _Detail(4, 3, 3, 3, 10))


def crown_meshes(seed: int, key: CrownKey) -> tuple[Mesh, Mesh, Mesh]:
    """First-order branches, second-order branches, leaves.

    In the crown's own frame: origin on the stem's axis at the crown base, z along the axis. All levels
    of a crown have the same branches and the same leaf area; coarse ones draw them with fewer faces.
    """
    species, detail = species_table()[key.species], _DETAIL[key.level]
    rng = generator(seed, Purpose.CROWN, species.number, key.variant, round(key.dbh_m * 1e4))
    at_m = np.linspace(key.crown_base_m, key.height_m, 16)[None]
    dbh_m, height_m = np.array([key.dbh_m]), np.array([key.height_m])
    stem_m = taper_radius_m(np.array([species.taper]), dbh_m, height_m, at_m)[0]
    first = first_order(rng, species.crown, (key.crown_length_m, key.crown_width_m), stem_m)
    second = second_order(rng, species.crown, first)
    leaves = foliage_mesh(rng, species.foliage, second, key.leaf_area_m2, detail.merged)
    return (
        tubes(first, detail.every, detail.first_sides),
        tubes(_some(second, detail.second_share), detail.every, detail.second_sides),
        leaves,
    )


def _some(branches: Branches, one_in: int) -> Branches:
    """Every so-many-th branch."""
    keep = slice(None, None, one_in)
    return Branches(
        branches.nodes_m[keep], branches.azimuth[keep], branches.length_m[keep], branches.radius_m[keep]
    )
