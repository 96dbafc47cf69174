"""The table `[motion]` of a scene in which a person walks.

No kernel is in this file, so that a scene is read without the compiler.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from vlp16emu.motion.settings import Gps, MotionSection
from vlp16emu.settings import (
    Angle,
    ExpectationError,
    Fraction,
    NonNegative,
    Place,
    Preset,
    SceneFile,
    Section,
    Seed,
    Size,
)

if TYPE_CHECKING:  # scenes are read without numpy
    from vlp16emu.extras.walk.motion import WalkMotion
    from vlp16emu.extras.walk.route import Route
    from vlp16emu.motion.pose import Motion
    from vlp16emu.types import F8
    from vlp16emu.world.settings import Site

_Amplitude = Annotated[float, Field(ge=0, le=1)]
_Frequency = Annotated[float, Field(ge=0.5, le=1e9)]
_Point = Annotated[tuple[Place, Place], Field(strict=False)]
_Swing = Annotated[float, Field(ge=0, le=45)]


class LawnMower(Section):
    """Parallel lines back and forth over a rectangle, joined by rounded turns inside it."""

    corner_m: _Point = (0.0, 0.0)
    """x and y of the corner at which both edges begin."""
    length_m: Size
    """Length of the edge along the lines."""
    width_m: Annotated[float, Field(ge=0, le=1e4)]
    """Length of the edge across the lines, to the left of the first line."""
    azimuth_deg: Angle = 0.0
    """Direction of the lines, counter-clockwise from east."""
    line_spacing_m: Annotated[float, Field(ge=0.1, le=1e4)] = 10.0
    """Distance between lines."""
    turn_radius_m: Annotated[float, Field(ge=0.05, le=1e4)] = 1.0
    """Radius of both quarter turns between one line and the next."""


class Stop(Section):
    """A halt; needs exactly one of `way_point` and `at_m`."""

    way_point: Annotated[int, Field(ge=1, le=1_000_000)] | None = None
    """Number of the waypoint; the first is 1."""
    at_m: NonNegative | None = None
    """Distance along the path."""
    pause_s: NonNegative
    """Duration of the halt."""

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        if (self.way_point is None) == (self.at_m is None):
            raise ExpectationError("exactly one of way_point and at_m in it")
        return self


_STRONG_GAIT = {  # a heavy pack on rough ground: about twice `natural` (assumption)
    "vertical_m": 0.04,
    "second_harmonic_m": 0.006,
    "heel_strike_m": 0.003,
    "sideways_m": 0.045,
    "fore_aft_m": 0.02,
    "roll_deg": 4.0,
    "pitch_deg": 4.5,
    "yaw_deg": 7.0,
    "variation": 0.08,
}


class Gait(Preset):
    """Amplitudes of the trunk's motion at walking speed; they fade as the person slows down.

    The defaults are the values of `natural`.
    """

    presets: ClassVar[Mapping[str, Mapping[str, float]]] = {
        "none": dict.fromkeys(_STRONG_GAIT, 0.0),
        # Two plain sines (Lu et al., LiDAR-Forest, module 4).
        "paper": {
            **dict.fromkeys(_STRONG_GAIT, 0.0),
            "step_hz": 1.8,
            "vertical_m": 0.025,
            "sideways_m": 0.02,
        },
        "natural": {},
        # Step times of young adults vary by 4.0 % on flat ground and by 8.2 % on uneven ground, and the rise
        # and sway of their sacrum vary more too (Downey et al., PLOS ONE 17, e0278646, 2022, abstract).
        "uneven": {"variation": 0.082},
        "strong": _STRONG_GAIT,
    }

    preset: Literal["none", "paper", "natural", "uneven", "strong"] = "natural"
    """Sets the keys that are not given beside it; the defaults are `natural`. Steps of `uneven` vary as on
    uneven ground."""
    step_hz: Annotated[float, Field(gt=0, le=5)] | None = None
    """Steps per second; from the walking speed if not given."""
    vertical_m: _Amplitude = 0.023
    """Rise and fall, once per step; 4.6 cm from end to end (assumption)."""
    second_harmonic_m: _Amplitude = 0.0015
    """Rise and fall, twice per step (assumption)."""
    heel_strike_m: _Amplitude = 0.0007
    """Depth of the dip of 40 ms at each heel strike, 0.2 g at the trunk (assumption)."""
    sideways_m: _Amplitude = 0.022
    """Sway, once per stride; 4.4 cm from end to end (assumption)."""
    fore_aft_m: _Amplitude = 0.01
    """Lead and lag, once per step (assumption)."""
    roll_deg: _Swing = 1.65
    """Once per stride; range 3.3 degrees (Chung et al., J NeuroEng Rehabil 7:9, 2010, global obliquity)."""
    pitch_deg: _Swing = 2.0
    """Once per step; range 4.0 degrees (Chung et al., 2010, global tilt)."""
    yaw_deg: _Swing = 3.45
    """Once per stride; range 6.9 degrees (Chung et al., 2010, global rotation)."""
    variation: Fraction = 0.04
    """Standard deviation of stride times and of amplitudes, relative to them; a healthy walker's stride times
    varied by 4 % in nine minutes (PhysioNet, Fractal mechanisms in neural control, figure 9)."""

    @property
    def moves(self) -> bool:
        """True if any amplitude is above zero."""
        return any(getattr(self, name) for name in _STRONG_GAIT if name != "variation")


class Harness(Section):
    """Straps; without this table the pack is strapped tight.

    The defaults describe a loose pack (assumption): suspended packs in measurements swing
    at 1.9 to 2.3 Hz under 5 kg (690 to 1050 N/m; J Biomech Eng 144, 051001, 2022).
    """

    fore_aft_hz: _Frequency = 3.0
    """Undamped natural frequency, forwards and backwards."""
    sideways_hz: _Frequency = 3.0
    """Undamped natural frequency, sideways."""
    vertical_hz: _Frequency = 2.1
    """Undamped natural frequency, up and down."""
    roll_hz: _Frequency = 3.0
    """Undamped natural frequency about the forward axis."""
    pitch_hz: _Frequency = 3.0
    """Undamped natural frequency about the axis to the left."""
    yaw_hz: _Frequency = 3.0
    """Undamped natural frequency about the vertical axis."""
    damping_ratio: Annotated[float, Field(ge=0, le=10)] = 0.25
    """Share of critical damping, on all axes."""

    @property
    def frequency_hz(self) -> tuple[float, ...]:
        """Frequencies (6,) in the order of `walk.gait.AXES`."""
        return self.fore_aft_hz, self.sideways_hz, self.vertical_hz, self.roll_hz, self.pitch_hz, self.yaw_hz


class Mast(Section):
    """Mast that carries the sensors above the pack and the inertial unit, and bends with each step.

    A pole of aluminium with a sensor of 0.83 kg (63-9243 Rev D, appendix C) swings at about 8 Hz and hardly
    along itself; at walking pace it leans by a tenth of a degree (assumption).
    """

    bending_hz: _Frequency = 8.0
    """Undamped natural frequency of its bending, forwards and to the sides."""
    damping_ratio: Annotated[float, Field(ge=0, le=10)] = 0.05
    """Share of critical damping, on all axes."""

    @property
    def frequency_hz(self) -> tuple[float, ...]:
        """Frequencies (6,) in the order of `AXES`: 50 Hz up and down, 15 Hz about itself (assumptions)."""
        return self.bending_hz, self.bending_hz, 50.0, self.bending_hz, self.bending_hz, 15.0


class Walk(MotionSection):
    """A person with the sensor on the back."""

    either_or: ClassVar[frozenset[str]] = frozenset({"speed_m_s", "run_time_s"})
    one_of: ClassVar[tuple[str, ...]] = ("way_points_m", "way_points_file", "lawn_mower")
    """Keys; exactly one of them is needed."""

    way_points_m: Annotated[list[_Point], Field(min_length=2)] | None = None
    """x and y in the world; the path is a smooth curve through them in this order."""
    way_points_file: SceneFile | None = None
    """CSV with the columns x_m, y_m (or x, y) and, if wanted, stop_s; or GPX with one track or route."""
    lawn_mower: LawnMower | None = None
    """Parallel lines over a plot."""
    laps: Annotated[int, Field(ge=1, le=1000)] = 1
    """Number of laps of a closed path, whose last waypoint is the first, or of any path with
    `back_and_forth`. A closed path closes smoothly."""
    back_and_forth: bool = False
    """True if a lap is the way there and back, with a small loop behind each end where the person turns
    round."""
    speed_m_s: Annotated[float, Field(gt=0, le=10)] = 1.2
    """Speed along the path where nothing slows the person down."""
    run_time_s: Annotated[float, Field(gt=0, le=7 * 86400)] | None = None
    """Time from first motion to last, instead of a speed."""
    acceleration_m_s2: Annotated[float, Field(gt=0, le=10)] = 1.0
    """Greatest change of speed; at 1 m/s^2 a person is at walking speed after two paces (assumption)."""
    yaw_rate_deg_s: Annotated[float, Field(gt=0, le=720)] = 60.0
    """Greatest turn rate: a right angle takes 1.5 s (assumption). The person slows down in tight turns."""
    stops: list[Stop] = Field(default_factory=list)
    """Halts on each lap."""
    stand_s: Annotated[float, Field(ge=0, le=86_400)] = 0.0
    """Time that the person stands still before the first step, as programs need that estimate gravity and
    biases first; not part of `run_time_s`."""
    kind: Literal["walk"]
    """Selects a walking person."""
    seed: Seed | None = None
    """Seed of the variation of steps: scenes with the same seed and ground have the same walk; the scene's
    seed if not set."""
    sensor_height_m: Size = 2.0
    """Height of the pack's origin over the ground under it; the origin is the sensor's centre unless it is
    mounted elsewhere."""
    gait: Gait = Gait()
    """Motion of the person's trunk."""
    harness: Harness | None = None
    """Straps of the pack; without this table the pack is strapped tight."""
    mast: Mast | None = None
    """Mast that carries the sensors but not the inertial unit; without this table the sensors are rigid on
    the pack."""

    @model_validator(mode="after")
    def _given_once(self) -> Self:
        if sum(getattr(self, source) is not None for source in self.one_of) != 1:
            raise ExpectationError("exactly one of way_points_m, way_points_file and lawn_mower in it")
        if self.either_or <= self.model_fields_set:
            raise ExpectationError("one of speed_m_s and run_time_s in it, not both")
        if self.lawn_mower is not None and any(stop.way_point is not None for stop in self.stops):
            raise ExpectationError("stops given by at_m where lawn_mower makes the waypoints")
        return self

    def carrier(
        self, site: "Site", *, gps: Gps, start_ns: int, seed: int, **_: object
    ) -> "tuple[WalkMotion, F8]":
        """Return the motion of the pack, and points (n, 2) of its path, which leads around obstacles.

        Raises TrajectoryError if a person cannot walk it.
        """
        from vlp16emu.extras.walk.motion import WalkMotion, check_gait

        check_gait(self.gait, self.sensor_height_m)
        route = self.route(site, gps)
        return WalkMotion(self, route, start_ns=start_ns, seed=seed), route.path.xy_m

    def route(self, site: "Site", gps: Gps, *, is_stored: bool = True) -> "Route":
        """Return the path over the ground, around its obstacles, with the time at each place.

        Raises TrajectoryError if a person cannot walk it.

        Parameters
        ----------
        site : ground
        gps : position of the scene's origin on earth
        is_stored : True to keep the path in the user's store for later runs
        """
        from vlp16emu.extras.walk.path import path_over
        from vlp16emu.extras.walk.route import Route
        from vlp16emu.extras.walk.way_points import lead_around, way_points

        points = way_points(self, gps, site.origin_m[:2])
        if site.obstacles is not None:
            points = lead_around(points, *site.obstacles)
        path = path_over(points.xy_m, site.height_m, site.name if is_stored else "")
        return Route(path, self, points.pause_s)

    def under_sensors(self, carrier: "Motion") -> "Motion":
        """Return the motion of the top of the mast, or `carrier` without a mast."""
        if self.mast is None:
            return carrier
        # `carrier` is a `WalkMotion`, which this file does not load.
        top: Motion = carrier.mast_top(self.mast)  # type: ignore[attr-defined]
        return top
