"""A stand of trees: who stands where, and how large. Tile by tile, from (seed, tile) alone."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import GeometryError
from vlp16emu.random import Purpose, generator
from vlp16emu.types import HeightField
from vlp16emu.world.crown import VARIANTS, CrownKey
from vlp16emu.world.points import HardCore
from vlp16emu.world.polyline import distance_m
from vlp16emu.world.species import Species, species_table, taper_radius_m, tapers

__all__ = ["TREE", "SpeciesMix", "Stand"]

Array = NDArray[np.float64]
Trees = NDArray[np.void]

TREE = np.dtype(
    [
        ("id", "<u4"),  # unique in the forest
        ("species", "<u2"),  # number in the species table
        ("x_m", "<f8"),  # foot: where the stem's axis leaves the ground
        ("y_m", "<f8"),
        ("z_m", "<f8"),
        ("dbh_m", "<f8"),  # area-equivalent, across the axis where that is 1.3 m above the foot
        ("height_m", "<f8"),  # of the tip over the foot, vertical
        ("crown_base_m", "<f8"),  # of the lowest branch over the foot, vertical
        ("crown_width_m", "<f8"),
        ("lean_deg", "<f8"),  # of the axis from the vertical
        ("lean_towards_deg", "<f8"),  # counter-clockwise from east
        ("crown_azimuth_deg", "<f8"),  # of the crown about the axis
        ("cohort", "u1"),  # which line of the mixture it belongs to
        ("crown_class", "<i2"),  # diameter class of the crown's prototype
        ("crown_variant", "u1"),  # which of the prototypes of that class
        ("bark_reflectance", "<f4"),  # at 903 nm
        ("leaf_reflectance", "<f4"),
    ]
)
"""One tree."""

_CLASS_RATIO = 1.35
"""Between the diameters of neighbouring crown classes: no crown is scaled by more than a sixth or so."""

_TOP_DBH_RATIO = 1.25
"""Diameter of the stand's top height trees over its quadratic mean diameter; assumption."""

_OPEN_GROWN = 1.5
"""Ground whose leaves one crown can carry at most, over the crown's own projection; assumption."""

_LEAN_SIGMA_DEG = 1.5
"""One sigma of lean along each horizontal axis; assumption."""

_BARK_SPREAD, _LEAF_SPREAD = 0.08, 0.04
"""Half-range of reflectance between trees; assumptions (wide spread in the near infrared: Juola et al. 2020)."""

_HEAD_ROOM_M = 2.5
"""Height up to which a leaning stem must keep clear of the path: above a walker's head."""


@dataclass(frozen=True, slots=True)
class SpeciesMix:
    """One species of a stand."""

    species: str
    """Name in the species table."""
    share: float
    """Of stems; shares need not sum to one."""
    dbh_cm: float
    """Quadratic mean diameter at breast height."""
    height_m: float
    """Height of the tree of that diameter."""


class _Cohort:
    """The trees of one species in a stand: their diameters, and what follows from a diameter."""

    def __init__(self, mix: SpeciesMix) -> None:
        self.mix, self.species = mix, _species(mix.species)
        midpoints = (np.arange(4096) + 0.5) / 4096
        raw_cm = self.species.dbh_quantile_cm(midpoints, mix.dbh_cm)
        self._scale = mix.dbh_cm / math.sqrt(float(np.mean(raw_cm**2)))
        dbh_cm = raw_cm * self._scale
        self.mean_crown_m2 = float(np.mean(_projection_m2(self.species.crown_width_m(dbh_cm))))
        self._top_height_m = float(self.height_m(np.array([_TOP_DBH_RATIO * mix.dbh_cm]))[0])

    def dbh_cm(self, probability: Array) -> Array:
        """Quantiles of diameter, scaled to the stand's quadratic mean."""
        return self.species.dbh_quantile_cm(probability, self.mix.dbh_cm) * self._scale

    def height_m(self, dbh_cm: Array) -> Array:
        """Mean height of trees of these diameters."""
        return self.species.height_m(dbh_cm, self.mix.dbh_cm, self.mix.height_m)

    def crown_base_m(self, dbh_cm: Array, height_m: Array) -> Array:
        """Height of the lowest living branch."""
        return self.species.crown_base_m(dbh_cm, height_m, self._top_height_m)


class Stand:
    """A mixed stand on a terrain, without edge.

    Parameters
    ----------
    seed : of the scenario
    height_m : ground
    stems_per_ha : mean over the plane
    species : the mixture
    path_xy_m : (m, 2) the way that is kept free of stems
    path_clearance_m : no stem surface comes nearer to it than this

    Raises
    ------
    GeometryError
        for a species that is not in the table
    """

    def __init__(
        self,
        *,
        seed: int,
        height_m: HeightField,
        stems_per_ha: float,
        species: Sequence[SpeciesMix],
        path_xy_m: Array,
        path_clearance_m: float,
    ) -> None:
        self._seed, self._height_m = seed, height_m
        self._points = HardCore(seed=seed, per_ha=stems_per_ha)
        self._cohorts = [_Cohort(mix) for mix in species]
        shares = np.array([mix.share for mix in species])
        self._shares = shares / shares.sum()
        crown_m2 = sum(s * c.mean_crown_m2 for s, c in zip(self._shares, self._cohorts, strict=True))
        cover = stems_per_ha * crown_m2 / 10_000
        self._ground_per_crown = 1 / max(cover, 1 / _OPEN_GROWN)
        self._path_xy_m, self._clearance_m = path_xy_m, path_clearance_m

    def trees(self, ix: int, iy: int) -> Trees:
        """Trees whose foot lies in a tile, `TREE` with id still 0, in the order they were sown."""
        position = self._points.candidates(ix, iy)[:, :2]
        rng = generator(self._seed, Purpose.TREE, ix, iy)
        # All candidates draw, survivors or not: who falls changes nothing for the others.
        uniform, normal = rng.random((len(position), 6)), rng.standard_normal((len(position), 3))
        trees = np.zeros(len(position), TREE)
        trees["x_m"], trees["y_m"] = position.T
        trees["z_m"] = self._height_m(trees["x_m"], trees["y_m"])
        lean_x, lean_y = _LEAN_SIGMA_DEG * normal[:, 0], _LEAN_SIGMA_DEG * normal[:, 1]
        trees["lean_deg"] = np.hypot(lean_x, lean_y)
        trees["lean_towards_deg"] = np.degrees(np.arctan2(lean_y, lean_x)) % 360
        trees["crown_azimuth_deg"] = 360 * uniform[:, 0]
        trees["crown_variant"] = VARIANTS * uniform[:, 1]
        cohort_of = np.searchsorted(np.cumsum(self._shares)[:-1], uniform[:, 2], side="right")
        trees["cohort"] = cohort_of
        for i, cohort in enumerate(self._cohorts):
            own = cohort_of == i
            trees[own] = _sized(trees[own], cohort, uniform[own, 3:], normal[own, 2])
        standing: Trees = trees[self._points.survive(ix, iy)]
        return standing[self._clear_of_path(standing)]

    def _clear_of_path(self, trees: Trees) -> NDArray[np.bool_]:
        """Which stems keep their surface away from the path, from the ground to above a walker's head."""
        foot = np.column_stack([trees["x_m"], trees["y_m"]])
        towards = np.radians(trees["lean_towards_deg"])
        shift = _HEAD_ROOM_M * np.tan(np.radians(trees["lean_deg"]))
        above = foot + shift[:, None] * np.column_stack([np.cos(towards), np.sin(towards)])
        taper = tapers(trees["species"])
        radius = taper_radius_m(taper, trees["dbh_m"], trees["height_m"], np.zeros((len(trees), 1)))[:, 0]
        gap = np.minimum(distance_m(foot, self._path_xy_m), distance_m(above, self._path_xy_m)) - radius
        clear: NDArray[np.bool_] = gap >= self._clearance_m
        return clear

    def crown(self, cohort: int, crown_class: int, variant: int, level: int) -> CrownKey:
        """Name the crown prototype of a diameter class.

        Each species bears its own leaf area index on its share of the ground, which trees divide in
        proportion to their crown projection.
        """
        own = self._cohorts[cohort]
        dbh_cm = np.array([own.mix.dbh_cm * _CLASS_RATIO**crown_class])
        height_m = own.height_m(dbh_cm)
        width_m = own.species.crown_width_m(dbh_cm)
        leaf_area_m2 = own.species.leaf_area_index * self._ground_per_crown * _projection_m2(width_m)
        return CrownKey(
            species=own.species.name,
            variant=variant,
            level=level,
            dbh_m=float(dbh_cm[0]) / 100,
            height_m=float(height_m[0]),
            crown_base_m=float(own.crown_base_m(dbh_cm, height_m)[0]),
            crown_width_m=float(width_m[0]),
            leaf_area_m2=float(leaf_area_m2[0]),
        )


def _species(name: str) -> Species:
    """Row of the species table by name."""
    table = species_table()
    if name not in table:
        raise GeometryError("species", f"found {name!r}", f"one of {', '.join(table)}")
    return table[name]


def _projection_m2(crown_width_m: Array) -> Array:
    """Area of a crown seen from above."""
    return np.pi / 4 * crown_width_m**2


def _sized(trees: Trees, cohort: _Cohort, uniform: Array, normal: Array) -> Trees:
    """Give trees of one cohort their species, size and brightness, from (n, 3) uniform and (n,) normal."""
    species, mix = cohort.species, cohort.mix
    dbh_cm = cohort.dbh_cm(uniform[:, 0])
    height_m = cohort.height_m(dbh_cm) * np.exp(species.height_spread * normal)
    trees["species"] = species.number
    trees["dbh_m"] = dbh_cm / 100
    trees["height_m"] = height_m
    trees["crown_base_m"] = cohort.crown_base_m(dbh_cm, height_m)
    trees["crown_width_m"] = species.crown_width_m(dbh_cm)
    trees["crown_class"] = np.round(np.log(dbh_cm / mix.dbh_cm) / math.log(_CLASS_RATIO))
    trees["bark_reflectance"] = species.bark_reflectance + _BARK_SPREAD * (2 * uniform[:, 1] - 1)
    trees["leaf_reflectance"] = species.leaf_reflectance + _LEAF_SPREAD * (2 * uniform[:, 2] - 1)
    return trees
