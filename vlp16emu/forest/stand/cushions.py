"""Cushions of moss in the far medium: their sides on squares of the ground."""

from functools import cache

import numpy as np

from vlp16emu.elementary import cos, matvec, norm, sin
from vlp16emu.foliage.tiles import SIDE_CODES, SIDE_ROW_BIT
from vlp16emu.foliage.voxel import COLUMNS, FINER, QUANTILES, VOXEL_M
from vlp16emu.forest.stand.floor_shapes import FLOOR_VARIANTS, FloorKey, FloorKind, floor, floor_meshes
from vlp16emu.forest.stand.placement import Tile
from vlp16emu.types import F4, F8, U4

_SINE = 0.1
"""Sine of the elevation at which a cushion is measured: that of a sensor 2 m over the ground at 20 m."""
_AZIMUTH = (np.arange(64) + 0.5) * (np.pi / 32)
_SQUARE_M = VOXEL_M / FINER
_SPREAD = np.array([(x, y) for x in np.linspace(-1, 1, 5) for y in np.linspace(-1, 1, 5)])
"""Places about a cushion of diameter 1 among whose squares its side is divided: low light misses the ground
under the cushion, and up to ten times its height behind it."""


@cache
def side_of(seed: int) -> tuple[F8, F4]:
    """Return the side of cushions, and what of it faces low light.

    Returns
    -------
    Projected area (variants,) of the part over the ground, for a height of 1; and quantiles (QUANTILES,) of
    the cosine of incidence.
    """
    spread = floor()["layers"]["moss"]["spread"]
    level = np.sqrt(1.0 - _SINE * _SINE)
    side = np.empty(FLOOR_VARIANTS)
    found = []
    for variant in range(FLOOR_VARIANTS):
        (mesh,) = floor_meshes(seed, FloorKey(FloorKind.MOSS_CUSHION, variant))
        corners = mesh.vertices_m[mesh.faces] * np.array([spread, spread, 1.0])
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
        low, high = corners[..., 2].min(axis=1), corners[..., 2].max(axis=1)
        over = np.clip(high, 0.0, None) / np.maximum(high - np.minimum(low, 0.0), 1e-9)
        toward = level * (normal[:, 0] * cos(_AZIMUTH)[:, None] + normal[:, 1] * sin(_AZIMUTH)[:, None])
        light = np.maximum(toward + _SINE * normal[:, 2], 0.0)
        met = over * light
        side[variant] = met.sum() / len(_AZIMUTH)
        found.append(np.stack([light / norm(normal), met]).reshape(2, -1))
    cosine, weight = np.concatenate(found, axis=1)
    order = np.argsort(cosine, kind="stable")
    so_far = np.cumsum(weight[order])
    wanted = (np.arange(QUANTILES) + 0.5) / QUANTILES * so_far[-1]
    return side, cosine[order][np.searchsorted(so_far, wanted)].astype(np.float32)


def sides_on(corner_m: F8, tile: Tile, seed: int) -> U4:
    """Return the `FarTile.sides` of the cushions of a tile with its corner (3,)."""
    variant_of = np.full(len(tile.keys), -1, np.int64)
    for number, key in enumerate(tile.keys):
        if isinstance(key, FloorKey) and key.kind is FloorKind.MOSS_CUSHION:
            variant_of[number] = key.variant
    cushion = np.flatnonzero(variant_of[tile.shape] >= 0)
    world_T_shape = tile.world_T_shape[cushion]
    row = tile.first_surface[cushion]
    squares = COLUMNS * FINER
    height_m = norm(world_T_shape[:, :, 2])
    area_m2 = side_of(seed)[0][variant_of[tile.shape[cushion]]] * height_m * height_m
    at_m = world_T_shape[:, None, :2, 3] + matvec(world_T_shape[:, None, :2, :2], _SPREAD)
    square = np.floor((at_m - corner_m[:2]) / _SQUARE_M).astype(np.int64)
    inside = ((square >= 0) & (square < squares)).all(axis=-1)
    place = (square[..., 0] * squares + square[..., 1])[inside]
    part_m2 = np.broadcast_to(area_m2[:, None] / len(_SPREAD), inside.shape)[inside]
    share = np.bincount(place, part_m2, squares * squares) / (_SQUARE_M * _SQUARE_M)
    code = np.where(share > 0.0, np.clip(np.round(SIDE_CODES * share), 1, SIDE_CODES), 0).astype(np.uint32)
    of_square = np.zeros(squares * squares, np.uint32)
    of_square[place] = np.broadcast_to(row[:, None], inside.shape)[inside]
    return (of_square << np.uint32(SIDE_ROW_BIT) | code).reshape(squares, squares)
