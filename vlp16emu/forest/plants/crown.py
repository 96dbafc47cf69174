"""Crown prototypes: grown once for a species, diameter class and variant, then instanced."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vlp16emu.elementary import cos, matmul, sin
from vlp16emu.forest.plants.allometry import taper_radius_m
from vlp16emu.forest.plants.branches import (
    Branches,
    bole_branches,
    first_order,
    joined,
    side_branches,
    tubes,
    volume_m3,
)
from vlp16emu.forest.plants.flora import Table, Trees, species_table
from vlp16emu.forest.plants.foliage import foliage_mesh
from vlp16emu.forest.plants.meshes import merged
from vlp16emu.forest.plants.species import Species
from vlp16emu.forest.plants.stem import lean_rotation
from vlp16emu.forest.purpose import Growth
from vlp16emu.forest.settings import Season
from vlp16emu.random import generator
from vlp16emu.types import Array, Mesh, PlantPart
from vlp16emu.world.vectors import places_m

VARIANTS = 3  # different crowns of the same species and diameter class, of short to long ones
CROWN_PARTS = (PlantPart.BRANCH_FIRST_ORDER, PlantPart.BRANCH_HIGHER_ORDER, PlantPart.LEAF, PlantPart.DEAD_BRANCH)
"""Of the meshes of a crown, in order. A mesh without faces stands where a crown has no such part."""
_SIDES = (6, 4, 3)  # of branches, by order
_NOTHING = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))


@dataclass(frozen=True, slots=True)
class CrownKey:
    """Name of a crown's shape, and with the seed all that it is grown from."""

    species: str
    variant: int
    dbh_m: float
    height_m: float
    crown_base_m: float
    crown_width_m: float
    leaf_area_m2: float  # one-sided
    season: Season = "leaf_on"
    dead_branches: bool = False  # whether dead branches still sit below the crown

    @property
    def crown_length_m(self) -> float:
        """Length from the lowest branch to the tip."""
        return self.height_m - self.crown_base_m


def crown_meshes(seed: int, key: CrownKey, *, table: Table | None = None) -> tuple[Mesh, Mesh, Mesh, Mesh]:
    """Meshes of `CROWN_PARTS`; a dead tree has all its branches among the dead ones.

    In the crown's own frame: origin on the stem's axis at the crown base, z along the axis. Season
    and dead branches change nothing else about a crown.
    """
    species = (table or species_table())[key.species]
    rng, orders, dead = _orders(seed, key, species)
    leaves = _NOTHING
    if species.foliage and species.foliage.is_borne(key.season):
        leaves = foliage_mesh(rng, species.foliage, orders[-1], key.leaf_area_m2)
    first, *others = (tubes(branches, sides) for branches, sides in zip(orders, _SIDES, strict=False))
    higher = merged(*others)
    bare = [tubes(dead[0], _SIDES[1], every=4), tubes(dead[1], _SIDES[2])] if key.dead_branches else []
    if species.foliage is None:
        return _NOTHING, _NOTHING, _NOTHING, merged(first, higher, *bare)
    return first, higher, leaves, merged(*bare) if bare else _NOTHING


def crown_branches(seed: int, key: CrownKey, *, table: Table | None = None) -> tuple[Branches, Branches]:
    """Return the branches that leave the stem, in the crown's own frame: living ones, and dead ones."""
    species = (table or species_table())[key.species]
    (first, *_), dead = _orders(seed, key, species)[1:]
    bare = dead[0] if key.dead_branches else dead[0].of(np.zeros(0, np.int64))
    return (first, bare) if species.foliage else (first.of(np.zeros(0, np.int64)), joined(first, bare))


def crown_wood_m3(seed: int, key: CrownKey, *, table: Table | None = None) -> float:
    """Volume of all branches of a prototype, dead ones too."""
    orders, dead = _orders(seed, key, (table or species_table())[key.species])[1:]
    return sum(volume_m3(branches) for branches in (*orders, *(dead if key.dead_branches else ())))


def crown_scale(trees: Trees, crowns: Sequence[CrownKey]) -> tuple[Array, Array]:
    """Stretch of each tree's crown over its prototype: across (n,), and along the axis (n,), which leans while heights are vertical."""
    prototype_m = np.array([(c.crown_width_m, c.crown_length_m) for c in crowns]).reshape(-1, 2)
    upright = cos(np.radians(trees["lean_deg"]))
    wide: Array = trees["crown_width_m"] / prototype_m[:, 0]
    long: Array = (trees["height_m"] - trees["crown_base_m"]) / upright / prototype_m[:, 1]
    return wide, long


def crown_placements(trees: Trees, crowns: Sequence[CrownKey]) -> Array:
    """`world_T_shape` of the crowns, (n, 3, 4): scaled to the tree's size, turned, and leaning with the stem."""
    wide, long = crown_scale(trees, crowns)
    lean = lean_rotation(trees["lean_deg"], trees["lean_towards_deg"])
    upright = lean[:, 2, 2]  # cosine of the lean: heights are vertical
    turn = np.radians(trees["crown_azimuth_deg"])
    stem_T = np.zeros((len(trees), 3, 3))
    stem_T[:, 0, 0] = stem_T[:, 1, 1] = wide * cos(turn)
    stem_T[:, 1, 0], stem_T[:, 0, 1] = wide * sin(turn), -wide * sin(turn)
    stem_T[:, 2, 2] = long
    foot = places_m(trees)
    base = foot + lean[:, :, 2] * (trees["crown_base_m"] / upright)[:, None]
    return np.concatenate([matmul(lean, stem_T), base[..., None]], axis=2)


def _generator(purpose: Growth, seed: int, key: CrownKey, species: Species) -> np.random.Generator:
    return generator(seed, purpose, species.number, key.variant, round(key.dbh_m * 1e4))


def _orders(
    seed: int, key: CrownKey, species: Species
) -> tuple[np.random.Generator, list[Branches], tuple[Branches, Branches]]:
    """Random numbers; branches of first, second and, on broad crowns, third order; and dead ones below with their twigs."""
    rng = _generator(Growth.CROWN, seed, key, species)
    at_m = np.append(*(np.linspace(key.crown_base_m, end_m, 16) for end_m in (key.height_m, 0.0)))
    taper = species.taper.row[None]
    stem_m = taper_radius_m(taper, np.array([key.dbh_m]), np.array([key.height_m]), at_m[None])[0]
    habit = species.crown
    bole_rng = _generator(Growth.DEAD_BRANCH, seed, key, species)
    longest_m = habit.base_fraction * key.crown_width_m / 2
    living, *dead = bole_branches(bole_rng, habit, key.crown_base_m, longest_m, stem_m[16:])
    crown = [first_order(rng, habit, (key.crown_length_m, key.crown_width_m), stem_m[:16])]
    below = [living]
    for order, twigs in enumerate((habit.twigs, habit.twiglets), start=2):
        if twigs is not None:
            crown.append(side_branches(rng, twigs, crown[-1], order))
            below.append(side_branches(bole_rng, twigs, below[-1], order))
    return rng, [joined(*both) for both in zip(crown, below, strict=True)], (dead[0], dead[1])
