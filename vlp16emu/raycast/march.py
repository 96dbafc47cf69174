"""The way of light through what is far: ground as a grid, stems as tapered cones, foliage as a medium of voxels.

A pulse goes through slabs of voxels along the axis that it is most parallel to. The voxel that its middle passes in a slab
decides for all its sub-rays: how much foliage there is in it (`vlp16emu.raycast.medium`), and whether ground or a stem may
be met, which each sub-ray is then cut with exactly.

The leaves of a voxel are 64 cells of a Latin square: one in each column of 8 x 8 along each of the three axes, so that a
leaf has one place in space from wherever it is seen. Of these the first n are there, n being the share of the light that
foliage of that density takes over the length of the slab (Beer's law). Which of the squares a voxel has, how it is
mirrored, and how a share between two whole numbers is rounded follow from hashing its place in the world.
"""

import math
from typing import NamedTuple

import llvmlite.ir
import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.raycast.medium import BRICK, GROUND, QUANTILES, STEM, TAU_PER_M, VOXEL_M
from vlp16emu.types import NO_SURFACE

__all__ = ["LANES", "Ground", "Lanes", "Medium", "Stems", "lanes", "march"]

LANES = 8

_NONE = np.uint32(NO_SURFACE)
_VARIANTS = 32
_COVER_STEPS, _COVER_MOST = 64, 16
_AHEAD = 16
"""Slabs that are looked at before the voxels in them: without branches that nobody can foretell."""
_WIDE = np.uint64(3 << 32)
"""Of a brick that is worth skipping: it and those around it are empty, and those around these."""
_FAST = {"contract", "arcp", "nsz"}
f4, u4 = np.float32, np.uint32


def _leaves() -> tuple[NDArray[np.uint64], NDArray[np.uint8], NDArray[np.uint8]]:
    """Leaves of the voxels' variants.

    Returns
    -------
    Columns that the first n leaves take, (3, variants, 65) bits 8 a + b along each axis, a and b being the other two in
    order; the leaf of each column, (3, variants, 64); and places of leaves along the axes, (variants, 64, 3) in 256ths
    of a voxel.
    """
    rng = np.random.default_rng(20)  # part of the output, like the purposes of random numbers
    mask = np.zeros((3, _VARIANTS, 65), np.uint64)
    leaf_of, place = np.zeros((3, _VARIANTS, 64), np.uint8), np.zeros((_VARIANTS, 64, 3), np.uint8)
    base = np.add.outer(np.arange(4), np.arange(4)) % 4
    for variant in range(_VARIANTS):
        # Clumps of 2 x 2 x 2 cells lie by a Latin square of order 4, the leaves of a clump by one of order 2.
        square = rng.permutation(4)[base[np.ix_(rng.permutation(4), rng.permutation(4))]]
        cells = []
        for clump in rng.permutation(16):
            x, y = divmod(int(clump), 4)
            odd, four = int(rng.integers(2)), []
            for pair in rng.permutation(4):
                i, j = divmod(int(pair), 2)
                four.append((2 * x + i, 2 * y + j, 2 * int(square[x, y]) + ((i + j + odd) & 1)))
            cells += [four[:2], four[2:]]
        # Leaves come in pairs: so far returns are as frequent as those of explicit leaves (`vlp16emu accuracy`).
        leaves = [cell for pair in rng.permutation(32) for cell in cells[pair]]
        for leaf, cell in enumerate(leaves):
            place[variant, leaf] = [32 * c + rng.integers(32) for c in cell]
            for axis in range(3):
                a, b = (cell[other] for other in range(3) if other != axis)
                column = 8 * a + b
                leaf_of[axis, variant, column] = leaf
                mask[axis, variant, leaf + 1] = mask[axis, variant, leaf] | np.uint64(1 << column)
    return mask, leaf_of, place


_MASK, _LEAF_OF, _PLACE = _leaves()
_COVER = (1.0 - np.exp(-np.arange(_COVER_STEPS * _COVER_MOST + 2) / _COVER_STEPS)).astype(np.float32)


class Ground(NamedTuple):
    """The ground."""

    height_m: NDArray[np.float32]
    """(4 x + 1, 4 y + 1) at the corners of voxel columns."""
    surface: NDArray[np.uint32]
    """(x, y) of the column of bricks."""
    corner_x_m: float
    corner_y_m: float
    steepest: float
    """Greatest slope."""


class Stems(NamedTuple):
    """Stems, and where they stand."""

    first: NDArray[np.int32]
    """(4 x, 4 y, 2) where the stems of each column of voxels begin and stop in `of`."""
    of: NDArray[np.int32]
    """Stems of the columns, one column after the other."""
    line: NDArray[np.float64]
    """(n, 7) foot, unit axis, and widest radius."""
    profile: NDArray[np.float32]
    """(n, 2, knots) heights along the axis and radii."""
    surface: NDArray[np.uint32]
    """(n, 2) of root flare and stem."""
    flare_m: NDArray[np.float32]
    """(n,) height along the axis at which the flare ends."""


class Medium(NamedTuple):
    """What is far in a window, relative to the window's origin."""

    near_m: float
    """Range at which it begins; nothing where it is infinite."""
    corner_m: tuple[float, float, float]
    """Of the grid of bricks."""
    corner: tuple[int, int, int]
    """The same in voxels of the world."""
    brick: NDArray[np.uint64]
    """(x, y, z, 2) of each brick its mask as in `Block`; and number of its first voxel, over 32 bits the distance in bricks
    to the nearest one that is not empty, 0 where that is itself, by the greatest of the three axes."""
    voxel: NDArray[np.uint64]
    """(m,) record as in `Block`, over 32 bits the number of its first owner."""
    owner: NDArray[np.uint64]
    """(o,) surface, over 32 bits the law, over 56 bits the share as in `Block`."""
    cosine: NDArray[np.float32]
    """(laws, knots, QUANTILES) as in `Cloud`."""
    ground: Ground
    stems: Stems
    seed: int


class Lanes(NamedTuple):
    """Up to eight sub-rays of a pulse."""

    origin_m: NDArray[np.float32]
    """(3, 8)."""
    direction: NDArray[np.float32]
    """(3, 8)."""
    range_m: NDArray[np.float32]
    """(8,) in: what each has met, or where its light is given up. Out: what it meets first."""
    surface: NDArray[np.uint32]
    """(8,) likewise."""
    cosine: NDArray[np.float32]
    """(8,) likewise."""
    line: NDArray[np.float32]
    """(6, 8) scratch: place across at the grid's corner and its change per metre, in 8ths of voxels, on both axes; then
    place along and its inverse change per metre of range."""
    column: NDArray[np.uint64]
    """(8,) scratch."""
    place: NDArray[np.int32]
    """(_AHEAD,) scratch: brick and bit of the voxel of each slab."""
    found: NDArray[np.int32]
    """(_AHEAD,) scratch: slabs whose voxels are not empty."""


@numba.njit(cache=True, nogil=True)
def lanes() -> Lanes:
    """Make room for lanes."""
    three = np.zeros((3, LANES), np.float32), np.zeros((3, LANES), np.float32)
    return Lanes(
        *three,
        np.zeros(LANES, np.float32),
        np.zeros(LANES, np.uint32),
        np.zeros(LANES, np.float32),
        np.zeros((6, LANES), np.float32),
        np.zeros(LANES, np.uint64),
        np.zeros(_AHEAD, np.int32),
        np.zeros(_AHEAD, np.int32),
    )


@numba.extending.intrinsic
def _ones(typingctx, word):  # noqa: ANN001, ANN202, ARG001 - the signature is numba's
    """Count the bits of a word."""

    def codegen(context, builder, signature, args):  # noqa: ANN001, ANN202, ARG001 - likewise
        return builder.ctpop(args[0])

    return numba.types.uint64(numba.types.uint64), codegen


@numba.extending.intrinsic
def _lowest(typingctx, word):  # noqa: ANN001, ANN202, ARG001 - likewise
    """Number of the lowest bit of a word that is not 0."""

    def codegen(context, builder, signature, args):  # noqa: ANN001, ANN202, ARG001 - likewise
        return builder.cttz(args[0], llvmlite.ir.Constant(llvmlite.ir.IntType(1), 1))

    return numba.types.uint64(numba.types.uint64), codegen


@numba.njit(cache=True, nogil=True, _nrt=False, inline="always")
def _mixed(a: int, b: int, c: int, seed: int) -> np.uint32:
    """Hash the place of a voxel (constants and rounds as in MurmurHash3's finaliser)."""
    h = u4(u4(a) * u4(0x9E3779B1)) ^ u4(u4(b) * u4(0x85EBCA77)) ^ u4(u4(c) * u4(0xC2B2AE3D)) ^ u4(seed)
    h = u4(h ^ u4(h >> u4(16)))
    h = u4(h * u4(0x7FEB352D))
    h = u4(h ^ u4(h >> u4(15)))
    h = u4(h * u4(0x846CA68B))
    return u4(h ^ u4(h >> u4(16)))


@numba.njit(cache=True, nogil=True, _nrt=False, fastmath=_FAST, error_model="numpy")
def march(M: Medium, L: Lanes, n: int, axis: NDArray[np.float32]) -> None:
    """Follow n sub-rays of a pulse through the medium, from `near_m` on.

    Parameters
    ----------
    axis : (6,) origin and direction of the pulse's middle
    """
    near_m = f4(M.near_m)
    main = 0
    for a in (1, 2):
        if abs(axis[3 + a]) > abs(axis[3 + main]):
            main = a
    one, two = (1, 2) if main == 0 else ((0, 2) if main == 1 else (0, 1))
    corner_m = (f4(M.corner_m[0]), f4(M.corner_m[1]), f4(M.corner_m[2]))
    spread, aside_m, last_m = _lines(corner_m, L, n, axis, main, one, two)
    inverse = f4(1.0) / axis[3 + main]
    step = 1 if inverse > 0 else -1
    length = f4(VOXEL_M) * abs(inverse)
    along = axis[main] - corner_m[main]
    k = int(math.floor((along + axis[3 + main] * near_m) * f4(1.0 / VOXEL_M)))
    to_middle = ((f4(k) + f4(0.5)) * f4(VOXEL_M) - along) * inverse
    # In voxels: where the middle of the pulse is in the middle of slab k, and its change per slab.
    p1 = (axis[one] - corner_m[one] + axis[3 + one] * to_middle) * f4(1.0 / VOXEL_M)
    p2 = (axis[two] - corner_m[two] + axis[3 + two] * to_middle) * f4(1.0 / VOXEL_M)
    d1, d2 = axis[3 + one] * length * f4(1.0 / VOXEL_M), axis[3 + two] * length * f4(1.0 / VOXEL_M)
    # Projected areas are between two knots: weights, and bits of the codes.
    up = abs(axis[5])
    low_knot = u4(0) if up < f4(0.3) else u4(7)
    share = up / f4(0.3) if up < f4(0.3) else (up - f4(0.3)) / f4(0.7)
    w_low, w_high = (f4(1.0) - share) * length, share * length
    knot = 0 if up < f4(0.15) else (1 if up < f4(0.65) else 2)
    nx, ny, nz, _ = M.brick.shape
    bricks, voxels = M.brick.reshape(nx * ny * nz, 2), M.voxel
    size = (nx * BRICK, ny * BRICK, nz * BRICK)
    n_main, n_one, n_two = size[main], size[one], size[two]
    strides = (np.int32(ny * nz), np.int32(nz), np.int32(1))
    s_main, s_one, s_two = strides[main], strides[one], strides[two]
    shifts = (np.int32(4), np.int32(2), np.int32(0))
    b_main, b_one, b_two = shifts[main], shifts[one], shifts[two]
    ground, stems = M.ground, M.stems
    corner_main, corner_one, corner_two = M.corner[main], M.corner[one], M.corner[two]
    seed = u4(M.seed)
    tested = before = np.int32(-1)
    # Slabs until the pulse is in the grid, and until it leaves it.
    first, stop = f4(0.0), f4(1e6)
    for at, change, size in ((f4(k) + f4(0.5), f4(step), n_main), (p1, d1, n_one), (p2, d2, n_two)):
        if abs(change) < f4(1e-9):
            if not 0 <= at < size:
                stop = f4(-1.0)
            continue
        a, b = -at / change, (f4(size) - f4(1e-3) - at) / change  # less what rounding may add
        first, stop = max(first, min(a, b)), min(stop, max(a, b))
    slab, slabs = int(math.ceil(first)), int(math.floor(min(stop, (last_m - to_middle) / length + f4(1.5))))
    found, place, alive = L.found, L.place, np.uint64((1 << n) - 1)
    while slab <= slabs:
        for ahead in range(_AHEAD):
            at, slice_ = f4(slab + ahead), np.int32(k + (slab + ahead) * step)
            i1, i2 = np.int32(p1 + at * d1), np.int32(p2 + at * d2)
            brick = np.int32((slice_ >> 2) * s_main + (i1 >> 2) * s_one + (i2 >> 2) * s_two)
            place[ahead] = np.int32(brick << 6 | (slice_ & 3) << b_main | (i1 & 3) << b_one | (i2 & 3) << b_two)
        size = min(_AHEAD, slabs - slab + 1)
        count = 0
        for ahead in range(size):
            found[count] = ahead
            count += int((bricks[place[ahead] >> 6, 0] >> np.uint64(place[ahead] & 63)) & np.uint64(1))
        for number in range(count):
            here = slab + found[number]
            if here > slabs:
                break
            k_, at = k + here * step, f4(here)
            i1, i2 = int(np.int32(p1 + at * d1)), int(np.int32(p2 + at * d2))
            brick, bit = place[found[number]] >> 6, np.uint64(place[found[number]] & 63)
            before_it = bricks[brick, 0] & ((np.uint64(1) << bit) - np.uint64(1))
            voxel = voxels[u4(bricks[brick, 1]) + u4(_ones(before_it))]
            code, met = u4(voxel), False
            low, high = (code >> low_knot) & u4(127), (code >> (low_knot + u4(7))) & u4(127)
            if low | high:
                g, g1, g2 = k_ + corner_main, i1 + corner_one, i2 + corner_two
                a = g if main == 0 else g1
                b = g if main == 1 else (g1 if main == 0 else g2)
                c = g if main == 2 else g2
                h = _mixed(a, b, c, seed)
                x = min((TAU_PER_M[low] * w_low + TAU_PER_M[high] * w_high) * f4(_COVER_STEPS), f4(_COVER_STEPS * _COVER_MOST))
                whole = int(x)
                cover = _COVER[whole] + (_COVER[whole + 1] - _COVER[whole]) * (x - f4(whole))
                bits = _MASK[main, int(h & u4(_VARIANTS - 1)), int(cover * f4(64.0) + f4(h >> u4(24)) * f4(1.0 / 256.0))]
                if bits:
                    met = _meet_leaves(M, L, n, near_m, main, one, two, k_, h, bits, u4(voxel >> np.uint64(32)), knot, alive)
            if code & STEM:
                i, j = (k_, i1) if main == 0 else ((i1, k_) if main == 1 else (i1, i2))
                for entry in range(stems.first[i, j, 0], stems.first[i, j, 1]):
                    stem = stems.of[entry]
                    if stem not in (tested, before):
                        before, tested = tested, stem
                        met |= _meet_stem(stems, L, n, near_m, axis, stem, spread, aside_m)
            if code & GROUND:
                met |= _meet_ground(ground, L, n, near_m, axis, to_middle + at * length, length, spread, aside_m)
            if met:
                last_m = L.range_m[0]
                for lane in range(1, n):
                    last_m = max(last_m, L.range_m[lane])
                slabs = min(slabs, int((last_m - to_middle) / length + f4(1.5)))
                passed_m = to_middle + (at + f4(0.5)) * length
                for lane in range(n):
                    if L.range_m[lane] < passed_m:
                        alive &= ~(np.uint64(1) << np.uint64(lane))
        slab += size


@numba.njit(cache=True, nogil=True, _nrt=False, fastmath=_FAST, error_model="numpy", inline="always")
def _lines(
    corner_m: tuple[float, float, float], L: Lanes, n: int, axis: NDArray[np.float32], main: int, one: int, two: int
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


@numba.njit(cache=True, nogil=True, _nrt=False, fastmath=_FAST, error_model="numpy", inline="always")
def _meet_leaves(
    M: Medium,
    L: Lanes,
    n: int,
    near_m: float,
    main: int,
    one: int,
    two: int,
    k: int,
    h: int,
    bits: int,
    first_owner: int,
    knot: int,
    alive: int,
) -> bool:
    """Cut the lanes with the leaves of a voxel; whether any meets one."""
    variant = int(h & u4(_VARIANTS - 1))
    mirror = (int(h >> u4(5)) & 7, int(h >> u4(8)) & 7, int(h >> u4(11)) & 7)
    line, column, range_m = L.line, L.column, L.range_m
    middle_m = (f4(k) + f4(0.5)) * f4(VOXEL_M)
    r1, r2 = np.int32(mirror[one]), np.int32(mirror[two])
    for lane in range(n):
        a = (np.int32(line[0, lane] + line[1, lane] * middle_m) & np.int32(7)) ^ r1
        b = (np.int32(line[2, lane] + line[3, lane] * middle_m) & np.int32(7)) ^ r2
        column[lane] = np.uint64(8 * a + b)
    lit = np.uint64(0)
    for lane in range(n):
        lit |= ((bits >> column[lane]) & np.uint64(1)) << np.uint64(lane)
    lit &= alive
    met = False
    while lit:
        lane = int(_lowest(lit))
        lit &= lit - np.uint64(1)
        leaf = int(_LEAF_OF[main, variant, column[lane]])
        place = int(_PLACE[variant, leaf, main]) ^ (mirror[main] << 5)
        along_m = (f4(k) + (f4(place) + f4(0.5)) * f4(1.0 / 256.0)) * f4(VOXEL_M)
        at_m = (along_m - line[4, lane]) * line[5, lane]
        if near_m <= at_m < range_m[lane]:
            range_m[lane] = at_m
            own = u4(u4(h + u4(leaf) * u4(0x9E3779B1)) * u4(0x85EBCA77))
            own = u4(own ^ u4(own >> u4(15)))
            own = u4(own * u4(0xC2B2AE3D))
            own = u4(own ^ u4(own >> u4(16)))
            owner, drawn = first_owner, u4(own & u4(0xFF))
            whose = M.owner[owner]
            while whose >> np.uint64(56) < drawn:
                owner += u4(1)
                whose = M.owner[owner]
            L.surface[lane] = u4(whose)
            law = int(whose >> np.uint64(32)) & 0xFFFFFF
            L.cosine[lane] = M.cosine[law, knot, int(own >> u4(8)) % QUANTILES]
            met = True
    return met


@numba.njit(cache=True, nogil=True, _nrt=False, fastmath=_FAST, error_model="numpy", inline="always")
def _meet_stem(
    stems: Stems, L: Lanes, n: int, near_m: float, axis: NDArray[np.float32], stem: int, spread: float, aside_m: float
) -> bool:
    """Cut the lanes with a stem: across its axis a circle whose radius is that of the height at which it is met."""
    s, profile = stems.line[stem], stems.profile[stem]
    # Middle of the pulse first: nearest approach to the axis, in the plane across it.
    qx, qy, qz = s[0] - axis[0], s[1] - axis[1], s[2] - axis[2]
    up = axis[3] * s[3] + axis[4] * s[4] + axis[5] * s[5]
    lift = qx * s[3] + qy * s[4] + qz * s[5]
    wx, wy, wz = axis[3] - up * s[3], axis[4] - up * s[4], axis[5] - up * s[5]
    ux, uy, uz = qx - lift * s[3], qy - lift * s[4], qz - lift * s[5]
    square = wx * wx + wy * wy + wz * wz
    if square < 1e-9:
        return False
    nearest_m = (ux * wx + uy * wy + uz * wz) / square
    off2 = ux * ux + uy * uy + uz * uz - nearest_m * nearest_m * square
    within = s[6] + aside_m + spread * nearest_m
    if off2 > within * within:
        return False
    # The cone that the stem is at that height; the beam is too narrow to leave it by more than a little.
    at, lower, upper = nearest_m * up - lift, 0, profile.shape[1] - 1
    while upper - lower > 1:
        middle = (lower + upper) >> 1
        if profile[0, middle] <= at:
            lower = middle
        else:
            upper = middle
    low_m, low_radius_m = profile[0, lower], profile[1, lower]
    taper = (profile[1, upper] - low_radius_m) / (profile[0, upper] - low_m)
    met = False
    for lane in range(n):
        dx, dy, dz = L.direction[0, lane], L.direction[1, lane], L.direction[2, lane]
        qx, qy, qz = s[0] - L.origin_m[0, lane], s[1] - L.origin_m[1, lane], s[2] - L.origin_m[2, lane]
        up = dx * s[3] + dy * s[4] + dz * s[5]
        lift = qx * s[3] + qy * s[4] + qz * s[5]
        wx, wy, wz = dx - up * s[3], dy - up * s[4], dz - up * s[5]
        ux, uy, uz = qx - lift * s[3], qy - lift * s[4], qz - lift * s[5]
        inverse = 1.0 / (wx * wx + wy * wy + wz * wz)
        middle_m = (ux * wx + uy * wy + uz * wz) * inverse
        off2 = ux * ux + uy * uy + uz * uz - middle_m * middle_m / inverse
        at_m, radius_m, inside = middle_m, 0.0, 0.0
        for _ in range(3):  # the radius is that of where it is met: each step is a hundredth of the one before
            radius_m = low_radius_m + taper * (at_m * up - lift - low_m)
            inside = radius_m * radius_m - off2
            at_m = middle_m - math.sqrt(max(inside, 0.0) * inverse)
        height_m = at_m * up - lift
        is_stem = inside > 0.0 and radius_m > 0.0 and profile[0, 0] <= height_m <= profile[0, -1]
        if is_stem and near_m <= at_m < L.range_m[lane]:
            L.range_m[lane] = at_m
            L.surface[lane] = stems.surface[stem, 0 if height_m < stems.flare_m[stem] else 1]
            L.cosine[lane] = min(math.sqrt(inside / inverse) / radius_m, 1.0)
            met = True
    return met


@numba.njit(cache=True, nogil=True, _nrt=False, fastmath=_FAST, error_model="numpy", inline="always")
def _meet_ground(
    ground: Ground,
    L: Lanes,
    n: int,
    near_m: float,
    axis: NDArray[np.float32],
    middle_m: float,
    length: float,
    spread: float,
    aside_m: float,
) -> bool:
    """Cut the lanes with the ground within a slab; whether any meets it."""
    last_m = middle_m + f4(0.5) * length
    clear_m = _over_ground(ground, axis[0], axis[1], axis[2], axis[3], axis[4], axis[5], last_m)[0]
    steepest = f4(1.0 + ground.steepest)
    if clear_m > steepest * (spread * last_m + aside_m):
        return False
    met, range_m = False, L.range_m
    first_m = max(middle_m - f4(0.5) * length, near_m)
    for lane in range(n):
        if range_m[lane] <= first_m:
            continue
        x, y, z = L.origin_m[0, lane], L.origin_m[1, lane], L.origin_m[2, lane]
        dx, dy, dz = L.direction[0, lane], L.direction[1, lane], L.direction[2, lane]
        below = _over_ground(ground, x, y, z, dx, dy, dz, last_m)
        if not below[0] <= 0:
            continue
        at_m, slope = last_m, below
        low_m, c_low = first_m, f4(0.0)
        for _ in range(4):  # flat but for the edges of its triangles: along the slope, and then by secants
            falls = dz - slope[1] * dx - slope[2] * dy
            if slope[0] <= 0 and falls < f4(-1e-4) and c_low == 0:
                at_m = max(at_m - slope[0] / falls, first_m)
            else:
                at_m = low_m + (at_m - low_m) * c_low / (c_low - slope[0])
            slope = _over_ground(ground, x, y, z, dx, dy, dz, at_m)
            if abs(slope[0]) < f4(5e-4) or at_m <= first_m:
                break
            if slope[0] > 0:
                low_m, c_low, at_m, slope = at_m, slope[0], last_m, below
        if at_m < range_m[lane]:
            range_m[lane] = at_m
            gx, gy = slope[1], slope[2]
            L.cosine[lane] = min(abs(dz - gx * dx - gy * dy) / f4(math.sqrt(gx * gx + gy * gy + f4(1.0))), f4(1.0))
            across = f4(1.0 / (BRICK * VOXEL_M))
            i = min(max(int((x + dx * at_m - f4(ground.corner_x_m)) * across), 0), ground.surface.shape[0] - 1)
            j = min(max(int((y + dy * at_m - f4(ground.corner_y_m)) * across), 0), ground.surface.shape[1] - 1)
            L.surface[lane] = ground.surface[i, j]
            met = True
    return met


@numba.njit(cache=True, nogil=True, _nrt=False, fastmath=_FAST, error_model="numpy", inline="always")
def _over_ground(
    ground: Ground, x: float, y: float, z: float, dx: float, dy: float, dz: float, at_m: float
) -> tuple[np.float32, np.float32, np.float32]:
    """Height of a ray over the ground at a range, and the slope of the triangle there; no ground is infinitely deep."""
    ground_m = ground.height_m
    u = (x + dx * at_m - f4(ground.corner_x_m)) * f4(1.0 / VOXEL_M)
    v = (y + dy * at_m - f4(ground.corner_y_m)) * f4(1.0 / VOXEL_M)
    i = min(max(int(u), 0), ground_m.shape[0] - 2)
    j = min(max(int(v), 0), ground_m.shape[1] - 2)
    s, t = u - f4(i), v - f4(j)
    h00, h11 = ground_m[i, j], ground_m[i + 1, j + 1]
    if s >= t:
        h10 = ground_m[i + 1, j]
        gx, gy = h10 - h00, h11 - h10
    else:
        h01 = ground_m[i, j + 1]
        gx, gy = h11 - h01, h01 - h00
    height = h00 + gx * s + gy * t
    return z + dz * at_m - height, gx * f4(1.0 / VOXEL_M), gy * f4(1.0 / VOXEL_M)
