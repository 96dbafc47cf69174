"""Blocks side by side in arrays that windows share: what one has of another is neither copied nor kept twice."""

import weakref
from collections.abc import Iterable
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from vlp16emu.raycast.medium import Block

__all__ = ["Laid", "Shelf"]

T = TypeVar("T", bound=np.generic)
Name = tuple[int, int]
"""Of a tile."""


class Laid(NamedTuple):
    """A block on a shelf, whose parts are those of `Block`."""

    bottom: int
    mask: NDArray[np.uint64]
    stem: NDArray[np.uint64]
    first: NDArray[np.uint32]
    """Records in the array of the shelf."""
    records: slice
    """What it takes of the shelf."""
    owners: slice


class Shelf:
    """Blocks of all open windows."""

    def __init__(self) -> None:
        self.blocks = dict[Name, Laid]()
        self._record, self._first_owner = np.empty(0, np.uint32), np.empty(0, np.uint32)
        self._owner = np.empty(0, np.uint64)
        self._users = list[tuple[weakref.ref[object], frozenset[Name]]]()

    @property
    def arrays(self) -> tuple[NDArray[np.uint32], NDArray[np.uint32], NDArray[np.uint64]]:
        """Records, their first owners, and owners, up to the last that is of any block."""
        records = max((laid.records.stop for laid in self.blocks.values()), default=0)
        owners = max((laid.owners.stop for laid in self.blocks.values()), default=0)
        return self._record[:records], self._first_owner[:records], self._owner[:owners]

    def clear(self, wanted: Iterable[Name]) -> None:
        """Make room of blocks that are not wanted, and that no open window has."""
        self._users = [(user, names) for user, names in self._users if user() is not None]
        kept = frozenset(wanted).union(*(names for _, names in self._users))
        self.blocks = {name: laid for name, laid in self.blocks.items() if name in kept}

    def lay(self, name: Name, block: Block, most: int) -> None:
        """Lay a block down; arrays that are too small are replaced, so what is open keeps its own.

        Parameters
        ----------
        most : blocks that there will be, for which room is made
        """
        laid = self.blocks.values()
        records = _gap([each.records for each in laid], len(block.record))
        owners = _gap([each.owners for each in laid], len(block.owner))
        share = max(most / (len(laid) + 1), 1.0)
        self._record, self._first_owner = (
            _with_room(array, records.stop, share) for array in (self._record, self._first_owner)
        )
        self._owner = _with_room(self._owner, owners.stop, share)
        self._record[records], self._owner[owners] = block.record, block.owner
        np.add(block.first_owner, np.uint32(owners.start), out=self._first_owner[records])
        first = block.first + np.uint32(records.start)
        self.blocks[name] = Laid(block.bottom, block.mask.copy(), block.stem.copy(), first, records, owners)

    def keep(self, user: object, names: Iterable[Name]) -> None:
        """Keep blocks in their places for as long as there is somebody that uses them."""
        self._users.append((weakref.ref(user), frozenset(names)))


def _gap(taken: Iterable[slice], size: int) -> slice:
    """First place between those that are taken that is large enough."""
    begin = 0
    for each in sorted(taken, key=lambda each: each.start):
        if each.start - begin >= size:
            break
        begin = each.stop
    return slice(begin, begin + size)


def _with_room(array: NDArray[T], size: int, share: float) -> NDArray[T]:
    """Give an array of a size at least: the same, or one with half as much again as all blocks may need."""
    if len(array) >= size:
        return array
    larger = np.empty(int(1.5 * share * size), array.dtype)
    larger[: len(array)] = array
    return larger
