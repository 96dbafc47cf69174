"""What grows under the trees: saplings and shrubs, as prototypes of a species and height class, scaled to their size."""

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import log
from vlp16emu.forest.plants.allometry import BREAST_HEIGHT_M
from vlp16emu.forest.plants.crown import VARIANTS
from vlp16emu.forest.plants.flora import BARK_SPREAD, LEAF_SPREAD, Trees
from vlp16emu.forest.plants.sapling import CROWN_BASE_SHARE, CROWN_WIDTH_SHARE, SAPLING_PARTS, SLENDERNESS, SaplingKey
from vlp16emu.forest.plants.shrub import SHRUB_PARTS, ShrubKey
from vlp16emu.forest.stand.layer import Layer
from vlp16emu.forest.stand.placed import (
    NO_TREES,
    PlacedThings,
    Site,
    between,
    distinct,
    placements,
    plant_surfaces,
    turned,
)
from vlp16emu.forest.stand.stand import REGENERATION, TREE, class_scale
from vlp16emu.types import Array, IntArray, Semantic
from vlp16emu.world.vectors import places_m

_CLASS_RATIO = 1.4  # between the heights of neighbouring prototypes: none is scaled by more than a fifth

_ROOM_SHARE, _MOST_ROOM_M = 0.15, 0.5
"""Of a sapling's height, and at most, from its bark to that of a tree: assumption; none grows up through the foot of another."""

_FOOT_SHARE = 0.1  # of a shrub's width, the radius within which its stems leave the ground


def lay_saplings(layer: Layer, site: Site, xy_m: Array, draws: Array) -> PlacedThings:
    """Lay out young trees."""
    height_m = between(layer.section.height_m, draws[:, 0])
    kind = (len(layer.species) * draws[:, 1]).astype(int)
    room_m = np.minimum(_ROOM_SHARE * height_m, _MOST_ROOM_M)
    keep = site.clear(xy_m, CROWN_WIDTH_SHARE * height_m / 2, height_m / SLENDERNESS / 2 + room_m)
    trees = _grown(layer, site, xy_m, kind, height_m, draws)
    trees["storey"] = trees["cohort"] = REGENERATION
    trees["dbh_m"] = np.maximum(height_m - BREAST_HEIGHT_M, 0.0) / SLENDERNESS
    trees["crown_base_m"] = CROWN_BASE_SHARE * height_m
    trees["crown_width_m"] = CROWN_WIDTH_SHARE * height_m
    trees = trees[keep]
    prototype_m, world_T = _scaled(trees)
    keys = [
        SaplingKey(layer.species[i].name, variant, height_m, layer.season)
        for i, variant, height_m in zip(kind[keep], trees["crown_variant"].tolist(), prototype_m, strict=True)
    ]
    return PlacedThings(*distinct(keys), world_T, plant_surfaces(trees, SAPLING_PARTS, layer.plants), trees)


def lay_shrubs(layer: Layer, site: Site, xy_m: Array, draws: Array) -> PlacedThings:
    """Lay out bushes of several stems."""
    kind = (len(layer.species) * draws[:, 1]).astype(int)
    limits_m = np.array([layer.species[i].height_m for i in kind]).reshape(-1, 2)
    height_m = limits_m[:, 0] + (limits_m[:, 1] - limits_m[:, 0]) * draws[:, 0]
    width_m = height_m * [layer.species[i].width_share for i in kind]
    keep = site.clear(xy_m, width_m / 2, _FOOT_SHARE * width_m)
    shrubs = _grown(layer, site, xy_m, kind, height_m, draws)[keep]  # the fields of a tree that a shrub has too
    prototype_m, world_T = _scaled(shrubs)
    keys = [
        ShrubKey(one.name, variant, height_m, one.width_share * height_m, layer.season)
        for i, variant, height_m in zip(kind[keep], shrubs["crown_variant"].tolist(), prototype_m, strict=True)
        for one in [layer.species[i]]
    ]
    rows = plant_surfaces(shrubs, SHRUB_PARTS, layer.plants, Semantic.SHRUB)
    return PlacedThings(*distinct(keys), world_T, rows, NO_TREES)


def _grown(layer: Layer, site: Site, xy_m: Array, kind: IntArray, height_m: Array, draws: Array) -> NDArray[np.void]:
    """Give saplings and shrubs place, height, species, brightness, and class and variant of their prototype."""
    plants = np.zeros(len(xy_m), TREE)
    plants["x_m"], plants["y_m"] = xy_m.T
    plants["z_m"] = site.height_m(*xy_m.T)
    plants["height_m"], plants["crown_azimuth_deg"] = height_m, 360 * draws[:, 2]
    plants["crown_class"] = np.round(log(height_m) / log(_CLASS_RATIO))
    plants["crown_variant"] = VARIANTS * draws[:, 3]
    looks = [(one.number, one.bark_reflectance, one.leaf_reflectance) for one in layer.species]
    number, bark, leaf = np.array(looks)[kind].T
    plants["species"] = number
    plants["bark_reflectance"] = bark + (2 * draws[:, 4] - 1) * BARK_SPREAD
    plants["leaf_reflectance"] = leaf + (2 * draws[:, 5] - 1) * LEAF_SPREAD
    return plants


def _scaled(plants: Trees) -> tuple[list[float], Array]:
    """Heights (n,) of the prototypes of plants, and their `world_T_shape`."""
    prototype_m = [class_scale(_CLASS_RATIO, number) for number in plants["crown_class"].tolist()]
    size = np.repeat((plants["height_m"] / np.array(prototype_m))[:, None], 3, axis=1)
    return prototype_m, placements(places_m(plants), turned(plants["crown_azimuth_deg"]), size)
