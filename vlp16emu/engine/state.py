"""State of one sensor over a run: set by the scene and its events, read by the sensor's parts."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, Self

from vlp16emu.engine.gps_input import GpsInput
from vlp16emu.sensor.clock import ClockEvent
from vlp16emu.sensor.operation import Operation
from vlp16emu.sensor.rotor import Wobble
from vlp16emu.sensor.settings import Lidar, SensorSettings
from vlp16emu.sensor.steps import Spans, Steps
from vlp16emu.types import Firings, Hits, Returns


class Optics(Protocol):
    """Dirty window and dead lasers."""

    def dim(self, firings: Firings, hits: Hits) -> Hits:
        """Attenuate the light of each pulse."""

    def without_dead_lasers(self, returns: Returns) -> Returns:
        """Remove the returns of dead lasers."""


@dataclass(frozen=True)
class SensorState:
    """Settings, power, GPS input and disturbances of a sensor, each a function of time."""

    operation: Steps[Operation]  # since the first pulse
    gps: GpsInput
    wobbles: tuple[Wobble, ...] = ()
    clock_events: tuple[ClockEvent, ...] = ()
    optics: Optics | None = None  # None for a clean window

    @classmethod
    def steady(cls, section: Lidar, gps: GpsInput) -> Self:
        """Return the state of a sensor that keeps the settings of its power-up."""
        return cls(Steps(((0, Operation(SensorSettings.of(section))),)), gps)

    @cached_property
    def silences(self) -> Spans:
        """Spans since the first pulse without power, in which no packet of any kind leaves."""
        return self.operation.where(lambda operation: not operation.is_powered)
