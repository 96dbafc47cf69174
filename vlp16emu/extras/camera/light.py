"""Daylight: the sun's direction, the sky's colours, and the colour of a lit surface.

Colours in light are linear, 1 for a white surface that sun and sky light fully; those of files are their
square roots, which is near enough to the curve of sRGB and rounds equally on every processor.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import atan2, cos, sin
from vlp16emu.types import F4, F8, U1
from vlp16emu.units import S_NS

_J2000_NS = 946_728_000 * S_NS  # 2000-01-01 12:00 UTC
_DAY_NS = 86_400 * S_NS

# By eye, from photographs of forests in summer
_SUN = np.array([1.0, 0.92, 0.78])  # colour of its light
_SKY = np.array([0.70, 0.83, 1.0])  # and of the sky's
_ZENITH = np.array([0.09, 0.22, 0.54])  # the sky itself
_HORIZON = np.array([0.60, 0.72, 0.82])
_AMBIENT = 0.22  # light of the sky under trees, against a white surface that faces the sun
_DIRECT = 1.35  # light of the sun against it
_UNDER = 0.5  # light from below, as a share of the light from above
_GLOW = 0.02  # size of the bright sky around the sun, as 1 - cosine
_HAZE_M = 1200.0  # distance at which half the light of a surface is the haze's
_FAR_WOOD = np.array([0.115, 0.155, 0.12])  # light of a forest in haze
_TREE_TOPS = 0.17  # sine of the elevation of trees 17 m high at 100 m
_TREE_FEET = 0.06  # and of their densest part
_EXPOSURE = 1.9  # factor on light
_WHITE = 1.5  # exposed light from which on a colour is full


class Facing(NamedTuple):
    """Orientation of n surfaces to the light."""

    normal: F8  # (n, 3) towards the camera
    cosine: F4  # (n,) of incidence of the camera's ray
    is_leaf: NDArray[np.bool_]  # (n,) thin: lit through from behind, and too fine for a normal


def sun_direction(t_ns: int, latitude_deg: float, longitude_deg: float) -> F8:
    """Return the unit direction (3,) to the sun, east, north, up, at a UTC instant.

    The Astronomical Almanac's formula of low precision, section C: within 0.01 degree from 1950 to 2050;
    refraction and parallax are left out.
    """
    days = (t_ns - _J2000_NS) / _DAY_NS
    mean_rad = math.radians((280.460 + 0.9856474 * days) % 360.0)
    anomaly_rad = math.radians((357.528 + 0.9856003 * days) % 360.0)
    ecliptic_rad = mean_rad + math.radians(1.915) * sin(anomaly_rad)
    ecliptic_rad = ecliptic_rad + math.radians(0.020) * sin(2.0 * anomaly_rad)
    tilt_rad = math.radians(23.439 - 4e-7 * days)
    sine = sin(tilt_rad) * sin(ecliptic_rad)
    cosine = math.sqrt(1.0 - sine * sine)
    ascension_rad = atan2(cos(tilt_rad) * sin(ecliptic_rad), cos(ecliptic_rad))
    sidereal_deg = (280.46062 + 360.98564737 * days) % 360.0
    hour_rad = math.radians(sidereal_deg + longitude_deg) - ascension_rad
    latitude_rad = math.radians(latitude_deg)
    east = -cosine * sin(hour_rad)
    north = cos(latitude_rad) * sine - sin(latitude_rad) * cosine * cos(hour_rad)
    up = sin(latitude_rad) * sine + cos(latitude_rad) * cosine * cos(hour_rad)
    return np.array([east, north, up])


def linear(rgb: U1) -> F8:
    """Return colours of a file as light, 0..1."""
    share = rgb / 255.0
    return share * share


def tone_map(light: F8) -> U1:
    """Return light as colours of a file; bright parts approach white slowly.

    Reinhard et al., "Photographic tone reproduction for digital images", SIGGRAPH 2002, equation 4.
    """
    exposed = _EXPOSURE * light
    shown = exposed * (1.0 + exposed / (_WHITE * _WHITE)) / (1.0 + exposed)
    return np.rint(255.0 * np.sqrt(np.minimum(shown, 1.0))).astype(np.uint8)


def sky(direction: F8, sun: F8 | None, *, wooded: bool) -> F8:
    """Return the light (n, 3) of the sky from directions (n, 3).

    Parameters
    ----------
    sun : (3,) direction to it; None indoors, where it is dark
    wooded : whether a forest goes on beyond the range of rays, and hides the sky above the horizon
    """
    if sun is None:
        return np.zeros(direction.shape)
    share = 1.0 - np.maximum(direction[:, 2], 0.0)
    share = share * share
    light = _ZENITH + (_HORIZON - _ZENITH) * (share * share)[:, None]
    if sun[2] > 0.0:
        light = light + (_GLOW / (_GLOW + 1.0 - _dot(direction, sun)))[:, None] * _SUN
    if wooded:
        hidden = np.clip((_TREE_TOPS - direction[:, 2]) / (_TREE_TOPS - _TREE_FEET), 0.0, 1.0)
        light = light + hidden[:, None] * (_FAR_WOOD - light)
    return light


def by_day(albedo: F8, facing: Facing, sun: F8, sun_share: F8 | None) -> F8:
    """Return the light (n, 3) that surfaces of an albedo (n, 3) send to the camera.

    Parameters
    ----------
    sun : (3,) its direction
    sun_share : (n,) visible share of it; None below the horizon, where the sky alone is as bright as by day
    """
    upward = np.where(facing.is_leaf, 0.35 + 0.5 * facing.cosine, 0.5 + 0.5 * facing.normal[:, 2])
    ambient = (_AMBIENT * (_UNDER + (1.0 - _UNDER) * upward))[:, None] * _SKY
    if sun_share is None:
        return albedo * ambient * 2.0
    towards = np.where(facing.is_leaf, 0.2 + 0.7 * facing.cosine, np.maximum(_dot(facing.normal, sun), 0.0))
    return albedo * (ambient + (_DIRECT * towards * sun_share)[:, None] * _SUN)


def by_lamp(albedo: F8, facing: Facing) -> F8:
    """Return the light (n, 3) that surfaces of an albedo (n, 3) in a hall send to the camera.

    There are lamps above, and one at the camera.
    """
    return albedo * (0.35 + 0.2 * facing.normal[:, 2] + 0.35 * facing.cosine)[:, None]


def with_haze(light: F8, range_m: NDArray[np.floating]) -> F8:
    """Return light (n, 3) seen through the air of a range (n,)."""
    share = (range_m / (range_m + _HAZE_M))[:, None]
    return light + share * (_HORIZON - light)


def _dot(vectors: F8, direction: F8) -> F8:
    return vectors[:, 0] * direction[0] + vectors[:, 1] * direction[1] + vectors[:, 2] * direction[2]
