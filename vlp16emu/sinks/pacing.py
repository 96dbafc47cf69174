"""Letting packets leave at absolute deadlines, and measuring how late they are."""

import math
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from vlp16emu.errors import InputError
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import S_NS

__all__ = ["Lateness", "LatenessHistogram", "Pacer"]

_CLOSEST = 0.94
"""Share of the sensor's own spacing that packets of a unit and kind keep on average while they catch up. The shortest
interval of a real sensor in 293 packets is 1 246 of 1 327 us: mrpt_vlp16_gps.pcap."""
_JITTER_NS = 10_000_000
"""Lateness of single packets that does not move the ones after it: two or three turns of 3 to 4 ms that Linux gives to
other threads before it wakes ours. Where wake-ups come that late each of them sends several packets, 8 at most."""
_BIN_BITS = 6
"""Significant bits that separate the bins of lateness, which gives quantiles within 1.6 %."""


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
    """Waits for deadlines that all count from one start instant, so that errors never add up.

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
        self._planned_ns = 0
        self._last = dict[tuple[int, PacketKind], tuple[int, int]]()
        self.delay_ns = 0
        """Time by which deadlines have been moved in all."""
        self.elapsed_ns = (0, 0)
        """Simulated time and clock time from the first packet that left to the last one."""

    def deadline_ns(self, due_ns: int) -> int:
        """Instant on the pacer's clock at which a packet shall leave; the first call starts the clock."""
        if self._first_due_ns is None:
            self._first_due_ns, self._start_ns = due_ns, self._clock_ns()
        simulated_ns = due_ns - self._first_due_ns
        return self._start_ns + self.delay_ns + round(simulated_ns / self._speed)

    def due_in_ns(self, ahead_ns: int) -> int:
        """Due time of a packet whose deadline is some time ahead of now; after the first deadline."""
        assert self._first_due_ns is not None
        ran_ns = self._clock_ns() - self._start_ns - self.delay_ns
        return self._first_due_ns + round((ran_ns + ahead_ns) * self._speed)

    def behind_ns(self, deadline_ns: int) -> int:
        """Time since a deadline, 0 where it is still to come."""
        return max(self._clock_ns() - deadline_ns, 0)

    def since_start_ns(self, instant_ns: int) -> int:
        """Clock time from the first deadline to an instant."""
        return instant_ns - self._start_ns

    def delay(self, by_ns: int) -> None:
        """Move all deadlines to come."""
        self.delay_ns += by_ns

    def break_off(self) -> None:
        """Begin anew with spacing, as where packets are left out: the next one leaves at its deadline."""
        self._last.clear()

    def wait(self, packet: Packet, deadline_ns: int) -> int:
        """Sleep until a packet may leave, and return how late after its deadline it does, in ns.

        It leaves at its deadline, or later where its predecessors of the same unit and kind were late: n packets
        take at least 0.94 of the sensor's own time for n packets, less 10 ms. (A leaky bucket; as such ITU-T I.371
        has it as the generic cell rate algorithm.)
        """
        last_due_ns, planned_ns = self._last.get((packet.unit, packet.kind), (packet.due_ns, deadline_ns))
        closest_ns = planned_ns + round(_CLOSEST * (packet.due_ns - last_due_ns) / self._speed)
        self._planned_ns = max(deadline_ns, closest_ns)
        while (left_ns := self._planned_ns - (now_ns := self._clock_ns())) > 0:
            self._sleep(left_ns / S_NS)
        return now_ns - deadline_ns

    def left(self, packet: Packet) -> None:
        """Note that the packet that was waited for has left just now."""
        assert self._first_due_ns is not None
        now_ns = self._clock_ns()
        planned_ns = max(self._planned_ns, now_ns - _JITTER_NS)
        self._last[packet.unit, packet.kind] = packet.due_ns, planned_ns
        self.elapsed_ns = packet.due_ns - self._first_due_ns, now_ns - self._start_ns
