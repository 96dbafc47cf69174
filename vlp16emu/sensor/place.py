"""Points from returns, beam table and poses, as a driver with perfect poses computes them."""

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.sensor.beams import BeamTable
from vlp16emu.sensor.head import turn
from vlp16emu.trig import cos_sin
from vlp16emu.types import Array, Firings, IntArray, Poses


@dataclass(frozen=True, slots=True)
class PlacedReturns:
    """n points."""

    azimuth_deg: Array
    """(n,) what the encoder read for the firing sequence, and what the rotor turned until the pulse; [0, 360)."""
    elevation_deg: Array
    """(n,) elevation of the beam table."""
    sensor_m: Array
    """(n, 3) in the sensor's frame at the instant of the pulse: x forward at azimuth 0, y left, z up."""
    world_m: Array
    """(n, 3)."""


def place(
    beams: BeamTable,
    firings: Firings,
    sequence: IntArray,
    laser: IntArray,
    distance_m: NDArray[np.float32],
    poses: Poses,
    tangents: Array | None = None,
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
    sensor_m, world_m = np.empty((len(laser), 3)), np.empty((len(laser), 3))
    ranges = beams.vertical_offset_m[laser], distance_m, np.empty((0, 2)) if tangents is None else tangents
    _place(azimuth_deg, elevation_deg, *ranges, poses.world_R_body, poses.world_p_body_m, sensor_m, world_m)
    return PlacedReturns(azimuth_deg, elevation_deg, sensor_m, world_m)


@numba.njit(cache=True, nogil=True)
def _place(
    azimuth_deg: Array,
    elevation_deg: Array,
    offset_m: Array,
    distance_m: NDArray[np.float32],
    tangents: Array,
    world_R_body: Array,
    world_p_body_m: Array,
    sensor_m: Array,
    world_m: Array,
) -> None:
    moving = len(world_p_body_m) > 1
    for i in range(len(distance_m)):
        n = i if moving else 0
        r, (cosine, sine) = float(distance_m[i]), cos_sin(math.radians(azimuth_deg[i]))
        level, up = cos_sin(math.radians(elevation_deg[i]))
        sensor_m[i, 0] = r * level * cosine
        sensor_m[i, 1] = -r * level * sine
        sensor_m[i, 2] = r * up + offset_m[i]
        if len(tangents):
            a, b = tangents[i]
            shorter = 1.0 - math.sqrt(1.0 - a * a - b * b)
            sensor_m[i, 0] -= r * (shorter * level * cosine + a * sine + b * up * cosine)
            sensor_m[i, 1] += r * (shorter * level * sine - a * cosine + b * up * sine)
            sensor_m[i, 2] += r * (b * level - shorter * up)
        turn(world_R_body[n], sensor_m[i], world_m[i])
        for axis in range(3):
            world_m[i, axis] += world_p_body_m[n, axis]
