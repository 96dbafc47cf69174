"""Ground from a grid of heights."""

import numpy as np
import pytest
from scipy import interpolate

from vlp16emu.errors import GeometryError
from vlp16emu.forest.ground.dem import DemHeights, read_grid, write_ascii
from vlp16emu.forest.settings import Dem

HEADER = "ncols 4\nnrows 3\nxllcorner 100\nyllcorner 200\ncellsize 10\nNODATA_value -9999\n"
ROWS = "1 2 3 4\n5 6 7 8\n9 10 11 12\n"
NO_ORIGIN = (0.0, 0.0, 0.0)


def write(tmp_path, text):
    path = tmp_path / "ground.asc"
    path.write_text(text, encoding="utf-8")
    return path


def read(path, cell_m=None, corner_m=None, origin_m=NO_ORIGIN):
    return DemHeights(Dem(file=str(path), cell_m=cell_m, corner_m=corner_m), origin_m=origin_m)


def dem_of(heights_m, tmp_path, cell_m=1.0, corner_m=(-0.5, -0.5), origin_m=NO_ORIGIN):
    """A surface through heights whose first row is the northernmost; its south-western node is at (0, 0)."""
    path = tmp_path / "ground.npy"
    np.save(path, heights_m)
    return read(path, cell_m, corner_m, origin_m)


CENTRES = HEADER.replace("xllcorner 100", "XLLCENTER 105").replace("yllcorner 200", "yllcenter 205")


@pytest.mark.parametrize("text", [HEADER + ROWS, CENTRES + ROWS, "\ufeff" + HEADER + ROWS, None])
def test_the_surface_goes_through_every_height_where_the_file_puts_it(tmp_path, text):
    """Heights stand at the centres of their cells, first row northernmost: by corner or centre, after a
    byte order mark, in a .npy."""
    array = np.arange(1, 13).reshape(3, 4)
    dem = read(write(tmp_path, text)) if text else dem_of(array, tmp_path, 10.0, (100.0, 200.0))
    x, y = np.meshgrid([105.0, 115.0, 125.0, 135.0], [225.0, 215.0, 205.0])
    assert dem.height_m(x, y) == pytest.approx(array, abs=1e-12)


@pytest.fixture
def bumpy(tmp_path):
    """A surface of 30 x 40 random heights, and the heights with the southernmost row first."""
    heights = np.random.default_rng(1).normal(size=(30, 40))
    return dem_of(heights[::-1], tmp_path), heights


def along(values, at, slopes):
    """Cubic Hermite curve, straight on beyond the ends, with slopes at heights that follow from the rises
    before and after."""
    rises = np.diff(np.concatenate([[2 * values[0] - values[1]], values, [2 * values[-1] - values[-2]]]))
    return interpolate.CubicHermiteSpline(np.arange(len(values)), values, slopes(rises[:-1], rises[1:]))(at)


def steffen(before, after):
    """Equation 11 of the paper, for equal distances."""
    least = np.minimum(np.minimum(abs(before), abs(after)), abs(before + after) / 4)
    return (np.sign(before) + np.sign(after)) * least


def keys(before, after):
    """The parabola's chord."""
    return (before + after) / 2


@pytest.mark.parametrize(("slopes", "bend"), [(steffen, 1.0), (keys, 0.02)])
def test_the_surface_is_made_of_monotone_cubics(tmp_path, slopes, bend):
    """It agrees with Steffen's along x and then along y, and with the convolution of Keys where a slope
    bends little, to 1e-12."""
    heights = np.arange(40) + bend * np.random.default_rng(1).normal(size=(30, 40))
    dem = dem_of(heights[::-1] + 0.7 * np.arange(30)[::-1, None], tmp_path)
    heights += 0.7 * np.arange(30)[:, None]
    x, y = np.random.default_rng(4).uniform([[0], [1]], [[39], [28]], (2, 60))
    twin = [along([along(row, a, slopes) for row in heights], b, slopes) for a, b in zip(x, y, strict=True)]
    assert dem.height_m(x, y) == pytest.approx(np.array(twin), abs=1e-12)


def test_the_ground_keeps_between_the_heights_of_the_file(bumpy, tmp_path):
    """No point lies above or below the four heights around it; so beside a cliff of 100 m the ground is
    level."""
    dem, heights = bumpy
    x, y = np.random.default_rng(5).uniform([[0], [0]], [[39], [29]], (2, 20_000))
    column, row = x.astype(int), y.astype(int)
    around = np.array([heights[row + i, column + j] for i in (0, 1) for j in (0, 1)])
    z_m = dem.height_m(x, y)
    assert (z_m >= around.min(axis=0) - 1e-12).all()
    assert (z_m <= around.max(axis=0) + 1e-12).all()
    cliff = dem_of(np.where(np.arange(20) < 10, 0.0, 100.0) + np.zeros((20, 1)), tmp_path)
    assert set(cliff.height_m(np.array([7.3, 8.9, 10.1, 12.5]), np.full(4, 9.4)).tolist()) == {0.0, 100.0}


def test_a_height_is_the_same_alone_and_in_any_array(bumpy):
    """The height of a point does not depend on how many points are asked for."""
    dem, _ = bumpy
    x, y = np.random.default_rng(6).uniform(-5, 45, (2, 301))
    together = dem.height_m(x, y)
    assert np.array_equal(together[3::7], dem.height_m(x[3::7], y[3::7]))
    assert np.array_equal(
        together[1:].reshape(20, 15), dem.height_m(x[1:].reshape(20, 15), y[1:].reshape(20, 15))
    )


@pytest.mark.parametrize(
    ("path", "reach_m", "message"),
    [
        ([[15.0, 15.0], [30.0, 15.0]], 9.5, ("ground.npy: ends in column 40 at x = 39.0 m, 9.0 m from the "
                                            "path at the nearest, and goes on level from there; the "
                                            "sensor sees 9.5 m")),
        ([[3.0, 15.0]], 4.0, "ends in column 1 at x = 0.0 m, 3.0 m from"),
        ([[20.0, 26.0]], 4.0, "ends in row 1 at y = 29.0 m, 3.0 m from"),
        ([[20.0, 2.0]], 4.0, "ends in row 30 at y = 0.0 m, 2.0 m from"),
    ],
)  # fmt: skip
def test_ground_goes_on_level_beyond_the_file(bumpy, caplog, path, reach_m, message):
    """Where a grid ends within reach a warning names its last row or column, and heights stay those of its
    edge."""
    dem, _ = bumpy
    dem.check(np.array(path), reach_m)
    assert message in caplog.text
    west, east = (
        dem.height_m(np.array(x), np.full(3, 12.0)) for x in ([0.0, -5.0, -80.0], [39.0, 44.0, 90.0])
    )
    assert np.ptp(west) == np.ptp(east) == 0.0


def test_a_gap_within_reach_is_refused_and_one_beyond_is_not(tmp_path):
    """A cell without height counts as far as its two cells of influence reach, is named by row, column and
    place, and has the nearest height."""
    heights = np.zeros((30, 40))
    heights[4, 9], heights[4, 8] = np.nan, 3.0  # fifth row from the north, at (9, 25)
    dem = dem_of(heights, tmp_path, 1.0, (999.5, 1999.5), (1000.0, 2000.0, 0.0))
    path = np.array([[9.0, 14.0], [30.0, 14.0]])
    assert dem.height_m(np.array([9.0]), np.array([25.0])).tolist() == [3.0]
    dem.check(path, 8.0)
    message = r"row 5, column 10: no height at \(9.0, 25.0\) m \(E 1009.0, N 2025.0\), "
    message += "11.0 m from the path; expected"
    with pytest.raises(GeometryError, match=message):
        dem.check(path, 8.5)


@pytest.mark.parametrize("none", ["-9999", "nan", "inf"])
def test_a_cell_that_is_no_height_is_a_gap(tmp_path, none):
    """A cell with the grid's NODATA_value, or that is not finite, has no height."""
    dem = read(write(tmp_path, HEADER + ROWS.replace("5 6", f"5 {none}", 1)))
    with pytest.raises(GeometryError, match="row 2, column 2: no height"):
        dem.check(np.array([[120.0, 215.0]]), 5.0)


@pytest.mark.parametrize(
    ("name", "content", "cell_m", "message"),
    [
        *(
            ("ground.asc", text, None, f"ground.asc[:,] {message}")
            for text, message in [
                (
                    HEADER + "1 2 3 4\n5 6 7\n9 10 11 12\n",
                    ("line 9: found 11 heights; expected nrows = 3 times ncols = 4; line 8 has 3"),
                ),
                (
                    HEADER + "1 2 3 4\n5 6 7 8\n",
                    "line 8: found 8 heights; expected nrows = 3 times ncols = 4$",
                ),
                (
                    HEADER + ROWS + "1 2 3 4\n",
                    "line 10: found more than 12 heights; expected nrows = 3 times",
                ),
                (HEADER + ROWS.replace("7", "seven"), "line 8: found '5 6 seven 8'; expected 4 heights"),
                (
                    HEADER.replace("cellsize 10\n", "") + ROWS,
                    ("line 6: found '1 2 3 4'; expected cellsize or dx and a number"),
                ),
                (
                    HEADER.replace("cellsize 10", "dx 10") + ROWS,
                    "line 7: found '1 2 3 4'; expected cellsize or dy",
                ),
                (
                    HEADER.replace("cellsize 10", "dx 10\ndy 0") + ROWS,
                    "line 6: found 'dy 0'; expected dy and a number above",
                ),
                (HEADER + ROWS.replace("7", "1_0"), "line 8: found '5 6 1_0 8'; expected 4 heights"),
                (
                    HEADER.replace("cellsize 10", "cellsize -1") + ROWS,
                    ("line 5: found 'cellsize -1'; expected cellsize and a number above 0"),
                ),
                (
                    HEADER.replace("corner 100", "corner nan") + ROWS,
                    ("line 3: found 'xllcorner nan'; expected xllcorner and a number"),
                ),
                (
                    HEADER.replace("ncols 4", "ncols 3.5") + ROWS,
                    ("found ncols = 3.5, nrows = 3; expected whole numbers"),
                ),
                (
                    HEADER.replace("cellsize 10", "cellsize ten") + ROWS,
                    ("line 5: found 'cellsize ten'; expected cellsize and a number"),
                ),
                (
                    HEADER.replace("cellsize", "cell") + ROWS,
                    ("line 5: found 'cell 10'; expected cellsize or dx and a number"),
                ),
                (
                    HEADER.replace("yllcorner 200\n", "") + ROWS,
                    ("line 6: found '1 2 3 4'; expected yllcorner or yllcenter and a number"),
                ),
                ("ncols 4\n" + HEADER + ROWS, "line 2: found 'ncols 4'; expected nrows and a number"),
                (HEADER + "-9999 -9999 -9999 -9999\n" * 3, "no cell has a height"),
                (
                    HEADER.replace("nrows 3", "nrows 1") + "1 2 3 4\n",
                    ("found 1 rows of 4; expected at least 2 rows of 2"),
                ),
                (
                    HEADER.replace("ncols 4", "ncols 1000000000") + ROWS,
                    (
                        r"found ncols = 1e\+09, nrows = 3; "
                        r"expected whole numbers, and 50000000"
                    ),
                ),
                (HEADER, "line 6: found 'NODATA_value -9999'; expected 4 heights"),
                ("\n", "line 0: no header; expected ncols and a number"),
            ]
        ),
        *(
            ("ground.npy", heights, 1.0, message)
            for heights, message in [
                (np.zeros(5), r"found \(5,\) float64; expected numbers in rows and columns"),
                (np.zeros((3, 3), "U2"), r"found \(3, 3\) <U2"),
                (
                    np.array([[1, -9999], [2, 3]]),
                    (
                        "ground.npy: row 1, column 2: found -9999; expected heights "
                        "from -500 to 9000 m, NaN or"
                    ),
                ),
                (
                    np.array([[1, 2], [1e308, -3.4e38]]),
                    (
                        r"row 2, column 1: found 1e\+308 and 1 more such; "
                        r"expected heights"
                    ),
                ),
            ]
        ),
        ("ground.npy", b"junk", 1.0, "ground.npy: cannot be read: .*numbers"),
        ("ground.npy", b"", 1.0, "ground.npy: an empty file"),
        ("ground.npy", b"PK\3\4" + bytes(40), 1.0, "ground.npy: cannot be read: the magic string .*numbers"),
        (
            "ground.npy",
            b"\x93NUMPY\1\0\x10\0{'descr': '<f8',  ",
            1.0,
            "ground.npy: cannot be read: .*numbers",
        ),
        ("ground.npy", b"", None, "an array alone does not say where it lies; expected cell_m and corner_m"),
        ("ground.asc", b"", 1.0, "ground.asc: found cell_m or corner_m; expected neither"),
        ("ground.asc", b"ncols \xff", None, "no UTF-8 text at byte 6; expected an ESRI ASCII grid"),
        ("ground.xyz", b"", None, "found the ending '.xyz'; expected .asc, .npy, .tif or .tiff"),
        ("absent.asc", None, None, "absent.asc: no such file or directory; expected an ESRI ASCII grid"),
    ],
)
def test_what_is_no_grid_of_heights_is_refused(tmp_path, name, content, cell_m, message):
    """Broken, missing and unknown files, arrays of something else, and grids placed twice or not at all, are
    refused in one line.

    What is wrong with a text is reported with the file, the line, what was found and what was expected.
    """
    if isinstance(content, np.ndarray):
        np.save(tmp_path / name, content)
    elif content is not None:
        (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(GeometryError, match=message):
        read(tmp_path / name, cell_m, cell_m and (0.0, 0.0))


def test_ground_that_is_written_is_read_as_it_was(tmp_path):
    """Every cell of a written grid has the height at its own centre, to half a millimetre, and lies where
    it was."""

    def plane(x_m, y_m):
        return 0.1 * x_m - 0.05 * y_m + 3.0

    path = tmp_path / "ground.asc"
    with path.open("wb") as file:
        write_ascii(file, plane, np.array([-10.1, 3.0]), np.array([-2.0, 7.4]), 0.25)
    grid = read_grid(path, cell_m=None, corner_m=None)
    assert (grid.west_m, grid.north_m, grid.heights_m.shape) == (-10.25 + 0.125, 7.5 - 0.125, (18, 33))
    north_m, east_m = np.meshgrid(*(np.arange(n) * 0.25 for n in grid.heights_m.shape), indexing="ij")
    assert grid.heights_m == pytest.approx(plane(grid.west_m + east_m, grid.north_m - north_m), abs=6e-4)


OBLONG = HEADER.replace("cellsize 10", "dx 10.0000123\ndy 9.9999877")


@pytest.mark.parametrize(
    "text",
    [
        OBLONG + ROWS,
        HEADER.replace("cellsize 10", "DY 5\nDX 10") + ROWS,
        CENTRES.replace("cellsize 10", "dx 10\ndy 5") + ROWS,
        HEADER + "1 2 3\n4 5 6 7\n8\n9 10 11 12\n",
        HEADER + ROWS.replace("\n", " "),
        HEADER + ROWS.replace(" ", "\n"),
        HEADER + ROWS.replace(" ", "\t"),
    ],
)
def test_a_text_is_read_as_gdal_reads_it(tmp_path, text):
    """Oblong cells by `dx` and `dy`, and rows that are wrapped, joined or one height to a line, are at the
    places and have the heights of GDAL's driver AAIGrid."""
    rasterio = pytest.importorskip("rasterio")
    path = write(tmp_path, text)
    grid = read_grid(path, cell_m=None, corner_m=None)
    with rasterio.open(path) as file:
        width_m, _, west_m, _, minus_m, north_m = file.transform[:6]
        np.testing.assert_array_equal(grid.heights_m, file.read(1))
    assert grid.cell_m == pytest.approx((width_m, -minus_m), abs=1e-12)
    assert (grid.west_m, grid.north_m) == pytest.approx((west_m + width_m / 2, north_m + minus_m / 2))
    x_m, y_m = grid.west_m + np.arange(4) * width_m, grid.north_m + np.arange(3) * minus_m
    assert read(path).height_m(*np.meshgrid(x_m, y_m)) == pytest.approx(grid.heights_m, abs=1e-12)


def test_a_geotiff_with_oblong_cells_is_read_as_gdal_reads_it(tmp_path):
    """Cells of 10 by 5 m have their heights where the file puts them."""
    rasterio = pytest.importorskip("rasterio")
    path = tmp_path / "ground.tif"
    heights = np.arange(12, dtype=np.float32).reshape(3, 4)
    size = {"width": 4, "height": 3, "transform": rasterio.Affine(10.0, 0.0, 100.0, 0.0, -5.0, 230.0)}
    with rasterio.open(path, "w", driver="GTiff", count=1, dtype="float32", crs="EPSG:25832", **size) as file:
        file.write(heights, 1)
        x_m, y_m = file.xy(*np.indices(heights.shape).reshape(2, -1))
    assert read(path).height_m(np.array(x_m), np.array(y_m)).tolist() == heights.ravel().tolist()


@pytest.fixture
def rimmed(tmp_path):
    """Random heights, the same in a rim of two cells without, and the same in a disc of 25 m."""
    heights = np.random.default_rng(2).normal(size=(60, 60)).cumsum(axis=0)
    row, column = np.indices(heights.shape)
    disc = np.where(np.hypot(row - 29.5, column - 29.5) <= 25.0, heights, np.nan)
    (tmp_path / "rim").mkdir()
    (tmp_path / "disc").mkdir()
    rim = dem_of(np.pad(heights, 2, constant_values=np.nan), tmp_path / "rim", 1.0, (-2.5, -2.5))
    return dem_of(heights, tmp_path), rim, dem_of(disc, tmp_path / "disc")


def test_a_rim_without_heights_is_the_end_of_the_grid(rimmed, caplog):
    """A grid in a rim of cells without heights has the ground and the warning of the grid alone, with the
    rows and columns of its file."""
    bare, rim, _ = rimmed
    x, y = np.random.default_rng(3).uniform(-10, 70, (2, 2_000))
    assert np.array_equal(bare.height_m(x, y), rim.height_m(x, y))
    path = np.array([[10.0, 30.0], [50.0, 30.0]])
    for dem, edge in ((bare, "column 1 at x = 0.0 m"), (rim, "column 3 at x = 0.0 m")):
        caplog.clear()
        dem.check(path, 12.0)
        assert f"ends in {edge}" in caplog.text
        assert "9.0 m from the path" in caplog.text


def test_a_round_plot_is_taken_and_its_rim_is_named(rimmed, caplog):
    """Inside a round plot the ground is that of the whole grid, two cells from its rim; a rim in sight is a
    warning, and ground goes on with the nearest height."""
    bare, _, disc = rimmed
    x, y = np.random.default_rng(4).uniform(10, 50, (2, 5_000))
    inside = np.hypot(x - 29.5, y - 29.5) < 25.0 - 3.0
    assert np.array_equal(bare.height_m(x[inside], y[inside]), disc.height_m(x[inside], y[inside]))
    path = np.array([[20.0, 30.0], [40.0, 30.0]])
    disc.check(path, 8.0)
    assert caplog.text == ""
    disc.check(path, 20.0)
    assert "ends in front of row " in caplog.text
    assert "goes on level from there; the sensor sees 20 m" in caplog.text
    assert np.isfinite(disc.height_m(np.array([1.0, -50.0]), np.array([1.0, -50.0]))).all()


@pytest.mark.parametrize("path", [[[8.0, 8.0]], [[30.0, 30.0], [10.0, 10.0]], [[7.0, 45.0], [45.0, 7.0]]])
def test_a_path_over_a_rim_is_refused(rimmed, path):
    """A path that begins, ends or crosses where a plot has no heights is refused; so it is by
    `has_heights` at its ends."""
    disc = rimmed[2]
    path_m = np.array(path)
    with pytest.raises(GeometryError, match=r"no height at .* on the path; expected ground under the whole"):
        disc.check(path_m, 5.0)
    assert not disc.has_heights(path_m, 5.0).all()


def test_a_hole_in_a_plot_is_no_rim(rimmed, tmp_path):
    """A cell without a height amid the heights of a round plot is refused as before, by its row and column
    in the file."""
    heights = np.pad(np.zeros((20, 20)), 3, constant_values=np.nan)
    heights[12, 9] = np.nan  # in the file row 13, column 10
    dem = dem_of(heights, tmp_path)
    with pytest.raises(GeometryError, match=r"row 13, column 10: no height at \(9.0, 13.0\) m, 4.0 m from"):
        dem.check(np.array([[13.0, 13.0], [15.0, 13.0]]), 2.0)
