"""The sheet with plan and section."""

import io
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from vlp16emu.extras.palette import colour_of_species
from vlp16emu.extras.sheets.sheet import StandSection, draw_sheet, draw_side, legend_entries

TREE = [("x_m", "f8"), ("y_m", "f8"), ("dbh_m", "f8"), ("crown_width_m", "f8"), ("species", "u2")]
SECTION = StandSection(np.array([0.0, 0.0]), np.array([1.0, 0.0]), 20.0, 8.0, -1.0, 9.0)


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
        "near": np.array([(5.0, 5.0, 0.3, 6.0, 3), (15.0, 5.0, 0.3, 4.0, 3), (10.0, -6.0, 0.4, 5.0, 1)], TREE),
        "species": {1: "norway_spruce", 3: "silver_birch"},
        "things": [stone],
        "names": {},
        "bare": SimpleNamespace(height_m=lambda x, y: 0.1 * x + 0.0 * y),
    }
    return SimpleNamespace(**(values | changes))


def sheet(of):
    file = io.BytesIO()
    drawn = np.full((480, 960, 3), 200, np.uint8)
    draw_sheet(file, of, SECTION, drawn, title="A title", subtitle="and a second line")
    return Image.open(file)


def share(picture, colour, tolerance=14):
    """Share of the pixels that have nearly a colour."""
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
    draw_side(axes, survey(field_of_view_deg=(-40.0, 20.0)), SECTION, np.zeros((480, 960, 3), np.uint8))
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
    assert sheet(survey(near=np.zeros(0, TREE), things=[], bare=plain)).width == 1008


def test_a_section_and_its_marks_stay_within_a_small_survey():
    """A strip longer than the plan is shortened about its middle, with room for the marks; a shorter one stays."""
    low_m, high_m = np.array([-5.0, -5.0]), np.array([25.0, 5.0])
    long = StandSection(np.array([-20.0, 0.0]), np.array([1.0, 0.0]), 60.0, 8.0, -1.0, 9.0).within(low_m, high_m)
    assert long.start_xy_m[0] > -5.0
    assert long.start_xy_m[0] + long.length_m / 2 == pytest.approx(10.0)
    assert long.start_xy_m[0] + 1.02 * long.length_m < 25.0
    assert SECTION.within(low_m, high_m).length_m == SECTION.length_m


def test_the_line_of_the_sensor_has_no_gaps():
    """Where the path leaves the strip sideways, the line of its height goes on."""
    axes = Figure().add_subplot()
    along_m = np.linspace(0, 20, 50)
    path_m = np.column_stack([along_m, 6 * np.sin(along_m / 4), np.full(50, 2.0)])
    draw_side(axes, survey(path_m=path_m), SECTION, np.zeros((480, 960, 3), np.uint8))
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), path_m[:, 2])
