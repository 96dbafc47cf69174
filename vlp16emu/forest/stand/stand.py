"""A stand of trees: positions and sizes, tile by tile, from (seed, tile) alone."""

import fractions
import math
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import atan2, cos, exp, hypot, log, sin, tan
from vlp16emu.errors import GeometryError
from vlp16emu.foliage.polyline import Corridor
from vlp16emu.forest.plants.allometry import taper_radius_m, truncated_weibull_cm
from vlp16emu.forest.plants.prototypes import VARIANTS, CrownKey
from vlp16emu.forest.plants.species import (
    BARK_SPREAD,
    LEAF_SPREAD,
    Flora,
    Species,
    Table,
    Trees,
    find_species,
    tapers,
)
from vlp16emu.forest.purpose import Growth
from vlp16emu.forest.settings import MOST_STEMS_PER_HA, Forest, SpeciesShare, Storey
from vlp16emu.forest.stand.points import Land, PointPattern, pattern_of
from vlp16emu.forest.tiles import around
from vlp16emu.random import generator
from vlp16emu.types import F8
from vlp16emu.world.vectors import places_m

TREE = np.dtype(  # one tree
    [
        ("id", "<u4"),  # unique in the forest
        ("species", "<u2"),  # number in the species table
        ("x_m", "<f8"),  # foot: point where the stem's axis leaves the ground
        ("y_m", "<f8"),
        ("z_m", "<f8"),
        ("dbh_m", "<f8"),  # area-equivalent, perpendicular to the axis 1.3 m above the foot
        ("height_m", "<f8"),  # height of the tip over the foot, vertical
        ("crown_base_m", "<f8"),  # height of the crown's lowest branch over the foot, vertical
        ("crown_width_m", "<f8"),
        ("taper", "<f8"),  # relative radius (1 at breast height) is the species' curve to the power 1 + taper
        ("lean_deg", "<f8"),  # angle of the axis from the vertical
        ("lean_towards_deg", "<f8"),  # counter-clockwise from east
        ("crown_azimuth_deg", "<f8"),  # rotation of the crown about the axis
        ("cohort", "u1"),  # index in the species mixture
        ("crown_class", "<i2"),  # diameter class of the crown's prototype
        ("crown_variant", "u1"),  # index of the prototype in that class
        ("bark_reflectance", "<f4"),  # at 903 nm
        ("leaf_reflectance", "<f4"),
        ("storey", "u1"),  # 0 canopy, 1 and 2 the storeys under it, REGENERATION saplings
        ("list_line", "<u4"),  # line of the stem list; 0 for a generated tree
        ("form", "<u8"),  # seed of the stem's form; 0 is straight and round
    ]
)
REGENERATION = 255  # storey of saplings: DBH below 5 cm, or 0 if lower than breast height
_CLASS_RATIO = 1.5
"""Ratio of diameters of neighbouring crown classes: no crown is scaled by more than a quarter."""
_OPEN_GROWN = 1.5
"""Upper limit of the ground area whose leaves one crown carries, over its projection; assumption."""
RIVALS_M = 10.0
"""Distance to which trees compete. Hasenauer and Monserud (1996) use angle counts, which reach as far for 40
cm stems."""
_WIDTH_BY_HEIGHT = -0.2
_WIDTH_BY_RATIO = 0.23
"""Correlation of crown width residuals with height and crown ratio residuals: pooled from [B] in the species
table."""
_LEVELS = np.linspace(-1.2, 1.2, VARIANTS)
"""Crown ratio residuals of the prototypes of a class, in sigmas, so that no crown is stretched much along its
stem."""
_MOST_SIGMAS = 2.5
"""Limit of residuals: larger ones are likely measuring errors; keeps crowns near their prototypes."""
_HEAD_ROOM_M = 2.5  # height up to which a leaning stem must stay clear of the path: above a walker's head
_STEM_GAP_M = 0.05  # least gap between two stems at the ground; assumption
_TILES_KEPT = 1024  # tiles whose trees are kept for their neighbours: more than a window with its border has
_MOST_BASAL_M2_PER_HA = 350.0
"""Greatest basal area of all storeys. Coast redwoods, the densest known, reportedly have 343 (Fujimori 1977,
Journal of the Japanese Forestry Society 59, not accessible; Busing and Fujimori 2005,
10.1007/s11258-005-2322-8, give that stand 3000 to 5200 t of stems per ha)."""
_STOREYS = (Growth.STAND, Growth.SECOND_STOREY, Growth.THIRD_STOREY)


class _Cohort:
    """The trees of one species in a stand: diameters, and the sizes that follow from a diameter."""

    def __init__(self, share: SpeciesShare, plants: Flora) -> None:
        self.share = share
        self.species = find_species([share.species], plants.trees, "species")[0]
        _check_size(share, self.species)
        midpoints = (np.arange(4096) + 0.5) / 4096
        raw_cm = truncated_weibull_cm(self.species.diameters, midpoints, share.dbh_cm)
        self._scale = share.dbh_cm / math.sqrt(float(np.mean(np.square(raw_cm))))
        self.sample_cm = raw_cm * self._scale

    def height_m(self, dbh_cm: F8) -> F8:
        """Mean height of trees of these diameters."""
        return self.species.height_curve(dbh_cm, self.share.dbh_cm, self.share.height_m)

    def with_sizes(self, trees: Trees, uniform: F8, residual: F8) -> Trees:
        """Set species, size and brightness of trees (n,), all but the crown base.

        They follow from (n, 3) uniform numbers and `residuals`.
        """
        species = self.species
        # Quantiles of diameter, scaled to the stand's quadratic mean.
        dbh_cm = truncated_weibull_cm(species.diameters, uniform[:, 0], self.share.dbh_cm) * self._scale
        tall, _, wide, form = residual.T
        trees["species"] = species.number
        trees["dbh_m"] = dbh_cm / 100
        trees["height_m"] = self.height_m(dbh_cm) * exp(species.spread.height * tall)
        trees["crown_width_m"] = species.crown_width_m(dbh_cm, wide)
        trees["taper"] = species.taper_of(form)
        trees["crown_class"] = np.round(log(dbh_cm / self.share.dbh_cm) / log(_CLASS_RATIO))
        trees["bark_reflectance"] = species.bark_reflectance + BARK_SPREAD * (2 * uniform[:, 1] - 1)
        trees["leaf_reflectance"] = species.leaf_reflectance + LEAF_SPREAD * (2 * uniform[:, 2] - 1)
        return trees


def _check_size(share: SpeciesShare, species: Species) -> None:
    """Raise GeometryError for a mean tree that is larger than the largest known of its species."""
    champion = species.champion
    if share.height_m > champion.height_m:
        expected = f"{champion.height_m:g} at most, the height of the tallest known"
        raise GeometryError(f"species {species.name}: height_m", f"found {share.height_m:g}", expected)
    if share.dbh_cm > champion.dbh_cm:
        expected = f"{champion.dbh_cm:g} at most, the DBH of the thickest known"
        raise GeometryError(f"species {species.name}: dbh_cm", f"found {share.dbh_cm:g}", expected)


def competition(
    rivals: F8, area_m2: float, larger: NDArray[np.bool_], near: NDArray[np.bool_]
) -> tuple[F8, F8]:
    """Basal area of larger trees in m2 per ha, and crown competition factor in percent, each (n,).

    `rivals` (m, 2) are sections at breast height and open-grown crown projections in m2; `area_m2` is the
    area around each of n trees; `larger` and `near` (n, m) are true if a rival is thicker, and within that
    area.
    """
    basal_m2, crown_m2 = rivals.T
    basal_m2_per_ha = 1e4 / area_m2 * (larger * near * basal_m2).sum(axis=1)
    return basal_m2_per_ha, 100 / area_m2 * (near * crown_m2).sum(axis=1)


def residuals(normal: F8) -> F8:
    """Correlate normal numbers (n, 4) as the residuals of trees, in sigmas.

    They are residuals of height, crown ratio, crown width and volume.
    """
    z = np.clip(normal, -_MOST_SIGMAS, _MOST_SIGMAS)
    own_share = math.sqrt(1 - _WIDTH_BY_HEIGHT * _WIDTH_BY_HEIGHT - _WIDTH_BY_RATIO * _WIDTH_BY_RATIO)
    z[:, 2] = _WIDTH_BY_HEIGHT * z[:, 0] + _WIDTH_BY_RATIO * z[:, 1] + own_share * z[:, 2]
    return z


def class_scale(ratio: float, number: int) -> float:
    """Return the size of a class relative to class 0, an integer power of a ratio, correctly rounded."""
    return float(pow(fractions.Fraction(ratio), number))


def foot_discs(trees: Trees, *, table: Table | None = None) -> F8:
    """Sections of stems at the ground (n, 3): x, y, radius."""
    foot = np.zeros((len(trees), 1))
    radius_m = taper_radius_m(tapers(trees, table=table), trees["dbh_m"], trees["height_m"], foot)
    return np.column_stack([trees["x_m"], trees["y_m"], radius_m])


def in_the_way_m(trees: Trees) -> tuple[F8, F8]:
    """Return the positions (n, 2) of stems at the foot, and above a walker's head."""
    foot = places_m(trees, "xy")
    towards = np.radians(trees["lean_towards_deg"])
    shift = _HEAD_ROOM_M * tan(np.radians(trees["lean_deg"]))
    return foot, foot + shift[:, None] * np.column_stack([cos(towards), sin(towards)])


def path_gap_m(trees: Trees, radius_m: F8, path: Corridor) -> F8:
    """Distance (n,) from a path to the surfaces of stems, from the ground to above a walker's head."""
    foot, above = in_the_way_m(trees)
    return np.minimum(path.distance_m(foot), path.distance_m(above)) - radius_m


def density_per_ha(storey: Storey) -> float:
    """Stems per hectare; for a basal area, the number whose cross-sections at breast height sum to it.

    Raises GeometryError if a basal area gives too many stems.
    """
    if storey.stems_per_ha:
        return storey.stems_per_ha
    per_ha = (basal_m2 := storey.basal_area_m2_per_ha) / _stem_m2(storey)
    if per_ha > MOST_STEMS_PER_HA:
        found = f"found {basal_m2:g}, {per_ha:.0f} stems of that size per ha"
        raise GeometryError("basal_area_m2_per_ha", found, f"at most {MOST_STEMS_PER_HA}")
    return per_ha


def _stem_m2(storey: Storey) -> float:
    share = np.array([row.share for row in storey.species])
    stem_m2 = np.pi / 4 * np.square(np.array([row.dbh_cm / 100 for row in storey.species]))
    return float(np.average(stem_m2, weights=share))


class Stand:
    """A mixed stand on a terrain, without edge, with path and trails free of stems.

    If two stems would overlap, the thicker one remains. Raises GeometryError for a species that is not in the
    table, and for too many stems.
    """

    def __init__(self, section: Forest, land: Land) -> None:
        self._section = section
        self._land = land
        storeys: list[Storey] = [section, *section.storeys]
        self._patterns = [
            pattern_of(storey.pattern, land, purpose=purpose, per_ha=density_per_ha(storey))
            for storey, purpose in zip(storeys, _STOREYS, strict=False)
        ]
        self._cohorts = [[_Cohort(share, land.plants) for share in storey.species] for storey in storeys]
        self._all_cohorts = [cohort for cohorts in self._cohorts for cohort in cohorts]
        self.per_ha = sum(pattern.per_ha for pattern in self._patterns)
        self.species = [share.species for share in section.species]  # canopy
        basal_m2 = sum(density_per_ha(storey) * _stem_m2(storey) for storey in storeys)
        if basal_m2 > _MOST_BASAL_M2_PER_HA:
            found = f"found a basal area of {basal_m2:.0f} m2 per ha"
            raise GeometryError(
                "stems_per_ha", found, f"at most {_MOST_BASAL_M2_PER_HA:g}: fewer or thinner stems"
            )
        samples = [_sample(*storey) for storey in zip(self._patterns, self._cohorts, strict=True)]
        self._rivals_cm, per_ha_m2 = (np.concatenate(column) for column in zip(*samples, strict=True))
        self._rivals_m2 = per_ha_m2[:, :2]
        ccf_percent = 100 * float(self._rivals_m2[:, 1].sum()) / 10_000
        self._openness = [float(row.species.openness(np.array(ccf_percent))) for row in self._all_cohorts]
        cover = float(per_ha_m2[:, 2].sum()) / 10_000
        self._ground_per_crown = 1 / max(cover, 1 / _OPEN_GROWN)
        self._crown = cache(self.crown)
        self._kept_trees = lru_cache(maxsize=_TILES_KEPT)(self._sow)

    def trees(self, ix: int, iy: int) -> Trees:
        """Trees with their foot in a tile, `TREE` with id still 0, in the order of sowing."""
        trees, values = self._kept_trees(ix, iy)
        trees = trees.copy()
        rivals = around(ix, iy, lambda *tile: self._kept_trees(*tile)[1])
        dx, dy = (values[:, None, :2] - rivals[:, :2]).transpose(2, 0, 1)
        apart_m2 = dx * dx + dy * dy
        gap_m = values[:, None, 2] + rivals[:, 2] + _STEM_GAP_M
        thicker = rivals[:, 3] > values[:, None, 3]
        beaten = ((apart_m2 < gap_m * gap_m) & thicker).any(axis=1)
        near = apart_m2 < RIVALS_M * RIVALS_M
        pressure = competition(rivals[:, 4:6], np.pi * RIVALS_M * RIVALS_M, thicker, near)
        for i, cohort in enumerate(self._all_cohorts):
            in_cohort = trees["cohort"] == i
            sizes = (
                100 * trees["dbh_m"][in_cohort],
                trees["height_m"][in_cohort],
                tuple(areas[in_cohort] for areas in pressure),
            )
            trees["crown_base_m"][in_cohort] = cohort.species.crown_base_m(*sizes, values[in_cohort, 6])
            openness = cohort.species.openness(pressure[1][in_cohort])
            trees["crown_width_m"][in_cohort] *= cohort.species.widening(sizes[0], openness)
        kinds, kind_of = np.unique(trees[["cohort", "crown_class"]], return_inverse=True)
        crowns = [self._crown(*kind, variant) for kind in kinds.tolist() for variant in range(VARIANTS)]
        ratios = np.array([1 - key.crown_base_m / key.height_m for key in crowns]).reshape(-1, VARIANTS)[
            kind_of
        ]
        own_ratio = 1 - trees["crown_base_m"] / trees["height_m"]
        trees["crown_variant"] = np.abs(ratios - own_ratio[:, None]).argmin(axis=1)
        clear = path_gap_m(trees, values[:, 2], self._land.path) >= self._land.path.clearance_m
        return trees[~beaten & clear]

    def _sow(self, ix: int, iy: int) -> tuple[Trees, F8]:
        """Sow the trees of a tile, without crown bases; return them, and (n, 7) values of each.

        The values are x, y, radius at the ground, DBH, the two competition areas, and the residual of the
        crown ratio.
        """
        storeys = [self._sow_storey(number, ix, iy) for number in range(len(self._patterns))]
        trees, ratio = (np.concatenate(column) for column in zip(*storeys, strict=True))
        competition_m2 = np.zeros((len(trees), 2))
        for i, cohort in enumerate(self._all_cohorts):
            in_cohort = trees["cohort"] == i
            competition_m2[in_cohort] = cohort.species.competition_m2(100 * trees["dbh_m"][in_cohort])
        return trees, np.column_stack(
            [foot_discs(trees, table=self._land.plants.trees), trees["dbh_m"], competition_m2, ratio]
        )

    def _sow_storey(self, number: int, ix: int, iy: int) -> tuple[Trees, F8]:
        position = self._patterns[number].points(ix, iy)
        rng = generator(self._land.seed, Growth.TREE, ix, iy, number)
        uniform = rng.random((len(position), 5))
        normal = rng.standard_normal((len(position), 6))
        trees = np.zeros(len(position), TREE)
        trees["x_m"], trees["y_m"] = position.T
        trees["z_m"] = self._land.height_m(trees["x_m"], trees["y_m"])
        trees["crown_azimuth_deg"] = 360 * uniform[:, 0]
        trees["storey"] = number
        if self._section.crooked_stems:
            trees["form"] = rng.integers(1, 2**63, len(position))
        cohorts = self._cohorts[number]
        share = np.array([cohort.share.share for cohort in cohorts])
        cohort_of = np.searchsorted(np.cumsum(share / share.sum())[:-1], uniform[:, 1], side="right")
        trees["cohort"] = sum(map(len, self._cohorts[:number])) + cohort_of
        lean_deg = np.array([cohort.species.lean_deg for cohort in cohorts])[cohort_of]
        lean_x, lean_y = lean_deg * normal[:, :2].T
        trees["lean_deg"] = hypot(lean_x, lean_y)
        trees["lean_towards_deg"] = np.degrees(atan2(lean_y, lean_x)) % 360
        residual = residuals(normal[:, 2:])
        for i, cohort in enumerate(cohorts):
            in_cohort = cohort_of == i
            trees[in_cohort] = cohort.with_sizes(
                trees[in_cohort], uniform[in_cohort, 2:], residual[in_cohort]
            )
        return trees, residual[:, 1]

    def crown(self, cohort: int, crown_class: int, variant: int) -> CrownKey:
        """Return the key of the crown prototype of a diameter class; variants have short to long crowns.

        Each species has its leaf area index on its share of the ground, divided among trees by their crown
        projection.
        """
        row = self._all_cohorts[cohort]
        dbh_cm = np.array([row.share.dbh_cm * class_scale(_CLASS_RATIO, crown_class)])
        height_m = row.height_m(dbh_cm)
        openness = self._openness[cohort]
        width_m = row.species.crown_width_m(dbh_cm) * row.species.widening(dbh_cm, np.array([openness]))
        leaf_area_m2 = row.species.leaf_area_index * self._ground_per_crown * _projection_m2(width_m)
        larger = self._rivals_cm > dbh_cm[:, None]
        rivals = competition(self._rivals_m2, 10_000.0, larger, np.ones_like(larger))
        base_m = row.species.crown_base_m(dbh_cm, height_m, rivals, _LEVELS[variant])
        sizes = dbh_cm / 100, height_m, base_m, width_m, leaf_area_m2
        dbh, height, base, width, leaves = (float(size[0]) for size in sizes)
        options = self._section.season, self._section.dead_branches
        return CrownKey(row.species.name, variant, dbh, height, base, width, leaves, *options, openness)


def _sample(pattern: PointPattern, cohorts: list[_Cohort]) -> tuple[F8, F8]:
    """Diameters (n,) of sample trees of a storey, and areas (n, 3) in m2 per ha of each.

    The areas are `competition_m2` and the crown projection.
    """
    total_share = sum(cohort.share.share for cohort in cohorts)
    areas_m2 = []
    for cohort in cohorts:
        species = cohort.species
        dbh_cm = cohort.sample_cm
        # Ratio of the mean of squares to the square of the mean.
        wider = exp(species.spread.crown_width * species.spread.crown_width)
        area_m2 = np.column_stack(
            [species.competition_m2(dbh_cm), wider * _projection_m2(species.crown_width_m(dbh_cm))]
        )
        areas_m2.append(pattern.per_ha * cohort.share.share / total_share / len(dbh_cm) * area_m2)
    return np.concatenate([cohort.sample_cm for cohort in cohorts]), np.concatenate(areas_m2)


def _projection_m2(crown_width_m: F8) -> F8:
    return np.pi / 4 * np.square(crown_width_m)
