"""Interpolating splines, against those of scipy and by what defines them."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline, make_interp_spline

from vlp16emu.motion.splines import interpolant


def uneven(n, least=0.2):
    """Parameters with steps that differ by up to a factor of ten, and values in the plane."""
    rng = np.random.default_rng(n)
    return np.cumsum(rng.uniform(least, 2.0, n)), rng.normal(size=(n, 2))


def agree(found, wanted, at):
    """Compare values and two derivatives between the ends."""
    x = np.linspace(at[0], at[-1], 500)
    for derivative in range(3):
        np.testing.assert_allclose(found(x, derivative), wanted(x, derivative), rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("n", [2, 3, 4, 5, 9, 200])
def test_cubic_splines_are_scipys(n):
    """With natural and not-a-knot ends, with few points too, they are those of scipy, to rounding."""
    at, values = uneven(n)
    agree(interpolant(at, values), CubicSpline(at, values), at)
    agree(interpolant(at, values, ends="natural"), CubicSpline(at, values, bc_type="natural"), at)


@pytest.mark.parametrize("n", [3, 4, 9, 200])
def test_periodic_cubic_splines_are_scipys(n):
    """The neighbouring laps that are solved along do not show, however few the points are."""
    at, values = uneven(n)
    values[-1] = values[0]
    agree(interpolant(at, values, ends="periodic"), CubicSpline(at, values, bc_type="periodic"), at)


@pytest.mark.parametrize("n", [6, 7, 12, 200])
def test_quintic_splines_are_scipys(n):
    """Quintic splines are those of scipy, to rounding."""
    at, values = uneven(n, least=1.5)
    agree(interpolant(at, values, 5), make_interp_spline(at, values, k=5), at)


def test_periodic_quintic_splines_are_scipys():
    """A closed quintic spline is that of scipy, to rounding, and leads from its end into its start."""
    at, values = uneven(40, least=1.5)
    values[-1] = values[0]
    found = interpolant(at, values, 5, "periodic")
    agree(found, make_interp_spline(at, values, k=5, bc_type="periodic"), at)
    for derivative in range(5):
        np.testing.assert_allclose(*(found(at[[end]], derivative) for end in (0, -1)), rtol=0, atol=1e-10)


def test_points_are_met_exactly():
    """At its parameters a spline has the very values it was made of, within one rounding."""
    at, values = uneven(50)
    np.testing.assert_allclose(interpolant(at, values, 5)(at), values, rtol=0, atol=1e-13)
