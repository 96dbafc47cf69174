"""Stems: two meshes for each tree, root flare and stem, which together are closed and exact at breast height.

Where a stem's axis is 1.3 m above the ground at its foot there is a ring of vertices, and across the
axis there the mesh's cross-section has exactly the area of a circle of the recorded diameter.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from vlp16emu.types import HeightField, Mesh, PlantPart
from vlp16emu.world.plants.allometry import BREAST_HEIGHT_M, taper_radius_m
from vlp16emu.world.plants.flora import tapers
from vlp16emu.world.plants.species import Species
from vlp16emu.world.stand.tiles import STEM, TileKey

__all__ = ["STEM_PARTS", "StemKey", "StemRings", "far_stems", "lean_rotation", "stem_meshes", "stem_rings"]

Array = NDArray[np.float64]
Trees = NDArray[np.void]

STEM_PARTS = (PlantPart.ROOT_FLARE, PlantPart.STEM)
"""Of the meshes of a stem, in order."""

_FLARE_TOP_M = 0.5
"""Where the root flare ends and the stem begins, at a ring that both share; assumption."""

_SPLINTER_SHARE = 0.8
"""How far off the axis the tip of a broken stem is, over the radius of the highest ring: a slanting break."""

_BURIED_M = 0.1
"""How far the foot reaches below the lowest ground around it."""

_THICK_DBH_M = 0.5
"""Thicker stems get `_THICK_SIDES`."""

_SIDES, _THICK_SIDES = 24, 32
"""Of a stem's cross-section."""

_BUTT_M = (0.0, 0.12, 0.28, _FLARE_TOP_M, 0.85, BREAST_HEIGHT_M)
"""Heights of rings from the ground to breast height."""

_UPPER = (0.08, 0.18, 0.3, 0.45, 0.6, 0.75, 0.88, 0.96)
"""Rings above, as shares of the way from breast height to the tip."""


@dataclass(frozen=True, slots=True)
class StemKey:
    """Name of the shape of a single stem, in the frame of its tile."""

    tile: TileKey
    number: int
    """Among the trees of the tile."""


@dataclass(frozen=True, slots=True)
class StemRings:
    """What the stems of n trees are made of."""

    above_ground_m: Array
    """(n, r) height of each ring over the foot, vertical where it meets the axis; the first is buried."""
    radius_m: Array
    """(n, r) of the circle that has the ring's area."""
    sides: NDArray[np.int64]
    """(n,) of the cross-section."""
    flare_rings: int
    """How many of the rings belong to the root flare."""


def lean_rotation(lean_deg: Array, towards_deg: Array) -> Array:
    """Rotations (n, 3, 3) that tip the vertical by `lean_deg` towards an angle from east, without twist."""
    tilt, towards = np.radians(lean_deg), np.radians(towards_deg)
    c, s = np.cos(towards), np.sin(towards)
    v, w = 1 - np.cos(tilt), np.sin(tilt)
    rows = [[1 - v * c * c, -v * c * s, w * c], [-v * c * s, 1 - v * s * s, w * s], [-w * c, -w * s, 1 - v]]
    return np.moveaxis(np.array(rows), -1, 0)


def stem_meshes(
    trees: Trees,
    origin_m: Array,
    height_m: HeightField,
    *,
    table: Mapping[str, Species] | None = None,
) -> list[Mesh]:
    """Meshes of `STEM_PARTS` of a tile's trees, tree by tree, relative to the tile's origin (3,)."""
    buried_m = _buried_m(trees, height_m, table)
    rings = stem_rings(trees, buried_m=buried_m, table=table)
    foot = np.column_stack([trees["x_m"], trees["y_m"], trees["z_m"]]) - origin_m
    frame = lean_rotation(trees["lean_deg"], trees["lean_towards_deg"])
    along_m = rings.above_ground_m / frame[:, 2, 2, None]
    tip_m = trees["height_m"] / frame[:, 2, 2]
    # A tip of no radius is that of a whole tree; any other is off the axis.
    taper = tapers(trees["species"], table=table)
    at_tip_m = taper_radius_m(taper, trees["dbh_m"], trees["height_m"], trees["height_m"][:, None])[:, 0]
    aside_m = np.where(at_tip_m > 0, _SPLINTER_SHARE * rings.radius_m[:, -1], 0.0)
    phase = np.radians(trees["crown_azimuth_deg"])
    meshes: dict[int, tuple[Mesh, Mesh]] = {}
    for count in np.unique(rings.sides):
        own = np.flatnonzero(rings.sides == count)
        ends_m = along_m[own, 0], tip_m[own], aside_m[own]
        local = _stems(int(count), rings.radius_m[own], along_m[own], ends_m, phase[own])
        vertices = (np.einsum("nij,nvj->nvi", frame[own], local) + foot[own, None]).astype(np.float32)
        upper_rings = rings.radius_m.shape[1] - rings.flare_rings + 1
        flare, upper = _flare_faces(int(count), rings.flare_rings), _stem_faces(int(count), upper_rings)
        shared = 1 + int(count) * (rings.flare_rings - 1)
        for tree, mesh in zip(own, vertices, strict=True):
            meshes[int(tree)] = Mesh(mesh[: shared + count], flare), Mesh(mesh[shared:], upper)
    return [mesh for tree in range(len(trees)) for mesh in meshes[tree]]


def stem_rings(
    trees: Trees, *, buried_m: Array | None = None, table: Mapping[str, Species] | None = None
) -> StemRings:
    """Rings of stems; `buried_m` (n,) is how far each foot reaches below the ground."""
    n = len(trees)
    sunk = np.full(n, _BURIED_M) if buried_m is None else buried_m
    butt = np.broadcast_to(_BUTT_M, (n, len(_BUTT_M)))
    upper = BREAST_HEIGHT_M + (trees["height_m"][:, None] - BREAST_HEIGHT_M) * np.array(_UPPER)
    above_m = np.concatenate([-sunk[:, None], butt, upper], axis=1)
    taper = tapers(trees["species"], table=table)
    return StemRings(
        above_ground_m=above_m,
        radius_m=taper_radius_m(taper, trees["dbh_m"], trees["height_m"], above_m),
        sides=np.where(trees["dbh_m"] > _THICK_DBH_M, _THICK_SIDES, _SIDES),
        flare_rings=2 + _BUTT_M.index(_FLARE_TOP_M),
    )


def far_stems(
    trees: Trees, first_row: int, *, table: Mapping[str, Species] | None = None
) -> NDArray[np.void]:
    """Stems of n trees as `STEM`, circles in place of their polygons; rows of `STEM_PARTS` count on from the first."""
    rings = stem_rings(trees, table=table)
    stems = np.zeros(len(trees), STEM)
    axis = lean_rotation(trees["lean_deg"], trees["lean_towards_deg"])[:, :, 2]
    stems["foot_m"], stems["axis"] = np.column_stack([trees["x_m"], trees["y_m"], trees["z_m"]]), axis
    above_m = np.column_stack([rings.above_ground_m, trees["height_m"]])
    stems["along_m"] = above_m / axis[:, 2:]
    taper = tapers(trees["species"], table=table)
    stems["radius_m"] = taper_radius_m(taper, trees["dbh_m"], trees["height_m"], above_m)
    stems["flare_m"] = _FLARE_TOP_M / axis[:, 2]
    stems["row"] = first_row + len(STEM_PARTS) * np.arange(len(trees))[:, None] + [0, 1]
    return stems


def _buried_m(trees: Trees, height_m: HeightField, table: Mapping[str, Species] | None) -> Array:
    """How far each foot (n,) must reach down to lie in the ground all around the flare."""
    n = len(trees)
    taper = tapers(trees["species"], table=table)
    flare = taper_radius_m(taper, trees["dbh_m"], trees["height_m"], np.zeros((n, 1)))
    around = np.arange(8) * (np.pi / 4)
    ground = height_m(
        trees["x_m"][:, None] + flare * np.cos(around), trees["y_m"][:, None] + flare * np.sin(around)
    )
    buried: Array = _BURIED_M - np.minimum(ground.min(axis=1) - trees["z_m"], 0.0)
    return buried


def _stems(
    sides: int, radius_m: Array, along_m: Array, ends_m: tuple[Array, Array, Array], phase: Array
) -> Array:
    """Vertices with the axis upright: the bottom's middle, rings from the bottom up, then the tip.

    `ends_m` holds for each stem how high bottom and tip are, and how far the tip is off the axis.
    """
    n, rings = radius_m.shape
    step = 2 * np.pi / sides
    # The polygon's corners stand out so far that its area is that of the circle.
    corner_m = radius_m[..., None] * np.sqrt(step / np.sin(step))
    angle = (phase[:, None] + step * np.arange(sides))[:, None]
    z = np.broadcast_to(along_m[..., None], (n, rings, sides))
    ring = np.stack([corner_m * np.cos(angle), corner_m * np.sin(angle), z], axis=-1)
    ends = np.zeros((n, 2, 3))
    ends[:, 0, 2], ends[:, 1, 2], aside_m = ends_m
    ends[:, 1, 0], ends[:, 1, 1] = aside_m * np.cos(phase), aside_m * np.sin(phase)
    return np.concatenate([ends[:, :1], ring.reshape(n, rings * sides, 3), ends[:, 1:]], axis=1)


@cache
def _flare_faces(sides: int, rings: int) -> NDArray[np.uint32]:
    """Triangles of a flare, open at the top, whose first vertex is the middle of its bottom."""
    here = np.arange(sides)
    bottom = np.column_stack([np.roll(here, -1) + 1, here + 1, np.zeros(sides, np.int64)])
    return _frozen(bottom, 1 + _walls(sides, rings))


@cache
def _stem_faces(sides: int, rings: int) -> NDArray[np.uint32]:
    """Triangles of a stem, open at the bottom, whose last vertex is the tip."""
    here = (rings - 1) * sides + np.arange(sides)
    tip = np.column_stack([here, np.roll(here, -1), np.full(sides, rings * sides)])
    return _frozen(_walls(sides, rings), tip)


def _walls(sides: int, rings: int) -> NDArray[np.int64]:
    """Triangles between the rings of a pipe."""
    here = np.arange(sides)
    after = np.roll(here, -1)
    triangles: list[Sequence[NDArray[np.int64]]] = []
    for low, high in pairwise(np.arange(rings) * sides):
        triangles += [(low + here, low + after, high + after), (low + here, high + after, high + here)]
    return np.concatenate([np.column_stack(t) for t in triangles])


def _frozen(*triangles: NDArray[np.int64]) -> NDArray[np.uint32]:
    """All the triangles, not to be written to: stems with as many sides and rings share them."""
    faces = np.concatenate(triangles).astype(np.uint32)
    faces.flags.writeable = False
    return faces
