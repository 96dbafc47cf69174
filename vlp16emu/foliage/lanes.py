"""Sub-rays of a pulse, side by side, and what they go through when it is far.

Ground is a grid, stems are cones, and foliage is bricks of voxels.
"""

from typing import Any, NamedTuple

import llvmlite.ir
import numpy as np

from vlp16emu.kernels.compiler import numba
from vlp16emu.raycast.kernel import COSINE, DIRECTION, LANES, ORIGIN, RANGE, ROW
from vlp16emu.types import F4, F8, U4, U8


class Ground(NamedTuple):
    """The ground."""

    height_m: F4  # (8 x + 1, 8 y + 1) at the corners of squares, `FINER` to the edge of a voxel
    surface: U4  # (x, y) of the column of bricks
    corner_x_m: float
    corner_y_m: float
    steepest: float  # greatest slope


class Stems(NamedTuple):
    """Stems of a window, relative to its origin."""

    line: F8  # (n, 8) foot, unit axis, widest radius, and how far the stem bends off the axis at most
    profile: F4
    """(n, 5, knots) heights along the axis, radii, the greatest radius from there upwards, and how far in x and y the
    middle of the circle is off the axis."""
    plan: F4  # (3, n) x and y of the middle, and radius, of a circle around the stem as seen from above
    bounds: F4  # (n, 9) foot, unit axis, lowest and highest end along the axis, reach beside it
    surface: U4  # (n, 2) of root flare and stem
    flare_m: F4  # (n,) height along the axis at which the flare ends


class Medium(NamedTuple):
    """Far medium of a window, relative to the window's origin."""

    near_m: float  # range at which it begins; nothing where it is infinite
    corner_m: tuple[float, float, float]  # corner of the grid of bricks
    corner: tuple[int, int, int]  # corner of the grid, in voxels of the world
    brick: U8
    """(x, y, z, 2) of each brick which voxels hold anything, as in `Block`, and the number of the first of them."""
    record: U4  # (m,) of voxels, as in `Block`, and of some that are in other windows only
    first_owner: U4  # (m,) of each of them
    owner: U8  # (o,) as in `Block`
    surface: U4  # (x / 10, y / 10, 9) first surfaces of each tile and of those around it
    cosine: F4  # (laws, knots, QUANTILES) as in `Cloud`
    ground: Ground
    stems: Stems
    seed: int


AHEAD = 16  # slabs that are looked at before the voxels in them: without branches that nobody can foretell

AT, HEIGHT, FACING, _END = (ROW + LANES * row for row in range(4))  # offsets of further rows of lanes in `Lanes.row`


class Lanes(NamedTuple):
    """Up to eight sub-rays of a pulse.

    Loops over lanes read and write one array at constant places, so that the compiler makes vectors of them.
    """

    row: F4
    """(88,) rows of eight as in `Batch.row`, then scratch. `AT`, `HEIGHT`, `FACING`: range, height along the axis and cosine at which a lane meets a stem."""
    origin_m: F4  # (3, 8) of these rows
    direction: F4  # (3, 8) likewise
    range_m: F4  # (8,) likewise, in: what each has met, or where its light is given up. Out: what it meets first.
    cosine: F4  # (8,) likewise
    surface: U4  # (8,) likewise
    line: F4
    """(48,) scratch, rows of eight: place across at the grid's corner and its change per metre, in 8ths of voxels, on both
    axes; then place along and its inverse change per metre of range."""
    place: U4  # (AHEAD,) scratch: brick and bit of the voxel of each slab, then the number of its record
    code: U4  # (AHEAD,) scratch: these records
    hash: U4  # (AHEAD,) scratch: hashes of the places of these voxels
    lit: U8  # (AHEAD,) scratch: bits of the lanes before whose middles there is a leaf in these voxels


class Pulse(NamedTuple):
    """A pulse on its way through a medium."""

    lanes: Lanes
    n: int  # number of its lanes
    near_m: np.float32  # range at which the medium begins
    axis: F4  # (6 or more,) origin and direction of its middle
    aside_m: np.float32  # greatest distance from the middle at which lanes begin
    spread: np.float32  # greatest growth of that distance per metre of range


def lanes() -> Lanes:
    """Return empty lanes."""
    row = np.zeros(_END, np.float32)
    return Lanes(
        row,
        row[ORIGIN:DIRECTION].reshape(3, LANES),
        row[DIRECTION:RANGE].reshape(3, LANES),
        row[RANGE:COSINE],
        row[COSINE:AT],
        np.zeros(LANES, np.uint32),
        np.zeros(6 * LANES, np.float32),
        np.zeros(AHEAD, np.uint32),
        np.zeros(AHEAD, np.uint32),
        np.zeros(AHEAD, np.uint32),
        np.zeros(AHEAD, np.uint64),
    )


@numba.extending.intrinsic
def lowest(typingctx: Any, word: Any) -> Any:  # noqa: ARG001 - the signature is numba's
    """Find the lowest bit of a word that is not 0."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ARG001 - likewise
        return builder.cttz(args[0], llvmlite.ir.Constant(llvmlite.ir.IntType(1), 1))

    return numba.types.uint64(numba.types.uint64), codegen


@numba.extending.intrinsic
def ones(typingctx: Any, word: Any) -> Any:  # noqa: ARG001 - likewise
    """Count the bits of a word."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ARG001 - likewise
        return builder.ctpop(args[0])

    return numba.types.uint64(numba.types.uint64), codegen
