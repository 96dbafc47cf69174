"""Stems: closed meshes, one for each tree, whose diameter at breast height is exact.

Where a stem's axis is 1.3 m above the ground at its foot there is a ring of vertices, and across the
axis there the mesh's cross-section has exactly the area of a circle of the recorded diameter.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from vlp16emu.types import HeightField, Mesh
from vlp16emu.world.species import BREAST_HEIGHT_M, taper_radius_m, tapers

__all__ = ["lean_rotation", "stem_meshes"]

Array = NDArray[np.float64]
Trees = NDArray[np.void]

_BURIED_M = 0.1
"""How far the foot reaches below the lowest ground around it."""

_THICK_DBH_M = 0.5
"""Thicker stems near the path get `_Detail.thick_sides`."""


@dataclass(frozen=True, slots=True)
class _Detail:
    """How finely stems are drawn at one level."""

    sides: int
    thick_sides: int
    butt_m: tuple[float, ...]
    """Heights of rings from the ground to breast height."""
    upper: tuple[float, ...]
    """Rings above, as shares of the way from breast height to the tip."""


_DETAIL = (
    _Detail(24, 32, (0.0, 0.12, 0.35, 0.75, BREAST_HEIGHT_M), (0.08, 0.18, 0.3, 0.45, 0.6, 0.75, 0.88, 0.96)),
    _Detail(12, 12, (0.0, 0.35, BREAST_HEIGHT_M), (0.2, 0.45, 0.7, 0.9)),
    _Detail(8, 8, (0.0, 0.5, BREAST_HEIGHT_M), (0.35, 0.7, 0.92)),
)


def lean_rotation(lean_deg: Array, towards_deg: Array) -> Array:
    """Rotations (n, 3, 3) that tip the vertical by `lean_deg` towards an angle from east, without twist."""
    tilt, towards = np.radians(lean_deg), np.radians(towards_deg)
    c, s = np.cos(towards), np.sin(towards)
    v, w = 1 - np.cos(tilt), np.sin(tilt)
    rows = [[1 - v * c * c, -v * c * s, w * c], [-v * c * s, 1 - v * s * s, w * s], [-w * c, -w * s, 1 - v]]
    return np.moveaxis(np.array(rows), -1, 0)


def stem_meshes(trees: Trees, level: int, origin_m: Array, height_m: HeightField) -> list[Mesh]:
    """Stems of a tile's trees, relative to the tile's origin (3,), in the order of the trees."""
    detail = _DETAIL[level]
    rings_m = _ring_heights_m(trees, detail, height_m)
    radius_m = taper_radius_m(tapers(trees["species"]), trees["dbh_m"], trees["height_m"], rings_m)
    foot = np.column_stack([trees["x_m"], trees["y_m"], trees["z_m"]]) - origin_m
    frame = lean_rotation(trees["lean_deg"], trees["lean_towards_deg"])
    sides = np.where(trees["dbh_m"] > _THICK_DBH_M, detail.thick_sides, detail.sides)
    along_m = rings_m / frame[:, 2, 2, None]
    tip_m = trees["height_m"] / frame[:, 2, 2]
    phase = np.radians(trees["crown_azimuth_deg"])
    meshes: dict[int, Mesh] = {}
    for count in np.unique(sides):
        own = np.flatnonzero(sides == count)
        local = _stems(int(count), radius_m[own], along_m[own], tip_m[own], phase[own])
        vertices = np.einsum("nij,nvj->nvi", frame[own], local) + foot[own, None]
        faces = _faces(int(count), rings_m.shape[1])
        meshes |= {int(i): Mesh(v, faces) for i, v in zip(own, vertices.astype(np.float32), strict=True)}
    return [meshes[i] for i in range(len(trees))]


def _ring_heights_m(trees: Trees, detail: _Detail, height_m: HeightField) -> Array:
    """Heights of the rings over each foot, (n, rings); the lowest lies in the ground all around the flare."""
    n = len(trees)
    taper = tapers(trees["species"])
    flare = taper_radius_m(taper, trees["dbh_m"], trees["height_m"], np.zeros((n, 1)))
    around = np.arange(8) * (np.pi / 4)
    ground = height_m(
        trees["x_m"][:, None] + flare * np.cos(around), trees["y_m"][:, None] + flare * np.sin(around)
    )
    sunk = np.minimum(ground.min(axis=1) - trees["z_m"], 0.0) - _BURIED_M
    butt = np.broadcast_to(detail.butt_m, (n, len(detail.butt_m)))
    upper = BREAST_HEIGHT_M + (trees["height_m"][:, None] - BREAST_HEIGHT_M) * np.array(detail.upper)
    return np.concatenate([sunk[:, None], butt, upper], axis=1)


def _stems(sides: int, radius_m: Array, along_m: Array, tip_m: Array, phase: Array) -> Array:
    """Vertices with the axis upright: rings from the bottom up, then the bottom's middle, then the tip."""
    n, rings = radius_m.shape
    step = 2 * np.pi / sides
    # The polygon's corners stand out so far that its area is that of the circle.
    corner_m = radius_m[..., None] * np.sqrt(step / np.sin(step))
    angle = (phase[:, None] + step * np.arange(sides))[:, None]
    z = np.broadcast_to(along_m[..., None], (n, rings, sides))
    ring = np.stack([corner_m * np.cos(angle), corner_m * np.sin(angle), z], axis=-1)
    ends = np.zeros((n, 2, 3))
    ends[:, 0, 2], ends[:, 1, 2] = along_m[:, 0], tip_m
    return np.concatenate([ring.reshape(n, rings * sides, 3), ends], axis=1)


@cache
def _faces(sides: int, rings: int) -> NDArray[np.uint32]:
    """Triangles of a closed stem, shared by all stems with as many sides and rings."""
    here = np.arange(sides)
    after = np.roll(here, -1)
    middle, tip = np.full(sides, rings * sides), np.full(sides, rings * sides + 1)
    top = (rings - 1) * sides
    triangles: list[Sequence[NDArray[np.int64]]] = [(after, here, middle), (top + here, top + after, tip)]
    for low, high in pairwise(np.arange(rings) * sides):
        triangles += [(low + here, low + after, high + after), (low + here, high + after, high + here)]
    faces = np.concatenate([np.column_stack(t) for t in triangles]).astype(np.uint32)
    faces.flags.writeable = False
    return faces
