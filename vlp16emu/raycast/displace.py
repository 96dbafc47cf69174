"""Hits displaced inside the beam: the error `offset` of LiDAR-Forest (Lu et al.), for comparison."""

import math

import numba

from vlp16emu.elementary import power
from vlp16emu.random import Purpose, uniform_pair
from vlp16emu.raycast.beam import Footprint
from vlp16emu.trig import cos_sin
from vlp16emu.types import F4, F8

_DISPLACEMENT = int(Purpose.BEAM_ERROR)


def displace(range_m: F4, beam: Footprint, index: int) -> None:
    """Displace hits (k, L) inside the beam, in place: the paper's error `offset`.

    The paper displaces "inside the ellipsoid whose axes are the divergence at that distance" (Lu et al.). Our
    reading: uniformly, within semi-axes of half the beam's horizontal and vertical width there, and along the
    beam half of their geometric mean. What a sensor reports of the displaced point is its distance.

    Parameters
    ----------
    index : number of the first firing sequence
    """
    _displace(range_m, 4.0 * beam.sigmas, beam.seed, index)


@numba.njit(cache=True, nogil=True)
def _displace(range_m: F4, widths: F8, seed: int, index: int) -> None:
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
                z, radius = 2.0 * a - 1.0, power(max(c, 2.0**-53), 1.0 / 3.0)
                level = radius * math.sqrt(1.0 - z * z)
                cosine, sine = cos_sin(2.0 * math.pi * b)
                x_m, y_m = across_m * level * cosine, up_m * level * sine
                along_m = reach_m + math.sqrt(across_m * up_m) * radius * z
                range_m[i, j] = math.sqrt(along_m * along_m + x_m * x_m + y_m * y_m)
