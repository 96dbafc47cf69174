"""Between the globe and the world's metres."""

import math

import numpy as np
import pytest

from vlp16emu.motion import Gps
from vlp16emu.motion.geodesy import to_geodetic, to_local

ORIGINS = [
    Gps(latitude_deg=62.24, longitude_deg=25.75, height_m=120.0),
    Gps(latitude_deg=-33.5, longitude_deg=-70.6, height_m=900.0),
    Gps(latitude_deg=0.0, longitude_deg=179.9999, height_m=0.0),
    Gps(latitude_deg=89.9, longitude_deg=10.0, height_m=0.0),
]


def ecef(latitude_deg, longitude_deg, height_m):
    """Earth-centred coordinates by the textbook, from the defining axis and flattening."""
    a, f = 6_378_137.0, 1 / 298.257223563
    e2, phi, lam = f * (2 - f), math.radians(latitude_deg), math.radians(longitude_deg)
    n = a / math.sqrt(1 - e2 * math.sin(phi) ** 2)
    return np.array(
        [
            (n + height_m) * math.cos(phi) * math.cos(lam),
            (n + height_m) * math.cos(phi) * math.sin(lam),
            (n * (1 - e2) + height_m) * math.sin(phi),
        ]
    )


@pytest.mark.parametrize("origin", ORIGINS)
@pytest.mark.parametrize("offset_m", [(300.0, 0.0, 2.0), (0.0, 30_000.0, -40.0), (-100_000.0, 100_000.0, 9000.0)])
def test_a_point_lies_where_the_textbook_puts_it(origin, offset_m):
    """The geodetic point found is, in ECEF, the origin plus the offset along its east, north and up, within 1 um."""
    phi, lam = math.radians(origin.latitude_deg), math.radians(origin.longitude_deg)
    east = np.array([-math.sin(lam), math.cos(lam), 0.0])
    north = np.array([-math.sin(phi) * math.cos(lam), -math.sin(phi) * math.sin(lam), math.cos(phi)])
    up = np.cross(east, north)
    found = ecef(*to_geodetic(np.array([offset_m]), origin)[0])
    wanted = ecef(origin.latitude_deg, origin.longitude_deg, origin.height_m)
    wanted = wanted + offset_m[0] * east + offset_m[1] * north + offset_m[2] * up
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-6)


@pytest.mark.parametrize("origin", ORIGINS)
def test_there_and_back_again(origin):
    """Local to geodetic to local gives the same point within 1 um up to 100 km away."""
    rng = np.random.default_rng(3)
    local_m = rng.uniform(-100_000, 100_000, (200, 3)) * [1, 1, 0.05]
    np.testing.assert_allclose(to_local(to_geodetic(local_m, origin), origin), local_m, rtol=0, atol=1e-6)


def test_longitude_wraps_at_the_date_line():
    """East of 180 degrees comes -180."""
    longitude_deg = to_geodetic(
        np.array([[1000.0, 0.0, 0.0]]), Gps(latitude_deg=10.0, longitude_deg=179.999, height_m=0.0)
    )[0, 1]
    assert -180.0 <= longitude_deg < -179.9


def test_a_point_does_not_know_its_neighbours():
    """A point alone gives the same bits as among others."""
    many_m = np.random.default_rng(4).uniform(-1e4, 1e4, (37, 3))
    whole = to_geodetic(many_m, ORIGINS[0])
    assert (np.concatenate([to_geodetic(many_m[i : i + 1], ORIGINS[0]) for i in range(37)]) == whole).all()
