"""What a pulse's light covers, and where its sub-rays go.

At range D the beam is `spot + divergence * D` wide: on a VLP-16 horizontally 12.7 mm + 3.0 mrad, vertically
9.5 mm + 1.5 mrad. Divergences are full angles, the growth of the beam's diameter (VLS-128 manual, appendix F.2.3,
table F-1). Assumption: the diameter is that at 1/e2 of a Gaussian profile, so four standard deviations. A sub-ray
with standard normal coordinates (x, y) starts x and y quarters of the spot off the middle of the lens, and leans
x and y quarters of the divergence off the pulse's direction.

Sub-ray i of a pulse is point i of the R2 sequence, steps of the plastic number and of its square (M. Roberts, "The
unreasonable effectiveness of quasirandom sequences", 2018), shifted around the unit square by two random
numbers of the pulse (Cranley and Patterson, SIAM J. Numer. Anal. 13, 1976) and laid on the plane by Box and Muller
(1958). Each sub-ray alone is a fair draw from the profile, so means over them have no bias, and the first s
of them lie evenly for every s. RMS errors of a mean, over 3000 shifts (`tools/convergence` prints them anew):

    sub-rays                        4      8     16     32     64    256   1024   order
    range of a tilted plane, sd   0.29   0.18   0.07   0.05   0.03   0.02   0.01   0.65
    share beyond a straight edge  0.145  0.087  0.051  0.032  0.018  0.007  0.002  0.75
    the same by random points     0.203  0.147  0.101  0.075  0.051  0.025  0.013  0.50

Sub-rays of an adaptive footprint come in rounds of eight. The first of a round lies in the innermost eighth of the
light, that of the first round in its very middle: the ray by which the pulse was judged. The other seven lie in
the rest, so each stands for an eighth.

Sobol' points are as good at powers of two and worse between; a van der Corput and golden-angle pair is worse on edges.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.random import Purpose, uniform_pair
from vlp16emu.types import Firings

__all__ = [
    "LINE",
    "ROUND",
    "BeamModel",
    "Footprint",
    "across_of",
    "displace",
    "pulse_axes",
    "sub_ray",
    "sub_rays",
    "turn",
]

_PLASTIC = 1.32471795724474602596
_STEP_U, _STEP_V = np.uint32(round(2**32 / _PLASTIC)), np.uint32(round(2**32 / _PLASTIC**2))
ROUND = 8
"""Sub-rays per round of an adaptive footprint: a packet. Rounds of 4 and 6 take a tenth fewer, and a tenth more time,
for the same error."""
_TOGETHER, _USUAL_RAYS, _MOST_RAYS = 8, 64, 512
"""Revolutions at once, in which what stands in one direction stays in the cache; and, over all of them, sub-rays of a
direction as a rule, and at most."""
_FIRST_PART = np.uint32(2**32 // ROUND)
_BITS = 12
_SHIFT = np.uint32(32 - _BITS)
_TURN, _DISPLACEMENT = int(Purpose.FOOTPRINT), int(Purpose.BEAM_ERROR)


class BeamModel(StrEnum):
    """What a pulse is made of. `angle` and `offset` are the beam errors of LiDAR-Forest (Lu et al.), for comparison."""

    NONE = "none"
    """One ray along the middle of the beam."""
    FIXED = "fixed"
    """The same number of sub-rays for each pulse."""
    ADAPTIVE = "adaptive"
    """One ray where the footprint sees one smooth surface, more where it is split."""
    ANGLE = "angle"
    """One ray, drawn from the profile."""
    OFFSET = "offset"
    """One ray along the middle, its hit displaced inside the beam; see `displace`."""


@dataclass(frozen=True, slots=True)
class Footprint:
    """How the light of a pulse is spread, and by how many rays it is followed."""

    model: BeamModel
    rays: int
    """Sub-rays of each pulse of a fixed footprint, and the most of an adaptive one."""
    target_m: float
    """Error that an adaptive footprint aims at; see `adaptive`."""
    resolution_m: float
    """Echoes farther apart than this are separate."""
    spot_m: tuple[float, float]
    """Width at the lens, horizontal and vertical."""
    divergence_rad: tuple[float, float]
    """Full angle, horizontal and vertical."""
    seed: int
    """The scenario's."""

    @property
    def has_width(self) -> bool:
        """Whether casting needs `Firings.across`."""
        return self.model in (BeamModel.FIXED, BeamModel.ADAPTIVE, BeamModel.ANGLE)

    @property
    def together(self) -> int:
        """Revolutions that are best cast at once: fewer where that would be long, or take much room."""
        usual = {BeamModel.FIXED: self.rays, BeamModel.ADAPTIVE: ROUND}.get(self.model, 1)
        return max(1, min(_TOGETHER, _USUAL_RAYS // usual, _MOST_RAYS // self.rays))

    @property
    def quarters(self) -> NDArray[np.float64]:
        """(4,) standard deviations: spot horizontal and vertical in metres, divergence likewise in radians."""
        return np.array([*self.spot_m, *self.divergence_rad]) / 4


LINE = Footprint(BeamModel.NONE, 1, 0.0, 0.0, (0.0, 0.0), (0.0, 0.0), 0)
"""Light without width."""


def _ring_radii() -> NDArray[np.float64]:
    """Radii of rings of equal energy about a unit Gaussian's middle, each the root mean square over its ring."""
    outside = 1.0 - np.arange(2**_BITS) / 2**_BITS
    mass = np.append(2 * outside * (1 - np.log(outside)), 0.0)  # of r squared, outside of a ring's inner edge
    return np.sqrt((mass[:-1] - mass[1:]) * 2**_BITS)


_RADIUS = _ring_radii()
_ANGLE_RAD = (np.arange(2**_BITS) + 0.5) * (2 * np.pi / 2**_BITS)
_COS, _SIN = np.cos(_ANGLE_RAD), np.sin(_ANGLE_RAD)


@numba.njit(cache=True, nogil=True, _nrt=False)
def turn(seed: int, firing: int, laser: int) -> tuple[np.uint32, np.uint32]:
    """Shift of a pulse's pattern around the unit square, in steps of 2**-32."""
    u, v = uniform_pair(seed, _TURN, firing, laser)
    return np.uint32(u * 2.0**32), np.uint32(v * 2.0**32)


@numba.njit(cache=True, nogil=True, _nrt=False)
def sub_ray(
    axes: NDArray[np.float64],
    r: int,
    quarters: NDArray[np.float64],
    u: np.uint32,
    v: np.uint32,
    i: int,
    by_rounds: bool,
) -> tuple[float, float, float, float, float, float]:
    """Lay sub-ray i of a pulse: its origin in metres and its unit direction.

    Parameters
    ----------
    axes, r : row r is that of the pulse, by `pulse_axes`
    quarters : as in `Footprint`
    u, v : shifts of the pulse, by `turn`
    by_rounds : whether the first of each `ROUND` lies in the innermost part of the light, the others in the rest
    """
    outward = np.uint32(u + np.uint32(i) * _STEP_U)  # share of the light inside, in steps of 2**-32
    if by_rounds:
        inner = outward // np.uint32(ROUND)
        outward = inner if i % ROUND == 0 else np.uint32(outward - inner + _FIRST_PART)
    ring = outward >> _SHIFT
    way = np.uint32(v + np.uint32(i) * _STEP_V) >> _SHIFT
    radius = 0.0 if by_rounds and i == 0 else _RADIUS[ring]
    x, y = radius * _COS[way], radius * _SIN[way]
    x_m, y_m, lean_x, lean_y = x * quarters[0], y * quarters[1], x * quarters[2], y * quarters[3]
    scale = 1.0 / math.sqrt(1.0 + lean_x * lean_x + lean_y * lean_y)
    return (
        axes[r, 0] + axes[r, 6] * x_m + axes[r, 9] * y_m,
        axes[r, 1] + axes[r, 7] * x_m + axes[r, 10] * y_m,
        axes[r, 2] + axes[r, 8] * x_m + axes[r, 11] * y_m,
        (axes[r, 3] + axes[r, 6] * lean_x + axes[r, 9] * lean_y) * scale,
        (axes[r, 4] + axes[r, 7] * lean_x + axes[r, 10] * lean_y) * scale,
        (axes[r, 5] + axes[r, 8] * lean_x + axes[r, 11] * lean_y) * scale,
    )


@numba.njit(cache=True, nogil=True, _nrt=False)
def pulse_axes(
    origin_m: NDArray[np.float64],
    direction: NDArray[np.float64],
    across: NDArray[np.float64],
    i: int,
    j: int,
    axes: NDArray[np.float64],
    r: int,
) -> None:
    """Fill row r of axes (n, 12): origin, direction, horizontal and vertical axis of pulse i, j of arrays (k, L, 3)."""
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        axes[r, a], axes[r, 3 + a], axes[r, 6 + a] = origin_m[i, j, a], direction[i, j, a], across[i, j, a]
        axes[r, 9 + a] = across[i, j, b] * direction[i, j, c] - across[i, j, c] * direction[i, j, b]


def across_of(firings: Firings, beam: Footprint) -> NDArray[np.float64]:
    """Horizontal axes of the footprints, (k, L, 3).

    Raises
    ------
    ValueError
        where the firings have none
    """
    if firings.across is None:
        raise ValueError(f"cast: found firings without `across`, expected them for a beam of {beam.model}")
    return firings.across


def sub_rays(
    firings: Firings, beam: Footprint, first: NDArray[np.int64], last: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lay sub-rays first .. last - 1 of every pulse, in order of pulses.

    Parameters
    ----------
    first, last : (k, L)

    Returns
    -------
    Origins in metres and unit directions, (n, 3) each.

    Raises
    ------
    ValueError
        where the firings have no `across`
    """
    across = across_of(firings, beam)
    rays = np.empty((int((last - first).sum()), 6))
    _sub_rays(
        firings.origin_m,
        firings.direction,
        across,
        beam.quarters,
        beam.seed,
        firings.index,
        first,
        last,
        beam.model is BeamModel.ADAPTIVE,
        rays,
    )
    return np.ascontiguousarray(rays[:, :3]), np.ascontiguousarray(rays[:, 3:])


@numba.njit(cache=True, nogil=True)
def _sub_rays(
    origin_m: NDArray[np.float64],
    direction: NDArray[np.float64],
    across: NDArray[np.float64],
    quarters: NDArray[np.float64],
    seed: int,
    index: int,
    first: NDArray[np.int64],
    last: NDArray[np.int64],
    by_rounds: bool,
    rays: NDArray[np.float64],
) -> None:
    """Fill rays (n, 6)."""
    axes, n = np.empty((1, 12)), 0
    for k in range(first.shape[0]):
        for j in range(first.shape[1]):
            pulse_axes(origin_m, direction, across, k, j, axes, 0)
            u, v = turn(seed, index + k, j)
            for i in range(first[k, j], last[k, j]):
                rays[n, 0], rays[n, 1], rays[n, 2], rays[n, 3], rays[n, 4], rays[n, 5] = sub_ray(
                    axes, 0, quarters, u, v, i, by_rounds
                )
                n += 1


def displace(range_m: NDArray[np.float32], beam: Footprint, index: int) -> None:
    """Displace hits (k, L) inside the beam, in place: the paper's error `offset`.

    The paper displaces "inside the ellipsoid whose axes are the divergence at that distance" (Lu et al.). Our
    reading: uniformly, within semi-axes of half the beam's horizontal and vertical width there, and along the
    beam half of their geometric mean. What a sensor tells of the displaced point is its distance.

    Parameters
    ----------
    index : number of the first firing sequence
    """
    _displace(range_m, 4.0 * beam.quarters, beam.seed, index)


@numba.njit(cache=True, nogil=True)
def _displace(range_m: NDArray[np.float32], widths: NDArray[np.float64], seed: int, index: int) -> None:
    """Displace in place; widths are spot and divergence, both horizontal and vertical."""
    count, lasers = range_m.shape
    for i in range(count):
        for j in range(lasers):
            reach_m = float(range_m[i, j])
            if math.isfinite(reach_m):
                across_m = (widths[0] + widths[2] * reach_m) / 2
                up_m = (widths[1] + widths[3] * reach_m) / 2
                a, b = uniform_pair(seed, _DISPLACEMENT, index + i, j)
                c, _ = uniform_pair(seed, _DISPLACEMENT, index + i, lasers + j)
                # Uniform in a ball: height uniform on the sphere (Archimedes), radius by the cube root.
                z, radius = 2.0 * a - 1.0, c ** (1.0 / 3.0)
                level = radius * math.sqrt(1.0 - z * z)
                x_m = across_m * level * math.cos(2.0 * math.pi * b)
                y_m = up_m * level * math.sin(2.0 * math.pi * b)
                along_m = reach_m + math.sqrt(across_m * up_m) * radius * z
                range_m[i, j] = math.sqrt(along_m * along_m + x_m * x_m + y_m * y_m)
