"""Distance to a path."""

from itertools import pairwise

import numpy as np
import pytest

from vlp16emu.foliage.polyline import Polyline, distance_m

RNG = np.random.default_rng(7)


def test_distance_agrees_with_many_points_on_the_line():
    """The distance equals that to the nearest of many points laid on the line at most 3 mm apart."""
    line, points = RNG.uniform(0, 10, (5, 2)), RNG.uniform(-5, 15, (200, 2))
    share = np.linspace(0, 1, 5001)[:, None]
    dense = np.concatenate([a + share * (b - a) for a, b in pairwise(line)])
    twin = [np.hypot(*(dense - p).T).min() for p in points]
    assert distance_m(points, line) == pytest.approx(twin, abs=1.5e-3)


def test_a_reversed_line_is_as_far_to_the_last_bit():
    """Both walking directions give identical numbers."""
    line, points = RNG.uniform(0, 10, (9, 2)), RNG.uniform(-5, 15, (500, 2))
    assert np.array_equal(distance_m(points, line), distance_m(points, line[::-1]))


def test_a_line_of_one_point_and_a_doubled_point():
    """A sensor that stands is a line of one point, and a repeated point changes nothing."""
    points = RNG.uniform(-5, 15, (20, 2))
    one = distance_m(points, np.array([[1.0, 2.0]]))
    assert one == pytest.approx(np.hypot(*(points - (1, 2)).T))
    assert np.array_equal(one, distance_m(points, np.array([[1.0, 2.0], [1.0, 2.0]])))


def test_a_long_line_is_searched_in_pieces_without_loss():
    """On a line of 1000 segments that winds back on itself the distance is that to the nearest of all
    segments."""
    turn = np.linspace(0, 12 * np.pi, 1001)
    line = np.column_stack([turn * np.cos(turn), turn * np.sin(turn)])
    points = RNG.uniform(-45, 45, (300, 2))
    twin = np.min([distance_m(points, piece) for piece in pairwise(line)], axis=0)
    assert np.array_equal(Polyline(line).distance_m(points), twin)
