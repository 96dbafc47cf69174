"""The beam error `offset` of LiDAR-Forest (Lu et al.): hits displaced inside the beam, for comparison.

The paper displaces a hit "inside the ellipsoid whose axes are the divergence at that distance". Our
interpretation: uniformly, within semi-axes of half the beam's horizontal and vertical width there, and along
the beam half of their geometric mean. A packet can hold only the distance of the displaced point; point
clouds have the point itself.
"""

import math

import numpy as np

from vlp16emu.elementary import power
from vlp16emu.kernels.compiler import array_kernel
from vlp16emu.random import Purpose, uniform_pair
from vlp16emu.raycast.beam import Footprint
from vlp16emu.trig import cos_sin
from vlp16emu.types import F4, F8, I8

_DISPLACEMENT = int(Purpose.BEAM_ERROR)


def displace(range_m: F4, beam: Footprint, index: int) -> None:
    """Replace ranges (k, L) of hits by the ranges of the displaced points, in place.

    The first firing sequence is `index`.
    """
    _displace(range_m, 4.0 * beam.sigmas, beam.seed, index)


def offset_tangents(distance_m: F4, beam: Footprint, sequence: I8, laser: I8, lasers: int) -> F8:
    """Return the offsets (n, 2) of displaced points from their pulses, over their distance.

    Offsets are to greater azimuths and upwards.

    Parameters
    ----------
    distance_m : (n,) distances of the displaced points
    sequence, laser : (n,) firing sequence since the run began, and laser, out of `lasers`
    """
    out = np.empty((len(distance_m), 2))
    _fill_tangents(distance_m, 4.0 * beam.sigmas, beam.seed, sequence, laser, lasers, out)
    return out


@array_kernel
def _displace(range_m: F4, widths: F8, seed: int, index: int) -> None:
    count, lasers = range_m.shape
    for i in range(count):
        for j in range(lasers):
            reach_m = float(range_m[i, j])
            if math.isfinite(reach_m):
                x_m, y_m, z_m = _displacement(widths, reach_m, seed, index + i, j, lasers)
                along_m = reach_m + z_m
                range_m[i, j] = math.sqrt(along_m * along_m + x_m * x_m + y_m * y_m)


@array_kernel
def _fill_tangents(
    distance_m: F4, widths: F8, seed: int, sequence: I8, laser: I8, lasers: int, out: F8
) -> None:
    for i in range(len(out)):
        reach_m = float(distance_m[i])
        x_m, y_m, _ = _displacement(widths, reach_m, seed, sequence[i], laser[i], lasers)
        out[i, 0] = x_m / reach_m
        out[i, 1] = y_m / reach_m


@array_kernel
def _displacement(
    widths: F8, reach_m: float, seed: int, sequence: int, laser: int, lasers: int
) -> tuple[float, float, float]:
    """Draw a displacement: horizontal, vertical and along the beam.

    The `widths` are spot and divergence, horizontal and vertical.
    """
    across_m = (widths[0] + widths[2] * reach_m) / 2
    up_m = (widths[1] + widths[3] * reach_m) / 2
    a, b = uniform_pair(seed, _DISPLACEMENT, sequence, laser)
    c, _ = uniform_pair(seed, _DISPLACEMENT, sequence, lasers + laser)
    # Uniform in a ball: height uniform on the sphere (Archimedes), radius by the cube root.
    z = 2.0 * a - 1.0
    radius = power(max(c, 2.0**-53), 1.0 / 3.0)
    level = radius * math.sqrt(1.0 - z * z)
    cosine, sine = cos_sin(2.0 * math.pi * b)
    return across_m * level * cosine, up_m * level * sine, math.sqrt(across_m * up_m) * radius * z
