"""The tables `[[events]]` of a scene: settings of a sensor during a run, and faults."""

from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, Self, Union, get_type_hints

from pydantic import Field, TypeAdapter, create_model, model_validator

from vlp16emu.sensor.settings import Sector, Sensor, SensorSettings
from vlp16emu.settings import ExpectationError, Fraction, NonNegative, Positive, Section, toml
from vlp16emu.trees import Tree
from vlp16emu.units import FOREVER_NS, seconds_to_ns

_MOST_EVENTS = 10_000
_SETTINGS = get_type_hints(SensorSettings, include_extras=True)


class Event(Section):
    """An event of a sensor at a time; the row of its kind in `KINDS` names the other keys."""

    kind: str
    """Kind of the event."""
    at_s: NonNegative
    """Begin, since the first pulse."""
    unit: Annotated[int, Field(ge=1, le=254)] = 1
    """Number of the sensor in the rig, from 1."""

    if TYPE_CHECKING:

        def __getattr__(self, key: str) -> Any: ...

    @property
    def effect(self) -> str:
        """Effect of the event, as in `KINDS`."""
        return KINDS[self.kind].effect

    @property
    def begin_ns(self) -> int:
        """Begin, since the first pulse."""
        return seconds_to_ns(self.at_s)

    @property
    def end_ns(self) -> int:
        """End, since the first pulse; `begin_ns` for an event without duration."""
        duration_s = getattr(self, "off_s", getattr(self, "duration_s", 0.0))
        return FOREVER_NS if duration_s is None else seconds_to_ns(self.at_s + duration_s)

    @property
    def settings(self) -> Tree:
        """Settings that the event `setting` changes, fields of `SensorSettings`."""
        values = {name: getattr(self, name) for name in _SETTINGS}
        return {name: value for name, value in values.items() if value is not None}

    @property
    def is_random(self) -> bool:
        """True if it affects each packet with a probability below one."""
        return bool(getattr(self, "share", 1.0) < 1.0)

    @model_validator(mode="after")
    def _check_keys(self) -> Self:
        if self.kind == "setting" and not self.model_fields_set - {"kind", "at_s", "unit"}:
            raise ExpectationError(
                "at least one of rpm, return_mode, laser, fov_deg and phase_lock_deg in it"
            )
        if getattr(self, "count", None) is not None and self.duration_s is not None:
            raise ExpectationError("duration_s or count in it, not both")
        return self


def _number(number_type: type, **bounds: Any) -> Any:
    """Return the type of a number within bounds, as `pydantic.Field` names them."""
    return Annotated[number_type, Field(**bounds)]


_LASER_MEANING = "False: no data packets; position packets go on (63-9243 Rev D, section 10.1.2)."
_PHASE_LOCK_MEANING = "Rotor angle at each UTC second; `off` ends the phase lock."
_COUNT_MEANING = "Number of consecutive packets of a kind that it may affect, instead of `duration_s`."
KEYS: dict[str, tuple[Any, Any, str]] = {
    "duration_s": (Positive | None, None, "Duration; until the end of the run if not given."),
    "rpm": (_SETTINGS["rpm"] | None, None, "Rotor speed, which changes gradually."),
    "return_mode": (_SETTINGS["return_mode"] | None, None, "Echoes that are sent."),
    "laser": (_SETTINGS["laser"] | None, None, _LASER_MEANING),
    "fov_deg": (
        _SETTINGS["fov_deg"] | None,
        None,
        "First and last azimuth that is sent, whole degrees; (0, 359) is all around.",
    ),
    "phase_lock_deg": (_SETTINGS["phase_lock_deg"] | None, None, _PHASE_LOCK_MEANING),
    "amplitude_rpm": (_number(float, gt=0, le=100), 6.0, "Greatest difference from the set speed."),
    "period_s": (_number(float, ge=0.05, le=1000), 1.0, "Time from one greatest speed to the next."),
    "off_s": (
        _number(float, gt=0, le=3600),
        5.0,
        "Time without packets: power off, and start of the sensor.",
    ),
    "dead_laser.laser": (_number(int, ge=0, le=1023), ..., "Number of the laser in wire order, from 0."),
    "sector_deg": (Sector, ..., "First and last azimuth of the dirt, clockwise."),
    "transmission": (Fraction, 0.3, "Share of the light that passes, in each direction."),
    "offset_us": (
        _number(float, ge=-1e9, le=1e9),
        0.0,
        "Offset of the clock from then on, positive if fast.",
    ),
    "drift_ppm": (
        _number(float, ge=-1000, le=1000),
        0.0,
        "Rate error of the clock from then on, positive if fast.",
    ),
    "characters": (_number(int, ge=1, le=60), 1, "Number of characters that are replaced."),
    "late_sentence.by_s": (_number(float, gt=0, le=60), 0.5, "Delay, beside `gps.sentence_delay_s`."),
    "http_delay.by_s": (_number(float, gt=0, le=60), 5.0, "Time from a request to its answer."),
    "packets": (Literal["data", "position", "both"], "data", "Kinds of packets that it affects."),
    "count": (_number(int, ge=1, le=1_000_000_000) | None, None, _COUNT_MEANING),
    "share": (_number(float, gt=0, le=1), 1.0, "Probability for each packet."),
    "after_s": (_number(float, ge=0, le=10), 0.0, "Time from the first copy to the second."),
    "by": (_number(int, ge=1, le=100), 1, "Number of packets of its kind that overtake a packet."),
    "by_s": (_number(float, gt=0, le=10), 0.05, "Delay of the packets."),
    "up_to_s": (
        _number(float, gt=0, le=10),
        0.02,
        "Greatest delay; delays are uniformly distributed up to it.",
    ),
    "bits": (_number(int, ge=1, le=4096), 8, "Number of bits that are flipped in a packet."),
    "to_bytes": (_number(int, ge=0, le=1205), 600, "Remaining bytes of the payload."),
    "status": (
        _number(int, ge=400, le=599) | None,
        None,
        "HTTP status of the answers; no answer if not given.",
    ),
}
"""Type, default and meaning of each key; `...` if it is required, and `KIND.KEY` where two kinds differ."""


class Kind(NamedTuple):
    """A row of `KINDS`."""

    effect: Literal["settings", "rotor", "power", "clock", "optics", "gps", "packets", "web"]
    """Part of the sensor that the event affects."""
    keys: str  # names of `KEYS`, in addition to the keys of `Event`
    selects: str  # end of the sentence "Selects ..." about the kind
    meaning: str  # docstring of the kind


_TABLE = toml(files(__package__).joinpath("events.toml").read_text(encoding="utf-8"))
KINDS = {name: Kind(**row) for name, row in _TABLE.items()}
"""Kinds of events by name."""


@cache
def event_adapter() -> TypeAdapter[list[Event]]:
    """Build the pydantic type of `[[events]]`, with a class for each row of `KINDS`."""
    classes = []
    for name, kind in KINDS.items():
        keys: Tree = {"kind": (Literal[name], Field(description=f"Selects {kind.selects}."))}
        for key in kind.keys.split():
            value_type, default, meaning = KEYS.get(f"{name}.{key}") or KEYS[key]
            keys[key] = value_type, Field(default, description=meaning)
        classes.append(create_model(name, __base__=Event, __doc__=kind.meaning, **keys))
    alternatives: Any = Union[tuple(classes)]  # noqa: UP007  # one class per row
    event_type: Any = Annotated[alternatives, Field(discriminator="kind")]
    table_type: Any = Annotated[list[event_type], Field(max_length=_MOST_EVENTS)]
    return TypeAdapter(table_type)


def check_events(tables: object, scene: Tree) -> list[Event]:
    """Check the tables `[[events]]` of a scene, and return its events.

    Parameters
    ----------
    tables : list of tables
    scene : those of the scene's sections `sensor`, `rig` and `gps` that are valid

    Raises `pydantic.ValidationError` if a table is no event, `ExpectationError` if the scene cannot have it.
    """
    events = event_adapter().validate_python(tables)
    sensor, rig, gps = (scene.get(key) for key in ("sensor", "rig", "gps"))
    for number, event in enumerate(events):
        if rig is not None and event.unit > len(rig) + 1:
            raise ExpectationError(f"events[{number}].unit of at most {len(rig) + 1}, the units of the scene")
        if event.kind == "dead_laser" and sensor is not None and rig is not None:
            lasers = len([sensor, *rig][event.unit - 1].beam_table().elevation_deg)
            if event.laser >= lasers:
                raise ExpectationError(f"events[{number}].laser of at most {lasers - 1}, the sensor's lasers")
        if sensor is not None and not isinstance(sensor, Sensor) and event.effect != "optics":
            raise ExpectationError(
                f'no {event.kind} (events[{number}]) beside sensor.model = "{sensor.model}"'
            )
        if gps is not None and not gps.connected and event.effect == "gps":
            raise ExpectationError(f"gps.connected = true beside {event.kind} (events[{number}])")
    return events


def make_event(kind: str, at_s: float, unit: int = 1, **keys: object) -> Event:
    """Return an event of a unit, from 1."""
    return event_adapter().validate_python([{"kind": kind, "at_s": at_s, "unit": unit, **keys}])[0]
