"""The tables `[[events]]` of a scene: what is set on the sensor while it runs, and what goes wrong."""

from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from vlp16emu.settings import Fraction, NonNegative, Positive, Section

_Degree = Annotated[int, Field(ge=0, le=359)]
_KINDS: list[Any] = []
"""Events that a scene can name, in the order of this file."""


class Event(Section):
    """Something that happens to a sensor at a time."""

    kind: str
    """What happens."""
    at_s: NonNegative
    """When it begins, since the first pulse."""
    unit: Annotated[int, Field(ge=1)] = 1
    """Sensor of the rig that it happens to, from 1."""

    def __init_subclass__(cls, kind: str = "", selects: str = "", **rest: Any) -> None:
        """Make the word `kind` select the class, which `selects` describes."""
        super().__init_subclass__(**rest)
        if kind:
            words = Field(description=f"Selects {selects}.")
            cls.__annotations__["kind"] = Annotated[Literal[kind], words]
            _KINDS.append(cls)


class LastingEvent(Event):
    """Something that happens to a sensor for a time."""

    duration_s: Positive | None = None
    """How long it lasts; until the end of the run where it is left out."""

    def lasts_at(self, since_s: float) -> bool:
        """Whether it lasts at a time since the first pulse."""
        return self.at_s <= since_s and (self.duration_s is None or since_s < self.at_s + self.duration_s)


class Setting(Event, kind="setting", selects="a change of settings"):
    """A change of settings, as the web interface of the sensor makes it; keys that are left out stay as they are."""

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


class Wobble(LastingEvent, kind="rpm_wobble", selects="a wobbling rotor"):
    """A speed that is not held: a sine on top of it."""

    amplitude_rpm: Annotated[float, Field(gt=0, le=100)] = 6.0
    """Greatest difference from the speed that is set."""
    period_s: Annotated[float, Field(ge=0.05, le=1000)] = 1.0
    """Time from one greatest speed to the next."""


class MotorStop(LastingEvent, kind="motor_stop", selects="a stopping rotor"):
    """A rotor that runs down, and up again afterwards."""


class PowerCycle(Event, kind="power_cycle", selects="a loss of power"):
    """Power that is lost and comes back; unsaved settings are lost."""

    off_s: Annotated[float, Field(gt=0, le=3600)] = 5.0
    """How long nothing is sent: power off, and start of the sensor."""


class DeadLaser(LastingEvent, kind="dead_laser", selects="a dead laser"):
    """A laser that emits nothing."""

    laser: Annotated[int, Field(ge=0, le=15)]
    """Its number in order of firing, from 0."""


class DirtyWindow(LastingEvent, kind="dirty_window", selects="a dirty window"):
    """Dirt on a sector of the window."""

    sector_deg: Annotated[tuple[_Degree, _Degree], Field(strict=False)]
    """Azimuths from which and to which it is dirty, clockwise."""
    transmission: Fraction = 0.3
    """Share of the light that passes, on each of its two ways."""


class Oscillator(Event, kind="oscillator", selects="an error of the oscillator"):
    """A step and a drift of the clock that runs without GPS."""

    offset_us: Annotated[float, Field(ge=-1e9, le=1e9)] = 0.0
    """By which the clock is fast from then on."""
    drift_ppm: Annotated[float, Field(ge=-1000, le=1000)] = 0.0
    """By which it runs fast from then on."""


class GpsEvent(LastingEvent):
    """Something that happens to what the GPS receiver sends to a sensor; sentences are those that would come meanwhile."""


class PpsLoss(GpsEvent, kind="pps_loss", selects="a loss of the pulse per second"):
    """Pulses that do not come."""


class VoidSentence(GpsEvent, kind="void_sentence", selects="void sentences"):
    """Sentences of status V, as of a receiver without a fix."""


class WrongSentence(GpsEvent, kind="wrong_sentence", selects="garbled sentences"):
    """Sentences that are garbled on the line, so that their checksum is wrong."""

    characters: Annotated[int, Field(ge=1, le=60)] = 1
    """Number of characters that are replaced."""


class LateSentence(GpsEvent, kind="late_sentence", selects="late sentences"):
    """Sentences that come late; one that comes after the next pulse names the wrong second."""

    by_s: Annotated[float, Field(gt=0, le=60)] = 0.5
    """Delay, beside `gps.sentence_delay_s`."""


class SentenceLoss(GpsEvent, kind="missing_sentence", selects="missing sentences"):
    """Sentences that do not come."""


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


class Share(PacketEvent):
    """Something that befalls a share of packets."""

    share: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Probability with which it befalls each of them."""


class Drop(Share, kind="drop", selects="a loss of packets"):
    """Packets that are lost."""


class Duplicate(Share, kind="duplicate", selects="a repetition of packets"):
    """Packets that arrive twice."""

    after_s: Annotated[float, Field(ge=0, le=10)] = 0.0
    """From the first one to the second."""


class Reorder(Share, kind="reorder", selects="a change of order"):
    """Packets that later ones overtake."""

    by: Annotated[int, Field(ge=1, le=100)] = 1
    """Number of packets of its kind behind which one arrives."""


class Delay(Share, kind="delay", selects="a constant delay"):
    """Packets that are late by the same time, each by itself: those that are not delayed overtake them."""

    by_s: Annotated[float, Field(gt=0, le=10)] = 0.05
    """How late they are."""


class Jitter(Share, kind="jitter", selects="a random delay"):
    """Packets that are late by a random time, in a queue: none overtakes another of its kind."""

    up_to_s: Annotated[float, Field(gt=0, le=10)] = 0.02
    """How late they are at most; all delays up to it are equally likely."""


class Corrupt(Share, kind="corrupt", selects="flipped bits"):
    """Packets with flipped bits, in the sensor: checksums are those of the wrong bytes."""

    bits: Annotated[int, Field(ge=1, le=4096)] = 8
    """Number of bits that are flipped in a packet."""


class Truncate(Share, kind="truncate", selects="cut packets"):
    """Packets whose payload is cut."""

    to_bytes: Annotated[int, Field(ge=0, le=1205)] = 600
    """Bytes of the payload that are left."""


class Freeze(PacketEvent, kind="freeze", selects="a hanging sensor"):
    """A sensor that hangs: it sends the same payload again and again."""


class HttpError(LastingEvent, kind="http_error", selects="an error of the web interface"):
    """A web interface that answers every request with an error, or not at all; only of a stream that has one."""

    status: Annotated[int, Field(ge=400, le=599)] | None = None
    """Status of the answers; no answer where it is left out."""


if TYPE_CHECKING:
    AnyEvent = Event
else:
    AnyEvent = Annotated[reduce(or_, _KINDS), Field(discriminator="kind")]
"""A table of `[[events]]`."""
