"""The table `[camera]` of a scene.

No kernel is in this file, so that a scene is read without the compiler.
"""

from typing import Annotated, ClassVar

from pydantic import Field, field_validator

from vlp16emu.motion.settings import Mount
from vlp16emu.settings import ExpectationError, Section

_Pixels = Annotated[int, Field(ge=8, le=8192)]
_Focal = Annotated[float, Field(ge=1, le=1e6)]
_Place = Annotated[float, Field(ge=-1e5, le=1e5)]
_Coefficient = Annotated[float, Field(ge=-100, le=100)]
_Coefficients = tuple[_Coefficient, _Coefficient, _Coefficient, _Coefficient, _Coefficient]


class Camera(Section):
    """A pinhole camera beside the sensor, for `vlp16emu images` and for bags.

    Pixels are counted as in OpenCV and ROS: the middle of the first pixel is (0, 0).
    """

    either_or: ClassVar[frozenset[str]] = frozenset({"hfov_deg", "focal_px"})

    width_px: _Pixels = 640
    """Columns of an image."""
    height_px: _Pixels = 480
    """Rows of an image."""
    hfov_deg: Annotated[float, Field(ge=1, le=170)] = 70.0
    """Horizontal field of view without distortion, for square pixels."""
    focal_px: Annotated[tuple[_Focal, _Focal], Field(strict=False)] | None = None
    """Focal lengths fx and fy, in place of `hfov_deg`."""
    principal_px: Annotated[tuple[_Place, _Place], Field(strict=False)] | None = None
    """Principal point cx and cy; by default the middle of the image, ((width - 1) / 2, (height - 1) / 2)."""
    distortion: Annotated[_Coefficients, Field(strict=False)] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """Distortion k1, k2, p1, p2 and k3 of Brown's model, in the order of OpenCV and of ROS' `plumb_bob`."""
    readout_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Rolling shutter: time from the first row to the last, each with the pose at its own time; 0 for one
    instant."""
    rate_hz: Annotated[float, Field(gt=0, le=1000)] = 2.0
    """Images per second."""
    mount: Mount = Mount()
    """Mount on the carrier, like the sensor's: with no rotation the camera looks along the carrier's x
    axis."""

    @field_validator("mount")
    @classmethod
    def _check_is_fixed(cls, mount: Mount) -> Mount:
        if mount.spin_hz:
            raise ExpectationError("spin_hz = 0 in it, as a camera is fixed to its carrier")
        return mount
