"""Pacing: packets are sent at absolute deadlines, and their lateness is measured.

Sleeps end on time, and each time that a stream falls behind is recorded.
"""

import ctypes
import gc
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
"""Longest time for which the computing thread may hold the interpreter before the sending thread. Python's
default of 5 ms would delay four packets."""
_lock = threading.Lock()
_before_s = list[float]()
"""Switch interval before each active stream: the interpreter has one for all, and the last stream restores
the first."""


@contextmanager
def prompt() -> Iterator[None]:
    """Make the calling thread wake promptly from sleeps and get the interpreter soon.

    Restore the state afterwards.

    Linux's timer slack delays wake-ups by up to 50 us to save power. On other systems sleeps end as late as
    the system decides, and the report of a stream shows it.
    """
    prctl = None
    before_ns = 0
    if sys.platform == "linux":
        prctl = ctypes.CDLL(None).prctl
        # The arguments are unsigned longs, and prctl is variadic: a plain int would leave half a register
        # undefined.
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
                gc.unfreeze()
        if prctl is not None:
            prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(max(before_ns, 0)), *[ctypes.c_ulong(0)] * 3)


def settle_memory() -> None:
    """Collect garbage, and spare all that is alive later collections, until the last active stream ends.

    A collection that walks through a forest, with hundreds of thousands of objects, holds the interpreter for
    40 ms, and longer on a thread of low priority.
    """
    gc.collect()
    gc.freeze()


TOLERANCE_NS = 50_000_000
"""Lateness up to which a stream is not behind: half a revolution at 600 rpm. Pauses of 5 to 40 ms are common
if other programs use the same cores; the usual receive buffer of Linux, 208 KiB, holds 120 ms of packets."""


class Late(StrEnum):
    """Treatment of a packet that is late by more than the tolerance."""

    PACE = "pace"  # It is sent, and all later deadlines move by its lateness: the delay stays
    SKIP = "skip"  # It is dropped


@dataclass(slots=True)
class FellBehind:
    """One time that a stream fell behind; grows while it lasts."""

    at_s: float  # Deadline of the first packet that was too late, from the start of the stream
    behind_s: float  # Lateness of that packet
    engine: bool
    """True if the packet was not computed in time; else it was ready, and the process stood still or could
    not send."""
    engine_speed: float | None
    """Simulated seconds per second that the engine computed since it was last ahead; None if unknown."""
    speed: float = 1.0  # Requested simulated seconds per second
    total_s: float = 0.0  # Resulting delay so far, with `pace`; greatest lateness, with `skip`

    @property
    def cause(self) -> str:
        """Cause in words."""
        if not self.engine:
            return "the process stood still or got no core"
        if self.engine_speed is None:
            return "the engine is too slow"
        if self.engine_speed > self.speed:  # it has been fast enough on the whole
            return "the engine stood still for a moment"
        return f"the engine computes {self.engine_speed:.2f} x real time"


_CLOSEST = 0.94
"""Share of the sensor's spacing that packets of a unit and kind keep on average while they catch up. The
shortest interval of a real sensor in 293 packets is 1 246 of 1 327 us: unit A of protocol/README.md."""
_JITTER_NS = 10_000_000
"""Lateness of single packets that does not delay later ones: two or three time slices of 3 to 4 ms that Linux
gives to other threads before ours. After such a late wake-up several packets are sent at once, at most 8."""
_NAP_S = 0.2
"""Longest single sleep: a signal sets an event, and Python resumes a sleep after a signal (PEP 475)."""
_BIN_BITS = 6  # significant bits of the bins of lateness: quantiles are within 1.6 %


@dataclass(frozen=True, slots=True)
class Lateness:
    """Lateness of packets against their deadlines."""

    packets: int
    median_ns: int
    p99_ns: int
    max_ns: int


class LatenessHistogram:
    """Histogram of lateness with bins proportional to it.

    It has a few hundred numbers for a stream of any length.
    """

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
        """Centre of the bin of a quantile; 0 before the first packet."""
        rank = math.ceil(share * self._counts.total())
        seen = 0
        for middle_ns, count in sorted(self._counts.items()):
            seen += count
            if seen >= rank:
                return min(middle_ns, self._max_ns)
        return 0


class Pacer:
    """Waits for deadlines that all count from one start instant, so that errors do not accumulate.

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
        self.speed = speed
        self.now_ns = clock_ns
        self._sleep = sleep
        self.first_due_ns: int | None = None  # Due time of the first packet; None before it
        self.start_ns = 0  # Instant on the pacer's clock at which it was due
        self._planned_ns = 0
        self._last = dict[tuple[int, PacketKind], tuple[int, int]]()
        self.delay_ns = 0  # Shift of all future deadlines
        self.late_ns = 0  # Lateness of the last packet
        self.elapsed_ns = (0, 0)  # Simulated time and clock time from the first to the last sent packet

    def begin(self, due_ns: int, ago_ns: int = 0) -> None:
        """Start the clock so that `due_ns` was `ago_ns` before now; negative for the future."""
        self.first_due_ns = due_ns
        self.start_ns = self.now_ns() - ago_ns

    def deadline_ns(self, due_ns: int) -> int:
        """Instant on the pacer's clock at which a packet is due; the first call starts the clock."""
        if self.first_due_ns is None:
            self.begin(due_ns)
        assert self.first_due_ns is not None
        simulated_ns = due_ns - self.first_due_ns
        return self.start_ns + self.delay_ns + round(simulated_ns / self.speed)

    def due_in_ns(self, ahead_ns: int) -> int:
        """Due time of a packet whose deadline is `ahead_ns` after now; valid after the first deadline."""
        assert self.first_due_ns is not None
        ran_ns = self.now_ns() - self.start_ns - self.delay_ns
        return self.first_due_ns + round((ran_ns + ahead_ns) * self.speed)

    def break_off(self) -> None:
        """Reset the spacing after packets were dropped: the next one is sent at its deadline."""
        self._last.clear()

    def wait(self, packet: Packet, deadline_ns: int, *, is_over: Callable[[], bool] = lambda: False) -> int:
        """Sleep until a packet may be sent or `is_over`, and return the lateness after its deadline, in ns.

        It is sent at its deadline, or later if predecessors of the same unit and kind were late: n packets
        take at least 0.94 of the sensor's time for n packets, minus 10 ms. (A leaky bucket: the generic cell
        rate algorithm of ITU-T I.371.)
        """
        last_due_ns, planned_ns = self._last.get((packet.unit, packet.kind), (packet.due_ns, deadline_ns))
        closest_ns = planned_ns + round(_CLOSEST * (packet.due_ns - last_due_ns) / self.speed)
        self._planned_ns = max(deadline_ns, closest_ns)
        while (left_ns := self._planned_ns - (now_ns := self.now_ns())) > 0 and not is_over():
            self._sleep(min(left_ns / S_NS, _NAP_S))
        self.late_ns = now_ns - deadline_ns
        return self.late_ns

    def left(self, packet: Packet) -> None:
        """Record that the awaited packet has just been sent."""
        assert self.first_due_ns is not None
        now_ns = self.now_ns()
        planned_ns = max(self._planned_ns, now_ns - _JITTER_NS)
        self._last[packet.unit, packet.kind] = packet.due_ns, planned_ns
        self.elapsed_ns = packet.due_ns - self.first_due_ns, now_ns - self.start_ns
