"""Points from returns, beam table and poses, as a driver with perfect poses computes them."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import matvec
from vlp16emu.kernels.compiler import numba
from vlp16emu.sensor.beams import BeamTable
from vlp16emu.sensor.head import in_sensor
from vlp16emu.trig import cos_sin
from vlp16emu.types import F8, I8, Firings, Poses


class PlacedReturns(NamedTuple):
    """n points."""

    azimuth_deg: F8
    """(n,) what the encoder read for the firing sequence, and what the rotor turned until the pulse; [0, 360)."""
    elevation_deg: F8  # (n,) elevation of the beam table
    sensor_m: F8  # (n, 3) in the sensor's frame at the instant of the pulse: x forward at azimuth 0, y left, z up
    world_m: F8  # (n, 3)


def place(
    beams: BeamTable,
    firings: Firings,
    sequence: I8,
    laser: I8,
    distance_m: NDArray[np.float32],
    poses: Poses,
    tangents: F8 | None = None,
) -> PlacedReturns:
    """Place returns by the manual's formulas (63-9243 Rev D, section 9.2).

    What the sensor does not report is not known here either: encoder and angle errors displace the points.
    Without such errors a point in the world is the pulse's origin + distance * direction.

    Parameters
    ----------
    sequence, laser : (n,) which pulses of `firings` they belong to
    distance_m : (n,)
    poses : of the body at the pulses, n or one that holds for all
    tangents : (n, 2) how far points are off their pulses, over their distance, to greater azimuths and upwards; None on them
    """
    turned_deg = firings.azimuth_deg[sequence, laser] - firings.azimuth_deg[sequence, 0]
    azimuth_deg, elevation_deg = (firings.reading_deg[sequence] + turned_deg) % 360.0, beams.elevation_deg[laser]
    range_m = distance_m.astype(np.float64)
    sensor_m = in_sensor(azimuth_deg, elevation_deg, beams.vertical_offset_m[laser], range_m)
    if tangents is not None:
        _shift(tangents, azimuth_deg, elevation_deg, range_m, sensor_m)
    world_m = matvec(poses.world_R_body, sensor_m) + poses.world_p_body_m
    return PlacedReturns(azimuth_deg, elevation_deg, sensor_m, world_m)


@numba.njit(cache=True, nogil=True)
def _shift(tangents: F8, azimuth_deg: F8, elevation_deg: F8, distance_m: F8, sensor_m: F8) -> None:
    """Move points off the axes of their pulses, by tangents (n, 2) to greater azimuths and upwards, at the same ranges."""
    for i in range(len(distance_m)):
        r, (a, b) = distance_m[i], tangents[i]
        cosine, sine = cos_sin(math.radians(azimuth_deg[i]))
        level, up = cos_sin(math.radians(elevation_deg[i]))
        shorter = 1.0 - math.sqrt(1.0 - a * a - b * b)
        sensor_m[i, 0] -= r * (shorter * level * cosine + a * sine + b * up * cosine)
        sensor_m[i, 1] += r * (shorter * level * sine - a * cosine + b * up * sine)
        sensor_m[i, 2] += r * (b * level - shorter * up)
