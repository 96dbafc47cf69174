"""Letting packets leave at absolute deadlines, and measuring how late they are."""

import math
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from vlp16emu.errors import InputError
from vlp16emu.units import S_NS

__all__ = ["Lateness", "LatenessHistogram", "Pacer"]

_SPIN_NS = 120_000
"""Last stretch before a deadline, in which we ask the clock again and again: a sleep on Linux ends 50 us
late by the default timer slack, see PR_SET_TIMERSLACK in prctl(2), plus the time of a wake-up."""
_BIN_BITS = 6
"""Significant bits by which late packets are told apart, which gives quantiles within 1.6 %."""


@dataclass(frozen=True, slots=True)
class Lateness:
    """By how much packets missed their deadlines."""

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
        return Lateness(self._counts.total(), self._quantile(0.5), self._quantile(0.99), self._max_ns)

    def _quantile(self, share: float) -> int:
        """Middle of the bin that holds the given share's packet."""
        rank = math.ceil(share * self._counts.total())
        seen = 0
        for middle_ns, count in sorted(self._counts.items()):
            seen += count
            if seen >= rank:
                return min(middle_ns, self._max_ns)
        return 0


class Pacer:
    """Waits for deadlines that are all reckoned from one start instant, so that errors never add up.

    The first packet starts the clock and is due at once.

    Parameters
    ----------
    speed : simulated seconds per second, above 0
    clock_ns : monotonic clock
    sleep : suspends the thread for some seconds

    Raises
    ------
    InputError
        If the speed is not a finite number above 0.
    """

    def __init__(
        self,
        speed: float,
        *,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        if not (math.isfinite(speed) and speed > 0):
            raise InputError("speed", f"{speed}", "a finite number above 0")
        self._speed, self._clock_ns, self._sleep = speed, clock_ns, sleep
        self._first_due_ns: int | None = None
        self._start_ns = 0
        self._simulated_ns = 0
        self.elapsed_ns = (0, 0)
        """Simulated time and clock time from the first packet that left to the last one."""

    def deadline_ns(self, due_ns: int) -> int:
        """Instant on the pacer's clock at which a packet shall leave; the first call starts the clock."""
        if self._first_due_ns is None:
            self._first_due_ns, self._start_ns = due_ns, self._clock_ns()
        self._simulated_ns = due_ns - self._first_due_ns
        return self._start_ns + round(self._simulated_ns / self._speed)

    def behind_ns(self, deadline_ns: int) -> int:
        """Time since a deadline, 0 where it is still to come."""
        return max(self._clock_ns() - deadline_ns, 0)

    def wait(self, deadline_ns: int) -> int:
        """Sleep until a deadline and return how late it has become, in ns."""
        while (left_ns := deadline_ns - self._clock_ns()) > 0:
            if left_ns > _SPIN_NS:
                self._sleep((left_ns - _SPIN_NS) / S_NS)
        self.elapsed_ns = self._simulated_ns, deadline_ns - left_ns - self._start_ns
        return -left_ns
