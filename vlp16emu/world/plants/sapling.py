"""Sapling prototypes: a thin stem from the ground with branches and leaves, grown once for a species and height."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vlp16emu.random import Purpose, generator
from vlp16emu.types import Mesh, PlantPart
from vlp16emu.world.plants.branches import first_order, side_branches, tubes
from vlp16emu.world.plants.flora import species_table
from vlp16emu.world.plants.foliage import foliage_mesh
from vlp16emu.world.plants.species import Habit, Species
from vlp16emu.world.stand.settings import Season

__all__ = [
    "CROWN_BASE_SHARE",
    "CROWN_WIDTH_SHARE",
    "SAPLING_PARTS",
    "SLENDERNESS",
    "SaplingKey",
    "sapling_meshes",
]

SAPLING_PARTS = (
    PlantPart.STEM,
    PlantPart.BRANCH_FIRST_ORDER,
    PlantPart.BRANCH_HIGHER_ORDER,
    PlantPart.LEAF,
)
"""Of the meshes of a sapling, in order. A mesh without faces stands where it has no such part."""

SLENDERNESS = 80.0
"""Height of a sapling over the diameter of its stem at the ground; the stem is a cone; assumptions."""

CROWN_BASE_SHARE, CROWN_WIDTH_SHARE = 0.1, 0.5
"""Height of the lowest branch, and width of the crown, over the height; assumptions."""

_LEAF_AREA_INDEX = 2.0
"""Of a sapling in the shade on the ground under it; assumption."""

_FEWEST_WHORLS = 6
"""However small it is; assumption."""

_STEM_SIDES, _BRANCH_SIDES = 6, 4

_EVERY = 2
"""Of the nodes of a branch's curve, one in so many is used."""

_BURIED_SHARE = 0.05
"""Of the height, how far the stem reaches into the ground."""


@dataclass(frozen=True, slots=True)
class SaplingKey:
    """Name of a sapling's shape, and with the seed all that it is grown from."""

    species: str
    variant: int
    height_m: float
    season: Season


def sapling_meshes(
    seed: int, key: SaplingKey, *, table: Mapping[str, Species] | None = None
) -> tuple[Mesh, Mesh, Mesh, Mesh]:
    """Meshes of `SAPLING_PARTS`, in a frame with its origin on the ground and z along the stem."""
    species = (table or species_table())[key.species]
    rng = generator(seed, Purpose.SAPLING, species.number, key.variant, round(key.height_m * 1e3))
    base_m, width_m = CROWN_BASE_SHARE * key.height_m, CROWN_WIDTH_SHARE * key.height_m
    crown_m = key.height_m - base_m
    foot_m = key.height_m / SLENDERNESS / 2
    stem_m = foot_m * (1 - CROWN_BASE_SHARE) * np.linspace(1, 0, 16)
    habit = _small(species.crown, crown_m)
    first = first_order(rng, habit, (crown_m, width_m), stem_m)
    second = side_branches(rng, habit.twigs, first, 2)
    leaves = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 4), np.uint32))
    foliage = species.foliage
    if foliage and (key.season == "leaf_on" or foliage.kind == "shoot"):
        leaf_area_m2 = _LEAF_AREA_INDEX * np.pi / 4 * width_m**2
        leaves = foliage_mesh(rng, foliage, second, leaf_area_m2)
    return (
        _cone(foot_m, key.height_m),
        _raised(tubes(first, _BRANCH_SIDES, every=_EVERY), base_m),
        _raised(tubes(second, _BRANCH_SIDES, every=_EVERY), base_m),
        _raised(leaves, base_m),
    )


def _small(habit: Habit, crown_m: float) -> Habit:
    """Habit of a tree that has not yet room for its whorls and its shortest twigs."""
    spacing_m = min(habit.whorl_spacing_m, crown_m / _FEWEST_WHORLS)
    twigs = habit.twigs.model_copy(update={"length_m": (0.01, habit.twigs.length_m[1])})
    return habit.model_copy(update={"whorl_spacing_m": spacing_m, "twigs": twigs})


def _raised(mesh: Mesh, by_m: float) -> Mesh:
    """Lift a mesh from the crown's frame to that of the stem's foot."""
    return Mesh(mesh.vertices_m + np.array([0.0, 0.0, by_m], np.float32), mesh.faces)


def _cone(foot_m: float, height_m: float) -> Mesh:
    """Make a closed stem whose cross-section at any height has the area of its circle."""
    step = 2 * np.pi / _STEM_SIDES
    corner_m = foot_m * (1 + _BURIED_SHARE) * np.sqrt(step / np.sin(step))
    angle = step * np.arange(_STEM_SIDES)
    ring = np.column_stack([corner_m * np.cos(angle), corner_m * np.sin(angle), np.zeros(_STEM_SIDES)])
    ring[:, 2] = -_BURIED_SHARE * height_m
    vertices = np.concatenate([ring, [[0, 0, -_BURIED_SHARE * height_m], [0, 0, height_m]]])
    here = np.arange(_STEM_SIDES)
    after, middle, tip = (
        np.roll(here, -1),
        np.full(_STEM_SIDES, _STEM_SIDES),
        np.full(_STEM_SIDES, _STEM_SIDES + 1),
    )
    faces = np.concatenate([np.column_stack([after, here, middle]), np.column_stack([here, after, tip])])
    return Mesh(vertices.astype(np.float32), faces.astype(np.uint32))
