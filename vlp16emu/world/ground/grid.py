"""Grids of heights in files: ESRI ASCII, numpy, and GeoTIFF where tifffile is installed.

Tags and keys of a GeoTIFF: OGC 19-008r4, OGC GeoTIFF Standard 1.1, sections 7 and annexes C and D; tifffile reads it.
"""

import logging
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import LARGEST_BYTES, GeometryError, MissingExtraError, readable
from vlp16emu.types import HeightField

_EXPECTED = "a GeoTIFF of heights"

_PROJECTED = 1
"""Value of GTModelTypeGeoKey: metres or feet on a map, not degrees."""

_PIXEL_IS_POINT = 2
"""Value of GTRasterTypeGeoKey: tie points name centres of cells, not their north-western corners."""

_METRE = 9001
"""EPSG code of the unit metre."""

_GDAL_NODATA = 42113
"""Tag of the number that stands for no height (GDAL, GTiff driver)."""


def read_geotiff(path: Path) -> tuple[NDArray[np.float64], float, float, float]:
    """Read the first image of a GeoTIFF.

    Returns
    -------
    heights (rows, columns) in m, northernmost row first, NaN where there is none; easting of the centres
    of the first column; northing of the centres of the first row; edge of a cell, m

    Raises
    ------
    MissingExtraError
        without tifffile, or without imagecodecs for a file that only it can decompress
    GeometryError
        for a file that is none, or is not on a north-up grid of squares in metres
    """
    try:
        import tifffile
    except ImportError:
        raise MissingExtraError("tifffile", "dem", f"reading {path.name}") from None
    # Its failures are reported in a line of our own.
    logging.getLogger("tifffile").setLevel(logging.CRITICAL)
    with readable(path, _EXPECTED, GeometryError, most_bytes=LARGEST_BYTES):
        try:
            with tifffile.TiffFile(path) as file:
                page = file.pages[0]
                tags, heights = page.geotiff_tags or {}, page.asarray()
                nodata = page.nodata if _GDAL_NODATA in page.tags else None
        except OSError:
            raise
        except Exception as error:  # noqa: BLE001  # tifffile and its codecs raise whatever they stumble over
            raise _unread(path, error) from None
    if heights.ndim != 2 or heights.dtype.kind not in "iuf":
        raise GeometryError(str(path), f"found {heights.shape} {heights.dtype}", "one number to a cell")
    west_m, north_m, cell_m = _place(path, tags)
    known = np.isfinite(heights) if nodata is None else np.isfinite(heights) & (heights != nodata)
    return np.where(known, heights.astype(np.float64), np.nan), west_m, north_m, cell_m


def _unread(path: Path, error: Exception) -> GeometryError | MissingExtraError:
    """Say why a file could not be read: for want of a codec, or for what is in it."""
    # Python before 3.14 has no Zstandard, and tifffile then looks for it in vain.
    wants_codec = isinstance(error, ModuleNotFoundError) or "imagecodecs" in str(error)
    if wants_codec and find_spec("imagecodecs") is None:
        return MissingExtraError("imagecodecs", "dem", f"decompressing {path.name}")
    return GeometryError(str(path), str(error).lower() or "cannot be read", _EXPECTED)


def _place(path: Path, tags: dict[str, Any]) -> tuple[float, float, float]:
    """Centre of the north-western cell, and edge of a cell."""
    for key, expected in (
        ("GTModelTypeGeoKey", _PROJECTED),
        ("ProjLinearUnitsGeoKey", _METRE),
        ("VerticalUnitsGeoKey", _METRE),
    ):
        if (found := int(tags.get(key, expected))) != expected:
            raise GeometryError(f"{path}: {key}", f"found {found}", f"{expected}: a map in metres")
    if "ModelPixelScale" not in tags or len(tags.get("ModelTiepoint", ())) != 6:
        raise GeometryError(
            str(path),
            "found no ModelPixelScale with one ModelTiepoint",
            "a north-up grid that says where it lies",
        )
    width_m, height_m = tags["ModelPixelScale"][:2]
    if width_m != height_m or width_m <= 0:
        raise GeometryError(f"{path}: ModelPixelScale", f"found {width_m:g} x {height_m:g}", "square cells")
    column, row, _, east_m, north_m, _ = place = tags["ModelTiepoint"]
    if not np.isfinite([width_m, *place]).all():
        raise GeometryError(
            f"{path}: ModelTiepoint", f"found {place}, cells of {width_m:g}", "finite numbers"
        )
    half = 0.0 if tags.get("GTRasterTypeGeoKey") == _PIXEL_IS_POINT else 0.5
    return east_m + (half - column) * width_m, north_m - (half - row) * width_m, width_m


Array = NDArray[np.float64]

_ASCII_EXPECTED = "an ESRI ASCII grid"
_ASCII_SIZE = ("ncols", "nrows", "cellsize")
_ASCII_WEST, _ASCII_SOUTH = ("xllcorner", "xllcenter"), ("yllcorner", "yllcenter")
_ASCII_NODATA = "nodata_value"
"""Keys of the header, in any order and case (Esri, ArcGIS documentation, "Esri ASCII raster format")."""


@dataclass(frozen=True, slots=True)
class Grid:
    """Heights over equal squares, as the file has them."""

    path: Path
    heights_m: Array
    """(rows, columns), northernmost row first, NaN where the file has no height."""
    west_m: float
    """Easting of the centres of the first column."""
    north_m: float
    """Northing of the centres of the first row."""
    cell_m: float


def read_grid(path: Path, *, cell_m: float | None, corner_m: tuple[float, float] | None) -> Grid:
    """Read a grid, of the format that the suffix names: .asc, .npy, .tif or .tiff.

    Parameters
    ----------
    cell_m, corner_m : edge of a cell, and easting and northing of the outer corner of the south-western
        cell; needed for .npy, which does not hold them, and None for the others

    Raises
    ------
    GeometryError
        where the file is no such grid
    MissingExtraError
        for a GeoTIFF without tifffile
    """
    kind = path.suffix.lower()
    if kind not in {".asc", ".npy", ".tif", ".tiff"}:
        raise GeometryError(str(path), f"found the ending {kind!r}", ".asc, .npy, .tif or .tiff")
    if kind == ".npy":
        if cell_m is None or corner_m is None:
            raise GeometryError(str(path), "an array alone does not say where it lies", "cell_m and corner_m")
        heights = _read_npy(path)
        return _from_corner(path, heights, corner_m, cell_m)
    if cell_m is not None or corner_m is not None:
        raise GeometryError(str(path), "found cell_m or corner_m", "neither: the file itself says both")
    if kind == ".asc":
        return _read_ascii(path)
    heights, west_m, north_m, cell = read_geotiff(path)
    return _checked(Grid(path, heights, west_m, north_m, cell))


def write_ascii(file: BinaryIO, height_m: HeightField, low_m: Array, high_m: Array, cell_m: float) -> None:
    """Write ground as an ESRI ASCII grid, in millimetres; each height is that at the centre of its cell.

    Parameters
    ----------
    low_m, high_m : (2,) x and y of a rectangle; the grid holds it, its edges at whole multiples of a cell

    Raises
    ------
    OSError
        where the file cannot be written to its end
    """
    first, end = np.floor(low_m / cell_m), np.ceil(high_m / cell_m)
    columns, rows = (end - first).astype(np.int64).tolist()
    west_m, south_m = (first * cell_m).tolist()
    head = f"ncols {columns}\nnrows {rows}\nxllcorner {west_m:.10g}\nyllcorner {south_m:.10g}\ncellsize {cell_m:g}\n"
    file.write(head.encode())
    x_m = (first[0] + 0.5 + np.arange(columns)) * cell_m
    for row in reversed(range(rows)):
        heights_m = height_m(x_m, np.full(columns, (first[1] + 0.5 + row) * cell_m))
        np.savetxt(file, heights_m[None], fmt="%.3f")


def _from_corner(path: Path, heights_m: Array, corner_m: tuple[float, float], cell_m: float) -> Grid:
    west_m = corner_m[0] + cell_m / 2
    north_m = corner_m[1] + (len(heights_m) - 0.5) * cell_m
    return _checked(Grid(path, heights_m, west_m, north_m, cell_m))


def _checked(grid: Grid) -> Grid:
    """Refuse what gives no surface."""
    rows, columns = grid.heights_m.shape
    if min(rows, columns) < 2:
        raise GeometryError(str(grid.path), f"found {rows} rows of {columns}", "at least 2 rows of 2")
    if np.isnan(grid.heights_m).all():
        raise GeometryError(str(grid.path), "no cell has a height", "heights")
    return grid


def _read_npy(path: Path) -> Array:
    """Read an array, northernmost row first; NaN is no height."""
    with readable(path, "a numpy array", GeometryError, most_bytes=LARGEST_BYTES):
        try:
            with path.open("rb") as file:
                heights = np.load(file, allow_pickle=False)
        except OSError:
            raise
        except Exception:  # noqa: BLE001  # numpy raises whatever a broken header leads it to
            raise GeometryError(str(path), "no .npy file", "a numpy array of numbers") from None
    if not isinstance(heights, np.ndarray) or heights.ndim != 2 or heights.dtype.kind not in "iuf":
        found = f"{heights.shape} {heights.dtype}" if isinstance(heights, np.ndarray) else "an archive"
        raise GeometryError(str(path), f"found {found}", "numbers in rows and columns")
    if len(infinite := np.argwhere(np.isinf(heights))):
        row, column = infinite[0] + 1
        raise GeometryError(
            str(path), f"found inf in row {row}, column {column}", "a height, or NaN for none"
        )
    return heights.astype(np.float64)


def _read_ascii(path: Path) -> Grid:
    """Read an ESRI ASCII grid with one row of cells to a line."""
    with (
        readable(path, _ASCII_EXPECTED, GeometryError, most_bytes=LARGEST_BYTES),
        path.open(encoding="utf-8-sig") as file,
    ):
        lines = [(number, text) for number, text in enumerate(file, start=1) if text.strip()]
    header: dict[str, float] = {}
    for number, text in lines:
        if not text.split()[0][0].isalpha() or text.split()[0].lower() == "nan":
            break
        _read_header_line(f"{path}, line {number}", text, header)
    columns, rows, cell_m = (_sized(path, header, key) for key in _ASCII_SIZE)
    heights = _read_rows(path, lines[len(header) :], int(rows), int(columns), header.get(_ASCII_NODATA))
    corner_m = (_low_edge(path, header, _ASCII_WEST, cell_m), _low_edge(path, header, _ASCII_SOUTH, cell_m))
    return _from_corner(path, heights, corner_m, cell_m)


def _read_header_line(where: str, text: str, header: dict[str, float]) -> None:
    """Add one key and its number."""
    known = (*_ASCII_SIZE, *_ASCII_WEST, *_ASCII_SOUTH, _ASCII_NODATA)
    key, *values = text.lower().split()
    if key not in known:
        found = f"unknown key {key!r}" if header else "no key of a header"  # or else no such grid at all
        raise GeometryError(where, found, f"one of {', '.join(known)}")
    if key in header:
        raise GeometryError(where, f"{key} a second time", "each key once")
    try:
        (value,) = values
        header[key] = float(value)
    except ValueError:
        raise GeometryError(where, f"found {text.strip()!r}", f"{key} and a number") from None


def _sized(path: Path, header: dict[str, float], key: str) -> float:
    """One of the keys that must be there and positive, counts whole."""
    value = header.get(key)
    whole = key != "cellsize"
    if value is None or not 0 < value < np.inf or (whole and value % 1):
        found = "missing" if value is None else f"found {value:g}"
        raise GeometryError(f"{path}: {key}", found, f"a {'whole ' if whole else ''}number above 0")
    return value


def _low_edge(path: Path, header: dict[str, float], keys: tuple[str, str], cell_m: float) -> float:
    """Outer edge of the first column or of the last row, from the edge itself or the cell's centre."""
    given = [key for key in keys if key in header]
    if len(given) != 1:
        raise GeometryError(f"{path}: header", f"found {' and '.join(given) or 'neither'}", " or ".join(keys))
    if not np.isfinite(at_m := header[given[0]]):
        raise GeometryError(f"{path}: {given[0]}", f"found {at_m:g}", "a finite number")
    return at_m - (cell_m / 2 if given[0] == keys[1] else 0.0)


def _read_rows(
    path: Path, lines: list[tuple[int, str]], rows: int, columns: int, nodata: float | None
) -> Array:
    """Read the cells; NaN where the file has the number that stands for none."""
    if len(lines) != rows:
        where = f"{path}, line {lines[-1][0]}" if lines else str(path)
        raise GeometryError(where, f"found {len(lines)} rows", f"nrows = {rows}")
    if len(first := lines[0][1].split()) != columns:  # before room is made for what there is not
        raise GeometryError(
            f"{path}, line {lines[0][0]}", f"found {len(first)} heights", f"ncols = {columns}"
        )
    heights = np.empty((rows, columns))
    for row, (number, text) in enumerate(lines):
        where, words = f"{path}, line {number}", text.split()
        if len(words) != columns:
            raise GeometryError(where, f"found {len(words)} heights", f"ncols = {columns}")
        try:
            heights[row] = words
        except ValueError:
            word = next(word for word in words if not _is_number(word))
            raise GeometryError(where, f"found {word!r}", "a height") from None
        none = np.isnan(heights[row]) if nodata is not None and np.isnan(nodata) else heights[row] == nodata
        if not (np.isfinite(heights[row]) | none).all():
            column = int(np.argmin(np.isfinite(heights[row]) | none))
            raise GeometryError(where, f"found {words[column]} in column {column + 1}", "a height")
        heights[row, none] = np.nan
    return heights


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
