"""Packets of another time as if they were of the present."""

import time
from collections.abc import Callable
from threading import Event

from vlp16emu.packets.retime import age_ns, has_stamp, moved, stamp_ns
from vlp16emu.sinks.sink import PacketSink
from vlp16emu.types import Packet
from vlp16emu.units import HOUR_NS, S_NS

_ASLEEP_NS = 20_000_000
"""How long before its instant the clock is looked at by this thread alone, and no longer the stop event."""


class NowSink(PacketSink):
    """Passes packets on, moved by a whole number of seconds into the present of the system's clock.

    Because seconds stay whole, the pulses of the receiver, its sentences and the stamps stay as far apart as they were. For that
    the stream begins at the instant that has the first packet's fraction of a second: it waits for less than one.

    Parameters
    ----------
    sink : where they go
    clock_ns : UTC
    sleep : suspends the thread for some seconds
    """

    def __init__(
        self,
        sink: PacketSink,
        *,
        clock_ns: Callable[[], int] = time.time_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._sink, self._clock_ns, self._sleep = sink, clock_ns, sleep
        self._ahead_ns = 0
        self.moved_s = 0
        """By how much, from the time of the packets; known when the first one leaves, as the next."""
        self.began_ns = 0
        """UTC at which that is by the sensor's clock."""

    def begin(self, first: Packet, stop: Event) -> int:
        """Wait for the instant at which the first packet leaves, or until the stream is to stop.

        Returns
        -------
        How long ago the instant is, in ns; negative where it has not come
        """
        sent_ns, now_ns = self._sent_ns(first), self._clock_ns()
        at_ns = now_ns + (sent_ns - now_ns) % S_NS
        if (left_ns := at_ns - self._clock_ns()) > _ASLEEP_NS:
            stop.wait((left_ns - _ASLEEP_NS) / S_NS)
        while not stop.is_set() and (left_ns := at_ns - self._clock_ns()) > 0:
            self._sleep(left_ns / S_NS)
        self._start(first, sent_ns, at_ns)
        return self._clock_ns() - at_ns

    def join(self, first: Packet, left_ns: int) -> None:
        """Begin where a clock runs already, by which the first packet leaves in some time, or left some time ago."""
        sent_ns, due_ns = self._sent_ns(first), self._clock_ns() + left_ns
        self._start(first, sent_ns, sent_ns + round((due_ns - sent_ns) / S_NS) * S_NS)

    def _sent_ns(self, first: Packet) -> int:
        """UTC at which a packet leaves by its own stamp, where it has one."""
        if not has_stamp(first):
            return first.due_ns
        moved(first, 0, first.due_ns)  # Python loads what parses dates in the first one's time, 3 ms
        made_ns = stamp_ns(first)
        hour_ns = (first.due_ns - age_ns(first) - made_ns + HOUR_NS // 2) // HOUR_NS * HOUR_NS
        return hour_ns + made_ns + age_ns(first)

    def _start(self, first: Packet, sent_ns: int, at_ns: int) -> None:
        self.moved_s, self.began_ns, self._ahead_ns = (at_ns - sent_ns) // S_NS, at_ns, at_ns - first.due_ns

    def send(self, packet: Packet) -> None:
        """Send one packet.

        Raises
        ------
        RunError
            as of the sink
        """
        self._sink.send(moved(packet, self.moved_s, packet.due_ns + self._ahead_ns))
