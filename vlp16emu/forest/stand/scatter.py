"""What grows and lies under the trees, scattered over the ground: one layer for each section of a scene.

Places come from a point pattern, sizes and looks from random numbers of the tile; what is in the way of the path or of a
trunk is left out.
"""

import math
from collections.abc import Sequence
from functools import cache, partial

import numpy as np

from vlp16emu.elementary import atan2, exp, hypot, log1p, matmul
from vlp16emu.errors import GeometryError
from vlp16emu.forest.ground.trails import Trails
from vlp16emu.forest.plants.flora import Flora, flora, known
from vlp16emu.forest.plants.settings import Season
from vlp16emu.forest.plants.species import Shrub, Species
from vlp16emu.forest.purpose import Growth
from vlp16emu.forest.quantiles import normal_quantile
from vlp16emu.forest.stand.deadwood import lay_logs, lay_stumps
from vlp16emu.forest.stand.floor_shapes import FloorKind, labelled
from vlp16emu.forest.stand.layer import Layer, LayerKind
from vlp16emu.forest.stand.placed import PlacedThings, Site, between, laid, placements, turned
from vlp16emu.forest.stand.points import PatchyPattern, PointPattern, ScatteredPattern, pattern_of
from vlp16emu.forest.stand.settings import (
    Cover,
    DwarfShrubs,
    Ferns,
    Grass,
    Herbs,
    Litter,
    Logs,
    Moss,
    Regeneration,
    Shrubs,
    Stones,
    Stumps,
    Woods,
)
from vlp16emu.forest.stand.understorey import lay_saplings, lay_shrubs
from vlp16emu.settings import Section
from vlp16emu.types import Array, HeightField

_STONE_M = (0.1, 1.5)  # least and greatest length of a stone; assumption

_STONE_MEDIAN_M, _STONE_SIGMA = 0.22, 0.6
"""Of the log-normal distribution of lengths, before it is cut at both ends; assumptions."""

_STONE_SHARES = (0.0944070172326103, 0.999311242465033)
"""Of the uncut distribution, the shares below the least and the greatest length."""

_STONE_BURIED = (0.3, 0.6)  # range of the share of a stone's height that is in the ground; assumption
_STONE_WIDTH, _STONE_HEIGHT = 0.8, 0.6  # over its length; assumptions
_LARGE_STONE_M = 0.4  # stones that long have four times the faces; those of shorter ones are off by less than 3 mm
_MOST_IN_PATCHES_PER_M2 = 4.0  # on average; of smaller plants in patches a tile might have more than it has numbers for
_SLOPE_M = 0.2  # over which the slope under a cushion or heap is taken, either way


def layer_of(
    section: Section,
    *,
    seed: int,
    season: Season = "leaf_on",
    canopy: Sequence[str] = (),
    plants: Flora | None = None,
    trails: Trails | None = None,
) -> Layer:
    """Scatter the things of one section, off the trails.

    A section that names no species has those of the canopy, saplings those of them that live. Plants are those of the program if
    none are given. Raises GeometryError for a species that is not in the table, and for saplings of none.
    """
    kind, plants = _KINDS[type(section)], plants or flora()
    species = _species(section, kind.name, canopy, plants)
    return Layer(section, kind, species, season, plants, _pattern(section, kind, seed, trails))


def layers_of(
    section: Woods, seed: int, canopy: Sequence[str], plants: Flora, trails: Trails | None = None
) -> list[Layer]:
    """All that grows and lies under the trees, in the order of its numbers."""
    scattered = partial(layer_of, seed=seed, season=section.season, canopy=canopy, plants=plants, trails=trails)
    return [scattered(getattr(section, kind.name)) for kind in _KINDS.values()]


def stones_per_ha(cover: float) -> float:
    """Stones per hectare that cover a share of the ground, seen from above.

    Overlaps counted once, scattered discs of mean area a and density d leave exp(-a d) of the plane bare
    (Boolean model; Chiu et al., Stochastic Geometry, section 3.1). What is seen of a stone is its section
    at the ground, or its outline where its widest part is above.
    """
    return -log1p(-cover) / _stone_area_m2() * 10_000


def plants_per_ha(section: Cover, spread: float, *, patches: bool) -> tuple[float, float]:
    """Plants per hectare whose outlines cover a share c of the ground, overlaps counted once as of stones: even ones, those in patches.

    Discs of area a in patches of mean density d leave (1 + 2 a d)^(-1/2) of the plane bare: the mean of exp(-a d n^2) over normal
    noise n. That this is 1 / (1 + c (1 - c)) is an assumption: most plants are in patches where cover is low, and few where it is
    closed. Even ones cover the rest. Heights are evenly between least and greatest, `spread` is width over height.
    """
    (low, high), cover = section.height_m, section.cover
    area_m2 = math.pi / 4 * spread * spread * (low * low + low * high + high * high) / 3
    in_patches = min(cover * (1 - cover), _MOST_IN_PATCHES_PER_M2 * area_m2) if patches else 0.0
    patchy = in_patches + in_patches * in_patches / 2
    even = -log1p(-cover) - log1p(in_patches)
    return 10_000 * even / area_m2, 10_000 * patchy / area_m2


def _species(section: Section, name: str, canopy: Sequence[str], plants: Flora) -> Sequence[Species] | Sequence[Shrub]:
    match section:
        case Regeneration():
            names = section.species or [one for one in canopy if plants.trees[one].foliage]
            if section.stems_per_ha and not names:
                found = "found none, and only dead trees above"
                raise GeometryError("regeneration.species", found, "names of species")
            return known(names, plants.trees, "regeneration.species")
        case Shrubs():
            return known(section.species, plants.shrubs, "shrubs.species")
        case Logs() | Stumps():
            return known(section.species or canopy, plants.trees, f"{name}.species")
    return []


def _pattern(section: Section, kind: LayerKind, seed: int, trails: Trails | None) -> PointPattern:
    """Make the places of things: herbs, ferns and dwarf shrubs come in patches, stones, wood, tufts, moss and litter anywhere."""
    match section:
        case Regeneration(stems_per_ha=per_ha, pattern=pattern) | Shrubs(per_ha=per_ha, pattern=pattern):
            return pattern_of(pattern, seed=seed, purpose=kind.purpose, per_ha=per_ha, trails=trails)
        case Cover():
            even, patchy = plants_per_ha(section, kind.spread, patches=not kind.is_ground)
            if patchy:
                return PatchyPattern(seed=seed, purpose=kind.purpose, even_per_ha=even, patchy_per_ha=patchy)
        case Grass():
            even = 10_000 * section.tufts_per_m2
        case Stones():
            even = stones_per_ha(section.cover)
        case Logs() | Stumps():
            even = section.per_ha
    return ScatteredPattern(seed=seed, purpose=kind.purpose, per_ha=even)


@cache
def _stone_area_m2() -> float:
    low, high = _STONE_BURIED
    buried = low + (high - low) * (np.arange(1000) + 0.5) / 1000
    seen = 1 - np.square(np.clip(2 * buried - 1, 0, None))  # section of an ellipsoid at a relative height
    length_m = _stone_length_m((np.arange(20_000) + 0.5) / 20_000)
    return math.pi / 4 * _STONE_WIDTH * float(np.mean(np.square(length_m)) * np.mean(seen))


def _stone_length_m(probability: Array) -> Array:
    """Quantiles of the log-normal distribution cut at `_STONE_M`."""
    low, high = _STONE_SHARES
    return _STONE_MEDIAN_M * exp(_STONE_SIGMA * normal_quantile(low + (high - low) * probability))


def _lay_stones(_layer: Layer, site: Site, xy_m: Array, draws: Array) -> PlacedThings:
    length_m = _stone_length_m(draws[:, 0])
    size = length_m[:, None] * [1.0, _STONE_WIDTH, _STONE_HEIGHT]
    keep = site.clear(xy_m, length_m / 2, length_m / 2)
    z_m = site.height_m(*xy_m.T) + (0.5 - between(_STONE_BURIED, draws[:, 1])) * size[:, 2]
    world_T = placements(np.column_stack([xy_m, z_m]), turned(360 * draws[:, 2]), size)
    return labelled(FloorKind.STONE, keep, world_T, draws[:, 3:], large=length_m >= _LARGE_STONE_M)


def _lay_low(layer: Layer, site: Site, xy_m: Array, draws: Array) -> PlacedThings:
    """Lay out what is lower than a person and covers the ground beside the path; what is ground lies on it too, along its slope."""
    height_m, kind = between(layer.section.height_m, draws[:, 0]), layer.kind
    keep = site.path.distance_m(xy_m) < kind.reach_m
    world_R_thing = turned(360 * draws[:, 1])
    if kind.is_ground:
        world_R_thing = matmul(_along(site.height_m, xy_m), world_R_thing)
    else:
        keep[keep] = site.clear(xy_m[keep], kind.spread * height_m[keep] / 2, np.zeros(keep.sum()))
    place_m = np.column_stack([xy_m, site.height_m(*xy_m.T)])
    size = height_m[:, None] * [kind.spread, kind.spread, 1.0]
    assert kind.shape is not None
    return labelled(kind.shape, keep, placements(place_m, world_R_thing, size), draws[:, 2:])


def _along(height_m: HeightField, xy_m: Array) -> Array:
    """Rotations (n, 3, 3) from level to the slope of the ground at points (n, 2)."""
    x, y = xy_m.T
    east = (height_m(x + _SLOPE_M, y) - height_m(x - _SLOPE_M, y)) / (2 * _SLOPE_M)
    north = (height_m(x, y + _SLOPE_M) - height_m(x, y - _SLOPE_M)) / (2 * _SLOPE_M)
    towards = atan2(north, east)
    return matmul(laid(towards, hypot(east, north)), turned(np.degrees(-towards)))


_KINDS: dict[type[Section], LayerKind] = {
    Regeneration: LayerKind("regeneration", Growth.REGENERATION, (6,), lay_saplings),
    Shrubs: LayerKind("shrubs", Growth.SHRUBS, (6,), lay_shrubs),
    Stones: LayerKind("stones", Growth.STONES, (7,), _lay_stones),
    Logs: LayerKind("logs", Growth.LOGS, (8, 7), lay_logs),
    Stumps: LayerKind("stumps", Growth.STUMPS, (8,), lay_stumps),
    Grass: LayerKind("grass", Growth.GRASS, (6,), _lay_low, FloorKind.TUFT, 1.0, 25.0),
    Herbs: LayerKind("herbs", Growth.HERBS, (6,), _lay_low, FloorKind.HERB, 2.0, 25.0),
    Ferns: LayerKind("ferns", Growth.FERNS, (6,), _lay_low, FloorKind.FERN, 1.3, 25.0),
    DwarfShrubs: LayerKind("dwarf_shrubs", Growth.DWARF_SHRUBS, (6,), _lay_low, FloorKind.DWARF_SHRUB, 1.2, 25.0),
    Moss: LayerKind("moss", Growth.MOSS, (6,), _lay_low, FloorKind.MOSS_CUSHION, 8.0, 12.0),
    Litter: LayerKind("litter", Growth.LITTER, (6,), _lay_low, FloorKind.LITTER_HEAP, 8.0, 12.0),
}
"""By section, in the order of their numbers."""
