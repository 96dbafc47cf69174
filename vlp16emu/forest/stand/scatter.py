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
from vlp16emu.forest.plants.species import BARK_SPREAD, LEAF_SPREAD, known
from vlp16emu.forest.purpose import Growth
from vlp16emu.forest.stand.floor_shapes import GROUND_KINDS, LOG_TAPER, FloorKind, labelled
from vlp16emu.forest.stand.placed import (
    PlacedThings,
    between,
    laid,
    placements,
    plant_surfaces,
    together,
    turned,
)
from vlp16emu.forest.stand.points import Land, PointPattern, patchy, pattern_of, scattered
from vlp16emu.forest.stand.stand import REGENERATION, TREE, class_scale
from vlp16emu.forest.tiles import tile_distance_m
from vlp16emu.random import generator
from vlp16emu.settings import Section
from vlp16emu.types import F8, I8, HeightField, Semantic
from vlp16emu.world.vectors import places_m

_CLASS_RATIO = 1.4  # ratio of the heights of neighbouring prototypes: none is scaled by more than a fifth
_ROOM_SHARE = 0.15
_MOST_ROOM_M = 0.5
"""Distance of a sapling from a tree, bark to bark, over its height, and its upper limit: assumption; none
grows through the foot of another."""
_FOOT_SHARE = 0.1  # radius of the foot of a shrub's stems over its width


Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class LayerKind:
    """Recipe for the things of a section of a scene."""

    name: str  # key of the section
    purpose: Growth  # purpose of its random numbers
    draws: tuple[int, ...]  # numbers drawn for each thing, in groups
    lay: Callable[
        ..., PlacedThings
    ]  # makes things from the layer, trunks, positions (n, 2) and draws (n, draws)
    shape: FloorKind | None = None  # shape of ground cover
    spread: float = 1.0  # width over height, for a tuft already in its shape; assumption
    reach_m: float = math.inf
    """Greatest distance from the path: farther away the beam is wider than such a plant; assumption."""

    @property
    def is_ground(self) -> bool:
        """True if it is part of the ground: without instance numbers, and too low for the far medium."""
        return self.shape in GROUND_KINDS


class Layer:
    """Plants or things of one section of a scene, off the trails.

    A section without species uses the canopy's species, for saplings the living ones. Raises GeometryError
    for a species that is not in the table, and for saplings without any species.
    """

    def __init__(
        self, section: Section, land: Land, *, season: settings.Season = "leaf_on", canopy: Sequence[str] = ()
    ) -> None:
        self.section: Any = section
        self.kind = _KINDS[type(section)]
        self.season = season
        self.land = land
        self.species: Sequence[Any] = []  # species of the plants, living or dead
        plants = land.plants
        match section:
            case settings.Regeneration():
                names = section.species or [one for one in canopy if plants.trees[one].foliage]
                if section.stems_per_ha and not names:
                    found = "found none, and only dead trees above"
                    raise GeometryError("regeneration.species", found, "names of species")
                self.species = known(names, plants.trees, "regeneration.species")
            case settings.Shrubs():
                self.species = known(section.species, plants.shrubs, "shrubs.species")
            case settings.Logs() | settings.Stumps():
                self.species = known(section.species or canopy, plants.trees, f"{self.kind.name}.species")
        self.pattern = _pattern(
            section, self.kind, land
        )  # before things on the path and in trunks are left out

    def place(self, ix: int, iy: int, trunks: F8) -> PlacedThings:
        """Place the things of a tile clear of trunks (m, 3): x, y and radius at the ground of stems on it and its neighbours."""
        near = tile_distance_m((ix, iy), self.land.path) < self.kind.reach_m
        xy_m = self.pattern.points(ix, iy) if near else np.zeros((0, 2))
        rng = generator(self.land.seed, self.kind.purpose, ix, iy, 1)
        return self.kind.lay(
            self, trunks, xy_m, *(rng.random((len(xy_m), count)) for count in self.kind.draws)
        )

    def are_clear(self, trunks: F8, xy_m: F8, reach_m: F8, foot_m: F8) -> Mask:
        """Return a mask (n,) of points (n, 2) that keep `reach_m` (n,) away from the path, and `foot_m` (n,) from all trunks."""
        free = np.asarray(self.land.path.distance_m(xy_m) - reach_m >= self.land.path.clearance_m)
        dx, dy = (xy_m[:, None, axis] - trunks[:, axis] for axis in (0, 1))
        gap_m = foot_m[:, None] + trunks[:, 2]
        blocked = np.asarray((dx * dx + dy * dy < gap_m * gap_m).any(axis=1))
        return np.logical_and(free, ~blocked)


def layers_of(section: settings.Woods, land: Land, canopy: Sequence[str]) -> list[Layer]:
    """Return the layers of all plants and things under the trees, in the order of their numbers."""
    sections = (getattr(section, kind.name) for kind in _KINDS.values())
    layers = [Layer(own, land, season=section.season, canopy=canopy) for own in sections]
    return [layer for layer in layers if layer.pattern.per_ha]


def _lay_plants(layer: Layer, trunks: F8, xy_m: F8, draws: F8) -> PlacedThings:
    """Place young trees, or bushes of several stems."""
    own = layer.section
    kind = (len(layer.species) * draws[:, 1]).astype(int)
    is_shrub = isinstance(own, settings.Shrubs)
    if is_shrub:
        low_m, high_m, wide = np.array([(*one.height_m, one.width_share) for one in layer.species])[kind].T
        height_m = low_m + (high_m - low_m) * draws[:, 0]
        width_m = height_m * wide
        foot_m = _FOOT_SHARE * width_m
    else:
        height_m = between(own.height_m, draws[:, 0])
        width_m = CROWN_WIDTH_SHARE * height_m
        foot_m = height_m / SLENDERNESS / 2 + np.minimum(_ROOM_SHARE * height_m, _MOST_ROOM_M)
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
    plants["crown_class"] = np.round(log(height_m) / log(_CLASS_RATIO))
    plants["crown_variant"] = VARIANTS * draws[:, 3]
    looks = [(one.number, one.bark_reflectance, one.leaf_reflectance) for one in layer.species]
    plants["species"], bark, leaf = np.array(looks)[kind].T
    plants["bark_reflectance"] = bark + (2 * draws[:, 4] - 1) * BARK_SPREAD
    plants["leaf_reflectance"] = leaf + (2 * draws[:, 5] - 1) * LEAF_SPREAD
    prototype_m = [class_scale(_CLASS_RATIO, number) for number in plants["crown_class"].tolist()]
    size = np.repeat((height_m / np.array(prototype_m))[:, None], 3, axis=1)
    world_T = placements(places_m(plants), turned(plants["crown_azimuth_deg"]), size)
    prototypes = zip(
        (layer.species[i] for i in kind), plants["crown_variant"].tolist(), prototype_m, strict=True
    )
    if is_shrub:
        shrubs = [
            ShrubKey(one.name, variant, m, one.width_share * m, layer.season)
            for one, variant, m in prototypes
        ]
        return PlacedThings(
            shrubs, world_T, plant_surfaces(plants, SHRUB_PARTS, layer.land.plants, Semantic.SHRUB)
        )
    plants["storey"] = plants["cohort"] = REGENERATION
    plants["dbh_m"] = np.maximum(height_m - BREAST_HEIGHT_M, 0.0) / SLENDERNESS
    plants["crown_base_m"] = CROWN_BASE_SHARE * height_m
    plants["crown_width_m"] = CROWN_WIDTH_SHARE * height_m
    saplings = [SaplingKey(one.name, variant, m, layer.season) for one, variant, m in prototypes]
    return PlacedThings(saplings, world_T, plant_surfaces(plants, SAPLING_PARTS, layer.land.plants), plants)


_STATIONS = np.linspace(-0.5, 0.5, 9)
"""Stations along a log at which the ground and the distance from the path are sampled."""
_SUNK = 0.25  # share of its half height that a sound log has sunk into the ground; assumption
_DECAY = (0.3, 1.0)
"""Range of decay of a rotten log: from round to oval, the third of five classes, to lying wholly on the
ground (decay class system for coarse woody debris in Ann. For. Sci. 67(8), 2010, f09374, table I)."""
_DECAYED_LOWER = 0.5
_DECAYED_WIDER = 0.2
_DECAYED_SUNK = 0.5
"""Decrease of height and increase of width of a log's section at decay 1, and its extra sinking;
assumptions."""
_BREAK_AT = (0.35, 0.65)
_BREAK_GAP = (0.02, 0.1)
_BREAK_TURN = np.radians(12.0)
"""Range of the position of a break and of its gap, over the length, and half-range of the angle between the
pieces; assumptions."""
_PLATE_M = 1.0
_PLATE_PER_DIAMETER = 4.0
"""Diameter of a root plate: intercept, and slope over the mean diameter of the log; assumption."""
_PLATE_THICKNESS = 0.25  # over its diameter; assumption
_PLATE_AXIS = 0.3
"""Height of the butt over the ground over the plate's diameter; the plate's lower part is in its pit;
assumption."""
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


def _lay_logs(layer: Layer, trunks: F8, xy_m: F8, draws: F8, fate: F8) -> PlacedThings:
    """Place trunks along the ground, some with their root plate, some broken in two, some rotten."""
    own = layer.section
    diameter_m = between(own.diameter_m, draws[:, 0])
    is_uprooted = fate[:, 0] < own.uprooted
    is_broken = fate[:, 1] < own.broken
    # A log with a standing root plate is young.
    decay = np.where((fate[:, 2] < own.decayed) & ~is_uprooted, between(_DECAY, fate[:, 3]), 0.0)
    whole = _Pieces(
        log=np.arange(len(xy_m)),
        is_top=np.zeros(len(xy_m), np.bool_),
        xy_m=xy_m,
        towards=2 * np.pi * draws[:, 2],
        length_m=between(own.length_m, draws[:, 1]),
        wide_m=diameter_m * (1 + _DECAYED_WIDER * decay),
        high_m=diameter_m * (1 - _DECAYED_LOWER * decay),
        sunk=_SUNK + _DECAYED_SUNK * decay,
        plate_m=np.where(is_uprooted, _PLATE_M + _PLATE_PER_DIAMETER * diameter_m, 0.0),
    )
    pieces = _broken(whole, is_broken, fate[:, 4:])
    world_T = _laid_down(pieces, layer.land.height_m)
    along_m = pieces.along_m()
    sideways = pieces.towards + np.pi / 2
    across_m = _line_m(along_m[:, 0], sideways, pieces.plate_m[:, None] * _PLATE_STATIONS)
    keep = _are_clear(layer, trunks, along_m, pieces.wide_m / 2)
    keep &= _are_clear(layer, trunks, across_m, _PLATE_THICKNESS * pieces.plate_m)
    keep = np.bincount(pieces.log, ~keep, len(xy_m))[pieces.log] == 0
    species = _sampled_species(layer, draws)[pieces.log]
    looks = draws[pieces.log]
    log_looks = np.where(pieces.is_top[:, None], looks[:, [6, 5]], looks[:, 4:6])
    in_two = is_broken[pieces.log]
    has_plate = pieces.plate_m > 0
    # Plates stand at the butts, across the logs.
    along = world_T[:, :, 0] / pieces.length_m[:, None]
    across = laid(pieces.towards, along[:, 2] / hypot(along[:, 0], along[:, 1]))
    size = pieces.plate_m[:, None] * [_PLATE_THICKNESS, 1.0, 1.0]
    butt_T = placements(world_T[:, :, 3] - world_T[:, :, 0] / 2, across, size)
    return together(
        [
            labelled(FloorKind.LOG, keep & ~in_two, world_T, log_looks, species=species),
            labelled(FloorKind.BROKEN_LOG, keep & in_two, world_T, log_looks, species=species),
            labelled(FloorKind.ROOT_PLATE, keep & has_plate, butt_T, looks[:, [7, 5]], species=species),
        ]
    )


def _lay_stumps(layer: Layer, trunks: F8, xy_m: F8, draws: F8) -> PlacedThings:
    own = layer.section
    species = _sampled_species(layer, draws)
    diameter_m = between(own.diameter_m, draws[:, 0])
    height_m = between(own.height_m, draws[:, 1])
    keep = layer.are_clear(trunks, xy_m, 0.8 * diameter_m, 0.8 * diameter_m)
    place_m = np.column_stack([xy_m, layer.land.height_m(*xy_m.T)])
    size = np.column_stack([diameter_m, diameter_m, height_m])
    world_T = placements(place_m, turned(360 * draws[:, 2]), size)
    is_broken = draws[:, 6] < own.broken
    kinds = (FloorKind.STUMP, keep & ~is_broken), (FloorKind.BROKEN_STUMP, keep & is_broken)
    return together([labelled(*kind, world_T, draws[:, 4:], species=species) for kind in kinds])


def _sampled_species(layer: Layer, draws: F8) -> I8:
    numbers = np.array([tree.number for tree in layer.species], np.int64)
    return numbers[(len(numbers) * draws[:, 3]).astype(int)]


def _broken(whole: _Pieces, is_broken: Mask, draws: F8) -> _Pieces:
    """Break some of the logs (n,) in two; draws (n, 3) give position, gap and angle."""
    log = np.append(whole.log, np.flatnonzero(is_broken))
    is_top = np.arange(len(log)) >= len(whole.log)
    towards = whole.towards[log]
    whole_m = whole.length_m[log]
    at = between(_BREAK_AT, draws[log, 0])
    gap = between(_BREAK_GAP, draws[log, 1])
    share = np.where(is_top, 1 - at - gap, np.where(is_broken[log], at, 1.0))
    middle = np.where(is_top, at / 2, -0.5 + share / 2)
    thick = np.where(is_broken[log], 1 - 2 * LOG_TAPER * middle, 1.0)
    length_m = share * whole_m
    xy_m = _line_m(whole.xy_m[log], towards, (np.where(is_top, at + gap - 0.5, middle) * whole_m)[:, None])[
        :, 0
    ]
    # The upper piece is turned about its lower end.
    towards = towards + np.where(is_top, _BREAK_TURN * (2 * draws[log, 2] - 1), 0.0)
    xy_m[is_top] = _line_m(xy_m[is_top], towards[is_top], length_m[is_top, None] / 2)[:, 0]
    wide_m = thick * whole.wide_m[log]
    high_m = thick * whole.high_m[log]
    plate_m = np.where(is_top, 0.0, whole.plate_m[log])
    return _Pieces(log, is_top, xy_m, towards, length_m, wide_m, high_m, whole.sunk[log], plate_m)


def _laid_down(pieces: _Pieces, height_m: HeightField) -> F8:
    """`world_T_shape` (n, 3, 4) of pieces on the ground; butts with root plates are raised."""
    station_m = pieces.length_m[:, None] * _STATIONS
    ground_m = height_m(*np.moveaxis(pieces.along_m(), -1, 0))
    # Least-squares line through the ground at evenly spaced stations.
    slope = (ground_m * station_m).sum(axis=1) / (np.square(station_m)).sum(axis=1)
    rest_m = (1 - pieces.sunk) * pieces.high_m / 2
    lift_m = np.maximum(_PLATE_AXIS * pieces.plate_m - rest_m, 0.0)
    z_m = ground_m.mean(axis=1) + rest_m + lift_m / 2
    world_R_log = laid(pieces.towards, slope - lift_m / pieces.length_m)
    size = np.column_stack([pieces.length_m, pieces.wide_m, pieces.high_m])
    return placements(np.column_stack([pieces.xy_m, z_m]), world_R_log, size)


def _are_clear(layer: Layer, trunks: F8, line_m: F8, radius_m: F8) -> Mask:
    """Return a mask of lines of positions (n, k, 2) that keep a radius (n,) clear of the path and of trunks."""
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
    (-5.99633501014107895267e1, 9.80010754185999661536e1, -5.66762857469070293439e1, 1.39312609387279679503e1, -1.23916583867381258016e0),
    (1.0, 1.95448858338141759834e0, 4.67627912898881538453e0, 8.63602421390890590575e1, -2.25462687854119370527e2, 2.00260212380060660359e2, -8.20372256168333339912e1, 1.59056225126211695515e1, -1.18331621121330003142e0),
)  # fmt: skip
_TAILS = (
    (4.05544892305962419923e0, 3.15251094599893866154e1, 5.71628192246421288162e1, 4.40805073893200834700e1, 1.46849561928858024014e1, 2.18663306850790267539e0, -1.40256079171354495875e-1, -3.50424626827848203418e-2, -8.57456785154685413611e-4),
    (1.0, 1.57799883256466749731e1, 4.53907635128879210584e1, 4.13172038254672030440e1, 1.50425385692907503408e1, 2.50464946208309415979e0, -1.42182922854787788574e-1, -3.80806407691578277194e-2, -9.33259480895457427372e-4),
)  # fmt: skip
"""Numerators and denominators, highest power first (Moshier, Cephes Mathematical Library, ndtri.c)."""


def normal_quantile(probability: F8) -> F8:
    """Return standard normal quantiles of probabilities (n,) from 1e-13 to 1 - 1e-13, with a relative error of 1e-15."""
    off = probability - 0.5
    square = off * off
    above, below = (np.polyval(np.array(coefficients), square) for coefficients in _MIDDLE)
    middle = (off + off * (square * (above / below))) * _SQRT_2_PI
    tail = np.minimum(np.minimum(probability, 1.0 - probability), _TAIL)
    far = np.sqrt(-2.0 * log(tail))
    above, below = (np.polyval(np.array(coefficients), 1.0 / far) for coefficients in _TAILS)
    far = far - log(far) / far - above / below / far
    return np.where(tail < _TAIL, np.copysign(far, off), middle)


_STONE_M = (0.1, 1.5)  # range of the length of a stone; assumption
_STONE_MEDIAN_M = 0.22
_STONE_SIGMA = 0.6
"""Parameters of the log-normal distribution of lengths, before truncation at both ends; assumptions."""
_STONE_SHARES = (0.0944070172326103, 0.999311242465033)
"""Shares of the untruncated distribution below the least and the greatest length."""
_STONE_BURIED = (0.3, 0.6)  # range of the buried share of a stone's height; assumption
_STONE_WIDTH, _STONE_HEIGHT = 0.8, 0.6  # width and height over length; assumptions
_LARGE_STONE_M = (
    0.4  # longer stones have four times the faces; the faces of shorter ones are off by less than 3 mm
)
_MOST_IN_PATCHES_PER_M2 = 4.0  # mean density; with more plants in patches a tile could run out of numbers
_SLOPE_M = 0.2  # distance to either side for the slope under a cushion or heap


def plants_per_ha(section: settings.Cover, spread: float, *, patches: bool) -> tuple[float, float]:
    """Plants per hectare, even ones and ones in patches, to cover a share c of the ground, overlaps counted once.

    Discs of area a in patches of mean density d leave (1 + 2 a d)^(-1/2) of the plane bare: the mean of
    exp(-a d n^2) over normal noise n. It is assumed to be 1 / (1 + c (1 - c)): most plants are in patches at
    low cover, and few at closed cover. Even ones cover the rest. Heights are uniform between least and
    greatest, `spread` is width over height.
    """
    (low, high) = section.height_m
    cover = section.cover
    area_m2 = math.pi / 4 * spread * spread * (low * low + low * high + high * high) / 3
    in_patches = min(cover * (1 - cover), _MOST_IN_PATCHES_PER_M2 * area_m2) if patches else 0.0
    patchy = in_patches + in_patches * in_patches / 2
    even = -log1p(-cover) - log1p(in_patches)
    return 10_000 * even / area_m2, 10_000 * patchy / area_m2


def _pattern(section: Section, kind: LayerKind, land: Land) -> PointPattern:
    """Make the point pattern of a layer: herbs, ferns and dwarf shrubs grow in patches, other things anywhere."""
    match section:
        case settings.Regeneration() | settings.Shrubs():
            per_ha = section.per_ha if isinstance(section, settings.Shrubs) else section.stems_per_ha
            return pattern_of(section.pattern, land, purpose=kind.purpose, per_ha=per_ha)
        case settings.Cover():
            even, in_patches = plants_per_ha(section, kind.spread, patches=not kind.is_ground)
            if in_patches:
                return patchy(
                    seed=land.seed, purpose=kind.purpose, even_per_ha=even, patchy_per_ha=in_patches
                )
        case settings.Grass():
            even = 10_000 * section.tufts_per_m2
        case settings.Stones():
            # Overlaps counted once, scattered discs of mean area a and density d leave exp(-a d) of the plane
            # bare (Boolean model; Chiu et al., Stochastic Geometry, section 3.1).
            even = -log1p(-section.cover) / _stone_area_m2() * 10_000
        case settings.Logs() | settings.Stumps():
            even = section.per_ha
    return scattered(seed=land.seed, purpose=kind.purpose, per_ha=even)


@cache
def _stone_area_m2() -> float:
    """Mean area of a stone from above: its section at the ground, or its outline if its widest part is above."""
    low, high = _STONE_BURIED
    buried = low + (high - low) * (np.arange(1000) + 0.5) / 1000
    seen = 1 - np.square(np.clip(2 * buried - 1, 0, None))  # section of an ellipsoid at a relative height
    length_m = _stone_length_m((np.arange(20_000) + 0.5) / 20_000)
    return math.pi / 4 * _STONE_WIDTH * float(np.mean(np.square(length_m)) * np.mean(seen))


def _stone_length_m(probability: F8) -> F8:
    """Quantiles of the log-normal distribution truncated to `_STONE_M`."""
    low, high = _STONE_SHARES
    return _STONE_MEDIAN_M * exp(_STONE_SIGMA * normal_quantile(low + (high - low) * probability))


def _lay_stones(layer: Layer, trunks: F8, xy_m: F8, draws: F8) -> PlacedThings:
    length_m = _stone_length_m(draws[:, 0])
    size = length_m[:, None] * [1.0, _STONE_WIDTH, _STONE_HEIGHT]
    keep = layer.are_clear(trunks, xy_m, length_m / 2, length_m / 2)
    z_m = layer.land.height_m(*xy_m.T) + (0.5 - between(_STONE_BURIED, draws[:, 1])) * size[:, 2]
    world_T = placements(np.column_stack([xy_m, z_m]), turned(360 * draws[:, 2]), size)
    return labelled(FloorKind.STONE, keep, world_T, draws[:, 3:], large=length_m >= _LARGE_STONE_M)


def _lay_low(layer: Layer, trunks: F8, xy_m: F8, draws: F8) -> PlacedThings:
    """Place low ground cover beside the path; moss and litter, which are ground, follow the slope."""
    height_m = between(layer.section.height_m, draws[:, 0])
    kind = layer.kind
    keep = layer.land.path.distance_m(xy_m) < kind.reach_m
    world_R_thing = turned(360 * draws[:, 1])
    if kind.is_ground:
        x, y = xy_m.T
        east = (layer.land.height_m(x + _SLOPE_M, y) - layer.land.height_m(x - _SLOPE_M, y)) / (2 * _SLOPE_M)
        north = (layer.land.height_m(x, y + _SLOPE_M) - layer.land.height_m(x, y - _SLOPE_M)) / (2 * _SLOPE_M)
        towards = atan2(north, east)
        world_R_ground = matmul(laid(towards, hypot(east, north)), turned(np.degrees(-towards)))
        world_R_thing = matmul(world_R_ground, world_R_thing)
    else:
        keep[keep] = layer.are_clear(
            trunks, xy_m[keep], kind.spread * height_m[keep] / 2, np.zeros(keep.sum())
        )
    place_m = np.column_stack([xy_m, layer.land.height_m(*xy_m.T)])
    size = height_m[:, None] * [kind.spread, kind.spread, 1.0]
    assert kind.shape is not None
    return labelled(kind.shape, keep, placements(place_m, world_R_thing, size), draws[:, 2:])


_KINDS: dict[type[Section], LayerKind] = {  # kinds of layers by section, in the order of their numbers
    settings.Regeneration: LayerKind("regeneration", Growth.REGENERATION, (6,), _lay_plants),
    settings.Shrubs: LayerKind("shrubs", Growth.SHRUBS, (6,), _lay_plants),
    settings.Stones: LayerKind("stones", Growth.STONES, (7,), _lay_stones),
    settings.Logs: LayerKind("logs", Growth.LOGS, (8, 7), _lay_logs),
    settings.Stumps: LayerKind("stumps", Growth.STUMPS, (8,), _lay_stumps),
    settings.Grass: LayerKind("grass", Growth.GRASS, (6,), _lay_low, FloorKind.TUFT, 1.0, 25.0),
    settings.Herbs: LayerKind("herbs", Growth.HERBS, (6,), _lay_low, FloorKind.HERB, 2.0, 25.0),
    settings.Ferns: LayerKind("ferns", Growth.FERNS, (6,), _lay_low, FloorKind.FERN, 1.3, 25.0),
    settings.DwarfShrubs: LayerKind(
        "dwarf_shrubs", Growth.DWARF_SHRUBS, (6,), _lay_low, FloorKind.DWARF_SHRUB, 1.2, 25.0
    ),
    settings.Moss: LayerKind("moss", Growth.MOSS, (6,), _lay_low, FloorKind.MOSS_CUSHION, 8.0, 12.0),
    settings.Litter: LayerKind("litter", Growth.LITTER, (6,), _lay_low, FloorKind.LITTER_HEAP, 8.0, 12.0),
}
