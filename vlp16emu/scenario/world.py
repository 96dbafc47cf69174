"""The `[world]` table: a forest that grows itself, a plot of given trees, or a hall of known shapes."""

import math
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, PlainSerializer, model_validator

from vlp16emu.scenario.finish import Finish
from vlp16emu.scenario.given import Dem, MapPoint, MeshFile
from vlp16emu.scenario.ground import Terrain
from vlp16emu.scenario.presets import DENSITY_KEYS, with_preset
from vlp16emu.settings import Fraction, NonNegative, SceneFile, Section, Size

__all__ = [
    "MOST_STEMS_PER_HA",
    "Clusters",
    "Forest",
    "Grass",
    "Hall",
    "HallBox",
    "HallPole",
    "HallSphere",
    "HardCore",
    "Logs",
    "Pattern",
    "Plantation",
    "Plot",
    "Regeneration",
    "Scattered",
    "Shrubs",
    "SpeciesShare",
    "Stones",
    "Storey",
    "Stumps",
    "Woods",
    "World",
]


MOST_STEMS_PER_HA = 5000
"""Of a storey, however its density is told."""


def _in_order(limits: tuple[float, float]) -> tuple[float, float]:
    """See that a range does not run backwards."""
    if limits[0] > limits[1]:
        raise ValueError("the smaller number first")
    return limits


Range = Annotated[tuple[Size, Size], Field(strict=False), AfterValidator(_in_order)]
_Near = Annotated[float, Field(ge=5)]
Near = Annotated[
    _Near,
    Field(allow_inf_nan=True),
    BeforeValidator(lambda m: math.inf if m == "inf" else m, json_schema_input_type=_Near | Literal["inf"]),
    PlainSerializer(lambda m: "inf" if math.isinf(m) else m, when_used="json"),
]
"""A distance, in m, that may be infinite; JSON, which has no such number, has the text "inf"."""


class SpeciesShare(Section):
    """One species of the stand."""

    species: str
    """Name in the species table, for instance `silver_birch`."""
    share: Annotated[float, Field(ge=1e-6, le=1e6)]
    """Share of stems; shares are scaled to sum to one."""
    dbh_cm: Annotated[float, Field(ge=5, le=120)]
    """Quadratic mean diameter at breast height."""
    height_m: Annotated[float, Field(ge=3, le=60)]
    """Height of the tree of that diameter."""


class Scattered(Section):
    """Places that know nothing of each other."""

    kind: Literal["random"]
    """Selects places independent of each other."""


class HardCore(Section):
    """Places that keep apart, as those of trees which compete."""

    kind: Literal["hard_core"]
    """Selects places that keep a distance."""


class Plantation(Section):
    """Planted rows, of which the given density is left."""

    kind: Literal["plantation"]
    """Selects rows."""
    row_spacing_m: Annotated[float, Field(ge=0.5, le=1000)] = 2.5
    """Distance between rows."""
    tree_spacing_m: Annotated[float, Field(ge=0.5, le=1000)] = 2.0
    """Distance of planted trees within a row."""
    azimuth_deg: Annotated[float, Field(ge=0, lt=360)] = 0.0
    """Direction of the rows, counter-clockwise from east."""
    jitter_m: Annotated[float, Field(ge=0, le=2)] = 0.15
    """Half-range of the error of planting along and across the row."""


class Clusters(Section):
    """Clumps."""

    kind: Literal["clusters"]
    """Selects clumps of plants."""
    per_cluster: Annotated[float, Field(ge=1, le=100)] = 8.0
    """Mean number of plants of a clump."""
    sigma_m: Annotated[float, Field(gt=0, le=5)] = 3.0
    """Standard deviation of plants about the middle of their clump, along either axis."""


Pattern = Annotated[Scattered | HardCore | Plantation | Clusters, Field(discriminator="kind")]


class Storey(Section):
    """Trees of one layer of the canopy; needs exactly one of `stems_per_ha` and `basal_area_m2_per_ha`."""

    either_or: ClassVar[frozenset[str]] = DENSITY_KEYS

    stems_per_ha: Annotated[float, Field(ge=0, le=MOST_STEMS_PER_HA)] = 0.0
    """Density of stems; instead of `basal_area_m2_per_ha`."""
    basal_area_m2_per_ha: Annotated[float, Field(ge=0, le=120)] = 0.0
    """Sum of the cross-sections of stems at breast height; instead of `stems_per_ha`."""
    species: Annotated[list[SpeciesShare], Field(min_length=1)]
    """Species of the trees, with share and size."""
    pattern: Pattern = HardCore(kind="hard_core")
    """How the trees are spread over the ground."""

    @model_validator(mode="after")
    def _one_density(self) -> Self:
        """Refuse a density that is missing or told twice."""
        if len(DENSITY_KEYS & self.model_fields_set) != 1:
            raise ValueError(f"exactly one of {' and '.join(sorted(DENSITY_KEYS))} in it")
        return self


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
    """What trees they were, each as often; if none is named, those of the canopy."""
    diameter_m: Range = (0.1, 0.5)
    """Minimum and maximum mean diameter."""
    length_m: Range = (3.0, 15.0)
    """Minimum and maximum length."""


class Stumps(Section):
    """What felled trees left."""

    per_ha: Annotated[float, Field(ge=0, le=5000)] = 0.0
    """Density of stumps."""
    species: list[str] = Field(default_factory=list)
    """What trees they were, each as often; if none is named, those of the canopy."""
    diameter_m: Range = (0.2, 0.6)
    """Minimum and maximum diameter at the top."""
    height_m: Range = (0.1, 0.4)
    """Minimum and maximum height."""


class Grass(Section):
    """Tufts within 25 m of the path."""

    tufts_per_m2: Annotated[float, Field(ge=0, le=8)] = 0.0
    """Density of tufts."""
    height_m: Range = (0.15, 0.5)
    """Minimum and maximum height of a tuft."""


class Woods(Section):
    """Ground and undergrowth, whatever trees stand on it."""

    season: Literal["leaf_on", "leaf_off"] = "leaf_on"
    """Whether broadleaved trees and shrubs bear leaves."""
    dead_branches: bool = False
    """Whether stems have dead branches below the crowns."""
    regeneration: Regeneration = Regeneration()
    shrubs: Shrubs = Shrubs()
    stones: Stones = Stones()
    logs: Logs = Logs()
    stumps: Stumps = Stumps()
    grass: Grass = Grass()
    species_file: SceneFile | None = None
    """Plants of the user's own, in the form of the program's `world/species.toml`, numbered from 1000."""
    path_clearance_m: NonNegative = 0.8
    """Nothing that grows or lies on the ground is nearer to the path than this."""
    near_m: Near = 15.0
    """What is nearer to the sensor than this is cast leaf by leaf; beyond, ground and stems are exact and foliage is a
    medium of voxels made of the same plants. `inf` casts everything leaf by leaf."""
    terrain: Terrain = Terrain()
    dem: Dem | None = None
    """Heights of the ground in a file; they take the place of `terrain`."""
    origin_m: MapPoint = (0.0, 0.0, 0.0)
    """Easting, northing and height that are (0, 0, 0) in the world, for files in map coordinates."""
    meshes: list[MeshFile] = Field(default_factory=list)
    """The user's own things."""


class Forest(Woods, Storey):
    """A stand without edge on a terrain with relief."""

    kind: Literal["forest"]
    """Selects a stand without edge."""
    preset: Literal["none", "plantation", "managed_mixed", "old_growth", "wild_regrowth", "open_savanna"] = (
        "none"
    )
    """A kind of forest that gives all keys of this table which are not given beside it."""
    storeys: Annotated[list[Storey], Field(max_length=2)] = Field(default_factory=list)
    """Storeys under the canopy, from the top down."""

    @model_validator(mode="before")
    @classmethod
    def _from_preset(cls, table: Any) -> Any:
        """Fill in what the preset gives."""
        return with_preset(table) if isinstance(table, dict) else table


class Plot(Woods):
    """Trees that somebody has measured."""

    kind: Literal["plot"]
    """Selects measured trees."""
    stem_list: SceneFile
    """CSV whose first line names the columns: x, y, species, dbh_cm, height_m, and more if known."""


class HallBox(Finish):
    """An upright box."""

    name: str
    """Name in reports."""
    centre_m: Annotated[tuple[float, float, float], Field(strict=False)]
    """x, y and z of the centre."""
    size_m: Annotated[tuple[Size, Size, Size], Field(strict=False)]
    """Extent along x, y and z."""


class HallPole(Finish):
    """An upright round pole."""

    name: str
    """Name in reports."""
    foot_m: Annotated[tuple[float, float, float], Field(strict=False)]
    """x, y and z of the middle of the lower end."""
    diameter_m: Size
    """Diameter."""
    height_m: Size
    """Height over the foot."""


class HallSphere(Finish):
    """A ball."""

    name: str
    """Name in reports."""
    centre_m: Annotated[tuple[float, float, float], Field(strict=False)]
    """x, y and z of the centre."""
    diameter_m: Size
    """Diameter."""


class Hall(Section):
    """A closed room of known size, centred on the origin, floor at z = 0, with things in it."""

    kind: Literal["hall"]
    """Selects a hall of known shapes."""
    length_m: Size
    """Extent along x."""
    width_m: Size
    """Extent along y."""
    height_m: Size
    """Height of the ceiling."""
    wall_reflectance: Fraction = 0.6
    """Lambertian reflectance of walls, floor and ceiling at 903 nm."""
    boxes: list[HallBox] = Field(default_factory=list)
    """Upright boxes."""
    poles: list[HallPole] = Field(default_factory=list)
    """Upright round poles."""
    spheres: list[HallSphere] = Field(default_factory=list)
    """Balls."""
    meshes: list[MeshFile] = Field(default_factory=list)
    """The user's own things; unlike the others they may lie anywhere."""


World = Annotated[Forest | Plot | Hall, Field(discriminator="kind")]
