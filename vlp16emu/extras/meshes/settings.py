"""The tables `[[world.meshes]]` of a scene."""

from typing import Annotated, Literal

from pydantic import Field

from vlp16emu.settings import Angle, Place, Section
from vlp16emu.world.settings import Finish, MeshSource, PartFinish

SemanticName = Literal["ground", "tree", "shrub", "stone", "deadwood", "grass", "other"]
PartName = Literal[
    "none", "stem", "branch_first_order", "branch_higher_order", "leaf", "root_flare", "dead_branch"
]


class MeshPart(PartFinish):
    """Labels and finish of one part of a mesh file that differs from the rest."""

    name: str
    """Name of the object or group (OBJ) or node (GLB)."""
    semantic: SemanticName | None = None
    """Class of the points on it, if it differs."""
    part: PartName | None = None
    """Part of a plant, if it differs."""


class MeshPlace(Section):
    """Place and pose of a mesh in the world."""

    x_m: Place
    """Position east."""
    y_m: Place
    """Position north."""
    z_m: Place | None = None
    """Height of the file's origin in the world; without it the mesh is on the ground."""
    above_ground_m: Place = 0.0
    """Height of the file's origin over the ground, if `z_m` is not given."""
    yaw_deg: Angle = 0.0
    """Counter-clockwise, seen from above."""
    scale: Annotated[float, Field(ge=1e-3, le=1000)] = 1.0
    """Factor on the size."""


class MeshFile(Finish, MeshSource):
    """A mesh file of the user: OBJ, PLY, GLB or STL."""

    semantic: SemanticName = "other"
    """Class of the points on it."""
    part: PartName = "none"
    """Part of a plant."""
    one_thing: bool = True
    """True if all parts at one place are one instance; otherwise each part is an instance of its own."""
    parts: list[MeshPart] = Field(default_factory=list)
    """Parts that differ."""
    places: Annotated[list[MeshPlace], Field(min_length=1)]
    """Positions at which the mesh is placed."""
