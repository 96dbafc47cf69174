"""A forest that grows itself, a plot of given trees, or a hall of known shapes."""

import math
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, PlainSerializer

from vlp16emu.settings import Fraction, MapPoint, NonNegative, SceneFile, Section, Seed, Size
from vlp16emu.world.given.settings import Finish, MeshFile, TreeModelFile
from vlp16emu.world.ground.settings import Dem, Terrain
from vlp16emu.world.stand.settings import (
    DwarfShrubs,
    Ferns,
    Grass,
    Herbs,
    Ivy,
    Litter,
    Logs,
    Moss,
    Regeneration,
    Season,
    Shrubs,
    Stones,
    Storey,
    Stumps,
)

_Near = Annotated[float, Field(ge=5)]
Near = Annotated[
    _Near,
    Field(allow_inf_nan=True),
    BeforeValidator(lambda m: math.inf if m == "inf" else m, json_schema_input_type=_Near | Literal["inf"]),
    PlainSerializer(lambda m: "inf" if math.isinf(m) else m, when_used="json"),
]
"""A distance, in m, that may be infinite; JSON, which has no such number, has the text "inf"."""


Texture = Annotated[float, Field(ge=0, le=0.3)]


class Woods(Section):
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
    texture: Texture = 0.085
    """Share by which the reflectance of ground, bark and stones varies over patches, of some 0.08 m on bark and 0.2 m else, one sigma; leaves have
    none, as each lies at an angle of its own. Assumption: neighbouring returns then scatter as those of real sensors in
    rooms and streets do."""
    species_file: SceneFile | None = None
    """Plants of the user's own, in the form of the program's `world/species.toml`, numbered from 1000."""
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


class Plot(Woods):
    """Trees that somebody has measured."""

    kind: Literal["plot"]
    """Selects measured trees."""
    stem_list: SceneFile
    """CSV whose first line names the columns: x, y, species, dbh_cm, height_m, and more if known."""
    on_conflict: Literal["refuse", "drop", "move_path"] = "refuse"
    """What happens to stems nearer to the path than `path_clearance_m`: the scene is refused with all of them named, they are
    left out with a warning, or the path of a walk leads around them."""


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
    texture: Texture = 0.08
    """Share by which it varies over patches of some 0.2 m, one sigma; things in the hall have none. Neighbouring returns
    of real sensors from walls scatter as with 0.08."""
    relief_m: Annotated[float, Field(ge=0, le=0.05)] = 0.0
    """How far walls, floor and ceiling stand out and back over patches of a few centimetres, one sigma; ground truth has
    it too. Walls of the rooms that real sensors stood in have 0.002 to 0.005 m; without it, the hall is flat."""
    boxes: list[HallBox] = Field(default_factory=list)
    """Upright boxes."""
    poles: list[HallPole] = Field(default_factory=list)
    """Upright round poles."""
    spheres: list[HallSphere] = Field(default_factory=list)
    """Balls."""
    meshes: list[MeshFile] = Field(default_factory=list)
    """The user's own things; unlike the others they may lie anywhere."""
