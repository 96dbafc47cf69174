"""The species table: what kinds of trees and shrubs there are, and what is known of each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import GeometryError
from vlp16emu.world.allometry import (
    BIOMASS_MODELS,
    BREAST_HEIGHT_M,
    CROWN_BASE_MODELS,
    CROWN_WIDTH_MODELS,
    HEIGHT_MODELS,
    TAPER_MODELS,
    Curve,
    Taper,
    taper_radius_m,
    truncated_weibull_cm,
)
from vlp16emu.world.species_file import read_tables, record

__all__ = [
    "BREAST_HEIGHT_M",
    "Flora",
    "Foliage",
    "Habit",
    "Shrub",
    "Species",
    "Twigs",
    "flora",
    "known",
    "shrub_table",
    "species_table",
    "taper_radius_m",
    "tapers",
]

Array = NDArray[np.float64]

_Plant = TypeVar("_Plant", "Species", "Shrub")

_FIRST_OWN_NUMBER = 1000
"""Smaller numbers belong to the table that comes with the program."""

_BIOMASS_AT = 0.3
"""Relative height of the upper diameter in component biomass equations (Vonderach et al. 2018)."""


@dataclass(frozen=True, slots=True)
class Foliage:
    """One leaf, or one shoot of needles."""

    kind: Literal["leaf", "shoot"]
    """A kite-shaped blade that falls in autumn, or two crossed rectangles that stay."""
    length_m: float
    width_m: float
    clumping: float
    """One-sided leaf area over the area that is modelled."""
    spread_m: float
    """How far from its twig a leaf sits at most."""
    inclination: tuple[float, ...] = ()
    """mu and nu of the beta distribution of leaf inclination; none for shoots, which follow their twig."""


@dataclass(frozen=True, slots=True)
class Twigs:
    """How branches of the second or third order sit on those that bear them."""

    start: float
    """Share of the bearer that is bare."""
    per_m: float
    angle_deg: float
    """Between a branch and the one that bears it."""
    roll_spread_deg: float
    """Half-range about the horizontal on either side: 90 is all around, small is a comb."""
    length_share: float
    """Length over that of the bearer."""
    length_m: tuple[float, float]
    """Least and greatest length."""
    droop_deg: float


@dataclass(frozen=True, slots=True)
class Habit:
    """How a crown branches. Pairs are [crown base, crown top], straight between them."""

    base_fraction: float
    """Crown radius at the crown base over the largest."""
    widest_at: float
    """Relative height in the crown where it is widest."""
    top_power: float
    """Above that the radius falls as 1 - s^top_power: 1 is a cone, 2 a paraboloid's half-width."""
    whorl_spacing_m: float
    branches_per_whorl: int
    """1 makes a spiral."""
    rise_deg: tuple[float, float]
    """Elevation of a first-order branch where it leaves the stem."""
    droop_deg: tuple[float, float]
    """How much its elevation falls towards the tip, in proportion to the way along it."""
    upturn_deg: tuple[float, float]
    """How much it rises again, with the cube of the way along it."""
    crook_deg: float
    """One sigma of the bend from one stretch of a branch to the next."""
    dead_per_m: float
    """Dead branches on each metre of stem below the crown, where they are wanted."""
    twigs: Twigs
    twiglets: Twigs | None = None
    """Third order, for broad crowns."""


@dataclass(frozen=True, slots=True)
class Species:
    """A kind of tree. Sources stand in `species.toml`, value by value."""

    name: str
    number: int
    """In labels; never changes."""
    scientific_name: str
    height_curve: Curve
    height_spread: float
    crown_width: Curve
    crown_base: Curve
    diameters: tuple[float, float, float, float, float]
    taper: Taper
    leaf_area_index: float
    bark_reflectance: float
    leaf_reflectance: float
    leaf_transmittance: float
    crown: Habit
    foliage: Foliage | None = None
    """None on a dead tree."""
    fia: int | None = None
    """Code of the Forest Inventory and Analysis programme of the USDA Forest Service."""
    biomass: Curve | None = None

    def dbh_quantile_cm(self, probability: Array, mean_dbh_cm: float) -> Array:
        """Quantiles of the left-truncated Weibull distribution of a stand's diameters, before scaling.

        Parameters
        ----------
        probability : (n,) in [0, 1)
        mean_dbh_cm : quadratic mean diameter that the distribution is meant for
        """
        return truncated_weibull_cm(self.diameters, probability, mean_dbh_cm)

    def height_m(self, dbh_cm: Array, mean_dbh_cm: float, mean_height_m: float) -> Array:
        """Height by the species' curve through (mean_dbh_cm, mean_height_m)."""
        return HEIGHT_MODELS[self.height_curve.model][1](
            self.height_curve.coefficients, dbh_cm, mean_dbh_cm, mean_height_m
        )

    def crown_width_m(self, dbh_cm: Array) -> Array:
        """Crown width of forest-grown trees."""
        return CROWN_WIDTH_MODELS[self.crown_width.model][1](self.crown_width.coefficients, dbh_cm)

    def crown_base_m(self, dbh_cm: Array, height_m: Array, top_height_m: float) -> Array:
        """Height of the lowest living branch; `top_height_m` is that of the stand's thickest trees."""
        return CROWN_BASE_MODELS[self.crown_base.model][1](
            self.crown_base.coefficients, dbh_cm, height_m, top_height_m
        )

    def biomass_kg(self, dbh_m: Array, height_m: Array, crown_base_m: Array) -> Array:
        """Dry mass above ground (n,), NaN where no equation is known."""
        if self.biomass is None:
            return np.full(len(dbh_m), np.nan)
        rows = np.tile(self.taper.row, (len(dbh_m), 1))
        upper_m = 2 * taper_radius_m(rows, dbh_m, height_m, _BIOMASS_AT * height_m[:, None])[:, 0]
        equation = BIOMASS_MODELS[self.biomass.model][1]
        return equation(self.biomass.coefficients, 100 * dbh_m, height_m, 100 * upper_m, crown_base_m)


@dataclass(frozen=True, slots=True)
class Shrub:
    """A kind of shrub. Sources stand in `species.toml`, value by value."""

    name: str
    number: int
    """In labels; never changes, and no tree has it."""
    scientific_name: str
    height_m: tuple[float, float]
    """From small to large."""
    width_share: float
    """Width over height, as it grows by itself."""
    stems: int
    """That come out of the ground."""
    slenderness: float
    """Length of a stem over its diameter at the ground."""
    rise_deg: tuple[float, float]
    """Elevation of the outermost and of the innermost stem at the ground."""
    droop_deg: float
    """How much a stem's elevation falls towards its tip."""
    crook_deg: float
    twigs: Twigs
    foliage: Foliage
    leaf_area_index: float
    """Of the ground that the shrub covers."""
    bark_reflectance: float
    leaf_reflectance: float
    leaf_transmittance: float
    fia: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Flora:
    """All plants that a world may hold, by name, in the order of the table; a user's own come last."""

    trees: Mapping[str, Species]
    shrubs: Mapping[str, Shrub]

    @property
    def names(self) -> dict[int, str]:
        """Names of all plants by number."""
        return {plant.number: name for table in (self.trees, self.shrubs) for name, plant in table.items()}


def species_table(path: Path | None = None) -> Mapping[str, Species]:
    """All trees of `flora`."""
    return flora(path).trees


def shrub_table(path: Path | None = None) -> Mapping[str, Shrub]:
    """All shrubs of `flora`."""
    return flora(path).shrubs


@cache
def flora(path: Path | str | None = None) -> Flora:
    """Read the plants of the program, and those of a user's file after them.

    Parameters
    ----------
    path : a file of the same form as `species.toml` whose plants are to be had besides, numbered from 1000

    Raises
    ------
    GeometryError
        naming file, species and key, where the user's file is wrong
    """
    with resources.as_file(resources.files("vlp16emu.world").joinpath("species.toml")) as shipped:
        trees, shrubs = _plants(shipped)
    if path is not None:
        own_trees, own_shrubs = _plants(Path(path))
        own: list[Species | Shrub] = [*own_trees.values(), *own_shrubs.values()]
        for plant in own:
            where = f"{path}: {plant.name}"
            if plant.name in trees or plant.name in shrubs:
                raise GeometryError(where, "a plant of that name is in the table already", "another name")
            if plant.number < _FIRST_OWN_NUMBER:
                found = f"found {plant.number}"
                raise GeometryError(f"{where}: number", found, f"{_FIRST_OWN_NUMBER} or more")
        trees, shrubs = trees | own_trees, shrubs | own_shrubs
    return Flora(MappingProxyType(trees), MappingProxyType(shrubs))


def _plants(path: Path) -> tuple[dict[str, Species], dict[str, Shrub]]:
    """Trees and shrubs of one file, with numbers of their own."""
    tables = read_tables(path)
    trees = {name: _tree(row, name, f"{path}: {name}") for name, row in tables["tree"].items()}
    shrubs = {
        name: _whole(record(Shrub, row, f"{path}: {name}", name=name), f"{path}: {name}")
        for name, row in tables["shrub"].items()
    }
    taken: dict[int, str] = {}
    plants: list[Species | Shrub] = [*trees.values(), *shrubs.values()]
    for plant in plants:
        other = taken.setdefault(plant.number, plant.name)
        if other != plant.name:
            where = f"{path}: {plant.name}: number"
            raise GeometryError(where, f"found {plant.number}, which is that of {other}", "one of its own")
    return trees, shrubs


def _tree(row: dict[str, Any], name: str, where: str) -> Species:
    """One tree, whose equations are known and have as many coefficients as they need."""
    species = _whole(record(Species, row, where, name=name), where)
    equations: list[tuple[str, Curve | Taper | None, dict[str, int]]] = [
        ("height_curve", species.height_curve, _counts(HEIGHT_MODELS)),
        ("crown_width", species.crown_width, _counts(CROWN_WIDTH_MODELS)),
        ("crown_base", species.crown_base, _counts(CROWN_BASE_MODELS)),
        ("taper", species.taper, TAPER_MODELS),
        ("biomass", species.biomass, _counts(BIOMASS_MODELS)),
    ]
    for key, equation, models in equations:
        if equation is None:
            continue
        if equation.model not in models:
            expected = f"one of {', '.join(models)}"
            raise GeometryError(f"{where}: {key}: model", f"found {equation.model!r}", expected)
        if len(equation.coefficients) != models[equation.model]:
            found = f"found {len(equation.coefficients)} numbers"
            expected = f"{models[equation.model]} for {equation.model!r}"
            raise GeometryError(f"{where}: {key}: coefficients", found, expected)
    return species


def _counts(models: Mapping[str, tuple[int, object]]) -> dict[str, int]:
    """Tell how many coefficients each model has."""
    return {name: count for name, (count, _) in models.items()}


def _whole(plant: _Plant, where: str) -> _Plant:
    """See that leaves have an inclination, and that light is not made."""
    foliage = plant.foliage
    if foliage is not None and len(foliage.inclination) != 2 * (foliage.kind == "leaf"):
        expected = "mu and nu for leaves, nothing for shoots"
        raise GeometryError(f"{where}: foliage: inclination", f"found {list(foliage.inclination)}", expected)
    if plant.leaf_reflectance + plant.leaf_transmittance > 1:
        found = f"found {plant.leaf_reflectance} and {plant.leaf_transmittance}"
        raise GeometryError(f"{where}: leaf_transmittance", found, "at most 1 with leaf_reflectance")
    return plant


def known(names: Sequence[str], table: Mapping[str, _Plant], where: str) -> list[_Plant]:
    """Rows of a species table by name.

    Raises
    ------
    GeometryError
        for a name that is not in the table
    """
    for name in names:
        if name not in table:
            raise GeometryError(where, f"found {name!r}", f"one of {', '.join(table)}")
    return [table[name] for name in names]


def tapers(numbers: NDArray[np.uint16], *, table: Mapping[str, Species] | None = None) -> Array:
    """Taper by species number, (n, 12) for `taper_radius_m`; `table` is that of the program if none is given."""
    rows = {species.number: species.taper.row for species in (table or species_table()).values()}
    return np.array([rows[int(number)] for number in numbers]).reshape(-1, 12)
