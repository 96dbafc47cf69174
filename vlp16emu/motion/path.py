"""The way that a person takes: a smooth curve over the ground, by arc length."""

import hashlib
import math
from collections.abc import Mapping
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.motion.curve import curve_through, taylor
from vlp16emu.store import recalled
from vlp16emu.types import HeightField

__all__ = ["Path"]

Array = NDArray[np.float64]


class Path:
    """A curve through way points that follows the ground: four times continuously differentiable.

    It is a quintic spline whose parameter is the length of the way over hill and dale; a walker's
    hip smooths the ground, so the curve takes the mean of the heights from a pace behind to one ahead.

    Parameters
    ----------
    way_points_m : (n, 2) float64, x and y in the world, n >= 2; where the last is the first (within
        1 cm), the path is a loop that closes smoothly
    height_m : ground height
    ground : name of all that decides it; empty where nothing is kept on disk

    Raises
    ------
    TrajectoryError
        where a way point is not finite or coincides with the one before it, where the curve turns with a
        radius below 0.1 m or climbs by more than 60 degrees, and where it is longer than 100 km
    """

    def __init__(self, way_points_m: Array, height_m: HeightField, ground: str = "") -> None:
        # Kept for the import of scipy's splines, which takes 0.4 s of a start.
        name = ground and f"path {ground} {hashlib.sha256(way_points_m.tobytes()).hexdigest()}"
        laid = recalled(name, lambda: _laid(way_points_m, height_m), lambda kept: kept, lambda kept: kept)
        self._knots_m, self._coefficients = laid["knots_m"], laid["coefficients"]
        self._heading_rad = laid["heading_rad"]
        self.length_m = float(self._knots_m[-1])
        self.closed = bool(laid["closed"])
        """Whether the path goes on at its start; then arc lengths may go on beyond the length."""
        self.way_points_at_m = laid["way_points_at_m"]
        """(n,) arc length of each way point."""
        self.xy_m = laid["xy_m"]
        """(m, 2) float64, points of the path 0.25 m apart at most."""

    def at(self, s_m: Array) -> tuple[Array, Array]:
        """Ground points (n, 3) in metres and headings (n,) in radians from east at arc lengths (n,).

        Beyond its ends the path stays where it ends, unless it is closed.
        """
        point_m, heading_rad = self.derivatives_at(s_m)
        return np.ascontiguousarray(point_m[:, 0]), np.ascontiguousarray(heading_rad[:, 0])

    def derivatives_at(self, s_m: Array) -> tuple[Array, Array]:
        """Points (n, 3, 3) and headings (n, 3), each with first and second derivative by arc length.

        The middle axis of the points is the order of the derivative. Headings are continuous, in radians.
        """
        point_m, heading_rad = np.empty((len(s_m), 3, 3)), np.empty((len(s_m), 3))
        _evaluate(
            self._knots_m,
            self._coefficients,
            self._heading_rad,
            self.closed,
            np.ascontiguousarray(s_m),
            point_m,
            heading_rad,
        )
        return point_m, heading_rad


def _laid(way_points_m: Array, height_m: HeightField) -> Mapping[str, NDArray[Any]]:
    """Lay a path, as arrays."""
    curve = curve_through(way_points_m, height_m)
    coefficients = taylor(curve.spline, curve.knots_m)
    coefficients[0] += curve.origin_m
    return {
        "knots_m": curve.knots_m,
        # (6, pieces, 3): powers of the distance into the piece, lowest first.
        "coefficients": np.ascontiguousarray(coefficients),
        "heading_rad": _headings(curve.spline(curve.knots_m, 1)),
        "closed": np.array(curve.closed),
        "way_points_at_m": curve.way_points_at_m,
        "xy_m": np.ascontiguousarray((curve.spline(curve.knots_m) + curve.origin_m)[:, :2]),
    }


def _headings(tangent: Array) -> Array:
    """Headings (k,) of the tangents (k, 3) at the knots, continuous."""
    return np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))


@numba.njit(cache=True, nogil=True)
def _evaluate(
    knots_m: Array,
    coefficients: Array,
    heading_at_knot: Array,
    closed: bool,
    s_m: Array,
    point_m: Array,
    heading_rad: Array,
) -> None:
    """Evaluate the pieces and their derivatives, each point alone."""
    length_m, last = knots_m[-1], knots_m.size - 2
    for i in range(s_m.size):
        lap = math.floor(s_m[i] / length_m) if closed else 0.0
        s = min(max(s_m[i] - lap * length_m, 0.0), length_m)
        piece = min(np.searchsorted(knots_m, s, side="right") - 1, last)
        d = s - knots_m[piece]
        c = coefficients[:, piece, :]
        for a in range(3):
            point_m[i, 0, a] = (
                ((((c[5, a] * d + c[4, a]) * d + c[3, a]) * d + c[2, a]) * d + c[1, a]) * d
            ) + c[0, a]
            point_m[i, 1, a] = (
                ((5.0 * c[5, a] * d + 4.0 * c[4, a]) * d + 3.0 * c[3, a]) * d + 2.0 * c[2, a]
            ) * d + c[1, a]
            point_m[i, 2, a] = ((20.0 * c[5, a] * d + 12.0 * c[4, a]) * d + 6.0 * c[3, a]) * d + 2.0 * c[2, a]
        x3 = (60.0 * c[5, 0] * d + 24.0 * c[4, 0]) * d + 6.0 * c[3, 0]
        y3 = (60.0 * c[5, 1] * d + 24.0 * c[4, 1]) * d + 6.0 * c[3, 1]
        x1, y1, x2, y2 = point_m[i, 1, 0], point_m[i, 1, 1], point_m[i, 2, 0], point_m[i, 2, 1]
        # From the knot's own heading, so that it stays continuous where atan2 does not.
        turn = math.atan2(c[1, 0] * y1 - c[1, 1] * x1, c[1, 0] * x1 + c[1, 1] * y1)
        heading_rad[i, 0] = heading_at_knot[piece] + turn + lap * (heading_at_knot[-1] - heading_at_knot[0])
        run2 = x1 * x1 + y1 * y1
        rate = (x1 * y2 - y1 * x2) / run2
        heading_rad[i, 1] = rate
        heading_rad[i, 2] = (x1 * y3 - y1 * x3 - 2.0 * (x1 * x2 + y1 * y2) * rate) / run2
