"""Work ahead: blocks of a run computed on several threads, handed out in order."""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

__all__ = ["BLOCK", "STRETCH", "ahead"]

BLOCK = 1_920
"""Firing sequences computed at once, 106 ms: whole packets in every return mode, whole packets of 8 rays."""
STRETCH = 64
"""Blocks that share a window of the world, 6.8 s or some 8 m of walking."""


S = TypeVar("S")
T = TypeVar("T")


def ahead(
    work: Callable[[int, Future[S]], T],
    open_stretch: Callable[[int], S],
    *,
    blocks: range,
    per_stretch: int | None,
    threads: int,
) -> Iterator[T]:
    """Yield the results of `work(block, scene of its stretch)` in order of blocks, a few computed ahead.

    The next stretch is opened from the middle of the present one on, and dropped when it is over.

    Parameters
    ----------
    work : called on a worker thread; the future may still be running
    open_stretch : called on a thread of its own
    blocks : numbers of the blocks, without gaps
    per_stretch : blocks that share a stretch; None where all do
    threads : workers
    """
    opened: dict[int, Future[S]] = {}
    pending: deque[Future[T]] = deque()
    last = (blocks.stop - 1) // per_stretch if per_stretch else 0
    with ThreadPoolExecutor(threads, "work") as workers, ThreadPoolExecutor(1, "open") as opener:
        try:
            for block in blocks:
                stretch = block // per_stretch if per_stretch else 0
                # Not at once: the first packet should not wait for the second window.
                soon = min((block + per_stretch // 2) // per_stretch, last) if per_stretch else 0
                for near in sorted({stretch, soon} - opened.keys()):
                    opened[near] = opener.submit(open_stretch, near)
                opened.pop(stretch - 1, None)
                pending.append(workers.submit(work, block, opened[stretch]))
                if len(pending) > 2 * threads:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            for waiting in pending:
                waiting.cancel()
            for window in opened.values():
                window.cancel()
