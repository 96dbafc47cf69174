"""The `[motion]` table: a sensor that stands, or a person who walks."""

from typing import Annotated, Literal

from pydantic import Field

from vlp16emu.scenario.section import Angle, NonNegative, Positive, Section

__all__ = ["Gait", "Motion", "Static", "Walk"]

Point = Annotated[tuple[float, float], Field(strict=False)]


class Static(Section):
    """A sensor on a tripod."""

    kind: Literal["static"]
    x_m: float = 0.0
    y_m: float = 0.0
    height_m: Positive = 1.5
    """Of the sensor's centre over the ground."""
    yaw_deg: Angle = 0.0
    """Counter-clockwise from east; the body's x axis looks there."""
    pitch_deg: Angle = 0.0
    """Nose down is positive."""
    roll_deg: Angle = 0.0
    """Right side down is positive."""


class Gait(Section):
    """The paper's human movement: two sines (Lu et al., LiDAR-Forest, module 4)."""

    step_hz: Positive = 1.8
    """Steps per second: the body rises and falls once per step."""
    vertical_m: NonNegative = 0.025
    """Amplitude of the rise and fall."""
    sideways_m: NonNegative = 0.02
    """Amplitude of the sway, once per two steps."""


class Walk(Section):
    """A person with the sensor on the back, at constant speed along a spline."""

    kind: Literal["walk"]
    way_points_m: Annotated[list[Point], Field(min_length=2)]
    """x and y in the world; the path is a smooth curve through them in this order."""
    speed_m_s: Annotated[float, Field(gt=0, le=10)] = 1.2
    sensor_height_m: Positive = 2.0
    """Of the sensor's centre over the ground under it."""
    pitch_deg: Angle = 0.0
    """Mounting: nose down is positive."""
    roll_deg: Angle = 0.0
    """Mounting: right side down is positive."""
    gait: Gait = Gait()


Motion = Annotated[Static | Walk, Field(discriminator="kind")]
