"""Kinds of trees and shrubs, and what is known of each."""

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, PrivateAttr, ValidationInfo, field_validator

from vlp16emu.elementary import exp, log
from vlp16emu.forest.plants.allometry import Biomass, CrownBase, CrownWidth, HeightCurve, Taper, taper_radius_m
from vlp16emu.forest.settings import Season
from vlp16emu.settings import Fraction, Section
from vlp16emu.types import Array

Pair = Annotated[tuple[float, float], Field(strict=False)]
Text = Annotated[str, Field(min_length=1)]
Length = Annotated[float, Field(ge=0.005, le=20)]
Crook = Annotated[float, Field(ge=0, le=60)]
_BIOMASS_AT = 0.3  # relative height of the upper diameter in component biomass equations (Vonderach et al. 2018)


_VOLUME_PER_TAPER = 0.45
"""Fall of the logarithm of a stem's volume for each unit of `taper`: 0.4 to 0.5 for the taper curves of the species."""


class Foliage(Section):
    """One leaf, or one shoot of needles."""

    kind: Literal["leaf", "shoot"]
    """A kite-shaped blade that falls in autumn, or two crossed rectangles that stay."""
    length_m: Length
    width_m: Annotated[float, Field(ge=0.0005, le=5)]
    clumping: Annotated[float, Field(ge=0.5, le=10)]
    """One-sided leaf area over the area that is modelled."""
    spread_m: Annotated[float, Field(ge=0, le=2)]
    """Greatest distance of a leaf from its twig."""
    bare_share: Annotated[float, Field(ge=0, le=0.95)] = 0.0
    """Share of a twig, from its base, whose leaves have fallen: those that are left sit in a tuft."""
    inclination: Annotated[tuple[float, ...], Field(strict=False, validate_default=True)] = ()
    """mu and nu of the beta distribution of leaf inclination; none for shoots, which follow their twig."""

    def is_borne(self, season: Season) -> bool:
        """Return True if it is on the plant in a season: blades fall, shoots stay."""
        return season == "leaf_on" or self.kind == "shoot"

    @field_validator("inclination")
    @classmethod
    def _of_leaves(cls, inclination: tuple[float, ...], info: ValidationInfo) -> tuple[float, ...]:
        if len(inclination) != 2 * (info.data.get("kind") == "leaf"):
            raise ValueError("mu and nu for leaves, nothing for shoots")
        return inclination


class Twigs(Section):
    """Branches of the second or third order on their bearers."""

    start: Annotated[float, Field(ge=0, le=0.95)]
    """Share of the bearer that is bare."""
    per_m: Annotated[float, Field(ge=0.1, le=200)]
    angle_deg: float
    """Between a branch and the one that bears it."""
    roll_spread_deg: float
    """Half-range about the horizontal on either side: 90 is all around, small is a comb."""
    length_share: Annotated[float, Field(ge=0.01, le=2)]
    """Length over that of the bearer."""
    length_m: Annotated[tuple[Length, Length], Field(strict=False)]
    """Least and greatest length."""
    droop_deg: float


class Habit(Section):
    """Branching of a crown. Pairs are [crown base, crown top], straight between them."""

    base_fraction: Fraction
    """Crown radius at the crown base over the largest."""
    widest_at: Annotated[float, Field(ge=0.01, le=0.99)]
    """Relative height in the crown where it is widest."""
    top_power: Annotated[float, Field(ge=0.2, le=10)]
    """Above that the radius falls as 1 - s^top_power: 1 is a cone, 2 a paraboloid's half-width."""
    whorl_spacing_m: Annotated[float, Field(ge=0.02, le=5)]
    branches_per_whorl: Annotated[int, Field(ge=1, le=20)]
    """1 makes a spiral."""
    branch_area: Annotated[float, Field(ge=0.1, le=10)] = 2.0
    """Sections of all branches of the first order together over that of the stem at the crown base."""
    rise_deg: Pair
    """Elevation of a first-order branch where it leaves the stem."""
    droop_deg: Pair
    """How much its elevation falls towards the tip, in proportion to the distance along it."""
    upturn_deg: Pair
    """How much it rises again, with the cube of the distance along it."""
    crook_deg: Crook
    """One sigma of the bend from one stretch of a branch to the next."""
    dead_per_m: Annotated[float, Field(ge=0, le=50)]
    """Branches on each metre of stem right below the crown, nearly all dead; further down some have fallen."""
    dead_reach: Fraction = 0.35
    """Share of the way from the crown base to the ground down to which dead branches have not all fallen; 4 m at least."""
    living_depth_m: Annotated[float, Field(gt=0, le=50)] = 1.0
    """Each so much further down, of the branches below the crown a share of 1/e of those above lives; 0.3 of the height of the
    crown base at most."""
    twigs: Twigs
    twiglets: Twigs | None = None
    """Third order, for broad crowns."""


class StemForm(Section):
    """Deviations of stems from straight and round ones: means over trees, nothing where all are 0."""

    bow: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    """Distance of the bole from the line between its foot and the crown base, where that is greatest, over its length; half
    the DBH at most."""
    butt_sweep_deg: Annotated[float, Field(ge=0, le=30)] = 0.0
    """How much more a stem leans at the ground than above the butt."""
    fork_share: Fraction = 0.0
    """Share of trees with two leaders."""
    fork_height: Annotated[tuple[Fraction, Fraction], Field(strict=False)] = (0.25, 0.6)
    """Lowest and highest fork over the height of the tree."""
    ovality: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    """Longest diameter of a section less the one across it, over the latter; without lobes and bark."""
    lobes: Annotated[float, Field(ge=0, le=0.3)] = 0.0
    """Amplitude of the lobes that roots make of the butt, at the ground, over the radius there."""
    surface_roots: Fraction = 0.0
    """Share of the lobes from which a root runs over the ground, of trees with a DBH over 0.3 m."""
    bark_mm_per_cm: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Depth of furrows, from ridge to bottom at breast height, for each cm of DBH: bark grows rougher with age."""
    bark_period_mm: Annotated[float, Field(ge=5, le=1000)] = 50.0
    """From ridge to ridge around the stem; coarser where the mesh has fewer than three vertices to a ridge."""

    @property
    def row(self) -> Array:
        """(10,) of all numbers in order."""
        return np.hstack([getattr(self, name) for name in type(self).model_fields])


class Spread(Section):
    """Residual spread of trees of one diameter about the curves of their species, one sigma."""

    height: Fraction = 0.06
    """Of the logarithm of the height."""
    crown_ratio: Annotated[float, Field(ge=0, le=2)] = 0.3
    """Of the logit of the crown length over the height."""
    crown_width: Fraction = 0.16
    """Of the logarithm of the crown width."""
    form: Annotated[float, Field(ge=0, le=0.3)] = 0.08
    """Of the logarithm of the stem's volume at a given diameter and height."""


class Plant(Section):
    """Common keys of trees and shrubs. Sources are in `species.toml`, value by value."""

    number: Annotated[int, Field(ge=1, le=65535)]
    """In labels; never changes, and no other plant has it."""
    scientific_name: Text
    fia: Annotated[int, Field(ge=1, le=9999)] | None = None
    """Code of the Forest Inventory and Analysis programme of the USDA Forest Service."""
    leaf_area_index: Annotated[float, Field(ge=0, le=20)]
    """Of a closed stand, or of the ground that a shrub covers."""
    bark_reflectance: Fraction
    leaf_reflectance: Fraction
    leaf_transmittance: Fraction
    _name: str = PrivateAttr()

    def model_post_init(self, context: Any, /) -> None:
        """Take the name, which is the table's own in the file."""
        self._name = context["name"]

    @property
    def name(self) -> str:
        """Name in the table."""
        return self._name

    @field_validator("number")
    @classmethod
    def _is_free(cls, number: int, info: ValidationInfo) -> int:
        first = info.context["first_number"] if info.context else 1
        if number < first:
            raise ValueError(f"{first} or more")
        return number

    @field_validator("leaf_transmittance")
    @classmethod
    def _makes_no_light(cls, transmittance: float, info: ValidationInfo) -> float:
        reflectance = info.data.get("leaf_reflectance", 0.0)  # absent where it is itself in error
        if reflectance + transmittance > 1:
            raise ValueError(f"at most 1 with leaf_reflectance = {reflectance:g}")
        return transmittance


class Species(Plant):
    """A kind of tree."""

    height_curve: HeightCurve
    spread: Spread = Spread()
    crown_width: CrownWidth
    crown_base: CrownBase
    open_crown: Pair = (0.1783, 0.5665)
    """ln a and b of the crown width a dbh_cm^b of open-grown trees, Hasenauer (1997); those of other broadleaves if not given."""
    diameters: Annotated[tuple[float, float, float, float, float], Field(strict=False)]
    """Coefficients of `truncated_weibull_cm`."""
    taper: Taper
    stem: StemForm = StemForm()
    crown: Habit
    foliage: Foliage | None = None
    """None on a dead tree."""
    biomass: Biomass | None = None

    def crown_width_m(self, dbh_cm: Array, residual: Array | None = None) -> Array:
        """Crown width of forest-grown trees; residuals (n,) are in sigmas, and without them it is the mean."""
        if residual is None:
            return self.crown_width(dbh_cm)
        sigma = self.spread.crown_width
        return self.crown_width(dbh_cm) * exp(sigma * residual - sigma * sigma / 2)

    def crown_base_m(
        self, dbh_cm: Array, height_m: Array, rivals: tuple[Array, Array], residual: Array | float = 0.0
    ) -> Array:
        """Height of the lowest living branch, under `competition`; residuals (n,) of the crown ratio are in sigmas."""
        logit = self.crown_base(dbh_cm, height_m, *rivals) - self.spread.crown_ratio * residual
        return height_m / (1 + exp(-logit))

    def rival_m2(self, dbh_cm: Array) -> Array:
        """Return what trees compete with, (n, 2) in m2: section at breast height, crown projection if open-grown; 0 of dead ones."""
        log_a, b = self.open_crown
        sizes_m = np.column_stack([dbh_cm / 100, exp(log_a + b * log(dbh_cm))])
        return np.pi / 4 * np.square(sizes_m) * (self.foliage is not None)

    def taper_of(self, residual: Array) -> Array:
        """`taper` (n,) of stems whose volume has residuals (n,), in sigmas: more taper is less volume."""
        return -self.spread.form / _VOLUME_PER_TAPER * residual

    def biomass_kg(self, dbh_m: Array, height_m: Array, crown_base_m: Array, taper: Array | float = 0.0) -> Array:
        """Dry mass above ground (n,), NaN where no equation is known; `taper` (n,) is each tree's own."""
        if self.biomass is None:
            return np.full(len(dbh_m), np.nan)
        rows = np.tile(self.taper.row, (len(dbh_m), 1))
        rows[:, -1] = taper
        upper_m = 2 * taper_radius_m(rows, dbh_m, height_m, _BIOMASS_AT * height_m[:, None])[:, 0]
        return self.biomass(100 * dbh_m, height_m, 100 * upper_m, crown_base_m)


class Shrub(Plant):
    """A kind of shrub."""

    height_m: Pair
    """From small to large."""
    width_share: float
    """Width over height, as it grows by itself."""
    stems: Annotated[int, Field(ge=1, le=100)]
    """That come out of the ground."""
    slenderness: float
    """Length of a stem over its diameter at the ground."""
    rise_deg: Pair
    """Elevation of the outermost and of the innermost stem at the ground."""
    droop_deg: float
    """How much a stem's elevation falls towards its tip."""
    crook_deg: Crook
    twigs: Twigs
    foliage: Foliage
