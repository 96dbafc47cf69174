"""What the receiver says of the walk."""

import math

import numpy as np
import pytest

from vlp16emu.motion import Gait, Path, Standing, Walking, fix_at, geodetic

START_NS = 1_780_000_000 * 10**9


def ecef(latitude_deg, longitude_deg):
    """WGS 84 to earth-centred coordinates at height 0, from the defining axis and flattening."""
    a, f = 6_378_137.0, 1 / 298.257223563
    e2, phi, lam = f * (2 - f), math.radians(latitude_deg), math.radians(longitude_deg)
    n = a / math.sqrt(1 - e2 * math.sin(phi) ** 2)
    return np.array(
        [n * math.cos(phi) * math.cos(lam), n * math.cos(phi) * math.sin(lam), n * (1 - e2) * math.sin(phi)]
    )


@pytest.mark.parametrize("origin", [(62.24, 25.75), (-33.5, -70.6), (0.0, 0.0)])
@pytest.mark.parametrize("offset_m", [(300.0, 0.0), (0.0, 300.0), (-200.0, 200.0)])
def test_geodetic_offset_has_the_right_length_and_direction(origin, offset_m):
    """Within 300 m the point found lies within 2 cm of the true one in the tangent plane at the origin."""
    phi, lam = map(math.radians, origin)
    east = np.array([-math.sin(lam), math.cos(lam), 0.0])
    north = np.array([-math.sin(phi) * math.cos(lam), -math.sin(phi) * math.sin(lam), math.cos(phi)])
    vector = ecef(*geodetic(*offset_m, *origin)) - ecef(*origin)
    np.testing.assert_allclose([vector @ east, vector @ north], offset_m, atol=0.02)


def test_longitude_wraps_at_the_date_line():
    """East of 180 degrees comes -180."""
    _, longitude = geodetic(1000.0, 0.0, 10.0, 179.999)
    assert -180.0 <= longitude < -179.9


def test_fix_agrees_with_the_walk():
    """Speed and course are those of the body over the second before the fix."""
    path = Path(np.array([[0.0, 0.0], [30.0, 30.0]]), lambda x, _y: 0.0 * x)
    gait = Gait(1.8, 0.0, 0.0)
    motion = Walking(
        path, start_ns=START_NS, speed_m_s=1.2, sensor_height_m=2.0, pitch_deg=0.0, roll_deg=0.0, gait=gait
    )
    fix = fix_at(motion, START_NS + 10 * 10**9, 62.0, 25.0)
    assert fix.speed_m_s == pytest.approx(1.2, rel=1e-6)
    assert fix.course_deg == pytest.approx(45.0, abs=1e-6)
    assert (fix.latitude_deg, fix.longitude_deg) == pytest.approx(
        geodetic(12 / 2**0.5, 12 / 2**0.5, 62.0, 25.0), abs=1e-9
    )


def test_standing_receiver_has_no_speed():
    """A static sensor reports speed 0 at its own place."""
    fix = fix_at(Standing(np.zeros(3), 0.0, 0.0, 0.0), START_NS, 62.0, 25.0)
    assert (fix.speed_m_s, fix.latitude_deg, fix.longitude_deg) == (0.0, 62.0, 25.0)
