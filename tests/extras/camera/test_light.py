"""Daylight beside formulas of others."""

from datetime import UTC, datetime

import numpy as np
import pytest

from vlp16emu.extras.camera.light import linear, sky, sun_direction, tone_map


def spencer(when: datetime, latitude_deg: float, longitude_deg: float) -> np.ndarray:
    """East, north, up to the sun by Fourier series (J. W. Spencer, Search 2(5), 1971, as in NOAA's solar
    calculator)."""
    hours = when.hour + when.minute / 60
    g = 2 * np.pi / 365 * (when.timetuple().tm_yday - 1 + (hours - 12) / 24)
    fourier = (
        7.5e-5
        + 0.001868 * np.cos(g)
        - 0.032077 * np.sin(g)
        - 0.014615 * np.cos(2 * g)
        - 0.040849 * np.sin(2 * g)
    )
    declination = 0.006918 - 0.399912 * np.cos(g) + 0.070257 * np.sin(g) - 0.006758 * np.cos(2 * g)
    declination += 0.000907 * np.sin(2 * g) - 0.002697 * np.cos(3 * g) + 0.00148 * np.sin(3 * g)
    hour = np.radians((60 * hours + 229.18 * fourier + 4 * longitude_deg) / 4 - 180)
    latitude = np.radians(latitude_deg)
    return np.array(
        [
            -np.cos(declination) * np.sin(hour),
            np.cos(latitude) * np.sin(declination) - np.sin(latitude) * np.cos(declination) * np.cos(hour),
            np.sin(latitude) * np.sin(declination) + np.cos(latitude) * np.cos(declination) * np.cos(hour),
        ]
    )


@pytest.mark.parametrize(
    ("when", "latitude_deg", "longitude_deg"),
    [
        (datetime(2026, 6, 21, 9, 15, tzinfo=UTC), 62.24, 25.75),
        (datetime(2026, 12, 3, 15, 0, tzinfo=UTC), 47.0, 8.0),
        (datetime(2031, 3, 20, 22, 30, tzinfo=UTC), -33.0, 151.0),
        (datetime(2026, 9, 1, 0, 0, tzinfo=UTC), 40.0, -105.0),
    ],
)
def test_the_sun_stands_where_another_formula_has_it(when, latitude_deg, longitude_deg):
    """In both hemispheres, by day and by night, the sun is within 0.6 degrees of Spencer's series."""
    sun = sun_direction(int(when.timestamp()) * 10**9, latitude_deg, longitude_deg)
    assert np.linalg.norm(sun) == pytest.approx(1.0)
    assert np.degrees(np.arccos(sun @ spencer(when, latitude_deg, longitude_deg))) < 0.6


def test_the_sky_is_bluest_above_and_bright_about_the_sun():
    """The zenith has less red than the horizon, the sky about the sun is the brightest, and a forest
    darkens its foot."""
    up, ahead, sun = np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 1.0, 0.0]]), np.array([0.6, 0.0, 0.8])
    open_up, open_ahead, at_sun = (sky(of, sun, wooded=False)[0] for of in (up, ahead, sun[None]))
    assert open_up[0] / open_up[2] < 0.5 * open_ahead[0] / open_ahead[2]
    assert at_sun.min() > max(open_up.max(), open_ahead.max())
    assert (sky(ahead, sun, wooded=True)[0] < 0.4 * open_ahead).all()
    np.testing.assert_array_equal(sky(up, sun, wooded=True)[0], open_up)
    assert not sky(up, None, wooded=False).any()


def test_brighter_light_is_a_brighter_colour():
    """Colours rise with light, from black to white, and the palette's light is its square."""
    shown = tone_map(np.linspace(0.0, 5.0, 200)[:, None].repeat(3, axis=1))[:, 0].astype(int)
    assert (np.diff(shown) >= 0).all()
    assert (shown[0], shown[-1]) == (0, 255)
    np.testing.assert_allclose(linear(np.array([0, 51, 255], np.uint8)), [0.0, 0.04, 1.0])
