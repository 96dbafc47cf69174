"""What is between a laser and the world: a dirty window, a laser that is dead."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from vlp16emu.scenario.events import DeadLaser, DirtyWindow, Event, LastingEvent
from vlp16emu.types import Firings, Hits, Returns
from vlp16emu.units import seconds_to_ns


@dataclass(frozen=True, slots=True)
class Optics:
    """Lasers that are dead and sectors of the window that are dirty, over time; in most runs nothing."""

    dead: tuple[DeadLaser, ...]
    dirty: tuple[DirtyWindow, ...]
    start_ns: int
    """UTC of the first pulse."""

    @classmethod
    def of(cls, events: Sequence[Event], start_ns: int) -> Self:
        """Take them from the events of a unit."""
        return cls(
            tuple(event for event in events if isinstance(event, DeadLaser)),
            tuple(event for event in events if isinstance(event, DirtyWindow)),
            start_ns,
        )

    def dimmed(self, firings: Firings, hits: Hits) -> Hits:
        """Take from the light of each pulse what a dirty window keeps, twice: it goes as the cosine of incidence does."""
        if not self.dirty:
            return hits
        passes = np.ones(firings.t_ns.shape, np.float32)
        for event in self.dirty:
            begin, end = event.sector_deg
            a = firings.azimuth_deg
            inside = (a >= begin) & (a <= end) if begin <= end else (a >= begin) | (a <= end)
            passes[inside & self._lasts(event, firings)] *= event.transmission * event.transmission
        return replace(hits, cos_incidence=hits.cos_incidence * np.repeat(passes, hits.count.reshape(-1)))

    def received(self, returns: Returns) -> Returns:
        """Take away the returns of dead lasers."""
        for event in self.dead:
            lost = self._lasts(event, returns.firings)[:, event.laser]
            returns.distance_m[lost, event.laser] = 0.0
            returns.reflectivity[lost, event.laser] = 0
        return returns

    def _lasts(self, event: LastingEvent, firings: Firings) -> NDArray[np.bool_]:
        """Which pulses (k, L) an event lasts for."""
        begin_ns = self.start_ns + seconds_to_ns(event.at_s)
        during = firings.t_ns >= begin_ns
        if event.duration_s is not None:
            during &= firings.t_ns < begin_ns + seconds_to_ns(event.duration_s)
        return np.asarray(during)
