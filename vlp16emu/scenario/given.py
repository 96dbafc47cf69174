"""What the user brings to a world in files of their own: heights, trees, meshes.

A file's path is relative to the folder of the scene file.
"""

from typing import Annotated, Literal

from pydantic import Field

from vlp16emu.scenario.finish import Finish, PartFinish
from vlp16emu.settings import Angle, Place, Positive, SceneFile, Section

__all__ = ["Dem", "MapPoint", "MeshFile", "MeshPart", "MeshPlace"]

MapPoint = Annotated[tuple[Place, Place, Place], Field(strict=False)]
Corner = Annotated[tuple[Place, Place], Field(strict=False)]
SemanticName = Literal["ground", "tree", "shrub", "stone", "deadwood", "grass", "other"]
PartName = Literal[
    "none", "stem", "branch_first_order", "branch_higher_order", "leaf", "root_flare", "dead_branch"
]


class Dem(Section):
    """Heights of the ground in a file: ESRI ASCII grid (.asc), numpy array (.npy) or GeoTIFF (.tif)."""

    file: SceneFile
    """Path of the file, from the folder of the scene file."""
    cell_m: Positive | None = None
    """Edge of a cell of a .npy, whose rows run from north to south; other files say it themselves."""
    corner_m: Corner | None = None
    """Easting and northing of the outer corner of the south-western cell of a .npy."""


class MeshPart(PartFinish):
    """What one part of a mesh file is, where it differs from the rest."""

    name: str
    """Name of the object or group (OBJ) or node (GLB)."""
    semantic: SemanticName | None = None
    """Class of the points on it, where it differs."""
    part: PartName | None = None
    """Part of a plant that it is, where it differs."""


class MeshPlace(Section):
    """Where a mesh stands."""

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


class MeshFile(Finish):
    """A mesh of the user's own: OBJ, PLY, GLB or STL."""

    file: SceneFile
    """Path of the file, from the folder of the scene file."""
    unit: Literal["m", "cm", "mm", "in", "ft"]
    """Unit of the file's coordinates."""
    up: Literal["z", "y"]
    """Axis of the file that points upwards."""
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
