"""Kinds of trees and shrubs with their properties, and the species table."""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PrivateAttr, ValidationError, ValidationInfo, field_validator

from vlp16emu.elementary import exp, log
from vlp16emu.errors import GeometryError
from vlp16emu.explain import explain
from vlp16emu.forest.plants.allometry import (
    Biomass,
    CrownBase,
    CrownWidth,
    HeightCurve,
    Taper,
    taper_radius_m,
)
from vlp16emu.forest.settings import Season
from vlp16emu.inputs import read_text
from vlp16emu.settings import ExpectationError, Fraction, Section, toml
from vlp16emu.types import F8, I8

Pair = Annotated[tuple[float, float], Field(strict=False)]
Text = Annotated[str, Field(min_length=1)]
Length = Annotated[float, Field(ge=0.005, le=20)]
Crook = Annotated[float, Field(ge=0, le=60)]
_BIOMASS_AT = 0.3
"""Relative height of the upper diameter in component biomass equations (Vonderach et al. 2018)."""


_VOLUME_PER_TAPER = 0.45
"""Decrease of the logarithm of a stem's volume per unit of `taper`: 0.4 to 0.5 for the species' taper
curves."""


class Foliage(Section):
    """One leaf, or one shoot of needles."""

    kind: Literal["leaf", "shoot"]
    """A kite-shaped deciduous blade, or two crossed evergreen rectangles."""
    length_m: Length
    width_m: Annotated[float, Field(ge=0.0005, le=5)]
    clumping: Annotated[float, Field(ge=0.5, le=10)]
    """One-sided leaf area over the modelled area."""
    spread_m: Annotated[float, Field(ge=0, le=2)]
    """Greatest distance of a leaf from its twig."""
    bare_share: Annotated[float, Field(ge=0, le=0.95)] = 0.0
    """Share of a twig, from its base, without leaves: the remaining leaves form a tuft."""
    inclination: Annotated[tuple[float, ...], Field(strict=False, validate_default=True)] = ()
    """Parameters mu and nu of the beta distribution of leaf inclination; none for shoots, which follow their
    twig."""

    def is_borne(self, season: Season) -> bool:
        """Return whether the foliage is present in a season: blades fall, shoots stay."""
        return season == "leaf_on" or self.kind == "shoot"

    @field_validator("inclination")
    @classmethod
    def _check_inclination(cls, inclination: tuple[float, ...], info: ValidationInfo) -> tuple[float, ...]:
        if len(inclination) != 2 * (info.data.get("kind") == "leaf"):
            raise ExpectationError("mu and nu for leaves, nothing for shoots")
        return inclination


class Twigs(Section):
    """Branches of the second or third order on their bearers."""

    start: Annotated[float, Field(ge=0, le=0.95)]
    """Share of the bearer, from its base, without branches."""
    per_m: Annotated[float, Field(ge=0.1, le=200)]
    angle_deg: float
    """Angle between a branch and its bearer."""
    roll_spread_deg: float
    """Half-range about the horizontal on either side: 90 is the full circle, a small angle gives a comb."""
    length_share: Annotated[float, Field(ge=0.01, le=2)]
    """Length over the bearer's length."""
    length_m: Annotated[tuple[Length, Length], Field(strict=False)]
    """Minimum and maximum length."""
    droop_deg: float


class OpenGrown(Section):
    """Keys of a crown's habit that differ on a tree without neighbours."""

    base_fraction: Fraction
    widest_at: Annotated[float, Field(ge=0.01, le=0.99)]
    rise_deg: Pair


class Habit(Section):
    """Branching of a crown. Pairs are [crown base, crown top], with linear interpolation."""

    base_fraction: Fraction
    """Crown radius at the crown base over the largest."""
    widest_at: Annotated[float, Field(ge=0.01, le=0.99)]
    """Relative height of the crown's greatest width."""
    top_power: Annotated[float, Field(ge=0.2, le=10)] = 1.0
    """Exponent of the radius above the widest point, 1 - s^top_power: 1 is a cone, 2 a parabola."""
    dome: Annotated[float, Field(ge=0.1, le=1)] | None = None
    """Exponent of the radius above the widest point of a domed crown, (1 - s)^dome, in place of
    `top_power`."""
    lopsided: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    """Spread of a crown's radius over its azimuths, one sigma over the mean."""
    whorl_spacing_m: Annotated[float, Field(ge=0.02, le=5)]
    branches_per_whorl: Annotated[int, Field(ge=1, le=20)]
    """Branches per whorl; 1 makes a spiral."""
    branch_area: Annotated[float, Field(ge=0.1, le=10)] = 2.0
    """Total section of all first-order branches over the stem's section at the crown base."""
    decurrent: Annotated[float, Field(ge=0, le=0.8)] = 0.0
    """Share of the crown, from its top, in which no first-order branch begins: limbs from below fill it."""
    rise_deg: Pair
    """Elevation of a first-order branch at the stem."""
    rise_spread_deg: Annotated[float, Field(ge=0, le=45)] = 6.0
    """One sigma of that elevation."""
    droop_deg: Pair
    """Decrease of its elevation towards the tip, linear in the distance along it."""
    upturn_deg: Pair
    """Increase of its elevation towards the tip, cubic in the distance along it."""
    crook_deg: Crook
    """One sigma of the bend between consecutive segments of a branch."""
    dead_per_m: Annotated[float, Field(ge=0, le=50)]
    """Branches per metre of stem directly below the crown, nearly all dead; further down some have fallen."""
    dead_reach: Fraction = 0.35
    """Share of the bole, from the crown base downwards, with remaining dead branches; at least 4 m."""
    living_depth_m: Annotated[float, Field(gt=0, le=50)] = 1.0
    """Depth below the crown over which the share of living branches falls to 1/e; at most 0.3 of the height
    of the crown base."""
    twigs: Twigs
    twiglets: Twigs | None = None
    """Third-order branches, for broad crowns."""
    open_grown: OpenGrown | None = None
    """Form of trees without neighbours; by default all trees have that of a closed stand."""

    def in_stand(self, openness: float) -> "Habit":
        """Return the habit between a closed stand, 0, and a place without neighbours, 1."""
        if self.open_grown is None or openness == 0:
            return self

        def between(closed: float, alone: float) -> float:
            """Return a value between those of closed and of open stands."""
            return closed + (alone - closed) * openness

        alone = self.open_grown
        rise_deg = tuple(map(between, self.rise_deg, alone.rise_deg))
        base_fraction = between(self.base_fraction, alone.base_fraction)
        widest_at = between(self.widest_at, alone.widest_at)
        return self.model_copy(
            update={"base_fraction": base_fraction, "widest_at": widest_at, "rise_deg": rise_deg}
        )


_LEAST_FLARE_M = 0.08
_MOST_FLARE_M = 1.0
"""Limits of the height of a root flare: the thinnest trees have a collar, and breast height is above the
flare of all but giants; assumptions."""
_MOST_SWELL_M = 0.62
"""Greatest height of a flare whose swell and lobes are as high as itself: higher ones would reach the
section at breast height, which real giants have too, but on which published tapers are scaled."""


def flare_height_m(flare_height: F8 | float, dbh_m: F8) -> F8:
    """Height (n,) of root flares, `flare_height` times the DBH."""
    return np.clip(flare_height * dbh_m, _LEAST_FLARE_M, _MOST_FLARE_M)


def swell_m(flare_m: F8) -> F8:
    """Height (n,) that scales the swell and the lobes of a butt with a root flare of these heights."""
    return np.minimum(flare_m, _MOST_SWELL_M)


class StemForm(Section):
    """Deviations of stems from a straight and round form: means over trees.

    Straight, round stems have 0 in all.
    """

    bow: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    """Greatest distance of the bole from the line between foot and crown base, over its length; at most half
    the DBH."""
    butt_sweep_deg: Annotated[float, Field(ge=0, le=30)] = 0.0
    """Extra lean of the stem at the ground compared to above the butt."""
    fork_share: Fraction = 0.0
    """Share of trees with two leaders."""
    fork_height: Annotated[tuple[Fraction, Fraction], Field(strict=False)] = (0.25, 0.6)
    """Range of the height of the fork over the height of the tree."""
    ovality: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    """Longest diameter of a section minus the perpendicular one, over the latter; without lobes and bark."""
    lobes: Annotated[float, Field(ge=0, le=0.3)] = 0.0
    """Amplitude of the root lobes of the butt at the ground, over the radius there."""
    flare_height: Annotated[float, Field(ge=0.2, le=5)] = 1.2
    """Height of the root flare over the DBH. The flare grows with the DBH: its diameter does in ten species
    with R2 of 0.81 and more (Hilbert et al. 2020, Urban Forestry & Urban Greening 49), and with its shape
    decides how high 202 spruces could be felled (Labelle et al. 2018, 10.3390/f9110709)."""
    surface_roots: Fraction = 0.0
    """Share of lobes from which a root runs over the ground, for trees with a DBH over 0.3 m."""
    bark_mm_per_cm: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Depth of furrows, from ridge to bottom at breast height, per cm of DBH: bark becomes rougher with
    age."""
    bark_period_mm: Annotated[float, Field(ge=5, le=1000)] = 50.0
    """Distance between bark ridges around the stem; coarser if the mesh has fewer than three vertices per
    ridge."""

    @property
    def row(self) -> F8:
        """Row (11,) of all numbers in order."""
        return np.hstack([getattr(self, name) for name in type(self).model_fields])


class Spread(Section):
    """Residual spread of trees of one diameter about their species' curves, one sigma."""

    height: Fraction = 0.06
    """Spread of the logarithm of the height."""
    crown_ratio: Annotated[float, Field(ge=0, le=2)] = 0.3
    """Spread of the logit of crown length over height."""
    crown_width: Fraction = 0.16
    """Spread of the logarithm of the crown width."""
    form: Annotated[float, Field(ge=0, le=0.3)] = 0.08
    """Spread of the logarithm of the stem's volume at a given diameter and height."""


class Champion(Section):
    """Height and DBH of the tallest and of the thickest known tree of a species, which may be two trees.

    By default the largest of all: coast redwood has 116 m, Montezuma cypress more than 5 m.
    """

    height_m: Annotated[float, Field(ge=2, le=130)] = 130.0
    dbh_cm: Annotated[float, Field(ge=1, le=500)] = 500.0


class Plant(Section):
    """Common keys of trees and shrubs. Sources are in `species.toml`, value by value."""

    number: Annotated[int, Field(ge=1, le=65535)]
    """Number in labels; unique and never changed."""
    scientific_name: Text
    leaf_area_index: Annotated[float, Field(ge=0, le=20)]
    """Leaf area index of a closed stand, or of the ground that a shrub covers."""
    bark_reflectance: Fraction
    leaf_reflectance: Fraction
    _name: str = PrivateAttr()

    def model_post_init(self, context: Any, /) -> None:
        """Take the name from the table's key in the file."""
        self._name = context["name"]

    @property
    def name(self) -> str:
        """Name in the table."""
        return self._name

    @field_validator("number")
    @classmethod
    def _check_number(cls, number: int, info: ValidationInfo) -> int:
        first = info.context["first_number"] if info.context else 1
        if number < first:
            raise ExpectationError(f"{first} or more")
        return number


class Species(Plant):
    """A kind of tree."""

    height_curve: HeightCurve
    spread: Spread = Spread()
    champion: Champion = Champion()
    crown_width: CrownWidth
    crown_base: CrownBase
    open_crown: Pair = (0.1783, 0.5665)
    """Coefficients ln a and b of the open-grown crown width a dbh_cm^b, Hasenauer (1997); by default other
    broadleaves'."""
    diameters: Annotated[tuple[float, float, float, float, float], Field(strict=False)]
    """Coefficients of `truncated_weibull_cm`."""
    taper: Taper
    stem: StemForm = StemForm()
    lean_deg: Annotated[float, Field(ge=0, le=15)] = 1.5
    """One sigma of a stem's lean along each level axis; assumption."""
    crown: Habit
    foliage: Foliage | None = None  # none on a dead tree
    biomass: Biomass | None = None

    def crown_width_m(self, dbh_cm: F8, residual: F8 | None = None) -> F8:
        """Crown width of forest-grown trees.

        Residuals (n,) are in sigmas, and without them the mean is returned.
        """
        if residual is None:
            return self.crown_width(dbh_cm)
        sigma = self.spread.crown_width
        return self.crown_width(dbh_cm) * exp(sigma * residual - sigma * sigma / 2)

    def openness(self, ccf_percent: F8) -> F8:
        """How open-grown trees (n,) are under a crown competition factor: 1 below 50 %, 0 above 150 %.

        At 100 % the crowns of open-grown trees would just touch (Krajicek et al. 1961, Forest Science 7); the
        limits are assumptions. Species without an open-grown form have 0.
        """
        if self.crown.open_grown is None:
            return np.zeros(np.shape(ccf_percent))
        return np.clip(1.5 - np.asarray(ccf_percent) / 100, 0.0, 1.0)

    def widening(self, dbh_cm: F8, openness: F8) -> F8:
        """Crown width (n,) over that of forest-grown trees, between those and open-grown ones."""
        log_a, b = self.open_crown
        alone = exp(log_a + b * log(dbh_cm)) / self.crown_width(dbh_cm)
        return 1 + (np.maximum(alone, 1.0) - 1) * openness

    def crown_base_m(self, dbh_cm: F8, height_m: F8, rivals: tuple[F8, F8], residual: F8 | float = 0.0) -> F8:
        """Height of the lowest living branch, under `competition`.

        Residuals (n,) of the crown ratio are in sigmas.
        """
        logit = self.crown_base(dbh_cm, height_m, *rivals) - self.spread.crown_ratio * residual
        return height_m / (1 + exp(-logit))

    def competition_m2(self, dbh_cm: F8) -> F8:
        """Return competition areas (n, 2) in m2: section at breast height, open-grown crown projection.

        Dead trees have 0.
        """
        log_a, b = self.open_crown
        sizes_m = np.column_stack([dbh_cm / 100, exp(log_a + b * log(dbh_cm))])
        return np.pi / 4 * np.square(sizes_m) * (self.foliage is not None)

    def taper_of(self, residual: F8) -> F8:
        """Taper numbers (n,) of stems from volume residuals (n,) in sigmas: more taper is less volume."""
        return -self.spread.form / _VOLUME_PER_TAPER * residual

    def biomass_kg(self, dbh_m: F8, height_m: F8, crown_base_m: F8, taper: F8 | float = 0.0) -> F8:
        """Dry mass above ground (n,), NaN without a known equation; `taper` (n,) is each tree's own."""
        if self.biomass is None:
            return np.full(len(dbh_m), np.nan)
        rows = self.taper_rows(dbh_m)
        rows[:, -1] = taper
        upper_m = 2 * taper_radius_m(rows, dbh_m, height_m, _BIOMASS_AT * height_m[:, None])[:, 0]
        mass_kg = self.biomass(100 * dbh_m, height_m, 100 * upper_m, crown_base_m)
        if self.biomass.model == "components":
            return mass_kg
        # These equations know no upper diameter: a stem with more volume than its species' curve weighs
        # more. Of 127 birches total mass at a DBH and height has a spread of 8.9 % (Repola 2008, Silva
        # Fennica 42(4), model 1), the volume of birch stems 8.2 % (Laasasenaho 1982).
        return mass_kg * exp(-_VOLUME_PER_TAPER * np.broadcast_to(taper, len(dbh_m)))

    def flare_m(self, dbh_m: F8) -> F8:
        """Height (n,) of root flares above the ground."""
        return flare_height_m(self.stem.flare_height, dbh_m)

    def taper_rows(self, dbh_m: F8) -> F8:
        """Tapers (n, 13) for `taper_radius_m` of stems without taper of their own."""
        rows = np.tile(self.taper.row, (len(dbh_m), 1))
        rows[:, 3] *= swell_m(self.flare_m(dbh_m))
        return rows


class Shrub(Plant):
    """A kind of shrub."""

    height_m: Pair  # from small to large
    width_share: float  # width over height, free-standing
    stems: Annotated[int, Field(ge=1, le=100)]  # number of stems at the ground
    slenderness: float  # length of a stem over its diameter at the ground
    rise_deg: Pair  # elevation of the outermost and of the innermost stem at the ground
    droop_deg: float  # decrease of a stem's elevation towards its tip
    crook_deg: Crook
    twigs: Twigs
    foliage: Foliage


Trees = NDArray[np.void]
Table = Mapping[str, Species]
_Kind = TypeVar("_Kind", bound=Plant)
_FIRST_OWN_NUMBER = 1000  # smaller numbers belong to the program's own table


@dataclass(frozen=True, eq=False)
class Flora:
    """All plants that a world may hold, by name, in the order of the table; the user's plants come last."""

    trees: Mapping[str, Species]
    shrubs: Mapping[str, Shrub]

    @property
    def names(self) -> dict[int, str]:
        """Names of all plants by number."""
        return {plant.number: name for table in (self.trees, self.shrubs) for name, plant in table.items()}

    @property
    def materials(self) -> tuple[str, ...]:
        """All materials by number: ground materials, then bark and leaf of each tree and shrub."""
        return (
            *GROUND_MATERIALS,
            *(f"{name} {part}" for name in self.names.values() for part in ("bark", "leaf")),
        )

    @cached_property
    def bark(self) -> I8:
        """Material number of the bark by species number; the leaf has the next number."""
        numbers = list(self.names)
        material = np.zeros(max(numbers) + 1, np.int64)
        material[numbers] = len(GROUND_MATERIALS) + 2 * np.arange(len(numbers))
        return material


@cache
def flora(path: Path | str | None = None) -> Flora:
    """Read the program's plants, followed by a user's file of the same form, numbered from 1000.

    Raises GeometryError, naming file, species and key, if the user's file is wrong.
    """
    with resources.as_file(resources.files("vlp16emu.forest").joinpath("species.toml")) as shipped:
        trees, shrubs = _plants(shipped, 1)
    if path is not None:
        own_trees, own_shrubs = _plants(Path(path), _FIRST_OWN_NUMBER)
        for name in (*own_trees, *own_shrubs):
            if name in trees or name in shrubs:
                found = "a plant of that name is in the table already"
                raise GeometryError(f"{path}: {name}", found, "another name")
        trees = trees | own_trees
        shrubs = shrubs | own_shrubs
    return Flora(MappingProxyType(trees), MappingProxyType(shrubs))


def _plants(path: Path, first_number: int) -> tuple[dict[str, Species], dict[str, Shrub]]:
    text = read_text(path, "a species file", GeometryError)
    try:
        tables = toml(text)
    except (ValueError, RecursionError) as error:
        raise GeometryError(str(path), str(error), "TOML") from None
    for kind in tables.keys() - {"tree", "shrub"}:
        raise GeometryError(f"{path}: [{kind}]", "unknown table", "[tree.NAME] or [shrub.NAME]")
    trees = _of_kind(Species, path, "tree", tables.get("tree", {}), first_number)
    shrubs = _of_kind(Shrub, path, "shrub", tables.get("shrub", {}), first_number)
    plant_of: dict[int, str] = {}
    for plant in (*trees.values(), *shrubs.values()):
        if (first_plant := plant_of.setdefault(plant.number, plant.name)) != plant.name:
            where = f"{path}: {plant.name}.number"
            raise GeometryError(where, f"found {plant.number}, the number of {first_plant}", "one of its own")
    return trees, shrubs


def _of_kind(section: type[_Kind], path: Path, kind: str, rows: Any, first_number: int) -> dict[str, _Kind]:
    plants = {}
    for name, row in rows.items() if isinstance(rows, dict) else [("", rows)]:
        if not isinstance(row, dict):
            raise GeometryError(f"{path}: {kind}.{name}", f"found {row!r:.80}", f"a table [{kind}.NAME]")
        try:
            plants[name] = section.model_validate(row, context={"name": name, "first_number": first_number})
        except ValidationError as error:
            key, found, expected = explain(error, section.model_json_schema())
            raise GeometryError(f"{path}: {kind}.{name}.{key}", found, expected) from None
    return plants


def find_species(names: Sequence[str], table: Mapping[str, _Kind], where: str) -> list[_Kind]:
    """Return rows of a species table by common or scientific name, regardless of case and white space.

    Raises GeometryError for a name that is not in the table.
    """
    # The first two words of a scientific name: without the author.
    latin = {" ".join(_plain(row.scientific_name).split()[:2]): row for row in table.values()}
    rows = latin | {_plain(row.name): row for row in table.values()}
    for name in names:
        if _plain(name) not in rows:
            near = difflib.get_close_matches(_plain(name), rows, n=1)
            expected = (
                f"{rows[near[0]].name}, the nearest known one" if near else f"one of {', '.join(table)}"
            )
            raise GeometryError(where, f"unknown species {name!r}", expected)
    return [rows[_plain(name)] for name in names]


def _plain(name: str) -> str:
    return " ".join(name.replace("_", " ").replace("-", " ").lower().split())


def tapers(trees: Trees, *, table: Table | None = None) -> F8:
    """Return the tapers (n, 13) of trees (n,) `TREE` for `taper_radius_m`.

    `table` defaults to the program's.
    """
    taper = np.zeros((len(trees), 13))
    for species in (table or flora().trees).values():
        is_species = trees["species"] == species.number
        taper[is_species] = species.taper_rows(trees["dbh_m"][is_species])
    taper[:, -1] = trees["taper"]
    return taper


def flares_m(trees: Trees, *, table: Table | None = None) -> F8:
    """Return the heights (n,) of the root flares of trees (n,) `TREE` over their feet."""
    share = {species.number: species.stem.flare_height for species in (table or flora().trees).values()}
    return flare_height_m(np.array([share[number] for number in trees["species"].tolist()]), trees["dbh_m"])


GROUND_MATERIALS = ("litter", "stone", "dead wood", "grass", "herb", "fern", "dwarf shrub", "moss")
"""Names of the first materials."""
BARK_SPREAD = 0.08
LEAF_SPREAD = 0.04
"""Half-range of reflectance between plants; assumptions (Juola et al. 2020 find a wide spread in the near
infrared)."""
