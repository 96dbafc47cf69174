"""The tables `[motion]`, `[imu]` and `[gps]` of a scene: what carries the sensor, and what else it carries.

No kernel is in this file, so that a scene is read without the compiler.
"""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from vlp16emu.settings import Angle, Fraction, NonNegative, Place, Preset, SceneFile, Section, Seed, Size

if TYPE_CHECKING:  # scenes are read without numpy
    from vlp16emu.motion.pose import Motion
    from vlp16emu.types import Array, HeightField

_Amplitude = Annotated[float, Field(ge=0, le=1)]
_Error = Annotated[float, Field(ge=0, le=1000)]
_Frequency = Annotated[float, Field(ge=0.5, le=1e9)]
_Offset = Annotated[float, Field(ge=-10, le=10)]
_Point = Annotated[tuple[float, float], Field(strict=False)]
_Swing = Annotated[float, Field(ge=0, le=45)]


class Mount(Section):
    """Extrinsics of a device on its carrier."""

    lever_arm_m: Annotated[tuple[_Offset, _Offset, _Offset], Field(strict=False)] = (0.0, 0.0, 0.0)
    """Its origin in the carrier's frame: forward, left, up."""
    yaw_deg: Angle = 0.0
    """Counter-clockwise is positive."""
    pitch_deg: Angle = 0.0
    """Nose down is positive."""
    roll_deg: Angle = 0.0
    """Right side down is positive."""
    spin_hz: Annotated[float, Field(ge=-10, le=10)] = 0.0
    """Revolutions per second of the stage under it, as in handheld scanners; 0 for a fixed one."""
    spin_axis: Annotated[tuple[float, float, float], Field(strict=False)] = (0.0, 0.0, 1.0)
    """Axis of the stage in the carrier's frame, through the device's origin."""
    error_deg: Annotated[float, Field(ge=0, le=10)] = 0.0
    """How far the true mount is turned from this one, which is what users are given: about each axis, one sigma."""
    error_mm: Annotated[float, Field(ge=0, le=100)] = 0.0
    """How far it is moved along each axis, one sigma."""

    @model_validator(mode="after")
    def _has_an_axis(self) -> Self:
        if not 1e-6 <= math.sqrt(sum(x * x for x in self.spin_axis)) <= 1e6:
            raise ValueError("a spin_axis of a length from 1e-6 to 1e6 in it")
        return self

    @property
    def trivial(self) -> bool:
        """True if device and carrier are one frame."""
        return not any((*self.lever_arm_m, self.yaw_deg, self.pitch_deg, self.roll_deg, self.spin_hz))

    @property
    def has_errors(self) -> bool:
        """True if the true mount is another one."""
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

    def carrier(self, height_m: "HeightField", start_ns: int) -> "tuple[Motion, Array]":
        """Return the motion of the carrier and points (n, 2) of its path.

        Parameters
        ----------
        height_m : height of the ground over places x_m, y_m
        start_ns : UTC of the first pulse
        """
        raise NotImplementedError

    def under_sensors(self, carrier: "Motion") -> "Motion":
        """Return the motion of what the sensors are mounted on: the carrier's, or that of a mast that bends on it."""
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
    """Counter-clockwise from east; the body's x axis looks there."""
    pitch_deg: Angle = 0.0
    """Nose down is positive."""
    roll_deg: Angle = 0.0
    """Right side down is positive."""


class LawnMower(Section):
    """Parallel lines to and fro over a rectangle, joined by rounded turns inside it."""

    corner_m: _Point = (0.0, 0.0)
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
    """Number of the waypoint; the first is 1."""
    at_m: NonNegative | None = None
    """Distance along the path."""
    pause_s: NonNegative
    """Duration of the halt."""

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        if (self.way_point is None) == (self.at_m is None):
            raise ValueError("exactly one of way_point and at_m in it")
        return self


_STRONG_GAIT = {  # a heavy pack on rough ground: about twice the natural, an assumption
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

    Defaults are those of `natural`.
    """

    presets: ClassVar[Mapping[str, Mapping[str, float]]] = {
        "none": dict.fromkeys(_STRONG_GAIT, 0.0),
        # Two plain sines (Lu et al., LiDAR-Forest, module 4).
        "paper": {**dict.fromkeys(_STRONG_GAIT, 0.0), "step_hz": 1.8, "vertical_m": 0.025, "sideways_m": 0.02},
        "natural": {},
        "strong": _STRONG_GAIT,
    }

    preset: Literal["none", "paper", "natural", "strong"] = "natural"
    """Values of the keys that are not given beside it; `natural` is their defaults."""
    step_hz: Annotated[float, Field(gt=0, le=5)] | None = None
    """Steps per second; from the walking speed where it is left out."""
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
    """Standard deviation of stride times, and of amplitudes, as a share of them; a healthy walker's stride times
    varied by 4 % in nine minutes (PhysioNet, Fractal mechanisms in neural control, figure 9)."""

    @property
    def moves(self) -> bool:
        """True if any amplitude is above zero."""
        return any(getattr(self, name) for name in _STRONG_GAIT if name != "variation")


class Harness(Section):
    """Straps; without this table the pack is strapped tight.

    The defaults are those of a loose pack (assumption): the suspended packs that people have measured swing
    at 1.9 to 2.3 Hz under 5 kg (690 to 1050 N/m; J Biomech Eng 144, 051001, 2022).
    """

    fore_aft_hz: _Frequency = 3.0
    """Undamped natural frequency, forwards and backwards."""
    sideways_hz: _Frequency = 3.0
    """The same to the sides."""
    vertical_hz: _Frequency = 2.1
    """The same up and down."""
    roll_hz: _Frequency = 3.0
    """The same about the forward axis."""
    pitch_hz: _Frequency = 3.0
    """The same about the axis to the left."""
    yaw_hz: _Frequency = 3.0
    """The same about the vertical axis."""
    damping_ratio: Annotated[float, Field(ge=0, le=10)] = 0.25
    """Share of critical damping, on all axes."""

    @property
    def frequency_hz(self) -> tuple[float, ...]:
        """Frequencies (6,) in the order of `motion.gait.AXES`."""
        return self.fore_aft_hz, self.sideways_hz, self.vertical_hz, self.roll_hz, self.pitch_hz, self.yaw_hz


class Mast(Section):
    """Mast that carries the sensors over the pack and the inertial unit, and bends with each step.

    A pole of aluminium with a sensor of 0.83 kg (63-9243 Rev D, appendix C) swings at some 8 Hz and hardly along itself; at
    walking pace it then leans by a tenth of a degree (assumption).
    """

    bending_hz: _Frequency = 8.0
    """Undamped natural frequency of its bending, forwards and to the sides."""
    damping_ratio: Annotated[float, Field(ge=0, le=10)] = 0.05
    """Share of critical damping, on all axes."""

    @property
    def frequency_hz(self) -> tuple[float, ...]:
        """Frequencies (6,) in the order of `motion.gait.AXES`: up and down at 50 Hz, about itself at 15 Hz (assumptions)."""
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
    """A pattern over a plot."""
    laps: Annotated[int, Field(ge=1, le=1000)] = 1
    """Number of laps, where the last waypoint is the first: such a path closes smoothly. Of another one with
    `back_and_forth`."""
    back_and_forth: bool = False
    """Whether a lap is the way there and back, with a small loop behind each end: the person turns round, and goes on."""
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
    stand_s: Annotated[float, Field(ge=0, le=86_400)] = 0.0
    """How long the person stands still before the first step, as programs that begin with gravity and biases want; not
    part of `run_time_s`."""
    kind: Literal["walk"]
    """Selects a walking person."""
    seed: Seed | None = None
    """Seed of how the steps vary: scenes that share it, and the ground, walk one walk; the scene's seed if not set."""
    sensor_height_m: Size = 2.0
    """Height of the pack's origin over the ground under it; the origin is the sensor's centre unless it is mounted
    elsewhere."""
    gait: Gait = Gait()
    """How the trunk of the person moves."""
    harness: Harness | None = None
    """How the pack hangs on the person; strapped tight without it."""
    mast: Mast | None = None
    """How the sensors bend on the pack, whose inertial unit does not; rigid without it."""

    @model_validator(mode="after")
    def _given_once(self) -> Self:
        if sum(getattr(self, source) is not None for source in self.one_of) != 1:
            raise ValueError("exactly one of way_points_m, way_points_file and lawn_mower in it")
        if self.either_or <= self.model_fields_set:
            raise ValueError("one of speed_m_s and run_time_s in it, not both")
        if self.lawn_mower is not None and any(stop.way_point is not None for stop in self.stops):
            raise ValueError("stops given by at_m where lawn_mower makes the waypoints")
        return self

    def under_sensors(self, carrier: "Motion") -> "Motion":
        """Return the motion of the top of the mast; the carrier's without one."""
        if self.mast is None:
            return carrier
        bent: Motion = carrier.bent(self.mast)  # type: ignore[attr-defined]  # `WalkMotion`, which this file does not load
        return bent


class Gps(Section):
    """The GPS receiver wired to the sensor, and its errors.

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
    pps_window_s: Annotated[float, Field(ge=0, le=65535)] = 5.0
    """Time for which the pulse must be steady before the sensor locks to it (63-9243 Rev D, appendix G)."""
    requires_valid: bool = False
    """Whether sentences of status V do not set the sensor's clock; true needs `canopy_loss = false`."""
    antenna_above_m: Annotated[float, Field(ge=0, le=100)] = 0.2
    """Height of the antenna over the sensor, straight up."""
    position_noise_m: _Error = 0.3
    """Error to the east and to the north that is new in each second, one sigma. 0 switches it off."""
    wander_m: _Error = 1.2
    """Error to the east and to the north that changes slowly, one sigma. 0 switches it off."""
    wander_s: Annotated[float, Field(ge=1, le=1_000_000)] = 300.0
    """Correlation time of the wandering error: 37 % of it is left then."""
    velocity_noise_m_s: Annotated[float, Field(ge=0, le=100)] = 0.05
    """Error of the velocity to the east and to the north, one sigma. 0 switches it off."""
    canopy_loss: bool = True
    """Whether what hides the sky from the antenna makes errors grow and fixes fail."""
    canopy_error_factor: Annotated[float, Field(ge=1, le=100)] = 2.5
    """How many times greater errors are where the whole sky is hidden; in between in proportion to the cover."""
    canopy_half_cover: Annotated[float, Field(gt=0, le=1)] = 0.88
    """Cover, as a share of the sky, at which every second fix fails; with 0.05 more or less 73 % or 27 % of them fail."""

    @model_validator(mode="after")
    def _is_known_beforehand(self) -> Self:
        if self.requires_valid and self.canopy_loss:
            raise ValueError("canopy_loss = false beside requires_valid = true")
        return self
