"""The table `[sensor]` of a sensor with any beam table."""

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator

from vlp16emu.sensor.settings import Lidar
from vlp16emu.settings import ExpectationError
from vlp16emu.units import S_NS

if TYPE_CHECKING:  # scenes are read without numpy
    from vlp16emu.sensor.beams import BeamTable

Elevation = Annotated[float, Field(gt=-90, lt=90)]


class FreeSensor(Lidar):
    """A spinning lidar with any beam table. It has no packets, only points."""

    model: Literal["free"]
    """Selects a sensor with any beam table, without packets."""
    elevations_deg: Annotated[tuple[Elevation, ...], Field(strict=False)] = ()
    """Elevation of each laser in order of firing, instead of `beams` and `vertical_fov_deg`."""
    beams: Annotated[int, Field(ge=1, le=1024)] = 16
    """Number of lasers, evenly spaced over the field of view, lowest first; a single laser is in its
    middle."""
    vertical_fov_deg: Annotated[tuple[Elevation, Elevation], Field(strict=False)] = (-15.0, 15.0)
    """Elevations of the lowest and the highest laser."""
    azimuth_resolution_deg: Annotated[float, Field(ge=0.05, le=2)] = 0.2
    """Rotor angle between firing sequences."""
    rpm: Annotated[int, Field(ge=60, le=3600)] = 600
    """Rotor speed."""
    lens_radius_m: Annotated[float, Field(ge=0, le=0.2)] = 0.0
    """Distance from the spin axis to the point through which all beams pass; with 0 they begin on the
    axis."""

    @field_validator("beams", "vertical_fov_deg")
    @classmethod
    def _said_once(cls, value: object, info: ValidationInfo) -> object:
        if info.data.get("elevations_deg"):
            raise ExpectationError("nothing, as elevations_deg names every beam")
        return value

    @field_validator("vertical_fov_deg")
    @classmethod
    def _check_order(cls, vertical_fov_deg: tuple[float, float]) -> tuple[float, float]:
        if vertical_fov_deg[0] >= vertical_fov_deg[1]:
            raise ExpectationError("the lower elevation first")
        return vertical_fov_deg

    @property
    def beam_elevations_deg(self) -> tuple[float, ...]:
        """Elevation of each laser in order of firing."""
        low, high = self.vertical_fov_deg
        if self.elevations_deg or self.beams == 1:
            return self.elevations_deg or ((low + high) / 2,)
        return tuple(low + (high - low) * i / (self.beams - 1) for i in range(self.beams))

    def beam_table(self) -> "BeamTable":
        """Return a table of lasers that fire once per azimuth step, at equal intervals.

        Intervals are to the nearest nanosecond.

        All beams pass through one point of the lens.
        """
        import numpy as np

        from vlp16emu.elementary import tan
        from vlp16emu.sensor.beams import table_of

        elevation_deg = self.beam_elevations_deg
        radius_m = self.lens_radius_m
        sequence_ns = round(self.azimuth_resolution_deg / (6 * self.rpm) * S_NS)
        # where lines through the lens meet the axis
        offset_m = -radius_m * tan(np.radians(np.array(elevation_deg)))
        firing_ns = np.arange(len(elevation_deg), dtype=np.int64) * (sequence_ns // len(elevation_deg))
        return table_of(elevation_deg, offset_m, radius_m, sequence_ns, firing_ns)
