"""The voxels of a tile: filled with the projected areas of what stands there, and packed brick by brick."""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import power
from vlp16emu.foliage.cloud import TILTS, Library
from vlp16emu.foliage.marks import mark_ground, mark_stem
from vlp16emu.foliage.voxel import BRICK, CODES, COLUMNS, LAW_BIT, MOST_PER_M, SHARE_BIT, TILE_BIT, VOXEL_M
from vlp16emu.trig import ZERO

Array = NDArray[np.float64]

_PIECE_M = 0.25
"""Faces larger than this are cut."""

_Packed = tuple[
    NDArray[np.uint64],
    NDArray[np.uint64],
    NDArray[np.uint32],
    NDArray[np.uint32],
    NDArray[np.uint32],
    NDArray[np.uint64],
]
"""Arrays of a block, in the order of `Block`."""


@numba.njit(cache=True, nogil=True)
def filled(
    library: Library,
    which: NDArray[np.int64],
    relative: Array,
    row: NDArray[np.int64],
    tile_of: NDArray[np.int64],
    lines: Array,
    radii: NDArray[np.float32],
    ground_m: NDArray[np.float32],
    low_m: float,
    levels: int,
    projection: Array,
) -> _Packed:
    """Fill the arrays of a block, in the order of `Block`."""
    head = np.full((COLUMNS, COLUMNS, levels * BRICK), -1, np.int32)
    # Owners as linked lists: tile, row, law and the next one; and their projected areas at the knots.
    node, area = np.empty((4096, 4), np.int64), np.empty((4096, 3))
    used = ZERO
    add = np.empty(3)
    for p in range(which.shape[0]):
        s, T = which[p], relative[p]
        needed = used + library.first_cell[s + 1] - library.first_cell[s]
        for f in range(library.first_face[s], library.first_face[s + 1]):
            pieces = _pieces(T, library.corners_m[f])
            needed += pieces * pieces
        node, area = _roomy(node, area, used, needed)
        scale = power(abs(_determinant(T)), 2.0 / 3.0)
        for c in range(library.first_cell[s], library.first_cell[s + 1]):
            law = library.first_law[s] + library.mesh[c]
            for k in range(3):
                add[k] = library.area_m2[c] * scale * library.projection[law, k]
            x, y, z = library.place_m[c, 0], library.place_m[c, 1], library.place_m[c, 2]
            used = _put(
                head, node, area, used, T, np.float64(x), np.float64(y), np.float64(z),
                low_m, tile_of[p], row[p] + library.mesh[c], law, add,
            )  # fmt: skip
        for f in range(library.first_face[s], library.first_face[s + 1]):
            mesh = library.corner_mesh[f]
            used = _put_face(
                head, node, area, used, T, library.corners_m[f], library.share[library.first_law[s] + mesh],
                low_m, tile_of[p], row[p] + mesh, library.first_law[s] + mesh, add, projection,
            )  # fmt: skip
    marks = _marks(head.shape, lines, radii, ground_m, low_m)
    return _pack(head, *marks, node, area, used)


@numba.njit(cache=True, nogil=True)
def _marks(
    shape: tuple[int, int, int], lines: Array, radii: NDArray[np.float32], ground_m: NDArray[np.float32], low_m: float
) -> tuple[NDArray[np.uint32], NDArray[np.uint64]]:
    """Mark where the ground is looked for, by voxels, and where stems are, by bits of bricks."""
    flags = np.zeros(shape, np.uint32)
    stem = np.zeros((shape[0] // BRICK, shape[1] // BRICK, shape[2] // BRICK), np.uint64)
    mark_ground(flags, ground_m, low_m)
    for i in range(lines.shape[0]):
        mark_stem(stem, lines[i], radii[i], low_m)
    return flags, stem


@numba.njit(cache=True, nogil=True)
def _roomy(node: NDArray[np.int64], area: Array, used: int, needed: int) -> tuple[NDArray[np.int64], Array]:
    """Give lists of owners as much room as is needed."""
    room = len(node)
    while needed > room:
        room *= 2
        bigger, more = np.empty((room, 4), np.int64), np.empty((room, 3))
        for owner in range(used):
            for a in range(4):
                bigger[owner, a] = node[owner, a]
            for a in range(3):
                more[owner, a] = area[owner, a]
        node, area = bigger, more
    return node, area


@numba.njit(cache=True, nogil=True)
def _determinant(T: Array) -> float:
    """Of the 3 x 3 part of a transform."""
    return (
        T[0, 0] * (T[1, 1] * T[2, 2] - T[1, 2] * T[2, 1])
        - T[0, 1] * (T[1, 0] * T[2, 2] - T[1, 2] * T[2, 0])
        + T[0, 2] * (T[1, 0] * T[2, 1] - T[1, 1] * T[2, 0])
    )


@numba.njit(cache=True, nogil=True)
def _put(
    head: NDArray[np.int32],
    node: NDArray[np.int64],
    area: Array,
    used: int,
    T: Array,
    a: float,
    b: float,
    c: float,
    low_m: float,
    tile: int,
    row: int,
    law: int,
    add: Array,
) -> int:
    """Add projected areas at a place of a shape to its voxel; return how many owners there are."""
    x = T[0, 0] * a + T[0, 1] * b + T[0, 2] * c + T[0, 3]
    y = T[1, 0] * a + T[1, 1] * b + T[1, 2] * c + T[1, 3]
    z = T[2, 0] * a + T[2, 1] * b + T[2, 2] * c + T[2, 3] - low_m
    i, j, k = math.floor(x / VOXEL_M), math.floor(y / VOXEL_M), math.floor(z / VOXEL_M)
    if not (0 <= i < head.shape[0] and 0 <= j < head.shape[1] and 0 <= k < head.shape[2]):
        return used
    at = head[i, j, k]
    while at >= 0 and not (node[at, 1] == row and node[at, 0] == tile):
        at = node[at, 3]
    if at < 0:
        at = used
        used += 1
        node[at, 0], node[at, 1], node[at, 2], node[at, 3] = tile, row, law, head[i, j, k]
        area[at, 0] = area[at, 1] = area[at, 2] = 0.0
        head[i, j, k] = at
    for knot in range(3):
        area[at, knot] += add[knot]
    return used


@numba.njit(cache=True, nogil=True)
def _pieces(T: Array, corners_m: NDArray[np.float32]) -> int:
    """Into how many pieces the sides of a face are cut."""
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


@numba.njit(cache=True, nogil=True)
def _put_face(
    head: NDArray[np.int32],
    node: NDArray[np.int64],
    area: Array,
    used: int,
    T: Array,
    corners_m: NDArray[np.float32],
    share: float,
    low_m: float,
    tile: int,
    row: int,
    law: int,
    add: Array,
    projection: Array,
) -> int:
    """Add a face of a shape, in pieces; return how many owners there are."""
    n = _pieces(T, corners_m)
    # Normal of the placed face from its diagonals; half their cross product is its area.
    u0 = u1 = u2 = v0 = v1 = v2 = 0.0
    for b in range(3):
        first, second = corners_m[2, b] - corners_m[0, b], corners_m[3, b] - corners_m[1, b]
        u0, u1, u2 = u0 + T[0, b] * first, u1 + T[1, b] * first, u2 + T[2, b] * first
        v0, v1, v2 = v0 + T[0, b] * second, v1 + T[1, b] * second, v2 + T[2, b] * second
    x, y, z = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
    double = math.sqrt(x * x + y * y + z * z)
    if double <= 0.0:
        return used
    tilt = min(int(abs(z) / double * TILTS), TILTS - 1)
    for knot in range(3):
        add[knot] = 0.5 * double * share * projection[knot, tilt] / (n * n)
    for p in range(n):
        for q in range(n):
            u, v = (p + 0.5) / n, (q + 0.5) / n
            w0, w1, w2, w3 = (1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v
            a = w0 * corners_m[0, 0] + w1 * corners_m[1, 0] + w2 * corners_m[2, 0] + w3 * corners_m[3, 0]
            b = w0 * corners_m[0, 1] + w1 * corners_m[1, 1] + w2 * corners_m[2, 1] + w3 * corners_m[3, 1]
            c = w0 * corners_m[0, 2] + w1 * corners_m[1, 2] + w2 * corners_m[2, 2] + w3 * corners_m[3, 2]
            used = _put(head, node, area, used, T, a, b, c, low_m, tile, row, law, add)
    return used


@numba.njit(cache=True, nogil=True)
def _pack(
    head: NDArray[np.int32],
    flags: NDArray[np.uint32],
    stem: NDArray[np.uint64],
    node: NDArray[np.int64],
    area: Array,
    used: int,
) -> _Packed:
    """Write out what is not empty, brick by brick."""
    nx, ny, nz = head.shape[0] // BRICK, head.shape[1] // BRICK, head.shape[2] // BRICK
    mask, first = np.zeros((nx, ny, nz), np.uint64), np.zeros((nx, ny, nz), np.uint32)
    full = _full(head, flags)
    record, first_owner = np.empty(full, np.uint32), np.empty(full, np.uint32)
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
                    so_far = 0.0
                    while at >= 0:
                        so_far += area[at, 1]
                        tile, row, law, at = node[at, 0], node[at, 1], node[at, 2], node[at, 3]
                        share = 255 if at < 0 or area1 <= 0.0 else int(255.0 * so_far / area1)
                        owner[o] = np.uint64(row) | np.uint64(law) << LAW_BIT
                        owner[o] |= np.uint64(tile) << TILE_BIT | np.uint64(share) << SHARE_BIT
                        o += 1
                    record[n] = (
                        flags[i, j, k] | _code(area0) | _code(area1) << np.uint32(7) | _code(area2) << np.uint32(14)
                    )
                    n += 1
    return mask, stem, first, record, first_owner, owner


@numba.njit(cache=True, nogil=True)
def _full(head: NDArray[np.int32], flags: NDArray[np.uint32]) -> int:
    """Count the voxels that are not empty."""
    full = 0
    for i in range(head.shape[0]):
        for j in range(head.shape[1]):
            for k in range(head.shape[2]):
                full += head[i, j, k] >= 0 or flags[i, j, k] != 0
    return full


@numba.njit(cache=True, nogil=True)
def _areas(node: NDArray[np.int64], area: Array, at: int) -> tuple[float, float, float]:
    """Projected areas at the knots of an owner and those after it."""
    area0 = area1 = area2 = 0.0
    while at >= 0:
        area0, area1, area2 = area0 + area[at, 0], area1 + area[at, 1], area2 + area[at, 2]
        at = node[at, 3]
    return area0, area1, area2


@numba.njit(cache=True, nogil=True)
def _code(area_m2: float) -> np.uint32:
    """Code of the projected area of a voxel; what is there at all has at least 1."""
    if area_m2 <= 0.0:
        return np.uint32(0)
    code = round(CODES * math.sqrt(area_m2 / (VOXEL_M * VOXEL_M * VOXEL_M * MOST_PER_M)))
    return np.uint32(min(max(code, 1), CODES))
