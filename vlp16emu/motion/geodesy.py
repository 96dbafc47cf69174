"""Geodetic coordinates of the world: the plane that touches the ellipsoid of WGS 84 under its origin."""

import numpy as np

from vlp16emu.elementary import atan2, cos, hypot, matvec, sin
from vlp16emu.motion.settings import Gps
from vlp16emu.types import Array

_RADIUS_M = 6_378_137.0  # semi-major axis of WGS 84 (NGA.STND.0036, table 3.1), as the next
_FLATTENING = 1.0 / 298.257223563
_ECCENTRICITY2 = _FLATTENING * (2.0 - _FLATTENING)
_ROUNDS = 3  # applications of Bowring's formula; near the ground the first one is already good to a millimetre


def to_local(geodetic: Array, gps: Gps) -> Array:
    """East, north and up in metres (n, 3) of points (n, 3): latitude and longitude in degrees, height in metres.

    The world is a plane, and the earth curves away below it: by 0.8 m at 3.2 km.
    """
    origin = np.array([[gps.latitude_deg, gps.longitude_deg, gps.height_m]])
    return matvec(_axes(gps), _to_earth(geodetic) - _to_earth(origin))


def to_geodetic(local_m: Array, gps: Gps) -> Array:
    """Latitude and longitude in degrees and height in metres (n, 3) of world points (n, 3); see `to_local`.

    Source: Bowring, "Transformation from spatial to geographical coordinates", Survey Review 23(181), 1976.
    """
    origin = np.array([[gps.latitude_deg, gps.longitude_deg, gps.height_m]])
    x_m, y_m, z_m = (matvec(_axes(gps).T, local_m) + _to_earth(origin)).T
    away_m, polar = hypot(x_m, y_m), 1.0 - _FLATTENING
    sine, cosine = z_m, away_m * polar  # of the reduced latitude, and then of the latitude, not to scale
    for _ in range(_ROUNDS):
        length = hypot(sine, cosine)
        sine, cosine = sine / length, cosine / length
        up_m = z_m + _ECCENTRICITY2 / polar * _RADIUS_M * sine * sine * sine
        out_m = away_m - _ECCENTRICITY2 * _RADIUS_M * cosine * cosine * cosine
        sine, cosine = polar * up_m, out_m
    latitude, length = atan2(up_m, out_m), hypot(up_m, out_m)
    sine, cosine = up_m / length, out_m / length
    height_m = away_m * cosine + z_m * sine - _RADIUS_M * np.sqrt(1.0 - _ECCENTRICITY2 * sine * sine)
    return np.column_stack([np.degrees(latitude), np.degrees(atan2(y_m, x_m)), height_m])


def _to_earth(geodetic: Array) -> Array:
    """Return Cartesian coordinates (n, 3) in metres, from the middle of the earth."""
    latitude, longitude = np.radians(geodetic[:, 0]), np.radians(geodetic[:, 1])
    sine, cosine = sin(latitude), cos(latitude)
    normal_m = _RADIUS_M / np.sqrt(1.0 - _ECCENTRICITY2 * sine * sine)
    away_m = (normal_m + geodetic[:, 2]) * cosine
    up_m = ((1.0 - _ECCENTRICITY2) * normal_m + geodetic[:, 2]) * sine
    return np.column_stack([away_m * cos(longitude), away_m * sin(longitude), up_m])


def _axes(gps: Gps) -> Array:
    """Rotation (3, 3) from the earth's axes to east, north and up."""
    latitude_rad, longitude_rad = np.radians(gps.latitude_deg), np.radians(gps.longitude_deg)
    up, level = sin(latitude_rad), cos(latitude_rad)
    aside, ahead = sin(longitude_rad), cos(longitude_rad)
    return np.array([[-aside, ahead, 0.0], [-up * ahead, -up * aside, level], [level * ahead, level * aside, up]])
