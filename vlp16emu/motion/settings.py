"""The tables `[motion]` and `[gps]` of a scene: the carrier of the sensor, its mount, and the GPS receiver.

This file has no kernel, so that a scene is read without the compiler.
"""

import math
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from vlp16emu.settings import Angle, ExpectationError, Place, Section, Size

if TYPE_CHECKING:  # scenes load without numpy
    from vlp16emu.motion.pose import Motion
    from vlp16emu.types import F8
    from vlp16emu.world.settings import Site

_Error = Annotated[float, Field(ge=0, le=1000)]
_Offset = Annotated[float, Field(ge=-10, le=10)]
_Component = Annotated[float, Field(ge=-1e6, le=1e6)]  # of a direction, of any length


class Mount(Section):
    """Extrinsics of a device on its carrier."""

    lever_arm_m: Annotated[tuple[_Offset, _Offset, _Offset], Field(strict=False)] = (0.0, 0.0, 0.0)
    """Lever arm: its origin in the carrier's frame, forward, left, up."""
    yaw_deg: Angle = 0.0
    """Counter-clockwise is positive."""
    pitch_deg: Angle = 0.0
    """Nose down is positive."""
    roll_deg: Angle = 0.0
    """Right side down is positive."""
    spin_hz: Annotated[float, Field(ge=-10, le=10)] = 0.0
    """Revolutions per second of the stage under it, as in handheld scanners; 0 for a fixed mount."""
    spin_axis: Annotated[tuple[_Component, _Component, _Component], Field(strict=False)] = (0.0, 0.0, 1.0)
    """Axis of the stage in the carrier's frame, through the device's origin."""
    error_deg: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Rotation of the true mount from this nominal one, about each axis, one sigma."""
    error_mm: Annotated[float, Field(ge=0, le=100)] = 0.0
    """Offset of the true mount from this nominal one, along each axis, one sigma."""

    @model_validator(mode="after")
    def _check_spin_axis(self) -> Self:
        if not 1e-6 <= math.sqrt(sum(x * x for x in self.spin_axis)) <= 1e6:
            raise ExpectationError("a spin_axis of a length from 1e-6 to 1e6 in it")
        return self

    @property
    def trivial(self) -> bool:
        """True if device and carrier are one frame."""
        return not any((*self.lever_arm_m, self.yaw_deg, self.pitch_deg, self.roll_deg, self.spin_hz))

    @property
    def has_errors(self) -> bool:
        """True if the true mount differs from the nominal one."""
        return bool(self.error_deg or self.error_mm)


class MotionSection(Section):
    """Base class of the kinds of motion."""

    mount: Mount = Mount()
    """Mount of the sensor on its carrier."""
    if TYPE_CHECKING:
        kind: str

    @property
    def takes_poses(self) -> bool:
        """True if poses come in while the run is streamed."""
        return False

    def carrier(
        self, site: "Site", *, gps: "Gps", reach_m: float, start_ns: int, seed: int
    ) -> "tuple[Motion, F8]":
        """Return the motion of the carrier over the ground, and points (n, 2) of its path on the map.

        Raises TrajectoryError if the motion is impossible.

        Parameters
        ----------
        site : the ground, and obstacles on it
        gps : position of the world's origin on earth
        reach_m : range of the sensor
        start_ns : UTC of the first pulse
        seed : seed of the motion's random numbers
        """
        raise NotImplementedError

    def under_sensors(self, carrier: "Motion") -> "Motion":
        """Return the motion of the sensors' base: the carrier, or a bending mast on it."""
        return carrier


class Static(MotionSection):
    """A sensor on a tripod."""

    kind: Literal["static"]
    """Selects a sensor on a tripod."""
    x_m: Place = 0.0
    """Position east."""
    y_m: Place = 0.0
    """Position north."""
    height_m: Size = 1.5
    """Height of the sensor's centre over the ground."""
    yaw_deg: Angle = 0.0
    """Direction of the body's x axis, counter-clockwise from east."""
    pitch_deg: Angle = 0.0
    """Nose down is positive."""
    roll_deg: Angle = 0.0
    """Right side down is positive."""

    def carrier(self, site: "Site", **_: object) -> "tuple[Motion, F8]":
        """Return the one pose, and its position on the map."""
        import numpy as np

        from vlp16emu.motion.pose import StaticMotion

        xy_m = np.array([[self.x_m, self.y_m]])
        position_m = np.append(xy_m[0], site.height_m(xy_m[:, 0], xy_m[:, 1])[0] + self.height_m)
        return StaticMotion(position_m, self.yaw_deg, self.pitch_deg, self.roll_deg), xy_m


class Gps(Section):
    """The GPS receiver wired to the sensor, and its errors.

    Errors under open sky follow an automotive receiver (Garmin GPS 16x, 190-00228-08 Rev. C, section 1.5.4.4:
    3 m in 95 % of cases with WAAS, and 0.1 knot); their split and the effect of trees are assumptions.
    """

    connected: bool = True
    """False for no pulse and no sentence: the sensor's clock runs free from power-up."""
    latitude_deg: Annotated[float, Field(gt=-90, lt=90)] = 62.24
    """Latitude (WGS 84) of the scene's origin."""
    longitude_deg: Annotated[float, Field(ge=-180, le=180)] = 25.75
    """Longitude (WGS 84) of the scene's origin."""
    height_m: Annotated[float, Field(ge=-1000, le=9000)] = 0.0
    """Height of the scene's origin over the ellipsoid."""
    sentence_delay_s: Annotated[float, Field(gt=0, lt=1)] = 0.35
    """Delay from the edge of a second to the arrival of the sentence that names it."""
    sentence_delay_spread_s: Annotated[float, Field(ge=0, lt=0.5)] = 0.0
    """Greatest difference of that delay, drawn from the seed of the first sensor: receivers differ, and that
    of one real capture sends its sentence before 0.34 s. 0 gives each receiver the same delay."""
    pps_window_s: Annotated[float, Field(ge=0, le=65535)] = 5.0
    """Time for which the pulse must be steady before the sensor locks to it (63-9243 Rev D, appendix G)."""
    requires_valid: bool = False
    """True if sentences of status V do not set the sensor's clock; requires `canopy_loss = false`."""
    antenna_above_m: Annotated[float, Field(ge=0, le=100)] = 0.2
    """Height of the antenna vertically above the sensor."""
    position_noise_m: _Error = 0.3
    """White error east and north, independent each second, one sigma; 0 switches it off."""
    wander_m: _Error = 1.2
    """Slowly wandering error east and north, one sigma; 0 switches it off."""
    wander_s: Annotated[float, Field(ge=1, le=1_000_000)] = 300.0
    """Correlation time of the wandering error: after it the correlation is 37 %."""
    velocity_noise_m_s: Annotated[float, Field(ge=0, le=100)] = 0.05
    """Error of the velocity east and north, one sigma; 0 switches it off."""
    canopy_loss: bool = True
    """True if a covered sky makes errors grow and fixes fail."""
    canopy_error_factor: Annotated[float, Field(ge=1, le=100)] = 2.5
    """Factor on errors under a fully covered sky; in between it is linear in the cover."""
    canopy_half_cover: Annotated[float, Field(gt=0, le=1)] = 0.88
    """Cover, as a share of the sky, at which half of the fixes fail; 0.05 more or less gives 73 % or 27 %."""

    @model_validator(mode="after")
    def _check_requires_valid(self) -> Self:
        if self.requires_valid and self.canopy_loss:
            raise ExpectationError("canopy_loss = false beside requires_valid = true")
        return self
