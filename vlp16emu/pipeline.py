"""Work ahead: windows of the world and blocks of a run on several threads, handed out in order."""

import math
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

__all__ = ["BLOCK", "STRETCH", "Cut", "Windows", "ahead"]

BLOCK = 1_920
"""Firing sequences of a VLP-16 computed at once, 106 ms: whole packets in every return mode, and of 8 rays."""
STRETCH = 64
"""Blocks of a VLP-16 that share a window of the world, 6.8 s or some 8 m of walking."""

_RAYS = 8
_PULSES = 16 * BLOCK
_LONGEST_NS = 110_000_000
_STRETCH_NS = 6_800_000_000
_LEAD, _LAG = 3 / 8, 1 / 4
"""Shares of a stretch: how long before its use a window is opened, and how far behind the present the sky over the antenna
is asked for, at most (1.4 s). Workers share the rest."""

S = TypeVar("S")
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Cut:
    """How the run of a sensor is cut: a VLP-16's into blocks of `BLOCK` and stretches of `STRETCH`.

    Blocks of other sensors have no more pulses than that and last no longer, but have whole packets of 8 rays.
    """

    lasers: int
    sequence_ns: int
    """From one firing sequence to the next."""

    @property
    def block(self) -> int:
        """Firing sequences of a block."""
        most = min(_PULSES // self.lasers, _LONGEST_NS // self.sequence_ns)
        return max(most // _RAYS, 1) * _RAYS

    @property
    def block_ns(self) -> int:
        """How long a block lasts."""
        return self.block * self.sequence_ns

    @property
    def stretch(self) -> int:
        """Blocks of a stretch."""
        return _STRETCH_NS // self.block_ns

    def blocks(self, start_ns: int, stop_ns: int) -> range:
        """Blocks that together hold a span of time since the first pulse."""
        return range(start_ns // self.block_ns, -(-stop_ns // self.block_ns))

    def edges_ns(self, stretch: int) -> NDArray[np.int64]:
        """(n,) times since the first pulse at which the blocks of a stretch begin, and the last one ends."""
        edges = np.arange(stretch * self.stretch, (stretch + 1) * self.stretch + 1, dtype=np.int64)
        return edges * self.block_ns


class Windows(Generic[S]):
    """The world in windows, each opened once as long as it is in use, whoever asks for it.

    Two are kept: the one of the present stretch and the one before or after it; with very many threads more.

    Parameters
    ----------
    open_stretch : opens the window of a stretch; called on a thread of its own
    cut : of the run
    moves : whether each stretch needs a window; where nothing moves that of stretch 0 serves all
    threads : workers, which may be that many blocks ahead of whoever else asks
    """

    def __init__(self, open_stretch: Callable[[int], S], cut: Cut, *, moves: bool, threads: int) -> None:
        self._block_ns, self._per_stretch = cut.block_ns, cut.stretch if moves else None
        self._free = int((1 - _LEAD - _LAG) * cut.stretch)
        opener, too_far = ThreadPoolExecutor(1, "open"), max(0, threads + 1 - self._free)

        @lru_cache(2 + math.ceil(too_far / cut.stretch))
        def opened(stretch: int) -> Future[S]:
            """Open a stretch once, on the opener."""
            return opener.submit(open_stretch, stretch)

        self._opened = opened

    def at_block(self, block: int) -> Future[S]:
        """Window of a block."""
        return self._opened(block // self._per_stretch if self._per_stretch else 0)

    def at_time(self, since_ns: int) -> Future[S]:
        """Window of a time since the first pulse; before it that of the first stretch, for nobody moves yet."""
        return self.at_block(max(since_ns, 0) // self._block_ns)

    @property
    def lead(self) -> int:
        """Blocks between the opening of a window and its use."""
        return int(_LEAD * self._per_stretch) if self._per_stretch else 0

    def runs(self, blocks: range, together: int, threads: int) -> Iterator[range]:
        """Cut blocks into runs of up to so many `together`, each within one stretch.

        They are short at first, so that the first packet comes soon, and at last, so that workers end together; and
        so short that workers do not get too far ahead.
        """
        together = max(1, min(together, self._free // (threads + 1)))
        first, number = blocks.start, 0
        while first < blocks.stop:
            size = min(together, 2 ** (number // threads), max(1, (blocks.stop - first) // (2 * threads)))
            if self._per_stretch:
                size = min(size, self._per_stretch - first % self._per_stretch)
            yield range(first, first + size)
            first, number = first + size, number + 1


def ahead(
    work: Callable[[range, Future[S]], T],
    windows: Windows[S],
    *,
    blocks: range,
    threads: int,
    together: int,
) -> Iterator[T]:
    """Yield the results of `work(run of blocks, window of their stretch)` in order of blocks, a few computed ahead.

    Parameters
    ----------
    work : called on a worker thread; the future may still be running
    blocks : numbers of the blocks, without gaps
    threads : workers
    together : blocks of a run at most
    """
    pending: deque[Future[T]] = deque()
    with ThreadPoolExecutor(threads, "work") as workers:
        try:
            for run in windows.runs(blocks, together, threads):
                pending.append(workers.submit(work, run, windows.at_block(run.start)))
                # Now and not at once: the first packet should not wait for the second window.
                windows.at_block(min(run.stop - 1 + windows.lead, blocks.stop - 1))
                if len(pending) > threads:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            for waiting in pending:
                waiting.cancel()
