"""The plane cut into square tiles: which are near a line, and their ground."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vlp16emu.forest.ground.triangles import ground_triangles
from vlp16emu.types import Array, HeightField, IntArray, Mesh
from vlp16emu.world.polyline import Polyline

TILE_M = 20.0  # edge of a tile. Tile (ix, iy) spans TILE_M * ix .. TILE_M * (ix + 1) in x, and likewise in y.
_HALF_DIAGONAL_M = TILE_M / 2 * np.sqrt(2.0)
_SKIRT_M = 0.5  # depth of the hem under a tile's border, which hides the seams that rounding leaves


@dataclass(frozen=True, slots=True)
class TileKey:
    """Name of a tile's shape: its ground and its stems."""

    ix: int
    iy: int


def tiles_within(line_xy_m: Array, reach_m: float) -> IntArray:
    """Tiles (n, 2), ix and iy in ascending order, that may lie in part within `reach_m` of a polyline (m, 2)."""
    reach = reach_m + _HALF_DIAGONAL_M
    low = np.floor((line_xy_m.min(axis=0) - reach) / TILE_M).astype(np.int64)
    high = np.floor((line_xy_m.max(axis=0) + reach) / TILE_M).astype(np.int64)
    ix, iy = np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True)), indexing="ij")
    tiles = np.column_stack([ix.ravel(), iy.ravel()])
    return tiles[_centre_distance_m(tiles, Polyline(line_xy_m)) <= reach]


def around(ix: int, iy: int, of: Callable[[int, int], Array]) -> Array:
    """Join what there is of a tile and of the eight around it."""
    return np.concatenate([of(ix + i, iy + j) for i in (-1, 0, 1) for j in (-1, 0, 1)])


def tile_distance_m(tile: tuple[int, int], path: Polyline) -> float:
    """Distance that no point of a tile is nearer to a path than; 0 or more."""
    return max(float(_centre_distance_m(np.array([tile]), path)[0]) - _HALF_DIAGONAL_M, 0.0)


def _centre_distance_m(tiles: IntArray, line: Polyline) -> Array:
    return line.distance_m(TILE_M * tiles.astype(np.float64) + TILE_M / 2)


def tile_origin_m(ix: int, iy: int, height_m: HeightField) -> Array:
    """Origin of a tile's own frame, (3,): its south-west corner, at a whole metre near the ground."""
    x, y = ix * TILE_M, iy * TILE_M
    middle = height_m(np.array([x + TILE_M / 2]), np.array([y + TILE_M / 2]))
    return np.array([x, y, np.round(middle[0])])


def ground_mesh(key: TileKey, height_m: HeightField) -> Mesh:
    """Triangles of a tile's ground in the tile's own frame, with a hem that hides the seams."""
    points_m, faces = ground_triangles((key.ix * TILE_M, key.iy * TILE_M), TILE_M, height_m)
    points_m -= tile_origin_m(key.ix, key.iy, height_m)
    border = _border(points_m)
    hem_m = points_m[border] - [0.0, 0.0, _SKIRT_M]
    top, hem = border, len(points_m) + np.arange(len(border))
    next_top, next_hem = np.roll(top, -1), np.roll(hem, -1)
    sides = [np.column_stack(corners) for corners in ((top, hem, next_hem), (top, next_hem, next_top))]
    vertices_m = np.concatenate([points_m, hem_m]).astype(np.float32)
    return Mesh(vertices_m, np.concatenate([faces, *sides]).astype(np.uint32))


def _border(points_m: Array) -> IntArray:
    x, y = points_m[:, 0], points_m[:, 1]
    south, east, north, west = (np.flatnonzero(on) for on in (y == 0, x == TILE_M, y == TILE_M, x == 0))
    return np.concatenate([south[:-1], east[:-1], north[:0:-1], west[:0:-1]])
