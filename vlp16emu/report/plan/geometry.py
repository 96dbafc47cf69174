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
    """Quads that are kept, a triangle without a partner being one."""
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
    # Kernels bind to the library as soon as they are loaded.
    from vlp16emu.raycast.far_caster import FarGeometry
    from vlp16emu.raycast.near import EmbreeGeometry
    from vlp16emu.raycast.voxel import BRICK, COLUMNS

    assert isinstance(geometry, EmbreeGeometry)
    placed, meshes = Counter(map(id, geometry.meshes)), {id(mesh): mesh.faces for mesh in geometry.meshes}
    quads = {name: sum(len(own) for _, own in faces) for name, faces in meshes.items()}
    medium = geometry.medium if isinstance(geometry, FarGeometry) else None
    return GeometrySize(
        faces=sum(quads.values()),
        placed=sum(quads[name] * often for name, often in placed.items()),
        bytes=sum(array.nbytes for faces in meshes.values() for pair in faces for array in pair),
        near_m=medium.near_m if medium else None,
        tiles=math.prod(BRICK * bricks // COLUMNS for bricks in medium.brick.shape[:2]) if medium else 0,
        voxels=len(medium.record) if medium else 0,
        medium_bytes=sum(array.nbytes for array in _arrays(medium)) if medium else 0,
    )


def _arrays(part: object) -> Iterator[np.ndarray[Any, Any]]:
    if isinstance(part, np.ndarray):
        yield part
    elif isinstance(part, tuple):
        for inner in part:
            yield from _arrays(inner)
