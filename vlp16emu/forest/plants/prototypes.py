"""Prototypes of crowns, saplings and shrubs: grown once per species, size and variant, then instanced."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from vlp16emu.elementary import atan2, cos, hypot, matmul, sin
from vlp16emu.forest.plants.allometry import taper_radius_m
from vlp16emu.forest.plants.branches import (
    NO_LEAVES,
    Branches,
    bole_branches,
    first_order,
    ground_stems,
    join,
    merge,
    side_branches,
    tubes,
    volume_m3,
)
from vlp16emu.forest.plants.foliage import foliage_mesh
from vlp16emu.forest.plants.species import Shrub, Species, Table, Trees, flora
from vlp16emu.forest.plants.stem import lean_rotation
from vlp16emu.forest.purpose import Growth
from vlp16emu.forest.settings import Season
from vlp16emu.random import generator
from vlp16emu.types import F8, Mesh, PlantPart
from vlp16emu.world.vectors import closed_body, places_m

VARIANTS = 3  # crowns of the same species and diameter class, from short to long
CROWN_PARTS = (
    PlantPart.BRANCH_FIRST_ORDER,
    PlantPart.BRANCH_HIGHER_ORDER,
    PlantPart.LEAF,
    PlantPart.DEAD_BRANCH,
)
"""Parts of the meshes of a crown, in order. A part that a crown lacks is a mesh without faces."""
_SIDES = (6, 4, 3)  # number of sides of branches, by order
_NOTHING = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))


@dataclass(frozen=True, slots=True)
class CrownKey:
    """Key of a crown's shape; with the seed it determines the shape."""

    species: str
    variant: int
    dbh_m: float
    height_m: float
    crown_base_m: float
    crown_width_m: float
    leaf_area_m2: float  # one-sided
    season: Season = "leaf_on"
    dead_branches: bool = False  # True if dead branches remain below the crown
    openness: float = 0.0  # 0 in a closed stand, 1 without neighbours

    @property
    def crown_length_m(self) -> float:
        """Length from the lowest branch to the tip."""
        return self.height_m - self.crown_base_m


def crown_meshes(seed: int, key: CrownKey, *, table: Table | None = None) -> tuple[Mesh, Mesh, Mesh, Mesh]:
    """Meshes of `CROWN_PARTS`; all branches of a dead tree are dead branches.

    The crown frame has its origin on the stem's axis at the crown base and z along the axis. Season
    and dead branches change nothing else in a crown.
    """
    species = (table or flora().trees)[key.species]
    rng, orders, dead = _orders(seed, key, species)
    leaves = _NOTHING
    if species.foliage and species.foliage.is_borne(key.season):
        leaves = foliage_mesh(rng, species.foliage, orders[-1], key.leaf_area_m2)
    first, *higher_orders = (tubes(branches, sides) for branches, sides in zip(orders, _SIDES, strict=False))
    higher = merge(*higher_orders)
    bare = [tubes(dead[0], _SIDES[1], every=4), tubes(dead[1], _SIDES[2])] if key.dead_branches else []
    if species.foliage is None:
        return _NOTHING, _NOTHING, _NOTHING, merge(first, higher, *bare)
    return first, higher, leaves, merge(*bare) if bare else _NOTHING


def crown_branches(seed: int, key: CrownKey, *, table: Table | None = None) -> tuple[Branches, Branches]:
    """Return the living and the dead first-order branches, in the crown frame."""
    species = (table or flora().trees)[key.species]
    (first, *_), dead = _orders(seed, key, species)[1:]
    bare = dead[0] if key.dead_branches else dead[0].select(np.zeros(0, np.int64))
    return (first, bare) if species.foliage else (first.select(np.zeros(0, np.int64)), join(first, bare))


def crown_core(key: CrownKey, *, table: Table | None = None) -> F8:
    """Return heights, ascending in the crown frame, and radii (2, 31) of the stem in which branches begin."""
    at_m = np.append(
        np.linspace(0.0, key.crown_base_m, 16)[:-1], np.linspace(key.crown_base_m, key.height_m, 16)
    )
    return np.stack(
        [at_m - key.crown_base_m, _stem_radius_m(key, (table or flora().trees)[key.species], at_m)]
    )


def _stem_radius_m(key: CrownKey, species: Species, at_m: F8) -> F8:
    """Return the radii of a prototype's stem at heights (n,) over the ground."""
    taper = species.taper_rows(np.array([key.dbh_m]))
    return taper_radius_m(taper, np.array([key.dbh_m]), np.array([key.height_m]), at_m[None])[0]


def crown_wood_m3(seed: int, key: CrownKey, *, table: Table | None = None) -> float:
    """Volume of all branches of a prototype, including dead ones."""
    orders, dead = _orders(seed, key, (table or flora().trees)[key.species])[1:]
    return sum(volume_m3(branches) for branches in (*orders, *(dead if key.dead_branches else ())))


def crown_scale(trees: Trees, crowns: Sequence[CrownKey]) -> tuple[F8, F8]:
    """Scale of each tree's crown relative to its prototype: across (n,), and along the leaning axis (n,)."""
    width_m, length_m = np.array([(c.crown_width_m, c.crown_length_m) for c in crowns]).reshape(-1, 2).T
    upright = cos(np.radians(trees["lean_deg"]))
    return trees["crown_width_m"] / width_m, (trees["height_m"] - trees["crown_base_m"]) / upright / length_m


def crown_placements(trees: Trees, crowns: Sequence[CrownKey]) -> F8:
    """`world_T_shape` (n, 3, 4) of the crowns.

    They are scaled to the tree's size, turned, and lean with the stem.
    """
    wide, long = crown_scale(trees, crowns)
    lean = lean_rotation(trees["lean_deg"], trees["lean_towards_deg"])
    upright = lean[:, 2, 2]  # cosine of the lean: heights are vertical
    turn = np.radians(trees["crown_azimuth_deg"])
    stem_T = np.zeros((len(trees), 3, 3))
    stem_T[:, 0, 0] = stem_T[:, 1, 1] = wide * cos(turn)
    stem_T[:, 1, 0] = wide * sin(turn)
    stem_T[:, 0, 1] = -wide * sin(turn)
    stem_T[:, 2, 2] = long
    base = places_m(trees) + lean[:, :, 2] * (trees["crown_base_m"] / upright)[:, None]
    return np.concatenate([matmul(lean, stem_T), base[..., None]], axis=2)


def _orders(
    seed: int, key: CrownKey, species: Species
) -> tuple[np.random.Generator, list[Branches], tuple[Branches, Branches]]:
    """Return the random generator, branches by order, and the dead branches below with their twigs."""
    name = species.number, key.variant, round(key.dbh_m * 1e4)
    rng, bole_rng = (generator(seed, purpose, *name) for purpose in (Growth.CROWN, Growth.DEAD_BRANCH))
    at_m = np.append(*(np.linspace(key.crown_base_m, end_m, 16) for end_m in (key.height_m, 0.0)))
    stem_m = _stem_radius_m(key, species, at_m)
    habit = species.crown.in_stand(key.openness)
    longest_m = habit.base_fraction * key.crown_width_m / 2
    living, *dead = bole_branches(bole_rng, habit, key.crown_base_m, longest_m, stem_m[16:])
    crown = [first_order(rng, habit, (key.crown_length_m, key.crown_width_m), stem_m[:16])]
    below = [living]
    for order, twigs in enumerate((habit.twigs, habit.twiglets), start=2):
        if twigs is not None:
            crown.append(side_branches(rng, twigs, crown[-1], order))
            below.append(side_branches(bole_rng, twigs, below[-1], order))
    return rng, [join(*branches) for branches in zip(crown, below, strict=True)], (dead[0], dead[1])


SAPLING_PARTS = (PlantPart.STEM, PlantPart.BRANCH_FIRST_ORDER, PlantPart.BRANCH_HIGHER_ORDER, PlantPart.LEAF)
"""Parts of the meshes of a sapling, in order. A missing part is a mesh without faces."""
SLENDERNESS = 80.0
"""Height of a sapling over its stem's diameter at the ground; the stem is a cone; assumptions."""
CROWN_BASE_SHARE = 0.1
CROWN_WIDTH_SHARE = 0.5
"""Height of the lowest branch, and width of the crown, over the height; assumptions."""
_LEAF_AREA_INDEX = 2.0  # leaf area index of a shaded sapling on its crown projection; assumption
_FEWEST_WHORLS = 6  # fewest whorls of a sapling; assumption
_STEM_SIDES = 6
_BRANCH_SIDES = 4
_EVERY = 2  # every second node of a branch's curve is used
_LEAN = 0.15
_BOW = 0.08
_SWAY = 0.03
_LOPSIDED = 0.5
"""Upper limits for saplings: offset of the tip, simple and S-shaped bow of the stem, all over the height, and
extra reach of the crown on one side; assumptions."""
_CONE = (0.0, 0.12, 0.25, 0.38, 0.5, 0.62, 0.75, 0.88)  # relative heights of a stem's rings
_BURIED_SHARE = 0.05  # depth of the stem in the ground over its height


@dataclass(frozen=True, slots=True)
class SaplingKey:
    """Key of a sapling's shape; with the seed it determines the shape."""

    species: str
    variant: int
    height_m: float
    season: Season


def sapling_meshes(
    seed: int, key: SaplingKey, *, table: Table | None = None
) -> tuple[Mesh, Mesh, Mesh, Mesh]:
    """Meshes of `SAPLING_PARTS`, in a frame with its origin on the ground and z along the stem."""
    species = (table or flora().trees)[key.species]
    rng = generator(seed, Growth.SAPLING, species.number, key.variant, round(key.height_m * 1e3))
    base_m = CROWN_BASE_SHARE * key.height_m
    width_m = CROWN_WIDTH_SHARE * key.height_m
    crown_m = key.height_m - base_m
    foot_m = key.height_m / SLENDERNESS / 2
    stem_m = foot_m * (1 - CROWN_BASE_SHARE) * np.linspace(1, 0, 16)
    twigs = species.crown.twigs.model_copy(update={"length_m": (0.01, species.crown.twigs.length_m[1])})
    spacing_m = min(species.crown.whorl_spacing_m, crown_m / _FEWEST_WHORLS)
    habit = species.crown.model_copy(update={"whorl_spacing_m": spacing_m, "twigs": twigs})
    first = first_order(rng, habit, (crown_m, width_m), stem_m)
    second = side_branches(rng, habit.twigs, first, 2)
    bend = partial(_bend, key.height_m, rng.uniform(0.0, 1.0, 8))
    leaves = NO_LEAVES
    foliage = species.foliage
    if foliage and foliage.is_borne(key.season):
        leaf_area_m2 = _LEAF_AREA_INDEX * np.pi / 4 * width_m * width_m
        leaves = foliage_mesh(rng, foliage, second, leaf_area_m2)
    return (
        bend(_cone(foot_m, key.height_m)),
        bend(_raise(tubes(first, _BRANCH_SIDES, every=_EVERY), base_m)),
        bend(_raise(tubes(second, _BRANCH_SIDES, every=_EVERY), base_m)),
        bend(_raise(leaves, base_m)),
    )


def _bend(height_m: float, drawn: F8, mesh: Mesh) -> Mesh:
    """Return a sapling that leans, bows and extends towards the light.

    Its stem keeps its sections and height.
    """
    vertices_m = mesh.vertices_m.astype(np.float64)
    at_m = vertices_m
    if len(vertices_m) == 4 * len(mesh.faces):  # leaves are moved, not stretched
        at_m = np.empty_like(vertices_m)
        at_m[mesh.faces] = vertices_m[mesh.faces].mean(axis=1, keepdims=True)
    x, y, z = at_m.T
    u = np.clip(z / height_m, 0.0, 1.0)
    lean, bow, sway, light = 2 * np.pi * drawn[:4]
    away_m = hypot(x, y)
    lopsided = _LOPSIDED * drawn[4]
    # 0 at the stem, which stays round.
    reach = 1 + lopsided * cos(atan2(y, x) - light) * np.clip(away_m / (0.05 * height_m) - 0.3, 0, 1)
    shift_m = height_m * np.stack(
        [
            share * draw * np.outer([cos(towards), sin(towards)], course)
            for share, draw, towards, course in (
                (_LEAN, drawn[5], lean, u),
                (_BOW, drawn[6], bow, 4 * u * (1 - u)),
                (_SWAY, drawn[7], sway, sin(2 * np.pi * u)),
            )
        ]
    ).sum(axis=0)
    vertices_m[:, 0] += x * (reach - 1) + shift_m[0]
    vertices_m[:, 1] += y * (reach - 1) + shift_m[1]
    return Mesh(vertices_m.astype(np.float32), mesh.faces)


def _raise(mesh: Mesh, by_m: float) -> Mesh:
    return Mesh(mesh.vertices_m + np.array([0.0, 0.0, by_m], np.float32), mesh.faces)


def _cone(foot_m: float, height_m: float) -> Mesh:
    """Make a closed stem whose cross-section at any height has the area of its circle."""
    step = 2 * np.pi / _STEM_SIDES
    z = height_m * np.array([-_BURIED_SHARE, *_CONE])
    corner_m = foot_m * (1 - z / height_m) * np.sqrt(step / sin(step))
    angle = step * np.arange(_STEM_SIDES)
    x_m, y_m, z_m = np.outer(corner_m, cos(angle)), np.outer(corner_m, sin(angle)), z[:, None]
    rings_m = np.stack([x_m, y_m, np.broadcast_to(z_m, x_m.shape)], axis=-1)
    return closed_body(rings_m, np.array([[0, 0, z[0]], [0, 0, height_m]]))


SHRUB_PARTS = (PlantPart.STEM, PlantPart.BRANCH_FIRST_ORDER, PlantPart.LEAF)
"""Parts of the meshes of a shrub, in order. A missing part is a mesh without faces."""
_TWIG_SIDES = 3


@dataclass(frozen=True, slots=True)
class ShrubKey:
    """Key of a shrub's shape; with the seed it determines the shape."""

    species: str
    variant: int
    height_m: float
    width_m: float
    season: Season


def shrub_meshes(
    seed: int, key: ShrubKey, *, table: Mapping[str, Shrub] | None = None
) -> tuple[Mesh, Mesh, Mesh]:
    """Meshes of `SHRUB_PARTS`, origin on the ground and z up.

    They have the leaf area index of their kind on the covered ground.
    """
    shrub = (table or flora().shrubs)[key.species]
    size = round(key.height_m * 1e3), round(key.width_m * 1e3)
    rng = generator(seed, Growth.SHRUB, shrub.number, key.variant, *size)
    stems = ground_stems(rng, shrub, key.height_m, key.width_m)
    twigs = side_branches(rng, shrub.twigs, stems, 2)
    leaves = NO_LEAVES
    if shrub.foliage.is_borne(key.season):
        leaf_area_m2 = shrub.leaf_area_index * (np.pi / 4 * key.width_m * key.width_m)
        leaves = foliage_mesh(rng, shrub.foliage, twigs, leaf_area_m2)
    return tubes(stems, _STEM_SIDES), tubes(twigs, _TWIG_SIDES), leaves
