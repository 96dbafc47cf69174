"""How much geometry an open window holds."""

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from vlp16emu.raycast.caster import Geometry


@dataclass(frozen=True, slots=True)
class GeometrySize:
    """Faces of a window that are near by, and the medium beyond them."""

    faces: int
    """Quads that are kept, a triangle without a partner being one; all triangles where Embree cannot be driven."""
    placed: int
    """The same, each counted as often as it is placed."""
    bytes: int
    """Of their vertices and indices; Embree's own trees come on top."""
    near_m: float | None
    """Range at which the medium begins; None where there is none."""
    tiles: int
    """Squares that the medium spans."""
    voxels: int
    """That hold anything."""
    medium_bytes: int
    """Of all arrays of the medium."""


def geometry_of(geometry: Geometry) -> GeometrySize:
    """Count the faces and the voxels of a window."""
    from vlp16emu.raycast.slow import PlainGeometry

    if isinstance(geometry, PlainGeometry):
        triangles = len(geometry._surface)  # noqa: SLF001  # counting is all that anybody wants of it
        return GeometrySize(triangles, triangles, 36 * triangles, None, 0, 0, 0)
    from vlp16emu.raycast.near import EmbreeGeometry  # its kernel binds to the library
    from vlp16emu.raycast.voxel import BRICK, COLUMNS

    assert isinstance(geometry, EmbreeGeometry)
    placed, meshes = Counter(map(id, geometry.meshes)), {id(mesh): mesh.faces for mesh in geometry.meshes}
    quads = {name: sum(len(own) for _, own in faces) for name, faces in meshes.items()}
    medium = geometry.medium
    has_medium = math.isfinite(medium.near_m)
    return GeometrySize(
        faces=sum(quads.values()),
        placed=sum(quads[name] * often for name, often in placed.items()),
        bytes=sum(array.nbytes for faces in meshes.values() for pair in faces for array in pair),
        near_m=medium.near_m if has_medium else None,
        tiles=math.prod(BRICK * bricks // COLUMNS for bricks in medium.brick.shape[:2]),
        voxels=len(medium.record),
        medium_bytes=sum(array.nbytes for array in _arrays(medium)) if has_medium else 0,
    )


def _arrays(part: object) -> Iterator[np.ndarray[Any, Any]]:
    if isinstance(part, np.ndarray):
        yield part
    elif isinstance(part, tuple):
        for inner in part:
            yield from _arrays(inner)
