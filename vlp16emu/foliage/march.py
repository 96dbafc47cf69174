"""The march of light through the far medium: a grid of ground, tapered stems, and voxels of foliage.

A pulse passes slabs of voxels along the axis that it is most parallel to, some at a time; before each time it
is intersected with the stems that it may meet there (`vlp16emu.foliage.stems`). The voxel on its centre ray
decides for all sub-rays in a slab: the density of foliage (`vlp16emu.foliage.leaves`), and whether ground may
be met; each sub-ray is then intersected exactly with the ground (`vlp16emu.foliage.ground`).
"""

from typing import NamedTuple

import numpy as np

from vlp16emu.foliage.ground import meet_ground
from vlp16emu.foliage.lanes import AHEAD, Lanes, Medium, Pulse
from vlp16emu.foliage.leaves import (
    LeavesMet,
    Weights,
    draw_owners,
    hash_factors,
    hash_of,
    lit_lanes,
    meet_leaves,
    take_leaves,
    weights_of,
)
from vlp16emu.foliage.stems import StemsAhead, StemsLeft, find_stems_ahead, meet_stems
from vlp16emu.foliage.voxel import BRICK, GROUND, LEAVES, VOXEL_M
from vlp16emu.kernels.compiler import array_kernel, inline_kernel, kernel
from vlp16emu.kernels.eight import count_bits, lowest_bit
from vlp16emu.raycast.adaptive import RayBudget
from vlp16emu.raycast.beam import FARTHEST, ROUND, reach_of
from vlp16emu.raycast.kernel import (
    COSINE,
    DIRECTION,
    LANES,
    RANGE,
    Cast,
    cast_centre_rays,
    cast_near,
    concatenate,
    empty_groups,
    further_hits,
    queue_all,
    settle,
    write_centre_rays,
)
from vlp16emu.raycast.packet import PACKET, Target, set_filter
from vlp16emu.trig import ZERO
from vlp16emu.types import F4, U2, U4, U8

f4 = np.float32
u4 = np.uint32
_SLABS = np.arange(AHEAD, dtype=np.float32)
_FEW = 4  # voxels whose leaves are processed together


class Passage(NamedTuple):
    """All that rays pass behind the near faces, and scratch of a cast."""

    medium: Medium
    beyond: Target  # faces that are cast at any range
    lanes: Lanes  # scratch of this cast; `ahead` likewise
    ahead: StemsAhead
    leaves: LeavesMet


class _CentreRay(NamedTuple):
    """Centre ray of a pulse through a grid, slab by slab."""

    main: int  # axis across the slabs
    second: int
    third: int
    k: int  # slab in which the medium begins; others are counted from it
    step: int  # +1 or -1 along the axis
    length: np.float32  # metres of range from slab to slab
    to_middle: np.float32  # range at the centre of slab k
    p1: np.float32
    """Position in voxels along the second axis at the centre of slab k; `p2` likewise along the third, and
    their changes per slab."""
    p2: np.float32
    d1: np.float32
    d2: np.float32


class _Grid(NamedTuple):
    """A grid along the main axis, the second and the third."""

    size: tuple[int, int, int]  # size in voxels
    stride: tuple[np.uint32, np.uint32, np.uint32]  # stride from brick to brick
    shift: tuple[np.uint32, np.uint32, np.uint32]  # bits in a brick from voxel to voxel
    corner: tuple[int, int, int]  # corner in voxels of the world


@array_kernel
def march_lines(cast: Cast, passage: Passage, range_m: F4, surface: U4, cos_incidence: F4) -> None:
    """Cast one ray per pulse against near faces, as `cast_lines` does, and through the medium behind them."""
    pulses = cast.batch.missed.shape[0]
    set_filter(cast.packet)
    for first in cast.light.order:
        cast_centre_rays(cast, passage.beyond, first)
        _march_misses(passage, cast, pulses, ZERO + 1, f4(0.0))
        write_centre_rays(cast, first, range_m, surface, cos_incidence)


@array_kernel
def march_pulses(cast: Cast, passage: Passage, budget: RayBudget, count: U2, first_round: U4) -> U4:
    """Cast the sub-rays of every pulse as `cast_pulses` does, each round through the medium too."""
    set_filter(cast.packet)
    groups = empty_groups(count)
    for first in cast.light.order:
        todo = queue_all(cast.batch)
        have = ZERO
        while todo:
            rays = min(ROUND, budget.max_rays - have)
            cast_near(cast, passage.beyond, budget, first, todo, have, rays)
            _march_misses(passage, cast, todo, rays, reach_of(have, budget.adaptive))
            todo = settle(cast, budget, first_round, first, todo, have, rays)
            have = have + rays
        groups[first // PACKET] = further_hits(cast.batch, min(ROUND, budget.max_rays), first, count)
    return concatenate(groups)


@inline_kernel
def march(M: Medium, bricks: U8, ahead: StemsAhead, pulse: Pulse) -> None:
    """Follow the lanes of a pulse through the medium; `draw_owners` finds the owners of the leaves they meet.

    Parameters
    ----------
    bricks : `M.brick`, flattened
    ahead : the stems that it may meet, from `find_stems_ahead`
    """
    L = pulse.lanes
    n = pulse.n
    near_m = pulse.near_m
    axis = pulse.axis
    corner_m = (f4(M.corner_m[0]), f4(M.corner_m[1]), f4(M.corner_m[2]))
    centre = _centre_ray(corner_m, axis, near_m)
    axes = (centre.main, centre.second, centre.third)
    length = centre.length
    alive, last_m = _set_up_lines(corner_m, L, n, near_m, axes)
    weights = weights_of(abs(axis[5]), length)
    grid = _grid(M, axes)
    factors = hash_factors(axes)
    seed = u4(M.seed)
    first, stop = _crossing(centre, grid.size)
    slab = -_floor(-first)
    slabs = _floor(min(stop, (last_m - centre.to_middle) / length + f4(1.5)))
    stems = StemsLeft(ZERO, np.uint64(0))
    while True:
        # Outside the grid there are stems all the same.
        until_m = centre.to_middle + f4(slab + AHEAD + 1) * length if slab <= slabs else f4(np.inf)
        stems, met = meet_stems(M.stems, ahead, pulse, stems, until_m)
        if met:
            alive, slabs = _drop_ended(L, centre, n, alive, slab, slabs)
        if slab > slabs:
            break
        left = _occupied_voxels(L, centre, grid, bricks, factors, seed, slab, slabs)
        while left:
            left, voxels = _lit_voxels(M, pulse, centre, weights, bricks, slab, left, alive)
            while voxels:
                at = int(lowest_bit(voxels))
                voxels &= voxels - np.uint64(1)
                slab_here = slab + at
                if slab_here > slabs:
                    left = np.uint64(0)
                    break
                lit = L.lit[at] & alive
                met = False
                if lit:
                    met = meet_leaves(
                        M,
                        pulse,
                        axes,
                        _voxel(centre, slab_here),
                        L.place[at],
                        weights,
                        L.hash[at],
                        lit,
                        L.code[at],
                    )
                if L.code[at] & GROUND:
                    met |= meet_ground(M.ground, pulse, centre.to_middle + f4(slab_here) * length, length)
                if met:
                    alive, slabs = _drop_ended(L, centre, n, alive, slab_here + 1, slabs)
        slab += AHEAD


@inline_kernel
def _floor(x: np.float32) -> int:
    """Round a number below 2**31 down; for float32 `math.floor` would be a function call."""
    truncated = np.int32(x)
    return int(truncated) - int(x < f4(truncated))


@inline_kernel
def _centre_ray(
    corner_m: tuple[np.float32, np.float32, np.float32], axis: F4, near_m: np.float32
) -> _CentreRay:
    main = 0
    for a in (1, 2):
        if abs(axis[3 + a]) > abs(axis[3 + main]):
            main = a
    second, third = (1, 2) if main == 0 else ((0, 2) if main == 1 else (0, 1))
    inverse = f4(1.0) / axis[3 + main]
    step = 1 if inverse > 0 else -1
    length = f4(VOXEL_M) * abs(inverse)
    along = axis[main] - corner_m[main]
    k = _floor((along + axis[3 + main] * near_m) * f4(1.0 / VOXEL_M))
    to_middle = ((f4(k) + f4(0.5)) * f4(VOXEL_M) - along) * inverse
    p1 = (axis[second] - corner_m[second] + axis[3 + second] * to_middle) * f4(1.0 / VOXEL_M)
    p2 = (axis[third] - corner_m[third] + axis[3 + third] * to_middle) * f4(1.0 / VOXEL_M)
    d1 = axis[3 + second] * length * f4(1.0 / VOXEL_M)
    d2 = axis[3 + third] * length * f4(1.0 / VOXEL_M)
    return _CentreRay(main, second, third, k, step, length, to_middle, p1, p2, d1, d2)


@inline_kernel
def _grid(M: Medium, axes: tuple[int, int, int]) -> _Grid:
    main, second, third = axes
    nx, ny, nz, _ = M.brick.shape
    size = (nx * BRICK, ny * BRICK, nz * BRICK)
    strides = (u4(ny * nz), u4(nz), u4(1))
    shifts = (u4(4), u4(2), u4(0))
    return _Grid(
        (size[main], size[second], size[third]),
        (strides[main], strides[second], strides[third]),
        (shifts[main], shifts[second], shifts[third]),
        (M.corner[main], M.corner[second], M.corner[third]),
    )


@inline_kernel
def _crossing(centre: _CentreRay, size: tuple[int, int, int]) -> tuple[np.float32, np.float32]:
    """Return the slabs at which the pulse enters and leaves the grid."""
    first, stop = f4(0.0), f4(1e6)
    n_main, n_second, n_third = size
    k = f4(centre.k) + f4(0.5)
    step = f4(centre.step)
    for at, change, voxels in (
        (k, step, n_main),
        (centre.p1, centre.d1, n_second),
        (centre.p2, centre.d2, n_third),
    ):
        if abs(change) < f4(1e-9):
            if not 0 <= at < voxels:
                stop = f4(-1.0)
            continue
        a, b = -at / change, (f4(voxels) - f4(1e-3) - at) / change  # minus a margin for rounding
        first, stop = max(first, min(a, b)), min(stop, max(a, b))
    return first, stop


@inline_kernel
def _voxel(centre: _CentreRay, slab: int) -> tuple[int, int, int]:
    at = f4(slab)
    return (
        centre.k + slab * centre.step,
        int(np.int32(centre.p1 + at * centre.d1)),
        int(np.int32(centre.p2 + at * centre.d2)),
    )


@inline_kernel
def _occupied_voxels(
    L: Lanes,
    centre: _CentreRay,
    grid: _Grid,
    bricks: U8,
    factors: tuple[np.uint32, np.uint32, np.uint32],
    seed: np.uint32,
    slab: int,
    slabs: int,
) -> np.uint64:
    """Find the voxels of the next slabs and hash their positions; return bits of those that are not empty."""
    place = L.place
    hashes = L.hash
    begin = f4(slab)
    k = f4(centre.k)
    step = f4(centre.step)
    p1 = centre.p1
    p2 = centre.p2
    d1 = centre.d1
    d2 = centre.d2
    s_main, s_one, s_two = grid.stride
    b_main, b_one, b_two = grid.shift
    c_main, c_one, c_two = grid.corner
    last = u4((bricks.shape[0] >> 1) - 1)
    for ahead in range(AHEAD):
        at = begin + _SLABS[ahead]
        i = np.int32(k + at * step)
        i1 = np.int32(p1 + at * d1)
        i2 = np.int32(p2 + at * d2)
        brick = u4(u4(i >> 2) * s_main) + u4(u4(i1 >> 2) * s_one) + u4(u4(i2 >> 2) * s_two)
        bit = u4(u4(i & 3) << b_main) | u4(u4(i1 & 3) << b_one) | u4(u4(i2 & 3) << b_two)
        place[ahead] = u4(min(u4(brick), last) << u4(6)) | bit
        hashes[ahead] = hash_of(
            u4(u4(i) + u4(c_main)), u4(u4(i1) + u4(c_one)), u4(u4(i2) + u4(c_two)), factors, seed
        )
    voxels = np.uint64(0)
    for ahead in range(AHEAD):
        pair = np.uint64(place[ahead] >> u4(6)) << np.uint64(1)
        place_in = np.uint64(place[ahead] & u4(63))
        voxels |= ((bricks[pair] >> place_in) & np.uint64(1)) << np.uint64(ahead)
    return voxels & ((np.uint64(1) << np.uint64(min(slabs - slab + 1, AHEAD))) - np.uint64(1))


@inline_kernel
def _lit_voxels(
    M: Medium,
    pulse: Pulse,
    centre: _CentreRay,
    weights: Weights,
    bricks: U8,
    slab: int,
    voxels: np.uint64,
    alive: np.uint64,
) -> tuple[np.uint64, np.uint64]:
    """Return bits of the voxels after the first `_FEW`, and of those among the first that lanes may hit.

    The loop has no branch, so that memory latency is paid once and the arithmetic of voxels overlaps; half of
    all rays end within the few.
    """
    L = pulse.lanes
    records = M.record
    axes = (centre.main, centre.second, centre.third)
    asked = np.uint64(0)
    few = voxels
    for _ in range(_FEW):  # in a loop of its own, so that the records of all are read at once
        if not voxels:
            break
        at = int(lowest_bit(voxels))
        voxels &= voxels - np.uint64(1)
        pair = np.uint64(L.place[at] >> u4(6)) << np.uint64(1)
        bit = np.uint64(L.place[at] & u4(63))
        before_it = bricks[pair] & ((np.uint64(1) << bit) - np.uint64(1))
        number = bricks[pair + np.uint64(1)] + count_bits(before_it)
        L.place[at] = u4(number)
        L.code[at] = records[number]
    few ^= voxels
    while few:
        at = int(lowest_bit(few))
        few &= few - np.uint64(1)
        code = L.code[at]
        lit = lit_lanes(pulse, axes, centre.k + (slab + at) * centre.step, code, L.hash[at], weights)
        lit &= alive
        L.lit[at] = lit
        asked |= np.uint64((lit | np.uint64(code & GROUND)) != 0) << np.uint64(at)
    return voxels, asked


@inline_kernel
def _drop_ended(
    L: Lanes, centre: _CentreRay, n: int, alive: np.uint64, slab: int, slabs: int
) -> tuple[np.uint64, int]:
    """Return the lanes that do not end before a slab, and the slab in which the last one ends."""
    passed_m = centre.to_middle + (f4(slab) - f4(0.5)) * centre.length
    range_m = L.range_m
    last_m = range_m[0]
    for lane in range(n):
        last_m = max(last_m, range_m[lane])
        if range_m[lane] < passed_m:
            alive &= ~(np.uint64(1) << np.uint64(lane))
    return alive, min(slabs, int((last_m - centre.to_middle) / centre.length + f4(1.5)))


@inline_kernel
def _set_up_lines(
    corner_m: tuple[np.float32, np.float32, np.float32],
    L: Lanes,
    n: int,
    near_m: np.float32,
    axes: tuple[int, int, int],
) -> tuple[np.uint64, np.float32]:
    """Set up the lanes' lines; return the lanes that go on from `near_m`, and the farthest range."""
    row = L.row
    if n == 1:
        _fill_lines(corner_m, row, L.line, 1, axes)
    else:
        _fill_lines(corner_m, row, L.line, LANES, axes)
    alive = np.uint64(0)
    last_m = f4(0.0)
    for lane in range(n):
        if row[RANGE + lane] > near_m:
            alive |= np.uint64(1) << np.uint64(lane)
            last_m = max(last_m, row[RANGE + lane])
    return alive, last_m


@inline_kernel
def _fill_lines(
    corner_m: tuple[np.float32, np.float32, np.float32],
    row: F4,
    line: F4,
    lanes: int,
    axes: tuple[int, int, int],
) -> None:
    (main, second, third) = axes
    scale = f4(LEAVES / VOXEL_M)
    along = LANES * main
    across = LANES * second
    up = LANES * third
    c_main = corner_m[main]
    c_second = corner_m[second]
    c_third = corner_m[third]
    for lane in range(lanes):
        inverse = f4(1.0) / row[DIRECTION + along + lane]
        begin = row[along + lane] - c_main
        d1 = row[DIRECTION + across + lane] * inverse * scale
        d2 = row[DIRECTION + up + lane] * inverse * scale
        line[lane] = (row[across + lane] - c_second) * scale - begin * d1
        line[LANES + lane] = d1
        line[2 * LANES + lane] = (row[up + lane] - c_third) * scale - begin * d2
        line[3 * LANES + lane] = d2
        line[4 * LANES + lane] = begin
        line[5 * LANES + lane] = inverse


@kernel
def _march_misses(passage: Passage, cast: Cast, todo: int, count: int, reach: np.float32) -> None:
    """Continue rays without a near hit through the medium, `reach` sigmas from the centre at most."""
    (medium, _, L, ahead, leaves) = passage
    light = cast.light
    if light.reach_m >= light.far_m:
        return
    batch = cast.batch
    row = batch.row
    surface = batch.surface
    near_m = f4(medium.near_m)
    own_row = L.row
    own_surface = L.surface
    bricks = medium.brick.reshape(-1)
    aside_m = np.float32(reach * max(light.sigmas[0], light.sigmas[1]))
    spread = np.float32(reach * max(light.sigmas[2], light.sigmas[3]))
    if todo == batch.missed.shape[0]:  # first round; later ones reuse the list for all pulses
        aside = max(light.sigmas[0], light.sigmas[1])
        wide = max(light.sigmas[2], light.sigmas[3])
        find_stems_ahead(
            medium.stems, ahead, batch.axes_row, medium.near_m, light.far_m, FARTHEST * aside, FARTHEST * wide
        )
    found = ZERO
    for t in range(todo):
        q = batch.todo[t]
        if not batch.missed[q]:
            continue
        for a in range(COSINE + LANES):
            own_row[a] = row[q, a]
        for lane in range(LANES):
            own_surface[lane] = surface[q, lane]
        march(medium, bricks, ahead, Pulse(L, count, near_m, batch.axes_row[q], aside_m, spread))
        for a in range(RANGE, COSINE + LANES):
            row[q, a] = own_row[a]
        for lane in range(LANES):
            surface[q, lane] = own_surface[lane]
        found = take_leaves(L, q, count, leaves, found)
    draw_owners(medium, leaves, found, row, surface)
