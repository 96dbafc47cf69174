"""Which pulses of a run are looked at: groups of firing sequences, drawn by strata of time, with all lasers."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlp16emu.pipeline import Cut
from vlp16emu.random import Purpose, generator

__all__ = ["GROUP", "Group", "draw_groups"]

GROUP = 8
"""Sequences of a group: an adaptive beam is judged among so many, and no others."""
_MOST_STRETCHES = 8
"""Of a long walk: each needs a window of the world of its own."""


@dataclass(frozen=True, slots=True)
class Group:
    """Consecutive firing sequences, cast as in a run: of a block, from a multiple of eight on."""

    first: int
    """Number of the first one."""
    count: int


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
        yield number, [Group(place * GROUP, GROUP) for place in places.tolist()]


def _one_of_each(draw: np.random.Generator, things: int, strata: int) -> NDArray[np.int64]:
    """Draw one of the numbers below `things` from each of some strata of nearly equal size."""
    edges = np.arange(strata + 1) * things // strata
    return draw.integers(edges[:-1], edges[1:])
