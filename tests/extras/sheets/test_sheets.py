"""Sheets of a forest: figures, section, coverage of stems, and the sheet itself."""

import io
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from vlp16emu.errors import InputError
from vlp16emu.extras.plots import colour_of_species
from vlp16emu.extras.sheets.sheet import StandSection, draw_section, draw_sheet, draw_side, legend_entries, strip_along
from vlp16emu.extras.sheets.survey import CELL_M, cells_near, clark_evans, relief, stand_rows, stems_seen
from vlp16emu.extras.truth.slots import SLOT_COLUMNS
from vlp16emu.forest.plants.species import flora
from vlp16emu.forest.stand.stand import TREE
from vlp16emu.types import NO_SURFACE, Hits, PlantPart, Semantic

TREES = np.array(
    [(1, 0.10, 8.0, 0.05, 10.0), (1, 0.30, 20.0, 0.70, 60.0), (7, 0.50, 25.0, 2.00, 130.0)],
    [("species", "u2"), ("dbh_m", "f8"), ("height_m", "f8"), ("stem_m3", "f8"), ("leaf_m2", "f8")],
)


def test_rows_add_up_to_sums_by_hand():
    """Density, quadratic mean diameter, basal area, volume and leaf area follow from the trees and the area."""
    birch, oak, together = stand_rows(TREES, {1: "silver_birch", 7: "english_oak"}, 500.0)
    assert (birch["species"], oak["species"], together["species"]) == ("silver_birch", "english_oak", "all")
    assert (birch["stems"], birch["stems_per_ha"]) == (2, 40.0)
    assert birch["dbh_mean_cm"] == pytest.approx(100 * np.sqrt((0.01 + 0.09) / 2))
    assert (birch["dbh_min_cm"], birch["dbh_max_cm"]) == (10.0, 30.0)
    assert birch["basal_area_m2_per_ha"] == pytest.approx(np.pi / 4 * 0.10 * 20)
    assert together["stem_m3_per_ha"] == pytest.approx(2.75 * 20)
    assert together["leaf_area_index"] == pytest.approx(200 / 500)
    assert together["height_max_m"] == 25.0
    # A pure stand has one row, and a bare plain has none.
    assert [row["species"] for row in stand_rows(TREES[:2], {1: "silver_birch"}, 500.0)] == ["silver_birch"]
    assert stand_rows(TREES[:0], {}, 500.0) == []


def test_clark_evans_knows_lattices_and_rain():
    """A square lattice has index 2, a triangular one 2.149, and points that fall like rain 1."""
    square = np.stack(np.meshgrid(np.arange(40.0), np.arange(40.0)), axis=-1).reshape(-1, 2)
    inner = square[((square > 9.5) & (square < 29.5)).all(axis=1)]
    assert clark_evans(inner, square, 400.0) == pytest.approx(2.0)
    triangle = square * [1.0, np.sqrt(3) / 2] + np.where(square[:, 1:] % 2 == 1, [0.5, 0.0], [0.0, 0.0])
    inner = triangle[((square > 9.5) & (square < 29.5)).all(axis=1)]
    assert clark_evans(inner, triangle, 400 * np.sqrt(3) / 2) == pytest.approx(2.1491, abs=1e-4)
    rain = np.random.default_rng(3).uniform(0, 100, (10_000, 2))
    inner = rain[((rain > 10) & (rain < 90)).all(axis=1)]
    assert clark_evans(inner, rain, 6400.0) == pytest.approx(1.0, abs=0.02)  # sigma 0.26 / sqrt(6400) / 0.5


def test_cells_cover_the_surroundings_of_a_way():
    """Cells within 20 m of a straight way of 50 m cover a rectangle and two half circles."""
    way = np.column_stack([np.linspace(0, 50, 501), np.zeros(501)])
    cells = cells_near(way, 20.0)
    assert len(cells) * CELL_M**2 == pytest.approx(50 * 40 + np.pi * 400, rel=2e-3)


def test_relief_of_a_plane_is_its_slope():
    """On a plane that rises 3 in 4 the slope is 36.87 degrees everywhere, whichever way it faces."""
    cells = cells_near(np.zeros((1, 2)), 10.0)
    found = relief(cells, lambda x, y: 0.75 * (0.6 * x + 0.8 * y))
    assert found["slope_mean_deg"] == pytest.approx(np.degrees(np.arctan(0.75)))
    assert found["slope_max_deg"] == pytest.approx(found["slope_mean_deg"])
    assert found["high_m"] == pytest.approx(7.5, abs=0.3)
    assert found["low_m"] == pytest.approx(-found["high_m"])


pa = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")


@pytest.fixture(scope="module")
def trees():
    """Two straight stems, the second leaning, with crowns from 5.3 m up: ten cells of 0.5 m over 0.3 m."""
    trees = np.zeros(2, TREE)
    trees["id"], trees["species"] = [900, 300], flora().trees["silver_birch"].number
    trees["x_m"], trees["z_m"], trees["dbh_m"], trees["height_m"] = [10.0, 20.0], 2.0, 0.4, 18.0
    trees["crown_base_m"], trees["lean_deg"] = 5.3, [0.0, 5.0]
    return trees


def ring(tree, above_m, angle_deg, radius_m=0.2):
    axis_m = np.tan(np.radians(tree["lean_deg"])) * above_m
    angle = np.radians(angle_deg)
    x_m = tree["x_m"] + axis_m + radius_m * np.cos(angle)
    return np.column_stack(np.broadcast_arrays(x_m, radius_m * np.sin(angle), tree["z_m"] + above_m))


def write(path, parts):
    """Write a table of returns at places (n, 3), each with the labels of its part."""
    rows = [(at, semantic, part, number) for places, semantic, part, number in parts for at in places]
    columns = {name: np.zeros(len(rows), kind) for name, kind in SLOT_COLUMNS.items()}
    for axis in range(3):
        columns[f"world_{'xyz'[axis]}_m"] = np.array([row[0][axis] for row in rows])
    for i, name in enumerate(("semantic", "part", "instance"), 1):
        columns[name] = np.array([row[i] for row in rows]).astype(SLOT_COLUMNS[name])
    parquet.write_table(pa.table(columns), path, row_group_size=384)


def test_cells_with_returns_are_counted(tmp_path, trees):
    """Returns all around at breast height show 360 degrees and a tenth of the surface, from half of it half; others count nothing."""
    all_around, half = np.arange(36) * 10.0 + 5.0, np.arange(18) * 10.0 + 5.0
    tree = Semantic.TREE
    write(
        tmp_path / "returns.parquet",
        [
            (np.repeat(ring(trees[0], 1.2, all_around), 20, axis=0), tree, PlantPart.STEM, 900),
            (ring(trees[1], 1.2, half), tree, PlantPart.STEM, 300),
            (ring(trees[1], 4.9, half), tree, PlantPart.STEM, 300),
            (ring(trees[1], 0.1, half), tree, PlantPart.ROOT_FLARE, 300),
            (ring(trees[1], 9.0, half), tree, PlantPart.STEM, 300),
            (ring(trees[0], 3.0, half), tree, PlantPart.LEAF, 900),
            (ring(trees[0], 3.0, half), Semantic.DEADWOOD, PlantPart.STEM, 900),
            (ring(trees[0], 3.0, half), tree, PlantPart.STEM, 901),
        ],
    )
    rows = stems_seen(trees, tmp_path)
    assert rows["returns_stem"].tolist() == [720, 72]
    assert rows["stem_seen"] == pytest.approx([0.1, 0.1])
    assert rows["breast_seen_deg"].tolist() == [360.0, 180.0]


def test_tables_of_several_units_add_up(tmp_path, trees):
    """What one unit sees from the east and another from the west is seen from both."""
    for name, turn in (("returns.parquet", 5.0), ("returns_2.parquet", 185.0)):
        places = ring(trees[0], 1.2, np.arange(18) * 10.0 + turn)
        write(tmp_path / name, [(places, Semantic.TREE, PlantPart.STEM, 900)])
    rows = stems_seen(trees, tmp_path)
    assert rows["breast_seen_deg"].tolist() == [360.0, 0.0]
    assert rows["returns_stem"].tolist() == [36, 0]


def test_truth_of_another_scene_is_refused(tmp_path, trees):
    """Returns that lie metres off the axes of their trees are of another world, and a folder without returns is named."""
    with pytest.raises(InputError, match=r"no returns\.parquet"):
        stems_seen(trees, tmp_path)
    places = ring(trees[0], 1.2, np.arange(36) * 10.0, radius_m=4.0)
    write(tmp_path / "returns.parquet", [(places, Semantic.TREE, PlantPart.STEM, 900)])
    with pytest.raises(InputError, match=r"returns from stems 4\.0 m off the axes"):
        stems_seen(trees, tmp_path)


PAPER = np.array([252, 251, 248])
COLOURS = np.array([[200, 40, 20], [20, 40, 200]], np.uint8)
SECTION = StandSection(np.array([5.0, -3.0]), np.array([0.6, 0.8]), 10.0, 4.0, -1.0, 5.0)


class Wall:
    """A wall right across the strip, `into_m` behind its middle line, red up to 2 m and blue up to 4 m."""

    def __init__(self, into_m):
        self.into_m = into_m

    def cast(self, firings, near_m, far_m):
        _, into_m = SECTION.coordinates(firings.origin_m[..., :2].reshape(-1, 2))
        range_m = self.into_m - into_m.reshape(firings.t_ns.shape)
        z_m = firings.origin_m[..., 2]
        assert np.allclose(firings.direction, [-0.8, 0.6, 0.0])
        hit = (z_m < 4) & (range_m < far_m) & (range_m > near_m)
        surface = np.where(hit, (z_m > 2).astype(np.uint32), NO_SURFACE).astype(np.uint32)
        return Hits.one_ray_each(np.where(hit, range_m, np.inf).astype(np.float32), surface, hit.astype(np.float32))


def draw(into_m, overhang_m=3.0):
    return draw_section(Wall(into_m), SECTION, overhang_m, COLOURS, lambda x, _: np.zeros_like(x), 10.0)


def test_what_stands_there_is_drawn_at_its_height_in_its_colour():
    """Ten pixels per metre: soil below the ground, then red, then blue, then paper, from bottom to top."""
    picture = draw(-2.0)
    assert picture.shape == (60, 100, 3)
    column = picture[::-1, 50].astype(int)
    assert (column[5] == [196, 178, 150]).all()
    assert (column[15] == COLOURS[0]).all()
    assert (column[35] == COLOURS[1]).all()
    assert (column[55] == PAPER).all()
    assert (picture == picture[:, :1]).all()


def test_distance_pales_and_the_overhang_is_seen():
    """Colours fade with distance up to the strip's far side; a wall 2 m before the strip is seen with 3 m of overhang, not with none."""
    near, far, beyond = (draw(into_m)[40, 0].astype(int) for into_m in (-2.0, 2.0, 4.0))
    assert far == pytest.approx(0.45 * near + 0.55 * PAPER, abs=1)
    assert (beyond == far).all()
    assert (draw(-4.0)[40, 0] == COLOURS[0]).all()
    assert (draw(-4.0, overhang_m=0.0)[40, 0] == PAPER).all()


def test_a_strip_follows_the_beginning_of_a_way():
    """The strip begins a little before the way, points along it and holds its beginning."""
    s = np.linspace(0, 300, 301)
    way = np.column_stack([0.6 * s, 0.8 * s, np.full(301, 2.0)])
    strip = strip_along(way, 60.0, 10.0)
    assert strip.along == pytest.approx([0.6, 0.8])
    assert strip.length_m == 60.0
    along_m, into_m = strip.coordinates(way[:, :2])
    assert along_m[0] == pytest.approx(3.6, abs=0.5)
    assert into_m == pytest.approx(0.0, abs=1e-9)
    assert strip.holds(way[:, :2], 0.0).sum() == 57


def test_a_strip_of_a_loop_or_of_a_place_is_one_too():
    """A way that comes back has a strip across it, a short one a strip about its middle, a place one to the east."""
    turn = np.linspace(0, 2 * np.pi, 100)
    loop = np.column_stack([10 * np.cos(turn), 10 * np.sin(turn), np.zeros(100)])
    assert strip_along(loop, 60.0, 10.0).along == pytest.approx([-1.0, 0.0], abs=0.05)
    short = strip_along(np.array([[0.0, 0.0, 1.0], [0.0, 10.0, 1.0]]), 60.0, 10.0)
    assert short.coordinates(np.array([[0.0, 5.0]]))[0] == pytest.approx(30.0)
    stands = strip_along(np.array([[7.0, 2.0, 1.0]]), 60.0, 10.0)
    assert stands.along.tolist() == [1.0, 0.0]
    assert stands.start_xy_m.tolist() == [-23.0, 2.0]


ROWS_OF_TREES = [("x_m", "f8"), ("y_m", "f8"), ("dbh_m", "f8"), ("crown_width_m", "f8"), ("species", "u2")]
SHEET_SECTION = StandSection(np.array([0.0, 0.0]), np.array([1.0, 0.0]), 20.0, 8.0, -1.0, 9.0)


def survey(**changes):
    """A walk of 20 m past two birches, a spruce and a stone."""
    stone = SimpleNamespace(kind="stone", instance=1, place_m=np.array([2.0, -6.0, 0.0]))
    stone.outline_m = np.array([[1.0, -7], [3.0, -7], [2.0, -5]])
    values = {
        "bounds_m": (np.array([-8.0, -8.0]), np.array([28.0, 8.0])),
        "path_m": np.column_stack([np.linspace(0, 20, 50), np.zeros(50), np.full(50, 2.0)]),
        "field_of_view_deg": (-15.0, 15.0),
        "radius_m": 9.0,
        "hall": None,
        "near": np.array([(5.0, 5.0, 0.3, 6.0, 3), (15.0, 5.0, 0.3, 4.0, 3), (10.0, -6.0, 0.4, 5.0, 1)], ROWS_OF_TREES),
        "species": {1: "norway_spruce", 3: "silver_birch"},
        "things": [stone],
        "names": {},
        "bare": SimpleNamespace(height_m=lambda x, y: 0.1 * x + 0.0 * y),
    }
    return SimpleNamespace(**(values | changes))


def sheet(of):
    file = io.BytesIO()
    drawn = np.full((480, 960, 3), 200, np.uint8)
    draw_sheet(file, of, SHEET_SECTION, drawn, title="A title", subtitle="and a second line")
    return Image.open(file)


def share(picture, colour, tolerance=14):
    return (np.abs(np.asarray(picture.convert("RGB"), int) - colour).max(axis=2) <= tolerance).mean()


@pytest.fixture(scope="module")
def picture():
    return sheet(survey())


def test_crowns_have_the_colour_of_their_species_and_their_size(picture):
    """Crowns of two birches, drawn at 42 % over white, cover what discs of their width would, in a file with a palette."""
    assert (picture.format, picture.mode, picture.width) == ("PNG", "P", 1008)
    birch = 0.42 * np.array(colour_of_species("silver_birch")) + 0.58 * np.array([252, 251, 248])
    pixels_per_m = (12.0 - 1.9 - 0.7) * 84 / 40
    expected = np.pi / 4 * (36 + 16) * pixels_per_m**2 / (picture.width * picture.height)
    assert share(picture, birch) == pytest.approx(expected, rel=0.15)


def test_the_way_is_red(picture):
    """The path keeps its colour in spite of the palette, and without a path there is less of it."""
    red = np.array([200, 55, 45])
    assert share(picture, red) > 1.5 * share(sheet(survey(path_m=np.array([[0.0, 0.0, 2.0]]))), red) > 0


def test_the_field_of_view_is_that_of_the_sensor():
    """From the sensor four thin lines lead 12 m to both sides at the elevations of its lowest and highest beam."""
    axes = Figure().add_subplot()
    draw_side(axes, survey(field_of_view_deg=(-40.0, 20.0)), SHEET_SECTION, np.zeros((480, 960, 3), np.uint8))
    rays = [line.get_xydata() for line in axes.lines if np.ptp(line.get_xdata()) == pytest.approx(12.0)]
    slopes_deg = [np.degrees(np.arctan2(b[1] - a[1], abs(b[0] - a[0]))) for a, b in rays]
    assert sorted(slopes_deg) == pytest.approx([-40, -40, 20, 20])
    assert {tuple(a) for a, _ in rays} == {tuple(rays[0][0])}
    assert rays[0][0][1] == 2.0


def test_the_legend_names_what_is_there_and_nothing_else():
    """Species come first, the most frequent at the top, then things of which there are any, then the path."""
    labels = [entry.get_label() for entry in legend_entries(survey())]
    assert labels == ["silver birch", "norway spruce", "stone", "path of the sensor"]


def test_an_empty_plain_can_be_drawn():
    """No trees, no things, no relief: the sheet is drawn all the same."""
    plain = SimpleNamespace(height_m=lambda x, _: np.zeros_like(x))
    assert sheet(survey(near=np.zeros(0, ROWS_OF_TREES), things=[], bare=plain)).width == 1008


def test_a_section_and_its_marks_stay_within_a_small_survey():
    """A strip longer than the plan is shortened about its middle, with room for the marks; a shorter one stays."""
    low_m, high_m = np.array([-5.0, -5.0]), np.array([25.0, 5.0])
    long = StandSection(np.array([-20.0, 0.0]), np.array([1.0, 0.0]), 60.0, 8.0, -1.0, 9.0).within(low_m, high_m)
    assert long.start_xy_m[0] > -5.0
    assert long.start_xy_m[0] + long.length_m / 2 == pytest.approx(10.0)
    assert long.start_xy_m[0] + 1.02 * long.length_m < 25.0
    assert SHEET_SECTION.within(low_m, high_m).length_m == SHEET_SECTION.length_m


def test_the_line_of_the_sensor_has_no_gaps():
    """Where the path leaves the strip sideways, the line of its height goes on."""
    axes = Figure().add_subplot()
    along_m = np.linspace(0, 20, 50)
    path_m = np.column_stack([along_m, 6 * np.sin(along_m / 4), np.full(50, 2.0)])
    draw_side(axes, survey(path_m=path_m), SHEET_SECTION, np.zeros((480, 960, 3), np.uint8))
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), path_m[:, 2])
