"""Lanes, the sub-rays of a pulse side by side, and the far medium that they pass.

Ground is a grid, stems are cones, and foliage is voxels in bricks.
"""

from typing import NamedTuple

import numpy as np

from vlp16emu.raycast.kernel import COSINE, DIRECTION, LANES, ORIGIN, RANGE, ROW
from vlp16emu.types import F4, F8, U4, U8


class Ground(NamedTuple):
    """The ground."""

    height_m: F4  # (8 x + 1, 8 y + 1) at the corners of squares, `FINER` to the edge of a voxel
    surface: U4  # (x, y) of the column of bricks
    corner_x_m: float
    corner_y_m: float
    steepest: float  # greatest slope
    sides: U4  # (8 x, 8 y) low things on the squares of `height_m`, as in `FarTile`
    facing: F4  # (QUANTILES,) likewise


class Stems(NamedTuple):
    """Stems of a window, relative to its origin."""

    line: F8  # (n, 8) foot, unit axis, widest radius, and greatest bend of the stem off the axis
    profile: F4
    """(n, 5, knots) heights along the axis, radii, the greatest radius from there upwards, and the offset in
    x and y of the circle's centre from the axis."""
    plan: F4  # (3, n) x and y of the centre, and radius, of a circle around the stem as seen from above
    bounds: F4  # (n, 9) foot, unit axis, lowest and highest end along the axis, reach beside it
    share: F4  # (n, knots) movement in wind over the top's; (0, knots) if no stem moves
    top_m: F4
    """(k, n, 2) movement of the tops in x and y, at even times from 0 to 1 as in `PulseBatch.time`; k is 0 if
    no stem moves."""
    surface: U4  # (n, 2) of root flare and stem
    flare_m: F4  # (n,) height along the axis of the flare's end


class Medium(NamedTuple):
    """Far medium of a window, relative to the window's origin."""

    near_m: float  # range at which it begins; infinite for no medium
    corner_m: tuple[float, float, float]  # corner of the grid of bricks
    corner: tuple[int, int, int]  # corner of the grid, in voxels of the world
    brick: U8
    """(x, y, z, 2) for each brick the mask of its occupied voxels, as in `Block`, and the record of the first
    one."""
    record: U4  # (m,) voxel records, as in `Block`, with some that only other windows use
    first_owner: U4  # (m,) first owner of each record
    owner: U8  # (o,) as in `Block`
    surface: U4  # (x / 10, y / 10, 9) first surface of each tile and its neighbours
    cosine: F4  # (laws, knots, QUANTILES) as in `Cloud`
    ground: Ground
    stems: Stems
    seed: int


AHEAD = 16  # slabs examined before the voxels in them, without unpredictable branches

AT, HEIGHT, FACING, _END = (ROW + LANES * row for row in range(4))
"""Offsets of further rows of lanes in `Lanes.row`."""


class Lanes(NamedTuple):
    """Up to eight sub-rays of a pulse.

    Loops over lanes read and write one array at constant offsets, so that the compiler vectorizes them.
    """

    row: F4
    """(88,) rows of eight as in `Batch.row`, then scratch. `AT`, `HEIGHT`, `FACING`: range, height along the
    axis and cosine at which a lane meets a stem."""
    origin_m: F4  # (3, 8) of these rows
    direction: F4  # (3, 8) likewise
    range_m: F4
    """(8,) likewise; in: range of the hit so far, or the farthest range; out: range of the first hit."""
    cosine: F4  # (8,) likewise
    surface: U4
    """(8,) likewise; of a lane that meets a leaf `leaves.UNOWNED`, until its owner is drawn."""
    leaf: U4
    """(24,) rows of eight of the leaves that lanes meet: number of the voxel's record, draws, and tile; as in
    `leaves.LeavesMet`."""
    line: F4
    """(48,) scratch, rows of eight: position across at the grid's corner and its change per metre, in 16ths
    of voxels, on both axes; then position along and its inverse change per metre of range."""
    place: U4  # (AHEAD,) scratch: brick and bit of the voxel of each slab, then the number of its record
    code: U4  # (AHEAD,) scratch: these records
    hash: U4  # (AHEAD,) scratch: hashes of the places of these voxels
    lit: U8  # (AHEAD,) scratch: bits of the lanes that pass a column with a leaf in these voxels


class Pulse(NamedTuple):
    """A pulse on its way through a medium."""

    lanes: Lanes
    n: int  # number of lanes
    near_m: np.float32  # range at which the medium begins
    axis: F4
    """(6 or more,) origin and direction of its centre ray; with stems that move a row of `Batch.axes_row`."""
    aside_m: np.float32  # greatest distance of a lane's origin from the centre ray
    spread: np.float32  # greatest growth of that distance per metre of range


def empty_lanes() -> Lanes:
    """Return empty lanes."""
    row = np.zeros(_END, np.float32)
    return Lanes(
        row,
        row[ORIGIN:DIRECTION].reshape(3, LANES),
        row[DIRECTION:RANGE].reshape(3, LANES),
        row[RANGE:COSINE],
        row[COSINE:AT],
        np.zeros(LANES, np.uint32),
        np.zeros(3 * LANES, np.uint32),
        np.zeros(6 * LANES, np.float32),
        np.zeros(AHEAD, np.uint32),
        np.zeros(AHEAD, np.uint32),
        np.zeros(AHEAD, np.uint32),
        np.zeros(AHEAD, np.uint64),
    )
