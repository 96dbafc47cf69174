"""Ways that cover a plot."""

import math

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import TrajectoryError

__all__ = ["lawn_mower"]

_POINTS_PER_QUARTER = 6
"""Way points in a quarter turn: the spline through them keeps within 0.2 % of the radius."""


def lawn_mower(
    *,
    corner_m: tuple[float, float],
    length_m: float,
    width_m: float,
    azimuth_deg: float,
    line_spacing_m: float,
    turn_radius_m: float,
) -> NDArray[np.float64]:
    """Way points (n, 2) along parallel lines to and fro over a rectangle, joined by rounded turns inside it.

    The lines are as many as fit, in the middle of the width.

    Parameters
    ----------
    corner_m : x and y of the corner at which both edges begin
    length_m : of the edge along the lines
    width_m : of the edge across them, which lies to the left of the first
    azimuth_deg : direction of the lines, counter-clockwise from east
    turn_radius_m : of both quarter turns between one line and the next

    Raises
    ------
    TrajectoryError
        where the turns do not fit between two lines or along the plot
    """
    if not 0.0 < 2 * turn_radius_m <= min(line_spacing_m, length_m):
        raise TrajectoryError(
            "turn radius",
            f"found {turn_radius_m:g} m",
            f"above 0 and at most half of {min(line_spacing_m, length_m):g} m, line spacing or length",
        )
    lines = 1 + math.floor(width_m / line_spacing_m)
    offset_m = (width_m - (lines - 1) * line_spacing_m) / 2
    spacing_m = turn_radius_m * math.pi / 2 / _POINTS_PER_QUARTER
    corners = [(0.0, offset_m)]
    for line in range(lines):
        y_m = offset_m + line * line_spacing_m
        far_m = 0.0 if line % 2 else length_m
        corners.append((far_m, y_m))
        if line < lines - 1:
            corners.append((far_m, y_m + line_spacing_m))
    along, across = _rounded(np.array(corners), turn_radius_m, spacing_m).T
    cosine, sine = math.cos(math.radians(azimuth_deg)), math.sin(math.radians(azimuth_deg))
    return np.column_stack([cosine * along - sine * across, sine * along + cosine * across]) + corner_m


def _rounded(corners_m: NDArray[np.float64], radius_m: float, spacing_m: float) -> NDArray[np.float64]:
    """Points (n, 2) at about equal distances along right-angled corners (c, 2) that are cut by quarter circles."""
    ahead = np.diff(corners_m, axis=0)
    ahead /= np.hypot(*ahead.T)[:, None]
    pieces, at = [], corners_m[0]
    for corner, before, after in zip(corners_m[1:-1], ahead[:-1], ahead[1:], strict=True):
        pieces.append(_straight(at, corner - radius_m * before, spacing_m))
        angle = np.arange(_POINTS_PER_QUARTER)[:, None] / _POINTS_PER_QUARTER * (math.pi / 2)
        centre = corner + radius_m * (after - before)
        pieces.append(centre - radius_m * np.cos(angle) * after + radius_m * np.sin(angle) * before)
        at = corner + radius_m * after
    return np.concatenate([*pieces, _straight(at, corners_m[-1], spacing_m), corners_m[-1:]])


def _straight(
    start_m: NDArray[np.float64], end_m: NDArray[np.float64], spacing_m: float
) -> NDArray[np.float64]:
    """Points (n, 2) from a start until before an end; none where both are one."""
    count = math.ceil(math.dist(start_m, end_m) / spacing_m - 1e-9)
    return start_m + np.arange(count)[:, None] / max(count, 1) * (end_m - start_m)
