"""The tables `[[events]]` of a scene: what is set on the sensor while it runs, and what goes wrong."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from vlp16emu.settings import Fraction, NonNegative, Positive, Section

__all__ = [
    "AnyEvent",
    "DeadLaser",
    "DirtyWindow",
    "Event",
    "LastingEvent",
    "MotorStop",
    "Oscillator",
    "PowerCycle",
    "Setting",
    "Wobble",
]

_Degree = Annotated[int, Field(ge=0, le=359)]


class Event(Section):
    """Something that happens to a sensor at a time."""

    at_s: NonNegative
    """When it begins, since the first pulse."""
    unit: Annotated[int, Field(ge=1)] = 1
    """Sensor of the rig that it happens to, from 1."""


class LastingEvent(Event):
    """Something that happens to a sensor for a time."""

    duration_s: Positive | None = None
    """How long it lasts; until the end of the run where it is left out."""


class Setting(Event):
    """A change of settings, as the web interface of the sensor makes it; keys that are left out stay as they are."""

    kind: Literal["setting"]
    """Selects a change of settings."""
    rpm: Annotated[int, Field(ge=300, le=1200, multiple_of=60)] | None = None
    """Rotor speed; the rotor takes its time to reach it."""
    return_mode: Literal["strongest", "last", "dual"] | None = None
    """Echoes that are sent."""
    laser: bool | None = None
    """False: no data packets; position packets go on (63-9243 Rev D, section 10.1.2)."""
    fov_deg: Annotated[tuple[_Degree, _Degree], Field(strict=False)] | None = None
    """First and last azimuth that is sent, in whole degrees; (0, 359) is all around."""
    phase_lock_deg: Annotated[float, Field(ge=0, lt=360)] | Literal["off"] | None = None
    """Rotor angle at each UTC second, which the rotor is turned to; `off` lets it run on."""

    @model_validator(mode="after")
    def _sets_something(self) -> Self:
        """Refuse a change of nothing."""
        if not self.model_fields_set - {"kind", "at_s", "unit"}:
            raise ValueError("at least one of rpm, return_mode, laser, fov_deg and phase_lock_deg in it")
        return self


class Wobble(LastingEvent):
    """A speed that is not held: a sine on top of it."""

    kind: Literal["rpm_wobble"]
    """Selects a wobbling rotor."""
    amplitude_rpm: Annotated[float, Field(gt=0, le=100)] = 6.0
    """Greatest difference from the speed that is set."""
    period_s: Annotated[float, Field(ge=0.05, le=1000)] = 1.0
    """Time from one greatest speed to the next."""


class MotorStop(LastingEvent):
    """A rotor that runs down, and up again afterwards."""

    kind: Literal["motor_stop"]
    """Selects a stopping rotor."""


class PowerCycle(Event):
    """Power that is lost and comes back; unsaved settings are lost."""

    kind: Literal["power_cycle"]
    """Selects a loss of power."""
    off_s: Annotated[float, Field(gt=0, le=3600)] = 5.0
    """How long nothing is sent: power off, and start of the sensor."""


class DeadLaser(LastingEvent):
    """A laser that emits nothing."""

    kind: Literal["dead_laser"]
    """Selects a dead laser."""
    laser: Annotated[int, Field(ge=0, le=15)]
    """Its number in order of firing, from 0."""


class DirtyWindow(LastingEvent):
    """Dirt on a sector of the window."""

    kind: Literal["dirty_window"]
    """Selects a dirty window."""
    sector_deg: Annotated[tuple[_Degree, _Degree], Field(strict=False)]
    """Azimuths from which and to which it is dirty, clockwise."""
    transmission: Fraction = 0.3
    """Share of the light that passes, on each of its two ways."""


class Oscillator(Event):
    """A step and a drift of the clock that runs without GPS."""

    kind: Literal["oscillator"]
    """Selects an error of the oscillator."""
    offset_us: Annotated[float, Field(ge=-1e9, le=1e9)] = 0.0
    """By which the clock is fast from then on."""
    drift_ppm: Annotated[float, Field(ge=-1000, le=1000)] = 0.0
    """By which it runs fast from then on."""


AnyEvent = Annotated[
    Setting | Wobble | MotorStop | PowerCycle | DeadLaser | DirtyWindow | Oscillator,
    Field(discriminator="kind"),
]
"""A table of `[[events]]`."""
