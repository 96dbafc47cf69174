"""Casters, the choice of a caster with or without a far medium, and the sky cover by casting."""

import logging
import math
from collections.abc import Callable
from concurrent.futures import Executor
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vlp16emu.doors import Part
from vlp16emu.elementary import cos, sin
from vlp16emu.raycast.beam import LINE, Footprint
from vlp16emu.types import F8, Firings, Hits, Window, World

_log = logging.getLogger(__name__)  # at DEBUG it names each look at the sky
_RINGS = 16
_SECTORS = 16  # rings of equal solid angle, and rays on each: 256 rays give a share within 0.03
_STEEP_COSINE = 0.55  # of the elevation from which a ray is cast with steep ones


class Geometry(Protocol):
    """A window ready for casting."""

    @property
    def surfaces(self) -> NDArray[np.void]:
        """Table (m,) `SURFACE` of the window."""

    @property
    def as_far(self) -> "Geometry":
        """The same window, with near content as the far medium too, if there is one."""

    def cast(self, firings: Firings, near_m: F8, far_m: float, beam: Footprint = LINE) -> Hits:
        """Cast the pulses of k sequences, k a multiple of 8."""


class Caster(Protocol):
    """Opens windows of the world for casting."""

    def open(self, window: Window) -> Geometry:
        """Make a window ready for casting."""


FAR = Part[Callable[[World, Executor], Caster]]("vlp16emu.foliage.far:far_caster")
"""Caster of a world with a far medium."""


def caster(world: World, workers: Executor) -> Caster:
    """Make the caster of a world: faces alone, or with a far medium (`FAR`).

    Raises EmbreeMissingError if the library cannot be loaded.
    """
    # Kernels bind to the library when they are loaded, and a world without a far medium does not need its
    # kernels.
    if math.isinf(world.near_m):
        from vlp16emu.raycast.near import EmbreeCaster

        return EmbreeCaster(world, workers)
    return FAR.load()(world, workers)


def sky_cover(geometry: Geometry, t_ns: int, position_m: F8, lowest_deg: float, far_m: float) -> float:
    """Return the hidden share of the sky, 0..1, by solid angle.

    Crowns overhead are cast as the far medium: they hide as much, and are not built unless a pulse meets
    them.

    Parameters
    ----------
    t_ns : UTC, for moving surfaces
    position_m : (3,) world
    lowest_deg : elevation below which the sky does not count
    far_m : range beyond which surfaces do not count
    """
    _log.debug("casts the sky at %d", t_ns)
    direction = _directions(sin(math.radians(lowest_deg)))
    rays = Firings.rays(t_ns, position_m, direction)
    hits = geometry.as_far.cast(rays, np.zeros(1), far_m)
    return float(np.isfinite(hits.range_m).mean())


def _directions(lowest_sine: float) -> F8:
    """Return unit directions (rays, 1, 3).

    Rays that are cast together are neighbours: the steep ones, which pass beside stems all around, apart from
    the others, and each of both from azimuth to azimuth.
    """
    sine = lowest_sine + (1.0 - lowest_sine) * (np.arange(_RINGS) + 0.5) / _RINGS
    # Rings are rotated by the golden ratio against each other, without gaps and rows.
    start = np.arange(_RINGS) * (math.sqrt(5.0) - 1.0) / 2.0
    azimuth = 2.0 * math.pi / _SECTORS * (np.arange(_SECTORS)[:, None] + start % 1.0)
    across = np.sqrt(1.0 - sine * sine)
    up = np.broadcast_to(sine, azimuth.shape)
    direction = np.stack([across * sin(azimuth), across * cos(azimuth), up], axis=-1)
    is_steep = np.broadcast_to(across < _STEEP_COSINE, azimuth.shape)
    order = np.lexsort([azimuth.ravel(), is_steep.ravel()])
    return direction.reshape(-1, 1, 3)[order]
