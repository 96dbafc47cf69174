"""Which pulses of a run are looked at: groups of firing sequences, drawn by strata of time, with all lasers."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlp16emu.pipeline import Cut
from vlp16emu.random import Purpose, generator

__all__ = ["GROUP", "Group", "draw_groups"]

GROUP = 8
"""Sequences of a group: what is cast at once."""
_MOST_STRETCHES = 8
"""Of a long walk: each needs a window of the world of its own."""


@dataclass(frozen=True, slots=True)
class Group:
    """Consecutive firing sequences of a block."""

    first: int
    """Number of the first one that is cast: with neighbours on either side, on which an adaptive beam depends."""
    count: int
    """How many are cast."""
    own: slice
    """Which of those are looked at."""


def draw_groups(
    cut: Cut, blocks: int, pulses: int, seed: int, *, moves: bool
) -> Iterator[tuple[int, list[Group]]]:
    """Draw groups of the first blocks of a run, by stretches that share a window of the world.

    Parameters
    ----------
    cut : of the run
    blocks : in the run
    pulses : looked at in all, rounded up
    moves : whether each stretch has a window of its own; else one serves all

    Yields
    ------
    Number of a stretch, and its groups in order of time.
    """
    draw = generator(seed, Purpose.AUDIT, -1)
    per_block, stretch = cut.block // GROUP, cut.stretch if moves else blocks
    stretches = -(-blocks // stretch)
    chosen = _one_of_each(draw, stretches, min(_MOST_STRETCHES, stretches))
    most = -(-pulses // (GROUP * cut.lasers * len(chosen)))
    for number in chosen.tolist():
        first, stop = number * stretch * per_block, min((number + 1) * stretch, blocks) * per_block
        places = first + _one_of_each(draw, stop - first, min(most, stop - first))
        yield number, [_group(place, per_block) for place in places.tolist()]


def _one_of_each(draw: np.random.Generator, things: int, strata: int) -> NDArray[np.int64]:
    """Draw one of the numbers below `things` from each of some strata of nearly equal size."""
    edges = np.arange(strata + 1) * things // strata
    return draw.integers(edges[:-1], edges[1:])


def _group(place: int, per_block: int) -> Group:
    """Make the group of eight number `place` of the run, with an eight on either side in its block."""
    at = place % per_block
    before, after = min(at, 1), min(per_block - 1 - at, 1)
    return Group(
        first=(place - before) * GROUP,
        count=(1 + before + after) * GROUP,
        own=slice(before * GROUP, (before + 1) * GROUP),
    )
