"""A hall of known shapes."""

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from vlp16emu.doors import door
from vlp16emu.settings import Fraction, Section, Size
from vlp16emu.world.mesh_settings import Finish, MeshFile
from vlp16emu.world.site import Site

Texture = Annotated[float, Field(ge=0, le=0.3)]


class WorldSection(Section):
    """Base class of the kinds of world."""

    has_trees: ClassVar[bool] = False
    """Whether wind moves something in it."""
    site_door: ClassVar[str]
    """Name in `doors.DOORS` of what `site` makes; a section of another package overrides `site`."""
    if TYPE_CHECKING:
        kind: str

    meshes: list[MeshFile] = Field(default_factory=list)
    """The user's own things; they may lie anywhere."""

    def site(self, seed: int) -> Site:
        """Return the ground, on which the path and then the world are made.

        Raises
        ------
        GeometryError
            If it cannot be made as it is written
        """
        site: Site = door(self.site_door)(self, seed)
        return site


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


class People(Section):
    """People beside a carrier who walks, as upright cylinders: shoulders, and a head on them."""

    behind_m: Annotated[float, Field(ge=0, le=100)] = 1.5
    """Distance of a companion who follows behind the carrier, and hides a sector of what is seen; 0 for none (assumption)."""
    passes_every_s: Annotated[float, Field(ge=0, le=86_400)] = 40.0
    """Time from one person to the next who comes towards the carrier on the same way, and passes; 0 for none (assumption)."""
    passes_at_m: Annotated[float, Field(ge=0.6, le=100)] = 1.0
    """How far to the side such a person passes (assumption)."""


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
    """Share by which it varies over patches of some 0.2 m, one sigma over all; pieces of a wall of some 1.6 m differ
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
