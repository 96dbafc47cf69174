"""The `[sensor]` table."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from ipaddress import IPv4Address
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self, get_args

from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from vlp16emu.errors import ScenarioError
from vlp16emu.models import MODEL_NAMES, model_table
from vlp16emu.settings import ExpectationError, OneOf, Preset, Seed
from vlp16emu.trees import Tree

if TYPE_CHECKING:  # reading a scene does not import numpy
    from vlp16emu.sensor.beams import BeamTable

Degrees = Annotated[float, Field(ge=0, lt=360)]
Port = Annotated[int, Field(ge=1, le=65_535)]

LEAST_RPM: int
MOST_RPM: int
LEAST_RPM, MOST_RPM = model_table("vlp-16")["motor"]["rpm"]  # the other models have the same
RPM_STEP = 60
"""Step of the speeds that a Puck can be set to (63-9243 Rev D, section 8.3, p. 50)."""
MOST_OFF_RPM = 3.0
"""Error of a held speed at 600 rpm, in proportion at other speeds (manuals of sibling models)."""
Rpm = Annotated[int, Field(ge=LEAST_RPM, le=MOST_RPM, multiple_of=RPM_STEP)]


def set_rpm(mean_rpm: float) -> int:
    """Return the speed that a rotor is set to, which turns at a mean speed.

    It is the nearest multiple of 60 that a held speed can be off by so much, else the nearest multiple of 10,
    else the nearest whole number, within the limits of a unit.
    """
    for step in (RPM_STEP, 10, 1):
        rpm = min(max(step * round(mean_rpm / step), LEAST_RPM), MOST_RPM)
        if abs(mean_rpm - rpm) * 600.0 <= MOST_OFF_RPM * rpm:
            break
    return rpm


ReturnModeName = Literal["strongest", "last", "dual"]
_WholeDegree = Annotated[int, Field(ge=0, le=359)]
Sector = Annotated[tuple[_WholeDegree, _WholeDegree], Field(strict=False)]
"""First and last azimuth, clockwise, in whole degrees."""
ALL_AROUND = 0, 359  # field of view of a whole revolution


_PRESETS: dict[str, dict[str, object]] = {
    "steady": {},
    # Measured on captures of real units: protocol/README.md, "The character of a unit".
    "unit": {
        "azimuth_noise_deg": 0.00145,
        "twice_per_turn_deg": 0.0078,
        "hum_deg": 0.0019,
        "rotation_spread": 0.45,
        "speed_error_rpm": 0.5,
        "speed_wander_rpm": 0.08,
    },
}


def _host_address(address: str) -> str:
    try:
        known = IPv4Address(address)
    except ValueError:
        known = IPv4Address(0)
    if known.is_unspecified or known.is_multicast or known.is_reserved:
        raise ExpectationError("the IPv4 address of a host, such as 192.168.1.201")
    return str(known)


Address = Annotated[str, AfterValidator(_host_address)]


class Lidar(Preset):
    """Keys of all lidars."""

    if TYPE_CHECKING:
        model: str
        rpm: int

    seed: Seed | None = None
    """Seed of the errors of this sensor, its GPS receiver and its inertial unit; the scene's seed if not
    set."""
    presets = _PRESETS

    preset: Literal["steady", "unit"] = "unit"
    """Values of all rotation errors that are not set: `unit` draws the differences between real units, has an
    encoder with lines, and a random state at the start; `steady` turns at constant speed, and power-up is the
    start of the run."""
    return_mode: ReturnModeName = "strongest"
    """Returns that are sent: the strongest, the last, or both."""
    min_range_m: Annotated[float, Field(ge=0.5, lt=131.07)] = 0.5
    """Nearer targets are blanked; no real unit sends less than 0.5 m."""
    max_range_m: Annotated[float, Field(gt=0.5, le=262.14, validate_default=True)] = 100.0
    """Farther targets are lost; 100 m in the data sheet of the VLP-16 and the HDL-32E, 200 m in that of the
    VLP-32C, 245 m of the VLS-128. The largest code is 131.07 m, and 262.14 m of the latter two."""
    start_azimuth_deg: Degrees | None = None
    """True rotor angle at the first firing; random if not set, and 0.1 with `steady`, just past north, so
    that a recording begins with a complete scan."""
    eccentricity_deg: Annotated[float, Field(ge=0, le=1)] = 0.06
    """Amplitude of the encoder's once-per-revolution error; real units show 0.03 to 0.09. 0 switches it
    off."""
    eccentricity_phase_deg: Degrees = 40.0
    """Rotor angle at which that error crosses zero upwards."""
    azimuth_noise_deg: Annotated[float, Field(ge=0, le=0.02)] = 0.005
    """White error of each azimuth reading, one sigma; for an encoder with lines, the time error of a line at
    600 rpm: 0.00145 is a uniform spread over 1.4 us, at all speeds. 0 switches it off."""
    encoder_rate_error: Annotated[float, Field(ge=0, le=0.5)] = 0.246
    """Relative deficit of the reading's speed between two encoder lines at 600 rpm, in some readings; in the
    others it is too high by 0.85 of this. 0.246 on real units, where both speeds are one of 3/8, 1/2, 5/8, 1,
    5/4 and 2 hundredths of a degree in 2.304 us."""
    twice_per_turn_deg: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    """Amplitude of the encoder's twice-per-revolution error; real units show 0.006 to 0.010. 0 switches it
    off."""
    hum_deg: Annotated[float, Field(ge=0, le=0.02)] = 0.0
    """Half the height of the sawtooth from sampling the encoder at ticks of 1.2 us, at 600 rpm; 0.0018 to
    0.002 on real units.
    0 switches it off."""
    rotation_spread: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Unit-to-unit spread of the amplitudes of these three errors, relative; above 0 their phases are random
    too."""
    speed_error_rpm: Annotated[float, Field(ge=-3, le=3)] = 0.0
    """Error of the mean speed at 600 rpm, one sigma, at most 1.9 of them, in proportion at other speeds;
    exact without `rotation_spread`, positive is fast. It swings over minutes; a phase lock removes it."""
    speed_wander_rpm: Annotated[float, Field(ge=0, le=3)] = 0.0
    """Amplitude of the change of speed within seconds, at 600 rpm, in proportion at other speeds."""
    powered_for_s: Annotated[float, Field(ge=0, le=1_000_000_000)] | None = None
    """Time since power-up when the run begins; without GPS the sensor's clock counts from power-up. Random if
    not set, and 0 with `steady`."""
    clock_error_ppm: Annotated[float, Field(ge=-200, le=200)] | None = None
    """Rate error of the free-running clock, positive is fast; a clock locked to GPS keeps up to 0.3 ppm
    within a second. Random if not set, and 0 with `steady`."""

    @field_validator("max_range_m")
    @classmethod
    def _beyond_the_nearest(cls, max_range_m: float, info: ValidationInfo) -> float:
        nearest = info.data.get("min_range_m")  # absent if it is itself invalid
        if nearest is not None and max_range_m <= nearest:
            raise ExpectationError(f"more than min_range_m = {nearest}")
        return max_range_m

    def beam_table(self) -> "BeamTable":
        """Return the directions and firing times of the lasers."""
        raise NotImplementedError

    @property
    def unit_noise(self) -> Mapping[str, object]:
        """Values of `[noise]` in the preset `unit` that differ from a VLP-16's."""
        return {}


if TYPE_CHECKING:
    _ModelName = str
else:
    _ModelName = Literal[MODEL_NAMES]  # a type checker reads no folder


class Sensor(Lidar):
    """A lidar whose packets are known, with its factory values and configuration."""

    either_or: ClassVar[frozenset[str]] = frozenset({"start_azimuth_deg", "phase_lock_deg"})

    model: _ModelName = "vlp-16"
    """Sensor model: beams, firing times and layout of packets (`protocol/models`). The character of other
    units than Pucks is not known, and is that of a VLP-16."""
    rpm: Annotated[int, Field(ge=LEAST_RPM, le=MOST_RPM)] = 600
    """Rotor speed. The manual has multiples of 60, as other speeds disturb speed control and phase lock
    (63-9243 Rev D, section 8.3); a real unit turns at 500. So any speed can be set here, but a phase lock,
    the web interface and events need a multiple of 60."""
    position_rate: Literal["measured", "manual"] = "measured"
    """Rate of position packets: 146 per second at the irregular spacing of real units, or 53.8 as in the
    manual."""
    phase_lock_deg: Degrees | None = None
    """True rotor angle at each UTC second (63-9243 Rev D, chapter 8), instead of `start_azimuth_deg`; needs
    GPS."""
    name: Annotated[str, Field(min_length=1)] = "unit_1"
    """Name in reports."""
    serial_number: Annotated[str, Field(pattern=r"^[0-9]{1,20}$")] = "11001000000001"
    """Serial number in digits, as on the label of a unit."""
    address: Address = "192.168.1.201"
    """IPv4 address of the unit (63-9243 Rev D, section 10.2.3.12)."""
    data_port: Port = 2368
    """Destination port of data packets (63-9243 Rev D, section 9.3.2)."""
    position_port: Port = 8308
    """Destination port of position packets (63-9243 Rev D, section 9.3.3)."""

    def beam_table(self) -> "BeamTable":
        """Return the beam table of the model."""
        from vlp16emu.sensor.beams import BEAM_TABLES
        from vlp16emu.types import SensorModel

        return BEAM_TABLES[SensorModel(self.model)]

    @property
    def unit_noise(self) -> Mapping[str, object]:
        """Values of `[noise]` in the preset `unit` that differ from a VLP-16's."""
        values: Mapping[str, object] = model_table(self.model).get("noise", {})
        return {key: value for key, value in values.items() if key != "source"}

    @model_validator(mode="after")
    def _has_a_code(self) -> Self:
        """Raise ValueError for a range beyond the model's largest distance code."""
        most_m = 65.535 * model_table(self.model)["packet"]["distance_mm"]
        if self.max_range_m > most_m:
            raise ExpectationError(
                f"at most {most_m:g} m as max_range_m, the largest distance code of {self.model}"
            )
        return self

    @model_validator(mode="after")
    def _starts_once(self) -> Self:
        if self.either_or <= self.model_fields_set:
            raise ExpectationError("start_azimuth_deg or phase_lock_deg in it, not both")
        return self

    @model_validator(mode="after")
    def _locks_whole_turns(self) -> Self:
        if self.phase_lock_deg is not None and self.rpm % RPM_STEP:
            raise ExpectationError(f"a multiple of {RPM_STEP} as rpm, which phase_lock_deg needs")
        return self

    @model_validator(mode="after")
    def _has_two_ports(self) -> Self:
        """Raise ValueError for equal ports: receivers separate data from position packets by port."""
        if self.data_port == self.position_port:
            raise ExpectationError("a data_port and a position_port that differ")
        return self


@dataclass(frozen=True)
class SensorSettings:
    """Settings that events and the web interface change during a run; types and limits hold for both."""

    rpm: Rpm = 600
    """Speed of the rotor; other speeds disturb speed control and phase lock (63-9243 Rev D, section 8.3)."""
    return_mode: ReturnModeName = "strongest"  # echoes that are sent
    laser: bool = True  # False: no data packets, only position packets
    fov_deg: Sector = ALL_AROUND  # first and last azimuth that is sent
    phase_lock_deg: Degrees | Literal["off"] = "off"
    """Rotor angle at each pulse of the GPS receiver."""

    @classmethod
    def of(cls, section: Lidar) -> "SensorSettings":
        """Return the settings at power-up."""
        phase_deg = section.phase_lock_deg if isinstance(section, Sensor) else None
        return cls(section.rpm, section.return_mode, phase_lock_deg="off" if phase_deg is None else phase_deg)

    @property
    def is_locked(self) -> bool:
        """True if the rotor is in phase with the pulse: at a speed that has whole revolutions per second."""
        return self.phase_lock_deg != "off" and self.rpm % RPM_STEP == 0

    def changes_from(self, before: "SensorSettings") -> Tree:
        """Return the settings that differ from others, by name."""
        names = [field.name for field in fields(SensorSettings)]
        return {name: getattr(self, name) for name in names if getattr(self, name) != getattr(before, name)}


AnySensor = Annotated[Lidar, OneOf(Lidar, "sensors", "model", "vlp-16")]
"""The `[sensor]` table."""


def require_packets(sensor: Lidar) -> Sensor:
    """Return a sensor that has packets.

    Raises ScenarioError if it has none.
    """
    if not isinstance(sensor, Sensor):
        *others, last = (f'"{name}"' for name in get_args(Sensor.model_fields["model"].annotation))
        names = f"{', '.join(others)} or {last}"
        raise ScenarioError(
            "sensor.model",
            f'found "{sensor.model}", which has no packets',
            f"{names}, or `vlp16emu points`, which writes what any sensor sees",
        )
    return sensor
