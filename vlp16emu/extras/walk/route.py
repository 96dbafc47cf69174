"""A path with its timing: the place of a person on it at any time."""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from vlp16emu.errors import TrajectoryError
from vlp16emu.extras.splines import Spline, powers
from vlp16emu.extras.walk.gait import AXES
from vlp16emu.extras.walk.path import Path, limit_slope
from vlp16emu.extras.walk.settings import Walk
from vlp16emu.types import F8

Stops = Sequence[tuple[float, float]]
_PATH_AXES = [0, 1, 2, 5]  # x, y, z and yaw among x, y, z, roll, pitch, yaw: a path has no roll or pitch
_MAX_SPEED_M_S = 10.0  # a sprint
_KNOT_S = 0.1  # between knots: a start or a stop takes half a second, a pace (assumption)
_DEGREE = 5
_REACH = 3  # knots to either side that a quintic B-spline averages
_CELL_M = 0.02  # length of a cell, in which acceleration is constant before smoothing
_LOOKS = 4  # places of a cell at which the turn of the path is looked up
_BLOCK = 16_384  # places that are looked up together
_LONGEST_S = 14 * 86_400  # the latest start of a run and the longest run together
_HALVINGS = 24  # of the range of cruise speeds, if the run time is given


class Route:
    """A path with the times at which a person is on it, `laps` times round if it is closed.

    Arc length over time is a quintic B-spline with equal steps, four times continuously differentiable. The
    person walks as fast as the limits of cruise speed, turn rate and acceleration allow together. The arc
    lengths at equal times are the control points of the spline, so speed and acceleration are weighted means
    of the values before smoothing: they keep the same limits, and the person never walks backwards. At both
    ends and at stops the person is at rest.

    Raises TrajectoryError if an open path is to be walked more than once, a stop is not on the path, the run
    time is too short, or the walk would take more than two weeks.

    Parameters
    ----------
    path : over the ground
    walk : laps, limits, cruise speed or run time, and the stops along the path
    pause_s : (n,) how long the person stops at each waypoint of the path
    """

    def __init__(self, path: Path, walk: Walk, pause_s: F8) -> None:
        if walk.laps > 1 and not path.closed:
            found = f"found {walk.laps} on an open path"
            raise TrajectoryError("laps", found, "1, back_and_forth = true, or a last waypoint on the first")
        self.path = path
        self.length_m = walk.laps * path.length_m  # length of all laps
        stops = list(zip(path.way_points_at_m.tolist(), pause_s.tolist(), strict=True))
        stops = [stop for stop in stops if stop[1] > 0.0]
        stops += [(stop.at_m, stop.pause_s) for stop in walk.stops if stop.at_m is not None]
        # The end of one lap and the start of the next are equal to the last bit.
        laps = [
            ((lap + at_m / path.length_m) * path.length_m, stop_s)
            for lap in range(walk.laps)
            for at_m, stop_s in stops
        ]
        bounds_m, pauses_s = _rests(laps, self.length_m)
        legs = [_Leg(start_m, end_m, path.turn_rad_m, walk) for start_m, end_m in pairwise(bounds_m.tolist())]
        self._step_s = _KNOT_S
        run_time_s = walk.run_time_s
        self.speed_m_s = walk.speed_m_s  # cruise speed
        if run_time_s is not None:
            self.speed_m_s = _speed_for(run_time_s, legs, float(pauses_s.sum()), self.length_m)
        at_s, control_m = _control_points(legs, pauses_s, self.speed_m_s)
        self._moves_s = float(at_s + _PADDING_S)
        if run_time_s is not None:
            # The search ends slightly below the given time; stretching to it breaks no limit.
            self._step_s *= run_time_s / self._moves_s
            self._moves_s = run_time_s
        self._stand_s = walk.stand_s
        self.run_time_s = walk.stand_s + self._moves_s  # time from the start to the last motion
        knots = np.arange(len(control_m) + _DEGREE + 1.0) - _DEGREE  # in steps
        at = knots[_DEGREE:-_DEGREE]
        self._along_m = Spline(at, powers(at, knots, control_m[:, None], _DEGREE))

    def at(self, elapsed_s: F8) -> tuple[F8, F8]:
        """Return the foot point, without gait, at times (n,) since the start; it rests outside the run time.

        Returns
        -------
        (n, 6, 3) value, exact first and second time derivative of x, y, z, roll, pitch and yaw in the world,
        where roll and pitch are 0 and the yaw is continuous, so it may pass pi; and (n,) speed along the
        path, never negative
        """
        steps = np.clip(elapsed_s - self._stand_s, 0.0, self._moves_s) / self._step_s
        along_m, rate, second = (self._along_m(steps, order)[:, 0] for order in range(3))
        speed_m_s = np.maximum(rate, 0.0) / self._step_s  # rounding at rest must not give a negative speed
        acceleration_m_s2 = second / (self._step_s * self._step_s)
        point_m, heading_rad = self.path.derivatives_at(along_m)
        curve = np.concatenate([point_m, heading_rad[..., None]], axis=2)
        speed = speed_m_s[:, None]
        nodes = np.zeros((len(elapsed_s), AXES, 3))
        nodes[:, _PATH_AXES, 0] = curve[:, 0]
        nodes[:, _PATH_AXES, 1] = curve[:, 1] * speed
        nodes[:, _PATH_AXES, 2] = curve[:, 2] * (speed * speed) + curve[:, 1] * acceleration_m_s2[:, None]
        return nodes, speed_m_s


_PADDING_S = (2 * _REACH - 1) * _KNOT_S
"""Time that smoothing adds to the run: the first control point that moves comes two steps after the start."""


class _Leg:
    """Part of the path from one rest to the next, in equal cells."""

    def __init__(self, start_m: float, end_m: float, turn_rad_m: Callable[[F8], F8], walk: Walk) -> None:
        cells = max(2, math.ceil((end_m - start_m) / _CELL_M))
        looked_m = np.linspace(start_m, end_m, 1 + _LOOKS * cells)
        # A path of 100 km has 20 million places.
        blocks = np.array_split(looked_m, 1 + len(looked_m) // _BLOCK)
        turn = -_running_minimum(-np.abs(np.concatenate([*map(turn_rad_m, blocks)])), _LOOKS // 2)[::_LOOKS]
        yaw_rate_rad_s = math.radians(walk.yaw_rate_deg_s)
        self._turn_limit_m_s = yaw_rate_rad_s / np.maximum(turn, yaw_rate_rad_s / _MAX_SPEED_M_S)
        self._cell_m = (end_m - start_m) / cells
        self.at_m = looked_m[::_LOOKS]
        self._gain = np.full(cells, walk.acceleration_m_s2 * self._cell_m)

    def speeds_m_s(self, cruise_m_s: float) -> F8:
        """Return the speeds (n,) at the cells' edges before smoothing.

        Smoothing mixes speeds over `2 * _REACH` time steps, so each limit holds as far as the person gets in
        them.
        """
        reach = min(len(self.at_m), math.ceil(2 * _REACH * _KNOT_S * cruise_m_s / self._cell_m))
        limit = _running_minimum(self._turn_limit_m_s, reach)
        # v^2 / 2 grows by acceleration times distance.
        fastest_m_s = np.minimum(limit, cruise_m_s)
        energy = fastest_m_s * fastest_m_s / 2
        energy[0] = energy[-1] = 0.0
        limit_slope(energy, self._gain)
        return np.sqrt(2 * energy)

    def times_s(self, speeds_m_s: F8) -> F8:
        """Return times (n,) at the cells' edges since the leg's start; acceleration is constant in a cell."""
        with np.errstate(divide="ignore", over="ignore"):  # at zero speed the time is infinite
            return np.concatenate([[0.0], np.cumsum(2 * self._cell_m / (speeds_m_s[1:] + speeds_m_s[:-1]))])


def _running_minimum(values: F8, reach: int) -> F8:
    """Return the least value (n,) within `reach` neighbours to either side, in windows that double in width.

    `scipy.ndimage.minimum_filter1d` does the same, but its import takes 40 ms of each start.
    """
    least = np.pad(values, reach, mode="edge")
    width = 1
    while 2 * width <= 2 * reach + 1:
        least = np.minimum(least[:-width], least[width:])
        width *= 2
    return np.minimum(least[: len(values)], least[-len(values) :])


def _rests(stops: Stops, length_m: float) -> tuple[F8, F8]:
    """Return arc lengths (r,) of rests, both ends included, and their durations before smoothing."""
    for stop_m, _ in stops:
        if not 0.0 <= stop_m <= length_m:
            found = f"found {stop_m:g} m along the path"
            raise TrajectoryError("stop", found, f"from 0 to its length, {length_m:.2f} m")
    at_m = np.unique([0.0, *(stop_m for stop_m, _ in stops), length_m])
    pauses_s = np.zeros(len(at_m))
    for stop_m, pause_s in stops:
        pauses_s[np.searchsorted(at_m, stop_m)] += pause_s
    # Smoothing shortens a rest between two legs from both sides.
    pauses_s[1:-1] += 2 * _REACH * _KNOT_S
    return at_m, pauses_s


def _speed_for(run_time_s: float, legs: Sequence[_Leg], pauses_s: float, length_m: float) -> float:
    """Find the cruise speed with which the run takes a given time, or slightly less."""

    def duration_s(speed_m_s: float) -> float:
        """Return the duration of the walk at a speed."""
        return pauses_s + _PADDING_S + sum(leg.times_s(leg.speeds_m_s(speed_m_s))[-1] for leg in legs)

    high = _MAX_SPEED_M_S
    fastest_s = duration_s(_MAX_SPEED_M_S)
    if fastest_s > run_time_s:
        expected = f"at least {fastest_s:.1f} s, with its stops, turns and starts"
        raise TrajectoryError("run time", f"found {run_time_s:g} s for {length_m:.1f} m", expected)
    low = min(high, length_m / run_time_s)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if duration_s(middle) > run_time_s else (low, middle)
    return high


def _control_points(legs: Sequence[_Leg], pauses_s: F8, cruise_m_s: float) -> tuple[float, F8]:
    """Return the duration before smoothing and the control points (c,): arc lengths at equal times."""
    begin_s = pauses_s[0]
    begins = []
    runs = []
    for leg, pause_s in zip(legs, pauses_s[1:], strict=True):
        speeds = leg.speeds_m_s(cruise_m_s)
        times = leg.times_s(speeds)
        begins.append(begin_s)
        runs.append((leg.at_m, speeds, times))
        begin_s += times[-1] + pause_s
    duration_s = begin_s
    if not duration_s <= _LONGEST_S:
        raise TrajectoryError(
            "run time", f"found {duration_s:g} s", f"at most {_LONGEST_S} s, with its stops"
        )
    # Control point j is at (j - 2) steps, and the person sets off two steps after the start.
    count = math.ceil((duration_s + _PADDING_S) / _KNOT_S) + 6
    at_s = (np.arange(count) - 4) * _KNOT_S
    control_m = np.zeros(count)
    for begin, (at_m, speeds, times) in zip(begins, runs, strict=True):
        first = int(np.searchsorted(at_s, begin))
        since = np.minimum(at_s[first:] - begin, times[-1])
        cell = np.minimum(np.searchsorted(times, since, side="right") - 1, len(times) - 2)
        t = since - times[cell]
        dt = times[cell + 1] - times[cell]
        mean = speeds[cell] + (speeds[cell + 1] - speeds[cell]) * t / dt / 2
        control_m[first:] = np.where(since < times[-1], at_m[cell] + mean * t, at_m[-1])
    return duration_s, control_m
