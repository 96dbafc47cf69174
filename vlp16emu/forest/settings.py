"""Settings of a generated forest or a plot of given trees: ground, trees and undergrowth."""

import math
import tomllib
from collections.abc import Callable
from functools import cache
from importlib import resources
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, PlainSerializer, field_validator, model_validator

from vlp16emu.doors import Part
from vlp16emu.settings import (
    ExpectationError,
    Fraction,
    MapPoint,
    NonNegative,
    Place,
    Positive,
    Preset,
    SceneFile,
    Section,
    Seed,
    Size,
    merge_tables,
)
from vlp16emu.trees import Table
from vlp16emu.world.settings import MeshSource, Roughness, Site, Texture, WorldSection

FOREST_SITE = Part[Callable[["Woods", int], Site]]("vlp16emu.forest.make:ForestSite")

Season = Literal["leaf_on", "leaf_off"]  # with leaves, or as in winter: broadleaves bare, needles on
DENSITY_KEYS = frozenset({"stems_per_ha", "basal_area_m2_per_ha"})
"""Two measures of a storey's density; a scene gives one of them."""

LEAST_SLENDERNESS = 12.0
"""Least ratio of height to DBH of the tree of mean diameter: trees in stands have 50 to 120 and open-grown
ones 25 to 50 (Wang, Titus and LeMay 1998, "Relationships between tree slenderness coefficients and tree or
stand characteristics"); a DBH given in millimetres would give a tenth."""

_BUCKLING_M = 106.0
"""Height at which a stem of 1 m DBH buckles under its own weight: (0.49 E / (g rho)) ** (1/3) for a column
(Greenhill 1881), with E = 12 GPa and rho = 500 kg/m^3, the stiff and light end of wood; 576 trees of record
size have about a quarter of their limit (McMahon 1973, Science 179)."""

_SHARE_ERROR = 0.015  # tolerance of a sum of shares of 1: allows three shares of 0.33

MOST_STEMS_PER_HA = 5000  # greatest density of a storey, from either key


def _in_order(limits: tuple[float, float]) -> tuple[float, float]:
    if limits[0] > limits[1]:
        raise ExpectationError("the smaller number first")
    return limits


Range = Annotated[tuple[Size, Size], Field(strict=False), AfterValidator(_in_order)]


_RELIEFS: dict[str, dict[str, object]] = {
    # Smooth and rough micro-relief have 0.05 m and 0.25 m rms over wavelengths of 0.3 m to 60 m (assumption);
    # in a spectrum with exponent 3, 1 m to 12 m holds sqrt((12 - 1) / (60 - 0.3)) = 0.43 of that.
    "flat": {"hill_rms_m": 0.0, "rough_rms_m": 0.02},
    "rolling": {},
    "hilly": {"hill_rms_m": 4.0, "mounds_per_ha": 100.0},
    "rough": {"hill_rms_m": 1.5, "rough_rms_m": 0.11, "mounds_per_ha": 800.0},
}
"""Keys set by each kind of relief. Hills and mounds are assumptions: hills of 1 m rms have slopes of 4
degrees rms, hills of 4 m have 15."""


class Terrain(Preset):
    """Ground with relief: hills, roughness at the scale of a foot, and mounds."""

    presets = _RELIEFS
    preset_key = "relief"

    relief: Literal["flat", "rolling", "hilly", "rough"] = "rolling"
    """Preset of the next three keys, unless they are given too; `rolling` has their default values."""
    hill_rms_m: NonNegative = 1.0
    """Standard deviation of height over wavelengths of 30 m to 300 m."""
    rough_rms_m: NonNegative = 0.06
    """Standard deviation of height over wavelengths of 1 m to 12 m."""
    mounds_per_ha: Annotated[float, Field(ge=0, le=2500)] = 0.0
    """Mounds and hollows of up to 0.15 m, 1 m to 2 m wide."""
    pits_per_ha: Annotated[float, Field(ge=0, le=600)] = 0.0
    """Pits with a mound beside each, as left by uprooted trees: 0.2 m to 0.4 m deep and high, 2 m to 3 m
    wide."""
    trail_spacing_m: Annotated[float, Field(ge=0, le=200)] = 0.0
    """Distance between the middles of parallel trails of harvesters, each with two ruts, 0.05 m to 0.2 m deep
    and 0.5 m to 0.7 m wide, 2 m apart; 0 for none, else 10 or more. Generated trees and shrubs keep 2 m from
    their middle. Forests of Central Europe have trails every 20 m (PEFC) or 40 m (FSC)."""
    trail_towards_deg: Annotated[float, Field(ge=0, lt=360)] = 0.0
    """Direction of the trails, counter-clockwise from east."""
    slope_deg: Annotated[float, Field(ge=0, le=45)] = 0.0
    """Slope of the underlying plane, rising towards `slope_towards_deg`."""
    slope_towards_deg: Annotated[float, Field(ge=0, lt=360)] = 0.0
    """Direction of that slope, counter-clockwise from east."""

    @field_validator("trail_spacing_m")
    @classmethod
    def _check_trail_spacing(cls, spacing_m: float) -> float:
        if 0 < spacing_m < 10:
            raise ExpectationError("0 for none, or 10 or more")
        return spacing_m


class Dem(Section):
    """Heights of the ground in a file: ESRI ASCII grid (.asc), numpy array (.npy) or GeoTIFF (.tif)."""

    file: SceneFile
    """Path of the file, from the folder of the scene file."""
    cell_m: Positive | None = None
    """Edge of a cell of a .npy, whose rows run from north to south; other files contain it."""
    corner_m: Annotated[tuple[Place, Place], Field(strict=False)] | None = None
    """Easting and northing of the outer corner of the south-western cell of a .npy."""


def buckling_height_m(dbh_m: float) -> float:
    """Return the height at which a stem buckles under its own weight, which no tree reaches."""
    from vlp16emu.elementary import power  # here: it loads numba, which the check of a scene does not need

    return _BUCKLING_M * float(power(dbh_m, 2 / 3))


def buckles(dbh_m: float, height_m: float) -> bool:
    """Return True for a stem that is higher than `buckling_height_m`."""
    slenderness = height_m / _BUCKLING_M
    return slenderness * slenderness * slenderness > dbh_m * dbh_m


class SpeciesShare(Section):
    """One species of the stand."""

    species: str
    """Name in the species table, for instance `silver_birch`."""
    share: Annotated[float, Field(ge=1e-6, le=1)]
    """Share of stems; the shares of a storey sum to 1."""
    dbh_cm: Annotated[float, Field(ge=5, le=120)]
    """Quadratic mean diameter at breast height."""
    height_m: Annotated[float, Field(ge=3, le=60)]
    """Height of the tree of diameter `dbh_cm`."""

    @model_validator(mode="after")
    def _check_slenderness(self) -> Self:
        if self.height_m < LEAST_SLENDERNESS * self.dbh_cm / 100:
            expected = f"a height of {LEAST_SLENDERNESS:g} diameters or more (is dbh_cm in mm?)"
            raise ExpectationError(f"{expected} beside dbh_cm = {self.dbh_cm:g}")
        if buckles(self.dbh_cm / 100, self.height_m):
            most_m = buckling_height_m(self.dbh_cm / 100)
            expected = f"{most_m:.3g} m at most, where a stem buckles under its own weight,"
            raise ExpectationError(f"{expected} beside dbh_cm = {self.dbh_cm:g}")
        return self


class Scattered(Section):
    """Random positions, independent or with a minimum distance, as of trees that compete."""

    kind: Literal["random", "hard_core"]
    """Selects independent positions, or positions with a minimum distance."""


class Plantation(Section):
    """Planted rows, thinned to the given density."""

    kind: Literal["plantation"]
    """Selects rows."""
    row_spacing_m: Annotated[float, Field(ge=0.5, le=1000)] = 2.5
    """Distance between rows."""
    tree_spacing_m: Annotated[float, Field(ge=0.5, le=1000)] = 2.0
    """Distance of planted trees within a row."""
    azimuth_deg: Annotated[float, Field(ge=0, lt=360)] = 0.0
    """Direction of the rows, counter-clockwise from east."""


class Clusters(Section):
    """Clumps."""

    kind: Literal["clusters"]
    """Selects clumps of plants."""
    per_cluster: Annotated[float, Field(ge=1, le=100)] = 8.0
    """Mean number of plants in a clump."""
    sigma_m: Annotated[float, Field(gt=0, le=5)] = 3.0
    """Standard deviation of plants about the centre of their clump, along each axis."""


Pattern = Annotated[Scattered | Plantation | Clusters, Field(discriminator="kind")]


class Storey(Section):
    """Trees of one layer of the canopy; needs exactly one of `stems_per_ha` and `basal_area_m2_per_ha`."""

    either_or: ClassVar[frozenset[str]] = DENSITY_KEYS

    stems_per_ha: Annotated[float, Field(ge=0, le=MOST_STEMS_PER_HA)] = 0.0
    """Density of stems; instead of `basal_area_m2_per_ha`."""
    basal_area_m2_per_ha: Annotated[float, Field(ge=0, le=120)] = 0.0
    """Sum of the cross-sections of stems at breast height; instead of `stems_per_ha`."""
    species: Annotated[list[SpeciesShare], Field(min_length=1)]
    """Species of the trees, with share and size."""
    pattern: Pattern = Scattered(kind="hard_core")
    """Spatial pattern of the trees."""

    @model_validator(mode="after")
    def _check_density(self) -> Self:
        if len(DENSITY_KEYS & self.model_fields_set) != 1:
            raise ExpectationError(f"exactly one of {' and '.join(sorted(DENSITY_KEYS))} in it")
        return self

    @field_validator("species")
    @classmethod
    def _check_shares(cls, species: list[SpeciesShare]) -> list[SpeciesShare]:
        if abs(sum(row.share for row in species) - 1.0) > _SHARE_ERROR:
            raise ExpectationError("shares that sum to 1")
        return species


class Regeneration(Section):
    """Young trees with a DBH below 5 cm, or lower than breast height."""

    stems_per_ha: Annotated[float, Field(ge=0, le=20_000)] = 0.0
    """Density of young trees."""
    species: list[str] = Field(default_factory=list)
    """Species, in equal shares; by default the living species of the canopy."""
    height_m: Range = (0.5, 4.0)
    """Minimum and maximum height."""
    pattern: Pattern = Clusters(kind="clusters", per_cluster=20.0)
    """Spatial pattern of the young trees."""


class Shrubs(Section):
    """Bushes of several stems."""

    per_ha: Annotated[float, Field(ge=0, le=10_000)] = 0.0
    """Density of bushes."""
    species: Annotated[list[str], Field(min_length=1)] = Field(
        default_factory=lambda: ["hazel", "elder", "hawthorn", "dogwood", "honeysuckle"]
    )
    """Each as often."""
    pattern: Pattern = Clusters(kind="clusters", per_cluster=4.0)
    """Spatial pattern of the bushes."""


class Stones(Section):
    """Stones that lie half in the ground, 0.1 m to 1.5 m long."""

    cover: Annotated[float, Field(ge=0, le=0.3)] = 0.0
    """Share of the ground, seen from above."""


class Logs(Section):
    """Lying trunks."""

    per_ha: Annotated[float, Field(ge=0, le=2000)] = 0.0
    """Density of logs."""
    species: list[str] = Field(default_factory=list)
    """Species of the trees, in equal shares; by default the species of the canopy."""
    diameter_m: Range = (0.1, 0.5)
    """Minimum and maximum mean diameter."""
    length_m: Range = (3.0, 15.0)
    """Minimum and maximum length."""
    uprooted: Fraction = 0.15
    """Share of logs with a root plate, 1 m to 4 m wide, standing across the butt; assumption."""
    broken: Fraction = 0.25
    """Share of logs that are broken in two; assumption."""
    decayed: Fraction = 0.35
    """Share of logs without root plate that are rotten: flat, wide and sunk into the ground; assumption."""


class Stumps(Section):
    """Stumps of felled or broken trees."""

    per_ha: Annotated[float, Field(ge=0, le=5000)] = 0.0
    """Density of stumps."""
    species: list[str] = Field(default_factory=list)
    """Species of the trees, in equal shares; by default the species of the canopy."""
    diameter_m: Range = (0.2, 0.6)
    """Minimum and maximum diameter at the top."""
    height_m: Range = (0.1, 0.4)
    """Minimum and maximum height."""
    broken: Fraction = 0.2
    """Share of stumps with a jagged, hollow top, as left by broken trees and decay; assumption."""


class Grass(Section):
    """Tufts within 25 m of the path."""

    tufts_per_m2: Annotated[float, Field(ge=0, le=8)] = 0.0
    """Density of tufts."""
    height_m: Range = (0.15, 0.5)
    """Minimum and maximum height of a tuft."""


class Cover(Section):
    """Low plants that cover a share of the ground near the path."""

    cover: Annotated[float, Field(ge=0, le=0.8)] = 0.0
    """Share of the ground covered by their outlines, seen from above."""
    height_m: Range
    """Minimum and maximum height over the ground."""


class Herbs(Cover):
    """Patches of broadleaved herbs within 25 m of the path, twice as wide as high."""

    height_m: Range = (0.1, 0.3)
    """Minimum and maximum height of a patch; wood sorrel has 0.05 to 0.15 m, wood anemone 0.1 to 0.3 m, dog's
    mercury 0.15 to
    0.4 m (Stace, New Flora of the British Isles)."""


class Ferns(Cover):
    """Ferns whose fronds spread from a crown, within 25 m of the path, a little wider than high."""

    height_m: Range = (0.35, 1.0)
    """Minimum and maximum height; broad buckler-fern and male-fern have fronds of 0.3 to 1.2 m (Stace)."""


class DwarfShrubs(Cover):
    """Low bushes such as bilberry within 25 m of the path, a little wider than high."""

    height_m: Range = (0.15, 0.4)
    """Minimum and maximum height; bilberry has up to 0.6 m (Stace), under trees less."""


class Moss(Cover):
    """Cushions of moss within 12 m of the path, eight times as wide as high; labelled as ground.

    They are cast up to `near_m`; beyond, their sides are met in place of the ground.
    """

    height_m: Range = (0.03, 0.08)
    """Minimum and maximum height of a cushion; depth of feather mosses in spruce forest (assumption)."""


class Litter(Cover):
    """Heaps of litter within 12 m of the path, eight times as wide as high; labelled as ground.

    They are cast up to `near_m`.
    """

    height_m: Range = (0.03, 0.08)
    """Minimum and maximum height of a heap; assumption."""


class Ivy(Section):
    """Ivy on the stems of trees, labelled as leaf of its tree; not in the inventory's leaf area."""

    share: Fraction = 0.0
    """Share of stems with ivy."""
    height_m: Range = (1.5, 8.0)
    """Minimum and maximum height up to which it covers a stem, no higher than the crown base."""


_Near = Annotated[float, Field(ge=5)]
Near = Annotated[  # distance in m, may be infinite; JSON has no such number and holds the text "inf"
    _Near,
    Field(allow_inf_nan=True),
    BeforeValidator(lambda m: math.inf if m == "inf" else m, json_schema_input_type=_Near | Literal["inf"]),
    PlainSerializer(lambda m: "inf" if math.isinf(m) else m, when_used="json"),
]


class ModelPart(Section):
    """Label of one part of the file of a tree."""

    name: str
    """Name of the object or group (OBJ) or node (GLB)."""
    part: Literal["stem", "branch_first_order", "branch_higher_order", "leaf", "root_flare", "dead_branch"]
    """Part of the tree, for labels."""


class TreeModelFile(MeshSource):
    """A tree model from the user, which replaces the grown trees of a species, scaled to the size of each."""

    species: str
    """Species that it represents: name in the species table, or scientific name. With several models of a
    species, each tree takes a random one among the models that need the least stretching."""
    parts: list[ModelPart] = Field(default_factory=list)
    """Parts of the file that are not stem."""


class Woods(WorldSection):
    """Ground and undergrowth, for any kind of trees."""

    seed: Seed | None = None
    """Seed of ground, plants, stones and gusts; by default the scene's seed. Equal seeds give the same
    stand."""
    season: Season = "leaf_on"
    """Season: broadleaved trees and shrubs with or without leaves."""
    dead_branches: bool = True
    """True for dead branches with twigs below the crowns, on spruces nearly down to the ground."""
    crooked_stems: bool = True
    """True for stems with sweep, forks, lobes and bark from the species table; else they are straight and
    round."""
    regeneration: Regeneration = Regeneration()
    shrubs: Shrubs = Shrubs()
    stones: Stones = Stones()
    logs: Logs = Logs()
    stumps: Stumps = Stumps()
    grass: Grass = Grass()
    herbs: Herbs = Herbs()
    ferns: Ferns = Ferns()
    dwarf_shrubs: DwarfShrubs = DwarfShrubs()
    moss: Moss = Moss()
    litter: Litter = Litter()
    ivy: Ivy = Ivy()
    texture: Texture = 0.12
    """Relative variation (one sigma) of the reflectance of ground, bark and stones over patches of about 0.08
    m on bark and 0.2 m elsewhere; leaves have none, as each has its own angle. Assumption: neighbouring
    returns then scatter as with real
    sensors in rooms and streets."""
    leaf_roughness: Roughness | None = None
    """Root mean square slope of the facets of the leaves' coat; none for matt leaves. Dry leaves have 0.18 to
    0.56 (Comar et al. 2014,
    doi:10.1016/j.rse.2013.11.021), a film of water less: with 0.1, leaves seen straight on are white."""
    species_file: SceneFile | None = None
    """File with the user's plants, in the form of the program's `forest/species.toml`, numbered from 1000."""
    tree_models: list[TreeModelFile] = Field(default_factory=list)
    """Tree models from the user that replace the grown trees of a species; inventory and labels follow their
    meshes."""
    path_clearance_m: NonNegative = 0.8
    """Least distance of plants and things on the ground from the path, except roots of old trees."""
    near_m: Near = 15.0
    """Range up to which plants are cast leaf by leaf; beyond, ground and stems are exact and foliage is a
    medium of voxels made from the same plants. `inf` casts everything leaf by leaf."""
    terrain: Terrain = Terrain()
    dem: Dem | None = None
    """Ground heights from a file, in place of `terrain`."""
    origin_m: MapPoint = (0.0, 0.0, 0.0)
    """Easting, northing and height of the world's origin (0, 0, 0), for files in map coordinates."""

    has_trees: ClassVar[bool] = True

    def site(self, seed: int) -> Site:
        """Return the ground of the stand; raises GeometryError if heights cannot be read."""
        return FOREST_SITE.load()(self, seed)


@cache
def presets() -> Table:
    """All presets by name, each in the form of a `[world]` table. Sources are in `presets.toml`."""
    text = resources.files("vlp16emu.forest").joinpath("presets.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


class Wind(Section):
    """Wind through a stand; without this table, and at a speed of 0, the air is still and costs nothing."""

    speed_m_s: Annotated[float, Field(ge=0, le=12)]
    """Mean speed at the top of the canopy, roughly half the speed in the open. Trees respond linearly and do
    not break; neighbours hold their tops within half the width of a crown. Beyond `world.near_m` stems move
    and leaves do not."""
    towards_deg: Annotated[float, Field(ge=0, lt=360)] = 0.0
    """Direction towards which it blows, counter-clockwise from east."""
    turbulence_intensity: Annotated[float, Field(ge=0, le=1)] = 0.55
    """Turbulence intensity: standard deviation of the speed along the wind over the mean; 0.8 of that across.
    At the top of canopies 1.8 / 3.3 (both over the friction velocity; Raupach, Finnigan and Brunet,
    Boundary-Layer Meteorol 78, 1996)."""
    gust_length_m: Annotated[float, Field(ge=1, le=500)] = 20.0
    """Integral length of gusts along the wind: at the top of canopies about the height of the trees (same
    source)."""
    damping_ratio: Annotated[float, Field(ge=0.02, le=1)] = 0.1
    """Damping ratio of the trees' sway: whole trees have 0.08 and more, stripped ones 0.01 to 0.08 (Moore and
    Maguire, Trees 19, 2005)."""


class Forest(Woods, Storey):
    """A stand without edge on a terrain with relief."""

    kind: Literal["forest"]
    """Selects a stand without edge."""

    @model_validator(mode="before")
    @classmethod
    def with_preset(cls, table: Any) -> Any:
        """Lay a scene's `[world]` table over the preset that it names, as `merge_tables` does.

        An unknown preset changes nothing.
        """
        name = table.get("preset") if isinstance(table, dict) else None
        if not isinstance(name, str):
            return table
        left_out = DENSITY_KEYS if table.keys() & DENSITY_KEYS else frozenset[str]()
        return merge_tables(
            {key: value for key, value in presets().get(name, {}).items() if key not in left_out}, table
        )

    preset: Literal["none", "plantation", "managed_mixed", "old_growth", "wild_regrowth", "open_savanna"] = (
        "none"
    )
    """Kind of forest that sets all keys of this table that are not given."""
    storeys: Annotated[list[Storey], Field(max_length=2)] = Field(default_factory=list)
    """Storeys under the canopy, from the top down."""


class Plot(Woods):
    """A plot of measured trees."""

    kind: Literal["plot"]
    """Selects measured trees."""
    stem_list: SceneFile
    """CSV file with column names in the first line: x, y, species, dbh_cm, height_m, and more if known."""
    on_conflict: Literal["refuse", "drop", "move_path"] = "refuse"
    """Handling of stems nearer to the path than `path_clearance_m`: an error names all of them, they are
    dropped with a warning, or the path of a walk is moved around them."""
