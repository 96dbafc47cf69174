"""The `[sensor]` and `[gps]` tables."""

from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator

from vlp16emu.scenario.section import NonNegative, Section

__all__ = ["Gps", "Sensor"]

Degrees = Annotated[float, Field(ge=0, lt=360)]


class Sensor(Section):
    """The lidar as it leaves the box and as it is set."""

    model: Literal["vlp-16", "puck-lite", "puck-hi-res"] = "vlp-16"
    """Beam table and factory byte."""
    rpm: Annotated[int, Field(ge=300, le=1200, multiple_of=60)] = 600
    """Rotor speed; multiples of 60 (63-9243 Rev D, section 8.3)."""
    return_mode: Literal["strongest", "last", "dual"] = "strongest"
    """Which echoes are sent."""
    min_range_m: Annotated[float, Field(ge=0.5, le=131.07)] = 0.5
    """Nearer targets are blanked; no real unit sends less than 0.5 m."""
    max_range_m: Annotated[float, Field(gt=0.5, le=131.07, validate_default=True)] = 100.0
    """Farther targets are lost; 100 m in the data sheet, 131.07 m is the largest code."""
    start_azimuth_deg: Degrees = 0.0
    """True rotor angle at the first firing."""
    eccentricity_deg: Annotated[float, Field(ge=0, le=1)] = 0.06
    """Amplitude of the encoder's once-per-revolution error; real units show 0.03 to 0.09. 0 switches it off."""
    eccentricity_phase_deg: Degrees = 40.0
    """Rotor angle at which that error crosses zero upwards."""
    azimuth_noise_deg: Annotated[float, Field(ge=0, le=0.02)] = 0.005
    """White error of each azimuth reading, one sigma. 0 switches it off."""
    powered_for_s: NonNegative = 0.0
    """Time since power-up when the run begins; without GPS the sensor's clock counts from power-up."""
    clock_error_ppm: Annotated[float, Field(ge=-100, le=100)] = 0.0
    """How much the free-running clock is fast; a clock locked to GPS has no such error."""
    position_rate: Literal["measured", "manual"] = "measured"
    """Position packets: 146 per second at the irregular spacing of real units, or the 53.8 of the manual."""

    @field_validator("max_range_m")
    @classmethod
    def _beyond_the_nearest(cls, max_range_m: float, info: ValidationInfo) -> float:
        nearest = info.data.get("min_range_m")  # absent where it is itself in error
        if nearest is not None and max_range_m <= nearest:
            raise ValueError(f"more than min_range_m = {nearest}")
        return max_range_m


class Gps(Section):
    """The GPS receiver wired to the sensor."""

    connected: bool = True
    """False: no pulse, no sentence, and the sensor's clock runs free from power-up."""
    latitude_deg: Annotated[float, Field(gt=-90, lt=90)] = 62.24
    """Latitude (WGS 84) of the scene's origin."""
    longitude_deg: Annotated[float, Field(ge=-180, le=180)] = 25.75
    """Longitude (WGS 84) of the scene's origin."""
    sentence_delay_s: Annotated[float, Field(gt=0, lt=1)] = 0.35
    """From the second's edge to the arrival of the sentence that names it."""
