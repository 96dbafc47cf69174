"""What is between a laser and the world: a dirty window, a laser that is dead."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vlp16emu.extras.bench.events import Event
from vlp16emu.types import Firings, Hits, Returns


@dataclass(frozen=True, slots=True)
class DisturbedOptics:
    """Dead lasers and dirty sectors of the window, over time."""

    events: Sequence[Event]
    """Of the effect `optics`."""
    start_ns: int
    """UTC of the first pulse."""

    def dimmed(self, firings: Firings, hits: Hits) -> Hits:
        """Take from the light of each pulse what a dirty window keeps, twice: it goes as the cosine of incidence does."""
        passes = np.ones(firings.t_ns.shape, np.float32)
        for event in self.events:
            if event.kind == "dirty_window":
                begin, end = event.sector_deg
                a = firings.azimuth_deg
                inside = (a >= begin) & (a <= end) if begin <= end else (a >= begin) | (a <= end)
                passes[inside & self._during(event, firings)] *= event.transmission * event.transmission
        return replace(hits, cos_incidence=hits.cos_incidence * np.repeat(passes, hits.count.reshape(-1)))

    def received(self, returns: Returns) -> Returns:
        """Take away the returns of dead lasers."""
        for event in self.events:
            if event.kind == "dead_laser":
                lost = self._during(event, returns.firings)[:, event.laser]
                returns.distance_m[lost, event.laser] = 0.0
                returns.reflectivity[lost, event.laser] = 0
        return returns

    def _during(self, event: Event, firings: Firings) -> NDArray[np.bool_]:
        """(k, L) pulses that are fired while an event lasts."""
        since_ns = firings.t_ns - self.start_ns
        return np.asarray((since_ns >= event.begin_ns) & (since_ns < event.end_ns))
