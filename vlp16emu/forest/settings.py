"""A forest that grows itself, or a plot of given trees: its ground, how many trees, and what grows and lies under them."""

import math
import tomllib
from functools import cache
from importlib import resources
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, PlainSerializer, field_validator, model_validator

from vlp16emu.settings import (
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
    Table,
    merged,
)
from vlp16emu.world.settings import MeshSource, Texture, WorldSection

Season = Literal["leaf_on", "leaf_off"]  # with leaves, or as in winter: broadleaves bare, needles on
DENSITY_KEYS = frozenset({"stems_per_ha", "basal_area_m2_per_ha"})
"""Two measures of how dense a storey is; a scene that gives one does not want the other."""

LEAST_SLENDERNESS = 12.0
"""Height over DBH, at least, of the tree of mean diameter: trees in stands have 50 to 120 and open-grown ones 25 to 50 (Wang, Titus and
LeMay 1998, "Relationships between tree slenderness coefficients and tree or stand characteristics"), with a DBH in millimetres a tenth."""

_SHARE_ERROR = 0.015  # by which shares may fail to sum to 1: three of 0.33 do

MOST_STEMS_PER_HA = 5000  # greatest density of a storey, whichever key gives it


def _in_order(limits: tuple[float, float]) -> tuple[float, float]:
    if limits[0] > limits[1]:
        raise ValueError("the smaller number first")
    return limits


Range = Annotated[tuple[Size, Size], Field(strict=False), AfterValidator(_in_order)]


_RELIEFS: dict[str, dict[str, object]] = {
    # Smooth and rough micro-relief have 0.05 m and 0.25 m rms over wavelengths of 0.3 m to 60 m (assumption);
    # of a spectrum of the third power, 1 m to 12 m holds sqrt((12 - 1) / (60 - 0.3)) = 0.43 of that.
    "flat": {"hill_rms_m": 0.0, "rough_rms_m": 0.02},
    "rolling": {},
    "hilly": {"hill_rms_m": 4.0, "mounds_per_ha": 100.0},
    "rough": {"hill_rms_m": 1.5, "rough_rms_m": 0.11, "mounds_per_ha": 800.0},
}
"""Keys that each kind of relief gives. Hills and mounds are assumptions: hills of 1 m rms slope by 4 degrees rms,
of 4 m by 15."""


class Terrain(Preset):
    """Ground with relief: hills, roughness that a foot would feel, and mounds."""

    presets = _RELIEFS
    preset_key = "relief"

    relief: Literal["flat", "rolling", "hilly", "rough"] = "rolling"
    """Gives those of the next three keys that are not given beside it; `rolling` is as they are by default."""
    hill_rms_m: NonNegative = 1.0
    """Standard deviation of height over wavelengths of 30 m to 300 m."""
    rough_rms_m: NonNegative = 0.06
    """Standard deviation of height over wavelengths of 1 m to 12 m."""
    mounds_per_ha: Annotated[float, Field(ge=0, le=2500)] = 0.0
    """Mounds and hollows of up to 0.15 m, 1 m to 2 m wide."""
    pits_per_ha: Annotated[float, Field(ge=0, le=600)] = 0.0
    """Pits with a mound beside each, as uprooted trees leave them: 0.2 m to 0.4 m deep and high, 2 m to 3 m wide."""
    trail_spacing_m: Annotated[float, Field(ge=0, le=200)] = 0.0
    """Distance between the middles of parallel trails of harvesters, each with two ruts, 0.05 m to 0.2 m deep and 0.5 m to 0.7 m
    wide, 2 m apart; 0 for none, else 10 or more. Trees and shrubs that grow keep 2 m off their middles. Forests of Central Europe have
    trails every 20 m (PEFC) or 40 m (FSC)."""
    trail_towards_deg: Annotated[float, Field(ge=0, lt=360)] = 0.0
    """Direction of the trails, counter-clockwise from east."""
    slope_deg: Annotated[float, Field(ge=0, le=45)] = 0.0
    """Slope of the plane under it all, rising towards `slope_towards_deg`."""
    slope_towards_deg: Annotated[float, Field(ge=0, lt=360)] = 0.0
    """Direction of that slope, counter-clockwise from east."""

    @field_validator("trail_spacing_m")
    @classmethod
    def _leaves_room(cls, spacing_m: float) -> float:
        if 0 < spacing_m < 10:
            raise ValueError("0 for none, or 10 or more")
        return spacing_m


class Dem(Section):
    """Heights of the ground in a file: ESRI ASCII grid (.asc), numpy array (.npy) or GeoTIFF (.tif)."""

    file: SceneFile
    """Path of the file, from the folder of the scene file."""
    cell_m: Positive | None = None
    """Edge of a cell of a .npy, whose rows run from north to south; other files say it themselves."""
    corner_m: Annotated[tuple[Place, Place], Field(strict=False)] | None = None
    """Easting and northing of the outer corner of the south-western cell of a .npy."""


class SpeciesShare(Section):
    """One species of the stand."""

    species: str
    """Name in the species table, for instance `silver_birch`."""
    share: Annotated[float, Field(ge=1e-6, le=1)]
    """Share of stems; those of a storey sum to 1."""
    dbh_cm: Annotated[float, Field(ge=5, le=120)]
    """Quadratic mean diameter at breast height."""
    height_m: Annotated[float, Field(ge=3, le=60)]
    """Height of the tree of that diameter."""

    @model_validator(mode="after")
    def _slender(self) -> Self:
        if self.height_m < LEAST_SLENDERNESS * self.dbh_cm / 100:
            expected = f"a height of {LEAST_SLENDERNESS:g} diameters or more (is dbh_cm in mm?)"
            raise ValueError(f"{expected} beside dbh_cm = {self.dbh_cm:g}")
        return self


class Scattered(Section):
    """Places that know nothing of each other, or keep apart as those of trees which compete."""

    kind: Literal["random", "hard_core"]
    """Selects places independent of each other, or such as keep a distance."""


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
    """Mean number of plants of a clump."""
    sigma_m: Annotated[float, Field(gt=0, le=5)] = 3.0
    """Standard deviation of plants about the middle of their clump, along either axis."""


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
    """How the trees are spread over the ground."""

    @model_validator(mode="after")
    def _one_density(self) -> Self:
        if len(DENSITY_KEYS & self.model_fields_set) != 1:
            raise ValueError(f"exactly one of {' and '.join(sorted(DENSITY_KEYS))} in it")
        return self

    @field_validator("species")
    @classmethod
    def _whole(cls, species: list[SpeciesShare]) -> list[SpeciesShare]:
        if abs(sum(one.share for one in species) - 1.0) > _SHARE_ERROR:
            raise ValueError("shares that sum to 1")
        return species


class Regeneration(Section):
    """Young trees that are thinner than 5 cm at breast height, or do not reach it."""

    stems_per_ha: Annotated[float, Field(ge=0, le=20_000)] = 0.0
    """Density of young trees."""
    species: list[str] = Field(default_factory=list)
    """Each as often; if none is named, those of the canopy that live."""
    height_m: Range = (0.5, 4.0)
    """Minimum and maximum height."""
    pattern: Pattern = Clusters(kind="clusters", per_cluster=20.0)
    """How the young trees are spread over the ground."""


class Shrubs(Section):
    """Bushes of several stems."""

    per_ha: Annotated[float, Field(ge=0, le=10_000)] = 0.0
    """Density of bushes."""
    species: Annotated[list[str], Field(min_length=1)] = Field(
        default_factory=lambda: ["hazel", "elder", "hawthorn", "dogwood", "honeysuckle"]
    )
    """Each as often."""
    pattern: Pattern = Clusters(kind="clusters", per_cluster=4.0)
    """How the bushes are spread over the ground."""


class Stones(Section):
    """Stones that lie half in the ground, 0.1 m to 1.5 m long."""

    cover: Annotated[float, Field(ge=0, le=0.3)] = 0.0
    """Share of the ground, seen from above."""


class Logs(Section):
    """Lying trunks."""

    per_ha: Annotated[float, Field(ge=0, le=2000)] = 0.0
    """Density of logs."""
    species: list[str] = Field(default_factory=list)
    """Species of the trees, each as often; if none is named, those of the canopy."""
    diameter_m: Range = (0.1, 0.5)
    """Minimum and maximum mean diameter."""
    length_m: Range = (3.0, 15.0)
    """Minimum and maximum length."""
    uprooted: Fraction = 0.15
    """Share of logs whose butt has its root plate, 1 m to 4 m wide, standing across it; assumption."""
    broken: Fraction = 0.25
    """Share of logs that lie in two pieces; assumption."""
    decayed: Fraction = 0.35
    """Share of those without root plate that are rotten: flat, wide and sunk into the ground; assumption."""


class Stumps(Section):
    """Stumps of trees that were felled or broke."""

    per_ha: Annotated[float, Field(ge=0, le=5000)] = 0.0
    """Density of stumps."""
    species: list[str] = Field(default_factory=list)
    """Species of the trees, each as often; if none is named, those of the canopy."""
    diameter_m: Range = (0.2, 0.6)
    """Minimum and maximum diameter at the top."""
    height_m: Range = (0.1, 0.4)
    """Minimum and maximum height."""
    broken: Fraction = 0.2
    """Share of stumps whose top is jagged and hollow, as trees leave that broke, and decay; assumption."""


class Grass(Section):
    """Tufts within 25 m of the path."""

    tufts_per_m2: Annotated[float, Field(ge=0, le=8)] = 0.0
    """Density of tufts."""
    height_m: Range = (0.15, 0.5)
    """Minimum and maximum height of a tuft."""


class Cover(Section):
    """Low plants that cover a share of the ground near the path."""

    cover: Annotated[float, Field(ge=0, le=0.8)] = 0.0
    """Share of the ground under their outlines, seen from above."""
    height_m: Range
    """Minimum and maximum height over the ground."""


class Herbs(Cover):
    """Patches of broadleaved herbs within 25 m of the path, twice as wide as high."""

    height_m: Range = (0.1, 0.3)
    """Minimum and maximum height of a patch; wood sorrel has 0.05 to 0.15 m, wood anemone 0.1 to 0.3 m, dog's mercury 0.15 to
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
    """Cushions of moss within 12 m of the path, eight times as wide as high; ground by their label. Light meets them up to `near_m`."""

    height_m: Range = (0.03, 0.08)
    """Minimum and maximum height of a cushion; feather mosses of spruce forest are that deep (assumption)."""


class Litter(Cover):
    """Heaps of leaves and twigs within 12 m of the path, eight times as wide as high; ground by their label. Light meets them up to `near_m`."""

    height_m: Range = (0.03, 0.08)
    """Minimum and maximum height of a heap; assumption."""


class Ivy(Section):
    """Ivy on the stems of trees, leaves by their label and part of their tree; the inventory's leaf area is without it."""

    share: Fraction = 0.0
    """Share of stems on which it grows."""
    height_m: Range = (1.5, 8.0)
    """Minimum and maximum height up to which it covers a stem, no higher than the crown base."""


_Near = Annotated[float, Field(ge=5)]
Near = Annotated[  # a distance, in m, that may be infinite; JSON, which has no such number, has the text "inf"
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
    """Part of a tree that it is."""


class TreeModelFile(MeshSource):
    """A tree of the user's own, which takes the place of the grown trees of a species, scaled to the size of each."""

    species: str
    """Trees that look like it: name in the species table, or scientific name. Of several models of a species each tree has one
    at random among those that it stretches least."""
    parts: list[ModelPart] = Field(default_factory=list)
    """Parts of the file that are no stem."""


class Woods(WorldSection):
    """Ground and undergrowth, whatever trees stand on it."""

    seed: Seed | None = None
    """Seed of ground, plants, stones and gusts: scenes that share it see one stand; the scene's seed if not set."""
    season: Season = "leaf_on"
    """Whether broadleaved trees and shrubs bear leaves."""
    dead_branches: bool = True
    """Whether stems have dead branches with twigs below the crowns, spruces nearly down to the ground."""
    crooked_stems: bool = True
    """Whether stems sweep, fork and have sections with lobes and bark, as the species table says; else straight and round."""
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
    """Share by which the reflectance of ground, bark and stones varies over patches, of some 0.08 m on bark and 0.2 m else, one sigma; leaves have
    none, as each lies at an angle of its own. Assumption: neighbouring returns then scatter as those of real sensors in
    rooms and streets do."""
    species_file: SceneFile | None = None
    """Plants of the user's own, in the form of the program's `forest/species.toml`, numbered from 1000."""
    tree_models: list[TreeModelFile] = Field(default_factory=list)
    """Trees of the user's own that take the place of the grown ones of a species; inventory and labels follow their meshes."""
    path_clearance_m: NonNegative = 0.8
    """Nothing that grows or lies on the ground is nearer to the path than this, but for the roots of old trees."""
    near_m: Near = 15.0
    """What is nearer to the sensor than this is cast leaf by leaf; beyond, ground and stems are exact and foliage is a
    medium of voxels made of the same plants. `inf` casts everything leaf by leaf."""
    terrain: Terrain = Terrain()
    dem: Dem | None = None
    """Heights of the ground in a file; they take the place of `terrain`."""
    origin_m: MapPoint = (0.0, 0.0, 0.0)
    """Easting, northing and height that are (0, 0, 0) in the world, for files in map coordinates."""

    has_trees: ClassVar[bool] = True
    site_door = "forest_site"


@cache
def presets() -> Table:
    """All presets by name, each in the form of a `[world]` table. Sources stand in `presets.toml`."""
    text = resources.files("vlp16emu.forest").joinpath("presets.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


class Wind(Section):
    """Wind through a stand; without this table, and at a speed of 0, the air is still and costs nothing."""

    speed_m_s: Annotated[float, Field(ge=0, le=12)]
    """Mean, at the top of the canopy: there half of what it is in the open, by and large. Trees answer in proportion, also
    where real ones would break or lean on their neighbours: from some 8 m/s on thin trees of dense stands lean too far."""
    towards_deg: Annotated[float, Field(ge=0, lt=360)] = 0.0
    """Direction in which it blows, counter-clockwise from east."""
    turbulence_intensity: Annotated[float, Field(ge=0, le=1)] = 0.55
    """Standard deviation of the speed along the wind over the mean; across it is 0.8 of that. At the top of canopies
    1.8 / 3.3 (both over the friction velocity; Raupach, Finnigan and Brunet, Boundary-Layer Meteorol 78, 1996)."""
    gust_length_m: Annotated[float, Field(ge=1, le=500)] = 20.0
    """Integral length of gusts along the wind: at the top of canopies about the height of the trees (the same)."""
    damping_ratio: Annotated[float, Field(ge=0.02, le=1)] = 0.1
    """Damping of the trees' swing as a share of critical damping: whole trees have 0.08 and more, stripped ones 0.01 to
    0.08 (Moore and Maguire, Trees 19, 2005)."""


class Forest(Woods, Storey):
    """A stand without edge on a terrain with relief."""

    kind: Literal["forest"]
    """Selects a stand without edge."""

    @model_validator(mode="before")
    @classmethod
    def with_preset(cls, own: Any) -> Any:
        """Lay a scene's own `[world]` table over the preset that it names, as `merged` does; an unknown preset changes nothing."""
        name = own.get("preset") if isinstance(own, dict) else None
        if not isinstance(name, str):
            return own
        left_out = DENSITY_KEYS if own.keys() & DENSITY_KEYS else frozenset[str]()
        return merged({key: value for key, value in presets().get(name, {}).items() if key not in left_out}, own)

    preset: Literal["none", "plantation", "managed_mixed", "old_growth", "wild_regrowth", "open_savanna"] = "none"
    """A kind of forest that gives all keys of this table which are not given beside it."""
    storeys: Annotated[list[Storey], Field(max_length=2)] = Field(default_factory=list)
    """Storeys under the canopy, from the top down."""


class Plot(Woods):
    """Trees that somebody has measured."""

    kind: Literal["plot"]
    """Selects measured trees."""
    stem_list: SceneFile
    """CSV whose first line names the columns: x, y, species, dbh_cm, height_m, and more if known."""
    on_conflict: Literal["refuse", "drop", "move_path"] = "refuse"
    """What happens to stems nearer to the path than `path_clearance_m`: the scene is refused with all of them named, they are
    left out with a warning, or the path of a walk leads around them."""
