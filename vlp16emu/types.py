"""The types that the rooms exchange: frozen, with slots, shapes checked once when made.

Letters in shapes: k firing sequences in a batch, L lasers in **wire order** (16 on a VLP-16), m surfaces, n
anything else. Frames: `world` is local east-north-up in metres; `body` is x forward, y left, z up, and so is
`sensor`, whose azimuth 0 is forward and grows clockwise seen from above. `world_T_body` takes body to world
coordinates; `world_T_body @ body_T_sensor` reads left to right.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from functools import cache
from typing import TYPE_CHECKING, Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from vlp16emu.models import MODEL_NAMES

# Arrays by numpy's type codes
F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
I4 = NDArray[np.int32]
I8 = NDArray[np.int64]
U1 = NDArray[np.uint8]
U2 = NDArray[np.uint16]
U4 = NDArray[np.uint32]
U8 = NDArray[np.uint64]


class ReturnMode(StrEnum):
    """Echoes that the sensor reports (63-9243 Rev D, section 6)."""

    STRONGEST = "strongest"
    LAST = "last"
    DUAL = "dual"


if TYPE_CHECKING:

    class SensorModel(StrEnum):
        """Sensor models whose packets are known: the tables of `protocol/models`."""

        VLP_16 = "vlp-16"

else:  # a type checker reads no folder
    SensorModel = StrEnum(
        "SensorModel", {name.upper().replace("-", "_"): name for name in MODEL_NAMES}, module=__name__
    )


class PpsState(IntEnum):
    """State of the pulse-per-second input, with its value on the wire (63-9243 Rev D, section 9.3.3)."""

    ABSENT = 0
    SYNCHRONIZING = 1
    LOCKED = 2
    ERROR = 3


class PacketKind(StrEnum):
    """Kind of a packet.

    It is from the sensor, a GPS sentence, the level after an edge of the pulse, or an inertial sample.
    """

    DATA = "data"
    POSITION = "position"
    NMEA = "nmea"
    PPS = "pps"
    IMU = "imu"


class Semantic(IntEnum):
    """Semantic class of a surface."""

    NONE = 0
    GROUND = 1
    TREE = 2
    SHRUB = 3
    STONE = 4
    DEADWOOD = 5
    GRASS = 6
    OTHER = 7


class PlantPart(IntEnum):
    """Part of a plant. Leaf or wood follows from it: leaf is `LEAF`, all others but `NONE` are wood."""

    NONE = 0
    STEM = 1
    BRANCH_FIRST_ORDER = 2
    BRANCH_HIGHER_ORDER = 3
    LEAF = 4
    ROOT_FLARE = 5
    DEAD_BRANCH = 6


SURFACE = np.dtype(
    [
        ("reflectance", "<f4"),  # at 903 nm: 1 for a white Lambertian surface, more for a retroreflector
        ("material", "<u2"),  # number in the world's list of materials
        ("semantic", "u1"),  # Semantic
        ("part", "u1"),  # PlantPart
        ("instance", "<u4"),  # 0 none, else unique per plant, stone or object
        ("species", "<u2"),  # 0 none, else number in the species table
        ("texture", "<f4"),  # relative local variation of reflectance, one sigma
        ("shading", "<f4"),  # relative smooth variation of reflectance over metres, one sigma
        ("relief_m", "<f4"),  # local offset from its mesh, one sigma
        ("roughness", "<f4"),  # root mean square slope of the facets of a glossy coat; 0 for a matt surface
    ]
)
"""One row of a window's surface table."""

NO_SURFACE = np.uint32(0xFFFFFFFF)  # Surface of a pulse that hit nothing
FIRST_FREE_INSTANCE = (
    0xFFFF0000  # First instance of the user's objects and of people; worlds number theirs below
)
ShapeKey = Hashable  # Key of a shape: equal keys mean equal bytes of geometry


_dtype = cache(np.dtype)


def _fits(have: tuple[int, ...], want: tuple[int | None, ...]) -> bool:
    # Mostly the first comparison decides; arrays of a step of a live run are checked each 5 ms.
    return have == want or (
        len(have) == len(want)
        and all(axis is None or size == axis for size, axis in zip(have, want, strict=True))
    )


def _check(owner: object, dtype: str, **shapes: tuple[int | None, ...]) -> None:
    """Check the dtype of arrays, their number of axes, and every axis that is not None."""
    wanted = _dtype(dtype)
    for name, shape in shapes.items():
        array = getattr(owner, name)
        if not (isinstance(array, np.ndarray) and array.dtype == wanted and _fits(array.shape, shape)):
            want = "(" + ", ".join("n" if axis is None else str(axis) for axis in shape) + ")"
            found = f"{array.shape} {array.dtype}" if isinstance(array, np.ndarray) else type(array).__name__
            raise ValueError(
                f"{type(owner).__name__}.{name}: found {found}, expected {want} {np.dtype(dtype)}"
            )


@dataclass(frozen=True, slots=True)
class Poses:
    """Poses of the body at n instants; n = 1 stands for a body that never moves."""

    t_ns: I8  # (n,) UTC
    world_R_body: F8  # (n, 3, 3) rotation, body to world
    world_p_body_m: F8  # (n, 3) origin of the body in the world

    def __post_init__(self) -> None:
        n = len(self.t_ns)
        _check(self, "i8", t_ns=(None,))
        _check(self, "f8", world_R_body=(n, 3, 3), world_p_body_m=(n, 3))


@dataclass(frozen=True, slots=True)
class Firings:
    """k firing sequences of L lasers, each pulse with its own instant, origin and direction."""

    index: int  # Number of the first firing sequence since the run began
    t_ns: I8  # (k, L) UTC of each pulse
    clock_ns: I8  # (k,) sensor's clock at the first laser, ns past its hour
    azimuth_deg: F8  # (k, L) true rotor angle of each pulse, [0, 360)
    reading_deg: F8  # (k,) encoder reading at the first laser, [0, 360); the true angle plus encoder errors
    origin_m: F8  # (k, L, 3) world; the point on the spin axis from which the range is measured
    direction: F8  # (k, L, 3) world, unit length
    beam_axis: F8 | None
    """(k, L, 3) as `direction`, perpendicular to it, level in the sensor, towards greater azimuths; None for
    single rays."""

    def __post_init__(self) -> None:
        k, lasers = self.t_ns.shape
        places = (k, lasers, 3)
        _check(self, "i8", t_ns=(k, lasers), clock_ns=(k,))
        _check(self, "f8", azimuth_deg=(k, lasers), reading_deg=(k,), origin_m=places, direction=places)
        if self.beam_axis is not None:
            _check(self, "f8", beam_axis=places)

    @classmethod
    def rays(cls, t_ns: int, origin_m: F8, direction: F8) -> Self:
        """Make rays without a sensor, all at one instant; origins and directions broadcast to (k, L, 3)."""
        origin_m, direction = (np.array(of, order="C") for of in np.broadcast_arrays(origin_m, direction))
        shape = direction.shape[:2]
        angle_deg = np.zeros(shape)
        n = np.zeros(shape[0], np.int64)
        return cls(
            0, np.full(shape, t_ns, np.int64), n, angle_deg, angle_deg[:, 0].copy(), origin_m, direction, None
        )


@dataclass(frozen=True, slots=True)
class Hits:
    """Hits of sub-rays, pulse by pulse in order of sequence, then of laser.

    Sub-rays of a pulse have equal energy.
    """

    count: U2  # (k, L) sub-rays of each pulse, at least 1; n in all
    range_m: F4  # (n,) from the pulse's origin; +inf without a hit
    surface: U4  # (n,) row of the window's surface table; `NO_SURFACE` without a hit
    cos_incidence: F4  # (n,) between the ray and the surface normal, 0..1; 0 without a hit

    def __post_init__(self) -> None:
        n = len(self.range_m)
        _check(self, "u2", count=(None, None))
        _check(self, "u4", surface=(n,))
        _check(self, "f4", range_m=(None,), cos_incidence=(n,))

    @classmethod
    def one_ray_each(cls, range_m: F4, surface: U4, cos_incidence: F4) -> Self:
        """Make hits of pulses with one ray each, from arrays (k, L)."""
        count = np.ones(range_m.shape, np.uint16)
        return cls(count, range_m.reshape(-1), surface.reshape(-1), cos_incidence.reshape(-1))


@dataclass(frozen=True, slots=True)
class Returns:
    """Returns of the detector. Last axis: strongest, last, second strongest."""

    firings: Firings
    distance_m: F4  # (k, L, 3) not yet on the 2 mm grid; 0 without such a return
    reflectivity: U1  # (k, L, 3) 0..100 diffuse, 101..255 retroreflective
    surface: U4 | None = None  # (k, L, 3) ground truth, only on request, like all fields below
    surfaces: NDArray[np.void] | None = None  # (m,) `SURFACE`, the table that `surface` indexes
    range_m: F4 | None = None  # (k, L, 3) without range errors; 0 without an echo; a lost record keeps it
    share: F4 | None = None  # (k, L, 3) share of the footprint on the surface, at any range
    mode: ReturnMode = ReturnMode.STRONGEST  # which of them the sensor sends
    is_sent: NDArray[np.bool_] | None = None  # (k,) firing sequences that the sensor sends; None for all

    def __post_init__(self) -> None:
        shape = *self.firings.t_ns.shape, 3
        _check(self, "f4", distance_m=shape)
        _check(self, "u1", reflectivity=shape)
        for name, dtype in (("surface", "u4"), ("range_m", "f4"), ("share", "f4")):
            if getattr(self, name) is not None:
                _check(self, dtype, **{name: shape})


@dataclass(frozen=True, slots=True)
class Packet:
    """Bytes and the instant at which a real sensor would have sent them."""

    kind: PacketKind
    due_ns: int  # UTC at which the last byte has been produced and the datagram is sent
    payload: bytes
    unit: int = 0  # Index in the rig of its sensor, from 0
    fired_ns: int | None = None  # UTC of the first pulse in an emulated data packet
    number: int = 0  # of a position packet: count of its unit's earlier ones, also unsent; part of the frame
    slots: NDArray[np.void] | None = (
        None  # (384,) of a data packet: ground truth of each record, only on request
    )

    def at(self, due_ns: int) -> "Packet":
        """Return the packet with another time, as `dataclasses.replace` in a third of the time."""
        return Packet(self.kind, due_ns, self.payload, self.unit, self.fired_ns, self.number, self.slots)


class PacketSink(Protocol):
    """A destination of packets: a context manager that is open once it is made.

    Derived classes have nothing to close unless they override `__exit__`.
    """

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Close the sink."""
        return

    def send(self, packet: Packet) -> None:
        """Send one packet at once."""


@dataclass(frozen=True, slots=True)
class Labels:
    """Ground truth of n points: the reflecting surface of each."""

    semantic: U1  # (n,) `Semantic`
    part: U1  # (n,) `PlantPart`
    instance: U4  # (n,) unique per plant, stone or object; 0 none
    species: U2  # (n,) number in the species table; 0 none
    range_m: F4  # (n,) distance without range errors


@dataclass(frozen=True, slots=True)
class Scan:
    """One revolution: n points in the order of their pulses; pulses without return give no point.

    A revolution begins with the first azimuth reading (one in two firing sequences) that has passed
    0. In dual return each echo is present once, the last one first.

    Each point is in the sensor's frame at the instant of its own pulse. `world_T_sensor` is the pose at
    `start_ns` alone: on a moving sensor it is valid only for the scan's first points. The poses of all points
    are `Emulator.world_T_sensor(scan.t_ns)`.
    """

    start_ns: int  # UTC of the revolution's first pulse, whether or not it has a return
    t_ns: I8
    """(n,) UTC of the pulse. For a capture: by the clock chosen for `decode`, in whole microseconds for each
    packet."""
    xyz_m: F4  # (n, 3) in the sensor: x forward at azimuth 0, y left, z up
    distance_m: F4  # (n,) from the centre of the sensor
    azimuth_deg: F8  # (n,) at the instant of the pulse, [0, 360)
    ring: U2  # (n,) by elevation, 0 the lowest
    reflectivity: U1  # (n,) 0..100 diffuse, 101..255 retroreflective
    is_last: NDArray[np.bool_]
    """(n,) True for a last return; else the strongest, or in dual return, if that is the last, the second
    strongest."""
    world_T_sensor: F8 | None = None
    """(4, 4) transform of `xyz_m` to the world (local east, north, up) at `start_ns`; None for a capture."""
    labels: Labels | None = None  # Only with `truth`


@dataclass(frozen=True, slots=True)
class GnssFix:
    """Fix of a GNSS receiver at one whole UTC second."""

    t_ns: int  # UTC, a whole second
    valid: bool
    latitude_deg: float
    longitude_deg: float
    speed_m_s: float
    course_deg: float  # Over ground, clockwise from north, [0, 360)


@dataclass(frozen=True, slots=True)
class Mesh:
    """Faces of one surface, in the coordinates of its shape."""

    vertices_m: F4  # (v, 3)
    faces: U4  # (f, 3) triangles or (f, 4) planar quads, counter-clockwise seen from outside

    def __post_init__(self) -> None:
        _check(self, "f4", vertices_m=(None, 3))
        _check(self, "u4", faces=(None, 4 if self.faces.shape[1:] == (4,) else 3))


@dataclass(frozen=True, slots=True)
class Sway:
    """Motion of m placements of a window that bend over their feet, linear in time between knots.

    A point of a placement moves level by `top_m` times the curve at its height. Below the foot nothing moves,
    and above the top the curve goes on straight. Each piece of a shape moves as the chord of the curve over
    the piece's height.
    """

    start_ns: int  # UTC of the first knot
    step_ns: int  # Time from knot to knot
    placement: I8  # (m,) in the window, ascending
    foot_z_m: F8  # (m,) height of each one's foot in the world
    height_m: F8  # (m,) from foot to top
    curve: F8  # (m, c) at even steps of height, from 0 at the foot to 1 at the top
    top_m: F8  # (k, m, 2) movement of the top at each knot, towards x and y; at least two knots

    def __post_init__(self) -> None:
        m = len(self.placement)
        _check(self, "i8", placement=(m,))
        _check(self, "f8", foot_z_m=(m,), height_m=(m,), curve=(m, None), top_m=(None, m, 2))

    def of_part(self, keep: NDArray[np.bool_]) -> "Sway":
        """Return the motion in a window that keeps the placements of a mask (n,) alone."""
        moves = keep[self.placement]
        return Sway(
            self.start_ns,
            self.step_ns,
            (np.cumsum(keep) - 1)[self.placement[moves]],
            self.foot_z_m[moves],
            self.height_m[moves],
            self.curve[moves],
            self.top_m[:, moves],
        )

    def shares(self, row: I8, z_m: F8) -> F8:
        """Return the shares (n,) of the top's movement at heights (n,) in the world, by rows (n,) of m."""
        steps = self.curve.shape[1] - 1
        at = np.maximum(z_m - self.foot_z_m[row], 0.0) / self.height_m[row] * steps
        knot = np.minimum(at, steps - 1).astype(np.int64)
        below = self.curve[row, knot]
        shares: F8 = below + (at - knot) * (self.curve[row, knot + 1] - below)
        return shares


@dataclass(frozen=True, slots=True)
class Window:
    """Placed shapes and their surfaces within reach of a stretch of the walk.

    A shape is a tuple of meshes that share one frame. Mesh j of placement i shows surface `first_surface[i] +
    j`.
    """

    origin_m: F8  # (3,) world; the caster's geometry is relative to it
    shapes: tuple[ShapeKey, ...]
    shape: I4  # (n,) index into `shapes`
    world_T_shape: F8  # (n, 3, 4) affine; rigid, or scaled for crowns
    first_surface: U4  # (n,) row of `surfaces` of the placement's first mesh
    surfaces: NDArray[np.void]  # (m,) `SURFACE`
    sway: Sway | None = None  # Motion over the time of the window; None if nothing moves

    def __post_init__(self) -> None:
        n = len(self.shape)
        _check(self, "i4", shape=(n,))
        _check(self, "u4", first_surface=(n,))
        _check(self, "f8", origin_m=(3,), world_T_shape=(n, 3, 4))

    def with_more(self, count: int) -> dict[str, Any]:  # noqa: ARG002  # windows with more fields need it
        """Return the other fields of the window for `count` placements that are appended."""
        return {}


AnyArray = NDArray[Any]  # an array whose type depends on what it holds
HeightField = Callable[[F8, F8], F8]  # Ground height in metres over arrays of x and y in metres


@dataclass(frozen=True, slots=True)
class Inertial:
    """Samples of an inertial unit at n instants, in its own axes."""

    t_ns: I8  # (n,) UTC
    angular_rate_rad_s: F8  # (n, 3)
    specific_force_m_s2: F8  # (n, 3) acceleration minus gravity: at rest it points up
    true_angular_rate_rad_s: F8  # (n, 3) without errors, like the next field
    true_specific_force_m_s2: F8
    gyro_bias_rad_s: F8
    """(n, 3) bias at switch-on and its random walk since, like the next field; the rest of an error is white
    noise."""
    accel_bias_m_s2: F8
    world_R_imu: F8 | None = None
    """(n, 3, 3) attitude that the unit reports, with its drift; None without `attitude`."""
    stamp_ns: I8 | None = None  # (n,) UTC of the unit's time stamps; None if equal to `t_ns`


class MovingTrees(Protocol):
    """The trees of a world in the wind."""

    def with_sway(self, window: Window, track_m: F8, start_ns: int, stop_ns: int) -> Window:
        """Return a window around positions (n, 3), with the sway of its trees between instants, UTC."""


class World(Protocol):
    """A world at rest: it describes windows and grows shapes."""

    @property
    def near_m(self) -> float:
        """Range beyond which it is a far medium, square by square (`vlp16emu.foliage.tiles`).

        It is inf for none.
        """

    @property
    def seed(self) -> int:
        """Seed of the world's random numbers."""

    def shape_name(self, key: ShapeKey) -> str:
        """Return a text with all inputs of a shape; empty if it is not kept on disk."""

    def window(self, track_m: F8) -> Window:
        """Return the window within reach of sensor positions (n, 3); it depends on nothing else."""

    def shape(self, key: ShapeKey) -> tuple[Mesh, ...]:
        """Grow the meshes of a shape; the same key always gives the same bytes, on any thread."""
