"""What the sensor takes the time to be."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlp16emu.units import HOUR_NS

__all__ = ["Clock"]


@dataclass(frozen=True, slots=True)
class Clock:
    """The sensor's top-of-hour counter.

    Locked to GPS it shows nanoseconds past the UTC hour; without GPS it runs from power-up on its own
    oscillator and rolls over every 3600 s (63-9243 Rev D, appendix G). Before power-up it stands at zero: the stamp of a
    position packet is older than the packet, and so may fall before there is a clock.
    """

    locked: bool
    power_up_ns: int
    """UTC at which the free-running counter stood at zero."""
    error_ppm: float
    """How much the free-running counter is fast."""

    def reading_ns(self, t_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Nanoseconds past the counter's hour at UTC instants, any shape."""
        if self.locked:
            return np.asarray(t_ns % HOUR_NS)
        since = np.maximum(t_ns - self.power_up_ns, 0)
        if self.error_ppm:
            since = since + np.rint(since * (self.error_ppm * 1e-6)).astype(np.int64)
        return np.asarray(since % HOUR_NS)
