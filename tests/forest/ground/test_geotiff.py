"""Ground from a GeoTIFF."""

import sys

import numpy as np
import pytest

from vlp16emu.errors import GeometryError, MissingExtraError
from vlp16emu.forest.ground.dem import DemHeights
from vlp16emu.forest.settings import Dem

rasterio = pytest.importorskip("rasterio")

HEIGHTS = np.arange(12, dtype=np.float32).reshape(3, 4)
PLACE = 10.0, 0.0, 100.0, 0.0, -10.0, 230.0  # cells of 10 m, their north-western corner at E 100, N 230


def write(path, heights=HEIGHTS, place=PLACE, crs="EPSG:25832", units=None, **options):
    bands = heights[None] if heights.ndim == 2 else heights
    count, height, width = bands.shape
    options |= {"dtype": heights.dtype, "crs": crs, "transform": place and rasterio.Affine(*place)}
    with rasterio.open(path, "w", driver="GTiff", count=count, height=height, width=width, **options) as file:
        file.write(bands)
        if units:
            file.units = units
    return path


def read(path):
    return DemHeights(Dem(file=str(path)), origin_m=(0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    "options",
    [
        {"compress": "deflate"},
        {"compress": "lzw", "predictor": 3},
        {"compress": "zstd"},
        {"tiled": True},
        {"crs": None, "AREA_OR_POINT": "Point"},
    ],
)
def test_heights_stand_where_the_tags_put_them(tmp_path, options):
    """Cells, areas or points, have their heights at their centres, however the file is compressed; without
    a system it is in metres."""
    dem = read(write(tmp_path / "ground.tif", **options))
    x, y = np.meshgrid([105.0, 115.0, 125.0, 135.0], [225.0, 215.0, 205.0])
    assert dem.height_m(x, y) == pytest.approx(HEIGHTS, abs=1e-9)


@pytest.mark.parametrize("none", [-32768.0, np.nan, np.inf])
def test_the_number_for_no_height_is_a_gap(tmp_path, none):
    """Cells with the file's no-data value, or that are not finite, have no height."""
    heights = np.where(HEIGHTS == 5, np.float32(none), HEIGHTS)
    dem = read(write(tmp_path / "ground.tif", heights=heights, nodata=-32768.0))
    with pytest.raises(GeometryError, match="row 2, column 2: no height"):
        dem.check(np.array([[120.0, 215.0]]), 5.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"crs": "EPSG:4326"}, "found a map in degrees; expected one in metres"),
        ({"crs": "EPSG:2225"}, "found a map in US survey foot; expected one in metres"),
        ({"units": ["ft"]}, "found heights in ft; expected metres"),
        ({"place": None}, "found no place on a map; expected a grid that says where it lies"),
        (
            {"place": (9.0, 1.0, 100.0, 1.0, -9.0, 230.0)},
            "found cells of 9 x 9, turned; expected cells that run",
        ),
        ({"place": (10.0, 0.0, 100.0, 0.0, 10.0, 230.0)}, "found cells of 10 x -10 from"),
        (
            {"place": (10.0, 0.0, np.nan, 0.0, -10.0, 230.0)},
            (
                r"found cells of 10 x 10 from \(nan, 230\); "
                r"expected"
            ),
        ),
        ({"place": (np.inf, 0.0, 100.0, 0.0, -np.inf, 230.0)}, "found cells of inf x inf"),
        (
            {"heights": HEIGHTS - 32768},
            ("row 1, column 1: found -32768 and 11 more such; expected heights from -500"),
        ),
        ({"heights": np.zeros((3, 3, 4), np.uint8)}, "found 3 bands of uint8; expected one height to a cell"),
    ],
)
@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_what_is_no_map_of_heights_in_metres_is_refused(tmp_path, changes, message):
    """Degrees, feet, turned cells, places that are none, and colours are named, with what was
    expected."""
    with pytest.raises(GeometryError, match=message):
        read(write(tmp_path / "ground.tif", **changes))


def test_a_small_file_of_vast_size_takes_no_memory(tmp_path):
    """Cells that a sparse file promises are counted before they are read."""
    path = tmp_path / "ground.tif"
    size = {"width": 100_000, "height": 100_000, "transform": rasterio.Affine(*PLACE)}
    rasterio.open(
        path, "w", driver="GTiff", count=1, dtype="float32", sparse_ok=True, tiled=True, **size
    ).close()
    assert path.stat().st_size < 10_000_000
    with pytest.raises(GeometryError, match="found 100000 rows of 100000; expected at most 50000000 cells"):
        read(path)


@pytest.mark.parametrize("is_tiff", [False, True])
def test_a_broken_file_is_refused(tmp_path, capfd, is_tiff):
    """Text with the ending of a TIFF, and heights that cannot be decompressed, give one error line, and
    GDAL prints nothing."""
    path = write(tmp_path / "ground.tif", compress="deflate")
    content = bytearray(path.read_bytes())
    start = content.rindex(b"\x78")  # of the deflated strip
    content[start : start + 8] = b"\xff" * 8
    path.write_bytes(content if is_tiff else b"hello")
    with pytest.raises(GeometryError, match=r"ground.tif: cannot be read: .+; expected a GeoTIFF of heights"):
        read(path)
    assert capfd.readouterr().err == ""


def test_without_rasterio_the_extra_is_named(tmp_path, monkeypatch):
    """Where rasterio is missing the error says which extra brings it."""
    monkeypatch.setitem(sys.modules, "rasterio", None)
    message = r"reading ground.tif needs rasterio: pip install 'vlp16emu\[dem\]'"
    with pytest.raises(MissingExtraError, match=message):
        read(tmp_path / "ground.tif")
