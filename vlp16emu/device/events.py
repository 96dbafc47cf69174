"""The tables `[[events]]` of a scene: what is set on the sensor while it runs, and what goes wrong."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from vlp16emu.settings import Fraction, NonNegative, Positive, Section

_Degree = Annotated[int, Field(ge=0, le=359)]


class Event(Section):
    """Something that happens to a sensor at a time."""

    kind: str
    """What happens."""
    at_s: NonNegative
    """When it begins, since the first pulse."""
    unit: Annotated[int, Field(ge=1)] = 1
    """Sensor of the rig that it happens to, from 1."""


class LastingEvent(Event):
    """Something that happens to a sensor for a time."""

    duration_s: Positive | None = None
    """How long it lasts; until the end of the run where it is left out."""

    def lasts_at(self, since_s: float) -> bool:
        """Whether it lasts at a time since the first pulse."""
        return self.at_s <= since_s and (self.duration_s is None or since_s < self.at_s + self.duration_s)


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


class GpsEvent(LastingEvent):
    """Something that happens to what the GPS receiver sends to a sensor; sentences are those that would come meanwhile."""


class PpsLoss(GpsEvent):
    """Pulses that do not come."""

    kind: Literal["pps_loss"]
    """Selects a loss of the pulse per second."""


class VoidSentence(GpsEvent):
    """Sentences of status V, as of a receiver without a fix."""

    kind: Literal["void_sentence"]
    """Selects void sentences."""


class WrongSentence(GpsEvent):
    """Sentences that are garbled on the line, so that their checksum is wrong."""

    kind: Literal["wrong_sentence"]
    """Selects garbled sentences."""
    characters: Annotated[int, Field(ge=1, le=60)] = 1
    """Number of characters that are replaced."""


class LateSentence(GpsEvent):
    """Sentences that come late; one that comes after the next pulse names the wrong second."""

    kind: Literal["late_sentence"]
    """Selects late sentences."""
    by_s: Annotated[float, Field(gt=0, le=60)] = 0.5
    """Delay, beside `gps.sentence_delay_s`."""


class SentenceLoss(GpsEvent):
    """Sentences that do not come."""

    kind: Literal["missing_sentence"]
    """Selects missing sentences."""


class PacketEvent(LastingEvent):
    """Something that befalls packets."""

    packets: Literal["data", "position", "both"] = "data"
    """Kinds of packets that it befalls."""
    count: Annotated[int, Field(ge=1)] | None = None
    """Number of packets of a kind, one after the other, that it may befall, in place of `duration_s`."""

    @model_validator(mode="after")
    def _ends_once(self) -> Self:
        if self.count is not None and self.duration_s is not None:
            raise ValueError("duration_s or count in it, not both")
        return self


class Freeze(PacketEvent):
    """A sensor that hangs: it sends the same payload again and again."""

    kind: Literal["freeze"]
    """Selects a hanging sensor."""


class Share(PacketEvent):
    """Something that befalls a share of packets."""

    share: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Probability with which it befalls each of them."""


class Drop(Share):
    """Packets that are lost."""

    kind: Literal["drop"]
    """Selects a loss of packets."""


class Duplicate(Share):
    """Packets that arrive twice."""

    kind: Literal["duplicate"]
    """Selects a repetition of packets."""
    after_s: Annotated[float, Field(ge=0, le=10)] = 0.0
    """From the first one to the second."""


class Reorder(Share):
    """Packets that later ones overtake."""

    kind: Literal["reorder"]
    """Selects a change of order."""
    by: Annotated[int, Field(ge=1, le=100)] = 1
    """Number of packets of its kind behind which one arrives."""


class Delay(Share):
    """Packets that are late by the same time, each by itself: those that are not delayed overtake them."""

    kind: Literal["delay"]
    """Selects a constant delay."""
    by_s: Annotated[float, Field(gt=0, le=10)] = 0.05
    """How late they are."""


class Jitter(Share):
    """Packets that are late by a random time, in a queue: none overtakes another of its kind."""

    kind: Literal["jitter"]
    """Selects a random delay."""
    up_to_s: Annotated[float, Field(gt=0, le=10)] = 0.02
    """How late they are at most; all delays up to it are equally likely."""


class Corrupt(Share):
    """Packets with flipped bits, in the sensor: checksums are those of the wrong bytes."""

    kind: Literal["corrupt"]
    """Selects flipped bits."""
    bits: Annotated[int, Field(ge=1, le=4096)] = 8
    """Number of bits that are flipped in a packet."""


class Truncate(Share):
    """Packets whose payload is cut."""

    kind: Literal["truncate"]
    """Selects cut packets."""
    to_bytes: Annotated[int, Field(ge=0, le=1205)] = 600
    """Bytes of the payload that are left."""


class HttpError(LastingEvent):
    """A web interface that answers every request with an error, or not at all; only of a stream that has one."""

    kind: Literal["http_error"]
    """Selects an error of the web interface."""
    status: Annotated[int, Field(ge=400, le=599)] | None = None
    """Status of the answers; no answer where it is left out."""


AnyEvent = Annotated[
    Setting
    | Wobble
    | MotorStop
    | PowerCycle
    | DeadLaser
    | DirtyWindow
    | Oscillator
    | PpsLoss
    | VoidSentence
    | WrongSentence
    | LateSentence
    | SentenceLoss
    | Drop
    | Duplicate
    | Reorder
    | Delay
    | Jitter
    | Corrupt
    | Truncate
    | Freeze
    | HttpError,
    Field(discriminator="kind"),
]
"""A table of `[[events]]`."""
