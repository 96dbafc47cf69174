"""The tables `[world]` of a hall and `[people]`, and the interface between worlds and the engine."""

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Protocol, Self

from pydantic import Field, model_validator

from vlp16emu.doors import Part
from vlp16emu.settings import (
    Angle,
    ExpectationError,
    Fraction,
    LazySection,
    MapPoint,
    SceneFile,
    Section,
    Size,
)

if TYPE_CHECKING:  # scenes load without numpy
    from vlp16emu.types import F8, MovingTrees, World

Texture = Annotated[float, Field(ge=0, le=0.3)]
Shading = Annotated[float, Field(ge=0, le=1)]
Relief = Annotated[float, Field(ge=0, le=0.05)]
Roughness = Annotated[float, Field(ge=0.05, le=0.5)]
_KEYS = frozenset({"reflectance", "retroreflection_cd_lx_m2"})

LengthUnit = Literal["m", "cm", "mm", "in", "ft"]
UpAxis = Literal["z", "y"]


class PartFinish(Section):
    """Finish of a part; by default the finish of the whole object."""

    either_or: ClassVar[frozenset[str]] = _KEYS

    reflectance: Fraction | None = None
    """Lambertian, at 903 nm."""
    retroreflection_cd_lx_m2: Annotated[float, Field(ge=1, le=1000)] | None = None
    """Coefficient of retroreflection, instead of `reflectance`: minimum values of ASTM D4956 for new white
    sheeting are 70 for type I, 250 for type III and 700 for type VIII. Assumptions: at 903 nm it is as in
    visible light, and it falls with the cosine of incidence."""
    roughness: Roughness | None = None
    """Root mean square slope of the facets of a glossy coat, such as paint; none for a matt surface. Seen
    straight on, it adds
    0.01 over the square of the slope to the reflectance, within an angle of about this slope."""

    @model_validator(mode="after")
    def _check_reflectance(self) -> Self:
        if self.retroreflection_cd_lx_m2 is not None and "reflectance" in self.model_fields_set:
            raise ExpectationError("reflectance or retroreflection_cd_lx_m2 in it, not both")
        return self

    @property
    def brightness(self) -> float | None:
        """Reflectance at normal incidence, relative to a white Lambertian surface; None if none is given."""
        if self.retroreflection_cd_lx_m2 is None:
            return self.reflectance
        return math.pi * self.retroreflection_cd_lx_m2  # a white Lambertian surface has 1 / pi


class Finish(PartFinish):
    """Finish of a thing."""

    reflectance: Fraction = 0.5
    """Lambertian, at 903 nm."""

    @property
    def brightness(self) -> float:
        """Reflectance at normal incidence, relative to a white Lambertian surface.

        It is above 1 for a retroreflector.
        """
        given = super().brightness
        return self.reflectance if given is None else given


class MeshSource(Section):
    """A file of meshes: OBJ, PLY, GLB or STL."""

    file: SceneFile
    """Path of the file, from the folder of the scene file."""
    unit: LengthUnit
    """Unit of the file's coordinates."""
    up: UpAxis
    """Axis of the file that points upwards."""


class Site(Protocol):
    """The ground of a world, before the path over it is known."""

    @property
    def name(self) -> str:
        """Digest of all inputs of the ground."""

    @property
    def origin_m(self) -> tuple[float, float, float]:
        """Easting, northing and height of the world's origin (0, 0, 0) in map coordinates."""

    @property
    def obstacles(self) -> "tuple[F8, F8] | None":
        """Positions (n, 2) that paths must avoid, and distances (n,) from them.

        It is None if paths stay as they are.
        """

    def height_m(self, x_m: "F8", y_m: "F8") -> "F8":
        """Height of the ground at positions."""

    def world(
        self, path_xy_m: "F8", *, reach_m: float, farthest_m: float, wind: Section | None, start_ns: int
    ) -> "tuple[World, MovingTrees | None]":
        """Return the world around a path, and its trees in the wind; None in still air.

        Raises GeometryError if the world cannot be made, or ends within reach.

        Parameters
        ----------
        path_xy_m : (n, 2) path of the sensors
        reach_m : distance from the path that is in reach
        farthest_m : greatest range of the sensors
        wind : the table `[wind]`; None without it
        start_ns : UTC of the first pulse
        """


HALL_SITE = Part[Callable[["Hall", int], Site]]("vlp16emu.world.hall:HallWorld")
MESH_SECTION = Part[type[Section]]("vlp16emu.extras.meshes.settings:MeshFile")
FURNISH = Part[Callable[["World", Sequence[Section], "F8", float], "World"]](
    "vlp16emu.extras.meshes.furnish:furnish"
)
"""Function that puts the user's meshes into a world, as `WorldSection.with_meshes` does."""


class WorldSection(Section):
    """Base class of the kinds of world."""

    has_trees: ClassVar[bool] = False
    """True if wind can move something in it."""
    if TYPE_CHECKING:
        kind: str

    meshes: list[Annotated[Section, LazySection(MESH_SECTION)]] = Field(default_factory=list)
    """Objects from the user; they may be anywhere."""

    def site(self, seed: int) -> Site:
        """Return the ground, on which path and world are made; raises GeometryError if it cannot be made."""
        raise NotImplementedError(type(self))

    def with_meshes(self, bare: "World", path_xy_m: "F8", reach_m: float) -> "World":
        """Return a world with the user's meshes, as far as they are visible along a path (n, 2).

        Raises GeometryError if a mesh cannot be read.
        """
        return FURNISH.load()(bare, self.meshes, path_xy_m, reach_m) if self.meshes else bare


class People(Section):
    """People beside a walking carrier, as upright cylinders: shoulders and a head."""

    behind_m: Annotated[float, Field(ge=0, le=100)] = 1.5
    """Distance of a companion who follows the carrier and hides a sector of the view; 0 for none
    (assumption)."""
    passes_every_s: Annotated[float, Field(ge=0, le=86_400)] = 40.0
    """Time between oncoming people, who pass the carrier 1 m to the side; 0 for none (assumption)."""


class HallThing(Finish):
    """An object of known shape."""

    name: str
    """Name in reports."""
    texture: Texture = 0.0
    """Relative variation of its reflectance over patches, as for the walls; 0 by default, for a known
    brightness."""
    shading: Shading = 0.0
    """Relative smooth variation of its reflectance, as for the walls; 0 by default."""
    relief_m: Relief = 0.0
    """Unevenness, as for the walls; 0 by default, for a known shape."""


class TurnedThing(HallThing):
    """An object that may be turned and tilted: about z, then y, then x, as a mount."""

    yaw_deg: Angle = 0.0
    """Counter-clockwise, seen from above."""
    pitch_deg: Angle = 0.0
    """Its top leans forward, to +x before the yaw, if positive; 90 lays a pole down."""
    roll_deg: Angle = 0.0
    """Its top leans to its right, to -y before the yaw, if positive."""

    @property
    def angles_deg(self) -> tuple[float, float, float]:
        """Yaw, pitch and roll."""
        return self.yaw_deg, self.pitch_deg, self.roll_deg


class HallBox(TurnedThing):
    """A box, upright unless it is tilted about its centre."""

    centre_m: MapPoint
    """x, y and z of the centre."""
    size_m: Annotated[tuple[Size, Size, Size], Field(strict=False)]
    """Extent along its x, y and z, before it is turned."""


class HallPole(TurnedThing):
    """A round pole, upright unless it is tilted about its foot."""

    foot_m: MapPoint
    """x, y and z of the centre of the lower end. On the floor, z of a pole that leans by an angle is its
    radius times the sine of it, so that all of its end is inside."""
    diameter_m: Size
    """Diameter."""
    height_m: Size
    """Length from the foot to the upper end: the height of an upright one."""


class HallSphere(HallThing):
    """A ball."""

    centre_m: MapPoint
    """x, y and z of the centre."""
    diameter_m: Size
    """Diameter."""


class Hall(WorldSection):
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
    wall_roughness: Roughness | None = None
    """Roughness of a glossy coat on them; none for matt ones. Paint has 0.15 to 0.3: codes on walls of real
    captures are 5 to 15 % higher within 10 degrees of normal incidence than at 20 to 40."""
    texture: Texture = 0.16
    """Relative variation of the reflectance over patches of about 0.1 m, one sigma overall; parts of a wall
    of about 1.6 m differ by a factor of three. With 0.16 neighbouring returns from walls scatter as on real
    units."""
    shading: Shading = 0.0
    """Relative variation of the reflectance that is smooth over one to three metres, one sigma. On real units
    brightness changes along a wall and through all rings: paint, dirt, light on cloth."""
    relief_m: Relief = 0.0
    """Unevenness of walls, floor and ceiling over patches of a few centimetres, one sigma; included in the
    ground truth. Walls in captures of real sensors have 0.002 to 0.005 m; 0 gives a flat hall."""
    boxes: list[HallBox] = Field(default_factory=list)
    """Boxes."""
    poles: list[HallPole] = Field(default_factory=list)
    """Round poles."""
    spheres: list[HallSphere] = Field(default_factory=list)
    """Balls."""

    def site(self, seed: int) -> Site:
        """Return the hall, which is its own ground; raises GeometryError for a thing that is not inside."""
        return HALL_SITE.load()(self, seed)
