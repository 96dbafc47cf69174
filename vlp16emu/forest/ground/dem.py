"""Ground from a digital elevation model: a smooth surface through the heights of a grid.

Between the centres of the cells run monotone cubics along x, and through their heights along y (Steffen, "A simple method for
monotonic interpolation in one dimension", Astronomy and Astrophysics 239, 1990): through every height of the grid, and never
above or below the four around. Where the ground bends little they are the bicubic convolution of Keys (1981) with a = -1/2.
"""

import logging
import math
from pathlib import Path

import numba
import numpy as np

from vlp16emu.errors import GeometryError
from vlp16emu.forest.ground.grid import read_grid
from vlp16emu.forest.ground.settings import Dem
from vlp16emu.types import Array
from vlp16emu.world.polyline import distance_m

_log = logging.getLogger(__name__)


_SUPPORT_CELLS = 2 * np.sqrt(2.0)  # A height takes part in the surface up to two cells away in either direction


class DemHeights:
    """Ground height from a file, in the scene's own coordinates.

    Outside the grid and where the file has no height, the nearest height goes on. Errors are those of `read_grid`.

    Parameters
    ----------
    origin_m : easting, northing and height that become (0, 0, 0) in the scene
    """

    def __init__(self, section: Dem, *, origin_m: tuple[float, float, float]) -> None:
        self._grid = read_grid(Path(section.file), cell_m=section.cell_m, corner_m=section.corner_m)
        self._origin_m = origin_m
        rows, columns = self._grid.heights_m.shape
        east, north, up = origin_m
        self._west_m = self._grid.west_m - east
        self._south_m = self._grid.north_m - (rows - 1) * self._grid.cell_m - north
        self._east_m = self._west_m + (columns - 1) * self._grid.cell_m
        self._north_m = self._grid.north_m - north
        self._nodes_m = _with_border(_without_gaps(self._grid.heights_m) - up)

    def height_m(self, x_m: Array, y_m: Array) -> Array:
        """Ground height at points of any common shape; a point's height depends on that point alone."""
        x, y = (np.ascontiguousarray(a, dtype=np.float64) for a in np.broadcast_arrays(x_m, y_m))
        height = np.empty(x.shape)
        flat = height.reshape(-1), x.reshape(-1), y.reshape(-1)
        _heights(*flat, self._nodes_m, self._west_m, self._south_m, self._grid.cell_m)
        return height

    def check(self, path_xy_m: Array, reach_m: float) -> None:
        """Raise GeometryError where a path (n, 2) leaves the grid, or a cell within reach has no height; warn of edges in sight."""
        self._check_edges(path_xy_m, reach_m)
        self._check_gaps(path_xy_m, reach_m)

    def _check_edges(self, path_xy_m: Array, reach_m: float) -> None:
        """Refuse a path that leaves the grid; beyond its edges the ground goes on level."""
        rows, columns = self._grid.heights_m.shape
        x, y = path_xy_m.T
        sides = (
            ("column 1", "x", self._west_m, x - self._west_m),
            (f"column {columns}", "x", self._east_m, self._east_m - x),
            ("row 1", "y", self._north_m, self._north_m - y),
            (f"row {rows}", "y", self._south_m, y - self._south_m),
        )
        in_sight = [side for side in sides if side[3].min() < reach_m]
        ends = ", ".join(f"{line} at {axis} = {edge_m:.1f} m" for line, axis, edge_m, _ in in_sight)
        for line, axis, edge_m, gap_m in in_sight:
            if gap_m.min() < 0:
                px, py = path_xy_m[gap_m.argmin()]
                found = f"ends in {line} at {axis} = {edge_m:.1f} m, {-gap_m.min():.1f} m short of the path at ({px:.1f}, {py:.1f}) m"
                place_m = float(px), float(py)
                raise GeometryError(str(self._grid.path), found, "ground under the whole path", at_m=place_m)
        if in_sight:
            _log.warning(
                "%s: ends in %s, %.1f m from the path at the nearest, and goes on level from there; the sensor sees %g m",
                *(self._grid.path, ends, min(side[3].min() for side in in_sight), reach_m),
            )

    def _check_gaps(self, path_xy_m: Array, reach_m: float) -> None:
        row, column = np.nonzero(np.isnan(self._grid.heights_m))
        cell_m = self._grid.cell_m
        places = np.column_stack([self._west_m + column * cell_m, self._north_m - row * cell_m])
        gap_m = distance_m(places, path_xy_m)
        if len(gap_m) and gap_m.min() < reach_m + _SUPPORT_CELLS * cell_m:
            i = int(gap_m.argmin())
            x, y = places[i]
            raise GeometryError(
                f"{self._grid.path}: row {row[i] + 1}, column {column[i] + 1}",
                f"no height at ({x:.1f}, {y:.1f}) m{self._on_the_map(x, y)}, {gap_m[i]:.1f} m from the path",
                f"heights {reach_m:g} m around the path and two cells more",
                at_m=(float(x), float(y)),
            )

    def _on_the_map(self, x_m: float, y_m: float) -> str:
        east, north, _ = self._origin_m
        return f" (E {x_m + east:.1f}, N {y_m + north:.1f})" if (east, north) != (0.0, 0.0) else ""


def _without_gaps(heights_m: Array) -> Array:
    """Continue the nearest height over cells that have none."""
    gaps = np.isnan(heights_m)
    if not gaps.any():
        return heights_m
    from scipy import ndimage

    row, column = ndimage.distance_transform_edt(gaps, return_distances=False, return_indices=True)
    filled: Array = heights_m[row, column]
    return filled


def _with_border(heights_m: Array) -> Array:
    return np.pad(heights_m[::-1], 1, mode="reflect", reflect_type="odd")


@numba.njit(cache=True, nogil=True, forceinline=True, _nrt=False)
def _slope(before: float, after: float) -> float:
    """Slope at a height between two rises: their mean, at most twice the lesser; level on tops and in hollows."""
    if before * after <= 0.0:
        return 0.0
    return math.copysign(min(abs(before + after) / 2, 2 * min(abs(before), abs(after))), before)


@numba.njit(cache=True, nogil=True, forceinline=True, _nrt=False)
def _between(a: float, b: float, c: float, d: float, t: float) -> float:
    """Height at share `t` of the way from b to c, of four at equal distances."""
    rise = c - b
    start, end = _slope(b - a, rise), _slope(rise, d - c)
    return b + t * (start + t * (3 * rise - 2 * start - end + t * (start + end - 2 * rise)))


@numba.njit(cache=True, nogil=True)
def _heights(out: Array, x: Array, y: Array, nodes: Array, west_m: float, south_m: float, cell_m: float) -> None:
    """Fill (n,) heights; `nodes` has a border of one cell."""
    rows, columns = nodes.shape
    z = np.empty(4)
    for i in range(out.shape[0]):
        u = min(max((x[i] - west_m) / cell_m, 0.0), columns - 3.0)
        v = min(max((y[i] - south_m) / cell_m, 0.0), rows - 3.0)
        column, row = min(int(u), columns - 4), min(int(v), rows - 4)
        for j in range(4):
            a, b, c, d = nodes[row + j, column : column + 4]
            z[j] = _between(a, b, c, d, u - column)
        out[i] = _between(z[0], z[1], z[2], z[3], v - row)
