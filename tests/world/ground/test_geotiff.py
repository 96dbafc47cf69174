"""Ground from a GeoTIFF."""

import sys

import numpy as np
import pytest

from vlp16emu.errors import GeometryError, MissingExtraError
from vlp16emu.world.ground.dem import DemHeights
from vlp16emu.world.ground.settings import Dem

HEIGHTS = np.arange(12, dtype=np.float32).reshape(3, 4)
PROJECTED_AREA = {1024: 1, 1025: 1, 3076: 9001}


def write(
    path, heights=HEIGHTS, keys=PROJECTED_AREA, scale=(10.0, 10.0, 0.0), nodata=None, east=100.0, **options
):
    """Write a GeoTIFF whose north-western corner lies at E 100, N 230."""
    tifffile = pytest.importorskip("tifffile", reason="tifffile is not installed")
    directory = [1, 1, 0, len(keys), *(n for key, value in keys.items() for n in (key, 0, 1, value))]
    tags = [
        (33550, "d", 3, scale, True),
        (33922, "d", 6, (0.0, 0.0, 0.0, east, 230.0, 0.0), True),
        (34735, "H", len(directory), directory, True),
    ]
    if nodata is not None:
        tags.append((42113, "s", 0, str(nodata), True))
    tifffile.imwrite(path, heights, extratags=tags, **options)
    return path


def read(path):
    return DemHeights(Dem(file=str(path)), origin_m=(0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("compression", "predictor"), [(None, None), ("zlib", None), ("lzw", None), ("lzw", 3), ("zstd", 3)]
)
def test_heights_stand_where_the_tags_put_them(tmp_path, compression, predictor):
    """Cells that are areas have their heights at their centres, however the file is compressed."""
    if compression not in (None, "zlib"):
        pytest.importorskip("imagecodecs", reason="imagecodecs is not installed")
    dem = read(write(tmp_path / "ground.tif", compression=compression, predictor=predictor))
    x, y = np.meshgrid([105.0, 115.0, 125.0, 135.0], [225.0, 215.0, 205.0])
    assert dem.height_m(x, y) == pytest.approx(HEIGHTS, abs=1e-9)


def test_cells_that_are_points_stand_half_a_cell_aside(tmp_path):
    """With PixelIsPoint the tie point is the centre of the first cell."""
    dem = read(write(tmp_path / "ground.tiff", keys=PROJECTED_AREA | {1025: 2}))
    assert dem.height_m(np.array([100.0, 130.0]), np.array([230.0, 210.0])) == pytest.approx([0.0, 11.0])


def test_the_number_for_no_height_is_a_gap(tmp_path):
    """Cells with the value of the GDAL_NODATA tag have no height."""
    heights = np.where(HEIGHTS == 5, -32768, HEIGHTS).astype(np.int16)
    dem = read(write(tmp_path / "ground.tif", heights=heights, nodata=-32768))
    with pytest.raises(GeometryError, match="row 2, column 2: no height"):
        dem.check(np.array([[120.0, 215.0]]), 5.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"keys": PROJECTED_AREA | {1024: 2}}, "GTModelTypeGeoKey: found 2; expected 1: a map in metres"),
        ({"keys": PROJECTED_AREA | {3076: 9002}}, "ProjLinearUnitsGeoKey: found 9002; expected 9001"),
        ({"scale": (10.0, 5.0, 0.0)}, "ModelPixelScale: found 10 x 5; expected square cells"),
        ({"east": np.nan}, r"ModelTiepoint: found \[.*nan.*\], cells of 10; expected finite numbers"),
        ({"scale": (np.inf, np.inf, 0.0)}, "ModelTiepoint: found .*, cells of inf; expected finite numbers"),
        (
            {"heights": np.zeros((3, 4, 3), np.uint8), "photometric": "rgb"},
            r"found \(3, 4, 3\) uint8; expected one",
        ),
    ],
)
def test_what_is_no_map_of_heights_in_metres_is_refused(tmp_path, changes, message):
    """Degrees, feet, oblong cells, places that are none, and colours are named, with what was expected."""
    with pytest.raises(GeometryError, match=message):
        read(write(tmp_path / "ground.tif", **changes))


def test_a_tiff_that_lies_nowhere_is_refused(tmp_path):
    """A plain TIFF has no place on the map."""
    tifffile = pytest.importorskip("tifffile", reason="tifffile is not installed")
    tifffile.imwrite(tmp_path / "ground.tif", HEIGHTS)
    with pytest.raises(GeometryError, match="found no ModelPixelScale with one ModelTiepoint"):
        read(tmp_path / "ground.tif")


def test_a_file_that_is_no_tiff_is_refused(tmp_path):
    """Text with the ending of a TIFF is refused in one line."""
    pytest.importorskip("tifffile", reason="tifffile is not installed")
    (tmp_path / "ground.tif").write_text("hello")
    with pytest.raises(GeometryError, match=r"ground.tif: .*; expected a GeoTIFF of heights"):
        read(tmp_path / "ground.tif")


def test_without_tifffile_the_extra_is_named(tmp_path, monkeypatch):
    """Where tifffile is missing the error says which extra brings it."""
    monkeypatch.setitem(sys.modules, "tifffile", None)
    message = r"reading ground.tif needs tifffile: pip install 'vlp16emu\[dem\]'"
    with pytest.raises(MissingExtraError, match=message):
        read(tmp_path / "ground.tif")


TAGS = {"lzw": (259, 5), "zstd": (259, 50000), "predictor": (317, 3)}


@pytest.fixture
def no_imagecodecs(monkeypatch):
    """Let tifffile be imported anew where imagecodecs is not."""
    pytest.importorskip("tifffile", reason="tifffile is not installed")
    for name in [name for name in sys.modules if name.partition(".")[0] == "tifffile"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "imagecodecs", None)


@pytest.mark.usefixtures("no_imagecodecs")
@pytest.mark.parametrize("what", TAGS)
def test_without_imagecodecs_the_extra_is_named(tmp_path, what):
    """A compression or a predictor that tifffile cannot undo by itself is told with the extra that brings what can."""
    import tifffile

    tag, value = TAGS[what]
    path = write(tmp_path / "ground.tif", HEIGHTS.astype(np.int16), compression="zlib", predictor=2)
    with tifffile.TiffFile(path) as file:
        place = file.pages[0].tags[tag].valueoffset
    content = bytearray(path.read_bytes())
    content[place : place + 2] = value.to_bytes(2, "little")
    path.write_bytes(content)
    message = r"^decompressing ground.tif needs imagecodecs: pip install 'vlp16emu\[dem\]'$"
    with pytest.raises(MissingExtraError, match=message):
        read(path)


def test_a_broken_compressed_file_is_refused(tmp_path):
    """Heights that cannot be decompressed are told in one line, whatever the codec raises."""
    path = write(tmp_path / "ground.tif", compression="zlib")
    content = bytearray(path.read_bytes())
    start = content.index(b"\x78")  # of the deflated strip
    content[start : start + 8] = b"\xff" * 8
    path.write_bytes(content)
    with pytest.raises(GeometryError, match=r"ground.tif: .+; expected a GeoTIFF of heights"):
        read(path)
