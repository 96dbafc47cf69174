"""The `[motion]` table: a sensor that stands, a person who walks, or recorded poses."""

from typing import Annotated, Literal

from pydantic import Field

from vlp16emu.scenario.gait import Gait
from vlp16emu.scenario.harness import Harness, Mount
from vlp16emu.scenario.way import Recorded, Way
from vlp16emu.settings import Angle, Place, Section, Size

__all__ = ["Motion", "Static", "Walk"]


class Static(Section):
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
    """Counter-clockwise from east; the body's x axis looks there."""
    pitch_deg: Angle = 0.0
    """Nose down is positive."""
    roll_deg: Angle = 0.0
    """Right side down is positive."""
    mount: Mount = Mount()
    """Mount of the sensor on the tripod."""


class Walk(Way):
    """A person with the sensor on the back."""

    kind: Literal["walk"]
    """Selects a walking person."""
    sensor_height_m: Size = 2.0
    """Height of the pack's origin over the ground under it; the origin is the sensor's centre unless it is mounted
    elsewhere."""
    gait: Gait = Gait()
    """How the trunk of the person moves."""
    harness: Harness | None = None
    """How the pack hangs on the person; strapped tight without it."""
    mount: Mount = Mount()
    """Mount of the sensor on the pack."""


Motion = Annotated[Static | Walk | Recorded, Field(discriminator="kind")]
