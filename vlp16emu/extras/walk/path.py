"""The path of a person: a smooth curve through waypoints over the ground, by arc length."""

import hashlib
import math

import numpy as np

from vlp16emu.elementary import atan2, hypot, norm
from vlp16emu.errors import TrajectoryError
from vlp16emu.extras.splines import Spline, interpolant, polynomial
from vlp16emu.kernels.compiler import array_kernel
from vlp16emu.store import recall
from vlp16emu.types import F8, I8, HeightField

_APART_M = 0.01  # waypoints nearer to each other than this are one waypoint
_LONGEST_M = 100_000.0  # more than a person walks in a day: a longer path is a mistake of units
_FARTHEST_M = 1e6  # from the origin of the scene; up to there the ground is exact to a nanometre
_SMALLEST_RADIUS_M = 0.1
"""Smallest turning radius: a person 0.4 m wide turns on the spot instead of on a smaller arc (assumption)."""
_STEEPEST_DEG = (
    60.0  # greatest slope along the path; people climb steeper ground with their hands (assumption)
)
_STEEPEST = 1.7320508075688772  # its tangent
_KNOT_M = 0.25  # greatest distance between knots: resolves the ground under a walker, smoothed over a pace
_KNOT_RAD = 0.125  # greatest turn between knots: keeps the parameter an arc length within 1e-4
_KNOT_GROWTH = 0.2  # of the distance between knots, per metre: neighbours are within a factor of about 1.2
_SAMPLE_M = 0.05
_FEWEST_SAMPLES = 16  # between two waypoints: fine enough to see each turn below the smallest radius
_PACE_M = 0.7
"""Length of a pace at a common walking speed (Perry and Burnfield, "Gait Analysis", 2nd ed., chapter 20)."""
_HEIGHT_M = 0.1  # distance between the heights that are taken from the ground
_GAUSS = (
    (-0.906179845938664, 0.23692688505618908),
    (-0.5384693101056831, 0.47862867049936647),
    (0.0, 0.5688888888888889),
    (0.5384693101056831, 0.47862867049936647),
    (0.906179845938664, 0.23692688505618908),
)
"""Places between -1 and 1, and weights, of Gauss-Legendre quadrature (Abramowitz and Stegun, table 25.4)."""


class Path:
    """A curve through waypoints that follows the ground: four times continuously differentiable.

    It is a quintic spline whose parameter is its length, height included. A walker's hip smooths the
    ground, so the height is the mean of the ground from one pace behind to one pace ahead.
    The horizontal curve is the natural (if closed: periodic) cubic spline, resampled by arc length as a
    quintic, because the second time derivative of the heading needs three derivatives of the position.

    Raises TrajectoryError if a waypoint is not finite or coincides with the one before it, and if the curve
    turns with a radius below 0.1 m, climbs by more than 60 degrees or is longer than 100 km.

    Parameters
    ----------
    way_points_m : (n, 2) float64, x and y in the world, n >= 2; if the last is the first (within
    1 cm), the path is a loop that closes smoothly
    height_m : ground height
    """

    def __init__(self, way_points_m: F8, height_m: HeightField) -> None:
        _check_way_points(way_points_m)
        closed = bool(norm(way_points_m[-1] - way_points_m[0]) < _APART_M)
        self.closed = closed  # True for a loop, where arc lengths may exceed the length
        origin_m = np.append(way_points_m[0], 0.0)
        points_m = way_points_m - way_points_m[0]
        if closed:
            points_m[-1] = points_m[0]
        # Centripetal parameters keep the curve from looping where waypoints are unevenly spaced
        # (Lee, "Choosing nodes in parametric curve interpolation", CAD 21(6), 1989).
        u = np.concatenate([[0.0], np.cumsum(np.sqrt(norm(np.diff(points_m, axis=0))))])
        cubic = interpolant(u, points_m, ends="periodic" if closed else "natural")
        knots, at_way_points = _knots(cubic, u, way_points_m, closed)
        plan, along_m = _by_length(cubic, knots, closed)
        z_m = _heights(plan, along_m, origin_m, height_m, closed)
        solid = _spline(along_m, np.column_stack([plan(along_m), z_m(along_m)]), closed)
        _check_slope(solid, along_m, origin_m)
        self._curve, knots_m = _by_length(solid, along_m, closed)
        self.xy_m = np.ascontiguousarray((self._curve(knots_m) + origin_m)[:, :2])
        """(m, 2) points of the path, at most 0.25 m apart."""
        self.along_m = knots_m  # (m,) arc length of each point
        self.way_point_rows = at_way_points  # (n,) index of each waypoint among the points
        self._curve.powers[0] += origin_m
        east, north, _ = self._curve(knots_m, 1).T
        self._heading_rad = np.unwrap(atan2(north, east))  # (m,) at the knots, continuous
        self.way_points_at_m = knots_m[at_way_points]  # (n,) arc length of each waypoint
        self.length_m = float(self._curve.breaks[-1])

    def derivatives_at(self, s_m: F8) -> tuple[F8, F8]:
        """Return ground points (n, 3, 3) and headings (n, 3) at arc lengths (n,), with two derivatives.

        The middle axis of the points is the order of the derivative. Headings are continuous, in radians from
        east. Arc lengths beyond an end of an open path give its end.
        """
        lap, s_m = self._on_lap(s_m)
        powers, since_m = self._curve.within(s_m)
        *point_m, third = (polynomial(powers, since_m, order) for order in range(4))
        (x0, y0, _), (x1, y1, _), (x2, y2, _), (x3, y3, _) = powers[1], *point_m[1:], third
        piece = self._curve.piece(s_m)
        heading_rad = np.empty((len(s_m), 3))
        # Relative to the heading at the knot, which is continuous where atan2 is not.
        turn = atan2(x0 * y1 - y0 * x1, x0 * x1 + y0 * y1)
        heading_rad[:, 0] = (
            self._heading_rad[piece] + turn + lap * (self._heading_rad[-1] - self._heading_rad[0])
        )
        run2 = x1 * x1 + y1 * y1
        heading_rad[:, 1] = rate = (x1 * y2 - y1 * x2) / run2
        heading_rad[:, 2] = (x1 * y3 - y1 * x3 - 2.0 * (x1 * x2 + y1 * y2) * rate) / run2
        return np.ascontiguousarray(np.stack(point_m).transpose(2, 0, 1)), heading_rad

    def turn_rad_m(self, s_m: F8) -> F8:
        """Return the change of heading per metre (n,): only the first derivative of `derivatives_at`."""
        _, s_m = self._on_lap(s_m)
        powers, since_m = self._curve.within(s_m)
        (x1, y1), (x2, y2) = (polynomial(powers[:, :2], since_m, order) for order in (1, 2))
        return np.asarray((x1 * y2 - y1 * x2) / (x1 * x1 + y1 * y1))

    def _on_lap(self, s_m: F8) -> tuple[F8, F8]:
        lap = np.floor(s_m / self.length_m) if self.closed else np.zeros(len(s_m))
        return lap, np.clip(s_m - lap * self.length_m, 0.0, self.length_m)


def level_path(way_points_m: F8) -> Path:
    """Return the path through waypoints (n, 2) on level ground; errors as in `Path`."""
    return Path(way_points_m, lambda x_m, _y_m: np.zeros_like(x_m))


def path_over(way_points_m: F8, height_m: HeightField, ground: str) -> Path:
    """Return the path over the ground named `ground`, from the user's store after the first computation.

    Nothing is stored for an empty name.
    """
    name = ground and f"path {ground} {hashlib.sha256(way_points_m.tobytes()).hexdigest()}"
    return recall(name, lambda: Path(way_points_m, height_m))


@array_kernel
def limit_slope(values: F8, step: F8) -> None:
    """Lower values (n,) in place as little as possible, until neighbours differ by at most step[i] >= 0."""
    for i in range(values.size - 1):
        values[i + 1] = min(values[i + 1], values[i] + step[i])
    for i in range(values.size - 2, -1, -1):
        values[i] = min(values[i], values[i + 1] + step[i])


def _check_way_points(way_points_m: F8) -> None:
    if len(way_points_m) < 2:
        raise TrajectoryError("waypoints", f"found {len(way_points_m)}", "at least 2 of them")
    for i, point in enumerate(way_points_m):
        where = f"waypoint {i + 1} of {len(way_points_m)}"
        if not np.isfinite(point).all():
            raise TrajectoryError(where, f"found {tuple(point.tolist())}", "finite coordinates")
        if np.abs(point).max() > _FARTHEST_M:
            raise TrajectoryError(
                where, f"found {tuple(point.tolist())}", f"within {_FARTHEST_M:g} m of the origin"
            )
        if i and norm(point - way_points_m[i - 1]) < _APART_M:
            expected = "at least 1 cm between waypoints"
            at_m = float(point[0]), float(point[1])
            raise TrajectoryError(where, "coincides with the one before it", expected, at_m=at_m)
    length_m = float(norm(np.diff(way_points_m, axis=0)).sum())
    if length_m > _LONGEST_M:
        found = f"found {length_m / 1000:.4g} km from first to last"
        raise TrajectoryError("waypoints", found, f"at most {_LONGEST_M / 1000:g} km")


def _knots(cubic: Spline, u: F8, way_points_m: F8, closed: bool) -> tuple[F8, I8]:
    """Return the parameters of the knots, dense in turns, and the indices of the waypoints among them."""
    chords_m = norm(np.diff(way_points_m, axis=0))
    counts = np.maximum(_FEWEST_SAMPLES, np.ceil(chords_m / _SAMPLE_M)).astype(np.int64)
    at = np.concatenate([[0], np.cumsum(counts)])
    fine = np.interp(np.arange(at[-1] + 1), at, u)
    steps = np.diff(cubic(fine), axis=0)
    lengths_m = norm(steps)
    curvature = _curvature(steps, closed)
    _check_radius(curvature, cubic(fine) + way_points_m[0], np.searchsorted(at, np.arange(len(fine))))
    # Curvature changes fastest where waypoints are near each other, and a spline is least determined at its
    # ends.
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
    # A whole number of knot intervals between waypoints, so that the curve passes through them to the last
    # bit.
    pieces = np.ceil(np.diff(measure[at])).astype(np.int64)
    at_way_points = np.concatenate([[0], np.cumsum(pieces)])
    wanted = np.interp(np.arange(at_way_points[-1] + 1), at_way_points, measure[at])
    return np.interp(wanted, measure, fine), at_way_points


def _curvature(steps: F8, closed: bool) -> F8:
    """Return the curvature (n,) from the angles between n - 1 steps; infinite at steps without length."""
    before, after = (np.roll(steps, 1, axis=0), steps) if closed else (steps[:-1], steps[1:])
    ahead = (before * after).sum(axis=1)
    aside = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    before_m, after_m = norm(before), norm(after)
    turn = np.where(np.minimum(before_m, after_m) > 1e-9, np.abs(atan2(aside, ahead)), np.inf)
    inner = turn / (before_m / 2 + after_m / 2)
    if closed:
        return np.append(inner, inner[0])
    return np.concatenate([inner[:1], inner, inner[-1:]])


def _check_radius(curvature: F8, points_m: F8, number: I8) -> None:
    worst = int(curvature.argmax())
    if curvature[worst] * _SMALLEST_RADIUS_M > 1.0:
        x_m, y_m = points_m[worst]
        where = f"path at ({x_m:.2f}, {y_m:.2f}) m, near waypoint {number[worst] + 1}"
        found = f"turns with a radius of {1.0 / curvature[worst]:.2g} m"
        expected = f"at least {_SMALLEST_RADIUS_M:g} m: more waypoints round the turn"
        raise TrajectoryError(where, found, expected, at_m=(float(x_m), float(y_m)))


def _spline(at: F8, points_m: F8, closed: bool) -> Spline:
    if not closed:
        return interpolant(at, points_m, 5)
    return interpolant(at, np.concatenate([points_m[:-1], points_m[:1]]), 5, "periodic")


def _by_length(curve: Spline, knots: F8, closed: bool) -> tuple[Spline, F8]:
    """Return the curve with its arc length as the parameter: the spline and its knots."""
    half = np.diff(knots) / 2
    mean_speed = np.zeros(len(knots) - 1)
    for place, weight in _GAUSS:
        mean_speed += weight * norm(curve((knots[1:] - half) + half * place, 1))
    along_m = np.concatenate([[0.0], np.cumsum(half * mean_speed)])
    return _spline(along_m, curve(knots), closed), along_m


def _heights(plan: Spline, along_m: F8, origin_m: F8, height_m: HeightField, closed: bool) -> Spline:
    """Return heights along the horizontal curve: means of the ground from one pace behind to one pace ahead.

    The weight falls linearly to zero over a pace, because the two feet carry the hip in turn (assumption).
    Beyond the ends the ground is continued point-symmetrically, so even slopes do not change.
    """
    count = max(8, math.ceil(along_m[-1] / _HEIGHT_M))
    at_m = np.linspace(0.0, along_m[-1], count + 1)
    xy_m = plan(at_m) + origin_m[:2]
    ground_m = height_m(xy_m[:, 0], xy_m[:, 1])
    reach = math.ceil(_PACE_M * count / along_m[-1])
    if closed:
        smooth = _smooth(np.pad(ground_m[:-1], reach - 1, mode="wrap"), reach)
        return interpolant(at_m, np.append(smooth, smooth[0])[:, None], ends="periodic")
    padded = np.pad(ground_m, reach - 1, mode="reflect", reflect_type="odd")
    return interpolant(at_m, _smooth(padded, reach)[:, None])


def _smooth(padded: F8, reach: int) -> F8:
    """Return means (n,) of values (n + 2 reach - 2,) under a triangle of `reach` steps to either side."""
    out = np.zeros(len(padded) - 2 * reach + 2)
    for k in range(1 - reach, reach):
        out += (reach - abs(k)) / (reach * reach) * padded[reach - 1 + k : reach - 1 + k + len(out)]
    return out


def _check_slope(solid: Spline, along_m: F8, origin_m: F8) -> None:
    dx, dy, dz = solid(along_m, 1).T
    slope = np.abs(dz) / hypot(dx, dy)
    worst = int(slope.argmax())
    if slope[worst] > _STEEPEST:
        x_m, y_m, _ = solid(along_m[worst : worst + 1])[0] + origin_m
        where = f"path at ({x_m:.2f}, {y_m:.2f}) m"
        steep_deg = math.degrees(atan2(float(slope[worst]), 1.0))
        found = f"the ground rises or falls by {steep_deg:.0f} degrees"
        expected = f"at most {_STEEPEST_DEG:g} degrees"
        raise TrajectoryError(where, found, expected, at_m=(float(x_m), float(y_m)))
