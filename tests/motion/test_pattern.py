"""Paths that cover a plot."""

import numpy as np
import pytest

from vlp16emu.errors import TrajectoryError
from vlp16emu.motion import LawnMower
from vlp16emu.motion.path import Path
from vlp16emu.motion.way_points import lawn_mower

PLOT = {
    "corner_m": (5.0, -6.0),
    "length_m": 30.0,
    "width_m": 27.0,
    "azimuth_deg": 30.0,
    "line_spacing_m": 5.0,
    "turn_radius_m": 1.0,
}


def in_plot(point_m):
    """Along and across the plot."""
    c, s = np.cos(np.radians(30.0)), np.sin(np.radians(30.0))
    x, y = (point_m[:, :2] - PLOT["corner_m"]).T
    return c * x + s * y, c * y - s * x


@pytest.fixture(scope="module")
def mown():
    """A path over level ground."""
    return Path(lawn_mower(LawnMower(**PLOT)), lambda x, _y: 0.0 * x)


def test_lines_cover_the_plot_and_stay_in_it(mown):
    """Six lines, 5 m apart and in the middle of 27 m, each walked over nearly its length, within 2 mm of the plot."""
    along, across = in_plot(mown.at(np.linspace(0.0, mown.length_m, 40_001))[0])
    assert -0.002 < along.min() < along.max() < 30.002
    assert across.min() == pytest.approx(1.0, abs=0.002)
    assert across.max() == pytest.approx(26.0, abs=0.002)
    for line in range(6):
        on_it = np.abs(across - (1.0 + 5.0 * line)) < 0.002
        assert np.ptp(along[on_it]) > 27.9


def test_length_is_that_of_lines_and_arcs(mown):
    """Quarter circles cut ten corners off six lines and five links."""
    assert mown.length_m == pytest.approx(6 * 30 + 5 * 5 - 10 * (2 - np.pi / 2), rel=1e-4)


def test_turns_have_their_radius(mown):
    """Nowhere does the path turn tighter than 0.8 times the radius."""
    _, heading_rad = mown.derivatives_at(np.linspace(0.0, mown.length_m, 40_001))
    assert np.abs(heading_rad[:, 1]).max() < 1.25


def test_one_line_is_a_line():
    """A plot narrower than the spacing has one line, in its middle."""
    points_m = lawn_mower(LawnMower(**PLOT | {"width_m": 3.0, "azimuth_deg": 0.0}))
    np.testing.assert_allclose(points_m[:, 1], -4.5)


@pytest.mark.parametrize("radius_m", [2.501, 2.6])
def test_turns_that_do_not_fit_are_refused(radius_m):
    """The radius is at most half the spacing."""
    with pytest.raises(TrajectoryError, match="above 0 and at most half of 5 m, line spacing or length"):
        lawn_mower(LawnMower(**PLOT | {"turn_radius_m": radius_m}))
