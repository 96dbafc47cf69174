"""Plants and things under the trees, scattered over the ground: one layer per section of a scene.

Positions come from a point pattern, sizes and appearance from random numbers of the tile; things in the way
of the path or of a trunk are left out.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import atan2, cos, exp, hypot, log, log1p, matmul, sin
from vlp16emu.errors import GeometryError
from vlp16emu.forest import settings
from vlp16emu.forest.plants.allometry import BREAST_HEIGHT_M
from vlp16emu.forest.plants.prototypes import (
    CROWN_BASE_SHARE,
    CROWN_WIDTH_SHARE,
    SAPLING_PARTS,
    SHRUB_PARTS,
    SLENDERNESS,
    VARIANTS,
    SaplingKey,
    ShrubKey,
)
from vlp16emu.forest.plants.species import BARK_SPREAD, LEAF_SPREAD, find_species
from vlp16emu.forest.purpose import Growth
from vlp16emu.forest.stand.floor_shapes import FloorKind, Row, floor, floor_things, is_ground, shape_row
from vlp16emu.forest.stand.placement import (
    PlacedThings,
    about_vertical,
    along_slope,
    concatenate,
    in_range,
    placements,
    plant_surfaces,
)
from vlp16emu.forest.stand.points import Land, PointPattern, cox_pattern, pattern_of, poisson_pattern
from vlp16emu.forest.stand.stand import REGENERATION, TREE, class_scale
from vlp16emu.forest.tiles import tile_distance_m
from vlp16emu.random import generator
from vlp16emu.settings import Section
from vlp16emu.types import F8, I8, HeightField, Semantic
from vlp16emu.world.vectors import places_m

Generator = np.random.Generator
Mask = NDArray[np.bool_]


class Layer:
    """Plants or things of one section of a scene, off the trails.

    A section without species uses the canopy's species, for saplings the living ones. Raises GeometryError
    for a species that is not in the table, and for saplings without any species.
    """

    def __init__(
        self, section: Section, land: Land, *, season: settings.Season = "leaf_on", canopy: Sequence[str] = ()
    ) -> None:
        self.section: Any = section
        self.name, self._lay = _LAYERS[type(section)]
        self.purpose = Growth[self.name.upper()]
        self.row = floor()["layers"][self.name]
        self.shape = FloorKind(self.row["shape"]) if "shape" in self.row else None  # of ground cover
        self.is_ground = self.shape is not None and is_ground(self.shape)
        self.season = season
        self.land = land
        self.species: Sequence[Any] = []  # species of the plants, living or dead
        plants = land.plants
        match section:
            case settings.Regeneration():
                names = section.species or [name for name in canopy if plants.trees[name].foliage]
                if section.stems_per_ha and not names:
                    found = "found none, and only dead trees above"
                    raise GeometryError("regeneration.species", found, "names of species")
                self.species = find_species(names, plants.trees, "regeneration.species")
            case settings.Shrubs():
                self.species = find_species(section.species, plants.shrubs, "shrubs.species")
            case settings.Logs() | settings.Stumps():
                self.species = find_species(section.species or canopy, plants.trees, f"{self.name}.species")
        self.pattern = self._pattern()  # before things on the path and in trunks are left out

    def place(self, ix: int, iy: int, trunks: F8) -> PlacedThings:
        """Place the things of a tile clear of trunks (m, 3).

        Trunks are x, y and radius at the ground of the stems on it and its neighbours.
        """
        near = tile_distance_m((ix, iy), self.land.path) < self.row.get("reach_m", math.inf)
        xy_m = self.pattern.points(ix, iy) if near else np.zeros((0, 2))
        return self._lay(self, trunks, xy_m, generator(self.land.seed, self.purpose, ix, iy, 1))

    def _pattern(self) -> PointPattern:
        """Make the point pattern: herbs, ferns and dwarf shrubs grow in patches, other things anywhere."""
        where: Any = {"seed": self.land.seed, "purpose": self.purpose}
        match self.section:
            case settings.Regeneration(stems_per_ha=per_ha) | settings.Shrubs(per_ha=per_ha):
                return pattern_of(self.section.pattern, self.land, purpose=self.purpose, per_ha=per_ha)
            case settings.Cover():
                spread = self.row["spread"]
                even, in_patches = plants_per_ha(self.section, spread, patches=not self.is_ground)
                if in_patches:
                    return cox_pattern(**where, even_per_ha=even, patchy_per_ha=in_patches)
            case settings.Grass(tufts_per_m2=per_m2):
                even = 10_000 * per_m2
            case settings.Stones(cover=cover):
                # Overlaps counted once, scattered discs of mean area a and density d leave exp(-a d) of the
                # plane bare (Boolean model; Chiu et al., Stochastic Geometry, section 3.1).
                even = -log1p(-cover) / _stone_area_m2() * 10_000
            case settings.Logs(per_ha=per_ha) | settings.Stumps(per_ha=per_ha):
                even = per_ha
        return poisson_pattern(**where, per_ha=even)

    def are_clear(self, trunks: F8, xy_m: F8, reach_m: F8, foot_m: F8) -> Mask:
        """Return a mask of points (n, 2) that are clear of path and trunks.

        They keep `reach_m` (n,) away from the path, and `foot_m` (n,) from all trunks.
        """
        free = np.asarray(self.land.path.distance_m(xy_m) - reach_m >= self.land.path.clearance_m)
        dx, dy = (xy_m[:, None, axis] - trunks[:, axis] for axis in (0, 1))
        gap_m = foot_m[:, None] + trunks[:, 2]
        blocked = np.asarray((dx * dx + dy * dy < gap_m * gap_m).any(axis=1))
        return np.logical_and(free, ~blocked)


def layers_of(section: settings.Woods, land: Land, canopy: Sequence[str]) -> list[Layer]:
    """Return the layers of all plants and things under the trees, in the order of their numbers."""
    sections = (getattr(section, name) for name, _ in _LAYERS.values())
    layers = [Layer(layer_section, land, season=section.season, canopy=canopy) for layer_section in sections]
    return [layer for layer in layers if layer.pattern.per_ha]


def _lay_plants(layer: Layer, trunks: F8, xy_m: F8, rng: Generator) -> PlacedThings:
    """Place young trees, or bushes of several stems."""
    row = layer.row
    draws = rng.random((len(xy_m), 6))
    kind = (len(layer.species) * draws[:, 1]).astype(int)
    is_shrub = isinstance(layer.section, settings.Shrubs)
    if is_shrub:
        low_m, high_m, wide = np.array([(*plant.height_m, plant.width_share) for plant in layer.species])[
            kind
        ].T
        height_m = low_m + (high_m - low_m) * draws[:, 0]
        width_m = height_m * wide
        foot_m = row["foot"] * width_m
    else:
        height_m = in_range(layer.section.height_m, draws[:, 0])
        width_m = CROWN_WIDTH_SHARE * height_m
        foot_m = height_m / SLENDERNESS / 2 + np.minimum(row["room"] * height_m, row["most_room_m"])
    keep = layer.are_clear(trunks, xy_m, width_m / 2, foot_m)
    xy_m = xy_m[keep]
    height_m = height_m[keep]
    kind = kind[keep]
    draws = draws[keep]
    plants = np.zeros(len(xy_m), TREE)
    plants["x_m"], plants["y_m"] = xy_m.T
    plants["z_m"] = layer.land.height_m(*xy_m.T)
    plants["height_m"] = height_m
    plants["crown_azimuth_deg"] = 360 * draws[:, 2]
    plants["crown_class"] = np.round(log(height_m) / log(row["class_ratio"]))
    plants["crown_variant"] = VARIANTS * draws[:, 3]
    looks = [(plant.number, plant.bark_reflectance, plant.leaf_reflectance) for plant in layer.species]
    plants["species"], bark, leaf = np.array(looks)[kind].T
    plants["bark_reflectance"] = bark + (2 * draws[:, 4] - 1) * BARK_SPREAD
    plants["leaf_reflectance"] = leaf + (2 * draws[:, 5] - 1) * LEAF_SPREAD
    prototype_m = [class_scale(row["class_ratio"], number) for number in plants["crown_class"].tolist()]
    size = np.repeat((height_m / np.array(prototype_m))[:, None], 3, axis=1)
    world_T = placements(places_m(plants), about_vertical(plants["crown_azimuth_deg"]), size)
    prototypes = zip(
        (layer.species[i] for i in kind), plants["crown_variant"].tolist(), prototype_m, strict=True
    )
    if is_shrub:
        shrubs = [
            ShrubKey(plant.name, variant, m, plant.width_share * m, layer.season)
            for plant, variant, m in prototypes
        ]
        return PlacedThings(
            shrubs, world_T, plant_surfaces(plants, SHRUB_PARTS, layer.land.plants, Semantic.SHRUB)
        )
    plants["storey"] = plants["cohort"] = REGENERATION
    plants["dbh_m"] = np.maximum(height_m - BREAST_HEIGHT_M, 0.0) / SLENDERNESS
    plants["crown_base_m"] = CROWN_BASE_SHARE * height_m
    plants["crown_width_m"] = CROWN_WIDTH_SHARE * height_m
    saplings = [SaplingKey(plant.name, variant, m, layer.season) for plant, variant, m in prototypes]
    return PlacedThings(saplings, world_T, plant_surfaces(plants, SAPLING_PARTS, layer.land.plants), plants)


_STATIONS = np.linspace(-0.5, 0.5, 9)
"""Stations along a log at which the ground and the distance from the path are sampled."""
_PLATE_STATIONS = np.linspace(-0.4, 0.4, 5)
"""Stations across a plate at which the distance from the path and from trunks is sampled."""


@dataclass(frozen=True, slots=True)
class _Pieces:
    """Whole logs and pieces of broken ones, (n,) each."""

    log: I8  # index of the log
    is_top: Mask  # True for the upper piece of a broken log
    xy_m: F8  # (n, 2) centre
    towards: F8  # direction from butt to top, rad from east
    length_m: F8
    wide_m: F8
    high_m: F8
    sunk: F8  # share of the half height
    plate_m: F8  # diameter of the root plate at the butt; 0 for none

    def along_m(self) -> F8:
        """Positions (n, 9, 2) along the pieces."""
        return _line_m(self.xy_m, self.towards, self.length_m[:, None] * _STATIONS)


def _lay_logs(layer: Layer, trunks: F8, xy_m: F8, rng: Generator) -> PlacedThings:
    """Place trunks along the ground, some with their root plate, some broken in two, some rotten."""
    section = layer.section
    row = layer.row
    draws = rng.random((len(xy_m), 8))
    fate = rng.random((len(xy_m), 7))
    diameter_m = in_range(section.diameter_m, draws[:, 0])
    is_uprooted = fate[:, 0] < section.uprooted
    is_broken = fate[:, 1] < section.broken
    # A log with a standing root plate is young.
    is_rotten = (fate[:, 2] < section.decayed) & ~is_uprooted
    decay = np.where(is_rotten, in_range(row["decay"], fate[:, 3]), 0.0)
    plate_m = row["plate_m"] + row["plate_per_diameter"] * diameter_m
    logs = _Pieces(
        log=np.arange(len(xy_m)),
        is_top=np.zeros(len(xy_m), np.bool_),
        xy_m=xy_m,
        towards=2 * np.pi * draws[:, 2],
        length_m=in_range(section.length_m, draws[:, 1]),
        wide_m=diameter_m * (1 + row["decayed_wider"] * decay),
        high_m=diameter_m * (1 - row["decayed_lower"] * decay),
        sunk=row["sunk"] + row["decayed_sunk"] * decay,
        plate_m=np.where(is_uprooted, plate_m, 0.0),
    )
    pieces = _break_in_two(logs, is_broken, fate[:, 4:], row)
    world_T = _on_ground(pieces, layer.land.height_m, row["plate_axis"])
    along_m = pieces.along_m()
    sideways = pieces.towards + np.pi / 2
    across_m = _line_m(along_m[:, 0], sideways, pieces.plate_m[:, None] * _PLATE_STATIONS)
    keep = _are_clear(layer, trunks, along_m, pieces.wide_m / 2)
    keep &= _are_clear(layer, trunks, across_m, row["plate_thickness"] * pieces.plate_m)
    keep = np.bincount(pieces.log, ~keep, len(xy_m))[pieces.log] == 0
    species = _sample_species(layer, draws)[pieces.log]
    looks = draws[pieces.log]
    log_looks = np.where(pieces.is_top[:, None], looks[:, [6, 5]], looks[:, 4:6])
    in_two = is_broken[pieces.log]
    has_plate = pieces.plate_m > 0
    # Plates stand at the butts, across the logs.
    along = world_T[:, :, 0] / pieces.length_m[:, None]
    across = along_slope(pieces.towards, along[:, 2] / hypot(along[:, 0], along[:, 1]))
    size = pieces.plate_m[:, None] * [row["plate_thickness"], 1.0, 1.0]
    butt_T = placements(world_T[:, :, 3] - world_T[:, :, 0] / 2, across, size)
    return concatenate(
        [
            floor_things(FloorKind.LOG, keep & ~in_two, world_T, log_looks, species=species),
            floor_things(FloorKind.BROKEN_LOG, keep & in_two, world_T, log_looks, species=species),
            floor_things(FloorKind.ROOT_PLATE, keep & has_plate, butt_T, looks[:, [7, 5]], species=species),
        ]
    )


def _lay_stumps(layer: Layer, trunks: F8, xy_m: F8, rng: Generator) -> PlacedThings:
    section = layer.section
    draws = rng.random((len(xy_m), 8))
    species = _sample_species(layer, draws)
    diameter_m = in_range(section.diameter_m, draws[:, 0])
    height_m = in_range(section.height_m, draws[:, 1])
    keep = layer.are_clear(trunks, xy_m, 0.8 * diameter_m, 0.8 * diameter_m)
    place_m = np.column_stack([xy_m, layer.land.height_m(*xy_m.T)])
    size = np.column_stack([diameter_m, diameter_m, height_m])
    world_T = placements(place_m, about_vertical(360 * draws[:, 2]), size)
    is_broken = draws[:, 6] < section.broken
    kinds = (FloorKind.STUMP, keep & ~is_broken), (FloorKind.BROKEN_STUMP, keep & is_broken)
    return concatenate([floor_things(*kind, world_T, draws[:, 4:], species=species) for kind in kinds])


def _sample_species(layer: Layer, draws: F8) -> I8:
    numbers = np.array([tree.number for tree in layer.species], np.int64)
    return numbers[(len(numbers) * draws[:, 3]).astype(int)]


def _break_in_two(logs: _Pieces, is_broken: Mask, draws: F8, row: Row) -> _Pieces:
    """Break some of the logs (n,) in two; draws (n, 3) give position, gap and angle."""
    log = np.append(logs.log, np.flatnonzero(is_broken))
    is_top = np.arange(len(log)) >= len(logs.log)
    towards = logs.towards[log]
    log_m = logs.length_m[log]
    at = in_range(row["break_at"], draws[log, 0])
    gap = in_range(row["break_gap"], draws[log, 1])
    share = np.where(is_top, 1 - at - gap, np.where(is_broken[log], at, 1.0))
    middle = np.where(is_top, at / 2, -0.5 + share / 2)
    taper = shape_row(FloorKind.LOG)["taper"]
    thick = np.where(is_broken[log], 1 - 2 * taper * middle, 1.0)
    length_m = share * log_m
    xy_m = _line_m(logs.xy_m[log], towards, (np.where(is_top, at + gap - 0.5, middle) * log_m)[:, None])[:, 0]
    # The upper piece is turned about its lower end.
    turn = np.radians(row["break_turn_deg"])
    towards = towards + np.where(is_top, turn * (2 * draws[log, 2] - 1), 0.0)
    xy_m[is_top] = _line_m(xy_m[is_top], towards[is_top], length_m[is_top, None] / 2)[:, 0]
    wide_m = thick * logs.wide_m[log]
    high_m = thick * logs.high_m[log]
    plate_m = np.where(is_top, 0.0, logs.plate_m[log])
    return _Pieces(log, is_top, xy_m, towards, length_m, wide_m, high_m, logs.sunk[log], plate_m)


def _on_ground(pieces: _Pieces, height_m: HeightField, plate_axis: float) -> F8:
    """`world_T_shape` (n, 3, 4) of pieces on the ground; butts with root plates are raised."""
    station_m = pieces.length_m[:, None] * _STATIONS
    ground_m = height_m(*np.moveaxis(pieces.along_m(), -1, 0))
    # Least-squares line through the ground at evenly spaced stations.
    slope = (ground_m * station_m).sum(axis=1) / (np.square(station_m)).sum(axis=1)
    rest_m = (1 - pieces.sunk) * pieces.high_m / 2
    lift_m = np.maximum(plate_axis * pieces.plate_m - rest_m, 0.0)
    z_m = ground_m.mean(axis=1) + rest_m + lift_m / 2
    world_R_log = along_slope(pieces.towards, slope - lift_m / pieces.length_m)
    size = np.column_stack([pieces.length_m, pieces.wide_m, pieces.high_m])
    return placements(np.column_stack([pieces.xy_m, z_m]), world_R_log, size)


def _are_clear(layer: Layer, trunks: F8, line_m: F8, radius_m: F8) -> Mask:
    """Return a mask of lines (n, k, 2) that keep a radius (n,) clear of the path and of trunks."""
    reach_m = np.repeat(radius_m, line_m.shape[1])
    clear = layer.are_clear(trunks, line_m.reshape(-1, 2), reach_m, reach_m).reshape(line_m.shape[:2])
    return np.asarray(clear.all(axis=1))


def _line_m(xy_m: F8, towards: F8, along_m: F8) -> F8:
    """Positions (n, k, 2) at distances (n, k) from points (n, 2) in directions (n,), rad from east."""
    away = np.stack([cos(towards), sin(towards)], axis=-1)
    return xy_m[:, None] + along_m[..., None] * away[:, None]


_SQRT_2_PI = 2.50662827463100050242
_TAIL = 0.13533528323661269189  # exp(-2): limit between the approximations of the middle and the tails
_MIDDLE = (
    (
        -5.99633501014107895267e1,
        9.80010754185999661536e1,
        -5.66762857469070293439e1,
        1.39312609387279679503e1,
        -1.23916583867381258016e0,
    ),
    (
        1.0,
        1.95448858338141759834e0,
        4.67627912898881538453e0,
        8.63602421390890590575e1,
        -2.25462687854119370527e2,
        2.00260212380060660359e2,
        -8.20372256168333339912e1,
        1.59056225126211695515e1,
        -1.18331621121330003142e0,
    ),
)
_TAILS = (
    (
        4.05544892305962419923e0,
        3.15251094599893866154e1,
        5.71628192246421288162e1,
        4.40805073893200834700e1,
        1.46849561928858024014e1,
        2.18663306850790267539e0,
        -1.40256079171354495875e-1,
        -3.50424626827848203418e-2,
        -8.57456785154685413611e-4,
    ),
    (
        1.0,
        1.57799883256466749731e1,
        4.53907635128879210584e1,
        4.13172038254672030440e1,
        1.50425385692907503408e1,
        2.50464946208309415979e0,
        -1.42182922854787788574e-1,
        -3.80806407691578277194e-2,
        -9.33259480895457427372e-4,
    ),
)
"""Numerators and denominators, highest power first (Moshier, Cephes Mathematical Library, ndtri.c)."""


def normal_quantile(probability: F8) -> F8:
    """Return standard normal quantiles of probabilities (n,) from 1e-13 to 1 - 1e-13.

    The relative error is 1e-15.
    """
    off = probability - 0.5
    square = off * off
    above, below = (np.polyval(np.array(coefficients), square) for coefficients in _MIDDLE)
    middle = (off + off * (square * (above / below))) * _SQRT_2_PI
    tail = np.minimum(np.minimum(probability, 1.0 - probability), _TAIL)
    far = np.sqrt(-2.0 * log(tail))
    above, below = (np.polyval(np.array(coefficients), 1.0 / far) for coefficients in _TAILS)
    far = far - log(far) / far - above / below / far
    return np.where(tail < _TAIL, np.copysign(far, off), middle)


_MOST_IN_PATCHES_PER_M2 = 4.0  # mean density; with more plants in patches a tile could run out of numbers
_SLOPE_M = 0.2  # distance to either side for the slope under a cushion or heap


def plants_per_ha(section: settings.Cover, spread: float, *, patches: bool) -> tuple[float, float]:
    """Plants per hectare, even ones and ones in patches, to cover a share c of the ground.

    Overlaps count once. Discs of area a in patches of mean density d leave (1 + 2 a d)^(-1/2) of the plane
    bare: the mean of exp(-a d n^2) over normal noise n. It is assumed to be 1 / (1 + c (1 - c)): most plants
    are in patches at low cover, and few at closed cover. Even ones cover the rest. Heights are uniform
    between least and greatest, `spread` is width over height.
    """
    (low, high) = section.height_m
    cover = section.cover
    area_m2 = math.pi / 4 * spread * spread * (low * low + low * high + high * high) / 3
    in_patches = min(cover * (1 - cover), _MOST_IN_PATCHES_PER_M2 * area_m2) if patches else 0.0
    patchy = in_patches + in_patches * in_patches / 2
    even = -log1p(-cover) - log1p(in_patches)
    return 10_000 * even / area_m2, 10_000 * patchy / area_m2


@cache
def _stone_area_m2() -> float:
    """Mean area of a stone from above.

    It is the section at the ground, or the outline if the widest part is above.
    """
    row = floor()["layers"]["stones"]
    low, high = row["buried"]
    buried = low + (high - low) * (np.arange(1000) + 0.5) / 1000
    seen = 1 - np.square(np.clip(2 * buried - 1, 0, None))  # section of an ellipsoid at a relative height
    length_m = _stone_length_m((np.arange(20_000) + 0.5) / 20_000)
    return math.pi / 4 * row["width"] * float(np.mean(np.square(length_m)) * np.mean(seen))


def _stone_length_m(probability: F8) -> F8:
    """Quantiles of the truncated log-normal distribution."""
    row = floor()["layers"]["stones"]
    low, high = row["shares"]
    return row["median_m"] * exp(row["sigma"] * normal_quantile(low + (high - low) * probability))


def _lay_stones(layer: Layer, trunks: F8, xy_m: F8, rng: Generator) -> PlacedThings:
    row = layer.row
    draws = rng.random((len(xy_m), 7))
    length_m = _stone_length_m(draws[:, 0])
    size = length_m[:, None] * [1.0, row["width"], row["height"]]
    keep = layer.are_clear(trunks, xy_m, length_m / 2, length_m / 2)
    z_m = layer.land.height_m(*xy_m.T) + (0.5 - in_range(row["buried"], draws[:, 1])) * size[:, 2]
    world_T = placements(np.column_stack([xy_m, z_m]), about_vertical(360 * draws[:, 2]), size)
    return floor_things(FloorKind.STONE, keep, world_T, draws[:, 3:], large=length_m >= row["large_m"])


def _lay_low(layer: Layer, trunks: F8, xy_m: F8, rng: Generator) -> PlacedThings:
    """Place low ground cover beside the path; moss and litter, which are ground, follow the slope."""
    assert layer.shape is not None
    draws = rng.random((len(xy_m), 6))
    spread = layer.row["spread"]
    height_m = in_range(layer.section.height_m, draws[:, 0])
    keep = layer.land.path.distance_m(xy_m) < layer.row["reach_m"]
    world_R_thing = about_vertical(360 * draws[:, 1])
    if layer.is_ground:
        x, y = xy_m.T
        east = (layer.land.height_m(x + _SLOPE_M, y) - layer.land.height_m(x - _SLOPE_M, y)) / (2 * _SLOPE_M)
        north = (layer.land.height_m(x, y + _SLOPE_M) - layer.land.height_m(x, y - _SLOPE_M)) / (2 * _SLOPE_M)
        towards = atan2(north, east)
        world_R_ground = matmul(
            along_slope(towards, hypot(east, north)), about_vertical(np.degrees(-towards))
        )
        world_R_thing = matmul(world_R_ground, world_R_thing)
    else:
        keep[keep] = layer.are_clear(trunks, xy_m[keep], spread * height_m[keep] / 2, np.zeros(keep.sum()))
    place_m = np.column_stack([xy_m, layer.land.height_m(*xy_m.T)])
    size = height_m[:, None] * [spread, spread, 1.0]
    return floor_things(layer.shape, keep, placements(place_m, world_R_thing, size), draws[:, 2:])


_LAYERS: dict[type[Section], tuple[str, Callable[[Layer, F8, F8, Generator], PlacedThings]]] = {
    settings.Regeneration: ("regeneration", _lay_plants),
    settings.Shrubs: ("shrubs", _lay_plants),
    settings.Stones: ("stones", _lay_stones),
    settings.Logs: ("logs", _lay_logs),
    settings.Stumps: ("stumps", _lay_stumps),
    settings.Grass: ("grass", _lay_low),
    settings.Herbs: ("herbs", _lay_low),
    settings.Ferns: ("ferns", _lay_low),
    settings.DwarfShrubs: ("dwarf_shrubs", _lay_low),
    settings.Moss: ("moss", _lay_low),
    settings.Litter: ("litter", _lay_low),
}
"""Key in a scene, and function that places the things, of each section, in the order of their numbers."""
