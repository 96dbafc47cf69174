"""Share of the sky that surfaces hide from a point."""

import math

import numpy as np

from vlp16emu.elementary import cos, sin
from vlp16emu.raycast.caster import Geometry
from vlp16emu.types import F8, Firings

_RINGS = 16
_SECTORS = 16
"""Rings of equal solid angle, and rays on each: 256 rays measure a share to 0.03."""


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
