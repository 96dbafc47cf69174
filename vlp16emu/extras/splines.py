"""Interpolating splines, computed in a fixed order for the same bits on every processor.

Libraries solve for splines with LAPACK, which selects its code by processor.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from vlp16emu.kernels.compiler import kernel
from vlp16emu.types import F8, I8

_WRAPPED = 64
"""Points of the neighbouring laps with which a periodic spline is solved: points beyond have weights below
2**-64."""


@dataclass(frozen=True, slots=True)
class Spline:
    """A piecewise polynomial; each piece is a polynomial of the distance from its break."""

    breaks: F8  # (n,) begins of the pieces, and end of the last one
    powers: F8  # (degree + 1, n - 1, m) coefficients, lowest power first

    def piece(self, x: F8) -> I8:
        """Return the pieces that contain parameters (k,); the outer pieces extend beyond the ends."""
        return np.clip(np.searchsorted(self.breaks, x, side="right") - 1, 0, len(self.breaks) - 2)

    def within(self, x: F8) -> tuple[F8, F8]:
        """Return coefficients (degree + 1, m, k) at parameters (k,), and distances (k,) from the breaks."""
        piece = self.piece(x)
        return np.take(np.moveaxis(self.powers, 1, -1), piece, axis=-1), x - self.breaks[piece]

    def __call__(self, x: F8, derivative: int = 0) -> F8:
        """Return values (k, m) of the curve or a derivative at (k,) parameters."""
        return polynomial(*self.within(x), derivative).T


def polynomial(powers: F8, x: F8, derivative: int = 0) -> F8:
    """Evaluate polynomials (degree + 1, m, k), lowest power first, or a derivative, at x (k,)."""
    value = np.zeros(powers.shape[1:])
    for power in range(len(powers) - 1, derivative - 1, -1):
        value = value * x + powers[power] * math.perm(power, derivative)
    return value


def interpolant(
    at: F8, values: F8, degree: int = 3, ends: Literal["not-a-knot", "natural", "periodic"] = "not-a-knot"
) -> Spline:
    """Return the spline of a degree through values (n, m) at increasing parameters (n,).

    Parameters
    ----------
    degree : odd; with too few points, the degree that they determine
    ends : no jump of any derivative in the outer pieces, or no curvature there (cubic splines only), or a
        smooth
    transition from end to start, for which the last value must equal the first
    """
    if ends == "periodic":
        lap = np.arange(-_WRAPPED, len(at) + _WRAPPED)
        whole, rest = np.divmod(lap, len(at) - 1)
        wrapped = interpolant(at[rest] + whole * (at[-1] - at[0]), values[rest], degree)
        return Spline(at, wrapped.powers[:, _WRAPPED : _WRAPPED + len(at) - 1].copy())
    natural = ends == "natural"
    n = len(at)
    degree = degree if natural else min(degree, n - 1)
    dropped = 1 if natural else (degree + 1) // 2
    inner = at[dropped:-dropped] if natural or n > degree + 1 else at[:0]
    knots = np.concatenate([np.repeat(at[0], degree + 1), inner, np.repeat(at[-1], degree + 1)])
    return Spline(at, powers(at, knots, _control_points(at, values, knots, natural), degree))


def _cells(knots: F8, x: F8, degree: int) -> I8:
    """Return the first knot of the interval of each parameter (n,); the end is in the last interval."""
    return np.clip(np.searchsorted(knots, x, side="right") - 1, degree, len(knots) - degree - 2)


def _basis(knots: F8, x: F8, cell: I8, degree: int) -> F8:
    """Return the nonzero B-splines (n, degree + 1).

    Source: de Boor, A Practical Guide to Splines, chapter X, algorithm BSPLVB.
    """
    value = np.ones((len(x), 1))
    for j in range(1, degree + 1):
        before = value
        value = np.zeros((len(x), j + 1))
        for r in range(j):
            right, left = knots[cell + r + 1], knots[cell + r + 1 - j]
            share = before[:, r] / (right - left)
            value[:, r] += (right - x) * share
            value[:, r + 1] = (x - left) * share
    return value


def _control_points(at: F8, values: F8, knots: F8, natural: bool) -> F8:
    """Return the control points (c, m) of the spline with these knots (t,) through values (n, m)."""
    degree = len(knots) - len(at) - (3 if natural else 1)
    size = len(knots) - degree - 1
    reach = max(degree - 1, 1)
    cell = _cells(knots, at, degree)
    rows = np.arange(len(at))
    if natural:  # rows of its conditions are after the first point and before the last one
        rows[1:] += 1
        rows[-1] += 1
    bands = np.zeros((size, 2 * reach + 1))
    out = np.zeros((size, values.shape[1]))
    out[rows] = values
    for r, share in enumerate(_basis(knots, at, cell, degree).T):
        place = cell - degree + r - rows
        known = abs(place) <= reach  # coefficients farther away are 0
        bands[rows[known], reach + place[known]] = share[known]
    if natural:
        for row, first in ((1, 1), (-2, len(knots) - 6)):
            before, after = 1.0 / (knots[first + 3 : first + 5] - knots[first : first + 2])
            bands[row, 1:4] = before, -before - after, after
    _solve(bands, out)
    return out


@kernel
def _solve(bands: F8, values: F8) -> None:
    """Solve a banded system in place: values (n, m) become the solution.

    Row i of the bands (n, 2 b + 1) has the coefficients of unknowns i - b .. i + b. Matrices of B-splines are
    totally positive, so that elimination needs no pivots (de Boor, chapter XIII).
    """
    n = len(bands)
    reach = bands.shape[1] // 2
    for i in range(n):
        for k in range(i + 1, min(i + reach + 1, n)):
            factor = bands[k, reach + i - k] / bands[i, reach]
            for j in range(1, reach + 1):
                bands[k, reach + i - k + j] -= factor * bands[i, reach + j]
            for a in range(values.shape[1]):
                values[k, a] -= factor * values[i, a]
    for i in range(n - 1, -1, -1):
        for a in range(values.shape[1]):
            for j in range(1, min(reach, n - 1 - i) + 1):
                values[i, a] -= bands[i, reach + j] * values[i + j, a]
            values[i, a] /= bands[i, reach]


def powers(at: F8, knots: F8, control: F8, degree: int) -> F8:
    """Return pieces (degree + 1, n - 1, m) of a B-spline: powers of the distance from each break.

    Parameters
    ----------
    at : (n,) begins of the pieces, and end of the last one
    knots : (c + degree + 1,) knots
    control : (c, m) control points
    """
    pieces = np.zeros((degree + 1, len(at) - 1, control.shape[1]))
    cell = _cells(knots, at[:-1], degree)
    for power in range(degree + 1):
        left = degree - power
        for r, share in enumerate(_basis(knots, at[:-1], cell, left).T):
            pieces[power] += control[cell - left + r] * share[:, None]
        pieces[power] /= math.factorial(power)
        if left:
            # The derivative's control points are differences of these; control points of empty spans are not
            # used.
            span = (knots[1 + left : len(control) + left] - knots[1 : len(control)])[:, None]
            steps = left * np.diff(control, axis=0) / np.where(span > 0.0, span, 1.0)
            control = np.concatenate([control[:1], steps])
    return pieces
