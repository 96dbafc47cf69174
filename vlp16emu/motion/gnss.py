"""The receiver's view of the walk: latitude, longitude, speed and course."""

import math

import numpy as np

from vlp16emu.motion.walk import Motion
from vlp16emu.types import GnssFix
from vlp16emu.units import S_NS

__all__ = ["fix_at", "geodetic"]

_WGS84_A_M = 6_378_137.0
_WGS84_E2 = 6.694379990141316e-3
"""Semi-major axis and first eccentricity squared (NGA.STND.0036, table 3.1 and derived)."""


def geodetic(east_m: float, north_m: float, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
    """Latitude and longitude of a point near a geodetic origin, by the ellipsoid's radii of curvature there.

    Good to 1 cm within 300 m of the origin and to 1 m within 3 km at 60 degrees of latitude.
    """
    sine = math.sin(math.radians(latitude_deg))
    w2 = 1.0 - _WGS84_E2 * sine * sine
    meridian_m = _WGS84_A_M * (1.0 - _WGS84_E2) / w2**1.5
    parallel_m = _WGS84_A_M / math.sqrt(w2) * math.cos(math.radians(latitude_deg))
    longitude = longitude_deg + math.degrees(east_m / parallel_m)
    return latitude_deg + math.degrees(north_m / meridian_m), (longitude + 180.0) % 360.0 - 180.0


def fix_at(motion: Motion, t_ns: int, latitude_deg: float, longitude_deg: float) -> GnssFix:
    """Fix for the whole UTC second `t_ns`, with speed and course over the second before it.

    Parameters
    ----------
    latitude_deg, longitude_deg : WGS 84, of the world's origin
    """
    p = motion.poses_at(np.array([t_ns - S_NS, t_ns])).world_p_body_m
    east_m, north_m = (p[-1] - p[0])[:2]
    latitude, longitude = geodetic(p[-1, 0], p[-1, 1], latitude_deg, longitude_deg)
    return GnssFix(
        t_ns=t_ns,
        valid=True,
        latitude_deg=latitude,
        longitude_deg=longitude,
        speed_m_s=math.hypot(east_m, north_m),
        course_deg=math.degrees(math.atan2(east_m, north_m)) % 360.0,
    )
