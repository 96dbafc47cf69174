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

from vlp16emu.elementary import atan2, cos, exp, hypot, matvec, norm, sin
from vlp16emu.forest.plants.flora import Table, Trees
from vlp16emu.forest.plants.meshes import merged, pipe_faces
from vlp16emu.forest.plants.stem_rings import StemRings, axis_m, second_leaders, stem_rings, tip_radius_m
from vlp16emu.forest.purpose import Growth
from vlp16emu.forest.tiles import TileKey
from vlp16emu.random import uniform
from vlp16emu.types import Array, HeightField, IntArray, Mesh, PlantPart
from vlp16emu.world.vectors import places_m, unit

_STATIONS = np.array([0.0, 0.08, 0.2, 0.4, 0.65, 1.0])
ROOT_SIDES, ROOT_RINGS = 6, len(_STATIONS)  # of a root's mesh, and where its rings are as shares of its length
_OLD_M = 0.3  # DBH from which trees have them; assumption
_MOST = 6  # roots of a tree: one to each lobe of its butt at most
_LENGTH, _LENGTH_M = (2.0, 4.5), (0.5, 2.0)  # over the DBH, and on the ground, least and most; assumptions
_RADIUS = (0.09, 0.15)  # at the butt over the DBH, least and most; assumption
_THINNER, _RISE, _RISE_M = 0.7, 1.5, 0.2
"""Share of its radius that a root loses on its way; how much higher than wide it leaves the butt, and over what length that
dies away by e; assumptions."""
_BURIED, _BEND, _ASIDE_RAD = 0.15, 0.12, 0.3
"""Of its height how far its middle lies in the ground before it dives; its bends over its length; range of its direction about
that of its lobe; assumptions."""
_TOP_M = 0.3
"""Over the foot above which no root reaches, lest it be part of a section at breast height: uphill it dives."""


def root_points(trees: Trees, rings: StemRings, height_m: HeightField) -> tuple[IntArray, Array]:
    """Roots of stems (n,), each from the seed of its stem's form.

    Of each (k,) the stem, and vertices (k, 1 + rings * sides + 1, 3) relative to its foot: the middle of the end in the butt,
    rings from there, and the tip.
    """
    number, _, phase = rings.forms.lobes.T
    seeds = [int(seed) for seed in trees["form"]]
    draws = np.array([uniform(seed, Growth.ROOT, 0, 5 * _MOST) for seed in seeds]).reshape(-1, _MOST, 5)
    is_there = (draws[..., 0] < rings.forms.surface_roots[:, None]) & (np.arange(_MOST) < number[:, None])
    stem, lobe = np.nonzero(is_there & (trees["dbh_m"] > _OLD_M)[:, None])
    turn, long, thick, bend = draws[stem, lobe, 1:].T
    dbh_m = trees["dbh_m"][stem]
    azimuth = (phase[stem] + 2 * np.pi * lobe) / number[stem] + _ASIDE_RAD * (turn - 0.5)
    length_m = np.clip(dbh_m * np.interp(long, (0, 1), _LENGTH), *_LENGTH_M)
    line_m = _lines(azimuth, length_m, bend) + 0.8 * rings.radius_m[stem, 1, None, None] * _unit(azimuth)
    wide_m = (dbh_m * np.interp(thick, (0, 1), _RADIUS))[:, None] * (1 - _THINNER * _STATIONS)
    high_m = wide_m * (1 + _RISE * exp(-_STATIONS * length_m[:, None] / _RISE_M))
    place = trees[stem]
    ground_m = height_m(place["x_m"][:, None] + line_m[..., 0], place["y_m"][:, None] + line_m[..., 1])
    sunk_m = high_m * (_BURIED + _STATIONS * _STATIONS * _STATIONS)
    z_m = np.minimum(ground_m - place["z_m"][:, None] - sunk_m, _TOP_M - high_m)
    return stem, _root_pipes(np.concatenate([line_m, z_m[..., None]], axis=2), wide_m, high_m)


def _unit(azimuth: Array) -> Array:
    """Level vectors (k, 1, 2) in directions (k,)."""
    return np.stack([cos(azimuth), sin(azimuth)], axis=-1)[:, None]


def _lines(azimuth: Array, length_m: Array, bend: Array) -> Array:
    """Middles (k, rings, 2) of roots seen from above, from where they begin; bends are draws (k,) from 0 to 1."""
    phase = 2 * np.pi * bend[:, None]
    aside_m = _BEND * length_m[:, None] * _STATIONS * (sin(5 * _STATIONS + phase) - sin(phase))
    along_m = length_m[:, None] * _STATIONS
    return along_m[..., None] * _unit(azimuth) + aside_m[..., None] * _unit(azimuth + np.pi / 2)


def _root_pipes(middle_m: Array, wide_m: Array, high_m: Array) -> Array:
    """Vertices of roots about middles (k, rings, 3), upright ellipses of half axes (k, rings) across them."""
    ahead = unit(np.gradient(middle_m[..., :2], axis=1))
    angle = (np.arange(ROOT_SIDES) + 0.5) * 2 * np.pi / ROOT_SIDES
    left_m = wide_m[..., None] * cos(angle)
    ring_m = np.repeat(middle_m[:, :, None], ROOT_SIDES, axis=2)
    ring_m[..., 0] -= ahead[..., None, 1] * left_m
    ring_m[..., 1] += ahead[..., None, 0] * left_m
    ring_m[..., 2] += high_m[..., None] * sin(angle)
    ring_m = ring_m.reshape(len(middle_m), ROOT_RINGS * ROOT_SIDES, 3)
    tip_m = middle_m[:, -1:].copy()
    tip_m[..., :2] += ahead[:, -1:] * wide_m[:, -1:, None]
    return np.concatenate([middle_m[:, :1], ring_m, tip_m], axis=1)


STEM_PARTS = (PlantPart.ROOT_FLARE, PlantPart.STEM)  # of the meshes of a stem, in order
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
    """Return the slopes of axes, east and north (n, r, 2), in metres aside per metre up at heights (n, r)."""
    return (axis(above_m + _STEP_M) - axis(above_m - _STEP_M))[..., :2] / (2 * _STEP_M)


def vertex_angles(trees: Trees, sides: int) -> Array:
    """Angles (n, sides) of a ring's vertices around the axis, from east, counter-clockwise."""
    return np.radians(trees["crown_azimuth_deg"])[:, None] + np.arange(sides) * 2 * np.pi / sides


def _buried_m(trees: Trees, rings: StemRings, height_m: HeightField) -> Array:
    """Return the depth (n,) of each foot that lies in the ground all around the flare, lobes and all."""
    flare_m = _WIDEST * rings.radius_m[:, :1]
    around = np.arange(8) * (np.pi / 4)
    ground_m = height_m(trees["x_m"][:, None] + flare_m * cos(around), trees["y_m"][:, None] + flare_m * sin(around))
    slope = stem_slopes(partial(axis_m, trees, rings.forms), np.zeros((len(trees), 1)))
    raised_m = (flare_m * norm(slope))[:, 0]
    return _BURIED_M + raised_m - np.minimum(ground_m.min(axis=1) - trees["z_m"], 0.0)


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
