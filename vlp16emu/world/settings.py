"""The tables `[world]` of a hall and `[people]`; and the contract of all worlds with the engine."""

import math
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Protocol, Self

from pydantic import Field, model_validator

from vlp16emu.doors import door
from vlp16emu.settings import Fraction, LazySection, SceneFile, Section, Size

if TYPE_CHECKING:  # scenes are read without numpy
    from vlp16emu.types import F8, World

Texture = Annotated[float, Field(ge=0, le=0.3)]
_KEYS = frozenset({"reflectance", "retroreflection_cd_lx_m2"})

LengthUnit = Literal["m", "cm", "mm", "in", "ft"]
UpAxis = Literal["z", "y"]


class PartFinish(Section):
    """Finish of a part, which is that of the whole unless one of these keys is given."""

    either_or: ClassVar[frozenset[str]] = _KEYS

    reflectance: Fraction | None = None
    """Lambertian, at 903 nm."""
    retroreflection_cd_lx_m2: Annotated[float, Field(ge=1, le=1000)] | None = None
    """Coefficient of retroreflection, instead of `reflectance`: least values of ASTM D4956 for new white sheeting are 70
    of type I, 250 of type III and 700 of type VIII. Assumptions: at 903 nm it is as in visible light, and it falls with the
    cosine of incidence."""

    @model_validator(mode="after")
    def _given_once(self) -> Self:
        if self.retroreflection_cd_lx_m2 is not None and "reflectance" in self.model_fields_set:
            raise ValueError("reflectance or retroreflection_cd_lx_m2 in it, not both")
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
        """Reflectance at normal incidence, relative to a white Lambertian surface; above 1 for a retroreflector."""
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
    """The ground of a world, before the path that leads over it is known."""

    @property
    def name(self) -> str:
        """Digest of all that decides the ground."""

    @property
    def origin_m(self) -> tuple[float, float, float]:
        """Easting, northing and height in maps that are (0, 0, 0) in the world."""

    @property
    def obstacles(self) -> "tuple[F8, F8] | None":
        """Places (n, 2) that way points lead around, and how far (n,) from each; None if paths keep their way."""

    def height_m(self, x_m: "F8", y_m: "F8") -> "F8":
        """Height of the ground over places."""

    def world(
        self, path_xy_m: "F8", *, reach_m: float, farthest_m: float, wind: Any, start_ns: int
    ) -> "tuple[World, Any]":
        """Return the world around a path, and what moves in it, as `forest.stand.wind.TreeSway`; None in still air.

        Raises GeometryError if the world cannot be made as it is written, or ends within reach.

        Parameters
        ----------
        path_xy_m : (n, 2) path of the sensors
        reach_m : from there, how far they see
        farthest_m : range of the one that sees farthest
        wind : the table `[wind]`; None without it
        start_ns : UTC of the first pulse
        """


class WorldSection(Section):
    """Base class of the kinds of world."""

    has_trees: ClassVar[bool] = False
    """Whether wind moves something in it."""
    site_door: ClassVar[str]
    """Name in `doors.DOORS` of what `site` makes; a section of another package overrides `site`."""
    if TYPE_CHECKING:
        kind: str

    meshes: list[Annotated[Any, LazySection("mesh_section")]] = Field(default_factory=list)
    """The user's own things; they may lie anywhere."""

    def site(self, seed: int) -> Site:
        """Return the ground, on which path and world are made; raises GeometryError if it cannot be made as it is written."""
        site: Site = door(self.site_door)(self, seed)
        return site

    def furnished(self, bare: "World", path_xy_m: "F8", reach_m: float) -> "World":
        """Return a world with the user's own meshes in it, as far as they are seen along a path (n, 2).

        Raises GeometryError if a mesh cannot be read.
        """
        return door("furnished")(bare, self.meshes, path_xy_m, reach_m) if self.meshes else bare


class People(Section):
    """People beside a carrier who walks, as upright cylinders: shoulders, and a head on them."""

    behind_m: Annotated[float, Field(ge=0, le=100)] = 1.5
    """Distance of a companion who follows behind the carrier, and hides a sector of what is seen; 0 for none (assumption)."""
    passes_every_s: Annotated[float, Field(ge=0, le=86_400)] = 40.0
    """Time from one person to the next who comes towards the carrier and passes 1 m to the side; 0 for none (assumption)."""


class HallThing(Finish):
    """Something of known shape."""

    name: str
    """Name in reports."""
    texture: Texture = 0.0
    """Share by which its reflectance varies over patches, as that of the walls does; none unless set, so that it is of known brightness."""


class HallBox(HallThing):
    """An upright box."""

    centre_m: Annotated[tuple[float, float, float], Field(strict=False)]
    """x, y and z of the centre."""
    size_m: Annotated[tuple[Size, Size, Size], Field(strict=False)]
    """Extent along x, y and z."""


class HallPole(HallThing):
    """An upright round pole."""

    foot_m: Annotated[tuple[float, float, float], Field(strict=False)]
    """x, y and z of the middle of the lower end."""
    diameter_m: Size
    """Diameter."""
    height_m: Size
    """Height over the foot."""


class HallSphere(HallThing):
    """A ball."""

    centre_m: Annotated[tuple[float, float, float], Field(strict=False)]
    """x, y and z of the centre."""
    diameter_m: Size
    """Diameter."""


class Hall(WorldSection):
    """A closed room of known size, centred on the origin, floor at z = 0, with things in it."""

    site_door = "hall_site"

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
    texture: Texture = 0.16
    """Share by which it varies over patches of some 0.1 m, one sigma over all; pieces of a wall of some 1.6 m differ
    by a factor of three. With 0.16 neighbouring returns from walls scatter as on real units."""
    relief_m: Annotated[float, Field(ge=0, le=0.05)] = 0.0
    """How far walls, floor and ceiling stand out and back over patches of a few centimetres, one sigma; ground truth has
    it too. Walls of the rooms that real sensors stood in have 0.002 to 0.005 m; without it, the hall is flat."""
    boxes: list[HallBox] = Field(default_factory=list)
    """Upright boxes."""
    poles: list[HallPole] = Field(default_factory=list)
    """Upright round poles."""
    spheres: list[HallSphere] = Field(default_factory=list)
    """Balls."""
