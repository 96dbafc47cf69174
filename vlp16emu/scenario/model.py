"""The scenario file as a frozen tree, with its tables `[capture]` and `[[rig]]`.

All defaults are in the sections.
"""

import ast
import inspect
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from functools import cache
from ipaddress import IPv4Address
from itertools import pairwise
from typing import Annotated, Any, Literal, Protocol

from pydantic import (
    AwareDatetime,
    BaseModel,
    BeforeValidator,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    TypeAdapter,
    ValidationInfo,
    field_validator,
)
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from vlp16emu.doors import Part
from vlp16emu.errors import InputError
from vlp16emu.motion.settings import Gps, MotionSection, Mount
from vlp16emu.raycast.settings import Beam
from vlp16emu.returns import Detector, Noise, Weather
from vlp16emu.sensor.settings import AnySensor, Lidar, Sensor
from vlp16emu.settings import ExpectationError, LazySection, OneOf, Preset, Section, Seed, merge_tables
from vlp16emu.trees import Tree
from vlp16emu.units import S_NS, US_NS
from vlp16emu.world.settings import People, WorldSection

_FIRST_START = datetime(1970, 1, 1, tzinfo=UTC)
_NO_START = datetime(2106, 1, 1, tzinfo=UTC)
"""Latest start: unsigned 32-bit seconds of a pcap file end 37 days later, beyond any run."""


_HOSTS: dict[str, dict[str, object]] = {
    "ideal": {},
    # On the hosts of units A and B (protocol/README.md) half of all stamps are within 1 us of an even
    # spacing, and 6 % of B's are 10 to 230 us late.
    "quiet_pc": {"jitter_us": 1.3, "late_share": 0.06, "late_us": 60.0, "host_spread": 0.4},
    # Up to 640 us were seen; the distribution is an assumption.
    "busy_pc": {"jitter_us": 40.0, "late_share": 0.04, "late_us": 1500.0, "host_spread": 0.4},
}


class CaptureClock(Preset):
    """The clock of the recording host; only stamps of pcap files follow it."""

    presets = _HOSTS

    preset: Literal["ideal", "quiet_pc", "busy_pc"] = "quiet_pc"
    """Preset of the keys that are not given; `ideal` stamps packets when they are due."""
    ppm: Annotated[float, Field(ge=-100, le=100)] | None = None
    """Rate error of the host's clock, positive if fast; drawn unless given, as in captures of real units,
    where it is -15 to 20 against the sensor's. 0 with `ideal`."""
    ahead_ms: Annotated[float, Field(ge=-1000, le=1000)] | None = None
    """Offset of the host's clock at the first pulse, positive if ahead; drawn unless given, one sigma of 3 ms
    as for a host on NTP (assumption). 0 with `ideal`."""
    jitter_us: Annotated[float, Field(ge=0, le=500)] = 0.0
    """Delay of a stamp, one sigma of the half-normal distribution."""
    late_share: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    """Share of packets that the host handles late; the packets after them come in a burst."""
    late_us: Annotated[float, Field(ge=0, le=3000)] = 0.0
    """Mean of that delay, exponential, up to 4.5 ms."""
    host_spread: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Host-to-host spread of jitter, share and delay, one sigma of the logarithm; drawn from the
    seed. 0 for the exact values."""


_OWN = frozenset({"name", "serial_number", "address", "data_port", "position_port", "seed"})
"""Keys that are unique per unit and therefore not inherited from `[sensor]`."""


class RigUnit(Sensor):
    """A further sensor, which inherits the keys of `[sensor]` that are not given.

    Name, serial number, address and ports count up from `[sensor]`; a preset given here replaces the preset
    of `[sensor]`.
    """

    mount: Mount = Mount()
    """Mount on the carrier of `[motion]`; `motion.mount` belongs to `[sensor]`."""
    seed: Seed | None = None
    """Seed of its random errors; by default derived from the seed of `[sensor]`."""


def complete_unit(table: object, first: Sensor, place: int) -> object:
    """Return the table of a unit completed with keys from the first unit.

    Parameters
    ----------
    table : the user's table; other types are reported by the type check
    first : `[sensor]`
    place : number of the table, from 1
    """
    if not isinstance(table, dict):
        return table
    not_taken = _OWN | (Sensor.either_or if Sensor.either_or & table.keys() else frozenset())
    if "preset" in table:  # replaces all keys of the first unit's preset
        not_taken |= {key for values in Sensor.presets.values() for key in values}
    given = first.model_dump(exclude_unset=True, exclude=set(not_taken))
    counted = {
        "name": f"unit_{place + 1}",
        "serial_number": str(int(first.serial_number) + place).zfill(len(first.serial_number)),
        "address": str(IPv4Address(first.address) + place),
        "data_port": first.data_port + place,
        "position_port": first.position_port + place,
    }
    return merge_tables(counted | given, table)


def _from_text(start: object) -> object:
    try:
        return datetime.fromisoformat(start) if isinstance(start, str) else start
    except ValueError:
        return start


class Mounted(Protocol):
    """Section of a device on the carrier."""

    @property
    def mount(self) -> Mount:
        """Mount on the carrier as it is documented."""


class InertialSection(Mounted, Protocol):
    """Section of an inertial unit."""

    @property
    def rate_hz(self) -> int:
        """Samples per second."""

    @property
    def attitude(self) -> bool:
        """True if the unit also reports its attitude."""

    @property
    def is_late(self) -> bool:
        """True if its time stamps differ from the times of its samples."""


IMU_SECTION = Part[type[Section]]("vlp16emu.extras.imu.settings:Imu")
CAMERA_SECTION = Part[type[Section]]("vlp16emu.extras.camera.settings:Camera")
WIND_SECTION = Part[type[Section]]("vlp16emu.forest.settings:Wind")
EVENT_TABLES = Part[Callable[[], TypeAdapter[Any]]]("vlp16emu.extras.bench.events:event_adapter")
"""Type of `events`."""
CHECKED_EVENTS = Part[Callable[[object, Tree], object]]("vlp16emu.extras.bench.events:check_events")
"""Check of the events of a scene, which is given as the sections that are valid so far."""


class _Events:
    """The type of `events`, loaded by the first scene that has events."""

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_before_validator_function(cls._check, handler(list[Any]))

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return handler(EVENT_TABLES.load()().core_schema if EVENT_TABLES.is_installed else schema)

    @staticmethod
    def _check(tables: object, info: ValidationInfo) -> object:
        return tables if tables == [] else CHECKED_EVENTS.load()(tables, info.data)


class Scenario(Section):
    """A scenario, which determines the bytes of a run."""

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    """Version of this file format."""
    title: str = "scene"
    """Title in reports and pictures, one line; by default the name of the file."""
    seed: Seed = 1
    """Seed of all random numbers: the same scenario and seed give the same bytes. `world.seed`, `motion.seed`
    and `sensor.seed` replace it for the stand, the walk and the sensor."""
    start_utc: Annotated[AwareDatetime, BeforeValidator(_from_text)] = datetime(2026, 5, 20, 9, 0, tzinfo=UTC)
    """Time of the first pulse, from 1970 to 2105. For a whole second the instant within it is drawn, unless
    `sensor.preset` is `steady`; a time with a fraction of a second is exact."""
    duration_s: Annotated[float, Field(gt=0, le=7 * 86400)] = 10.0
    """Duration of a recording, unless the command gives another."""
    sensor: AnySensor = Sensor()
    """The sensor; `model = "free"` allows any beam table."""
    beam: Beam = Beam()
    detector: Detector = Detector()
    noise: Noise = Noise()
    weather: Weather = Weather()
    gps: Gps = Gps()
    capture: CaptureClock = CaptureClock()
    motion: Annotated[MotionSection, OneOf(MotionSection, "motions")]
    """Motion of the sensor."""
    imu: Annotated[InertialSection, LazySection(IMU_SECTION)] | None = None
    """An inertial measurement unit beside the sensor; its samples are part of the ground truth."""
    camera: Annotated[Mounted, LazySection(CAMERA_SECTION)] | None = None
    """A camera beside the sensor, whose images bags have."""
    rig: Annotated[list[RigUnit], Field(max_length=253, default_factory=list)]
    """Further sensors on the same carrier, numbered from 2; `[sensor]` is unit 1."""
    events: Annotated[list[Any], _Events, Field(default_factory=list)]
    """Changes of sensor settings during the run, and faults."""
    world: Annotated[WorldSection, OneOf(WorldSection, "worlds")]
    """World around the sensor."""
    wind: Annotated[Section, LazySection(WIND_SECTION)] | None = None
    """Wind that makes the trees sway; not in a hall."""
    people: People | None = None
    """People beside a walking carrier; none without this table."""
    conditions: Literal["perfect", "field"] = "perfect"
    """Preset; `field` sets some keys of a real walk unless given: errors of the extrinsics, a
    bending `mast`, `imu.preset = "field"` with stamps 20 ms late, steps as on uneven ground, straps that give
    (`harness`), a light wind in a forest, and `people`. It is a rig without mistakes,
    and no hard place: slopes, turns, undergrowth and rain stay those of the scene, no clock drifts, no stamps
    are of a sweep's end, and no packet is lost."""

    @field_validator("start_utc")
    @classmethod
    def _check_start_utc(cls, start_utc: datetime) -> datetime:
        if not _FIRST_START <= start_utc < _NO_START:
            raise ExpectationError("a time from 1970 to 2105, as captures can be stamped with")
        return start_utc

    @field_validator("gps")
    @classmethod
    def _check_phase_lock(cls, gps: Gps, info: ValidationInfo) -> Gps:
        if _is_locked(info.data.get("sensor")) and not gps.connected:
            raise ExpectationError("connected = true, whose pulse sensor.phase_lock_deg needs")
        return gps

    @field_validator("rig", mode="before")
    @classmethod
    def _completed_rig(cls, tables: object, info: ValidationInfo) -> object:
        first = info.data.get("sensor")  # absent if it is itself in error
        if not isinstance(first, Sensor) or not isinstance(tables, list):
            if first is not None and tables and not isinstance(first, Sensor):
                raise ExpectationError(f'none beside sensor.model = "{first.model}", which has no packets')
            return tables
        return [complete_unit(table, first, place) for place, table in enumerate(tables, start=1)]

    @field_validator("rig")
    @classmethod
    def _distinct(cls, rig: list[RigUnit], info: ValidationInfo) -> list[RigUnit]:
        first = info.data.get("sensor")
        units = [first, *rig] if isinstance(first, Sensor) else rig
        for key in ("name", "serial_number", "address"):
            if len({getattr(unit, key) for unit in units}) < len(units):
                raise ExpectationError(f"{key} of its own for each unit, [sensor] included")
        if {unit.data_port for unit in units} & {unit.position_port for unit in units}:
            raise ExpectationError("a data_port that is no unit's position_port, [sensor] included")
        gps = info.data.get("gps")
        if gps is not None and not gps.connected and any(map(_is_locked, rig)):
            raise ExpectationError("gps.connected = true, whose pulse phase_lock_deg needs")
        return rig

    @field_validator("wind")
    @classmethod
    def _check_wind(cls, wind: Section | None, info: ValidationInfo) -> Section | None:
        world = info.data.get("world")
        if wind is not None and world is not None and not world.has_trees:
            raise ExpectationError("none in a hall, which has no trees")
        return wind

    @field_validator("people")
    @classmethod
    def _check_people(cls, people: People | None, info: ValidationInfo) -> People | None:
        motion = info.data.get("motion")
        if people is not None and motion is not None and motion.kind != "walk":
            raise ExpectationError("none beside a motion that is no walk")
        return people

    @property
    def world_seed(self) -> int:
        """Seed of the world."""
        return self._seed_of(self.world)

    @property
    def motion_seed(self) -> int:
        """Seed of the carrier's motion."""
        return self._seed_of(self.motion)

    @property
    def sensor_seed(self) -> int:
        """Seed of the first sensor and of the other instruments."""
        return self._seed_of(self.sensor)

    def _seed_of(self, section: Section) -> int:
        own: int | None = getattr(section, "seed", None)
        return self.seed if own is None else own

    @property
    def start_ns(self) -> int:
        """UTC of the first pulse, ns since 1970."""
        from vlp16emu.random import Purpose, uniform  # here: scenes load without numba

        since = self.start_utc.astimezone(UTC) - _FIRST_START
        within_ns = since.microseconds * US_NS
        if not within_ns and self.sensor.preset == "unit":
            within_ns = int(uniform(self.sensor_seed, Purpose.POWER_UP, 0, 1, 3)[0] * S_NS)
        return (since.days * 86400 + since.seconds) * S_NS + within_ns

    def span_s(
        self, start_s: float, duration_s: float | None, *, where: str = "start_s"
    ) -> tuple[float, float]:
        """Return begin and end of a run, in seconds since the first pulse; by default it ends with the scene.

        Raises InputError if the run would begin after the end of the scene; `where` is the name of its begin
        in the error.
        """
        if duration_s is not None:
            return start_s, start_s + duration_s
        if start_s >= self.duration_s:
            expected = (
                f"less than the scene's {self.duration_s:g} s, or a {where.replace('start', 'duration')}"
            )
            raise InputError(where, f"found {start_s:g}", expected)
        return start_s, self.duration_s


def _is_locked(sensor: Lidar | None) -> bool:
    return isinstance(sensor, Sensor) and sensor.phase_lock_deg is not None


class _SceneSchema(GenerateJsonSchema):
    """JSON Schema without titles, which repeat the keys, and with docstrings as descriptions.

    Pydantic's `use_attribute_docstrings` would parse the source of all sections at each start, for 0.1 s.
    """

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        """Add the descriptions of a section's keys."""
        table = super().model_schema(schema)
        section = schema["cls"]
        for name, text in _docstrings(section).items():
            field = section.model_fields.get(name)
            if field is not None and field.description is None:
                table["properties"][field.alias or name]["description"] = text
        return table

    def field_title_should_be_set(self, schema: object) -> bool:  # noqa: ARG002  # pydantic's signature
        """Return False: titles would only repeat the keys."""
        return False


@cache
def schema() -> Tree:
    """Return the JSON Schema (draft 2020-12) of a scene file; read-only, as the object is shared."""
    tree = Scenario.model_json_schema(schema_generator=_SceneSchema)
    return {"$schema": GenerateJsonSchema.schema_dialect} | tree | {"title": "vlp16emu scene"}


def _docstrings(section: type[BaseModel]) -> dict[str, str]:
    """Return the strings that follow the keys of a section and of its base classes."""
    found: dict[str, str] = {}
    for owner in reversed(section.__mro__[: section.__mro__.index(BaseModel)]):
        # A class made from a table is not in the source and describes its keys itself.
        found |= _docstrings_of_classes(owner.__module__).get(owner.__qualname__, {})
    return found


@cache
def _docstrings_of_classes(module: str) -> dict[str, dict[str, str]]:
    """Return the docstrings of the keys of the classes of a module, by class; the source is parsed once."""
    try:
        source = inspect.getsource(sys.modules[module])
    except (OSError, TypeError):  # a module without a file
        return {}
    found: dict[str, dict[str, str]] = {}
    for body in ast.parse(source).body:
        if not isinstance(body, ast.ClassDef):
            continue
        keys = found.setdefault(body.name, {})
        for key, text in pairwise(body.body):
            match key, text:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(words))):
                    keys[name] = inspect.cleandoc(words)
    return found
