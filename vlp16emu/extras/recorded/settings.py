"""The table `[motion]` of a scene whose poses are in a file."""

from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from vlp16emu.motion.settings import MotionSection
from vlp16emu.settings import Angle, ExpectationError, Place, Positive, SceneFile

if TYPE_CHECKING:  # scenes are read without numpy
    from vlp16emu.motion.pose import Motion
    from vlp16emu.types import F8
    from vlp16emu.world.settings import Site


class Recorded(MotionSection):
    """Poses from a file; the first one is at the start of the run."""

    kind: Literal["recorded"]
    """Selects recorded poses."""
    file: SceneFile
    """Path of the file, relative to the folder of the scene file."""
    format: Literal["tum", "csv", "kitti"]
    """t x y z qx qy qz qw; CSV with the columns t_s, x_m, y_m, z_m, qx, qy, qz, qw; 12 numbers of a
    matrix."""
    times_file: SceneFile | None = None
    """File with the time of each KITTI pose in seconds, one per line."""
    rate_hz: Annotated[float, Field(ge=0.001, le=1_000_000)] | None = None
    """Rate of KITTI poses if no file gives their times."""
    max_gap_s: Positive = 1.0
    """Poses farther apart in time are refused."""
    axes: Literal["body", "camera"] = "body"
    """body: x forward, z up, in the file's poses and in their world; camera: z forward, y down, in both
    (KITTI)."""
    x_m: Place = 0.0
    """Position of the file's origin in the world, with `y_m` and `z_m`. For poses in map coordinates give the
    negative of the world's `origin_m`, which is not subtracted from them."""
    y_m: Place = 0.0
    """See `x_m`."""
    z_m: Place = 0.0
    """See `x_m`."""
    yaw_deg: Angle = 0.0
    """Direction of the file's x axis, counter-clockwise from east."""

    @model_validator(mode="after")
    def _times_of_kitti(self) -> Self:
        if sum(times is not None for times in (self.times_file, self.rate_hz)) != (self.format == "kitti"):
            raise ExpectationError(
                "exactly one of times_file and rate_hz with format kitti, and neither with others"
            )
        return self

    def carrier(self, site: "Site", *, reach_m: float, start_ns: int, **_: object) -> "tuple[Motion, F8]":
        """Return the recorded motion and the places (n, 2) of its poses; it flies over any ground."""
        from vlp16emu.extras.recorded.files import read_poses
        from vlp16emu.extras.recorded.motion import RecordedMotion, check_places

        motion = RecordedMotion(self, read_poses(self), start_ns=start_ns)
        check_places(motion.position_m, site, reach_m)
        return motion, motion.position_m[:, :2].copy()
