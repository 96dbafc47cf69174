"""Ground from a digital elevation model: ESRI ASCII grids, numpy arrays and GeoTIFF (with rasterio).

Monotone cubics interpolate between cell
centres along x, and then along y (Steffen, "A simple method for monotonic interpolation in one dimension",
Astronomy and Astrophysics 239, 1990): the surface passes through every height and stays within the four
around. Where the ground bends little it equals the bicubic convolution of Keys (1981) with a = -1/2.
"""

import logging
import math
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from io import TextIOWrapper
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import GeometryError
from vlp16emu.foliage.polyline import distance_m
from vlp16emu.forest.settings import Dem
from vlp16emu.inputs import LARGEST_BYTES, open_input, parsing, readable
from vlp16emu.kernels.compiler import array_kernel, inline_kernel
from vlp16emu.libraries import of_extra
from vlp16emu.types import F8, HeightField

_MOST_CELLS = 50_000_000  # 7 km by 7 km at 1 m: a gigabyte while it is read; limits compressed files too
_LOWEST_M = -500.0
_HIGHEST_M = 9000.0
"""Limits of heights: the shore of the Dead Sea is at -440 m, Mount Everest at 8849 m; no-data values lie
beyond."""
_METRES = (None, "", "m", "metre", "meter")
_SIZE = ("ncols",), ("nrows",)
_CELL = ("cellsize", "dx"), ("cellsize", "dy")
_CORNER = ("xllcorner", "xllcenter"), ("yllcorner", "yllcenter")
_NODATA = "nodata_value"
_NEEDED = (*_SIZE, *_CELL, *_CORNER)
_KEYS = {_NODATA, *(key for keys in _NEEDED for key in keys)}
_ABOVE_0 = frozenset(("cellsize", "dx", "dy"))
"""Keys of the header, in any order and case (Esri, ArcGIS documentation, "Esri ASCII raster format"); `dx`
and `dy` are those of cells that are not square (GDAL, driver AAIGrid)."""
_PIECE = 1 << 20  # characters of a line that are parsed at once
_AROUND = np.ones((3, 3), np.bool_)  # cells that touch also by a corner


@dataclass(frozen=True, slots=True)
class Grid:
    """Heights over equal cells, as in the file, without outer rows and columns that have no height."""

    path: Path
    heights_m: F8  # (rows, columns), northernmost row first, NaN where the file has no height.
    west_m: float  # easting of the centres of the first column
    north_m: float  # northing of the centres of the first row
    cell_m: tuple[float, float]  # size of a cell from west to east, and from south to north
    first: tuple[int, int] = (1, 1)  # number of the first row and column in the file, from 1


def read_grid(path: Path, *, cell_m: float | None, corner_m: tuple[float, float] | None) -> Grid:
    """Read a grid in the format of its suffix.

    Cells with a non-finite value or the file's no-data value have no height. The edge of a cell, and easting
    and northing of the outer corner of the south-western cell, are required for .npy, which does not hold
    them, and None for the others. Raises GeometryError if the file is not such a grid, and MissingExtraError
    for a GeoTIFF without rasterio.
    """
    kind = path.suffix.lower()
    if kind not in {".asc", ".npy", ".tif", ".tiff"}:
        raise GeometryError(str(path), f"found the ending {kind!r}", ".asc, .npy, .tif or .tiff")
    if kind == ".npy":
        if cell_m is None or corner_m is None:
            raise GeometryError(str(path), "an array alone does not say where it lies", "cell_m and corner_m")
        return _from_corner(path, _read_npy(path), corner_m, (cell_m, cell_m))
    if cell_m is not None or corner_m is not None:
        raise GeometryError(str(path), "found cell_m or corner_m", "neither: the file itself says both")
    return _read_ascii(path) if kind == ".asc" else _read_geotiff(path)


def write_ascii(file: BinaryIO, height_m: HeightField, low_m: F8, high_m: F8, cell_m: float) -> None:
    """Write ground as an ESRI ASCII grid with millimetre resolution.

    Each height is taken at the centre of its cell. The grid covers the rectangle from `low_m` to `high_m`
    (2,), with edges at whole multiples of a cell.
    """
    first = np.floor(low_m / cell_m)
    end = np.ceil(high_m / cell_m)
    columns, rows = (end - first).astype(np.int64).tolist()
    west_m, south_m = (first * cell_m).tolist()
    size = f"ncols {columns}\nnrows {rows}\n"
    corner = f"xllcorner {west_m:.10g}\nyllcorner {south_m:.10g}\n"
    file.write(f"{size}{corner}cellsize {cell_m:g}\n".encode())
    x_m = (first[0] + 0.5 + np.arange(columns)) * cell_m
    for row in reversed(range(rows)):
        heights_m = height_m(x_m, np.full(columns, (first[1] + 0.5 + row) * cell_m))
        np.savetxt(file, heights_m[None], fmt="%.3f")


def _from_corner(
    path: Path, heights_m: F8, corner_m: tuple[float, float], cell_m: tuple[float, float]
) -> Grid:
    west_m, south_m = corner_m
    width_m, height_m = cell_m
    return _grid(path, heights_m, west_m + width_m / 2, south_m + (len(heights_m) - 0.5) * height_m, cell_m)


def _grid(path: Path, heights_m: F8, west_m: float, north_m: float, cell_m: tuple[float, float]) -> Grid:
    heights_m = np.where(np.isfinite(heights_m), heights_m, np.nan)
    is_height = ~np.isnan(heights_m)
    if not is_height.any():
        raise GeometryError(str(path), "no cell has a height", "heights")
    top, bottom = np.flatnonzero(is_height.any(axis=1))[[0, -1]].tolist()
    left, right = np.flatnonzero(is_height.any(axis=0))[[0, -1]].tolist()
    width_m, height_m = cell_m
    grid = Grid(
        path,
        heights_m[top : bottom + 1, left : right + 1],
        west_m + left * width_m,
        north_m - top * height_m,
        cell_m,
        (top + 1, left + 1),
    )
    rows, columns = grid.heights_m.shape
    if min(rows, columns) < 2:
        raise GeometryError(str(path), f"found {rows} rows of {columns}", "at least 2 rows of 2")
    off = np.argwhere((grid.heights_m < _LOWEST_M) | (grid.heights_m > _HIGHEST_M))
    if len(off):
        row, column = off[0].tolist()
        found = f"found {grid.heights_m[row, column]:g}" + f" and {len(off) - 1} more such" * (len(off) > 1)
        span = f"heights from {_LOWEST_M:g} to {_HIGHEST_M:g} m"
        expected = f"{span}, NaN or the file's own number where there is none"
        where = f"{path}: row {top + 1 + row}, column {left + 1 + column}"
        raise GeometryError(where, found, expected)
    return grid


def _read_npy(path: Path) -> F8:
    expected = "a numpy array of numbers"
    opened = open_input(path, expected, GeometryError, most_bytes=LARGEST_BYTES)
    with opened as file, parsing(path, expected, GeometryError):
        heights = np.lib.format.read_array(file, allow_pickle=False)
    if heights.ndim != 2 or heights.dtype.kind not in "iuf" or heights.size > _MOST_CELLS:
        expected = f"numbers in rows and columns, {_MOST_CELLS} at most"
        raise GeometryError(str(path), f"found {heights.shape} {heights.dtype}", expected)
    return heights.astype(np.float64)


Line = tuple[int, str]  # number in the file, from 1, and text without outer blanks


def _read_ascii(path: Path) -> Grid:
    expected = "an ESRI ASCII grid"
    opened = open_input(path, expected, GeometryError, most_bytes=LARGEST_BYTES)
    with opened as content, parsing(path, expected, GeometryError):
        file = TextIOWrapper(content, encoding="utf-8-sig")
        lines = ((number, text.strip()) for number, text in enumerate(file, start=1) if text.strip())
        header, first = _ascii_header(path, lines)
        columns, rows = (_value(header, keys) for keys in _SIZE)
        if not (columns.is_integer() and rows.is_integer() and 0 < columns * rows <= _MOST_CELLS):
            expected = f"whole numbers, and {_MOST_CELLS} cells at most"
            raise GeometryError(str(path), f"found ncols = {columns:g}, nrows = {rows:g}", expected)
        heights_m = _ascii_heights(path, chain([first], lines), int(rows), int(columns))
    heights_m[heights_m == header.get(_NODATA)] = np.nan
    width_m, height_m = (_value(header, keys) for keys in _CELL)
    west_m, south_m = (
        header[edge] if edge in header else header[centre] - size_m / 2
        for (edge, centre), size_m in zip(_CORNER, (width_m, height_m), strict=True)
    )
    return _from_corner(path, heights_m, (west_m, south_m), (width_m, height_m))


def _value(header: Mapping[str, float], keys: Sequence[str]) -> float:
    return next(header[key] for key in keys if key in header)


def _ascii_header(path: Path, lines: Iterator[Line]) -> tuple[dict[str, float], Line]:
    """Return the values of the header, and the first line of heights."""
    header = dict[str, float]()
    number = 0
    text = ""
    for number, text in lines:
        key, *values = text.lower().split()
        if key not in _KEYS or key in header:
            break
        try:
            (value,) = map(float, values)
        except ValueError:
            value = np.nan
        if not (np.isfinite(value) or key == _NODATA) or (key in _ABOVE_0 and value <= 0):
            found = f"found {' '.join([key, *values])!r}"
            expected = f"{key} and a number{' above 0' * (key in _ABOVE_0)}"
            raise GeometryError(f"{path}, line {number}", found, expected)
        header[key] = value
    for keys in _NEEDED:
        if not any(key in header for key in keys):
            found = f"found {text!r}" if header else "no header"  # a file of another kind is not quoted
            raise GeometryError(f"{path}, line {number}", found, f"{' or '.join(keys)} and a number")
    return header, (number, text)


def _ascii_heights(path: Path, lines: Iterable[Line], rows: int, columns: int) -> F8:
    """Return the heights (rows, columns) of the lines.

    The number of columns alone says where a row ends (Esri, ArcGIS documentation, "Esri ASCII raster
    format"). GDAL would read words as 0.
    """
    heights_m = np.empty(rows * columns)
    count = 0
    odd = ""  # first line that is not a row
    number = 0
    for number, text in lines:
        in_line = 0
        for values in _numbers(f"{path}, line {number}", text, columns):
            in_line += len(values)
            heights_m[count : count + len(values)] = values[: len(heights_m) - count]
            count += len(values)
            if count > len(heights_m):
                break
        if in_line != columns and not odd:
            odd = f"; line {number} has {in_line}"
        if count > len(heights_m):
            break
    if count != len(heights_m):
        found = f"found {'more than ' * (count > len(heights_m))}{min(count, len(heights_m))} heights"
        expected = f"nrows = {rows} times ncols = {columns}{odd}"
        raise GeometryError(f"{path}, line {number}", found, expected)
    return heights_m.reshape(rows, columns)


def _numbers(where: str, text: str, columns: int) -> Iterator[F8]:
    """Yield the numbers of a line piece by piece: a file may be a single line."""
    text = text.replace("\t", " ")
    at = 0
    while at < len(text):
        end = text.find(" ", at + _PIECE)
        piece = text[at : end if end >= 0 else None]
        at += len(piece)
        try:
            yield np.array(piece.replace("_", "?").split(), np.float64)  # numpy would allow underscores
        except ValueError:
            raise GeometryError(where, f"found {text!r}", f"{columns} heights") from None


def _read_geotiff(path: Path) -> Grid:
    with of_extra("dem", f"reading {path.name}"):
        import rasterio
        from rasterio.errors import CRSError, NotGeoreferencedWarning, RasterioError
    with (
        readable(path, "a GeoTIFF of heights", GeometryError, most_bytes=LARGEST_BYTES),
        # Sidecar files are ignored: results are cached by the content of this file alone.
        rasterio.Env(GDAL_DISABLE_READDIR_ON_OPEN="EMPTY_DIR"),
        warnings.catch_warnings(action="ignore", category=NotGeoreferencedWarning),
    ):
        try:
            with rasterio.open(path, driver="GTiff") as file:
                _check_map(path, file)
                heights_m = file.read(1, masked=True, out_dtype="float64").filled(np.nan)
                heights_m = heights_m * file.scales[0] + file.offsets[0]
        except (RasterioError, CRSError) as error:
            reason = str(error.__cause__ or error).rstrip(".")
            raise GeometryError(str(path), f"cannot be read: {reason}", "a GeoTIFF of heights") from None
    width_m, _, west_m, _, minus_m, north_m = file.transform[:6]
    return _grid(path, heights_m, west_m + width_m / 2, north_m + minus_m / 2, (width_m, -minus_m))


def _check_map(path: Path, file: Any) -> None:
    width_m, skew, west_m, turn, minus_m, north_m = file.transform[:6]
    unit, factor = file.crs.units_factor if file.crs else ("metre", 1.0)
    unit = "degrees" if file.crs and file.crs.is_geographic else unit
    size = f"{file.height} rows of {file.width}"
    kind = file.dtypes[0]
    is_upright = (
        min(width_m, -minus_m) > 0
        and skew == turn == 0
        and np.isfinite([west_m, north_m, width_m, minus_m]).all()
    )
    cells = f"cells of {width_m:g} x {-minus_m:g}"
    cells += ", turned" if skew or turn else f" from ({west_m:g}, {north_m:g})"
    for is_right, found, expected in (
        (
            file.count == 1 and np.dtype(kind).kind in "iuf",
            f"{file.count} bands of {kind}",
            "one height to a cell",
        ),
        (file.height * file.width <= _MOST_CELLS, size, f"at most {_MOST_CELLS} cells"),
        (not file.transform.is_identity, "no place on a map", "a grid that says where it lies"),
        (factor == 1.0, f"a map in {unit}", "one in metres"),
        (file.units[0] in _METRES, f"heights in {file.units[0]}", "metres"),
        (is_upright, cells, "cells that run to the south and east from a finite place"),
    ):
        if not is_right:
            raise GeometryError(str(path), f"found {found}", expected)


_log = logging.getLogger(__name__)
_ROUNDING = 1e-9  # of a distance that is a whole number of cells
_SUPPORT_CELLS = 2 * np.sqrt(2.0)  # a height affects the surface up to two cells away in either direction


class DemHeights:
    """Ground height from a file; beyond the grid the nearest height continues.

    Raises the errors of `read_grid`.

    Easting, northing and height of the origin become (0, 0, 0) in the scene.
    """

    def __init__(self, section: Dem, *, origin_m: tuple[float, float, float]) -> None:
        self._grid = read_grid(Path(section.file), cell_m=section.cell_m, corner_m=section.corner_m)
        self._origin_m = origin_m
        rows, columns = self._grid.heights_m.shape
        east, north, up = origin_m
        self._width_m, self._height_m = self._grid.cell_m
        self._west_m = self._grid.west_m - east
        self._south_m = self._grid.north_m - (rows - 1) * self._height_m - north
        self._east_m = self._west_m + (columns - 1) * self._width_m
        self._north_m = self._grid.north_m - north
        self._support_m = _SUPPORT_CELLS * max(self._grid.cell_m)
        heights_m = self._grid.heights_m
        gaps = np.isnan(heights_m)
        self._hole_m = self._rim_m = np.zeros((0, 2))
        if gaps.any():
            from scipy import ndimage

            is_rim = _rim_of(gaps)
            self._hole_m = self._places_m(gaps & ~is_rim)
            self._rim_m = self._places_m(is_rim & ndimage.binary_dilation(~gaps, _AROUND))
            heights_m = heights_m[
                *ndimage.distance_transform_edt(gaps, return_distances=False, return_indices=True)
            ]
        level_m = heights_m[::-1] - up
        self._nodes_m = np.pad(level_m, 1, mode="reflect", reflect_type="odd")

    def _places_m(self, cells: NDArray[np.bool_]) -> F8:
        """Return the centres (n, 2) of cells, given by a mask (rows, columns)."""
        row, column = np.nonzero(cells)
        return np.column_stack([self._west_m + column * self._width_m, self._north_m - row * self._height_m])

    def height_m(self, x_m: F8, y_m: F8) -> F8:
        """Ground height at points of any common shape; each height depends on its point alone."""
        x, y = (np.ascontiguousarray(a, dtype=np.float64) for a in np.broadcast_arrays(x_m, y_m))
        height = np.empty(x.shape)
        flat = height.reshape(-1), x.reshape(-1), y.reshape(-1)
        _heights(*flat, self._nodes_m, self._west_m, self._south_m, self._width_m, self._height_m)
        return height

    def has_heights(self, xy_m: F8, reach_m: float) -> NDArray[np.bool_]:
        """Return a mask of the points (n, 2) on the grid with all heights within reach, as in `check`."""
        hole_gap_m, _ = self._holes.query(xy_m)
        rim_gap_m, _ = self._rim.query(xy_m)
        is_clear = (hole_gap_m >= reach_m + self._support_m) & (rim_gap_m >= self._least_rim_gap_m)
        return np.asarray(self._on_ground(xy_m) & is_clear)

    def _on_ground(self, xy_m: F8) -> NDArray[np.bool_]:
        """Return a mask of the points (n, 2) on the grid whose nearest cell has a height."""
        x, y = xy_m.T
        on_grid = (x >= self._west_m) & (x <= self._east_m) & (y >= self._south_m) & (y <= self._north_m)
        rows, columns = self._grid.heights_m.shape
        row = np.rint((self._north_m - y) / self._height_m).astype(np.int64).clip(0, rows - 1)
        column = np.rint((x - self._west_m) / self._width_m).astype(np.int64).clip(0, columns - 1)
        return np.asarray(on_grid & ~np.isnan(self._grid.heights_m[row, column]))

    @property
    def _least_rim_gap_m(self) -> float:
        """Least distance of a path from cells of the rim: a cell, as from the row beyond the last one."""
        return min(self._grid.cell_m) * (1.0 - _ROUNDING)

    @cached_property
    def _holes(self) -> Any:
        """Cells without a height amid the others, as a `scipy.spatial.KDTree`.

        From none of them the distance is infinite.
        """
        from scipy.spatial import KDTree  # here: it takes a while to load

        return KDTree(self._hole_m)

    @cached_property
    def _rim(self) -> Any:
        """The innermost cells of the rim, as a `scipy.spatial.KDTree`."""
        from scipy.spatial import KDTree  # here: it takes a while to load

        return KDTree(self._rim_m)

    def check(self, path_xy_m: F8, reach_m: float) -> None:
        """Raise GeometryError if a path (n, 2) leaves the ground, or a hole in it is within reach.

        Warn of edges in sight: those of the grid, and of its rim, which are cells without a height that reach
        its edge, as around a plot that is no rectangle.
        """
        self._check_edges(path_xy_m, reach_m)
        self._check_rim(path_xy_m, reach_m)
        gap_m = distance_m(self._hole_m, path_xy_m)
        if len(gap_m) and gap_m.min() < reach_m + self._support_m:
            place_m = self._hole_m[gap_m.argmin()]
            found = f"no height at {self._on_map(place_m)}, {gap_m.min():.1f} m from the path"
            expected = f"heights {reach_m:g} m around the path and two cells more"
            raise GeometryError(self._cell_at(place_m), found, expected)

    def _check_edges(self, path_xy_m: F8, reach_m: float) -> None:
        rows, columns = self._grid.heights_m.shape
        first_row, first_column = self._grid.first
        x, y = path_xy_m.T
        sides = {
            f"column {first_column} at x = {self._west_m:.1f} m": x - self._west_m,
            f"column {first_column + columns - 1} at x = {self._east_m:.1f} m": self._east_m - x,
            f"row {first_row} at y = {self._north_m:.1f} m": self._north_m - y,
            f"row {first_row + rows - 1} at y = {self._south_m:.1f} m": y - self._south_m,
        }
        in_sight = {edge: gap_m for edge, gap_m in sides.items() if gap_m.min() < reach_m}
        for edge, gap_m in in_sight.items():
            if gap_m.min() < 0:
                px, py = path_xy_m[gap_m.argmin()].tolist()
                found = f"ends in {edge}, {-gap_m.min():.1f} m short of the path at ({px:.1f}, {py:.1f}) m"
                raise GeometryError(str(self._grid.path), found, "ground under the whole path")
        if in_sight:
            nearest_m = min(gap_m.min() for gap_m in in_sight.values())
            self._warn_of_end(", ".join(in_sight), nearest_m, reach_m)

    def _check_rim(self, path_xy_m: F8, reach_m: float) -> None:
        if not len(self._rim_m):
            return
        off_ground = ~self._on_ground(path_xy_m)
        gap_m = distance_m(self._rim_m, path_xy_m)
        nearest = int(gap_m.argmin())
        if off_ground.any() or gap_m[nearest] < self._least_rim_gap_m:
            place_m = path_xy_m[off_ground.argmax()] if off_ground.any() else self._rim_m[nearest]
            found = f"no height at {self._on_map(place_m)}, on the path"
            raise GeometryError(self._cell_at(place_m), found, "ground under the whole path")
        if gap_m[nearest] < reach_m:
            row, column = self._index(self._rim_m[nearest])
            self._warn_of_end(f"front of row {row}, column {column}", float(gap_m[nearest]), reach_m)

    def _warn_of_end(self, edge: str, nearest_m: float, reach_m: float) -> None:
        _log.warning(
            "%s: ends in %s, %.1f m from the path at the nearest, and goes on level from there;"
            " the sensor sees %g m",
            *(self._grid.path, edge, nearest_m, reach_m),
        )

    def _index(self, xy_m: F8) -> tuple[int, int]:
        """Return the row and column in the file, from 1, of the cell at a place (2,)."""
        x_m, y_m = xy_m.tolist()
        first_row, first_column = self._grid.first
        row = round((self._north_m - y_m) / self._height_m)
        return first_row + row, first_column + round((x_m - self._west_m) / self._width_m)

    def _cell_at(self, xy_m: F8) -> str:
        """Return the location of a cell of the file by its place (2,), for messages."""
        row, column = self._index(xy_m)
        return f"{self._grid.path}: row {row}, column {column}"

    def _on_map(self, xy_m: F8) -> str:
        """Return a place (2,) as text, on the map too if the scene has an origin."""
        east, north, _ = self._origin_m
        px, py = xy_m.tolist()
        on_map = f" (E {px + east:.1f}, N {py + north:.1f})" if (east, north) != (0.0, 0.0) else ""
        return f"({px:.1f}, {py:.1f}) m{on_map}"


def _rim_of(gaps: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask of the cells without a height, given by one, that reach the edge of the grid."""
    from scipy import ndimage  # here: it takes a while to load

    regions, count = ndimage.label(gaps, _AROUND)
    is_rim = np.zeros(count + 1, np.bool_)
    for edge in (regions[0], regions[-1], regions[:, 0], regions[:, -1]):
        is_rim[edge] = True
    is_rim[0] = False  # cells with a height
    return np.asarray(is_rim[regions])


@inline_kernel
def _slope(before: float, after: float) -> float:
    """Slope at a node between two rises: their mean, at most twice the smaller; 0 at tops and hollows."""
    if before * after <= 0.0:
        return 0.0
    return math.copysign(min(abs(before + after) / 2, 2 * min(abs(before), abs(after))), before)


@inline_kernel
def _interpolate(a: float, b: float, c: float, d: float, t: float) -> float:
    """Height at share `t` of the way from b to c, for four heights at equal distances."""
    rise = c - b
    start = _slope(b - a, rise)
    end = _slope(rise, d - c)
    return b + t * (start + t * (3 * rise - 2 * start - end + t * (start + end - 2 * rise)))


@array_kernel
def _heights(
    out: F8, x: F8, y: F8, nodes: F8, west_m: float, south_m: float, width_m: float, height_m: float
) -> None:
    """Fill (n,) heights; `nodes` has a border of one cell."""
    rows, columns = nodes.shape
    z = np.empty(4)
    for i in range(out.shape[0]):
        u = min(max((x[i] - west_m) / width_m, 0.0), columns - 3.0)
        v = min(max((y[i] - south_m) / height_m, 0.0), rows - 3.0)
        column, row = min(int(u), columns - 4), min(int(v), rows - 4)
        for j in range(4):
            a, b, c, d = nodes[row + j, column : column + 4]
            z[j] = _interpolate(a, b, c, d, u - column)
        out[i] = _interpolate(z[0], z[1], z[2], z[3], v - row)
