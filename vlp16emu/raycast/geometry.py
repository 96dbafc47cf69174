"""How much geometry an open window holds."""

from collections import Counter
from dataclasses import dataclass

from vlp16emu.raycast import Scene
from vlp16emu.raycast.plain import PlainScene

__all__ = ["Geometry", "geometry_of"]


@dataclass(frozen=True, slots=True)
class Geometry:
    """Faces of a window, as Embree takes them."""

    faces: int
    """Quads that are kept, a triangle without a partner being one; triangles in a `PlainScene`."""
    placed: int
    """The same, each counted as often as it is placed."""
    bytes: int
    """Of their vertices and indices; Embree's own trees come on top."""


def geometry_of(scene: Scene) -> Geometry:
    """Count the faces of a window."""
    if isinstance(scene, PlainScene):
        triangles = len(scene._surface)  # noqa: SLF001  # counting is all that anybody wants of it
        return Geometry(triangles, triangles, 36 * triangles)
    from vlp16emu.raycast.embree import EmbreeScene  # its kernel binds to the library

    assert isinstance(scene, EmbreeScene)
    placed = Counter(map(id, scene._solids))  # noqa: SLF001  # as above
    solids = {id(solid): solid._faces.values() for solid in scene._solids}  # noqa: SLF001  # as above
    quads = {name: sum(len(own) for _, own in faces) for name, faces in solids.items()}
    return Geometry(
        faces=sum(quads.values()),
        placed=sum(quads[name] * often for name, often in placed.items()),
        bytes=sum(array.nbytes for faces in solids.values() for pair in faces for array in pair),
    )
