"""Things that the user brings: meshes, and how bright they are."""

import math
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from vlp16emu.settings import Angle, Fraction, Place, SceneFile, Section

_KEYS = frozenset({"reflectance", "retroreflection_cd_lx_m2"})

LengthUnit = Literal["m", "cm", "mm", "in", "ft"]
UpAxis = Literal["z", "y"]
SemanticName = Literal["ground", "tree", "shrub", "stone", "deadwood", "grass", "other"]
PartName = Literal["none", "stem", "branch_first_order", "branch_higher_order", "leaf", "root_flare", "dead_branch"]


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


class MeshPart(PartFinish):
    """Labels and finish of one part of a mesh file that differs from the rest."""

    name: str
    """Name of the object or group (OBJ) or node (GLB)."""
    semantic: SemanticName | None = None
    """Class of the points on it, where it differs."""
    part: PartName | None = None
    """Part of a plant that it is, where it differs."""


class MeshPlace(Section):
    """Place and pose of a mesh in the world."""

    x_m: Place
    """Position east."""
    y_m: Place
    """Position north."""
    z_m: Place | None = None
    """Height of the file's origin in the world; without it the mesh is on the ground."""
    above_ground_m: Place = 0.0
    """Height of the file's origin over the ground, where `z_m` is not given."""
    yaw_deg: Angle = 0.0
    """Counter-clockwise, seen from above."""
    scale: Annotated[float, Field(ge=1e-3, le=1000)] = 1.0
    """Factor on the size."""


class MeshSource(Section):
    """A file of meshes: OBJ, PLY, GLB or STL."""

    file: SceneFile
    """Path of the file, from the folder of the scene file."""
    unit: LengthUnit
    """Unit of the file's coordinates."""
    up: UpAxis
    """Axis of the file that points upwards."""


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


class MeshFile(Finish, MeshSource):
    """A mesh of the user's own: OBJ, PLY, GLB or STL."""

    semantic: SemanticName = "other"
    """Class of the points on it."""
    part: PartName = "none"
    """Part of a plant that it is."""
    one_thing: bool = True
    """Whether all parts at one place are one instance; otherwise each is one of its own."""
    parts: list[MeshPart] = Field(default_factory=list)
    """Parts that differ."""
    places: Annotated[list[MeshPlace], Field(min_length=1)]
    """Positions at which the mesh is placed."""
