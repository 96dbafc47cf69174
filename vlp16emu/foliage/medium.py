"""Far foliage: voxels of 0.5 m with the leaf and wood area of the shapes that stand there.

A shape with many faces is measured once: its projected area in cells of 0.25 m (`Cloud`). Placements add
these areas, or single faces of shapes with few faces, to the voxels of a tile of the world (`Block`); tiles
make up the medium of a window (`vlp16emu.foliage.lanes`). A block depends on its tile and the neighbouring
tiles alone, so blocks are kept from window to window.

A `Shelf` holds blocks side by side in arrays that windows share, so that no block is copied or stored twice.
"""

import math
import weakref
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from vlp16emu.foliage.cloud import PROJECTION, Library
from vlp16emu.foliage.filling import fill_block
from vlp16emu.foliage.stems import stem_lines
from vlp16emu.foliage.tiles import FarTile
from vlp16emu.foliage.voxel import BRICK, COLUMNS, LAW_BIT, LAW_MASK, VOXEL_M
from vlp16emu.trees import Tree
from vlp16emu.types import F8, I8, U4, U8

T = TypeVar("T", bound=np.generic)
Name = tuple[int, int]  # name of a tile


@dataclass(frozen=True, slots=True)
class Block:
    """The voxels of a tile, in bricks of 4 x 4 x 4."""

    bottom: int  # level of the lowest bricks, in bricks from a height of 0
    mask: U8  # (10, 10, n) mask of the occupied voxels of each brick: bit 16 x + 4 y + z
    first: U4  # (10, 10, n) record of the first occupied voxel
    record: U4  # (m,) codes of projected area at the three knots, flag of the ground, and kind of foliage
    first_owner: U4  # (m,) first owner of each record; the last owner has a share of 255
    owner: U8
    """(o,) bit fields: row of a tile's surfaces; from `LAW_BIT` the law in the library; from `TILE_BIT` 3 (dx
    + 1) + dy + 1 for that tile; from `SHARE_BIT` the cumulative share of the voxel's projected area up to
    this owner, in 255ths."""


def block_of(
    library: Library, shape_of: dict[object, int], near: dict[Name, FarTile], ix: int, iy: int
) -> Block:
    """Make the block of a tile.

    Parameters
    ----------
    shape_of : index in the library by shape
    near : tiles, at least (ix, iy) itself and the eight around it, whose shapes may reach into it
    """
    tile_here = near[ix, iy]
    corner_m = near[ix, iy].corner_m
    around = [(3 * (dx + 1) + dy + 1, near[ix + dx, iy + dy]) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
    parts = zip(
        *(_placements_near(library, shape_of, tile, number, corner_m) for number, tile in around), strict=True
    )
    shape, world_T_shape, first_surface, number = (np.concatenate(part) for part in parts)
    placed = shape, world_T_shape, first_surface, number
    stems = np.concatenate([tile.stems for _, tile in around])
    ground_m = tile_here.ground_m - corner_m[2]
    lines = stem_lines(stems, corner_m)
    brick_m = BRICK * VOXEL_M
    top_m = placed[1][:, 2, 3] + library.radius_m[placed[0]] * stretch_of(placed[1])
    low_m = min(ground_m.min() - 1.5, lines[:, 2].min(initial=np.inf) - 0.5)
    high_m = max(
        ground_m.max() + 1.0,
        *(ends.max(initial=-np.inf) for ends in (top_m, lines[:, 2] + lines[:, 5] + 0.5)),
    )
    bottom = math.floor(low_m / brick_m)
    levels = math.ceil(high_m / brick_m) - math.floor(low_m / brick_m)
    ground_and_size = ground_m.astype(np.float32), bottom * brick_m, max(levels, 1), PROJECTION
    return Block(bottom + round(corner_m[2] / brick_m), *fill_block(library, placed, *ground_and_size))


def _placements_near(
    library: Library, shape_of: dict[object, int], tile: FarTile, number: int, corner_m: F8
) -> tuple[I8, F8, I8, I8]:
    """Select the placements of a tile that may reach into the tile at `corner_m`, for `fill_block`."""
    places = np.array([shape_of[key] for key in tile.keys], np.int64)
    shape = places[tile.shape] if len(tile.shape) else np.zeros(0, np.int64)
    world_T = tile.world_T_shape
    at_m = world_T[:, :, 3] - corner_m
    reach_m = library.radius_m[shape] * stretch_of(world_T)
    gap_m = np.maximum(np.maximum(-at_m[:, :2], at_m[:, :2] - COLUMNS * VOXEL_M), 0.0)
    near = np.flatnonzero((np.square(gap_m)).sum(axis=1) <= np.square(reach_m))
    relative = world_T[near].copy()
    relative[:, :, 3] = at_m[near]
    return shape[near], relative, tile.first_surface[near], np.full(len(near), number)


def stretch_of(world_T_shape: F8) -> F8:
    """Return the greatest scale (n,) along an axis of placements (n, 3, 4)."""
    stretch: F8 = np.sqrt(np.square(world_T_shape[:, :, :3]).sum(axis=1).max(axis=-1, initial=0.0))
    return stretch


def pack_block(block: Block, library: Library, names: Sequence[str]) -> Tree:
    """Return the fields of a block, with laws by the names of shapes, as each library has its own order."""
    laws, law = np.unique((block.owner >> LAW_BIT) & LAW_MASK, return_inverse=True)
    shape = np.searchsorted(library.first_law, laws.astype(np.int64), side="right") - 1
    used, law_shape = np.unique(shape, return_inverse=True)
    return {
        **{field.name: getattr(block, field.name) for field in fields(block)},
        "owner": _with_law(block.owner, law),
        "law_shape": law_shape,
        "law_mesh": laws.astype(np.int64) - library.first_law[shape],
        "shapes": [names[i] for i in used.tolist()],
    }


def unpack_block(kept: Tree, library: Library, place: Mapping[str, int]) -> Block:
    """Return the block from packed fields, for a library whose shapes have these indices by name."""
    shapes = np.array([place[name] for name in kept.pop("shapes")], np.int64)
    law = library.first_law[shapes[kept.pop("law_shape")]] + kept.pop("law_mesh")
    kept["owner"] = _with_law(kept["owner"], law[(kept["owner"] >> LAW_BIT) & LAW_MASK])
    return Block(**kept)


def _with_law(owner: U8, law: I8) -> U8:
    return (owner & ~(LAW_MASK << LAW_BIT)) | (law.astype(np.uint64) << LAW_BIT)


class ShelfEntry(NamedTuple):
    """A block on a shelf, with parts as in `Block`."""

    bottom: int
    mask: U8
    first: U4  # records in the array of the shelf
    records: slice  # position of its records on the shelf
    owners: slice


class Shelf:
    """Blocks of all open windows."""

    def __init__(self) -> None:
        self.blocks = dict[Name, ShelfEntry]()
        self._record = np.empty(0, np.uint32)
        self._first_owner = np.empty(0, np.uint32)
        self._owner = np.empty(0, np.uint64)
        self._users = list[tuple[weakref.ref[object], frozenset[Name]]]()

    @property
    def arrays(self) -> tuple[U4, U4, U8]:
        """Records, their first owners, and owners, up to the end of the last block."""
        records = max((entry.records.stop for entry in self.blocks.values()), default=0)
        owners = max((entry.owners.stop for entry in self.blocks.values()), default=0)
        return self._record[:records], self._first_owner[:records], self._owner[:owners]

    def clear(self, wanted: Iterable[Name]) -> None:
        """Remove blocks that are neither wanted nor used by an open window."""
        self._users = [(user, names) for user, names in self._users if user() is not None]
        kept = frozenset(wanted).union(*(names for _, names in self._users))
        self.blocks = {name: entry for name, entry in self.blocks.items() if name in kept}

    def put(self, name: Name, block: Block, expected: int) -> None:
        """Put a block on the shelf; arrays that are too small are replaced, but open windows keep theirs.

        Parameters
        ----------
        expected : expected number of blocks, for which room is made
        """
        entries = self.blocks.values()
        records = _gap([entry.records for entry in entries], len(block.record))
        owners = _gap([entry.owners for entry in entries], len(block.owner))
        share = max(expected / (len(entries) + 1), 1.0)
        self._record, self._first_owner = (
            _with_capacity(array, records.stop, share) for array in (self._record, self._first_owner)
        )
        self._owner = _with_capacity(self._owner, owners.stop, share)
        self._record[records] = block.record
        self._owner[owners] = block.owner
        np.add(block.first_owner, np.uint32(owners.start), out=self._first_owner[records])
        first = block.first + np.uint32(records.start)
        self.blocks[name] = ShelfEntry(block.bottom, block.mask.copy(), first, records, owners)

    def keep(self, user: object, names: Iterable[Name]) -> None:
        """Keep blocks in place as long as `user` exists."""
        self._users.append((weakref.ref(user), frozenset(names)))


def _gap(occupied: Iterable[slice], size: int) -> slice:
    """Return the first gap of a size between occupied slices."""
    begin = 0
    for part in sorted(occupied, key=lambda part: part.start):
        if part.start - begin >= size:
            break
        begin = max(begin, part.stop)  # an empty one may stand at the begin of another
    return slice(begin, begin + size)


def _with_capacity(array: NDArray[T], size: int, share: float) -> NDArray[T]:
    """Return `array` if it has `size` elements, or else one half larger than all blocks may need."""
    if len(array) >= size:
        return array
    larger = np.empty(int(1.5 * share * size), array.dtype)
    larger[: len(array)] = array
    return larger
