"""What grows under the trees: saplings and shrubs."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import log
from vlp16emu.errors import GeometryError
from vlp16emu.random import Purpose
from vlp16emu.types import PlantPart, Semantic
from vlp16emu.world.ground.trails import Trails
from vlp16emu.world.plants.allometry import BREAST_HEIGHT_M
from vlp16emu.world.plants.crown import VARIANTS
from vlp16emu.world.plants.flora import BARK_SPREAD, LEAF_SPREAD, Flora, bark_material, flora, known
from vlp16emu.world.plants.sapling import (
    CROWN_BASE_SHARE,
    CROWN_WIDTH_SHARE,
    SAPLING_PARTS,
    SLENDERNESS,
    SaplingKey,
)
from vlp16emu.world.plants.shrub import SHRUB_PARTS, ShrubKey
from vlp16emu.world.plants.species import Shrub, Species
from vlp16emu.world.stand.placed import (
    NO_TREES,
    PlacedThings,
    Site,
    between,
    distinct,
    placements,
    surface_rows,
    turned,
)
from vlp16emu.world.stand.points import pattern_of
from vlp16emu.world.stand.settings import Regeneration, Season, Shrubs
from vlp16emu.world.stand.stand import REGENERATION, TREE, class_scale
from vlp16emu.world.vectors import places_m

Array = NDArray[np.float64]

_CLASS_RATIO = 1.4
"""Between the heights of neighbouring prototypes: none is scaled by more than a fifth."""

_ROOM_SHARE, _MOST_ROOM_M = 0.15, 0.5
"""Of a sapling's height, and at most, from its bark to that of a tree: assumption; none grows up through the foot of another."""

_FOOT_SHARE = 0.1
"""Of a shrub's width, the radius within which its stems leave the ground."""


class SaplingLayer:
    """Young trees.

    Parameters
    ----------
    section : what the user wrote
    seed : of the scenario
    season : whether broadleaves bear leaves
    canopy : names of the trees above; where the section names no species, those of them that live
    plants : trees and shrubs; those of the program if none are given

    Raises
    ------
    GeometryError
        for a species that is not in the table, and for none
    """

    is_ground = False

    def __init__(
        self,
        section: Regeneration,
        *,
        seed: int,
        season: Season,
        canopy: Sequence[str] = (),
        plants: Flora | None = None,
        trails: Trails | None = None,
    ) -> None:
        self._section, self._season = section, season
        self._plants = plants or flora()
        trees = self._plants.trees
        living = section.species or [name for name in canopy if trees[name].foliage]
        if section.stems_per_ha and not living:
            raise GeometryError(
                "regeneration.species", "found none, and only dead trees above", "names of species"
            )
        self._species = known(living, trees, "regeneration.species")
        self.pattern = pattern_of(
            section.pattern,
            seed=seed,
            purpose=Purpose.REGENERATION,
            per_ha=section.stems_per_ha,
            trails=trails,
        )

    def place(self, site: Site) -> PlacedThings:
        """Saplings of a tile."""
        xy_m, rng = self.pattern.points(site.ix, site.iy), site.draw(Purpose.REGENERATION)
        draws = rng.random((len(xy_m), 6))
        height_m = between(self._section.height_m, draws[:, 0])
        foot_m = height_m / SLENDERNESS / 2
        room_m = np.minimum(_ROOM_SHARE * height_m, _MOST_ROOM_M)
        keep = site.clear(xy_m, CROWN_WIDTH_SHARE * height_m / 2, foot_m + room_m)
        kind = (len(self._species) * draws[:, 1]).astype(int)
        trees = np.zeros(len(xy_m), TREE)
        trees["storey"] = trees["cohort"] = REGENERATION
        trees["x_m"], trees["y_m"] = xy_m.T
        trees["z_m"] = site.height_m(*xy_m.T)
        trees["height_m"] = height_m
        trees["dbh_m"] = np.maximum(height_m - BREAST_HEIGHT_M, 0.0) / SLENDERNESS
        trees["crown_base_m"], trees["crown_width_m"] = (
            CROWN_BASE_SHARE * height_m,
            CROWN_WIDTH_SHARE * height_m,
        )
        trees["crown_azimuth_deg"] = 360 * draws[:, 2]
        trees["crown_class"], trees["crown_variant"] = _height_class(height_m), VARIANTS * draws[:, 3]
        trees["species"] = [self._species[i].number for i in kind]
        bark, leaf = _brightness(self._species, kind, draws[:, 4:])
        trees["bark_reflectance"], trees["leaf_reflectance"] = bark, leaf
        names = [self._species[i].name for i in kind[keep]]
        return self._placed(trees[keep], names)

    def _placed(self, trees: NDArray[np.void], names: Sequence[str]) -> PlacedThings:
        """Choose a prototype for each sapling."""
        sizes = trees[["crown_class", "crown_variant"]].tolist()
        prototype_m = [_class_height_m(size) for size, _ in sizes]
        keys, shape = distinct(
            [
                SaplingKey(name, variant, height_m, self._season)
                for name, (_, variant), height_m in zip(names, sizes, prototype_m, strict=True)
            ]
        )
        return PlacedThings(
            keys,
            shape,
            _scaled(trees, np.array(prototype_m)),
            _plant_rows(Semantic.TREE, SAPLING_PARTS, trees, self._plants),
            trees,
        )


class ShrubLayer:
    """Bushes of several stems; the arguments are those of `SaplingLayer`."""

    is_ground = False

    def __init__(
        self,
        section: Shrubs,
        *,
        seed: int,
        season: Season,
        plants: Flora | None = None,
        trails: Trails | None = None,
    ) -> None:
        self._season, self._plants = season, plants or flora()
        self._species = known(section.species, self._plants.shrubs, "shrubs.species")
        self.pattern = pattern_of(
            section.pattern, seed=seed, purpose=Purpose.SHRUBS, per_ha=section.per_ha, trails=trails
        )

    def place(self, site: Site) -> PlacedThings:
        """Shrubs of a tile."""
        xy_m, rng = self.pattern.points(site.ix, site.iy), site.draw(Purpose.SHRUBS)
        draws = rng.random((len(xy_m), 6))
        kind = (len(self._species) * draws[:, 1]).astype(int)
        limits_m = np.array([self._species[i].height_m for i in kind]).reshape(-1, 2)
        shrubs = np.zeros(len(xy_m), TREE)  # the fields of a tree that a shrub has too
        shrubs["height_m"] = limits_m[:, 0] + (limits_m[:, 1] - limits_m[:, 0]) * draws[:, 0]
        shrubs["crown_width_m"] = shrubs["height_m"] * [self._species[i].width_share for i in kind]
        shrubs["x_m"], shrubs["y_m"] = xy_m.T
        shrubs["z_m"] = site.height_m(*xy_m.T)
        shrubs["crown_azimuth_deg"] = 360 * draws[:, 2]
        shrubs["species"] = [self._species[i].number for i in kind]
        bark, leaf = _brightness(self._species, kind, draws[:, 4:])
        shrubs["bark_reflectance"], shrubs["leaf_reflectance"] = bark, leaf
        width_m = shrubs["crown_width_m"]
        keep = site.clear(xy_m, width_m / 2, _FOOT_SHARE * width_m)
        variant = (VARIANTS * draws[keep, 3]).astype(int)
        return self._placed(shrubs[keep], kind[keep], variant)

    def _placed(
        self, shrubs: NDArray[np.void], kind: NDArray[np.int64], variant: NDArray[np.int64]
    ) -> PlacedThings:
        prototype_m = [_class_height_m(size) for size in _height_class(shrubs["height_m"]).tolist()]
        species = [self._species[i] for i in kind]
        keys, shape = distinct(
            [
                ShrubKey(s.name, v, height_m, s.width_share * height_m, self._season)
                for s, v, height_m in zip(species, variant.tolist(), prototype_m, strict=True)
            ]
        )
        world_T = _scaled(shrubs, np.array(prototype_m))
        return PlacedThings(
            keys, shape, world_T, _plant_rows(Semantic.SHRUB, SHRUB_PARTS, shrubs, self._plants), NO_TREES
        )


def _height_class(height_m: Array) -> NDArray[np.int64]:
    return np.round(log(height_m) / log(_CLASS_RATIO)).astype(np.int64)


def _class_height_m(number: int) -> float:
    return class_scale(_CLASS_RATIO, number)


def _brightness(
    species: Sequence[Species] | Sequence[Shrub], kind: NDArray[np.int64], draws: Array
) -> tuple[Array, Array]:
    """Reflectance of bark and leaf of each plant, from draws (n, 2)."""
    middle = np.array([(plant.bark_reflectance, plant.leaf_reflectance) for plant in species])[kind]
    spread = (2 * draws - 1) * (BARK_SPREAD, LEAF_SPREAD)
    bark, leaf = (middle + spread).reshape(-1, 2).T
    return bark, leaf


def _scaled(plants: NDArray[np.void], prototype_m: Array) -> Array:
    """`world_T_shape` of plants whose prototypes have the given heights (n,)."""
    size = np.repeat((plants["height_m"] / prototype_m)[:, None], 3, axis=1)
    place_m = places_m(plants)
    return placements(place_m, turned(plants["crown_azimuth_deg"]), size)


def _plant_rows(
    semantic: Semantic, parts: Sequence[PlantPart], plants: NDArray[np.void], table: Flora
) -> NDArray[np.void]:
    leaf = np.array(parts) == PlantPart.LEAF
    bright = np.where(leaf, plants["leaf_reflectance"][:, None], plants["bark_reflectance"][:, None])
    material = bark_material(plants["species"], table)[:, None] + leaf
    return surface_rows(
        parts=parts, semantic=semantic, material=material, reflectance=bright, species=plants["species"]
    )
