"""From way points to a curve by arc length that turns and climbs no harder than a person can."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import TrajectoryError
from vlp16emu.motion.slope import limit_slope
from vlp16emu.types import HeightField

if TYPE_CHECKING:  # imported where curves are made: it takes 0.2 s, and who stands has none
    from scipy.interpolate import BSpline, CubicSpline

__all__ = ["Curve", "curve_through", "taylor"]

Array = NDArray[np.float64]

_APART_M = 0.01
"""Way points nearer than this are one."""
_LONGEST_M = 100_000.0
"""What a person walks in a day; a longer path is a mistake of units."""
_FARTHEST_M = 1e6
"""From the origin of the scene; so far the ground is good to a nanometre."""
_SMALLEST_RADIUS_M = 0.1
"""Of a turn. A body that is 0.4 m wide turns on the spot rather than along a smaller arc (assumption)."""
_STEEPEST_DEG = 60.0
"""Of the ground along the path; steeper is climbed by hand (assumption)."""
_KNOT_M = 0.25
"""Greatest distance between knots: resolves the ground under a walker, smoothed over a pace."""
_KNOT_RAD = 0.125
"""Greatest turn between knots: keeps the parameter an arc length within 1e-4."""
_KNOT_GROWTH = 0.2
"""How much the distance between knots may grow per metre: neighbours stay within a factor of about 1.2."""
_SAMPLE_M = 0.05
_FEWEST_SAMPLES = 16
"""Between two way points: fine enough that no turn below the smallest radius hides between samples."""
_PACE_M = 0.7
"""Length of a pace at a common walking speed (Perry and Burnfield, "Gait Analysis", 2nd ed., chapter 20)."""
_HEIGHT_M = 0.1
"""Distance between the heights that are taken from the ground."""
_GAUSS_X, _GAUSS_WEIGHT = np.polynomial.legendre.leggauss(5)

Position = Callable[[Array], Array]


@dataclass(frozen=True, slots=True)
class Curve:
    """Quintic spline by arc length, four times continuously differentiable."""

    spline: "BSpline"
    """Position (n, 3) relative to `origin_m` over arc length."""
    knots_m: Array
    """(k,) arc lengths from 0 to the length."""
    origin_m: Array
    """(3,) world."""
    way_points_at_m: Array
    """(w,) arc length of each way point."""
    closed: bool
    """Whether the curve goes on at its start, as smoothly as anywhere."""


def taylor(spline: "BSpline", breaks: Array) -> Array:
    """Coefficients of the pieces of a quintic spline, lowest power first: (6, k - 1, ...) for breaks (k,)."""
    return np.stack([spline.derivative(power)(breaks[:-1]) / math.factorial(power) for power in range(6)])


def curve_through(way_points_m: Array, height_m: HeightField) -> Curve:
    """Curve through way points (w, 2) over the ground; closed where the last way point is the first.

    The plan is the natural (or, closed, the periodic) cubic spline, drawn again by arc length as a
    quintic, since the second time derivative of the heading takes three derivatives of the position.

    Raises
    ------
    TrajectoryError
        where a person cannot walk through the way points
    """
    from scipy.interpolate import CubicSpline

    _check_way_points(way_points_m)
    closed = math.dist(way_points_m[0], way_points_m[-1]) < _APART_M
    origin_m = np.append(way_points_m[0], 0.0)
    points_m = way_points_m - way_points_m[0]
    if closed:
        points_m[-1] = points_m[0]
    # Centripetal parameters keep the curve from looping where way points are unevenly spaced
    # (Lee, "Choosing nodes in parametric curve interpolation", CAD 21(6), 1989).
    u = np.concatenate([[0.0], np.cumsum(np.sqrt(np.hypot(*np.diff(points_m, axis=0).T)))])
    cubic = CubicSpline(u, points_m, bc_type="periodic" if closed else "natural")
    knots, at_way_points = _knots(cubic, u, way_points_m, closed)
    plan, along_m = _by_length(cubic, knots, closed)
    z_m = _heights(plan, along_m, origin_m, height_m, closed)
    solid = _spline(along_m, np.column_stack([plan(along_m), z_m(along_m)]), closed)
    _check_slope(solid, along_m, origin_m)
    spline, knots_m = _by_length(solid, along_m, closed)
    return Curve(spline, knots_m, origin_m, knots_m[at_way_points], closed)


def _check_way_points(way_points_m: Array) -> None:
    """Let through only way points that a curve can pass."""
    if len(way_points_m) < 2:
        raise TrajectoryError("way points", f"found {len(way_points_m)}", "at least 2 of them")
    for i, point in enumerate(way_points_m):
        where = f"way point {i + 1} of {len(way_points_m)}"
        if not np.isfinite(point).all():
            raise TrajectoryError(where, f"found {tuple(point.tolist())}", "finite coordinates")
        if np.abs(point).max() > _FARTHEST_M:
            raise TrajectoryError(
                where, f"found {tuple(point.tolist())}", f"within {_FARTHEST_M:g} m of the origin"
            )
        if i and math.dist(point, way_points_m[i - 1]) < _APART_M:
            raise TrajectoryError(
                where, "coincides with the one before it", "at least 1 cm between way points"
            )
    length_m = float(np.hypot(*np.diff(way_points_m, axis=0).T).sum())
    if length_m > _LONGEST_M:
        found = f"found {length_m / 1000:.4g} km from first to last"
        raise TrajectoryError("way points", found, f"at most {_LONGEST_M / 1000:g} km")


def _knots(
    cubic: "CubicSpline", u: Array, way_points_m: Array, closed: bool
) -> tuple[Array, NDArray[np.int64]]:
    """Parameters of the knots, dense in turns, and which of them are the way points."""
    chords_m = np.hypot(*np.diff(way_points_m, axis=0).T)
    counts = np.maximum(_FEWEST_SAMPLES, np.ceil(chords_m / _SAMPLE_M)).astype(np.int64)
    at = np.concatenate([[0], np.cumsum(counts)])
    fine = np.interp(np.arange(at[-1] + 1), at, u)
    steps = np.diff(cubic(fine), axis=0)
    lengths_m = np.hypot(*steps.T)
    curvature = _curvature(steps, closed)
    _check_radius(curvature, cubic(fine) + way_points_m[0], np.searchsorted(at, np.arange(len(fine))))
    # The curve bends most suddenly where way points are near each other, and a spline is least sure at its ends.
    limit_m = np.minimum(_KNOT_M, lengths_m.sum() / 8.0)
    near_m = np.minimum(np.append(chords_m[0], chords_m), np.append(chords_m, chords_m[-1]))
    spacing_m = np.minimum(limit_m, _KNOT_RAD / np.maximum(curvature, 1e-9))
    spacing_m[at] = np.minimum(spacing_m[at], near_m / 3.0)
    if not closed:
        spacing_m[[0, -1]] /= 4.0
    limit_slope(spacing_m, _KNOT_GROWTH * lengths_m)
    if closed:
        spacing_m[0] = spacing_m[-1] = min(spacing_m[0], spacing_m[-1])
        limit_slope(spacing_m, _KNOT_GROWTH * lengths_m)
    measure = np.concatenate([[0.0], np.cumsum(lengths_m * 2 / (spacing_m[1:] + spacing_m[:-1]))])
    # Whole numbers of knot intervals between way points, so that the curve passes them to the last bit.
    pieces = np.ceil(np.diff(measure[at])).astype(np.int64)
    at_way_points = np.concatenate([[0], np.cumsum(pieces)])
    wanted = np.interp(np.arange(at_way_points[-1] + 1), at_way_points, measure[at])
    return np.interp(wanted, measure, fine), at_way_points


def _curvature(steps: Array, closed: bool) -> Array:
    """Curvature (n,) at n samples, from the angles between the n - 1 steps; infinite where they halt."""
    before, after = (np.roll(steps, 1, axis=0), steps) if closed else (steps[:-1], steps[1:])
    turn = np.abs(
        np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], (before * after).sum(axis=1))
    )
    mean_m = np.hypot(*before.T) / 2 + np.hypot(*after.T) / 2
    inner = np.where(np.minimum(np.hypot(*before.T), np.hypot(*after.T)) > 1e-9, turn, np.inf) / mean_m
    if closed:
        return np.append(inner, inner[0])
    return np.concatenate([inner[:1], inner, inner[-1:]])


def _check_radius(curvature: Array, points_m: Array, number: NDArray[np.int64]) -> None:
    """Refuse a turn that is too tight to walk."""
    worst = int(curvature.argmax())
    if curvature[worst] * _SMALLEST_RADIUS_M > 1.0:
        x_m, y_m = points_m[worst]
        raise TrajectoryError(
            f"path at ({x_m:.2f}, {y_m:.2f}) m, near way point {number[worst] + 1}",
            f"turns with a radius of {1.0 / curvature[worst]:.2g} m",
            f"at least {_SMALLEST_RADIUS_M:g} m: more way points round the turn",
        )


def _spline(at: Array, points_m: Array, closed: bool) -> "BSpline":
    """Quintic spline through points."""
    from scipy.interpolate import make_interp_spline

    if not closed:
        return make_interp_spline(at, points_m, k=5)
    return make_interp_spline(at, np.concatenate([points_m[:-1], points_m[:1]]), k=5, bc_type="periodic")


def _by_length(curve: "BSpline | CubicSpline", knots: Array, closed: bool) -> "tuple[BSpline, Array]":
    """Draw a curve again with its own length as the parameter: the spline and its knots."""
    half = np.diff(knots) / 2
    at = (knots[1:] - half)[:, None] + half[:, None] * _GAUSS_X
    speed = np.sqrt((curve(at.reshape(-1), 1) ** 2).sum(axis=1)).reshape(at.shape)
    along_m = np.concatenate([[0.0], np.cumsum(half * (speed @ _GAUSS_WEIGHT))])
    return _spline(along_m, curve(knots), closed), along_m


def _heights(
    plan: "BSpline", along_m: Array, origin_m: Array, height_m: HeightField, closed: bool
) -> "CubicSpline":
    """Heights along the plan as the hip takes them: the mean of the ground from a pace behind to one ahead.

    The weight falls linearly to nothing over a pace, since two feet in turn carry the hip (assumption).
    Beyond the ends the ground goes on point-symmetrically, so even slopes stay as they are.
    """
    from scipy.interpolate import CubicSpline

    count = max(8, math.ceil(along_m[-1] / _HEIGHT_M))
    at_m = np.linspace(0.0, along_m[-1], count + 1)
    xy_m = plan(at_m) + origin_m[:2]
    ground_m = height_m(xy_m[:, 0], xy_m[:, 1])
    reach = math.ceil(_PACE_M * count / along_m[-1])
    weight = np.arange(1, reach + 1) / reach**2
    weight = np.concatenate([weight, weight[-2::-1]])
    if closed:
        padded = np.pad(ground_m[:-1], reach - 1, mode="wrap")
        smooth = np.convolve(padded, weight, mode="valid")
        return CubicSpline(at_m, np.append(smooth, smooth[0]), bc_type="periodic")
    padded = np.pad(ground_m, reach - 1, mode="reflect", reflect_type="odd")
    return CubicSpline(at_m, np.convolve(padded, weight, mode="valid"))


def _check_slope(solid: "BSpline", along_m: Array, origin_m: Array) -> None:
    """Refuse ground that nobody walks up or down."""
    dx, dy, dz = solid(along_m, 1).T
    slope = np.abs(dz) / np.hypot(dx, dy)
    worst = int(slope.argmax())
    if slope[worst] > math.tan(math.radians(_STEEPEST_DEG)):
        x_m, y_m, _ = solid(along_m[worst]) + origin_m
        raise TrajectoryError(
            f"path at ({x_m:.2f}, {y_m:.2f}) m",
            f"the ground rises or falls by {math.degrees(math.atan(slope[worst])):.0f} degrees",
            f"at most {_STEEPEST_DEG:g} degrees",
        )
