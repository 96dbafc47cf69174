"""A body that is flown while the run goes on: poses come in, and the motion is what was made of them so far."""

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError
from dataclasses import dataclass

import numpy as np

from vlp16emu.elementary import norm
from vlp16emu.engine import Batching, Parts
from vlp16emu.errors import InputError, TrajectoryError
from vlp16emu.extras.live.flown import LiveWindows
from vlp16emu.extras.live.knots import GAP_M, GAP_RAD, STATE, STEP_NS, Knots, follow, turn_between
from vlp16emu.extras.live.settings import Live
from vlp16emu.extras.recorded.files import UNIT_TOLERANCE
from vlp16emu.motion.pose import Kinematics
from vlp16emu.types import F8, I8, Poses
from vlp16emu.units import S_NS

LOST_NS = S_NS  # without a pose for so long, poses are lost

_AHEAD_NS = 2_000_000
"""How long before its first pulse a step is computed: some packets need that, and each is due after its last pulse."""
_BASE_NS = 20_000_000
"""Rates are taken from poses at least that far apart, if there are such: noise of 1 mm then makes 0.07 m/s."""
_LEAST_BASE_NS, _MOST_BASE_NS = 2_000_000, 300_000_000  # poses closer together, or farther apart, say nothing of rates
_MOST_PULL = 500.0
"""Accelerations beyond that, in gaps that are led back slowly, per s2, are jumps: 50 m/s2 and 100 rad/s2."""
_RESTART_NS = S_NS  # a sender whose stamps are older than ever by more than that has begun a new clock
_CREEP_NS_S = 100_000  # by how much per second a sender's clock may be slow: 100 ppm
_FARTHEST_M = 1e6  # as far out as a scene may lie


@dataclass(frozen=True, slots=True)
class SeenPose:
    """A pose that came in."""

    state: F8  # (13,) as a knot has it; rates are those since poses before
    at_ns: int  # when it was true, on the monotonic clock of this machine
    arrived_ns: int  # when it came, on the same clock


@dataclass(frozen=True, slots=True)
class PosesLost:
    """A time without poses."""

    at_s: float  # last pose before it, since the first pulse
    lasted_s: float


class PoseInput:
    """Takes poses from any thread, and keeps the last one.

    Stamps of a sender count on a clock of its own. What that clock is off is taken from the pose that was quickest so
    far: its way took no time. So only what others took longer is known, and the least delay is part of the latency.
    """

    def __init__(self, clock_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._clock_ns, self._lock = clock_ns, threading.Lock()
        self.came = threading.Event()  # set by the first pose
        self._before = deque[tuple[int, F8]]()
        self._jumped = False
        self._offset_ns: int | None = None
        self._offset_at_ns = 0
        self.last: SeenPose | None = None
        self.received = self.refused = self.out_of_order = 0
        """Poses: taken, malformed, and with a stamp that is not after that of the pose before."""
        self.longest_gap_ns = 0  # between one arrival and the next, since the run began
        self.gaps_ns: list[tuple[int, int]] = []
        """Arrivals before and after each time without poses for more than a second, since the run began."""

    def put(self, position_m: Sequence[float], quaternion: Sequence[float], t_ns: int | None = None) -> bool:
        """Take a pose, and return whether it is later than the one before; others are left out.

        Parameters
        ----------
        position_m : (3,) of the body in the world
        quaternion : (4,) x, y, z, w of unit length, body to world
        t_ns : when it was true, on the sender's clock of any epoch; None for now

        Raises TrajectoryError if a number is not finite, or the quaternion is not of unit length.
        """
        now_ns = self._clock_ns()
        try:
            pose = _checked(position_m, quaternion)
        except InputError:
            self.refused += 1
            raise
        with self._lock:
            at_ns = now_ns
            if t_ns is not None:  # the sender's clock, by how long after its stamp the present pose came
                offset_ns, crept_ns = now_ns - t_ns, (now_ns - self._offset_at_ns) * _CREEP_NS_S // S_NS
                if self._offset_ns is not None and offset_ns <= self._offset_ns + _RESTART_NS:
                    offset_ns = min(offset_ns, self._offset_ns + crept_ns)
                self._offset_ns, self._offset_at_ns = offset_ns, now_ns
                at_ns = t_ns + offset_ns
            last = self.last
            if last is not None:
                if at_ns <= last.at_ns:
                    self.out_of_order += 1
                    return False
                gap_ns = now_ns - last.arrived_ns
                self.longest_gap_ns = max(self.longest_gap_ns, gap_ns)
                if gap_ns > LOST_NS:
                    self.gaps_ns.append((last.arrived_ns, now_ns))
            self.received += 1
            self.last = SeenPose(self._with_rates(at_ns, pose), at_ns, now_ns)
        self.came.set()
        return True

    def _with_rates(self, at_ns: int, pose: F8) -> F8:
        """Add to a pose (7,) the rates since the youngest pose that is old enough, and keep it for those to come."""
        before = self._before
        while before and at_ns - before[0][0] > _MOST_BASE_NS:
            before.popleft()
        while len(before) > 1 and at_ns - before[1][0] >= _BASE_NS:
            before.popleft()
        state = np.zeros(STATE)
        state[:7] = pose
        self._jumped = not self._jumped and self._is_jump(at_ns, pose)
        if self._jumped:
            before.clear()
            assert self.last is not None
            state[7:] = self.last.state[7:]
        elif before and (base_ns := at_ns - before[0][0]) >= _LEAST_BASE_NS:
            old, per_s = before[0][1], S_NS / base_ns
            state[7:10] = (pose[:3] - old[:3]) * per_s
            state[10:] = turn_between(old[3:], pose[3:]) * per_s
        before.append((at_ns, pose))
        return state

    def _is_jump(self, at_ns: int, pose: F8) -> bool:
        """Return whether no body gets from the last pose to a pose (7,) in time: then the step says nothing of its rates."""
        if self.last is None:
            return False
        last, since_s = self.last.state, (at_ns - self.last.at_ns) / S_NS
        off_m = norm(pose[:3] - last[:3] - since_s * last[7:10])
        off_rad = norm(turn_between(last[3:7], pose[3:]) - since_s * last[10:])
        most = 1.0 + _MOST_PULL * since_s * since_s
        return bool(off_m > GAP_M * most or off_rad > GAP_RAD * most)


class LiveMotion:
    """Motion of a body by the poses that have come in, made knot by knot as time goes on.

    Each knot is made once, when its time comes, and never changed, so later calls, and readers of what was flown, find
    the same. A call for a time to come waits for it.

    Parameters
    ----------
    section : how poses are followed
    start_ns : UTC of the first pulse
    clock_ns, sleep : monotonic clock, and what suspends a thread for some seconds
    """

    moves, run_time_s = True, math.inf

    def __init__(
        self,
        section: Live,
        *,
        start_ns: int,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._smoothing_s, self._start_ns = section.smoothing_s, start_ns
        self._clock_ns, self._sleep, self._lock = clock_ns, sleep, threading.Lock()
        self._zero_ns = 0
        self.knots: Knots | None = None  # all so far; None before the beginning
        self._used: SeenPose | None = None
        self.poses = PoseInput(clock_ns)
        self.is_open = False  # whether poses are waited for, as in a stream
        self.first_uses = deque[tuple[int, int]]()
        """Of each pose that was used: UTC of the first pulse whose pose it decides, and its arrival on the monotonic clock."""

    def begin(self, zero_ns: int) -> None:
        """Begin to move: the first pulse is fired at an instant of the monotonic clock."""
        self._zero_ns = zero_ns
        self.poses.longest_gap_ns = 0
        self.poses.gaps_ns.clear()
        self.knots = Knots(self._start_ns, self._seen().state[None])

    def end(self) -> None:
        """Forget what was flown, and take no more poses."""
        self.is_open, self.knots, self._used = False, None, None
        self.poses = PoseInput(self._clock_ns)
        self.first_uses.clear()

    def require_open(self) -> None:
        """Raise `TrajectoryError` if no poses come in, as nobody streams."""
        if not self.is_open:
            found = 'found "live", whose poses come in while `vlp16emu stream` runs'
            expected = 'motion.flown = "FILE", what a stream has written with --flown, beside it'
            raise TrajectoryError("motion.kind", found, expected)

    def put_pose(self, position_m: Sequence[float], quaternion: Sequence[float], t_ns: int | None) -> bool:
        """Take a pose; parameters, result and errors as of `PoseInput.put`."""
        return self.poses.put(position_m, quaternion, t_ns)

    def windows(self, parts: Parts, start_ns: int, batching: Batching, threads: int) -> LiveWindows:
        """Return windows that are opened as the body comes near; parameters as of `engine.windows.windows_of`."""
        return LiveWindows(parts, start_ns, batching, threads, self)

    def since_s(self, instant_ns: int) -> float:
        """Turn an instant of the monotonic clock into seconds since the first pulse."""
        return (instant_ns - self._zero_ns) / S_NS

    @property
    def elapsed_ns(self) -> int:
        """Time since the first pulse; 0 before the beginning."""
        return 0 if self.knots is None else self._clock_ns() - self._zero_ns

    @property
    def state(self) -> F8:
        """(13,) of the last knot, or before the beginning of the last pose."""
        return self._seen().state if self.knots is None else self.knots.last_state

    def poses_at(self, t_ns: I8) -> Poses:
        """Poses at UTC instants (n,), which may have to come first; before the beginning the body is at rest.

        Raises `TrajectoryError` if nobody streams, and `CancelledError` if the stream ends before there is a pose.
        """
        return self._knots_until(int(t_ns.max())).poses_at(t_ns)

    def kinematics_at(self, t_ns: I8) -> Kinematics:
        """Poses at UTC instants (n,) with their derivatives; the rest as of `poses_at`."""
        return self._knots_until(int(t_ns.max())).kinematics_at(t_ns)

    def _seen(self) -> SeenPose:
        self.require_open()
        if (seen := self.poses.last) is None:
            raise CancelledError
        return seen

    def _knots_until(self, t_ns: int) -> Knots:
        """Make knots until a UTC instant, each when its time has come."""
        if self.knots is None:
            rest = np.append(self._seen().state[:7], np.zeros(STATE - 7))
            still = follow(rest, rest, 0.0, STEP_NS / S_NS, self._smoothing_s)  # by the kernel, which is loaded with it
            return Knots(self._start_ns, np.stack([rest, still]))
        while True:
            with self._lock:
                knots, now_ns = self.knots, self._clock_ns()
                while knots.last < 1 or knots.last_ns < t_ns - self._start_ns:
                    early_ns = self._zero_ns + knots.last_ns - _AHEAD_NS - now_ns
                    if early_ns > 0:
                        break
                    seen = self._seen()
                    if seen is not self._used:
                        self._used = seen
                        self.first_uses.append((self._start_ns + knots.last_ns, seen.arrived_ns))
                    since_s = (self._zero_ns + knots.last_ns - seen.at_ns) / S_NS
                    knots.append(follow(knots.last_state, seen.state, since_s, STEP_NS / S_NS, self._smoothing_s))
                else:
                    return knots
            self._sleep(early_ns / S_NS)


def _checked(position_m: Sequence[float], quaternion: Sequence[float]) -> F8:
    """Put a pose into one array (7,), its quaternion scaled to unit length."""
    numbers = [*map(float, position_m), *map(float, quaternion)]
    if len(position_m) != 3 or len(quaternion) != 4:
        raise TrajectoryError("pose", f"found {len(position_m)} and {len(quaternion)} numbers", "3 and 4")
    if not all(map(math.isfinite, numbers)):
        raise TrajectoryError("pose", f"found {numbers}", "finite numbers")
    if max(map(abs, numbers[:3])) > _FARTHEST_M:
        raise TrajectoryError("pose", f"found a place at {numbers[:3]} m", f"at most {_FARTHEST_M:g} m")
    length = float(norm(np.array(numbers[3:])))
    if abs(length - 1.0) > UNIT_TOLERANCE:
        raise TrajectoryError("pose", f"a quaternion of length {length:.6g}", f"length 1, to {UNIT_TOLERANCE:g}")
    return np.array([*numbers[:3], *(number / length for number in numbers[3:])])
