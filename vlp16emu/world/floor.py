"""What lies and stands on the ground: stones, logs, stumps and tufts of grass."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from vlp16emu.random import Purpose
from vlp16emu.store import recalled
from vlp16emu.types import PlantPart, Semantic
from vlp16emu.world.floor_shapes import FLOOR_VARIANTS, FloorKey, FloorKind
from vlp16emu.world.materials import GROUND_MATERIALS
from vlp16emu.world.placed import (
    NO_TREES,
    Placed,
    Plot,
    distinct,
    laid,
    placements,
    surface_rows,
    turned,
)
from vlp16emu.world.points import Pattern
from vlp16emu.world.species import Flora, flora, known

__all__ = ["Grass", "Logs", "Stones", "Stumps", "stones_per_ha"]

Array = NDArray[np.float64]

_REFLECTANCE = {"stone": 0.30, "dead wood": 0.40, "grass": 0.45}
"""At 903 nm: rock, weathered wood like oak bark, blades like shrub leaves; assumptions."""

_REFLECTANCE_SPREAD = 0.08
"""Half-range between things, as between the barks of trees; assumption."""

_STONE_M = (0.1, 1.5)
"""Least and greatest length of a stone; assumption."""

_STONE_MEDIAN_M, _STONE_SIGMA = 0.22, 0.6
"""Of the log-normal distribution of lengths, before it is cut at both ends; assumptions."""

_STONE_BURIED = (0.3, 0.6)
"""Range of the share of a stone's height that is in the ground; assumption."""

_STONE_WIDTH, _STONE_HEIGHT = 0.8, 0.6
"""Over its length; assumptions."""

_LARGE_STONE_M = 0.4
"""Stones that long have four times the faces; those of shorter ones are off by less than 3 mm."""

_GRASS_REACH_M = 25.0
"""From the path; farther off the beam is wider than a tuft, and litter stands for grass."""

_LOG_STATIONS = np.linspace(-0.5, 0.5, 9)
"""Along a log, where the ground under it and the way to the path are looked at."""

_LOG_SUNK = 0.25
"""Share of its radius that a log has sunk into the ground; assumption."""


def stones_per_ha(cover: float) -> float:
    """Stones per hectare that cover a share of the ground, seen from above.

    Overlaps counted once, scattered discs of mean area a and density d leave exp(-a d) of the plane bare
    (Boolean model; Chiu et al., Stochastic Geometry, section 3.1). What is seen of a stone is its section
    at the ground, or its outline where its widest part is above.
    """
    # Kept for the import of scipy's functions, which takes 0.1 s of a start.
    area_m2 = recalled(
        "area of a stone", _stone_area_m2, lambda area: {"m2": np.array(area)}, lambda kept: float(kept["m2"])
    )
    return -math.log1p(-cover) / area_m2 * 10_000


def _stone_area_m2() -> float:
    """Mean area of a stone as it is seen from above."""
    low, high = _STONE_BURIED
    buried = low + (high - low) * (np.arange(1000) + 0.5) / 1000
    seen = 1 - np.clip(2 * buried - 1, 0, None) ** 2  # section of an ellipsoid at a relative height
    length_m = _stone_length_m((np.arange(20_000) + 0.5) / 20_000)
    return math.pi / 4 * _STONE_WIDTH * float(np.mean(length_m**2) * np.mean(seen))


def _stone_length_m(probability: Array) -> Array:
    """Quantiles of the log-normal distribution cut at `_STONE_M`."""
    from scipy import special  # here: a hall has no stones, and does without scipy

    low, high = (special.ndtr(math.log(size / _STONE_MEDIAN_M) / _STONE_SIGMA) for size in _STONE_M)
    normal = special.ndtri(low + (high - low) * probability)
    length: Array = _STONE_MEDIAN_M * np.exp(_STONE_SIGMA * normal)
    return length


@dataclass(frozen=True, slots=True)
class Stones:
    """Stones that lie half in the ground."""

    pattern: Pattern

    @property
    def per_ha(self) -> float:
        """Mean number of stones per hectare."""
        return self.pattern.per_ha

    def place(self, plot: Plot) -> Placed:
        """Stones of a tile."""
        xy_m, rng = self.pattern.points(plot.ix, plot.iy), plot.draw(Purpose.STONES)
        draws = rng.random((len(xy_m), 7))
        length_m = _stone_length_m(draws[:, 0])
        size = length_m[:, None] * [1.0, _STONE_WIDTH, _STONE_HEIGHT]
        buried = _between(_STONE_BURIED, draws[:, 1])
        keep = plot.clear(xy_m, length_m / 2, length_m / 2)
        z_m = plot.height_m(*xy_m.T) + (0.5 - buried) * size[:, 2]
        place_m = np.column_stack([xy_m, z_m])
        world_T = placements(place_m, turned(360 * draws[:, 2]), size)
        large = length_m >= _LARGE_STONE_M
        return _placed(FloorKind.STONE, keep, world_T, draws[:, 3:], np.zeros(len(xy_m)), large)


@dataclass(frozen=True, slots=True)
class Logs:
    """Lying trunks."""

    pattern: Pattern
    species: Sequence[str]
    """What trees they were, each as often."""
    diameter_m: tuple[float, float]
    """Least and greatest mean diameter."""
    length_m: tuple[float, float]
    """Least and greatest length."""

    plants: Flora | None = None

    def __post_init__(self) -> None:
        known(self.species, (self.plants or flora()).trees, "logs.species")

    @property
    def per_ha(self) -> float:
        """Mean number of logs per hectare."""
        return self.pattern.per_ha

    def place(self, plot: Plot) -> Placed:
        """Lay logs, whose middle is on a tile, along the ground under them."""
        xy_m, rng = self.pattern.points(plot.ix, plot.iy), plot.draw(Purpose.LOGS)
        draws = rng.random((len(xy_m), 8))
        diameter_m, length_m = _between(self.diameter_m, draws[:, 0]), _between(self.length_m, draws[:, 1])
        towards = 2 * np.pi * draws[:, 2]
        station_m = length_m[:, None] * _LOG_STATIONS
        x_m = xy_m[:, :1] + station_m * np.cos(towards)[:, None]
        y_m = xy_m[:, 1:] + station_m * np.sin(towards)[:, None]
        radius_m = np.repeat(diameter_m / 2, len(_LOG_STATIONS))
        along_xy = np.column_stack([x_m.ravel(), y_m.ravel()])
        keep = np.asarray(plot.clear(along_xy, radius_m, radius_m).reshape(x_m.shape).all(axis=-1))
        ground_m = plot.height_m(x_m, y_m)
        # Straight line of least squares through the ground at evenly spaced stations.
        slope = (ground_m * station_m).sum(axis=1) / (station_m**2).sum(axis=1)
        z_m = ground_m.mean(axis=1) + (1 - _LOG_SUNK) * diameter_m / 2
        size = np.column_stack([length_m, diameter_m, diameter_m])
        world_T = placements(np.column_stack([xy_m, z_m]), laid(towards, slope), size)
        species = _species_numbers(self.species, self.plants, draws[:, 3])
        return _placed(FloorKind.LOG, keep, world_T, draws[:, 4:], species)


@dataclass(frozen=True, slots=True)
class Stumps:
    """What felled trees left."""

    pattern: Pattern
    species: Sequence[str]
    """What trees they were, each as often."""
    diameter_m: tuple[float, float]
    """Least and greatest diameter at the top."""
    height_m: tuple[float, float]
    """Least and greatest height."""

    plants: Flora | None = None

    def __post_init__(self) -> None:
        known(self.species, (self.plants or flora()).trees, "stumps.species")

    @property
    def per_ha(self) -> float:
        """Mean number of stumps per hectare."""
        return self.pattern.per_ha

    def place(self, plot: Plot) -> Placed:
        """Stumps of a tile."""
        xy_m, rng = self.pattern.points(plot.ix, plot.iy), plot.draw(Purpose.STUMPS)
        draws = rng.random((len(xy_m), 8))
        diameter_m, height_m = _between(self.diameter_m, draws[:, 0]), _between(self.height_m, draws[:, 1])
        keep = plot.clear(xy_m, 0.8 * diameter_m, 0.8 * diameter_m)
        place_m = np.column_stack([xy_m, plot.height_m(*xy_m.T)])
        size = np.column_stack([diameter_m, diameter_m, height_m])
        world_T = placements(place_m, turned(360 * draws[:, 2]), size)
        species = _species_numbers(self.species, self.plants, draws[:, 3])
        return _placed(FloorKind.STUMP, keep, world_T, draws[:, 4:], species)


@dataclass(frozen=True, slots=True)
class Grass:
    """Tufts beside the path."""

    pattern: Pattern
    height_m: tuple[float, float]
    """Least and greatest height."""

    @property
    def per_ha(self) -> float:
        """Mean number of tufts per hectare near the path."""
        return self.pattern.per_ha

    def place(self, plot: Plot) -> Placed:
        """Tufts of a tile."""
        near = plot.distance_m < _GRASS_REACH_M
        xy_m = self.pattern.points(plot.ix, plot.iy) if near else np.zeros((0, 2))
        draws = plot.draw(Purpose.GRASS).random((len(xy_m), 6))
        height_m = _between(self.height_m, draws[:, 0])
        keep = plot.path.distance_m(xy_m) < _GRASS_REACH_M
        keep[keep] = plot.clear(xy_m[keep], height_m[keep] / 2, np.zeros(keep.sum()))
        place_m = np.column_stack([xy_m, plot.height_m(*xy_m.T)])
        world_T = placements(place_m, turned(360 * draws[:, 1]), np.repeat(height_m[:, None], 3, axis=1))
        return _placed(FloorKind.TUFT, keep, world_T, draws[:, 2:], np.zeros(len(xy_m)))


_LABELS = {
    FloorKind.STONE: (Semantic.STONE, PlantPart.NONE, "stone"),
    FloorKind.LOG: (Semantic.DEADWOOD, PlantPart.STEM, "dead wood"),
    FloorKind.STUMP: (Semantic.DEADWOOD, PlantPart.STEM, "dead wood"),
    FloorKind.TUFT: (Semantic.GRASS, PlantPart.LEAF, "grass"),
}
"""Semantic class, part and material."""


def _placed(
    kind: FloorKind,
    keep: NDArray[np.bool_],
    world_T: Array,
    draws: Array,
    species: Array,
    large: NDArray[np.bool_] | None = None,
) -> Placed:
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
    return Placed(keys, shape, world_T[keep], rows, NO_TREES)


@cache
def _key(kind: FloorKind, variant: int, large: bool) -> FloorKey:
    """Keys are few; one object for each."""
    return FloorKey(kind, variant, large)


def _between(limits: tuple[float, float], draw: Array) -> Array:
    """Evenly from limits[0] to limits[1]."""
    value: Array = limits[0] + (limits[1] - limits[0]) * draw
    return value


def _species_numbers(names: Sequence[str], plants: Flora | None, draw: Array) -> Array:
    """Numbers of species, each as often."""
    table = (plants or flora()).trees
    numbers = np.array([table[name].number for name in names])
    chosen: Array = numbers[(len(numbers) * draw).astype(int)]
    return chosen
