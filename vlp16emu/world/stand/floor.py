"""What is on the ground: stones, and all that covers it; and the labels of all that lies there."""

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import atan2, exp, hypot, log1p, matmul
from vlp16emu.random import Purpose
from vlp16emu.types import HeightField, PlantPart, Semantic
from vlp16emu.world.plants.flora import GROUND_MATERIALS
from vlp16emu.world.quantiles import normal_quantile
from vlp16emu.world.stand.floor_shapes import FLOOR_VARIANTS, GROUND_KINDS, FloorKey, FloorKind
from vlp16emu.world.stand.placed import (
    NO_TREES,
    PlacedThings,
    Site,
    between,
    distinct,
    laid,
    placements,
    surface_rows,
    turned,
)
from vlp16emu.world.stand.points import PatchyPattern, PointPattern, ScatteredPattern
from vlp16emu.world.stand.settings import Cover, Grass, Stones

Array = NDArray[np.float64]

_REFLECTANCE = {
    "stone": 0.30,
    "dead wood": 0.40,
    "litter": 0.30,
    "moss": 0.35,
    **dict.fromkeys(("grass", "herb", "fern", "dwarf shrub"), 0.45),
}
"""At 903 nm: rock, weathered wood like oak bark, dry leaves like the ground, green ones like those of shrubs; assumptions."""

_REFLECTANCE_SPREAD = 0.08
"""Half-range between things, as between the barks of trees; assumption."""

_STONE_M = (0.1, 1.5)
"""Least and greatest length of a stone; assumption."""

_STONE_MEDIAN_M, _STONE_SIGMA = 0.22, 0.6
"""Of the log-normal distribution of lengths, before it is cut at both ends; assumptions."""

_STONE_SHARES = (0.0944070172326103, 0.999311242465033)
"""Of the uncut distribution, the shares below the least and the greatest length."""

_STONE_BURIED = (0.3, 0.6)
"""Range of the share of a stone's height that is in the ground; assumption."""

_MOST_IN_PATCHES_PER_M2 = 4.0
"""On average; of smaller plants in patches a tile might have more than it has numbers for."""

_STONE_WIDTH, _STONE_HEIGHT = 0.8, 0.6
"""Over its length; assumptions."""

_LARGE_STONE_M = 0.4
"""Stones that long have four times the faces; those of shorter ones are off by less than 3 mm."""


def stones_per_ha(cover: float) -> float:
    """Stones per hectare that cover a share of the ground, seen from above.

    Overlaps counted once, scattered discs of mean area a and density d leave exp(-a d) of the plane bare
    (Boolean model; Chiu et al., Stochastic Geometry, section 3.1). What is seen of a stone is its section
    at the ground, or its outline where its widest part is above.
    """
    return -log1p(-cover) / _stone_area_m2() * 10_000


@cache
def _stone_area_m2() -> float:
    """Mean area of a stone as it is seen from above."""
    low, high = _STONE_BURIED
    buried = low + (high - low) * (np.arange(1000) + 0.5) / 1000
    seen = 1 - np.square(np.clip(2 * buried - 1, 0, None))  # section of an ellipsoid at a relative height
    length_m = _stone_length_m((np.arange(20_000) + 0.5) / 20_000)
    return math.pi / 4 * _STONE_WIDTH * float(np.mean(np.square(length_m)) * np.mean(seen))


def _stone_length_m(probability: Array) -> Array:
    """Quantiles of the log-normal distribution cut at `_STONE_M`."""
    low, high = _STONE_SHARES
    return _STONE_MEDIAN_M * exp(_STONE_SIGMA * normal_quantile(low + (high - low) * probability))


class StoneLayer:
    """Stones that lie half in the ground."""

    is_ground = False

    def __init__(self, section: Stones, *, seed: int) -> None:
        per_ha = stones_per_ha(section.cover)
        self.pattern = ScatteredPattern(seed=seed, purpose=Purpose.STONES, per_ha=per_ha)

    def place(self, site: Site) -> PlacedThings:
        """Stones of a tile."""
        xy_m, rng = self.pattern.points(site.ix, site.iy), site.draw(Purpose.STONES)
        draws = rng.random((len(xy_m), 7))
        length_m = _stone_length_m(draws[:, 0])
        size = length_m[:, None] * [1.0, _STONE_WIDTH, _STONE_HEIGHT]
        buried = between(_STONE_BURIED, draws[:, 1])
        keep = site.clear(xy_m, length_m / 2, length_m / 2)
        z_m = site.height_m(*xy_m.T) + (0.5 - buried) * size[:, 2]
        place_m = np.column_stack([xy_m, z_m])
        world_T = placements(place_m, turned(360 * draws[:, 2]), size)
        large = length_m >= _LARGE_STONE_M
        return labelled(FloorKind.STONE, keep, world_T, draws[:, 3:], np.zeros(len(xy_m)), large)


class LowLayer:
    """What is lower than a person and covers the ground beside the path; moss and litter also on it.

    Parameters
    ----------
    kind : tufts, herbs, ferns, dwarf shrubs, moss or litter
    section : what the user wrote
    seed : of the scenario
    """

    def __init__(self, kind: FloorKind, section: Grass | Cover, *, seed: int) -> None:
        self._kind, self._height_m = kind, section.height_m
        self._spread, self._reach_m, self._purpose = _LOW[kind]
        self.is_ground = kind in GROUND_KINDS
        self.pattern = self._pattern_of(section, seed)

    def _pattern_of(self, section: Grass | Cover, seed: int) -> PointPattern:
        """Scatter tufts, litter and moss; herbs, ferns and dwarf shrubs come in patches."""
        even, patchy = 0.0, 0.0
        if isinstance(section, Grass):
            even = 10_000 * section.tufts_per_m2
        else:
            even, patchy = plants_per_ha(section, self._spread, patches=not self.is_ground)
        if patchy:
            return PatchyPattern(seed=seed, purpose=self._purpose, even_per_ha=even, patchy_per_ha=patchy)
        return ScatteredPattern(seed=seed, purpose=self._purpose, per_ha=even)

    def place(self, site: Site) -> PlacedThings:
        """Plants of a tile; those that are ground lie on its slope."""
        near = site.distance_m < self._reach_m
        xy_m = self.pattern.points(site.ix, site.iy) if near else np.zeros((0, 2))
        draws = site.draw(self._purpose).random((len(xy_m), 6))
        height_m = between(self._height_m, draws[:, 0])
        keep = site.path.distance_m(xy_m) < self._reach_m
        world_R_thing = turned(360 * draws[:, 1])
        if self.is_ground:
            world_R_thing = matmul(_along(site.height_m, xy_m), world_R_thing)
        else:
            keep[keep] = site.clear(xy_m[keep], self._spread * height_m[keep] / 2, np.zeros(keep.sum()))
        place_m = np.column_stack([xy_m, site.height_m(*xy_m.T)])
        size = height_m[:, None] * [self._spread, self._spread, 1.0]
        world_T = placements(place_m, world_R_thing, size)
        return labelled(self._kind, keep, world_T, draws[:, 2:], np.zeros(len(xy_m)))


def plants_per_ha(section: Cover, spread: float, *, patches: bool) -> tuple[float, float]:
    """Plants per hectare whose outlines cover a share c of the ground, overlaps counted once as of stones: even ones, those in patches.

    Discs of area a in patches of mean density d leave (1 + 2 a d)^(-1/2) of the plane bare: the mean of exp(-a d n^2) over normal
    noise n. That this is 1 / (1 + c (1 - c)) is an assumption: most plants are in patches where cover is low, and few where it is
    closed. Even ones cover the rest.

    Parameters
    ----------
    spread : width over height, which is evenly between least and greatest
    """
    (low, high), cover = section.height_m, section.cover
    area_m2 = math.pi / 4 * spread * spread * (low * low + low * high + high * high) / 3
    in_patches = min(cover * (1 - cover), _MOST_IN_PATCHES_PER_M2 * area_m2) if patches else 0.0
    patchy = in_patches + in_patches * in_patches / 2
    even = -log1p(-cover) - log1p(in_patches)
    return 10_000 * even / area_m2, 10_000 * patchy / area_m2


def _along(height_m: HeightField, xy_m: Array) -> Array:
    """Rotations (n, 3, 3) from level to the slope of the ground at points (n, 2)."""
    x, y = xy_m.T
    east = (height_m(x + _SLOPE_M, y) - height_m(x - _SLOPE_M, y)) / (2 * _SLOPE_M)
    north = (height_m(x, y + _SLOPE_M) - height_m(x, y - _SLOPE_M)) / (2 * _SLOPE_M)
    towards = atan2(north, east)
    return matmul(laid(towards, hypot(east, north)), turned(np.degrees(-towards)))


_LOW = {
    FloorKind.TUFT: (1.0, 25.0, Purpose.GRASS),
    FloorKind.HERB: (2.0, 25.0, Purpose.HERBS),
    FloorKind.FERN: (1.3, 25.0, Purpose.FERNS),
    FloorKind.DWARF_SHRUB: (1.2, 25.0, Purpose.DWARF_SHRUBS),
    FloorKind.MOSS_CUSHION: (8.0, 12.0, Purpose.MOSS),
    FloorKind.LITTER_HEAP: (8.0, 12.0, Purpose.LITTER),
}
"""Width over height, which for a tuft is that of its shape already; how far from the path, in m, as farther off the beam is
wider than such a plant; and what draws them. Widths and reaches are assumptions."""

_SLOPE_M = 0.2
"""Over which the slope under a cushion or heap is taken, either way."""

_LABELS = {
    FloorKind.STONE: (Semantic.STONE, PlantPart.NONE, "stone"),
    FloorKind.LOG: (Semantic.DEADWOOD, PlantPart.STEM, "dead wood"),
    FloorKind.STUMP: (Semantic.DEADWOOD, PlantPart.STEM, "dead wood"),
    FloorKind.TUFT: (Semantic.GRASS, PlantPart.LEAF, "grass"),
    FloorKind.HERB: (Semantic.GRASS, PlantPart.LEAF, "herb"),
    FloorKind.FERN: (Semantic.GRASS, PlantPart.LEAF, "fern"),
    FloorKind.DWARF_SHRUB: (Semantic.GRASS, PlantPart.LEAF, "dwarf shrub"),
    FloorKind.MOSS_CUSHION: (Semantic.GROUND, PlantPart.NONE, "moss"),
    FloorKind.LITTER_HEAP: (Semantic.GROUND, PlantPart.NONE, "litter"),
    FloorKind.BROKEN_LOG: (Semantic.DEADWOOD, PlantPart.STEM, "dead wood"),
    FloorKind.BROKEN_STUMP: (Semantic.DEADWOOD, PlantPart.STEM, "dead wood"),
    FloorKind.ROOT_PLATE: (Semantic.DEADWOOD, PlantPart.ROOT_FLARE, "litter"),
}
"""Semantic class, part and material; that of the ground is litter and soil."""


def labelled(
    kind: FloorKind,
    keep: NDArray[np.bool_],
    world_T: Array,
    draws: Array,
    species: Array,
    large: NDArray[np.bool_] | None = None,
) -> PlacedThings:
    """Label those things that are kept; draws (n, 2 or more) choose variant and brightness."""
    variants = (FLOOR_VARIANTS * draws[keep, 0]).astype(int).tolist()
    larges = [False] * len(variants) if large is None else large[keep].tolist()
    keys, shape = distinct([_key(kind, *how) for how in zip(variants, larges, strict=True)])
    semantic, part, material = _LABELS[kind]
    reflectance = _REFLECTANCE[material] + _REFLECTANCE_SPREAD * (2 * draws[keep, 1:2] - 1)
    number = np.full(reflectance.shape, GROUND_MATERIALS.index(material))
    rows = surface_rows(
        parts=(part,), semantic=semantic, material=number, reflectance=reflectance, species=species[keep]
    )
    return PlacedThings(keys, shape, world_T[keep], rows, NO_TREES, is_ground=kind in GROUND_KINDS)


@cache
def _key(kind: FloorKind, variant: int, large: bool) -> FloorKey:
    """Keys are few; one object for each."""
    return FloorKey(kind, variant, large)
