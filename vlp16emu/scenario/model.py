"""The scenario file as a frozen tree. Defaults live here and nowhere else."""

from datetime import UTC, datetime
from typing import Annotated, Any, Literal

from pydantic import (
    AwareDatetime,
    BeforeValidator,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ValidationInfo,
    field_validator,
)
from pydantic_core import CoreSchema, core_schema

from vlp16emu.doors import door, has_door
from vlp16emu.errors import InputError
from vlp16emu.motion import Gps, Imu, MotionSection
from vlp16emu.raycast import Beam
from vlp16emu.returns import Detector, Noise, Weather
from vlp16emu.scenario.capture import CaptureClock
from vlp16emu.scenario.rig import RigUnit, completed
from vlp16emu.sensor import AnySensor, FreeSensor, Sensor
from vlp16emu.settings import OneOf, Section, Seed
from vlp16emu.units import S_NS, US_NS
from vlp16emu.world import People, Wind, WorldSection

_FIRST_START = datetime(1970, 1, 1, tzinfo=UTC)
_NO_START = datetime(2106, 1, 1, tzinfo=UTC)
"""Seconds of a pcap file are 32 bits without sign and end 37 days later, farther off than any run reaches."""


def _from_text(start: Any) -> Any:
    try:
        return datetime.fromisoformat(start) if isinstance(start, str) else start
    except ValueError:
        return start


class _Events:
    """The type of `events`: what can happen is loaded by the first scene in which something does."""

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_before_validator_function(cls._checked, handler(list[Any]))

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> Any:
        return handler(door("events_schema")().core_schema if has_door("events_schema") else schema)

    @staticmethod
    def _checked(tables: Any, info: ValidationInfo) -> Any:
        return tables if tables == [] else door("events_of_scene")(tables, info.data)


class Scenario(Section):
    """Everything that decides the bytes of a run."""

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    """Version of this file format."""
    title: str = "scene"
    """One line that reports and pictures show; the name of the file unless given."""
    seed: Seed = 1
    """Seed of all random numbers: the same scenario and seed give the same bytes. `world.seed`, `motion.seed` and `sensor.seed`
    take its place for the stand, the walk and the sensor."""
    start_utc: Annotated[AwareDatetime, BeforeValidator(_from_text)] = datetime(2026, 5, 20, 9, 0, tzinfo=UTC)
    """When the first pulse is fired, from 1970 to 2105. Within a whole second the instant is drawn, unless `sensor.preset` is `steady`; one
    with a fraction of a second is kept."""
    duration_s: Annotated[float, Field(gt=0, le=7 * 86400)] = 10.0
    """Length of a recording, unless the command gives another."""
    sensor: AnySensor = Sensor()
    """The sensor; with `model = "free"` one of any beam table."""
    beam: Beam = Beam()
    detector: Detector = Detector()
    noise: Noise = Noise()
    weather: Weather = Weather()
    gps: Gps = Gps()
    capture: CaptureClock = CaptureClock()
    motion: Annotated[MotionSection, OneOf(MotionSection, "motions")]
    """How the sensor moves."""
    imu: Imu | None = None
    """An inertial measurement unit beside the sensor; its samples are part of the truth."""
    rig: Annotated[list[RigUnit], Field(max_length=253, default_factory=list)]
    """Further sensors on the same carrier, numbered from 2; that of `[sensor]` is unit 1."""
    events: Annotated[list[Any], _Events, Field(default_factory=list)]
    """What is set on the sensors while they run, and what goes wrong."""
    world: Annotated[WorldSection, OneOf(WorldSection, "worlds")]
    """What the sensor sees."""
    wind: Wind | None = None
    """What makes the trees sway; none in a hall."""
    people: People | None = None
    """People beside a carrier who walks; none without it."""
    conditions: Literal["perfect", "field"] = "perfect"
    """`field` gives the keys that make a real walk harder, where they are not given: errors of the extrinsics, a `mast` that
    bends, `imu.preset = "field"`, a light wind in a forest, and `people`."""

    @field_validator("start_utc")
    @classmethod
    def _fits_a_capture(cls, start_utc: datetime) -> datetime:
        if not _FIRST_START <= start_utc < _NO_START:
            raise ValueError("a time from 1970 to 2105, as captures can be stamped with")
        return start_utc

    @field_validator("gps")
    @classmethod
    def _keeps_the_phase(cls, gps: Gps, info: ValidationInfo) -> Gps:
        if _is_locked(info.data.get("sensor")) and not gps.connected:
            raise ValueError("connected = true, whose pulse sensor.phase_lock_deg needs")
        return gps

    @field_validator("rig", mode="before")
    @classmethod
    def _like_the_first(cls, tables: Any, info: ValidationInfo) -> Any:
        first = info.data.get("sensor")  # absent where it is itself in error
        if isinstance(first, FreeSensor) and tables:
            raise ValueError('none beside sensor.model = "free", which has no packets')
        if not isinstance(first, Sensor) or not isinstance(tables, list):
            return tables
        return [completed(table, first, place) for place, table in enumerate(tables, start=1)]

    @field_validator("rig")
    @classmethod
    def _distinct(cls, rig: list[RigUnit], info: ValidationInfo) -> list[RigUnit]:
        first = info.data.get("sensor")
        units = [first, *rig] if isinstance(first, Sensor) else rig
        for key in ("name", "serial_number", "address"):
            if len({getattr(unit, key) for unit in units}) < len(units):
                raise ValueError(f"{key} of its own for each unit, that of [sensor] included")
        if {unit.data_port for unit in units} & {unit.position_port for unit in units}:
            raise ValueError("a data_port that is no unit's position_port, that of [sensor] included")
        gps = info.data.get("gps")
        if gps is not None and not gps.connected and any(map(_is_locked, rig)):
            raise ValueError("no phase_lock_deg in it without the pulse of gps.connected = true")
        return rig

    @field_validator("wind")
    @classmethod
    def _has_trees(cls, wind: Wind | None, info: ValidationInfo) -> Wind | None:
        world = info.data.get("world")
        if wind is not None and world is not None and not world.has_trees:
            raise ValueError("none in a hall, which has no trees")
        return wind

    @field_validator("people")
    @classmethod
    def _goes_on_foot(cls, people: People | None, info: ValidationInfo) -> People | None:
        motion = info.data.get("motion")
        if people is not None and motion is not None and motion.kind != "walk":
            raise ValueError("none beside a motion that is no walk")
        return people

    @property
    def world_seed(self) -> int:
        """Seed of what the sensor sees."""
        return self._seed_of(self.world)

    @property
    def motion_seed(self) -> int:
        """Seed of how the carrier moves."""
        return self._seed_of(self.motion)

    @property
    def sensor_seed(self) -> int:
        """Seed of the first sensor and of the instruments beside it."""
        return self._seed_of(self.sensor)

    def _seed_of(self, section: Section) -> int:
        own: int | None = getattr(section, "seed", None)
        return self.seed if own is None else own

    @property
    def start_ns(self) -> int:
        """UTC of the first pulse, ns since 1970."""
        from vlp16emu.random import Purpose, uniform  # here: a scene is read without numba

        since = self.start_utc.astimezone(UTC) - _FIRST_START
        within_ns = since.microseconds * US_NS
        if not within_ns and self.sensor.preset == "unit":
            within_ns = int(uniform(self.sensor_seed, Purpose.POWER_UP, 0, 1, 3)[0] * S_NS)
        return (since.days * 86400 + since.seconds) * S_NS + within_ns

    def span_s(self, start_s: float, duration_s: float | None, *, where: str = "start_s") -> tuple[float, float]:
        """Return begin and end of a run, in seconds since the first pulse; without a duration it ends with the scene.

        Raises
        ------
        InputError
            If the run would begin after the end of the scene; `where` is the name of its begin in the error
        """
        if duration_s is not None:
            return start_s, start_s + duration_s
        if start_s >= self.duration_s:
            expected = f"less than the scene's {self.duration_s:g} s, or a {where.replace('start', 'duration')}"
            raise InputError(where, f"found {start_s:g}", expected)
        return start_s, self.duration_s


def _is_locked(sensor: Sensor | FreeSensor | None) -> bool:
    return isinstance(sensor, Sensor) and sensor.phase_lock_deg is not None
