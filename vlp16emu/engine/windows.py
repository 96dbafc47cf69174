"""Windows of the world and blocks of a run, computed ahead on several threads and yielded in order."""

import logging
import math
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import groupby
from threading import Event
from typing import Any, Generic, Protocol, Self, TypeVar, runtime_checkable
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from vlp16emu.engine.build import Parts, Unit
from vlp16emu.raycast.caster import Caster, Geometry, caster
from vlp16emu.sensor.settings import Sensor
from vlp16emu.types import F8, Window

_log = logging.getLogger(__name__)  # at DEBUG it names each window that is opened
BLOCK = 1_920
"""Firing sequences of a VLP-16 computed at once, 106 ms: whole packets in every return mode, and a multiple
of 8 rays."""
STEP_NS = 2_654_208
"""Steps of a live run: 48 firing sequences of a VLP-16, two packets of single return, 40 in a block. A pose
waits for the next one, so longer steps are later, and shorter ones cost more."""
SEGMENT = 64  # blocks of a VLP-16 that share a window of the world, 6.8 s or some 8 m of walking

_RAYS = 8
_LONGEST_NS = 110_000_000
_SEGMENT_NS = 6_800_000_000
_POLL_S = 0.05  # interval at which a waiting thread checks whether the run ends
_LEAD = 3 / 8
_LAG = 1 / 4
"""Shares of a segment: lead time with which a window is opened, and greatest delay with which the sky over
the antenna is queried (1.4 s). Workers share the rest."""

_CASTERS: WeakValueDictionary[int, Caster] = WeakValueDictionary()
"""Casters of worlds in use, by the identity of the world: runs in one world share its geometry."""

S = TypeVar("S")
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Batching:
    """Sizes of the blocks and segments of a run: `BLOCK` and `SEGMENT` for a VLP-16.

    Blocks of other sensors have no more pulses and last no longer, and their rays are a multiple of 8.
    """

    lasers: int
    sequence_ns: int  # from one firing sequence to the next
    parts: int = 1  # parts of a block, for packets that do not wait for a whole block; they change no byte
    overhang_ns: int = 0  # longest time for which blocks of other sensors last beyond the end of a segment

    @classmethod
    def of(cls, units: Sequence[Unit]) -> dict[int, Self]:
        """Return the batchings of a run by the length of firing sequences; the first one has the segments.

        Sensors whose firing sequences are equally long have the blocks of the one with most lasers. For
        sensors with packets, blocks are cut into steps of a live run.
        """
        lasers = dict[int, int]()
        for unit in units:
            beams = unit.head.beams
            lasers[beams.sequence_ns] = max(lasers.get(beams.sequence_ns, 0), len(beams.elevation_deg))
        found = {sequence_ns: cls(most, sequence_ns) for sequence_ns, most in lasers.items()}
        _, *others = (batching.block_ns for batching in found.values())
        if isinstance(units[0].section, Sensor):
            found = {
                sequence_ns: replace(batching, parts=max(round(batching.block_ns / STEP_NS), 1))
                for sequence_ns, batching in found.items()
            }
        lead = next(iter(found))
        return found | {lead: replace(found[lead], overhang_ns=max(others, default=0))}

    @property
    def block(self) -> int:
        """Firing sequences of a block, or of a part of one."""
        greatest = min(16 * BLOCK // self.lasers, _LONGEST_NS // self.sequence_ns)
        return max(greatest // (_RAYS * self.parts), 1) * _RAYS

    @property
    def block_ns(self) -> int:
        """Duration of a block."""
        return self.block * self.sequence_ns

    @property
    def segment(self) -> int:
        """Blocks of a segment: whole ones, with all their parts."""
        return _SEGMENT_NS // (self.parts * self.block_ns) * self.parts

    def blocks(self, start_ns: int, stop_ns: int) -> range:
        """Blocks that cover a span of time since the first pulse."""
        return range(start_ns // self.block_ns, -(-stop_ns // self.block_ns))

    def edges_ns(self, segment: int) -> NDArray[np.int64]:
        """Edges (n,) of the whole blocks of a segment since the first pulse: begins, and the last end.

        If other sensors have other blocks, the end of the last one that begins in the segment is one too.
        """
        first, stop = segment * self.segment, (segment + 1) * self.segment
        edges_ns = np.arange(first, stop + 1, self.parts, dtype=np.int64) * self.block_ns
        return np.append(edges_ns, edges_ns[-1] + self.overhang_ns) if self.overhang_ns else edges_ns


class Windows(Generic[S]):
    """Windows of the world, each opened once while it is in use.

    Two are kept, for the present segment and the one before or after it; with very many threads, more.

    Parameters
    ----------
    open_segment : opens the window of a segment, or of another name that `name_of` gives; called on its own
        thread
    batching : sizes of blocks and segments
    moves : whether each segment needs its own window; if nothing moves, the window of segment 0 serves all
    threads : number of workers, which may be that many blocks ahead of the receiver
    prepare_thread : called at the begin of the thread that opens windows
    """

    kept = 2  # windows, with a few threads

    def __init__(
        self,
        open_segment: Callable[[Any], S],
        batching: Batching,
        *,
        moves: bool,
        threads: int,
        prepare_thread: Callable[[], None] | None = None,
    ) -> None:
        self._segment_ns = batching.segment * batching.block_ns
        self._moves = moves
        self._count_in(batching)
        opener = ThreadPoolExecutor(1, "open", prepare_thread)
        too_far = max(0, threads + 1 - self._free)

        @lru_cache(self.kept + math.ceil(too_far / batching.segment))
        def future_of(name: Hashable) -> Future[S]:
            """Begin to open the window of this name."""
            return opener.submit(open_segment, name)

        self._future_of = future_of
        self.stop = Event()  # never set; see `stopped_by`

    def _count_in(self, batching: Batching) -> None:
        """Take numbers of blocks as those of a batching."""
        self._block_ns = batching.block_ns
        self._free = int((1 - _LEAD - _LAG) * self._segment_ns / batching.block_ns)
        self._parts = batching.parts

    def in_blocks_of(self, batching: Batching) -> Self:
        """Return the same windows for blocks of another batching, each in the segment in which it begins."""
        windows = copy(self)
        windows._count_in(batching)  # noqa: SLF001  # of the same class
        return windows

    def stopped_by(self, stop: Event) -> Self:
        """Return the same windows for a run that stops waiting for results once `stop` is set."""
        windows = copy(self)
        windows.stop = stop
        return windows

    def wait(self, future: Future[T]) -> T:
        """Return the result of a future; `CancelledError` if the run is stopped first."""
        while not future.done():
            if self.stop.is_set():
                raise CancelledError
            with suppress(TimeoutError):
                return future.result(_POLL_S)
        return future.result()

    def name_of(self, block: int) -> Hashable:
        """Name of the window of a block: its segment."""
        return block * self._block_ns // self._segment_ns if self._moves else 0

    def at_block(self, block: int) -> Future[S]:
        """Window of a block."""
        return self._future_of(self.name_of(block))

    def at_time(self, since_ns: int) -> Future[S]:
        """Window of a time since the first pulse; before it, the first segment's, as nothing moves yet."""
        return self.at_block(max(since_ns, 0) // self._block_ns)

    def open_ahead(self, block: int, stop: int) -> None:
        """Begin to open the window that is needed a while after a block; a run ends before block `stop`."""
        lead = int(_LEAD * self._segment_ns / self._block_ns) if self._moves else 0
        self.at_block(min(block + lead, stop - 1))

    def runs(self, blocks: range, at_once: int, threads: int) -> Iterator[range]:
        """Cut blocks into runs of at most `at_once` whole blocks, each within one window.

        Runs are short at first, so that the first packet comes soon, and at the end, so that workers end
        together; they are also short enough that workers do not get too far ahead.
        """
        at_once = max(1, min(at_once * self._parts, self._free // (threads + 1)))
        first = blocks.start
        number = 0
        while first < blocks.stop:
            size = min(at_once, 2 ** (number // threads), max(1, (blocks.stop - first) // (2 * threads)))
            _, in_window = next(groupby(range(first, first + size), self.name_of))
            size = len(list(in_window))
            yield range(first, first + size)
            first = first + size
            number = number + 1


@contextmanager
def workers(threads: int, name: str, stop: Event | None = None) -> Iterator[ThreadPoolExecutor]:
    """Yield a pool of threads and wait for its end, unless `stop` is set or Ctrl-C is pressed."""
    pool = ThreadPoolExecutor(threads, name)
    try:
        yield pool
    except BaseException as error:
        is_over = isinstance(error, KeyboardInterrupt) or (stop is not None and stop.is_set())
        pool.shutdown(wait=not is_over, cancel_futures=True)
        raise
    pool.shutdown()


def in_order(
    work: Callable[[range, Future[S]], T],
    runs: Iterable[range],
    windows: Windows[S],
    *,
    threads: int,
    stop: int,
) -> Iterator[T]:
    """Yield the results of `work(run of blocks, its window)` in order; a few are computed ahead.

    Parameters
    ----------
    work : called on a worker thread; the future may still be running
    runs : runs of blocks without gaps, unless the windows leave blocks out
    threads : workers
    stop : number of the block after the last

    Raises CancelledError if the windows are stopped; unfinished work is abandoned.
    """
    pending: deque[Future[T]] = deque()
    with workers(threads, "work", windows.stop) as pool:
        for run in runs:
            pending.append(pool.submit(work, run, windows.at_block(run.start)))
            # Only now: the first packet should not wait for the second window.
            windows.open_ahead(run.stop - 1, stop)
            if len(pending) > threads:
                yield windows.wait(pending.popleft())
        while pending:
            yield windows.wait(pending.popleft())


def window_of(parts: Parts, start_ns: int, batching: Batching, segment: int) -> Window:
    """Return the window within reach of a segment of the walk; parameters as in `windows_of`."""
    edges_ns = start_ns + batching.edges_ns(segment)
    tracks_m = [unit.motion.poses_at(edges_ns).world_p_body_m for unit in parts.units]
    return window_around(parts, np.concatenate(tracks_m), edges_ns)


def window_around(parts: Parts, track_m: F8, edges_ns: NDArray[np.int64]) -> Window:
    """Return the window within reach of positions (n, 3); trees sway from the first instant to the last."""
    _log.debug("opens a window around %d positions", len(track_m))
    window = parts.world.window(track_m)
    if parts.wind is None:
        return window
    with_sway: Window = parts.wind.with_sway(window, track_m, int(edges_ns[0]), int(edges_ns[-1]))
    return with_sway


@runtime_checkable
class OwnWindows(Protocol):
    """A motion that opens its own windows, as its path is not known in advance."""

    def require_open(self) -> None:
        """Raise `TrajectoryError` if no poses arrive."""

    def windows(self, parts: Parts, start_ns: int, batching: Batching, threads: int) -> Windows[Geometry]:
        """Return the windows of a run; parameters as in `windows_of`."""


def windows_of(parts: Parts, start_ns: int, batching: Batching, threads: int) -> Windows[Geometry]:
    """Return the windows of a run, shared by all units; if nothing moves, one window serves all segments.

    Parameters
    ----------
    start_ns : UTC of the first pulse
    batching : sizes of blocks and segments
    threads : number of workers per unit
    """
    if isinstance(parts.carrier, OwnWindows):
        return parts.carrier.windows(parts, start_ns, batching, threads)
    built = _CASTERS.get(id(parts.world)) or caster(parts.world, ThreadPoolExecutor(threads, "build"))
    _CASTERS[id(parts.world)] = built

    def open_segment(segment: int) -> Geometry:
        """Open the window of a segment, with the people in it."""
        geometry = built.open(window_of(parts, start_ns, batching, segment))
        return parts.people.among(geometry) if parts.people else geometry

    return Windows(open_segment, batching, moves=parts.moves, threads=threads)
