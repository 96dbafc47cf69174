"""Heights from a GeoTIFF, by tifffile.

Tags and keys: OGC 19-008r4, OGC GeoTIFF Standard 1.1, sections 7 and annexes C and D.
"""

import logging
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import GeometryError, MissingExtraError, readable

__all__ = ["read_geotiff"]

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
    # What it stumbles over is told in a line of our own.
    logging.getLogger("tifffile").setLevel(logging.CRITICAL)
    with readable(path, _EXPECTED, GeometryError):
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
    """Tell why a file could not be read: for want of a codec, or for what is in it."""
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
