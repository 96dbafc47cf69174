"""The plane in square tiles: tiles near a line, and their ground as triangles, large on even ground.

Right triangles are bisected repeatedly from the middle of their longest side, if the ground is off that
middle (Evans, Kirkpatrick and Townsend, "Right-triangulated irregular networks", Algorithmica 30, 2001). A
cut is made in both triangles at a side, together with the coarser cuts that it depends on, so that no vertex
lies on a side of another triangle.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlp16emu.foliage.polyline import Polyline
from vlp16emu.types import F8, I8, HeightField, Mesh

Mask = NDArray[np.bool_]
_CELL_M = 0.5  # edge of the initial squares
_FINEST = 16  # steps of the finest grid along that edge, 31 mm each
_LOOKED_AT = (16, 8, 4, 2)
"""Edges, in these steps, of squares at whose centre and sides the ground is compared: the largest everywhere,
smaller ones only if the ground is off in the enclosing square or in a neighbour of it. A hollow may be missed
between points that are as far apart as it is wide, but not in a neighbouring square."""
_CUTS = 8  # successive cuts of a half square, down to halves of the finest squares
_OFF_M = 0.004
"""Tolerance of the ground at the middle of an uncut side; elsewhere on a triangle the error is little
more."""
_APRON = 2
"""Border of squares whose cuts are computed too: cuts reach at most into the neighbouring square."""


def ground_triangles(corner_m: tuple[float, float], edge_m: float, height_m: HeightField) -> tuple[F8, I8]:
    """Triangulate the ground of a square; neighbouring squares have the same vertices along the border.

    The south-west corner is at whole multiples of 0.5 m, and the edge is in whole metres. Returns vertices
    (n, 3) in the world, by rows from south to north, and faces (m, 3), counter-clockwise as seen from above.
    """
    cells = round(edge_m / _CELL_M)
    ground = _Ground(corner_m, (cells + 2 * _APRON) * _FINEST + 1, height_m)
    inner = np.arange(_APRON, _APRON + cells) * _FINEST
    # Both halves of each square: tip, and ends of the longest side.
    corner = (inner[:, None] * ground.side + inner).ravel()
    east, north = corner + _FINEST, corner + _FINEST * ground.side
    halves = [np.column_stack(t) for t in ((east, north + _FINEST, corner), (north, corner, north + _FINEST))]
    used, corners = np.unique(_bisect(np.concatenate(halves), _cuts(ground).ravel()), return_inverse=True)
    return ground.points_m(used), corners.reshape(-1, 3)


class _Ground:
    """Heights on the finest grid, computed on request."""

    def __init__(self, corner_m: tuple[float, float], side: int, height_m: HeightField) -> None:
        self.side = side
        self._height_m = height_m
        self._first_m = np.array(corner_m) - _APRON * _CELL_M
        self.z_m = np.full((side, side), np.nan)

    def ask(self, wanted: Mask) -> None:
        """Compute unknown heights at the points of a mask (side, side)."""
        self.points_m(np.flatnonzero(wanted & np.isnan(self.z_m)))

    def points_m(self, numbers: I8) -> F8:
        """Points (n, 3) of the grid by number, row by row."""
        row, column = np.divmod(numbers, self.side)
        xy_m = self._first_m[:, None] + np.array([column, row]) * (_CELL_M / _FINEST)
        z_m = self.z_m.reshape(-1)
        new = np.isnan(z_m[numbers])
        z_m[numbers[new]] = self._height_m(*xy_m[:, new])
        return np.column_stack([*xy_m, z_m[numbers]])


def _cuts(ground: _Ground) -> Mask:
    """Mask (side, side) of vertices at which the ground is off the side.

    It includes the vertices that such cuts depend on.
    """
    cut = np.zeros(ground.z_m.shape, np.bool_)
    off_m = np.full((ground.side // (2 * _FINEST),) * 2, np.inf)
    for step in _LOOKED_AT:
        ground.ask(_around(off_m > _OFF_M, 2 * step))
        half = step // 2
        z = ground.z_m
        corner = z[::step, ::step]
        is_anti = _is_anti(ground.side, step)
        main = (corner[:-1, :-1] + corner[1:, 1:]) / 2
        anti = (corner[:-1, 1:] + corner[1:, :-1]) / 2
        middle = np.abs(z[half::step, half::step] - np.where(is_anti, anti, main))
        across = np.abs(z[::step, half::step] - (corner[:, :-1] + corner[:, 1:]) / 2)
        up = np.abs(z[half::step, ::step] - (corner[:-1] + corner[1:]) / 2)
        cut[half::step, half::step] = middle > _OFF_M
        cut[::step, half::step] = across > _OFF_M
        cut[half::step, ::step] = up > _OFF_M
        off_m = np.fmax.reduce([middle, across[:-1], across[1:], up[:, :-1], up[:, 1:]])
    # Each cut depends on the cuts of the coarser squares around it.
    for step in reversed(_LOOKED_AT):
        half = step // 2
        tips = cut[::step, ::step]
        sides = cut[::step, half::step]
        ends = cut[half::step, ::step]
        centres = cut[half::step, half::step]
        centres |= sides[:-1] | sides[1:] | ends[:, :-1] | ends[:, 1:]
        if step < _FINEST:
            falling = centres & _is_anti(ground.side, step)
            tips[:-1, :-1] |= falling
            tips[1:, 1:] |= falling
            tips[:-1, 1:] |= centres & ~falling
            tips[1:, :-1] |= centres & ~falling
    return cut


def _around(squares: Mask, edge: int) -> Mask:
    """Mask (side, side) of points in squares and their neighbours, five along each edge."""
    side = len(squares) * edge + 1
    fine = edge // 4
    beside = np.lib.stride_tricks.sliding_window_view(np.pad(squares, 1), (3, 3))
    points = np.zeros((side, side), np.bool_)
    within = np.pad(np.asarray(beside.any(axis=(2, 3))).repeat(4, axis=0).repeat(4, axis=1), 1)
    points[::fine, ::fine] = within[1:, 1:] | within[:-1, 1:] | within[1:, :-1] | within[:-1, :-1]
    return points


def _is_anti(side: int, step: int) -> Mask:
    """Return a mask of the squares of `step` that are cut from south-east to north-west.

    They alternate within a larger square.
    """
    n = np.arange(side // step)
    return (n[:, None] + n) % 2 == 1 if step < _FINEST else np.zeros((len(n), len(n)), np.bool_)


def _bisect(triangles: I8, cut: Mask) -> I8:
    """Cut triangles (n, 3) until none has a cut in the middle of its longest side."""
    done = []
    for _ in range(_CUTS):
        tip, first, second = triangles.T
        middle = (first + second) // 2
        is_cut = cut[middle]
        done.append(triangles[~is_cut])
        tip, first, second, middle = (corner[is_cut] for corner in (tip, first, second, middle))
        triangles = np.concatenate(
            [np.column_stack([middle, tip, first]), np.column_stack([middle, second, tip])]
        )
    return np.concatenate([*done, triangles])


TILE_M = 20.0  # edge of a tile. Tile (ix, iy) spans TILE_M * ix .. TILE_M * (ix + 1) in x, and likewise in y.
_HALF_DIAGONAL_M = TILE_M / 2 * np.sqrt(2.0)
_SKIRT_M = 0.5  # depth of the skirt under a tile's border, which hides seams from rounding


@dataclass(frozen=True, slots=True)
class TileKey:
    """Key of a tile's shape: its ground and its stems."""

    ix: int
    iy: int


@dataclass(frozen=True, slots=True)
class GroundKey:
    """Key of the shape of a tile's ground without its stems."""

    ix: int
    iy: int


def tiles_within(line_xy_m: F8, reach_m: float) -> I8:
    """Return tiles (n, 2) that may be partly within `reach_m` of a polyline (m, 2).

    Their ix and iy are in ascending order.
    """
    reach = reach_m + _HALF_DIAGONAL_M
    low = np.floor((line_xy_m.min(axis=0) - reach) / TILE_M).astype(np.int64)
    high = np.floor((line_xy_m.max(axis=0) + reach) / TILE_M).astype(np.int64)
    ix, iy = np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True)), indexing="ij")
    tiles = np.column_stack([ix.ravel(), iy.ravel()])
    return tiles[_centre_distance_m(tiles, Polyline(line_xy_m)) <= reach]


def around(ix: int, iy: int, values_of: Callable[[int, int], F8]) -> F8:
    """Concatenate the results for a tile and the eight around it."""
    return np.concatenate([values_of(ix + i, iy + j) for i in (-1, 0, 1) for j in (-1, 0, 1)])


def tile_distance_m(tile: tuple[int, int], path: Polyline) -> float:
    """Return a lower bound of the distance of a tile from a path; 0 or more."""
    return max(float(_centre_distance_m(np.array([tile]), path)[0]) - _HALF_DIAGONAL_M, 0.0)


def _centre_distance_m(tiles: I8, line: Polyline) -> F8:
    return line.distance_m(TILE_M * tiles.astype(np.float64) + TILE_M / 2)


def tile_origin_m(ix: int, iy: int, height_m: HeightField) -> F8:
    """Origin (3,) of a tile's frame: its south-west corner, at a whole metre near the ground."""
    x, y = ix * TILE_M, iy * TILE_M
    middle = height_m(np.array([x + TILE_M / 2]), np.array([y + TILE_M / 2]))
    return np.array([x, y, np.round(middle[0])])


def ground_mesh(key: TileKey | GroundKey, height_m: HeightField) -> Mesh:
    """Triangles of a tile's ground in the tile's frame, with a skirt that hides seams."""
    points_m, faces = ground_triangles((key.ix * TILE_M, key.iy * TILE_M), TILE_M, height_m)
    points_m -= tile_origin_m(key.ix, key.iy, height_m)
    x, y = points_m[:, 0], points_m[:, 1]
    south, east, north, west = (np.flatnonzero(on) for on in (y == 0, x == TILE_M, y == TILE_M, x == 0))
    top = np.concatenate([south[:-1], east[:-1], north[:0:-1], west[:0:-1]])
    hem_m = points_m[top] - [0.0, 0.0, _SKIRT_M]
    hem = len(points_m) + np.arange(len(top))
    next_top = np.roll(top, -1)
    next_hem = np.roll(hem, -1)
    sides = [np.column_stack(corners) for corners in ((top, hem, next_hem), (top, next_hem, next_top))]
    vertices_m = np.concatenate([points_m, hem_m]).astype(np.float32)
    return Mesh(vertices_m, np.concatenate([faces, *sides]).astype(np.uint32))
