"""Footprint of a pulse, and the sub-rays that sample it.

At range D the beam is `spot + divergence * D` wide: on a VLP-16 horizontally 12.7 mm + 3.0 mrad, vertically
9.5 mm + 1.5 mrad. Divergences are full angles, the growth of the beam's diameter (VLS-128 manual, appendix
F.2.3, table F-1). Assumption: the diameter is the 1/e2 diameter of a Gaussian profile, so four standard
deviations. A sub-ray with standard normal coordinates (x, y) starts x and y standard deviations of the spot
off the centre of the lens, and leans x and y standard deviations of the divergence off the pulse's direction.

Sub-rays of an adaptive beam are support points of that profile: the set of eight with the least energy
distance to it (Mak and Joseph, "Support points", Annals of Statistics 46, 2018), and each further eight the
best addition to the previous ones. A pulse rotates and mirrors them at random. Sub-rays of a fixed beam, and
of an adaptive one from the 65th on, are points of the R2 sequence, steps of the plastic number and of its
square (M. Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018), shifted in the unit
square by two random numbers of the pulse (Cranley and Patterson, SIAM J. Numer. Anal. 13, 1976) and mapped to
the plane by Box and Muller (1958): each alone is a random draw from the profile, so that means over any
number of them are unbiased.
"""

from dataclasses import dataclass, replace

import numpy as np

from vlp16emu.elementary import cos, log, sin
from vlp16emu.kernels.compiler import inline_kernel, kernel
from vlp16emu.random import Purpose, uniform_pair
from vlp16emu.raycast.adaptive import RayBudget, worth_of_ray_m
from vlp16emu.raycast.settings import Beam
from vlp16emu.types import F4, F8, Firings

_PLASTIC = 1.32471795724474602596
_STEP_U, _STEP_V = np.uint32(round(2**32 / _PLASTIC)), np.uint32(round(2**32 / (_PLASTIC * _PLASTIC)))
ROUND = 8  # sub-rays per round: a packet
_Y = 4 * ROUND  # offset of the row of the first direction; used before for a coordinate of the profile
_TOGETHER = 8
_USUAL_RAYS = 64
_MOST_RAYS = 512
"""Revolutions cast at once, so that geometry in one direction stays in the cache; and, over all of them,
usual and greatest number of sub-rays per direction."""
_BITS = 12
_SHIFT = np.uint32(32 - _BITS)
_TURN = int(Purpose.FOOTPRINT)


@dataclass(frozen=True, slots=True)
class Footprint:
    """Footprint of a unit's pulses: the beam profile and its sub-rays."""

    section: Beam
    seed: int = 0  # of the unit
    resolution_m: float = 0.0  # echoes farther apart than this are separate
    threshold: float = 0.0
    """Amplitude at which half of the echoes are seen, in m-2; 0 if every echo is seen."""
    amplitude_noise: float = 0.0  # of the receiver, one sigma
    blank_m: float = 0.0  # range below which nothing gives an echo

    def with_settings(self, **settings: object) -> "Footprint":
        """Return this footprint with other settings of its section."""
        return replace(self, section=self.section.model_copy(update=settings))

    @property
    def rays(self) -> int:
        """Greatest number of rays of a pulse."""
        return 1 if self.section.model == "none" else self.section.rays

    @property
    def has_width(self) -> bool:
        """True if casting needs `Firings.beam_axis`."""
        return self.section.model in ("fixed", "adaptive", "angle")

    @property
    def revolutions_at_once(self) -> int:
        """Best number of revolutions to cast at once: fewer if that would take long, or much memory."""
        usual = {"fixed": self.rays, "adaptive": ROUND}.get(self.section.model, 1)
        return max(1, min(_TOGETHER, _USUAL_RAYS // usual, _MOST_RAYS // self.rays))

    @property
    def budget(self) -> RayBudget:
        """Budget of sub-rays for its pulses."""
        return RayBudget(
            max_rays=1 if self.section.model == "angle" else self.rays,
            adaptive=self.section.model == "adaptive",
            worth_m=worth_of_ray_m(self.section.target_m),
            resolution_m=self.resolution_m,
            threshold=self.threshold,
            amplitude_noise=self.amplitude_noise,
            blank_m=self.blank_m,
        )

    @property
    def sigmas(self) -> F8:
        """Standard deviations (4,): spot horizontal and vertical in m, divergence likewise in radians."""
        section = self.section
        return np.array([1e-3 * width for width in (*section.spot_mm, *section.divergence_mrad)]) / 4


LINE = Footprint(Beam(model="none", spot_mm=(0.0, 0.0), divergence_mrad=(0.0, 0.0)))  # light without width


def _ring_radii() -> F8:
    outside = 1.0 - np.arange(2**_BITS) / 2**_BITS
    mass = np.append(2 * outside * (1 - log(outside)), 0.0)  # of r squared, outside a ring's inner edge
    return np.sqrt((mass[:-1] - mass[1:]) * 2**_BITS)


_RADIUS = _ring_radii().astype(np.float32)
_ANGLE_RAD = (np.arange(2**_BITS) + 0.5) * (2 * np.pi / 2**_BITS)
_COS, _SIN = cos(_ANGLE_RAD).astype(np.float32), sin(_ANGLE_RAD).astype(np.float32)
# fmt: off
_SUPPORT = np.array(
    [
        (-0.9458, 1.1317), (0.9461, -1.1316), (0.6283, 1.3338), (-1.2934, -0.1659), (1.2939, 0.1667),
        (-0.049, 0.3819), (-0.6295, -1.3339), (0.0493, -0.3827), (-0.6539, 0.4392), (-0.234, 1.827),
        (0.1832, -1.429), (-0.489, -0.346), (0.5224, 0.5896), (0.5604, -0.2113), (-1.9061, -0.7242),
        (2.026, -0.222), (0.6835, 0.1903), (-0.8079, -0.7282), (1.5017, 1.2763), (0.4214, -0.6726),
        (0.5746, -2.1377), (-0.1437, 0.9725), (-1.7592, 0.8349), (-0.3562, 0.0772), (-0.9679, 0.1536),
        (0.1382, -0.0286), (-1.2171, -1.6406), (0.1636, 0.7868), (-1.0461, 1.8269), (1.3199, -0.6968),
        (-0.0956, -0.8377), (1.2081, 0.6668), (-0.7314, -0.2611), (0.7885, 1.9613), (-0.2284, -1.0851),
        (-0.4793, 0.7639), (0.8952, -0.3184), (1.6819, -1.3871), (-1.7866, 0.1293), (0.2923, 0.2513),
        (0.6408, -0.681), (0.679, 0.7898), (-0.1817, 1.2944), (-1.0685, 0.6143), (1.8453, 0.4748),
        (-0.29, -1.8807), (-0.149, -0.178), (-1.1914, -0.6987), (-0.3043, -0.6558), (0.8752, 0.2723),
        (0.2549, 1.5323), (-0.6131, 0.0574), (1.2965, -0.3276), (0.4548, -1.164), (-0.2368, 0.4726),
        (-2.5881, 0.132), (-0.7341, 0.6358), (0.084, -0.6261), (-1.1313, -1.1229), (0.2428, 0.5152),
        (-1.3671, 1.3364), (0.3417, -0.1577), (0.948, -1.6559), (2.1707, 1.3263),
    ],
    np.float32,
)
# fmt: on
"""(64, 2) in standard deviations."""
_REACH = np.append(
    np.sqrt(np.square(_SUPPORT).sum(axis=1)).reshape(-1, ROUND).max(axis=1), _RADIUS.max()
).astype(np.float32)
FARTHEST = float(_REACH[-1])  # greatest distance of a sub-ray from the centre, in standard deviations


@kernel
def draw_pattern(seed: int, firing: int, laser: int) -> tuple[np.uint32, np.uint32]:
    """Draw the two random numbers of a pulse's sub-ray pattern, in steps of 2**-32."""
    u, v = uniform_pair(seed, _TURN, firing, laser)
    return np.uint32(u * 2.0**32), np.uint32(v * 2.0**32)


@kernel
def fill_sub_rays(
    rays: F4, axes: F4, sigmas: F4, u: np.uint32, v: np.uint32, first: int, support: bool
) -> None:
    """Fill eight sub-rays of a pulse, from number `first` on.

    Rows of eight: origins in rows 0 to 2, unit directions in rows 4 to 6.

    Parameters
    ----------
    rays : (56 or more,) rows of eight, as in `RayPacket`
    axes : (4, 3) origin, direction, horizontal and vertical axis of the pulse, by `pulse_axes`
    sigmas : (4,) as in `Footprint`
    u, v : random numbers of the pulse, from `draw_pattern`
    support : whether the first 64 are support points
    """
    if support and first < len(_SUPPORT):
        cosine, sine = _COS[v >> _SHIFT], _SIN[v >> _SHIFT]
        mirror = np.float32(1.0) if u & np.uint32(1) else np.float32(-1.0)
        for lane in range(ROUND):
            a, b = _SUPPORT[first + lane, 0] * mirror, _SUPPORT[first + lane, 1]
            rays[lane] = a * cosine - b * sine
            rays[_Y + lane] = a * sine + b * cosine
    else:
        for lane in range(ROUND):
            ring = np.uint32(u + np.uint32(first + lane) * _STEP_U) >> _SHIFT
            turned = np.uint32(v + np.uint32(first + lane) * _STEP_V) >> _SHIFT
            rays[lane] = _RADIUS[ring] * _COS[turned]
            rays[_Y + lane] = _RADIUS[ring] * _SIN[turned]
    spot_x_m = sigmas[0]
    spot_y_m = sigmas[1]
    spread_x = sigmas[2]
    spread_y = sigmas[3]
    x_m = axes[0, 0]
    y_m = axes[0, 1]
    z_m = axes[0, 2]
    along_x = axes[1, 0]
    along_y = axes[1, 1]
    along_z = axes[1, 2]
    level_x, level_y, level_z = axes[2, 0], axes[2, 1], axes[2, 2]
    up_x, up_y, up_z = axes[3, 0], axes[3, 1], axes[3, 2]
    for lane in range(ROUND):
        a, b = rays[lane], rays[_Y + lane]
        a_m = a * spot_x_m
        b_m = b * spot_y_m
        lean_a = a * spread_x
        lean_b = b * spread_y
        scale = np.float32(1.0) / np.sqrt(np.float32(1.0) + lean_a * lean_a + lean_b * lean_b)
        rays[lane] = x_m + level_x * a_m + up_x * b_m
        rays[ROUND + lane] = y_m + level_y * a_m + up_y * b_m
        rays[2 * ROUND + lane] = z_m + level_z * a_m + up_z * b_m
        rays[_Y + lane] = (along_x + level_x * lean_a + up_x * lean_b) * scale
        rays[_Y + ROUND + lane] = (along_y + level_y * lean_a + up_y * lean_b) * scale
        rays[_Y + 2 * ROUND + lane] = (along_z + level_z * lean_a + up_z * lean_b) * scale


@inline_kernel
def reach_of(first: int, support: bool) -> np.float32:
    """Return the greatest distance from the centre, in sigmas, of the round that begins at `first`."""
    return _REACH[first // ROUND] if support and first < len(_SUPPORT) else _REACH[-1]


@kernel
def pulse_axes(origin_m: F8, direction: F8, beam_axis: F8, from_m: F8, i: int, j: int, axes: F4) -> None:
    """Fill axes (4, 3) of pulse i, j of arrays (k, L, 3), its origin relative to `from_m` (3,)."""
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        axes[0, a] = np.float32(origin_m[i, j, a] - from_m[a])
        axes[1, a] = np.float32(direction[i, j, a])
        axes[2, a] = np.float32(beam_axis[i, j, a])
        axes[3, a] = np.float32(
            beam_axis[i, j, b] * direction[i, j, c] - beam_axis[i, j, c] * direction[i, j, b]
        )


def beam_axis_of(firings: Firings, beam: Footprint) -> F8:
    """Horizontal axes of the footprints, (k, L, 3).

    Raises ValueError if the firings have none.
    """
    if firings.beam_axis is None:
        raise ValueError(
            f"cast: found firings without `beam_axis`, expected them for a beam of {beam.section.model}"
        )
    return firings.beam_axis
