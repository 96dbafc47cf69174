"""Where a person goes, and the poses that somebody has recorded."""

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from vlp16emu.scenario.given import SceneFile
from vlp16emu.scenario.harness import Mount
from vlp16emu.settings import Angle, NonNegative, Place, Positive, Section, Size

__all__ = ["LawnMower", "Point", "Recorded", "Stop", "Way"]

Point = Annotated[tuple[float, float], Field(strict=False)]


class LawnMower(Section):
    """Parallel lines to and fro over a rectangle, joined by rounded turns inside it."""

    corner_m: Point = (0.0, 0.0)
    """x and y of the corner at which both edges begin."""
    length_m: Size
    """Length of the edge along the lines."""
    width_m: Annotated[float, Field(ge=0, le=1e4)]
    """Length of the edge across them, to the left of the first."""
    azimuth_deg: Angle = 0.0
    """Direction of the lines, counter-clockwise from east."""
    line_spacing_m: Annotated[float, Field(ge=0.1, le=1e4)] = 10.0
    """Distance between lines."""
    turn_radius_m: Annotated[float, Field(ge=0.05, le=1e4)] = 1.0
    """Radius of both quarter turns between one line and the next."""


class Stop(Section):
    """A halt; needs exactly one of `way_point` and `at_m`."""

    way_point: Annotated[int, Field(ge=1)] | None = None
    """Number of the way point; the first is 1."""
    at_m: NonNegative | None = None
    """Distance along the path."""
    pause_s: NonNegative
    """Duration of the halt."""

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        """Refuse a place that is missing or told twice."""
        if (self.way_point is None) == (self.at_m is None):
            raise ValueError("exactly one of way_point and at_m in it")
        return self


class Way(Section):
    """Where a person goes and how fast; needs exactly one of the three ways to tell the way points."""

    either_or: ClassVar[frozenset[str]] = frozenset({"speed_m_s", "run_time_s"})
    one_of: ClassVar[tuple[str, ...]] = ("way_points_m", "way_points_file", "lawn_mower")
    """Keys of which exactly one is needed."""

    way_points_m: Annotated[list[Point], Field(min_length=2)] | None = None
    """x and y in the world; the path is a smooth curve through them in this order."""
    way_points_file: SceneFile | None = None
    """CSV with the columns x_m, y_m and, if wanted, stop_s; or GPX with one track or route."""
    lawn_mower: LawnMower | None = None
    """A pattern over a plot."""
    laps: Annotated[int, Field(ge=1, le=1000)] = 1
    """Number of laps, where the last way point is the first: such a path closes smoothly."""
    speed_m_s: Annotated[float, Field(gt=0, le=10)] = 1.2
    """Speed along the path, where nothing slows the person down."""
    run_time_s: Annotated[float, Field(gt=0, le=7 * 86400)] | None = None
    """Time from first motion to last, instead of a speed."""
    acceleration_m_s2: Annotated[float, Field(gt=0, le=10)] = 1.0
    """Greatest change of speed; at 1 m/s^2 a person is at walking speed after two paces (assumption)."""
    yaw_rate_deg_s: Annotated[float, Field(gt=0, le=720)] = 60.0
    """Greatest turn rate: a right angle takes 1.5 s (assumption). In tighter turns the person slows down."""
    stops: list[Stop] = Field(default_factory=list)
    """Halts on each lap."""

    @model_validator(mode="after")
    def _told_once(self) -> Self:
        """Refuse way points or a pace that are missing or told twice."""
        if sum(getattr(self, way) is not None for way in self.one_of) != 1:
            raise ValueError("exactly one of way_points_m, way_points_file and lawn_mower in it")
        if self.either_or <= self.model_fields_set:
            raise ValueError("one of speed_m_s and run_time_s in it, not both")
        if self.lawn_mower is not None and any(stop.way_point is not None for stop in self.stops):
            raise ValueError("stops told by at_m where lawn_mower makes the way points")
        return self


class Recorded(Section):
    """Poses in a file, with the first at the start of the run."""

    kind: Literal["recorded"]
    """Selects recorded poses."""
    file: SceneFile
    """Path of the file, from the folder of the scene file."""
    format: Literal["tum", "csv", "kitti"]
    """t x y z qx qy qz qw; CSV with the columns t_s, x_m, y_m, z_m, qx, qy, qz, qw; 12 numbers of a matrix."""
    times_file: SceneFile | None = None
    """Time of each KITTI pose in seconds, one to a line."""
    rate_hz: Annotated[float, Field(ge=0.001, le=1_000_000)] | None = None
    """Rate of KITTI poses, where no file gives their times."""
    max_gap_s: Positive = 1.0
    """Poses farther apart in time are refused."""
    axes: Literal["body", "camera"] = "body"
    """body: x forward, z up, in the file's poses and in their world; camera: z forward, y down, in both (KITTI)."""
    x_m: Place = 0.0
    """Place in the world of the file's origin, with `y_m` and `z_m`; of poses in map coordinates the world's `origin_m` with
    its signs turned, for that is not taken off them."""
    y_m: Place = 0.0
    """See `x_m`."""
    z_m: Place = 0.0
    """See `x_m`."""
    yaw_deg: Angle = 0.0
    """Where the file's x axis points, counter-clockwise from east."""
    mount: Mount = Mount()
    """Mount of the sensor on the body of the poses."""

    @model_validator(mode="after")
    def _times_of_kitti(self) -> Self:
        """Refuse times that are missing or told twice."""
        told = sum(times is not None for times in (self.times_file, self.rate_hz))
        if told != (self.format == "kitti"):
            raise ValueError(
                "exactly one of times_file and rate_hz with format kitti, and neither with others"
            )
        return self
