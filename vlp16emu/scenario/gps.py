"""The `[gps]` table."""

from typing import Annotated

from pydantic import Field

from vlp16emu.settings import Section

__all__ = ["Gps"]

_Metres = Annotated[float, Field(ge=0, le=1000)]


class Gps(Section):
    """The GPS receiver wired to the sensor, and how well it knows where it is.

    Of the errors, those under open sky follow a receiver for cars (Garmin GPS 16x, 190-00228-08 Rev. C, section
    1.5.4.4: 3 m in 95 % of all cases with WAAS, and 0.1 knot); how they are split and what trees do to them
    are assumptions.
    """

    connected: bool = True
    """False: no pulse, no sentence, and the sensor's clock runs free from power-up."""
    latitude_deg: Annotated[float, Field(gt=-90, lt=90)] = 62.24
    """Latitude (WGS 84) of the scene's origin."""
    longitude_deg: Annotated[float, Field(ge=-180, le=180)] = 25.75
    """Longitude (WGS 84) of the scene's origin."""
    height_m: Annotated[float, Field(ge=-1000, le=9000)] = 0.0
    """Height of the scene's origin over the ellipsoid."""
    sentence_delay_s: Annotated[float, Field(gt=0, lt=1)] = 0.35
    """From the second's edge to the arrival of the sentence that names it."""
    antenna_above_m: Annotated[float, Field(ge=0, le=100)] = 0.2
    """Height of the antenna over the sensor, straight up."""
    position_noise_m: _Metres = 0.3
    """Error to the east and to the north that is new in each second, one sigma. 0 switches it off."""
    wander_m: _Metres = 1.2
    """Error to the east and to the north that changes slowly, one sigma. 0 switches it off."""
    wander_s: Annotated[float, Field(ge=1, le=1_000_000)] = 300.0
    """After this time 37 % of the wandering error is left."""
    velocity_noise_m_s: Annotated[float, Field(ge=0, le=100)] = 0.05
    """Error of the velocity to the east and to the north, one sigma. 0 switches it off."""
    canopy_loss: bool = True
    """Whether what hides the sky from the antenna makes errors grow and fixes fail."""
    canopy_error_factor: Annotated[float, Field(ge=1, le=100)] = 2.5
    """How many times greater errors are where the whole sky is hidden; in between in proportion to the cover."""
    canopy_half_cover: Annotated[float, Field(gt=0, le=1)] = 0.88
    """Cover, as a share of the sky, at which every second fix fails."""
    canopy_cover_width: Annotated[float, Field(gt=0, le=1)] = 0.05
    """That much more or less cover makes 73 % or 27 % of it (a logistic curve)."""
