"""Blocks that windows share."""

from dataclasses import replace

import numpy as np
import pytest

from vlp16emu.foliage.medium import Block, Shelf


def block(number, records, owners):
    """Make a block whose numbers are its own; each record but the first has one owner, and that has the rest."""
    return Block(
        bottom=number,
        mask=np.full((10, 10, 1), number, np.uint64),
        first=np.arange(100, dtype=np.uint32).reshape(10, 10, 1) % np.uint32(records),
        record=np.full(records, number, np.uint32),
        first_owner=np.arange(records, dtype=np.uint32),
        owner=np.arange(owners, dtype=np.uint64) + np.uint64(1000 * number),
    )


class User:
    """Somebody who uses blocks."""


def found(shelf, name, arrays):
    """Read a block from arrays of a shelf."""
    laid, (record, first_owner, owner) = shelf.blocks[name], arrays
    shift = laid.records.start
    return Block(
        laid.bottom,
        laid.mask,
        laid.first - np.uint32(shift),
        record[laid.records],
        first_owner[laid.records] - np.uint32(laid.owners.start),
        owner[laid.owners],
    )


def same(one, other):
    """Whether two blocks are the same."""
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in Block.__slots__)


@pytest.fixture
def shelf():
    return Shelf()


def test_what_is_open_keeps_its_blocks_whatever_comes_and_goes(shelf):
    """Blocks of the last two of many windows are as they were made, in the arrays that each window got when it opened."""
    rng, open_windows = np.random.default_rng(3), []
    for start in range(60):
        names = [(start + i, 0) for i in range(6)]
        shelf.clear(names)
        for name in names:
            if name not in shelf.blocks:
                shelf.lay(name, block(name[0], *rng.integers(2, 400, 2).tolist()), len(names))
        laid = {name: found(shelf, name, shelf.arrays) for name in names}
        kept = {
            name: replace(each, **{n: getattr(each, n).copy() for n in Block.__slots__[1:]})
            for name, each in laid.items()
        }
        user = User()
        shelf.keep(user, names)
        open_windows = [*open_windows[-1:], (user, names, shelf.arrays, kept)]
        for _, others, arrays, before in open_windows:
            assert all(same(found(shelf, name, arrays), before[name]) for name in others)
            assert all((before[name].record == name[0]).all() for name in others)


def test_room_of_blocks_that_nobody_uses_is_used_again(shelf):
    """A walk past 200 tiles, of which five are seen at once, takes no more room than three times those."""
    user = None
    for start in range(200):
        names = [(start + i, 0) for i in range(5)]
        shelf.clear(names)
        for name in names:
            if name not in shelf.blocks:
                shelf.lay(name, block(name[0], 90 + 10 * (name[0] % 3), 50), len(names))
        user = User()
        shelf.keep(user, names)
    assert user is not None
    assert len(shelf.arrays[0]) <= 3 * 5 * 110
