"""The way of light through what is far: ground as a grid, stems as tapered cones, foliage as a medium of voxels.

A pulse goes through slabs of voxels along the axis that it is most parallel to. The voxel that its middle passes in a slab
decides for all its sub-rays: how much foliage there is in it (`vlp16emu.raycast.leaves`), and whether ground or a stem may
be met, which each sub-ray is then cut with exactly (`vlp16emu.raycast.cuts`).
"""

import math
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.raycast.cuts import meet_ground, meet_stem
from vlp16emu.raycast.grid import Medium
from vlp16emu.raycast.lanes import AHEAD, FAST, LANES, Lanes
from vlp16emu.raycast.leaves import meet_foliage, weights_of
from vlp16emu.raycast.voxel import BRICK, GROUND, STEM, VOXEL_M

__all__ = ["march"]

f4, u4 = np.float32, np.uint32


@numba.extending.intrinsic
def _ones(typingctx: Any, word: Any) -> Any:  # noqa: ARG001 - the signature is numba's
    """Count the bits of a word."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ARG001 - likewise
        """Emit the instruction."""
        return builder.ctpop(args[0])

    return numba.types.uint64(numba.types.uint64), codegen


class _Way(NamedTuple):
    """The middle of a pulse on its way through a grid, slab by slab."""

    main: int
    """Axis across the slabs."""
    one: int
    two: int
    k: int
    """Slab in which the medium begins: all others are counted from it."""
    step: int
    """Upwards or downwards."""
    length: np.float32
    """Metres of range from slab to slab."""
    to_middle: np.float32
    """Range at the middle of slab k."""
    p1: np.float32
    """In voxels along the axes one and two: place at the middle of slab k, and its change per slab."""
    p2: np.float32
    d1: np.float32
    d2: np.float32


class _Grid(NamedTuple):
    """A grid along the axes main, one and two."""

    size: tuple[int, int, int]
    """In voxels."""
    stride: tuple[np.int32, np.int32, np.int32]
    """From brick to brick."""
    shift: tuple[np.int32, np.int32, np.int32]
    """Bits in a brick from voxel to voxel."""
    corner: tuple[int, int, int]
    """In voxels of the world."""


@numba.njit(cache=True, nogil=True, _nrt=False, fastmath=FAST, error_model="numpy")
def march(M: Medium, L: Lanes, n: int, axis: NDArray[np.float32]) -> None:
    """Follow n sub-rays of a pulse through the medium, from `near_m` on.

    Parameters
    ----------
    axis : (6,) origin and direction of the pulse's middle
    """
    near_m = f4(M.near_m)
    corner_m = (f4(M.corner_m[0]), f4(M.corner_m[1]), f4(M.corner_m[2]))
    way = _way(corner_m, axis, near_m)
    main, one, two, length = way.main, way.one, way.two, way.length
    spread, aside_m, last_m = _lines(corner_m, L, n, axis, main, one, two)
    weights = weights_of(abs(axis[5]), length)
    nx, ny, nz, _ = M.brick.shape
    bricks, grid = M.brick.reshape(nx * ny * nz, 2), _grid(M, main, one, two)
    first, stop = _crossing(way, grid.size)
    slab = math.ceil(first)
    slabs = math.floor(min(stop, (last_m - way.to_middle) / length + f4(1.5)))
    tested, before, alive = np.int32(-1), np.int32(-1), np.uint64((1 << n) - 1)
    while slab <= slabs:
        size = min(AHEAD, slabs - slab + 1)
        for number in range(_look(L, way, grid, bricks, slab, size)):
            ahead = L.found[number]
            here = slab + ahead
            if here > slabs:
                break
            k, at = way.k + here * way.step, f4(here)
            i1, i2 = int(np.int32(way.p1 + at * way.d1)), int(np.int32(way.p2 + at * way.d2))
            voxel = _voxel(M.voxel, bricks, L.place[ahead])
            code = u4(voxel)
            met = meet_foliage(M, L, n, near_m, main, one, two, grid.corner, k, i1, i2, voxel, weights, alive)
            if code & STEM:
                i, j = (k, i1) if main == 0 else ((i1, k) if main == 1 else (i1, i2))
                for entry in range(M.stems.first[i, j, 0], M.stems.first[i, j, 1]):
                    stem = M.stems.of[entry]
                    if stem not in (tested, before):
                        before, tested = tested, stem
                        met |= meet_stem(M.stems, L, n, near_m, axis, stem, spread, aside_m)
            if code & GROUND:
                middle_m = way.to_middle + at * length
                met |= meet_ground(M.ground, L, n, near_m, axis, middle_m, length, spread, aside_m)
            if met:
                alive, last_m = _still_alive(L, n, alive, way.to_middle + (at + f4(0.5)) * length)
                slabs = min(slabs, int((last_m - way.to_middle) / length + f4(1.5)))
        slab += size


@numba.njit(cache=True, nogil=True, _nrt=False, fastmath=FAST, error_model="numpy", inline="always")
def _way(
    corner_m: tuple[np.float32, np.float32, np.float32], axis: NDArray[np.float32], near_m: np.float32
) -> _Way:
    """Lay the way of a pulse's middle through a grid."""
    main = 0
    for a in (1, 2):
        if abs(axis[3 + a]) > abs(axis[3 + main]):
            main = a
    one, two = (1, 2) if main == 0 else ((0, 2) if main == 1 else (0, 1))
    inverse = f4(1.0) / axis[3 + main]
    step = 1 if inverse > 0 else -1
    length = f4(VOXEL_M) * abs(inverse)
    along = axis[main] - corner_m[main]
    k = math.floor((along + axis[3 + main] * near_m) * f4(1.0 / VOXEL_M))
    to_middle = ((f4(k) + f4(0.5)) * f4(VOXEL_M) - along) * inverse
    p1 = (axis[one] - corner_m[one] + axis[3 + one] * to_middle) * f4(1.0 / VOXEL_M)
    p2 = (axis[two] - corner_m[two] + axis[3 + two] * to_middle) * f4(1.0 / VOXEL_M)
    d1, d2 = axis[3 + one] * length * f4(1.0 / VOXEL_M), axis[3 + two] * length * f4(1.0 / VOXEL_M)
    return _Way(main, one, two, k, step, length, to_middle, p1, p2, d1, d2)


@numba.njit(cache=True, nogil=True, _nrt=False, fastmath=FAST, error_model="numpy", inline="always")
def _grid(M: Medium, main: int, one: int, two: int) -> _Grid:
    """Turn a grid to the axes of a way."""
    nx, ny, nz, _ = M.brick.shape
    size = (nx * BRICK, ny * BRICK, nz * BRICK)
    strides = (np.int32(ny * nz), np.int32(nz), np.int32(1))
    shifts = (np.int32(4), np.int32(2), np.int32(0))
    return _Grid(
        (size[main], size[one], size[two]),
        (strides[main], strides[one], strides[two]),
        (shifts[main], shifts[one], shifts[two]),
        (M.corner[main], M.corner[one], M.corner[two]),
    )


@numba.njit(cache=True, nogil=True, _nrt=False, fastmath=FAST, error_model="numpy", inline="always")
def _crossing(way: _Way, size: tuple[int, int, int]) -> tuple[np.float32, np.float32]:
    """Slabs until the pulse is in the grid, and until it leaves it."""
    first, stop = f4(0.0), f4(1e6)
    n_main, n_one, n_two = size
    k, step = f4(way.k) + f4(0.5), f4(way.step)
    for at, change, voxels in ((k, step, n_main), (way.p1, way.d1, n_one), (way.p2, way.d2, n_two)):
        if abs(change) < f4(1e-9):
            if not 0 <= at < voxels:
                stop = f4(-1.0)
            continue
        a, b = -at / change, (f4(voxels) - f4(1e-3) - at) / change  # less what rounding may add
        first, stop = max(first, min(a, b)), min(stop, max(a, b))
    return first, stop


@numba.njit(cache=True, nogil=True, _nrt=False, fastmath=FAST, error_model="numpy", inline="always")
def _look(L: Lanes, way: _Way, grid: _Grid, bricks: NDArray[np.uint64], slab: int, size: int) -> int:
    """Find the voxels of the next slabs, and count those of the first `size` that are not empty."""
    found, place, k, step = L.found, L.place, way.k, way.step
    p1, p2, d1, d2 = way.p1, way.p2, way.d1, way.d2
    s_main, s_one, s_two = grid.stride
    b_main, b_one, b_two = grid.shift
    for ahead in range(AHEAD):
        at, slice_ = f4(slab + ahead), np.int32(k + (slab + ahead) * step)
        i1, i2 = np.int32(p1 + at * d1), np.int32(p2 + at * d2)
        brick = np.int32((slice_ >> 2) * s_main + (i1 >> 2) * s_one + (i2 >> 2) * s_two)
        place[ahead] = np.int32(brick << 6 | (slice_ & 3) << b_main | (i1 & 3) << b_one | (i2 & 3) << b_two)
    count = 0
    for ahead in range(size):
        found[count] = ahead
        count += int((bricks[place[ahead] >> 6, 0] >> np.uint64(place[ahead] & 63)) & np.uint64(1))
    return count


@numba.njit(cache=True, nogil=True, _nrt=False, fastmath=FAST, error_model="numpy", inline="always")
def _voxel(voxels: NDArray[np.uint64], bricks: NDArray[np.uint64], place: np.int32) -> np.uint64:
    """Look up the voxel at a place, which is not empty."""
    brick, bit = place >> 6, np.uint64(place & 63)
    before_it = bricks[brick, 0] & ((np.uint64(1) << bit) - np.uint64(1))
    return voxels[u4(bricks[brick, 1]) + u4(_ones(before_it))]


@numba.njit(cache=True, nogil=True, _nrt=False, fastmath=FAST, error_model="numpy", inline="always")
def _still_alive(L: Lanes, n: int, alive: np.uint64, passed_m: np.float32) -> tuple[np.uint64, np.float32]:
    """Take away the lanes that end before a range; with the others, the range at which the last of all ends."""
    range_m = L.range_m
    last_m = range_m[0]
    for lane in range(1, n):
        last_m = max(last_m, range_m[lane])
    for lane in range(n):
        if range_m[lane] < passed_m:
            alive &= ~(np.uint64(1) << np.uint64(lane))
    return alive, last_m


@numba.njit(cache=True, nogil=True, _nrt=False, fastmath=FAST, error_model="numpy", inline="always")
def _lines(
    corner_m: tuple[float, float, float],
    L: Lanes,
    n: int,
    axis: NDArray[np.float32],
    main: int,
    one: int,
    two: int,
) -> tuple[np.float32, np.float32, np.float32]:
    """Lay the lanes' lines; return how far they spread per metre and begin aside, and the farthest range asked for."""
    origin_m, direction, line = L.origin_m, L.direction, L.line
    scale = f4(LANES / VOXEL_M)
    c_main, c_one, c_two = corner_m[main], corner_m[one], corner_m[two]
    spread = aside_m = last_m = f4(0.0)
    for lane in range(n):
        inverse = f4(1.0) / direction[main, lane]
        line[4, lane], line[5, lane] = origin_m[main, lane] - c_main, inverse
        line[1, lane] = direction[one, lane] * inverse * scale
        line[0, lane] = (origin_m[one, lane] - c_one) * scale - line[4, lane] * line[1, lane]
        line[3, lane] = direction[two, lane] * inverse * scale
        line[2, lane] = (origin_m[two, lane] - c_two) * scale - line[4, lane] * line[3, lane]
        off = apart = f4(0.0)
        for a in range(3):
            off += abs(direction[a, lane] - axis[3 + a])
            apart += abs(origin_m[a, lane] - axis[a])
        spread, aside_m, last_m = max(spread, off), max(aside_m, apart), max(last_m, L.range_m[lane])
    return spread, aside_m, last_m
