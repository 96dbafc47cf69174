"""A GNSS receiver with wandering errors and fixes lost under trees; the world's place on the globe.

The world is the tangent plane of the WGS 84 ellipsoid under its origin.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np

from vlp16emu.elementary import atan2, cos, exp, hypot, matvec, sin, tanh
from vlp16emu.kernels.compiler import array_kernel
from vlp16emu.motion.pose import Motion
from vlp16emu.motion.settings import Gps
from vlp16emu.random import Purpose, normal_pair, uniform_pair
from vlp16emu.trig import cos_sin
from vlp16emu.types import F8, GnssFix
from vlp16emu.units import S_NS

Sky = Callable[[int, F8], float]
"""Function of UTC and antenna position (3,) that gives the hidden share of the sky, 0..1."""
_WAVES = 32
_EAST = 0  # lanes of the wandering processes
_NORTH = 1
_LOSS = 2
_COVER_WIDTH = 0.05  # width of the logistic curve of failed fixes over the cover; assumption
_LOSS_S = 10.0
"""Correlation time of failing fixes: about 12 m of walking, the spacing of large crowns; assumption."""
_FARTHEST_Z = 8.0  # limit beyond which the normal distribution is 0 or 1 within 1e-15
_NORMAL_PEAK = 0.3989422804014327  # greatest density of the normal distribution, 1 / sqrt(2 pi)
_HELD_S = 10  # time for which a receiver repeats its last fix
_FASTEST_M_S = 999 * 1852 / 3600
"""999 knots, the greatest reported speed (Garmin GPS 16x, 190-00228-08 Rev. C, section 1.5.4.4)."""
_RADIUS_M = 6_378_137.0  # semi-major axis of WGS 84 (NGA.STND.0036, table 3.1), as the next
_FLATTENING = 1.0 / 298.257223563
_ECCENTRICITY2 = _FLATTENING * (2.0 - _FLATTENING)
_ROUNDS = 3  # iterations of Bowring's formula; near the ground one is accurate to a millimetre
_READINGS_KEPT = 64  # more than `_HELD_S`, so that the sky of a second is cast only once


@dataclass(frozen=True, slots=True)
class GnssReading:
    """Measurement of a receiver in one second, with the ground truth."""

    t_ns: int  # UTC, a whole second
    antenna_m: F8  # (3,) true position in the world
    velocity_m_s: F8  # (3,) true velocity in the world
    measured_m: F8  # (3,) measured position in the world
    measured_m_s: F8  # (2,) measured velocity, east and north
    cover: float  # hidden share of the sky
    valid: bool  # True if it has a fix


class Receiver:
    """A GNSS receiver with its antenna vertically above the sensor.

    Each second can be computed alone: errors depend on seed and second, cover on position and world.

    Parameters
    ----------
    motion : motion of the sensor
    sky : hidden share of the sky; None for an always open sky
    """

    def __init__(self, motion: Motion, gps: Gps, *, seed: int, sky: Sky | None) -> None:
        self._gps = gps
        # Not a bound method: a reference cycle would keep the world alive longer than the receiver.
        self._known = lru_cache(_READINGS_KEPT)(partial(_measure, motion, gps, seed, sky))

    def reading(self, t_ns: int) -> GnssReading:
        """Measure at the whole UTC second `t_ns`."""
        return self._known(t_ns)

    def fix(self, t_ns: int) -> GnssFix:
        """Return the fix for the UTC second `t_ns`; its course is from north at the world's origin.

        Without a fix in this second, the numbers of the last fix are repeated. After 10 s without a fix they
        are the receiver's estimate of 10 s ago, as if it had continued its track.
        """
        for age in range(_HELD_S + 1):
            known = self.reading(t_ns - age * S_NS)
            if known.valid:
                break
        latitude_deg, longitude_deg, _ = to_geodetic(known.measured_m[None], self._gps)[0].tolist()
        east_m_s, north_m_s = known.measured_m_s.tolist()
        valid = self.reading(t_ns).valid
        speed_m_s = min(hypot(east_m_s, north_m_s), _FASTEST_M_S)
        course_deg = math.degrees(atan2(east_m_s, north_m_s)) % 360.0
        return GnssFix(t_ns, valid, latitude_deg, longitude_deg, speed_m_s, course_deg)


def _measure(motion: Motion, gps: Gps, seed: int, sky: Sky | None, t_ns: int) -> GnssReading:
    """Return the measurement at the whole UTC second `t_ns`."""
    truth = motion.kinematics_at(np.array([t_ns]))
    antenna_m = truth.world_p_body_m[0].copy()
    velocity_m_s = truth.world_v_body_m_s[0]
    antenna_m[2] += gps.antenna_above_m
    cover = sky(t_ns, antenna_m) if sky else 0.0
    grown = 1.0 + (gps.canopy_error_factor - 1.0) * cover
    second = t_ns // S_NS
    white_m = np.array(normal_pair(seed, int(Purpose.GNSS_NOISE), second, 0))
    white_m_s = np.array(normal_pair(seed, int(Purpose.GNSS_NOISE), second, 1))
    slow = np.array([wander(seed, lane, second, gps.wander_s) for lane in (_EAST, _NORTH)])
    # Fixes fail with a probability that is logistic in the cover, in periods of about 10 s.
    odds = (cover - gps.canopy_half_cover) / _COVER_WIDTH
    lost = _upper_tail(wander(seed, _LOSS, second, _LOSS_S)) if sky else 1.0
    valid = sky is None or lost >= 0.5 + 0.5 * tanh(0.5 * odds)
    measured_m = antenna_m.copy()  # heights are not measured: sentences have no altitude
    measured_m[:2] += grown * (gps.position_noise_m * white_m + gps.wander_m * slow)
    measured_m_s = velocity_m_s[:2] + grown * gps.velocity_noise_m_s * white_m_s
    return GnssReading(t_ns, antenna_m, velocity_m_s, measured_m, measured_m_s, cover, valid)


def _upper_tail(z: float) -> float:
    """Return the probability that a standard normal number exceeds z, within 1e-15, by a power series.

    Source: Marsaglia, "Evaluating the normal distribution", J. Statistical Software 11(4), 2004.
    """
    z = min(max(z, -_FARTHEST_Z), _FARTHEST_Z)
    total = 0.0
    term = z
    odd = 1.0
    while total + term != total:
        total = total + term
        odd = odd + 2.0
        term *= z * z / odd
    return 0.5 - total * exp(-0.5 * z * z) * _NORMAL_PEAK


@array_kernel
def wander(seed: int, lane: int, second: int, correlation_s: float) -> float:
    """Return the value of a first-order Gauss-Markov process of variance 1 at a whole second.

    Over seeds it is Gaussian at each second with the autocovariance exp(-|lag| / `correlation_s`). It is a
    sum of waves of equal power, with one frequency drawn from each of 32 parts of equal mass of
    the spectrum, a Cauchy distribution.

    Parameters
    ----------
    lane : number of the process, for several processes with one seed
    second : since 1970
    correlation_s : above 0
    """
    total = 0.0
    for wave in range(_WAVES):
        share, _ = uniform_pair(seed, Purpose.GNSS_WANDER, wave, 2 * lane)
        a, b = normal_pair(seed, Purpose.GNSS_WANDER, wave, 2 * lane + 1)
        cosine, sine = cos_sin(0.5 * math.pi * (wave + share) / _WAVES)
        hz = sine / cosine / (2.0 * math.pi * correlation_s)
        # At whole seconds, whole hertz and whole turns have no effect.
        cosine, sine = cos_sin(2.0 * math.pi * (hz % 1.0 * second % 1.0))
        total += a * cosine + b * sine
    return total / math.sqrt(_WAVES)


def to_local(geodetic: F8, gps: Gps) -> F8:
    """Return east, north and up (n, 3) in m of points (n, 3): latitude, longitude in degrees, height in m.

    The world is a plane, and the earth's surface is 0.8 m below it at 3.2 km.
    """
    origin = np.array([[gps.latitude_deg, gps.longitude_deg, gps.height_m]])
    return matvec(_enu_R_ecef(gps), _to_earth(geodetic) - _to_earth(origin))


def to_geodetic(local_m: F8, gps: Gps) -> F8:
    """Return latitude, longitude in degrees and height in m (n, 3) of world points (n, 3); see `to_local`.

    Source: Bowring, "Transformation from spatial to geographical coordinates", Survey Review 23(181), 1976.
    """
    origin = np.array([[gps.latitude_deg, gps.longitude_deg, gps.height_m]])
    x_m, y_m, z_m = (matvec(_enu_R_ecef(gps).T, local_m) + _to_earth(origin)).T
    away_m = hypot(x_m, y_m)
    polar = 1.0 - _FLATTENING
    sine, cosine = z_m, away_m * polar  # of the reduced latitude, later of the latitude, unnormalized
    for _ in range(_ROUNDS):
        length = hypot(sine, cosine)
        sine, cosine = sine / length, cosine / length
        up_m = z_m + _ECCENTRICITY2 / polar * _RADIUS_M * sine * sine * sine
        out_m = away_m - _ECCENTRICITY2 * _RADIUS_M * cosine * cosine * cosine
        sine, cosine = polar * up_m, out_m
    latitude = atan2(up_m, out_m)
    length = hypot(up_m, out_m)
    sine, cosine = up_m / length, out_m / length
    height_m = away_m * cosine + z_m * sine - _RADIUS_M * np.sqrt(1.0 - _ECCENTRICITY2 * sine * sine)
    return np.column_stack([np.degrees(latitude), np.degrees(atan2(y_m, x_m)), height_m])


def _to_earth(geodetic: F8) -> F8:
    """Return earth-centred Cartesian coordinates (n, 3) in metres."""
    latitude, longitude = np.radians(geodetic[:, 0]), np.radians(geodetic[:, 1])
    sine, cosine = sin(latitude), cos(latitude)
    normal_m = _RADIUS_M / np.sqrt(1.0 - _ECCENTRICITY2 * sine * sine)
    away_m = (normal_m + geodetic[:, 2]) * cosine
    up_m = ((1.0 - _ECCENTRICITY2) * normal_m + geodetic[:, 2]) * sine
    return np.column_stack([away_m * cos(longitude), away_m * sin(longitude), up_m])


def _enu_R_ecef(gps: Gps) -> F8:
    """Return the rotation (3, 3) from the earth's axes to east, north and up."""
    latitude_rad, longitude_rad = np.radians(gps.latitude_deg), np.radians(gps.longitude_deg)
    sin_lat, cos_lat = sin(latitude_rad), cos(latitude_rad)
    sin_lon, cos_lon = sin(longitude_rad), cos(longitude_rad)
    return np.array(
        [
            [-sin_lon, cos_lon, 0.0],
            [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
            [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
        ]
    )
