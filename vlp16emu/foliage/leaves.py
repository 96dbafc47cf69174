"""Leaves of voxels, and their intersection with lanes.

The leaves of a voxel are 256 cells, one in each column of 16 x 16 along each of the three axes, so that a
leaf has the same position from every direction. The first n of them are present; n / 256 is the share of the
light that foliage of that density intercepts over the length of the slab (Beer's law). The voxel's order, its
mirroring, and the rounding of n follow from a hash of the voxel's position in the world.

A column is 31 mm wide, about a small twig with its leaves. It consists of two facets of 16 x 31 mm. An owner
with little of a voxel's area has single facets, and one with much of it whole columns: a beam meets twigs
amid leaves in more pulses, and in fewer sub-rays of each, than it would meet branches of the same area.

Leaves come in clumps, which decide how many beams are filled by leaves, and how many pass through a gap.
Clumps have holes: a few of their leaves are missing long after the others are present. Kinds of foliage have
clumps of their own (`vlp16emu.foliage.voxel`).
"""

from typing import NamedTuple

import numpy as np
from llvmlite import ir

from vlp16emu.elementary import exp
from vlp16emu.foliage.lanes import Lanes, Medium, Pulse
from vlp16emu.foliage.voxel import (
    COLUMNS,
    KIND_BIT,
    LAW_BIT,
    LAW_MASK,
    LEAVES,
    QUANTILES,
    SHARE_BIT,
    TAU_PER_M,
    TILE_BIT,
    VOXEL_M,
)
from vlp16emu.kernels.compiler import NumbaObject, inline_kernel, kernel, numba
from vlp16emu.kernels.eight import lowest_bit
from vlp16emu.raycast.kernel import COSINE, LANES
from vlp16emu.types import F4, U1, U4, U8

_VARIANTS = 16  # of a kind
_COVER_STEPS = 64
_COVER_MOST = 16
f4 = np.float32
u4 = np.uint32
_SPREAD = u4(16)
"""Step of the draw of an owner from facet to facet, of 256. An owner with less than a 16th of a voxel's area
has single facets."""
_CLUMPS = (1.0, 0.7, 0.5, 0.7), (0.9, 1.3, 0.4, 2.0), (0.2, 0.7, 0.85, 0.9), (0.55, 1.1, 0.15, 0.1)
"""Weights of cubes of 250, 125, 62 and 31 mm in the order of leaves, by kind.

Source: sub-rays of a pulse that foliage ends within 0.75 m, and that are left at 20 to 70 m, in stands of one
species leaf by leaf (`tools/clumps`)."""
_HOLES = False, True, True, False
"""Whether the draws of leaves of 31 mm are fifth powers of uniform ones, by kind: most are small, and a few
large, so that clumps have holes."""
_Three = tuple[int, int, int]
_Words = tuple[np.uint32, np.uint32, np.uint32]
UNOWNED = u4(0xFFFFFFFE)  # surface of a lane that meets a leaf whose owner is not drawn yet
_QUANTILE_BIT = u4(8)  # first bits of the parts of `LeavesMet.drawn`; the draw of an owner begins at bit 0
_KNOT_BIT = u4(16)


def _leaves(weights: tuple[float, ...], seed: int, *, holes: bool) -> tuple[U1, U1]:
    """Make the leaves of the voxels' variants, the first to be present first.

    Leaves of a cube are present together the sooner, the greater its weight is.

    Parameters
    ----------
    weights : weights of the draws of cubes of 250, 125, 62 and 31 mm in the order of their leaves
    holes : True if the draws of the smallest cubes are fifth powers

    Returns
    -------
    The leaf of each column, (3, variants, 256): index 16 a + b along each axis, where a and b are the other
    two axes in order; and positions of leaves along the axes, (variants, 256, 3) in 256ths of a voxel.
    """
    rng = np.random.default_rng(seed)  # determines bytes of the output
    leaf_of = np.zeros((3, _VARIANTS, LEAVES * LEAVES), np.uint8)
    place = np.zeros((_VARIANTS, LEAVES * LEAVES, 3), np.uint8)
    i, j = np.divmod(np.arange(4), 2)
    for variant in range(_VARIANTS):
        cell = np.zeros((1, 3), np.int64)
        late = np.zeros(1)
        for level, weight in enumerate(weights):
            # Each cube has four smaller ones, a Latin square of order 2.
            odd = rng.integers(2, size=len(cell))[:, None]
            k = (i + j + odd) & 1
            smaller = np.stack([i + 0 * k, j + 0 * k, k], axis=-1)
            cell = (2 * cell[:, None] + smaller).reshape(-1, 3)
            draw = rng.random(len(cell))
            if holes and level == len(weights) - 1:
                draw *= draw * draw * draw * draw
            late = np.repeat(late, 4) + weight * draw
        cell = cell[np.argsort(late, kind="stable")]
        place[variant] = 16 * cell + rng.integers(16, size=cell.shape)
        for axis, (a, b) in enumerate(((1, 2), (0, 2), (0, 1))):
            leaf_of[axis, variant, LEAVES * cell[:, a] + cell[:, b]] = np.arange(len(cell))
    return leaf_of, place


_KINDS = [
    _leaves(weights, kind, holes=holes)
    for kind, (weights, holes) in enumerate(zip(_CLUMPS, _HOLES, strict=True))
]
_LEAF_OF = np.concatenate([leaf_of for leaf_of, _ in _KINDS], axis=1)
_PLACE = np.concatenate([place for _, place in _KINDS])
_PAIR = ((_PLACE[..., 0] >> 5) * 8 + (_PLACE[..., 1] >> 5)) * 2 + ((_PLACE[..., 2] >> 4) & 1)
"""(variants, 256) pair of each leaf: two side by side at one height."""
_LEAF_OF_COLUMN = _LEAF_OF.reshape(-1)
_PLACE_OF_COLUMN = np.concatenate(
    [np.take_along_axis(_PLACE[:, :, axis], _LEAF_OF[axis].astype(np.int64), axis=1) for axis in range(3)]
).reshape(-1)
"""Positions along the axis of the leaves of `_LEAF_OF_COLUMN`."""
_COVER = (1.0 - exp(-np.arange(_COVER_STEPS * _COVER_MOST + 2) / _COVER_STEPS)).astype(np.float32)


_FACTORS = u4(0x9E3779B1), u4(0x85EBCA77), u4(0xC2B2AE3D)
"""Factors of x, y and z in the hash of a voxel's position."""


@inline_kernel
def hash_factors(axes: _Three) -> _Words:
    """Return the factors of positions along three axes, for `hash_of`."""
    (main, second, third) = axes
    return _FACTORS[main], _FACTORS[second], _FACTORS[third]


@inline_kernel
def hash_of(a: np.uint32, b: np.uint32, c: np.uint32, factors: _Words, seed: np.uint32) -> np.uint32:
    """Hash the position of a voxel of the world (constants and rounds as in lowbias32, C. Wellons 2018).

    Parameters
    ----------
    a, b, c : position along three axes, in voxels
    factors : as `hash_factors` returns them for these axes
    """
    h = u4(a * factors[0]) ^ u4(b * factors[1]) ^ u4(c * factors[2]) ^ seed
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
    knot: int  # lower knot
    chance: np.uint32  # share of cosines of incidence that are those of the upper knot, of 256


_Whose = tuple[np.uint32, np.uint32, Weights]
"""Number of the record of a voxel, its tile in the order of `Medium.surface`, and the light's weights."""


@inline_kernel
def weights_of(up: np.float32, length: np.float32) -> Weights:
    """Weigh the knots for light whose direction has the sine `up`, through slabs of a length.

    Between knots the projected area of leaves is a convex function of the sine: that of upright leaves
    changes with its square, that of level ones with the sine itself. With these mixtures of both it is within
    1.4 % below the middle knot and 5.2 % above it for the inclinations of all broadleaves and shrubs in
    `species.toml`; straight lines are up to 10.7 % and 8.1 % too high.

    The mean cosine at which light meets level leaves is within 2 % of that of level light up to 10 degrees,
    since it meets their tilted parts, and grows by a sixth from there to 17 degrees.
    """
    low_knot = u4(0) if up < f4(0.3) else u4(7)
    part = up / f4(0.3) if up < f4(0.3) else (up - f4(0.3)) / f4(0.7)
    share = part * (f4(1.0) + f4(2.0) * part) / f4(3.0)
    if up >= f4(0.3):
        share = part * (f4(3.0) + part) / f4(4.0)
    w_low, w_high = (f4(1.0) - share) * length, share * length
    knot = 0 if up < f4(0.3) else 1
    at_upper = part * part * part * part if up < f4(0.3) else part
    return Weights(low_knot, w_low, w_high, knot, u4(at_upper * f4(256.0)))


@inline_kernel
def lit_lanes(
    pulse: Pulse, axes: _Three, k: int, code: np.uint32, h: np.uint32, weights: Weights
) -> np.uint64:
    """Return bits of the lanes that meet one of the leaves of a voxel; branchless.

    Parameters
    ----------
    axes : the main axis, across the slabs, and the two others
    k : place of the voxel in the grid along the main axis
    code, h : code of the voxel, and hash of its position
    """
    (main, second, third) = axes
    low, high = (code >> weights.bits) & u4(127), (code >> (weights.bits + u4(7))) & u4(127)
    x = min(
        (TAU_PER_M[low] * weights.low + TAU_PER_M[high] * weights.high) * f4(_COVER_STEPS),
        f4(_COVER_STEPS * _COVER_MOST),
    )
    step = u4(x)  # unsigned: a signed index might count from the end
    cover = _COVER[step] + (_COVER[step + u4(1)] - _COVER[step]) * (x - f4(step))
    count = np.int32(cover * f4(LEAVES * LEAVES) + f4(h >> u4(24)) * f4(1.0 / 256.0))
    line = pulse.lanes.line
    middle_m = (f4(k) + f4(0.5)) * f4(VOXEL_M)
    (r1, r2) = _mirrors(h, second, third)
    first = u4((main * len(_CLUMPS) * _VARIANTS + variant_of(h, code)) * LEAVES * LEAVES)
    if pulse.n == 1:
        leaf = _LEAF_OF_COLUMN[first + _column(line, 0, middle_m, r1, r2)]
        return np.uint64(np.int32(leaf) < count)
    return _in_columns(line, middle_m, r1, r2, _LEAF_OF_COLUMN, np.int32(first), count)


@inline_kernel
def variant_of(h: np.uint32, code: np.uint32) -> int:
    """Return the number of a voxel's variant, by the hash of its position and its code."""
    return int(h & u4(_VARIANTS - 1)) + _VARIANTS * int((code >> KIND_BIT) & u4(3))


@inline_kernel
def _mirrors(h: np.uint32, second: int, third: int) -> tuple[np.int32, np.int32]:
    """Return how columns are mirrored along two axes."""
    return np.int32((h >> u4(5 + 4 * second)) & u4(15)), np.int32((h >> u4(5 + 4 * third)) & u4(15))


@inline_kernel
def meet_leaves(
    M: Medium,
    pulse: Pulse,
    axes: _Three,
    cell: _Three,
    number: np.uint32,
    weights: Weights,
    h: np.uint32,
    lit: np.uint64,
    code: np.uint32,
) -> bool:
    """Intersect lanes with their leaves in a voxel; return True if a leaf is the nearest hit of any lane.

    Parameters
    ----------
    axes, cell : as in `lit_lanes`; `h` and `lit` are its results, without the lanes that have ended
    number : number of the voxel's record
    """
    (main, second, third) = axes
    (k, i1, i2) = cell
    x = k if main == 0 else i1
    y = k if main == 1 else (i1 if main == 0 else i2)
    whose = number, u4((x // COLUMNS) * M.surface.shape[1] + y // COLUMNS), weights
    L = pulse.lanes
    near_m = pulse.near_m
    variant = variant_of(h, code)
    line = L.line
    range_m = L.range_m
    middle_m = (f4(k) + f4(0.5)) * f4(VOXEL_M)
    (r1, r2) = _mirrors(h, second, third)
    mirror = int((h >> u4(5 + 4 * main)) & u4(15)) << 4
    first = u4((main * len(_CLUMPS) * _VARIANTS + variant) * LEAVES * LEAVES)
    met = False
    while lit:
        lane = int(lowest_bit(lit))
        lit &= lit - np.uint64(1)
        column = first + _column(line, lane, middle_m, r1, r2)
        place = int(_PLACE_OF_COLUMN[column]) ^ mirror
        along_m = (f4(k) + (f4(place) + f4(0.5)) * f4(1.0 / 256.0)) * f4(VOXEL_M)
        at_m = (along_m - line[4 * LANES + lane]) * line[5 * LANES + lane]
        if near_m <= at_m < range_m[lane]:
            range_m[lane] = at_m
            leaf = int(_LEAF_OF_COLUMN[column])
            pair = int(_PAIR[variant, leaf])
            _note_leaf(L, lane, h, leaf, pair, _facet(line, lane, middle_m), whose)
            met = True
    return met


@inline_kernel
def _column(line: F4, lane: int, middle_m: np.float32, r1: np.int32, r2: np.int32) -> np.uint32:
    """Return the mirrored column (of 16 x 16) of a lane in the middle of a slab."""
    a = (np.int32(line[lane] + line[LANES + lane] * middle_m) & np.int32(15)) ^ r1
    b = (np.int32(line[2 * LANES + lane] + line[3 * LANES + lane] * middle_m) & np.int32(15)) ^ r2
    return u4(LEAVES * a + b)


@inline_kernel
def _facet(line: F4, lane: int, middle_m: np.float32) -> np.uint32:
    """Return the facet of a column (of 2) that a lane meets in the middle of a slab."""
    return u4(np.int32(f4(2.0) * (line[lane] + line[LANES + lane] * middle_m)) & np.int32(1))


@numba.extending.intrinsic
def _in_columns(
    typingctx: NumbaObject,
    line: NumbaObject,
    middle_m: NumbaObject,
    r1: NumbaObject,
    r2: NumbaObject,
    table: NumbaObject,
    first: NumbaObject,
    count: NumbaObject,
) -> NumbaObject:
    """Return bits of the lanes whose `_column` has one of the first `count` leaves.

    Written as vectors, because the compiler splits a loop of eight: saves a twentieth of casting.
    """

    def codegen(
        context: NumbaObject, builder: NumbaObject, signature: NumbaObject, args: NumbaObject
    ) -> NumbaObject:
        floats = ir.VectorType(ir.FloatType(), LANES)
        wholes = ir.VectorType(ir.IntType(32), LANES)
        array, middle, *mirrors, table, begin, most = args
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
                    whole(15),
                ),
                each(mirror),
            )
            for k, mirror in enumerate(mirrors)
        )
        column = builder.add(builder.add(builder.shl(a, whole(4)), b), each(begin))
        leaves = context.make_array(signature.args[4])(context, builder, table).data
        leaf = ir.Constant(ir.VectorType(ir.IntType(8), LANES), ir.Undefined)
        for lane in range(LANES):
            number = ir.Constant(ir.IntType(32), lane)
            at = builder.zext(builder.extract_element(column, number), ir.IntType(64))
            leaf = builder.insert_element(leaf, builder.load(builder.gep(leaves, [at])), number)
        bit = builder.icmp_signed("<", builder.zext(leaf, wholes), each(most))
        lanes = builder.bitcast(bit, ir.IntType(LANES))
        return builder.zext(lanes, ir.IntType(64))

    types = numba.types
    return types.uint64(
        line, types.float32, types.int32, types.int32, table, types.int32, types.int32
    ), codegen


@inline_kernel
def _note_leaf(
    L: Lanes, lane: int, h: np.uint32, leaf: int, pair: int, facet: np.uint32, whose: _Whose
) -> None:
    """Note the leaf that a lane meets: what draws the owner of its facet, and the incidence of its pair.

    A pair of 62 x 31 mm is as large as a leaf of birch, which a beam meets at one angle. With an angle for
    each column of 31 mm, a stand of birch has 2.3 % too many echoes of leaves.
    """
    number, tile, weights = whose
    drawn = u4((_mixed(h, u4(leaf)) + _SPREAD * facet) & u4(0xFF))
    mixed = _mixed(h, u4(LEAVES * LEAVES + pair))
    knot = weights.knot + int(u4((mixed >> u4(16)) & u4(0xFF)) < weights.chance)
    quantile = u4(int(mixed >> u4(8)) % QUANTILES)
    row = L.leaf
    row[lane] = number
    row[LANES + lane] = drawn | u4(quantile << _QUANTILE_BIT) | u4(u4(knot) << _KNOT_BIT)
    row[2 * LANES + lane] = tile
    L.surface[lane] = UNOWNED


@inline_kernel
def _mixed(h: np.uint32, number: np.uint32) -> np.uint32:
    """Return the hash of a number in the voxel with the hash h."""
    mixed = u4(u4(h + number * u4(0x9E3779B1)) * u4(0x85EBCA77))
    mixed = u4(mixed ^ u4(mixed >> u4(15)))
    mixed = u4(mixed * u4(0xC2B2AE3D))
    return u4(mixed ^ u4(mixed >> u4(16)))


class LeavesMet(NamedTuple):
    """Leaves that the pulses of a round meet, (8 n + 1,) each for n pulses, and scratch.

    Their owners are drawn together, so that the memory of one is read while that of others is awaited.
    """

    place: U4  # eight times the number of the pulse, plus the lane
    number: U4  # of the voxel's record
    drawn: U4
    """Bit fields: draw of the owner; from `_QUANTILE_BIT` the quantile of the cosine of incidence; from
    `_KNOT_BIT` the knot of the light's elevation."""
    tile: U4  # in the order of `Medium.surface`
    at: U4  # scratch: place of the first owner; `owner` likewise
    owner: U8


def room_for_leaves(pulses: int) -> LeavesMet:
    """Make an empty `LeavesMet` for a number of pulses."""
    room = LANES * pulses + 1
    place, number, drawn, tile, at = (np.zeros(room, np.uint32) for _ in range(5))
    return LeavesMet(place, number, drawn, tile, at, np.zeros(room, np.uint64))


@inline_kernel
def take_leaves(L: Lanes, q: int, count: int, met: LeavesMet, found: int) -> int:
    """Add the leaves that pulse q meets to `found` others; return their number."""
    for lane in range(count):
        met.place[found] = LANES * q + lane
        met.number[found] = L.leaf[lane]
        met.drawn[found] = L.leaf[LANES + lane]
        met.tile[found] = L.leaf[2 * LANES + lane]
        found += L.surface[lane] == UNOWNED
    return found


@kernel
def draw_owners(M: Medium, met: LeavesMet, found: int, row: F4, surface: U4) -> None:
    """Find the owners of `found` leaves, and fill surfaces (n, 8) and cosines in rows as in `Batch.row`.

    Owners divide the facets of a leaf in proportion, so that a beam meets twigs as thin as they are.
    """
    place = met.place
    at = met.at
    owners = met.owner
    for i in range(found):
        at[i] = M.first_owner[met.number[i]]
    for i in range(found):
        owners[i] = M.owner[at[i]]
    for i in range(found):
        q = place[i] // LANES
        lane = place[i] % LANES
        drawn = met.drawn[i] & u4(0xFF)
        owner = owners[i]
        next_at = at[i]
        while owner >> SHARE_BIT < drawn:
            next_at += u4(1)
            owner = M.owner[next_at]
        tile = met.tile[i]
        first = M.surface[
            tile // M.surface.shape[1], tile % M.surface.shape[1], (owner >> TILE_BIT) & np.uint64(15)
        ]
        surface[q, lane] = first + u4(owner)
        law = (owner >> LAW_BIT) & LAW_MASK
        quantile = (met.drawn[i] >> _QUANTILE_BIT) & u4(0xFF)
        row[q, COSINE + lane] = M.cosine[law, met.drawn[i] >> _KNOT_BIT, quantile]
