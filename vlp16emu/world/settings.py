"""A hall of known shapes."""

from typing import Annotated, Literal

from pydantic import Field

from vlp16emu.settings import Fraction, Section, Size
from vlp16emu.world.mesh_settings import Finish, MeshFile

Texture = Annotated[float, Field(ge=0, le=0.3)]


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
