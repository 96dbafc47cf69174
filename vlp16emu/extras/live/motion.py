"""Motion of a body whose poses arrive while the run goes on."""

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
from vlp16emu.engine.windows import STEP_NS
from vlp16emu.errors import InputError, TrajectoryError
from vlp16emu.extras.live.knots import GAP_M, GAP_RAD, STATE, Knots, follow, turn_between
from vlp16emu.extras.live.settings import Live
from vlp16emu.extras.live.windows import ASIDE_M, Bounded, LiveWindows
from vlp16emu.extras.recorded.files import UNIT_TOLERANCE
from vlp16emu.motion.pose import Kinematics
from vlp16emu.types import F8, I8, Poses
from vlp16emu.units import S_NS

LOST_NS = S_NS  # time without a pose after which poses count as lost

_AHEAD_NS = 500_000
"""Time before its first pulse at which a step is computed. Its first packet is due 1.3 ms after that pulse,
and a step takes 0.4 to 1.4 ms with one ray (`tools/loop`)."""
_BASE_NS = 20_000_000
"""Rates are computed from poses at least this far apart, if there are any: noise of 1 mm then gives 0.07
m/s."""
_LEAST_BASE_NS = 2_000_000
_MOST_BASE_NS = 300_000_000
"""Least and greatest time between the poses that give rates."""
_MOST_PULL = 500.0
"""Limits in units of `GAP_M` and `GAP_RAD` per s2 above which a change is a jump: 50 m/s2 and 100 rad/s2."""
_RESTART_NS = S_NS  # a sender whose stamps go back by more than this has started a new clock
_CREEP_NS_S = 100_000  # rate by which a sender's clock may be slow: 100 ppm
_FARTHEST_M = 1e6  # limit of a scene


@dataclass(frozen=True, slots=True)
class ReceivedPose:
    """A pose that was received."""

    state: F8  # (13,) like a knot; rates are from earlier poses to this one
    at_ns: int  # time of the pose, on the monotonic clock of this machine
    arrived_ns: int  # time of its arrival, on the same clock


@dataclass(frozen=True, slots=True)
class PosesLost:
    """A time without poses."""

    at_s: float  # time of the last pose before it, since the first pulse
    lasted_s: float


class PoseInput:
    """Input of poses from any thread; it keeps the last one.

    A sender has a clock of its own. Its offset is estimated from the pose with the least delay so far, which
    counts as zero delay. So only additional delays are known, and the least delay is part of the latency.
    """

    def __init__(
        self,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        is_in_world: Callable[[F8], bool] = lambda _: True,
    ) -> None:
        self._clock_ns = clock_ns
        self._is_in_world = is_in_world
        self._lock = threading.Lock()
        self.came = threading.Event()  # set by the first pose
        self._before = deque[tuple[int, F8]]()
        self._jumped = False
        self._offset_ns: int | None = None
        self._offset_at_ns = 0
        self.last: ReceivedPose | None = None
        self.refusal = ""  # why the last refused pose was refused
        self.received = self.refused = self.out_of_order = 0
        """Counts of poses: accepted, malformed, and with a stamp that is not later than the stamp of the pose
        before."""
        self.longest_gap_ns = 0  # between one arrival and the next, since the run began
        self.gaps_ns: list[tuple[int, int]] = []
        """Arrivals before and after each time without poses for more than a second, since the run began."""

    def put(self, position_m: Sequence[float], quaternion: Sequence[float], t_ns: int | None = None) -> bool:
        """Take a pose; return True if it is later than the one before. Others are left out.

        Parameters
        ----------
        position_m : (3,) position of the body in the world
        quaternion : (4,) x, y, z, w of unit length, body to world
        t_ns : time of the pose, on the sender's clock of any epoch; None for now

        Raises TrajectoryError if a number is not finite, the quaternion is not of unit length, or the place
        is beyond the world.
        """
        now_ns = self._clock_ns()
        try:
            pose = _valid_pose(position_m, quaternion)
            if not self._is_in_world(pose[:3]):
                place = ", ".join(f"{number:g}" for number in pose[:3].tolist())
                raise TrajectoryError("pose", f"found a place at ({place}) m, beyond the world", "one nearer")
        except InputError as error:
            self.refused += 1
            self.refusal = str(error)
            raise
        with self._lock:
            at_ns = now_ns
            if t_ns is not None:  # offset of the sender's clock, from the delay of this pose
                offset_ns = now_ns - t_ns
                crept_ns = (now_ns - self._offset_at_ns) * _CREEP_NS_S // S_NS
                if self._offset_ns is not None and offset_ns <= self._offset_ns + _RESTART_NS:
                    offset_ns = min(offset_ns, self._offset_ns + crept_ns)
                self._offset_ns = offset_ns
                self._offset_at_ns = now_ns
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
            self.last = ReceivedPose(self._add_rates(at_ns, pose), at_ns, now_ns)
        self.came.set()
        return True

    def _add_rates(self, at_ns: int, pose: F8) -> F8:
        """Add rates to a pose (7,), from the latest pose that is old enough; keep it for later poses."""
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
            old = before[0][1]
            per_s = S_NS / base_ns
            state[7:10] = (pose[:3] - old[:3]) * per_s
            state[10:] = turn_between(old[3:], pose[3:]) * per_s
        before.append((at_ns, pose))
        return state

    def _is_jump(self, at_ns: int, pose: F8) -> bool:
        """Return True if no body can reach a pose (7,) from the last one in time, so it gives no rates."""
        if self.last is None:
            return False
        last = self.last.state
        since_s = (at_ns - self.last.at_ns) / S_NS
        off_m = norm(pose[:3] - last[:3] - since_s * last[7:10])
        off_rad = norm(turn_between(last[3:7], pose[3:]) - since_s * last[10:])
        limit = 1.0 + _MOST_PULL * since_s * since_s
        return bool(off_m > GAP_M * limit or off_rad > GAP_RAD * limit)


class LiveMotion:
    """Motion of a body that follows the poses received, computed knot by knot as time goes on.

    Each knot is computed once, at its time, and never changes, so later calls and readers of the table get
    the same motion. A call for a future time waits for it.

    Parameters
    ----------
    section : settings that say how poses are followed
    start_ns : UTC of the first pulse
    clock_ns, sleep : monotonic clock, and a function that suspends a thread for some seconds
    """

    moves = True
    run_time_s = math.inf

    def __init__(
        self,
        section: Live,
        *,
        start_ns: int,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._smoothing_s = section.smoothing_s
        self._start_ns = start_ns
        self._clock_ns = clock_ns
        self._sleep = sleep
        self._lock = threading.Lock()
        self._zero_ns = 0
        self.knots: Knots | None = None  # all knots so far; None before the beginning
        self._used: ReceivedPose | None = None
        self._world: object = None  # set with the windows
        self.poses = PoseInput(clock_ns, self._is_in_world)
        self.is_open = False  # True if calls wait for poses, as in a stream
        self.first_uses = deque[tuple[int, int]]()
        """For each pose that was used: UTC of the first pulse that it affects, and its arrival on the
        monotonic clock."""

    def begin(self, zero_ns: int) -> None:
        """Begin to move: the first pulse is fired at `zero_ns` on the monotonic clock."""
        self._zero_ns = zero_ns
        self.poses.longest_gap_ns = 0
        self.poses.gaps_ns.clear()
        self.knots = Knots(self._start_ns, self._last_pose().state[None])

    def end(self) -> None:
        """Forget the motion, and accept no more poses."""
        self.is_open = False
        self.knots = None
        self._used = None
        self.poses = PoseInput(self._clock_ns, self._is_in_world)
        self.first_uses.clear()

    def require_open(self) -> None:
        """Raise `TrajectoryError` if no stream is open, so that no poses can arrive."""
        if not self.is_open:
            found = 'found "live", whose poses come in while `vlp16emu stream` runs'
            expected = 'motion.flown = "FILE", what a stream has written with --flown, beside it'
            raise TrajectoryError("motion.kind", found, expected)

    def put_pose(self, position_m: Sequence[float], quaternion: Sequence[float], t_ns: int | None) -> bool:
        """Take a pose; parameters, result and errors as in `PoseInput.put`."""
        return self.poses.put(position_m, quaternion, t_ns)

    def windows(self, parts: Parts, start_ns: int, batching: Batching, threads: int) -> LiveWindows:
        """Return windows that open as the body comes near; parameters as in `windows_of`."""
        self._world = parts.world
        return LiveWindows(parts, start_ns, batching, threads, self)

    def _is_in_world(self, place_m: F8) -> bool:
        return not isinstance(self._world, Bounded) or self._world.reaches(place_m, ASIDE_M)

    def since_s(self, instant_ns: int) -> float:
        """Convert an instant of the monotonic clock to seconds since the first pulse."""
        return (instant_ns - self._zero_ns) / S_NS

    @property
    def elapsed_ns(self) -> int:
        """Time since the first pulse, in nanoseconds; 0 before the beginning."""
        return 0 if self.knots is None else self._clock_ns() - self._zero_ns

    def poses_at(self, t_ns: I8) -> Poses:
        """Return poses at UTC instants (n,), waiting for future ones; before the start the body is at rest.

        Raises `TrajectoryError` if no stream is open, and `CancelledError` if the stream ends before there is
        a pose.
        """
        return self._knots_until(int(t_ns.max())).poses_at(t_ns)

    def kinematics_at(self, t_ns: I8) -> Kinematics:
        """Return poses at UTC instants (n,) with their derivatives; otherwise like `poses_at`."""
        return self._knots_until(int(t_ns.max())).kinematics_at(t_ns)

    def _last_pose(self) -> ReceivedPose:
        self.require_open()
        if (seen := self.poses.last) is None:
            raise CancelledError
        return seen

    def _knots_until(self, t_ns: int) -> Knots:
        """Compute knots until a UTC instant, each at its time."""
        if self.knots is None:
            at_rest = np.append(self._last_pose().state[:7], np.zeros(STATE - 7))
            still = follow(at_rest, at_rest, 0.0, STEP_NS / S_NS, self._smoothing_s)  # also loads the kernel
            return Knots(self._start_ns, np.stack([at_rest, still]))
        while True:
            with self._lock:
                knots = self.knots
                now_ns = self._clock_ns()
                while knots.last < 1 or knots.last_ns < t_ns - self._start_ns:
                    early_ns = self._zero_ns + knots.last_ns - _AHEAD_NS - now_ns
                    if early_ns > 0:
                        break
                    seen = self._last_pose()
                    if seen is not self._used:
                        self._used = seen
                        self.first_uses.append((self._start_ns + knots.last_ns, seen.arrived_ns))
                    since_s = (self._zero_ns + knots.last_ns - seen.at_ns) / S_NS
                    knots.append(
                        follow(knots.last_state, seen.state, since_s, STEP_NS / S_NS, self._smoothing_s)
                    )
                else:
                    return knots
            self._sleep(early_ns / S_NS)


def _valid_pose(position_m: Sequence[float], quaternion: Sequence[float]) -> F8:
    """Return a pose as one array (7,), its quaternion scaled to unit length."""
    numbers = [*map(float, position_m), *map(float, quaternion)]
    if len(position_m) != 3 or len(quaternion) != 4:
        raise TrajectoryError("pose", f"found {len(position_m)} and {len(quaternion)} numbers", "3 and 4")
    if not all(map(math.isfinite, numbers)):
        raise TrajectoryError("pose", f"found {numbers}", "finite numbers")
    if max(map(abs, numbers[:3])) > _FARTHEST_M:
        raise TrajectoryError("pose", f"found a place at {numbers[:3]} m", f"at most {_FARTHEST_M:g} m")
    length = float(norm(np.array(numbers[3:])))
    if abs(length - 1.0) > UNIT_TOLERANCE:
        raise TrajectoryError(
            "pose", f"a quaternion of length {length:.6g}", f"length 1, to {UNIT_TOLERANCE:g}"
        )
    return np.array([*numbers[:3], *(number / length for number in numbers[3:])])
