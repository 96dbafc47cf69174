"""What happens to packets that are too late, and the record of when a stream fell behind."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from vlp16emu.units import S_NS

__all__ = ["TOLERANCE_NS", "DelayLog", "FellBehind", "Late"]

TOLERANCE_NS = 50_000_000
"""Lateness up to which a stream is not behind: half a revolution at 600 rpm. Pauses of 5 to 40 ms are common where
other programs want the same cores; the usual receive buffer of Linux, 208 KiB, holds 120 ms of packets."""

_SETTLED_NS = 5 * S_NS
"""Without a packet that is too late for so long, the next one is another time that the stream fell behind."""


class Late(StrEnum):
    """What happens to a packet that is late by more than the tolerance."""

    PACE = "pace"
    """It leaves, and the deadlines of all later ones move by as much: the delay stays."""
    SKIP = "skip"
    """It is dropped."""


@dataclass(slots=True)
class FellBehind:
    """One time that a stream fell behind; grows while it lasts."""

    at_s: float
    """Deadline of the first packet that was too late, from the start of the stream."""
    behind_s: float
    """Lateness of that packet."""
    engine: bool
    """The packet was not computed in time; else it was ready, and the process stood still or could not send."""
    engine_speed: float | None
    """Simulated seconds per second that the engine computed since it was last ahead; None where that is unknown."""
    total_s: float = 0.0
    """Delay that came of it so far, with `pace`; greatest lateness, with `skip`."""


class DelayLog:
    """Times that a stream fell behind.

    Parameters
    ----------
    late : how lateness adds up
    notify : called at once, each time that the stream falls behind
    """

    def __init__(self, late: Late, notify: Callable[[FellBehind], None]) -> None:
        self._late, self._notify = late, notify
        self._last_ns = 0
        self.times: list[FellBehind] = []

    def overdue(self, late_ns: int, deadline_ns: int, *, engine_speed: float | None) -> None:
        """Notify at once that a packet is late which the engine has still not computed; its delay comes with it."""
        self._time(late_ns, deadline_ns, engine=True, engine_speed=engine_speed)

    def add(self, late_ns: int, deadline_ns: int, *, engine: bool, engine_speed: float | None) -> None:
        """Record a packet that is late by more than the tolerance; its deadline counts from the start."""
        late_s = late_ns / S_NS
        time = self._time(late_ns, deadline_ns, engine=engine, engine_speed=engine_speed)
        time.total_s = time.total_s + late_s if self._late is Late.PACE else max(time.total_s, late_s)

    def _time(
        self, late_ns: int, deadline_ns: int, *, engine: bool, engine_speed: float | None
    ) -> FellBehind:
        """Give the time that lasts, or begin one and notify of it."""
        now_ns = deadline_ns + late_ns
        is_new = not self.times or now_ns - self._last_ns > _SETTLED_NS
        self._last_ns = now_ns
        if is_new:
            self.times.append(FellBehind(deadline_ns / S_NS, late_ns / S_NS, engine, engine_speed))
            self._notify(self.times[-1])
        elif engine:
            self.times[-1].engine_speed = engine_speed
        return self.times[-1]
