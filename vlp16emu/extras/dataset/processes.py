"""Walks made by this process or by worker processes of this machine."""

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, ProcessPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from pathlib import Path
from threading import Thread

from vlp16emu.cores import usable_cores
from vlp16emu.engine import in_one_world
from vlp16emu.errors import RunError
from vlp16emu.extras.dataset.spec import DatasetWalk
from vlp16emu.extras.dataset.walk import Made, make_walk

MOST_DEATHS = 4  # over one walk, as for Dask (distributed.scheduler.allowed-failures, 3, and one more)


def make_here(walks: Sequence[DatasetWalk], parts: Path, workers: int | None) -> Iterator[Made]:
    """Make walks in folders inside `parts`, and yield each when it is done.

    `workers` processes make them, by default one per core; with 0 this process. Each takes walks of one world
    as long as there are any, whose windows it keeps. A walk whose worker dies is made again by another;
    RunError if it happens too often to one walk.
    """
    if workers == 0:
        yield from (make_walk(walk, parts, threads=0) for walk in walks)
        return
    cores = usable_cores()
    count = max(min(workers or cores, len(walks)), 1)
    threads = max(cores // count, 1)
    queue = WorldQueue(walks)
    deaths = dict[int, int]()
    running = dict[Future[Made], tuple[ProcessPoolExecutor, DatasetWalk]]()

    def start(worker: ProcessPoolExecutor, after: DatasetWalk | None = None) -> None:
        """Start the next walk, if one is left, of a worker that has made `after`."""
        walk = queue.take(after)
        if walk is not None:
            running[worker.submit(make_walk, walk, parts, threads)] = worker, walk

    with ExitStack() as stack, _terminated_on_error():
        for _ in range(count):
            start(stack.enter_context(_new_worker()))
        while running:
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                worker, walk = running.pop(future)
                try:
                    made = future.result()
                except BrokenExecutor:
                    deaths[walk.number] = deaths.get(walk.number, 0) + 1
                    if deaths[walk.number] == MOST_DEATHS:
                        raise RunError(died_too_often(walk)) from None
                    queue.put_back(walk)
                    worker = stack.enter_context(_new_worker())
                else:
                    yield made
                start(worker, walk)


class WorldQueue:
    """Walks that are left to make, by the world in which walks that follow one another are."""

    def __init__(self, walks: Iterable[DatasetWalk]) -> None:
        self._worlds = list[deque[DatasetWalk]]()
        self._world_of = dict[int, int]()  # index of the world by the number of a walk
        self._begun = 0  # worlds before this one have been entered
        before: DatasetWalk | None = None
        for walk in walks:
            if before is None or not in_one_world(walk.scenario, before.scenario):
                self._worlds.append(deque())
            self._worlds[-1].append(walk)
            self._world_of[walk.number] = len(self._worlds) - 1
            before = walk

    def take(self, after: DatasetWalk | None) -> DatasetWalk | None:
        """Return the next walk for a worker that has made `after`; None if none is left.

        It is in the same world if one is left there, else in one that no worker has entered, else where most
        are left.
        """
        own = self._worlds[self._world_of[after.number]] if after else None
        if own:
            return own.popleft()
        if self._begun < len(self._worlds):
            self._begun += 1
            return self._worlds[self._begun - 1].popleft()
        most = max(self._worlds, key=len, default=None)
        return most.popleft() if most else None

    def put_back(self, walk: DatasetWalk) -> None:
        """Put a walk that was taken in front of those of its world."""
        self._worlds[self._world_of[walk.number]].appendleft(walk)


def died_too_often(walk: DatasetWalk) -> str:
    """Return the line for a walk over which workers die again and again."""
    return f"walk {walk.name}: {MOST_DEATHS} workers died over it; what is made so far is kept"


def _new_worker() -> ProcessPoolExecutor:
    """Return an executor of one process: with more, the death of one would end the walks of all."""
    return ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"), initializer=_start_worker)


@contextmanager
def _terminated_on_error() -> Iterator[None]:
    """Terminate the worker processes that the block has started if it raises."""
    others = set(multiprocessing.active_children())
    try:
        yield
    except BaseException:
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
        raise


def _start_worker() -> None:
    """Ignore Ctrl-C, which the parent process handles, and end with the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def end_with_parent() -> None:
        """Wait for the end of the parent process, and end this one."""
        if parent := multiprocessing.parent_process():
            parent.join()
            os._exit(1)

    Thread(target=end_with_parent, daemon=True).start()
