"""The `[motion.harness]` and mount tables: how the pack hangs on the person, and the sensor on the pack."""

import math
from typing import Annotated, Self

from pydantic import Field, model_validator

from vlp16emu.settings import Angle, Section

__all__ = ["Harness", "Mount"]

Frequency = Annotated[float, Field(ge=0.5, le=1e9)]
Offset = Annotated[float, Field(ge=-10, le=10)]
Vector = Annotated[tuple[float, float, float], Field(strict=False)]


class Harness(Section):
    """Straps; without this table the pack is strapped tight.

    The defaults are those of a loose pack (assumption): the suspended packs that people have measured swing
    at 1.9 to 2.3 Hz under 5 kg (690 to 1050 N/m; J Biomech Eng 144, 051001, 2022).
    """

    fore_aft_hz: Frequency = 3.0
    """Undamped natural frequency, forwards and backwards."""
    sideways_hz: Frequency = 3.0
    """The same to the sides."""
    vertical_hz: Frequency = 2.1
    """The same up and down."""
    roll_hz: Frequency = 3.0
    """The same about the forward axis."""
    pitch_hz: Frequency = 3.0
    """The same about the axis to the left."""
    yaw_hz: Frequency = 3.0
    """The same about the vertical axis."""
    damping_ratio: Annotated[float, Field(ge=0, le=10)] = 0.25
    """Share of critical damping, on all axes."""


class Mount(Section):
    """How a device sits on its carrier."""

    lever_arm_m: Annotated[tuple[Offset, Offset, Offset], Field(strict=False)] = (0.0, 0.0, 0.0)
    """Its origin in the carrier's frame: forward, left, up."""
    yaw_deg: Angle = 0.0
    """Counter-clockwise is positive."""
    pitch_deg: Angle = 0.0
    """Nose down is positive."""
    roll_deg: Angle = 0.0
    """Right side down is positive."""
    spin_hz: Annotated[float, Field(ge=-10, le=10)] = 0.0
    """Revolutions per second of the stage under it, as in handheld scanners; 0 for a fixed one."""
    spin_axis: Vector = (0.0, 0.0, 1.0)
    """Axis of the stage in the carrier's frame, through the device's origin."""

    @model_validator(mode="after")
    def _has_an_axis(self) -> Self:
        """Refuse an axis without direction."""
        if not 1e-6 <= math.hypot(*self.spin_axis) <= 1e6:
            raise ValueError("a spin_axis of a length from 1e-6 to 1e6 in it")
        return self
