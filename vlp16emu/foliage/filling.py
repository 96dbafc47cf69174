"""The voxels of a tile: filled with the projected areas of its shapes, and packed brick by brick."""

import math
from typing import NamedTuple

import numpy as np

from vlp16emu.elementary import power
from vlp16emu.foliage.cloud import TILTS, Library
from vlp16emu.foliage.voxel import (
    BRICK,
    CODES,
    COLUMNS,
    CROWN,
    FINER,
    GROUND,
    KIND_BIT,
    LAW_BIT,
    LEVEL,
    LOW,
    MOST_PER_M,
    SHARE_BIT,
    TILE_BIT,
    TUFTS,
    VOXEL_M,
)
from vlp16emu.kernels.compiler import array_kernel, inline_kernel, kernel
from vlp16emu.trig import ZERO
from vlp16emu.types import F4, F8, I4, I8, U1, U4, U8

_PIECE_M = 0.25  # faces with longer sides are cut
_LEVEL_SHARE = 0.94
"""Share of the area of leaves that lie nearly level. They grow in layers, along which level light goes for
longer than a voxel, so that leaves hide each other beyond it: without the share they are met by 5 % too many
rays (`tools/near_far old_growth`)."""
_LEAST_OVER = 0.125
"""Least share of a voxel over the ground whose density is that of its area over this share."""

_Place = tuple[float, float, float]
_Whose = tuple[int, int, int]


class _Voxels(NamedTuple):
    """Voxels of a tile while they are filled."""

    head: I4  # (x, y, z) first owner of each voxel; -1 for none
    node: I8  # (n, 4) owners as linked lists: tile, row, law and next owner
    area: F8  # (n, 3) their projected areas at the knots
    low_m: float
    ground_m: F4


_Placed = tuple[I8, F8, I8, I8]
_Packed = tuple[U8, U4, U4, U4, U8]  # arrays of a block, in the order of `Block`


@array_kernel
def fill_block(
    library: Library, placements: _Placed, ground_m: F4, low_m: float, levels: int, projection: F8
) -> _Packed:
    """Fill the arrays of a block, in the order of `Block`.

    Parameters
    ----------
    placements : (n,) shapes, their transforms (n, 3, 4), first surfaces and numbers of tiles
    """
    shape, relative, row, tile_of = placements
    head = np.full((COLUMNS, COLUMNS, levels * BRICK), -1, np.int32)
    node = np.empty((4096, 4), np.int64)
    area = np.empty((4096, 3))
    used = ZERO
    add = np.empty(3)
    for p in range(shape.shape[0]):
        s = shape[p]
        T = relative[p]
        needed = used + library.first_cell[s + 1] - library.first_cell[s]
        for f in range(library.first_face[s], library.first_face[s + 1]):
            pieces = _pieces(T, library.corners_m[f])
            needed += pieces * pieces
        node, area = _with_capacity(node, area, used, needed)
        voxels = _Voxels(head, node, area, low_m, ground_m)
        used = _add_shape(library, s, voxels, used, T, (tile_of[p], row[p]), add, projection)
    flags = np.zeros(head.shape, np.uint32)
    _mark_ground(flags, ground_m, low_m)
    return _pack(head, flags, node, area, used, _volumes(head.shape[2], ground_m, low_m), library.tufts)


@array_kernel
def _with_capacity(node: I8, area: F8, used: int, needed: int) -> tuple[I8, F8]:
    room = len(node)
    while needed > room:
        room *= 2
        bigger = np.empty((room, 4), np.int64)
        larger_area = np.empty((room, 3))
        bigger[:used] = node[:used]
        larger_area[:used] = area[:used]
        node = bigger
        area = larger_area
    return node, area


@kernel
def _add_shape(
    library: Library,
    s: int,
    voxels: _Voxels,
    used: int,
    T: F8,
    placed: tuple[int, int],
    add: F8,
    projection: F8,
) -> int:
    """Add shape s of the library, placed by T, to the voxels; return the number of owners.

    It counts no references: threads that fill blocks side by side would wait for each other's counts.
    """
    (tile, first_row) = placed
    first_law = library.first_law[s]
    scale = power(abs(_determinant(T)), 2.0 / 3.0)
    for c in range(library.first_cell[s], library.first_cell[s + 1]):
        law = first_law + library.mesh[c]
        for k in range(3):
            add[k] = library.area_m2[c] * scale * library.projection[law, k]
        x, y, z = library.place_m[c, 0], library.place_m[c, 1], library.place_m[c, 2]
        at = (np.float64(x), np.float64(y), np.float64(z))
        used = _add_area(voxels, used, T, at, (tile, first_row + library.mesh[c], law), add)
    for f in range(library.first_face[s], library.first_face[s + 1]):
        mesh = library.corner_mesh[f]
        whose = (tile, first_row + mesh, first_law + mesh)
        share = library.corner_share[f]
        used = _add_face(voxels, used, T, library.corners_m[f], share, whose, add, projection)
    return used


@inline_kernel
def _determinant(T: F8) -> float:
    return (
        T[0, 0] * (T[1, 1] * T[2, 2] - T[1, 2] * T[2, 1])
        - T[0, 1] * (T[1, 0] * T[2, 2] - T[1, 2] * T[2, 0])
        + T[0, 2] * (T[1, 0] * T[2, 1] - T[1, 1] * T[2, 0])
    )


@inline_kernel
def _add_area(voxels: _Voxels, used: int, T: F8, at_m: _Place, whose: _Whose, add: F8) -> int:
    """Add projected areas at a place of a shape to its voxel; return the number of owners."""
    head, node, area, low_m, ground_m = voxels
    (a, b, c) = at_m
    (tile, row, law) = whose
    x = T[0, 0] * a + T[0, 1] * b + T[0, 2] * c + T[0, 3]
    y = T[1, 0] * a + T[1, 1] * b + T[1, 2] * c + T[1, 3]
    z = T[2, 0] * a + T[2, 1] * b + T[2, 2] * c + T[2, 3] - low_m
    i, j, k = math.floor(x / VOXEL_M), math.floor(y / VOXEL_M), math.floor(z / VOXEL_M)
    if not (0 <= i < head.shape[0] and 0 <= j < head.shape[1] and 0 <= k < head.shape[2]):
        return used
    if z + low_m < _ground_at(ground_m, x, y):
        return used
    at = head[i, j, k]
    while at >= 0 and not (node[at, 1] == row and node[at, 0] == tile):
        at = node[at, 3]
    if at < 0:
        at = used
        used += 1
        node[at, 0] = tile
        node[at, 1] = row
        node[at, 2] = law
        node[at, 3] = head[i, j, k]
        area[at, 0] = area[at, 1] = area[at, 2] = 0.0
        head[i, j, k] = at
    for knot in range(3):
        area[at, knot] += add[knot]
    return used


@inline_kernel
def _ground_at(ground_m: F4, x: float, y: float) -> float:
    """Return the height of the ground at a place of the tile."""
    u = x * (FINER / VOXEL_M) + FINER
    v = y * (FINER / VOXEL_M) + FINER
    i = int(u)
    j = int(v)
    s = u - i
    t = v - j
    return (1 - s) * ((1 - t) * ground_m[i, j] + t * ground_m[i, j + 1]) + s * (
        (1 - t) * ground_m[i + 1, j] + t * ground_m[i + 1, j + 1]
    )


@inline_kernel
def _pieces(T: F8, corners_m: F4) -> int:
    """Return the number of pieces into which the sides of a face are cut."""
    longest = 0.0
    for side in range(4):
        square = 0.0
        for a in range(3):
            edge = 0.0
            for b in range(3):
                edge += T[a, b] * (corners_m[(side + 1) % 4, b] - corners_m[side, b])
            square += edge * edge
        longest = max(longest, square)
    return min(max(math.ceil(math.sqrt(longest) / _PIECE_M), 1), 64)


@kernel
def _add_face(
    voxels: _Voxels, used: int, T: F8, corners_m: F4, share: float, whose: _Whose, add: F8, projection: F8
) -> int:
    """Add a face of a shape, in pieces; return the number of owners."""
    n = _pieces(T, corners_m)
    # Normal of the placed face from its diagonals; half their cross product is its area.
    u0 = u1 = u2 = v0 = v1 = v2 = 0.0
    for b in range(3):
        first = corners_m[2, b] - corners_m[0, b]
        second = corners_m[3, b] - corners_m[1, b]
        u0 = u0 + T[0, b] * first
        u1 = u1 + T[1, b] * first
        u2 = u2 + T[2, b] * first
        v0 = v0 + T[0, b] * second
        v1 = v1 + T[1, b] * second
        v2 = v2 + T[2, b] * second
    x, y, z = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
    double = math.sqrt(x * x + y * y + z * z)
    if double <= 0.0:
        return used
    tilt = min(int(math.sqrt(1.0 - min(abs(z) / double, 1.0)) * TILTS), TILTS - 1)
    for knot in range(3):
        add[knot] = 0.5 * double * share * projection[knot, tilt] / (n * n)
    for p in range(n):
        for q in range(n):
            u, v = (p + 0.5) / n, (q + 0.5) / n
            w0 = (1 - u) * (1 - v)
            w1 = u * (1 - v)
            w2 = u * v
            w3 = (1 - u) * v
            a = w0 * corners_m[0, 0] + w1 * corners_m[1, 0] + w2 * corners_m[2, 0] + w3 * corners_m[3, 0]
            b = w0 * corners_m[0, 1] + w1 * corners_m[1, 1] + w2 * corners_m[2, 1] + w3 * corners_m[3, 1]
            c = w0 * corners_m[0, 2] + w1 * corners_m[1, 2] + w2 * corners_m[2, 2] + w3 * corners_m[3, 2]
            used = _add_area(voxels, used, T, (a, b, c), whose, add)
    return used


@array_kernel
def _mark_ground(flags: U4, ground_m: F4, low_m: float) -> None:
    """Flag the voxels that may contain ground; heights (85, 85) begin one voxel outside the tile."""
    for i in range(flags.shape[0]):
        for j in range(flags.shape[1]):
            around = ground_m[FINER * i : FINER * (i + 3) + 1, FINER * j : FINER * (j + 3) + 1]
            low, high = around.min(), around.max()
            first, last = (
                math.floor((low - low_m - 0.6) / VOXEL_M),
                math.floor((high - low_m + 0.16) / VOXEL_M),
            )
            for k in range(max(first, 0), min(last, flags.shape[2] - 1) + 1):
                flags[i, j, k] |= GROUND


@array_kernel
def _volumes(levels: int, ground_m: F4, low_m: float) -> F4:
    """Return the share (x, y, z) of each voxel's volume that is over the ground."""
    share = np.empty((COLUMNS, COLUMNS, levels), np.float32)
    for i in range(COLUMNS):
        for j in range(COLUMNS):
            under = ground_m[FINER * (i + 1) : FINER * (i + 2) + 1, FINER * (j + 1) : FINER * (j + 2) + 1]
            for k in range(levels):
                over = 0.0
                for a in range(FINER + 1):
                    for b in range(FINER + 1):
                        weight = (2.0 if a % FINER else 1.0) * (2.0 if b % FINER else 1.0) / 16.0
                        over += weight * min(max((low_m - under[a, b]) / VOXEL_M + (k + 1.0), 0.0), 1.0)
                share[i, j, k] = max(over, _LEAST_OVER)
    return share


@array_kernel
def _pack(head: I4, flags: U4, node: I8, area: F8, used: int, volume: F4, tufts: U1) -> _Packed:
    nx, ny, nz = head.shape[0] // BRICK, head.shape[1] // BRICK, head.shape[2] // BRICK
    mask = np.zeros((nx, ny, nz), np.uint64)
    first = np.zeros((nx, ny, nz), np.uint32)
    full = np.count_nonzero((head >= 0) | (flags != 0))
    record = np.empty(full, np.uint32)
    first_owner = np.empty(full, np.uint32)
    owner = np.empty(used, np.uint64)
    n = o = 0
    for x in range(nx):
        for y in range(ny):
            for z in range(nz):
                first[x, y, z] = n
                for bit in range(64):
                    i, j, k = BRICK * x + (bit >> 4), BRICK * y + ((bit >> 2) & 3), BRICK * z + (bit & 3)
                    at = head[i, j, k]
                    if at < 0 and flags[i, j, k] == 0:
                        continue
                    mask[x, y, z] |= np.uint64(1) << np.uint64(bit)
                    first_owner[n] = o
                    area0, area1, area2 = _areas(node, area, at)
                    kind = _kind(flags[i, j, k], area0, area2)
                    per_volume = (_LEVEL_SHARE if 9.0 * area0 < 4.0 * area2 else 1.0) / volume[i, j, k]
                    # Owners have shares as for light of 11 degrees; most of it goes into crowns at 5 to 15.
                    of_all = area0 + 2.0 * area1
                    so_far = in_tufts = 0.0
                    while at >= 0:
                        own = area[at, 0] + 2.0 * area[at, 1]
                        so_far += own
                        if tufts[node[at, 2]]:
                            in_tufts += own
                        tile = node[at, 0]
                        row = node[at, 1]
                        law = node[at, 2]
                        at = node[at, 3]
                        share = 255 if at < 0 or of_all <= 0.0 else int(255.0 * so_far / of_all)
                        owner[o] = np.uint64(row) | np.uint64(law) << LAW_BIT
                        owner[o] |= np.uint64(tile) << TILE_BIT | np.uint64(share) << SHARE_BIT
                        o += 1
                    if kind == CROWN and 2.0 * in_tufts > of_all:
                        kind = TUFTS
                    record[n] = (
                        flags[i, j, k]
                        | np.uint32(kind) << KIND_BIT
                        | _code(area0 * per_volume)
                        | _code(area1 * per_volume) << np.uint32(7)
                        | _code(area2 * per_volume) << np.uint32(14)
                    )
                    n += 1
    return mask, first, record, first_owner, owner


@inline_kernel
def _kind(flags: np.uint32, level: float, vertical: float) -> int:
    """Return the kind of a voxel, but for tufts, by its flags and areas.

    Leaves lie nearly level where light from above meets more than 9 / 4 of the area that level light meets.
    """
    if flags & GROUND:
        return LOW
    return LEVEL if 9.0 * level < 4.0 * vertical else CROWN


@inline_kernel
def _areas(node: I8, area: F8, at: int) -> tuple[float, float, float]:
    area0 = area1 = area2 = 0.0
    while at >= 0:
        area0 = area0 + area[at, 0]
        area1 = area1 + area[at, 1]
        area2 = area2 + area[at, 2]
        at = node[at, 3]
    return area0, area1, area2


@inline_kernel
def _code(area_m2: float) -> np.uint32:
    """Return the code of the projected area of a voxel, at least 1 for any area."""
    if area_m2 <= 0.0:
        return np.uint32(0)
    code = round(CODES * math.sqrt(area_m2 / (VOXEL_M * VOXEL_M * VOXEL_M * MOST_PER_M)))
    return np.uint32(min(max(code, 1), CODES))
