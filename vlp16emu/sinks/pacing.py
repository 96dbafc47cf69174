"""Packets leave at absolute deadlines, and how late they are is measured.

Sleeps end on time, and each time that a stream fell behind is on record.
"""

import ctypes
import math
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum

from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import S_NS

# Numbers of prctl(2). Source: linux/prctl.h.
_PR_SET_TIMERSLACK = 29
_PR_GET_TIMERSLACK = 30
_FINEST_NS = 1  # 0 would restore the default of 50 us


_SWITCH_INTERVAL_S = 0.000_2
"""Longest time for which the thread that computes may keep the interpreter from the one that sends. Python's own
5 ms would be four packets late."""
_lock, _before_s = threading.Lock(), list[float]()
"""Interval before each of the streams under way: the interpreter has one for all, and the last to end restores the first."""


@contextmanager
def prompt() -> Iterator[None]:
    """Let the calling thread wake at the end of its sleeps, and soon after another thread has the interpreter; as before afterwards.

    The timer slack of Linux joins wake-ups to save power, up to 50 us later. Elsewhere sleeps are as late as the system makes
    them, and the report of a stream says so.
    """
    prctl, before_ns = None, 0
    if sys.platform == "linux":
        prctl = ctypes.CDLL(None).prctl
        # The arguments are unsigned longs, and prctl is variadic: a plain int would leave half a register undefined.
        before_ns = prctl(_PR_GET_TIMERSLACK, *[ctypes.c_ulong(0)] * 4)
        prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(_FINEST_NS), *[ctypes.c_ulong(0)] * 3)
    with _lock:
        _before_s.append(sys.getswitchinterval())
        sys.setswitchinterval(_SWITCH_INTERVAL_S)
    try:
        yield
    finally:
        with _lock:
            before_s = _before_s.pop()
            if not _before_s:
                sys.setswitchinterval(before_s)
        if prctl is not None:
            prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(max(before_ns, 0)), *[ctypes.c_ulong(0)] * 3)


TOLERANCE_NS = 50_000_000
"""Lateness up to which a stream is not behind: half a revolution at 600 rpm. Pauses of 5 to 40 ms are common where
other programs want the same cores; the usual receive buffer of Linux, 208 KiB, holds 120 ms of packets."""


class Late(StrEnum):
    """Treatment of a packet that is late by more than the tolerance."""

    PACE = "pace"  # It leaves, and the deadlines of all later ones move by as much: the delay stays
    SKIP = "skip"  # It is dropped


@dataclass(slots=True)
class FellBehind:
    """One time that a stream fell behind; grows while it lasts."""

    at_s: float  # Deadline of the first packet that was too late, from the start of the stream
    behind_s: float  # Lateness of that packet
    engine: bool
    """The packet was not computed in time; else it was ready, and the process stood still or could not send."""
    engine_speed: float | None
    """Simulated seconds per second that the engine computed since it was last ahead; None where that is unknown."""
    total_s: float = 0.0  # Delay that came of it so far, with `pace`; greatest lateness, with `skip`

    @property
    def cause(self) -> str:
        """Cause in words."""
        if not self.engine:
            return "the process stood still or got no core"
        if self.engine_speed is None:
            return "the engine is too slow"
        return f"the engine computes {self.engine_speed:.2f} x real time"


_CLOSEST = 0.94
"""Share of the sensor's own spacing that packets of a unit and kind keep on average while they catch up. The shortest
interval of a real sensor in 293 packets is 1 246 of 1 327 us: mrpt_vlp16_gps.pcap."""
_JITTER_NS = 10_000_000
"""Lateness of single packets that does not move the ones after it: two or three turns of 3 to 4 ms that Linux gives to
other threads before it wakes ours. Where wake-ups come that late each of them sends several packets, 8 at most."""
_NAP_S = 0.2
"""Longest sleep at once: a signal sets an event, and Python goes on with a sleep that a signal interrupts (PEP 475)."""
_BIN_BITS = 6  # significant bits that separate the bins of lateness, which gives quantiles within 1.6 %


@dataclass(frozen=True, slots=True)
class Lateness:
    """Lateness of packets against their deadlines."""

    packets: int
    median_ns: int
    p99_ns: int
    max_ns: int


class LatenessHistogram:
    """Counts of lateness in bins that grow with it: a few hundred numbers, however long the stream."""

    def __init__(self) -> None:
        self._counts = Counter[int]()
        self._max_ns = 0

    def add(self, late_ns: int) -> None:
        """Count one packet; `late_ns` is not negative."""
        drop_bits = max(late_ns.bit_length() - _BIN_BITS, 0)
        self._counts[(late_ns >> drop_bits << drop_bits) + (1 << drop_bits >> 1)] += 1
        self._max_ns = max(self._max_ns, late_ns)

    @property
    def summary(self) -> Lateness:
        """Median, 99th percentile and maximum; all 0 before the first packet."""
        return Lateness(self._counts.total(), self.quantile_ns(0.5), self.quantile_ns(0.99), self._max_ns)

    def quantile_ns(self, share: float) -> int:
        """Middle of the bin that holds the given share's packet; 0 before the first one."""
        rank = math.ceil(share * self._counts.total())
        seen = 0
        for middle_ns, count in sorted(self._counts.items()):
            seen += count
            if seen >= rank:
                return min(middle_ns, self._max_ns)
        return 0


class Pacer:
    """Waits for deadlines that all count from one start instant, so that errors never add up.

    The first packet starts the clock and is due at once.

    Parameters
    ----------
    speed : simulated seconds per second, above 0
    clock_ns : monotonic clock
    sleep : suspends the thread for some seconds
    """

    def __init__(
        self,
        speed: float,
        *,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.speed, self.now_ns, self._sleep = speed, clock_ns, sleep
        self.first_due_ns: int | None = None  # Due time of the first packet; None before it
        self.start_ns = 0  # Instant on the pacer's clock at which it was to leave
        self._planned_ns = 0
        self._last = dict[tuple[int, PacketKind], tuple[int, int]]()
        self.delay_ns = 0  # Time by which all deadlines to come have been moved
        self.late_ns = 0  # Lateness of the packet that was waited for last
        self.elapsed_ns = (0, 0)  # Simulated time and clock time from the first packet that left to the last one

    def begin(self, due_ns: int, ago_ns: int = 0) -> None:
        """Start the clock: what is due at a time leaves some time ago, or in some time where that is negative."""
        self.first_due_ns, self.start_ns = due_ns, self.now_ns() - ago_ns

    def deadline_ns(self, due_ns: int) -> int:
        """Instant on the pacer's clock at which a packet shall leave; the first call starts the clock."""
        if self.first_due_ns is None:
            self.begin(due_ns)
        assert self.first_due_ns is not None
        simulated_ns = due_ns - self.first_due_ns
        return self.start_ns + self.delay_ns + round(simulated_ns / self.speed)

    def due_in_ns(self, ahead_ns: int) -> int:
        """Due time of a packet whose deadline is some time ahead of now; after the first deadline."""
        assert self.first_due_ns is not None
        ran_ns = self.now_ns() - self.start_ns - self.delay_ns
        return self.first_due_ns + round((ran_ns + ahead_ns) * self.speed)

    def break_off(self) -> None:
        """Forget the spacing after packets were dropped: the next one leaves at its deadline."""
        self._last.clear()

    def wait(self, packet: Packet, deadline_ns: int, *, is_over: Callable[[], bool] = lambda: False) -> int:
        """Sleep until a packet may leave or `is_over`, and return how late after its deadline that is, in ns.

        It leaves at its deadline, or later where its predecessors of the same unit and kind were late: n packets
        take at least 0.94 of the sensor's own time for n packets, less 10 ms. (A leaky bucket; as such ITU-T I.371
        has it as the generic cell rate algorithm.)
        """
        last_due_ns, planned_ns = self._last.get((packet.unit, packet.kind), (packet.due_ns, deadline_ns))
        closest_ns = planned_ns + round(_CLOSEST * (packet.due_ns - last_due_ns) / self.speed)
        self._planned_ns = max(deadline_ns, closest_ns)
        while (left_ns := self._planned_ns - (now_ns := self.now_ns())) > 0 and not is_over():
            self._sleep(min(left_ns / S_NS, _NAP_S))
        self.late_ns = now_ns - deadline_ns
        return self.late_ns

    def left(self, packet: Packet) -> None:
        """Note that the packet that was waited for has left just now."""
        assert self.first_due_ns is not None
        now_ns = self.now_ns()
        planned_ns = max(self._planned_ns, now_ns - _JITTER_NS)
        self._last[packet.unit, packet.kind] = packet.due_ns, planned_ns
        self.elapsed_ns = packet.due_ns - self.first_due_ns, now_ns - self.start_ns
