"""Leaves of voxels, and their intersection with lanes.

The leaves of a voxel are 64 cells of a Latin square, one in each column of 8 x 8 along each of the three
axes, so that a leaf has the same position from every direction. The first n of them are present; n / 64 is
the share of the light that foliage of that density intercepts over the length of the slab (Beer's law). The
voxel's square, its mirroring, and the rounding of n follow from a hash of the voxel's position in the world.

A column is 62.5 mm wide, about a small twig with its leaves. It consists of 4 x 2 facets of 16 x 31 mm, each
with an owner of its own: a beam meets thin wood amid leaves in more pulses, and in fewer sub-rays of each,
than it would meet whole columns of wood.
"""

from typing import NamedTuple

import numpy as np
from llvmlite import ir

from vlp16emu.elementary import exp
from vlp16emu.foliage.lanes import Lanes, Medium, Pulse, lowest_bit
from vlp16emu.foliage.voxel import (
    COLUMNS,
    LAW_BIT,
    LAW_MASK,
    QUANTILES,
    SHARE_BIT,
    TAU_PER_M,
    TILE_BIT,
    VOXEL_M,
)
from vlp16emu.kernels.compiler import NumbaObject, inline_kernel, numba
from vlp16emu.raycast.kernel import LANES
from vlp16emu.types import F4, U1, U8

_VARIANTS = 32
_COVER_STEPS = 64
_COVER_MOST = 16
f4 = np.float32
u4 = np.uint32
_SPREAD = u4(97)  # step of the draw of an owner from facet to facet, of 256
_Three = tuple[int, int, int]
_Whose = tuple[np.uint32, tuple[int, int], int]
"""Number of the record of a voxel, its tile, and the knot of the light's elevation."""


def _leaves() -> tuple[U8, U1, U1]:
    """Make the leaves of the voxels' variants.

    Returns
    -------
    Columns that the first n leaves occupy, (3, variants, 65) bits 8 a + b along each axis, where a and b are
    the other two axes in order; the leaf of each column, (3, variants, 64); and positions of leaves along the
    axes, (variants, 64, 3) in 256ths of a voxel.
    """
    rng = np.random.default_rng(20)  # determines bytes of the output
    mask = np.zeros((3, _VARIANTS, 65), np.uint64)
    leaf_of = np.zeros((3, _VARIANTS, 64), np.uint8)
    place = np.zeros((_VARIANTS, 64, 3), np.uint8)
    base = np.add.outer(np.arange(4), np.arange(4)) % 4
    for variant in range(_VARIANTS):
        # Clumps of 2 x 2 x 2 cells follow a Latin square of order 4, the leaves of a clump one of order 2.
        square = rng.permutation(4)[base[np.ix_(rng.permutation(4), rng.permutation(4))]]
        cells = []
        for clump in rng.permutation(16):
            x, y = divmod(int(clump), 4)
            odd = int(rng.integers(2))
            for pair in rng.permutation(4):
                i, j = divmod(int(pair), 2)
                cells.append((2 * x + i, 2 * y + j, 2 * int(square[x, y]) + ((i + j + odd) & 1)))
        leaves = np.array(cells)[rng.permutation(64)]
        place[variant] = 32 * leaves + rng.integers(32, size=(64, 3))
        for axis, (a, b) in enumerate(((1, 2), (0, 2), (0, 1))):
            column = 8 * leaves[:, a] + leaves[:, b]
            leaf_of[axis, variant, column] = np.arange(64)
            mask[axis, variant, 1:] = np.bitwise_or.accumulate(np.uint64(1) << column.astype(np.uint64))
    return mask, leaf_of, place


_MASK, _LEAF_OF, _PLACE = _leaves()
_COVER = (1.0 - exp(-np.arange(_COVER_STEPS * _COVER_MOST + 2) / _COVER_STEPS)).astype(np.float32)


@inline_kernel
def _hash(a: int, b: int, c: int, seed: np.uint32) -> np.uint32:
    """Hash the position of a voxel (constants and rounds as in MurmurHash3's finaliser)."""
    h = u4(u4(a) * u4(0x9E3779B1)) ^ u4(u4(b) * u4(0x85EBCA77)) ^ u4(u4(c) * u4(0xC2B2AE3D)) ^ u4(seed)
    h = u4(h ^ u4(h >> u4(16)))
    h = u4(h * u4(0x7FEB352D))
    h = u4(h ^ u4(h >> u4(15)))
    h = u4(h * u4(0x846CA68B))
    return u4(h ^ u4(h >> u4(16)))


class Weights(NamedTuple):
    """Weights of a voxel's codes for a light elevation between two knots."""

    bits: np.uint32  # first bit of the code of the lower knot
    low: np.float32
    high: np.float32  # times the length of a slab
    knot: int  # nearest knot


@inline_kernel
def weights_of(up: np.float32, length: np.float32) -> Weights:
    """Weigh the knots for light whose direction has the sine `up`, through slabs of a length.

    Between knots the projected area of leaves is a convex function of the sine: that of upright leaves
    changes with its square, that of level ones with the sine itself. With these mixtures of both it is within
    1.4 % below the middle knot and 5.2 % above it for the inclinations of all broadleaves and shrubs in
    `species.toml`; straight lines are up to 10.7 % and 8.1 % too high.
    """
    low_knot = u4(0) if up < f4(0.3) else u4(7)
    part = up / f4(0.3) if up < f4(0.3) else (up - f4(0.3)) / f4(0.7)
    share = part * (f4(1.0) + f4(2.0) * part) / f4(3.0)
    if up >= f4(0.3):
        share = part * (f4(3.0) + part) / f4(4.0)
    w_low, w_high = (f4(1.0) - share) * length, share * length
    knot = 0 if up < f4(0.15) else (1 if up < f4(0.65) else 2)
    return Weights(low_knot, w_low, w_high, knot)


@inline_kernel
def lit_lanes(
    M: Medium, pulse: Pulse, axes: _Three, corner: _Three, cell: _Three, code: np.uint32, weights: Weights
) -> tuple[np.uint32, np.uint64]:
    """Return the hash of a voxel's position, and bits of the lanes that meet one of its leaves; branchless.

    Parameters
    ----------
    axes : the main axis, across the slabs, and the two others
    corner, cell : corner of the grid in voxels of the world, and the voxel in the grid, along these axes
    code : code of the voxel
    """
    (main, second, third) = axes
    (k, i1, i2) = cell
    low, high = (code >> weights.bits) & u4(127), (code >> (weights.bits + u4(7))) & u4(127)
    g = k + corner[0]
    g1 = i1 + corner[1]
    g2 = i2 + corner[2]
    a = g if main == 0 else g1
    b = g if main == 1 else (g1 if main == 0 else g2)
    c = g if main == 2 else g2
    h = _hash(a, b, c, u4(M.seed))
    x = min(
        (TAU_PER_M[low] * weights.low + TAU_PER_M[high] * weights.high) * f4(_COVER_STEPS),
        f4(_COVER_STEPS * _COVER_MOST),
    )
    step = int(x)
    cover = _COVER[step] + (_COVER[step + 1] - _COVER[step]) * (x - f4(step))
    count = int(cover * f4(64.0) + f4(h >> u4(24)) * f4(1.0 / 256.0))
    bits = _MASK[main, int(h & u4(_VARIANTS - 1)), count]
    line = pulse.lanes.line
    middle_m = (f4(k) + f4(0.5)) * f4(VOXEL_M)
    (r1, r2) = _mirrors(h, second, third)
    if pulse.n == 1:
        return h, (bits >> np.uint64(_column(line, 0, middle_m, r1, r2))) & np.uint64(1)
    return h, _in_columns(line, middle_m, r1, r2, bits)


@inline_kernel
def _mirrors(h: np.uint32, second: int, third: int) -> tuple[np.int32, np.int32]:
    """Return how columns are mirrored along two axes."""
    return np.int32((h >> u4(5 + 3 * second)) & u4(7)), np.int32((h >> u4(5 + 3 * third)) & u4(7))


@inline_kernel
def meet_leaves(
    M: Medium,
    pulse: Pulse,
    axes: _Three,
    cell: _Three,
    number: np.uint32,
    knot: int,
    h: np.uint32,
    lit: np.uint64,
) -> bool:
    """Intersect lanes with their leaves in a voxel; return True if a leaf is the nearest hit of any lane.

    Parameters
    ----------
    axes, cell : as in `lit_lanes`; `h` and `lit` are its results, without the lanes that have ended
    number : number of the voxel's record
    knot : knot of the light's elevation
    """
    (main, second, third) = axes
    (k, i1, i2) = cell
    x = k if main == 0 else i1
    y = k if main == 1 else (i1 if main == 0 else i2)
    whose = number, (x // COLUMNS, y // COLUMNS), knot
    L = pulse.lanes
    near_m = pulse.near_m
    variant = int(h & u4(_VARIANTS - 1))
    line = L.line
    range_m = L.range_m
    middle_m = (f4(k) + f4(0.5)) * f4(VOXEL_M)
    (r1, r2) = _mirrors(h, second, third)
    mirror = int((h >> u4(5 + 3 * main)) & u4(7)) << 5
    met = False
    while lit:
        lane = int(lowest_bit(lit))
        lit &= lit - np.uint64(1)
        leaf = int(_LEAF_OF[main, variant, _column(line, lane, middle_m, r1, r2)])
        place = int(_PLACE[variant, leaf, main]) ^ mirror
        along_m = (f4(k) + (f4(place) + f4(0.5)) * f4(1.0 / 256.0)) * f4(VOXEL_M)
        at_m = (along_m - line[4 * LANES + lane]) * line[5 * LANES + lane]
        if near_m <= at_m < range_m[lane]:
            range_m[lane] = at_m
            _take_leaf(M, L, lane, h, leaf, _facet(line, lane, middle_m), whose)
            met = True
    return met


@inline_kernel
def _column(line: F4, lane: int, middle_m: np.float32, r1: np.int32, r2: np.int32) -> np.uint32:
    """Return the mirrored column (of 8 x 8) of a lane in the middle of a slab."""
    a = (np.int32(line[lane] + line[LANES + lane] * middle_m) & np.int32(7)) ^ r1
    b = (np.int32(line[2 * LANES + lane] + line[3 * LANES + lane] * middle_m) & np.int32(7)) ^ r2
    return u4(8 * a + b)


@inline_kernel
def _facet(line: F4, lane: int, middle_m: np.float32) -> np.uint32:
    """Return the facet of a column (of 4 x 2) that a lane meets in the middle of a slab."""
    a = np.int32(f4(4.0) * (line[lane] + line[LANES + lane] * middle_m)) & np.int32(3)
    b = np.int32(f4(2.0) * (line[2 * LANES + lane] + line[3 * LANES + lane] * middle_m)) & np.int32(1)
    return u4(2 * a + b)


@numba.extending.intrinsic
def _in_columns(
    typingctx: NumbaObject,
    line: NumbaObject,
    middle_m: NumbaObject,
    r1: NumbaObject,
    r2: NumbaObject,
    bits: NumbaObject,
) -> NumbaObject:
    """Return bits of the lanes whose `_column` is a bit of a word.

    Written as vectors, because the compiler splits a loop of eight: saves a twentieth of casting.
    """

    def codegen(
        context: NumbaObject, builder: NumbaObject, signature: NumbaObject, args: NumbaObject
    ) -> NumbaObject:
        floats = ir.VectorType(ir.FloatType(), LANES)
        wholes = ir.VectorType(ir.IntType(32), LANES)
        array, middle, *mirrors, word = args
        first = context.make_array(signature.args[0])(context, builder, array).data

        def row(number: int) -> NumbaObject:
            at = builder.gep(first, [ir.Constant(ir.IntType(64), LANES * number)])
            return builder.load(builder.bitcast(at, floats.as_pointer()), align=4)

        def each(value: NumbaObject) -> NumbaObject:
            nothing = ir.Constant(ir.VectorType(value.type, LANES), ir.Undefined)
            alone = builder.insert_element(nothing, value, ir.Constant(ir.IntType(32), 0))
            return builder.shuffle_vector(alone, nothing, ir.Constant(wholes, None))

        def whole(number: int) -> NumbaObject:
            return ir.Constant(wholes, [number] * LANES)

        a, b = (
            builder.xor(
                builder.and_(
                    builder.fptosi(
                        builder.fadd(row(2 * k), builder.fmul(row(2 * k + 1), each(middle))), wholes
                    ),
                    whole(7),
                ),
                each(mirror),
            )
            for k, mirror in enumerate(mirrors)
        )
        column = builder.add(builder.shl(a, whole(3)), b)
        low = builder.trunc(word, ir.IntType(32))
        high = builder.trunc(builder.lshr(word, ir.Constant(ir.IntType(64), 32)), ir.IntType(32))
        in_high = builder.sub(whole(0), builder.lshr(column, whole(5)))
        half = builder.xor(each(low), builder.and_(each(builder.xor(low, high)), in_high))
        bit = builder.lshr(half, builder.and_(column, whole(31)))
        lanes = builder.bitcast(builder.trunc(bit, ir.VectorType(ir.IntType(1), LANES)), ir.IntType(LANES))
        return builder.zext(lanes, ir.IntType(64))

    types = numba.types
    return types.uint64(line, types.float32, types.int32, types.int32, types.uint64), codegen


@inline_kernel
def _take_leaf(
    M: Medium, L: Lanes, lane: int, h: np.uint32, leaf: int, facet: np.uint32, whose: _Whose
) -> None:
    """Draw the owner of the facet of a leaf that a lane meets, and the angle of incidence of its quarter.

    Owners divide the facets of a leaf in proportion, so that a beam meets twigs as thin as they are.
    """
    number, tile, knot = whose
    quarter = (facet >> u4(2)) << u4(1) | (facet & u4(1))
    mixed = u4(u4(h + (u4(4 * leaf) | quarter) * u4(0x9E3779B1)) * u4(0x85EBCA77))
    mixed = u4(mixed ^ u4(mixed >> u4(15)))
    mixed = u4(mixed * u4(0xC2B2AE3D))
    mixed = u4(mixed ^ u4(mixed >> u4(16)))
    at = M.first_owner[number]
    drawn = u4((mixed + _SPREAD * facet) & u4(0xFF))
    owner = M.owner[at]
    while owner >> SHARE_BIT < drawn:
        at += u4(1)
        owner = M.owner[at]
    L.surface[lane] = M.surface[tile[0], tile[1], (owner >> TILE_BIT) & np.uint64(15)] + u4(owner)
    law = (owner >> LAW_BIT) & LAW_MASK
    L.cosine[lane] = M.cosine[law, knot, int(mixed >> u4(8)) % QUANTILES]
