"""Stems: two meshes for each tree, root flare and stem, which together are closed and exact at breast height.

Where a stem's axis is 1.3 m above the ground at its foot there is a ring of vertices, and across the axis as it runs
there the mesh's cross-section has exactly the area of a circle of the recorded diameter. A second leader is a closed
piece of the stem's mesh that begins within the first, whose tip is the mesh's last vertex.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import atan2, cos, hypot, matvec, norm, sin
from vlp16emu.forest.plants.flora import Table, Trees
from vlp16emu.forest.plants.meshes import merged, pipe_faces
from vlp16emu.forest.plants.stem_rings import StemRings, axis_m, second_leaders, stem_rings, tip_radius_m
from vlp16emu.forest.plants.surface_roots import ROOT_RINGS, ROOT_SIDES, root_points
from vlp16emu.forest.tiles import TileKey
from vlp16emu.types import Array, HeightField, Mesh, PlantPart
from vlp16emu.world.vectors import places_m

STEM_PARTS = (PlantPart.ROOT_FLARE, PlantPart.STEM)
"""Of the meshes of a stem, in order."""

_SPLINTER_SHARE = 0.8
"""How far off the axis the tip of a broken stem is, over the radius of the highest ring: a slanting break."""

_BURIED_M = 0.1  # how far the foot reaches below the lowest ground around it
_WIDEST = 1.3  # reach of a butt's lobes over the radius of its circle

_LEADER_SIDES, _LEADER_RINGS = 16, (0.0, 0.06, 0.15, 0.3, 0.5, 0.75, 0.92)
"""Of a second leader: sides, and rings as shares of the way from fork to tip."""

_STEP_M = 1e-3  # over which the slope of an axis is taken


@dataclass(frozen=True, slots=True)
class StemKey:
    """Name of the shape of a single stem, in the frame of its tile."""

    tile: TileKey
    number: int  # among the trees of the tile


def lean_rotation(lean_deg: Array, towards_deg: Array) -> Array:
    """Rotations (n, 3, 3) that tip the vertical by `lean_deg` towards an angle from east, without twist."""
    tilt, towards = np.radians(lean_deg), np.radians(towards_deg)
    c, s = cos(towards), sin(towards)
    v, w = 1 - cos(tilt), sin(tilt)
    rows = [[1 - v * c * c, -v * c * s, w * c], [-v * c * s, 1 - v * s * s, w * s], [-w * c, -w * s, 1 - v]]
    return np.moveaxis(np.array(rows), -1, 0)


def stem_meshes(trees: Trees, origin_m: Array, height_m: HeightField, *, table: Table | None = None) -> list[Mesh]:
    """Meshes of `STEM_PARTS` of a tile's trees, tree by tree, relative to the tile's origin (3,); root flares have their roots."""
    rings = stem_rings(trees, table=table)
    rings.above_ground_m[:, 0] = -_buried_m(trees, rings, height_m)
    foot_m = places_m(trees) - origin_m
    meshes = _meshes(trees, rings, foot_m, table)
    for stem, root_m in zip(*root_points(trees, rings, height_m), strict=True):
        root = Mesh((root_m + foot_m[stem]).astype(np.float32), pipe_faces(ROOT_SIDES, ROOT_RINGS))
        meshes[len(STEM_PARTS) * stem] = merged(meshes[len(STEM_PARTS) * stem], root)
    return meshes


def stems_above_ground(trees: Trees, *, table: Table | None = None) -> list[Mesh]:
    """Meshes as `stem_meshes` makes them, but with all feet at the origin, no roots, and nothing buried."""
    rings = stem_rings(trees, table=table)
    rings.above_ground_m[:, 0] = 0.0
    return _meshes(trees, rings, np.zeros((len(trees), 3)), table)


def stem_slopes(axis: Callable[[Array], Array], above_m: Array) -> Array:
    """How far axes go aside, east and north (n, r, 2), for each metre up at heights (n, r)."""
    slope: Array = (axis(above_m + _STEP_M) - axis(above_m - _STEP_M))[..., :2] / (2 * _STEP_M)
    return slope


def vertex_angles(trees: Trees, sides: int) -> Array:
    """Angles (n, sides) of a ring's vertices around the axis, from east, counter-clockwise."""
    angle: Array = np.radians(trees["crown_azimuth_deg"])[:, None] + np.arange(sides) * 2 * np.pi / sides
    return angle


def _buried_m(trees: Trees, rings: StemRings, height_m: HeightField) -> Array:
    """How far each foot (n,) must reach down to lie in the ground all around the flare, lobes and all."""
    flare_m = _WIDEST * rings.radius_m[:, :1]
    around = np.arange(8) * (np.pi / 4)
    ground_m = height_m(trees["x_m"][:, None] + flare_m * cos(around), trees["y_m"][:, None] + flare_m * sin(around))
    slope = stem_slopes(partial(axis_m, trees, rings.forms), np.zeros((len(trees), 1)))
    raised_m = (flare_m * norm(slope))[:, 0]
    buried: Array = _BURIED_M + raised_m - np.minimum(ground_m.min(axis=1) - trees["z_m"], 0.0)
    return buried


def _meshes(trees: Trees, rings: StemRings, foot_m: Array, table: Table | None) -> list[Mesh]:
    """Meshes of `STEM_PARTS`, tree by tree, of stems whose feet are at (n, 3)."""
    tip_m = _tips_m(trees, rings, table)
    second = dict(zip(rings.forked.tolist(), _leaders(trees, rings, table), strict=True))
    meshes: dict[int, tuple[Mesh, Mesh]] = {}
    for count in np.unique(rings.sides):
        own, sides = np.flatnonzero(rings.sides == count), int(count)
        angle, forms = vertex_angles(trees[own], sides), rings.forms.of(own)
        above_m, breast_m = rings.above_ground_m[own], trees["dbh_m"][own] / 2
        away_m = forms.outline(angle, above_m, rings.radius_m[own], breast_m)
        pipes_m = _pipes(partial(axis_m, trees[own], forms), above_m, away_m, angle)
        flare = pipe_faces(sides, rings.flare_rings, top=False)
        upper = pipe_faces(sides, above_m.shape[1] - rings.flare_rings + 1, bottom=False)
        shared = 1 + sides * (rings.flare_rings - 1)
        for tree, points_m in zip(own.tolist(), pipes_m, strict=True):
            top_m = np.concatenate([points_m[shared:], tip_m[tree : tree + 1]])
            stem = [*second.get(tree, ()), (top_m, upper)]
            pieces = (Mesh((at_m + foot_m[tree]).astype(np.float32), faces) for at_m, faces in stem)
            below = (points_m[: shared + sides] + foot_m[tree]).astype(np.float32)
            meshes[tree] = Mesh(below, flare), merged(*pieces)
    return [mesh for tree in range(len(trees)) for mesh in meshes[tree]]


def _leaders(trees: Trees, rings: StemRings, table: Table | None) -> list[list[tuple[Array, NDArray[np.uint32]]]]:
    """Vertices relative to the foot, and faces, of the second leader of each stem that forks."""
    leaders = second_leaders(trees, rings, np.array([*_LEADER_RINGS, 1.0]), table=table)
    above_m, radius_m = leaders.above_ground_m[:, :-1], leaders.radius_m[:, :-1]
    angle = vertex_angles(leaders.trees, _LEADER_SIDES)
    away_m = leaders.forms.outline(angle, above_m, radius_m, leaders.trees["dbh_m"] / 2)
    pipes_m = _pipes(leaders.axis_m, above_m, away_m, angle)
    tips_m = leaders.axis_m(leaders.above_ground_m[:, -1:])
    faces = pipe_faces(_LEADER_SIDES, len(_LEADER_RINGS))
    return [[(points_m, faces)] for points_m in np.concatenate([pipes_m, tips_m], axis=1)]


def _tips_m(trees: Trees, rings: StemRings, table: Table | None) -> Array:
    """Tips (n, 3) relative to the feet; that of a broken stem is off the axis."""
    tip_m = axis_m(trees, rings.forms, trees["height_m"][:, None])[:, 0]
    phase = np.radians(trees["crown_azimuth_deg"])
    broken = tip_radius_m(trees, table=table) > 0
    aside_m = np.where(broken, _SPLINTER_SHARE * rings.radius_m[:, -1], 0.0)
    across = lean_rotation(trees["lean_deg"], trees["lean_towards_deg"])[:, :, :2]
    splinter_m = aside_m[:, None] * np.column_stack([cos(phase), sin(phase)])
    return tip_m + matvec(across, splinter_m)


def _pipes(axis: Callable[[Array], Array], above_m: Array, away_m: Array, angle: Array) -> Array:
    """Vertices (n, 1 + rings * sides, 3): the bottom's middle, and rings across the axis, vertices `away_m` (n, rings, sides) from it."""
    n, rings, sides = away_m.shape
    east, north = np.moveaxis(stem_slopes(axis, above_m), -1, 0)
    tilt, towards = np.degrees(atan2(hypot(east, north), 1.0)), np.degrees(atan2(north, east))
    across = lean_rotation(tilt.ravel(), towards.ravel())[:, :, :2].reshape(n, rings, 3, 2)
    flat_m = away_m[..., None] * np.stack([cos(angle), sin(angle)], axis=-1)[:, None]
    middle_m = axis(above_m)
    ring_m = middle_m[:, :, None] + matvec(across[:, :, None], flat_m)
    return np.concatenate([middle_m[:, :1], ring_m.reshape(n, rings * sides, 3)], axis=1)
