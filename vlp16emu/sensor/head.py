"""From firing numbers and poses to pulses: instants, angles, origins and directions."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.sensor.beams import BeamTable
from vlp16emu.sensor.clock import Clock
from vlp16emu.sensor.rotor import Rotor
from vlp16emu.types import Firings, Poses

__all__ = ["BODY_R_SENSOR", "LASER_NS", "SEQUENCE_NS", "Head"]

LASER_NS = 2_304
"""From one laser's pulse to the next (63-9243 Rev D, section 8.1)."""
SEQUENCE_NS = 55_296
"""From one firing sequence to the next: 16 pulses and 18.432 us of recharge (63-9243 Rev D, section 8.1)."""

BODY_R_SENSOR = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Mounting: the cable points back, so azimuth 0 (sensor +y) looks forward (body +x)."""


@dataclass(frozen=True, slots=True)
class Head:
    """A head with L lasers that fires without pause from `start_ns` on."""

    beams: BeamTable
    rotor: Rotor
    clock: Clock
    start_ns: int

    def times_ns(self, first: int, count: int) -> NDArray[np.int64]:
        """UTC of every pulse of `count` sequences, (count, L)."""
        sequence = self.start_ns + np.arange(first, first + count, dtype=np.int64) * SEQUENCE_NS
        laser = np.arange(len(self.beams.elevation_deg), dtype=np.int64) * LASER_NS
        return np.asarray(sequence[:, None] + laser)

    def aim(self, first: int, count: int, poses_at: Callable[[NDArray[np.int64]], Poses]) -> Firings:
        """Point every pulse of `count` sequences from number `first` on.

        Parameters
        ----------
        poses_at : the body's poses at n instants, or one pose that holds for all
        """
        t_ns = self.times_ns(first, count)
        poses = poses_at(t_ns.reshape(-1))
        azimuth_deg = self.rotor.angle_deg(t_ns - self.start_ns)
        origin_m, direction = np.empty((*t_ns.shape, 3)), np.empty((*t_ns.shape, 3))
        _aim(
            azimuth_deg,
            np.radians(self.beams.elevation_deg),
            self.beams.vertical_offset_m,
            BODY_R_SENSOR,
            poses.world_R_body,
            poses.world_p_body_m,
            origin_m,
            direction,
        )
        return Firings(
            index=first,
            t_ns=t_ns,
            clock_ns=self.clock.reading_ns(t_ns[:, 0]),
            azimuth_deg=azimuth_deg,
            reading_deg=self.rotor.reading_deg(azimuth_deg[:, 0].copy(), first),
            origin_m=origin_m,
            direction=direction,
            across=None,
        )


@numba.njit(cache=True, nogil=True)
def _aim(
    azimuth_deg: NDArray[np.float64],
    elevation_rad: NDArray[np.float64],
    offset_m: NDArray[np.float64],
    body_R_sensor: NDArray[np.float64],
    world_R_body: NDArray[np.float64],
    world_p_body_m: NDArray[np.float64],
    origin_m: NDArray[np.float64],
    direction: NDArray[np.float64],
) -> None:
    """Fill origins and directions: x = cos w sin a, y = cos w cos a, z = sin w (63-9243 Rev D, section 9.2)."""
    count, lasers = azimuth_deg.shape
    moving = len(world_p_body_m) > 1
    sensor, body = np.empty(3), np.empty(3)
    for i in range(count):
        for j in range(lasers):
            n = i * lasers + j if moving else 0
            R, p = world_R_body[n], world_p_body_m[n]
            azimuth, w = math.radians(azimuth_deg[i, j]), elevation_rad[j]
            sensor[0] = math.cos(w) * math.sin(azimuth)
            sensor[1] = math.cos(w) * math.cos(azimuth)
            sensor[2] = math.sin(w)
            for a in range(3):
                body[a] = (
                    body_R_sensor[a, 0] * sensor[0]
                    + body_R_sensor[a, 1] * sensor[1]
                    + body_R_sensor[a, 2] * sensor[2]
                )
            for a in range(3):
                direction[i, j, a] = R[a, 0] * body[0] + R[a, 1] * body[1] + R[a, 2] * body[2]
                # The spin axis is the body's z axis, also when the head is mounted turned about it.
                origin_m[i, j, a] = p[a] + R[a, 2] * offset_m[j]
