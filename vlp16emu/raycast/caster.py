"""Casters, the choice between one of faces alone and one with a far medium, and the sky that a caster sees."""

import math
from concurrent.futures import Executor
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vlp16emu.doors import door
from vlp16emu.elementary import cos, sin
from vlp16emu.raycast.beam import LINE, Footprint
from vlp16emu.types import F8, Firings, Hits, Window, World

_RINGS = 16
_SECTORS = 16  # rings of equal solid angle, and rays on each: 256 rays measure a share to 0.03


class Geometry(Protocol):
    """A window ready to be cast against."""

    @property
    def surfaces(self) -> NDArray[np.void]:
        """(m,) `SURFACE`, the window's table."""

    def cast(self, firings: Firings, near_m: F8, far_m: float, beam: Footprint = LINE, *, as_far: bool = False) -> Hits:
        """Cast the pulses of k sequences, k a multiple of 8; `as_far` casts what is near as the medium too, where there is one."""


class Caster(Protocol):
    """Opens windows of the world for casting."""

    def open(self, window: Window) -> Geometry:
        """Make a window ready for casting."""


def caster(world: World, workers: Executor) -> Caster:
    """Make the caster of a world: of faces alone, or with what the door "far" has.

    Raises EmbreeMissingError where the library cannot be loaded.
    """
    # Kernels bind to the library as soon as they are loaded, and a world that has nothing far needs none for it.
    if math.isinf(world.near_m):
        from vlp16emu.raycast.near import EmbreeCaster

        return EmbreeCaster(world, workers)
    far: Caster = door("far")(world, workers)
    return far


def sky_cover(geometry: Geometry, t_ns: int, position_m: F8, lowest_deg: float, far_m: float) -> float:
    """Return the share of the sky that surfaces hide, 0..1, by solid angle.

    Crowns overhead are cast as the far medium: they hide as much, and need not be built if no pulse meets them.

    Parameters
    ----------
    t_ns : UTC, at which what moves stands somewhere
    position_m : (3,) world
    lowest_deg : elevation below which the sky does not count
    far_m : surfaces beyond hide nothing
    """
    direction = _directions(sin(math.radians(lowest_deg)))
    rays = Firings.rays(t_ns, position_m, direction)
    hits = geometry.cast(rays, np.zeros(direction.shape[1]), far_m, as_far=True)
    return float(np.isfinite(hits.range_m).mean())


def _directions(lowest_sine: float) -> F8:
    """Return directions (sectors, rings, 3), unit length: rays that are cast together are neighbours on a ring."""
    sine = lowest_sine + (1.0 - lowest_sine) * (np.arange(_RINGS) + 0.5) / _RINGS
    # A ring begins where the one below it does not: the golden ratio leaves no gap and no row.
    start = np.arange(_RINGS) * (math.sqrt(5.0) - 1.0) / 2.0
    azimuth = 2.0 * math.pi / _SECTORS * (np.arange(_SECTORS)[:, None] + start % 1.0)
    across = np.sqrt(1.0 - sine * sine)
    up = np.broadcast_to(sine, azimuth.shape)
    return np.stack([across * sin(azimuth), across * cos(azimuth), up], axis=-1)
