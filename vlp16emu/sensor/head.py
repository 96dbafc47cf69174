"""Pulses of a spinning head: instants, azimuths, origins and directions from firing numbers and poses."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vlp16emu.kernels.compiler import array_kernel
from vlp16emu.sensor.beams import BeamTable
from vlp16emu.sensor.clock import Clock
from vlp16emu.sensor.rotor import Rotor
from vlp16emu.trig import cos_sin
from vlp16emu.types import F8, I8, Firings, Poses

_TOGETHER = 480
"""Firing sequences that are aimed at a time, so that their poses are still in the processor's cache."""


@dataclass(frozen=True, slots=True)
class Head:
    """A head with L lasers that fires continuously from `start_ns`."""

    beams: BeamTable
    rotor: Rotor
    clock: Clock
    start_ns: int

    def times_ns(self, first: int, count: int) -> I8:
        """Return the UTC time of each pulse of `count` sequences, (count, L)."""
        beams = self.beams
        sequence = self.start_ns + np.arange(first, first + count, dtype=np.int64) * beams.sequence_ns
        return np.asarray(sequence[:, None] + beams.firing_ns)

    def read(self, sequence: I8) -> F8:
        """Return the encoder readings at firing sequences (n,), in degrees (n,)."""
        elapsed_ns = sequence * self.beams.sequence_ns
        clock_ns = self.clock.reading_ns(self.start_ns + elapsed_ns)
        return self.rotor.read(self.rotor.angle_deg(elapsed_ns), elapsed_ns, sequence, clock_ns)

    def aim(
        self, first: int, count: int, poses_at: Callable[[I8], Poses], *, beam_axis: bool = False
    ) -> Firings:
        """Return the pulses of `count` firing sequences from number `first`.

        Parameters
        ----------
        poses_at : function that returns the body's poses at n instants, or one pose for all
        beam_axis : True if pulses have a width, which needs `Firings.beam_axis`
        """
        beams = self.beams
        t_ns = self.times_ns(first, count)
        azimuth_deg = self.rotor.angle_deg(t_ns - self.start_ns)
        clock_ns = self.clock.reading_ns(t_ns[:, 0])
        reading_deg = self.rotor.read(
            azimuth_deg[:, 0].copy(), t_ns[:, 0] - self.start_ns, np.arange(first, first + count), clock_ns
        )
        origin_m = np.empty((*t_ns.shape, 3))
        direction = np.empty((*t_ns.shape, 3))
        level = np.empty((*t_ns.shape, 3) if beam_axis else (0, 0, 3))
        elevation_rad = np.radians(beams.elevation_deg + beams.elevation_error_deg)
        azimuth_rad = np.radians(beams.azimuth_offset_deg + beams.azimuth_error_deg)
        table = azimuth_rad, elevation_rad, beams.vertical_offset_m
        for begin in range(0, count, _TOGETHER):
            part = slice(begin, begin + _TOGETHER)
            poses = poses_at(t_ns[part].reshape(-1))  # each pulse has a pose of its own
            pulses = origin_m[part], direction[part], level[part]
            _aim(azimuth_deg[part], *table, poses.world_R_body, poses.world_p_body_m, *pulses)
        return Firings(
            index=first,
            t_ns=t_ns,
            clock_ns=clock_ns,
            azimuth_deg=azimuth_deg,
            reading_deg=reading_deg,
            origin_m=origin_m,
            direction=direction,
            beam_axis=level if beam_axis else None,
        )


@array_kernel
def _aim(
    azimuth_deg: F8,
    offset_rad: F8,
    elevation_rad: F8,
    offset_m: F8,
    world_R_body: F8,
    world_p_body_m: F8,
    origin_m: F8,
    direction: F8,
    beam_axis: F8,
) -> None:
    """Fill origins and directions: x = cos w cos a, y = -cos w sin a, z = sin w; azimuth 0 is forward.

    The level axis is the derivative of the direction by azimuth, over cos w; not computed if `beam_axis` is
    empty.
    """
    count, lasers = azimuth_deg.shape
    moving = len(world_p_body_m) > 1
    cosine = np.empty(lasers)
    sine = np.empty(lasers)
    flat = np.empty(lasers)
    up = np.empty(lasers)
    for j in range(lasers):
        flat[j], up[j] = cos_sin(elevation_rad[j])
    for i in range(count):
        for j in range(lasers):  # four at once
            cosine[j], sine[j] = cos_sin(math.radians(azimuth_deg[i, j]) + offset_rad[j])
        for j in range(np.uint64(lasers)):  # signed indices might count from the end
            n = np.uint64(i) * np.uint64(lasers) + j if moving else np.uint64(0)
            R = world_R_body[n]
            c = cosine[j]
            s = sine[j]
            x, y, z = flat[j] * c, -flat[j] * s, up[j]
            for a in range(3):
                direction[i, j, a] = R[a, 0] * x + R[a, 1] * y + R[a, 2] * z
                # The spin axis is the body's z axis, also if the mount turns the head about it.
                origin_m[i, j, a] = world_p_body_m[n, a] + R[a, 2] * offset_m[j]
            if len(beam_axis):
                for a in range(3):
                    beam_axis[i, j, a] = R[a, 0] * -s + R[a, 1] * -c + R[a, 2] * 0.0


@array_kernel
def in_sensor(azimuth_deg: F8, elevation_deg: F8, offset_m: F8, distance_m: F8) -> F8:
    """Return points (n, 3) in the sensor's frame by the manual's formulas; all arguments (n,)."""
    out = np.empty((len(distance_m), 3))
    for i in range(len(distance_m)):
        cosine, sine = cos_sin(math.radians(azimuth_deg[i]))
        level, up = cos_sin(math.radians(elevation_deg[i]))
        out[i, 0] = distance_m[i] * level * cosine
        out[i, 1] = -distance_m[i] * level * sine
        out[i, 2] = distance_m[i] * up + offset_m[i]
    return out
