"""Windows of a run whose path is not known in advance.

The bytes of a pulse depend on the window that it is cast in, through rounding. So windows belong to cubes of
the world, and the window of a block follows from the places of the body before the block alone: a recorded
flight has the windows of the flight. Which windows are opened ahead follows from where the body would be if
it flew on as it does; a wrong guess costs time, but changes no byte.
"""

import math
import os
import sys
import threading
import time
import weakref
from collections.abc import Callable, Hashable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from itertools import repeat
from typing import TYPE_CHECKING, NamedTuple, ParamSpec, Protocol, Self, TypeVar, runtime_checkable

import numpy as np

from vlp16emu.elementary import atan2, cos, norm, sin
from vlp16emu.engine import Parts
from vlp16emu.engine.windows import Batching, Windows, window_around
from vlp16emu.motion.pose import Motion
from vlp16emu.raycast.caster import Geometry, caster
from vlp16emu.types import F8, I8
from vlp16emu.units import S_NS

if TYPE_CHECKING:
    from vlp16emu.extras.live.motion import LiveMotion

_EDGE_M = 16.0  # of a cube
_ASIDE_M = 8.0  # margin around its cube in which a window is valid
_APART_M = 2.0
"""Distance between the lines that a window is opened along: each place is within the 1 m that the medium
allows for."""
_BEFORE_NS = 4 * S_NS
"""Time for which the body has been in the next cube before its window is used: less for bodies that leave the
margin earlier, 2 s at 3 m/s."""
_AHEAD_NS = 6 * S_NS
"""Time ahead of its use at which a window is opened. A new cube takes 1.2 s of one core, 4.3 s at the
priority of its threads beside other programs; at 3 m/s the body flies a whole cube in 6 s, and guesses for
longer are often wrong."""
_TURN_NS = S_NS // 4  # time over which the rate of turn is measured
_LOOK = 5  # ordinary blocks, 0.5 s, between those ahead whose windows are looked up
_KNOWN_NS = 200_000_000
"""Time before a block at which the place of the body is known when the block is submitted."""
_SPARE_M = 1.0
_SPARE_S = 0.35  # from that time to the end of a block
"""Margin that is left for the path of the body until the end of the block, at its speed."""
_MOST_LATE_NS = 32_000_000
"""Delay beyond which all late steps are left out: receivers need recent packets."""
_NICE = 10
"""Niceness of threads that open windows of a live run above the casting threads, which then get nine tenths
of a core. With 3, every other step is late while a window is opened."""


_EARLY = 1
"""Steps before its begin by which a step must be submitted, else it is late; usually it is submitted three
before."""
_REST_S = 0.05
"""Longest time for which a part of a window, 5 to 90 ms of work, gives way to late steps: a machine that is
late on the whole opens windows too."""
_NAP_S = 0.002  # interval at which it looks whether they still are

P = ParamSpec("P")
T = TypeVar("T")

ASIDE_M = 100.0
"""Distance around a pose in which a world must have windows: a cube and its margin, and the way that a body
coasts."""


@runtime_checkable
class Bounded(Protocol):
    """A world that ends somewhere."""

    def reaches(self, place_m: F8, aside_m: float) -> bool:
        """Return True if windows up to `aside_m` around a place (3,) can be opened."""


class Cube(NamedTuple):
    """A cube of the world, for whose sensors a window is opened."""

    x: int
    y: int
    z: int

    @classmethod
    def containing(cls, place_m: F8) -> Self:
        """Return the cube that contains a place (3,)."""
        return cls(*np.floor(place_m / _EDGE_M).astype(int).tolist())

    def serves(self, place_m: F8, speed_m_s: float) -> bool:
        """Return True if its window is valid until the end of the block for a body at a place (3,) before."""
        middle_m = (np.array(self) + 0.5) * _EDGE_M
        spare_m = _SPARE_M + _SPARE_S * speed_m_s
        return bool((np.abs(place_m - middle_m) <= _EDGE_M / 2 + _ASIDE_M - spare_m).all())

    def track_m(self, arm_m: float) -> F8:
        """Return positions (n, 3) all over cube and margin, for sensors up to `arm_m` from the body."""
        aside_m = _ASIDE_M + arm_m
        wide_m = _EDGE_M + 2 * aside_m
        low_m = np.array(self) * _EDGE_M - aside_m
        lines = 1 + math.ceil(wide_m / _APART_M)
        x_m = np.repeat(np.arange(lines), 2) * _APART_M
        # Up one line and down the next one, at the lowest and the highest places in turn.
        y_m = np.resize([0.0, wide_m, wide_m, 0.0], 2 * lines)
        z_m = np.resize([0.0, wide_m], 2 * lines)
        return low_m + np.column_stack([x_m, y_m, z_m])


_FAR_BLOCK = 1 << 40  # a block that no run reaches
_STRAIGHT_RAD = 1e-15  # half of a turn that no window shows


class Course(NamedTuple):
    """Course of a body that flies on as it does: at constant speed, and at a constant rate of turn."""

    place_m: F8  # (3,)
    velocity_m_s: F8  # (3,)
    turn_rad_s: float  # counter-clockwise as seen from above

    @classmethod
    def of(cls, motion: Motion, t_ns: int) -> Self:
        """Return the course of a motion at a UTC instant, from its places until then."""
        flown = motion.kinematics_at(np.array([t_ns - _TURN_NS, t_ns]))
        (x_before, y_before, _), (x, y, _) = flown.world_v_body_m_s
        turned_rad = float(atan2(x_before * y - y_before * x, x_before * x + y_before * y))
        return cls(flown.world_p_body_m[1], flown.world_v_body_m_s[1], turned_rad / _TURN_NS * S_NS)

    @property
    def speed_m_s(self) -> float:
        """Speed of the body."""
        return float(norm(self.velocity_m_s))

    def onwards_m(self, after_ns: I8) -> F8:
        """Return displacements (n, 3) after times (n,)."""
        after_s = after_ns[:, None] / S_NS
        x, y, z = self.velocity_m_s
        half_rad = 0.5 * self.turn_rad_s * after_s
        half_rad = np.where(np.abs(half_rad) < _STRAIGHT_RAD, _STRAIGHT_RAD, half_rad)
        chord_s = after_s * sin(half_rad) / half_rad
        ahead_s = chord_s * cos(half_rad)
        aside_s = chord_s * sin(half_rad)
        return ahead_s * [x, y, 0.0] + aside_s * [-y, x, 0.0] + after_s * [0.0, 0.0, z]


class CubeWindows(Windows[Geometry]):
    """The world in windows of cubes; parameters as in `windows_of`, and the motion of the body.

    `builders` runs the parts of building a window.
    """

    kept = 6
    ahead = 4  # windows of them that are opened ahead; others serve the present and the sky of a moment ago

    def __init__(
        self,
        parts: Parts,
        start_ns: int,
        batching: Batching,
        threads: int,
        motion: Motion,
        *,
        builders: Executor,
        prepare_thread: Callable[[], None] | None = None,
    ) -> None:
        built = caster(parts.world, builders)
        arm_m = max(float(norm(np.array(unit.mount.lever_arm_m))) for unit in parts.units)

        def open_window(name: tuple[Cube, int]) -> Geometry:
            """Open the window of a cube, at a segment of time if trees sway."""
            cube, segment = name
            edges_ns = start_ns + batching.edges_ns(segment)
            return built.open(window_around(parts, cube.track_m(arm_m), edges_ns))

        super().__init__(open_window, batching, moves=True, threads=threads, prepare_thread=prepare_thread)
        self._start_ns = start_ns
        self._motion = motion
        self._sways = parts.wind is not None  # time counts if trees sway
        self._looked_ns = 0
        self._named: tuple[int, Hashable] = (start_ns, None)  # begin of an ordinary block, and its name
        self._guess: Future[Geometry] | None = None  # window that was last opened ahead

    def name_of(self, block: int) -> Hashable:
        """Return the name of the window of a block: its cube, and its segment of time if trees sway.

        The cube is that of the body some seconds before, as long as its window serves.
        """
        begin_ns = self._begin_ns(block)
        named_ns, named = self._named
        # The first block is named anew: its body may still be somewhere else.
        if begin_ns == named_ns > self._start_ns:
            return named
        known = self._motion.kinematics_at(np.array([begin_ns - _BEFORE_NS, begin_ns - _KNOWN_NS]))
        before_m, place_m = known.world_p_body_m
        name = self._window_name(block, before_m, place_m, float(norm(known.world_v_body_m_s[1])))
        self._named = begin_ns, name
        return name

    def open_ahead(self, block: int, stop: int) -> None:
        """Begin to open the next window that the body needs if it flies on as it does.

        Only one is begun before it is needed, so that the body never waits for more than one wrong guess.
        """
        begin_ns = self._begin_ns(block)
        if begin_ns == self._looked_ns:  # names change at ordinary blocks only
            return
        self._looked_ns = begin_ns
        if self._guess is not None and not self._guess.done():
            return
        for name in self.expected(block, stop)[: self.ahead]:
            self._guess = self._future_of(name)
            if not self._guess.done():
                return

    def expected(self, block: int, stop: int) -> list[Hashable]:
        """Return the names of the windows that the body needs next if it flies on as it does, nearest first.

        Parameters
        ----------
        block : block whose poses are known
        stop : number of the block after the last of the run
        """
        begin_ns = self._begin_ns(block)
        known_ns = begin_ns - _KNOWN_NS
        first = block // self._parts * self._parts
        blocks = np.arange(first, min(first + _AHEAD_NS // self._block_ns + 1, stop), _LOOK * self._parts)
        places_ns = known_ns + (blocks - first) * self._block_ns
        befores_ns = places_ns + _KNOWN_NS - _BEFORE_NS
        flown = self._motion.kinematics_at(np.minimum(befores_ns, known_ns))
        course = self.course(known_ns)
        befores_m = flown.world_p_body_m + course.onwards_m(np.maximum(befores_ns - known_ns, 0))
        places_m = course.place_m + course.onwards_m(places_ns - known_ns)
        names = map(self._window_name, blocks.tolist(), befores_m, places_m, repeat(course.speed_m_s))
        return list(dict.fromkeys(names))

    def course(self, t_ns: int) -> Course:
        """Return the course of the body at a UTC instant."""
        return Course.of(self._motion, t_ns)

    def _begin_ns(self, block: int) -> int:
        """UTC at which the ordinary block begins that a block is part of."""
        return self._start_ns + block // self._parts * self._parts * self._block_ns

    def _window_name(self, block: int, before_m: F8, place_m: F8, speed_m_s: float) -> tuple[Cube, int]:
        """Name the window of a block for a body that is at `place_m` and was at `before_m`, both (3,)."""
        cube = Cube.containing(before_m)
        if not cube.serves(place_m, speed_m_s):
            cube = Cube.containing(place_m)
        return cube, block * self._block_ns // self._segment_ns if self._sways else 0


def lower_priority(thread: int) -> None:
    """Lower the priority of a thread, by its number in the system; elsewhere than on Linux, do nothing."""
    if sys.platform == "linux":
        os.setpriority(os.PRIO_PROCESS, thread, os.getpriority(os.PRIO_PROCESS, thread) + _NICE)


class Openers:
    """The threads that open windows of a live run; they do not keep the windows alive."""

    def __init__(self, elapsed_ns: Callable[[], int]) -> None:
        self._elapsed_ns = elapsed_ns  # time since the first pulse
        self._threads = list[int]()  # by their numbers in the system
        self._is_flying = False
        self.left_out = 0  # steps that were left out, also by the same windows in blocks of other sensors
        # Weak, as threads keep this object, and a window keeps the threads that built it.
        self._next: tuple[int, weakref.ref[Future[Geometry]]] | None = None

    def prepare_thread(self) -> None:
        """Prepare a thread that opens windows; once the body flies, with a lower priority."""
        self._threads.append(threading.get_native_id())
        if self._is_flying:
            lower_priority(self._threads[-1])

    def begin(self) -> None:
        """Lower the priority of the threads that open windows: the next one can wait, casting cannot."""
        if not self._is_flying:
            self._is_flying = True
            for thread in self._threads:
                lower_priority(thread)

    def goes_on(self, by_ns: int, window: Future[Geometry]) -> None:
        """Take the time since the first pulse by which the next step shall begin, and its window."""
        self._next = by_ns, weakref.ref(window)

    @property
    def is_in_the_way(self) -> bool:
        """True if steps are late, and do not wait for a window."""
        if self._next is None:
            return False
        by_ns, reference = self._next
        window = reference()
        return window is not None and window.done() and self._elapsed_ns() > by_ns

    def give_way(self) -> None:
        """Wait while steps are late, for some time: the interpreter runs one thread at a time."""
        until_s = time.monotonic() + _REST_S
        while self.is_in_the_way and time.monotonic() < until_s:
            time.sleep(_NAP_S)


class Builders(ThreadPoolExecutor):
    """A thread that builds windows of a live run, and gives way to late steps before each part of one."""

    def __init__(self, openers: Openers) -> None:
        # With more threads than one, casting threads wait for the interpreter.
        super().__init__(1, "build", openers.prepare_thread)
        self._openers = openers

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Run a part of building a window."""

        def part() -> T:
            """Run the part once steps are in time."""
            self._openers.give_way()
            return fn(*args, **kwargs)

        return super().submit(part)


class LiveWindows(CubeWindows):
    """Windows of a run that is being flown."""

    def __init__(
        self, parts: Parts, start_ns: int, batching: Batching, threads: int, motion: "LiveMotion"
    ) -> None:
        self.openers = Openers(lambda: motion.elapsed_ns)
        builders = Builders(self.openers)
        prepare_thread = self.openers.prepare_thread
        super().__init__(
            parts, start_ns, batching, threads, motion, builders=builders, prepare_thread=prepare_thread
        )
        self._live = motion

    @property
    def left_out(self) -> int:
        """Blocks of all sensors that were not cast because their time was over."""
        return self.openers.left_out

    def course(self, t_ns: int) -> Course:
        """Return the course of the body; at the start that of its last pose, as it rests before its knots."""
        seen = self._live.poses.last
        if seen is None or t_ns - _TURN_NS > self._start_ns:
            return super().course(t_ns)
        return Course(seen.state[:3], seen.state[7:10], float(seen.state[12]))

    def missing(self) -> Future[Geometry] | None:
        """Return the first window that is not open yet, of those for the start and the next seconds."""
        for name in dict.fromkeys([self.name_of(0), *self.expected(0, _FAR_BLOCK)[: self.ahead]]):
            future = self._future_of(name)
            if not future.done():
                return future
        return None

    def runs(self, blocks: range, at_once: int, threads: int) -> Iterator[range]:  # noqa: ARG002
        """Yield blocks one by one, as packets shall not wait; skip to the present if they are late.

        Late blocks that are over are taken together, as far as each thread has some: together they cost less.
        """
        block = blocks.start
        while block < blocks.stop:
            late = self._live.elapsed_ns // self._block_ns - block
            if late * self._block_ns > _MOST_LATE_NS:
                self.openers.left_out += min(late, blocks.stop - block)
                block += late
                continue
            size = min(max(late // threads, 1), self._parts - block % self._parts, blocks.stop - block)
            self.openers.goes_on((block - _EARLY) * self._block_ns, self.at_block(block))
            yield range(block, block + size)
            block += size
