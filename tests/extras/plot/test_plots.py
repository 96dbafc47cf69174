"""Contents of plots, read back from their artists and files."""

import io
import json
import re
import sys
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from PIL import Image

from vlp16emu.errors import InputError
from vlp16emu.extras.plot.page import page_of
from vlp16emu.extras.plot.sheet import figure_of, picture_of, plotting

pytest.importorskip("matplotlib", reason="the extra plot is not installed")

NAMES = "mean_error_m", "range_rmse_m"
STEMS = {
    "id": [3, 4],
    "species": ["silver_birch", "norway_spruce"],
    "x_m": [2.0, 8.0],
    "y_m": [1.0, -9.0],
    "z_m": [0.5, 1.0],
    "height_m": [18.0, 22.0],
    "crown_base_m": [9.0, 4.0],
    "crown_width_m": [3.0, 5.0],
    "dbh_m": [0.2, 0.4],
    "along_m": [2.0, 8.0],
    "aside_m": [1.0, 9.0],
}
FOREST = {
    "report": "forest",
    "scene": "wood",
    "title": "A wood",
    "seed": 1,
    "radius_m": 10.0,
    "path": {"length_m": 10.0},
    "stems": STEMS,
    "ground": {
        "west_m": -10.0,
        "south_m": -10.0,
        "cell_m": 10.0,
        "heights_m": [[0.0, 1.0, 2.0], [1.0, 2.0, 3.0]],
    },
    "profile": {
        "distance_m": [0, 5, 10],
        "x_m": [0, 5, 10],
        "y_m": [0, 0, 0],
        "sensor_m": [2, 2.5, 3],
        "ground_m": [0, 0.5, 1],
    },
}
PATH = {
    "time_s": [0.0, 1.0, 2.0],
    "distance_m": [0.0, 1.5, 3.0],
    "true_x_m": [0.0, 1.5, 3.0],
    "true_y_m": [0.0, 0.0, 0.0],
    "found_x_m": [0.0, 1.5, 3.1],
    "found_y_m": [0.0, 0.1, 0.2],
    "error_m": [0.0, 0.1, 0.2],
    "drift_over_m": 10.0,
    "drift_at_m": [10.0, 11.0],
    "drift_percent": [1.0, 2.0],
}


def row(name, us, error_m, *, in_use=False, ends=(0.5, 2.0)):
    """One setting of the beam, whose intervals end at multiples of its errors."""
    return {
        "model": name.partition(" ")[0],
        "name": f"beam.model={name}",
        "in_use": in_use,
        "us_per_pulse": us,
        "us_spread": 0.2,
        "errors": {"pulses": 4096, **dict.fromkeys(NAMES, error_m)},
        "intervals": dict.fromkeys(NAMES, ends and [end * error_m for end in ends]),
    }


def accuracy():
    """Errors of three settings; the second one is in use and suggested."""
    rows = [
        row("none", 1.0, 0.2),
        row("fixed rays=8", 3.0, 0.05, in_use=True),
        row("fixed rays=64", 20.0, 0.01, ends=None),
    ]
    means = {"with a return, %": {"value": 80.0, "off": -1.0, "half": 0.5}}
    explicit = {"with a return, %": {"value": 81.0, "off": 0.0, "half": 0.0}}
    worlds = [
        {"name": "world.near_m=15", "in_use": True, "us_per_pulse": 3.0, "means": means},
        {"name": "world.near_m=inf", "in_use": False, "us_per_pulse": 9.0, "means": explicit},
    ]
    choices = [{"wanted_m": 0.05, "take": "beam.model=fixed rays=8"}]
    return {
        "report": "accuracy",
        "scene": "wood",
        "seed": 1,
        "rows": rows,
        "foliage": worlds,
        "choices": choices,
    }


def tree(kind, x_m, dbh_m, range_m, dbh_error_m=None):
    """One tree of a score."""
    names = ("true_id", "list_line", "found_number", "position_error_m", "hits")
    place = {"x_m": x_m, "y_m": 2.0, "true_dbh_m": dbh_m, "range_m": range_m, "dbh_error_m": dbh_error_m}
    return {"kind": kind, **dict.fromkeys(names, ""), **place}


def score():
    """Scores of a path of three poses, and of three trees."""
    trees = [tree("found", 1.0, 0.3, 2.0, 0.01), tree("missed", 2.0, 0.1, 9.0), tree("false", 3.0, None, 4.0)]
    scores = {"ate_m": 0.129, "drift_10m_percent": 1.5, "stem_f1": 0.5, "chamfer_m": None}
    about = {
        "inputs": {"truth": "truth", "map": None},
        "reference": {"title": "A <wood>", "seed": 7, "world": "forest"},
    }
    head = {
        "report": "score",
        "written_by": "vlp16emu 0",
        "notes": {"stems": "all"},
        "missed": ["ate_m is 1"],
    }
    return {**head, **about, "scores": scores, "path": PATH, "trees": trees}


def compare():
    """Two captures with one histogram; one of two statistics differs."""
    statistic = {"text": "beat", "first": 1.0, "second": 3.0}
    rows = [
        {"name": "a", "distance": 2.0, "apart": True} | statistic,
        {"name": "b", "distance": 0.5, "apart": False} | statistic,
    ]
    counts = {"first_values": 4, "second_values": 0}
    shares = {"edges": [0.0, 1.0, 2.0], "first": [0.25, 0.75], "second": None}
    histograms = [{"name": "range noise", "unit": "mm"} | shares | counts]
    return {
        "report": "compare",
        "files": ["x/a.pcap", "b.pcap"],
        "apart": ["a"],
        "statistics": rows,
        "histograms": histograms,
    }


def plan():
    """Costs of two stages."""
    stages = [{"name": "cast, near", "cpu_s_per_s": 0.3}, {"name": "pack", "cpu_s_per_s": 0.1}]
    measured, stream = {"real_time_factor": 2.0}, {"verdict": "yes"}
    head = {"report": "plan", "scene": "wood", "seed": 1, "threads": 2}
    return {**head, "stages": stages, "measured": measured, "stream": stream}


REPORTS = {"accuracy": accuracy, "score": score, "compare": compare, "plan": plan, "forest": lambda: FOREST}


@pytest.fixture
def drawn():
    """Draw a report, and give its artists by id."""

    def draw(report):
        artists = {artist.get_gid(): artist for artist in figure_of(report).findobj() if artist.get_gid()}
        assert artists
        return artists

    return draw


def test_errors_stand_at_their_run_time_with_intervals(drawn):
    """Each setting is at its run time and error in mm, its bar ends at the interval, and the one in use
    and the suggestion are marked."""
    artists = drawn(accuracy())
    for name in NAMES:
        assert artists[f"{name}-none"].get_xydata().tolist() == [[1.0, 200.0]]
        assert artists[f"{name}-fixed"].get_xydata() == pytest.approx(np.array([[3.0, 50.0], [20.0, 10.0]]))
        assert artists[f"{name}-in-use"].get_xydata() == pytest.approx(np.array([[3.0, 50.0]]))
    assert artists["suggested-50"].get_xydata() == pytest.approx(np.array([[3.0, 50.0]]))
    assert artists["world-0"].get_ydata() == pytest.approx([-100 / 81, 0.0])
    (panel,) = (axes for axes in figure_of(accuracy()).axes if axes.get_ylabel().startswith("RMSE"))
    bars = [bar.get_segments() for bar in panel.collections]
    ends = {tuple(np.round(segment[:, 1], 6)) for segments in bars for segment in segments if len(segment)}
    assert {(100.0, 400.0), (25.0, 100.0)} <= ends
    assert any("wider than a factor of ten" in text.get_text() for text in panel.texts)


def test_a_score_shows_path_errors_and_stems(drawn):
    """The estimate, its errors in cm over time and distance, the drift, and stems by kind, DBH and range
    are those of the report."""
    artists = drawn(score())
    assert artists["found-path"].get_xydata().tolist() == [[0.0, 0.0], [1.5, 0.1], [3.1, 0.2]]
    for name in ("time_s", "distance_m"):
        assert artists[f"error-over-{name}"].get_xdata().tolist() == PATH[name]
        assert artists[f"error-over-{name}"].get_ydata() == pytest.approx([0.0, 10.0, 20.0])
    assert artists["drift"].get_ydata().tolist() == [1.0, 2.0]
    for kind, x_m in (("found", 1.0), ("missed", 2.0), ("false", 3.0)):
        assert artists[f"stems-{kind}"].get_offsets().tolist() == [[x_m, 2.0]]
    assert artists["dbh-errors"].get_offsets().data == pytest.approx(np.array([[30.0, 1.0]]))
    for name, classes in (("true_dbh_m", (10.0, 30.0)), ("range_m", (2.0, 9.0))):
        figure = figure_of(score())
        bars = [
            patch for axes in figure.axes for patch in axes.patches if patch.get_gid() == f"missed-by-{name}"
        ]
        at = [bar.get_x() for bar in bars if bar.get_height()]
        assert at == pytest.approx([min(classes) if name == "true_dbh_m" else max(classes) - (7 / 8)])


def test_a_score_without_a_path_or_stems_draws_the_rest(drawn):
    """With stems alone nothing is drawn of a path, and with a path shorter than the drift's length its
    panel says so."""
    assert "found-path" not in drawn({**score(), "path": None})
    short = {**score(), "trees": [], "path": {**PATH, "drift_at_m": [], "drift_percent": []}}
    assert "drift" not in drawn(short)
    assert any(
        text.get_text() == "path shorter than 10 m" for axes in figure_of(short).axes for text in axes.texts
    )


def test_histograms_have_the_shares_of_both_captures(drawn):
    """The steps of a capture are its shares in percent; one without the quantity is named, and what
    differs has another colour."""
    artists = drawn(compare())
    assert artists["histogram-0-first"].get_data().values.tolist() == [25.0, 75.0]
    assert "histogram-0-second" not in artists
    (texts,) = (
        [text.get_text() for text in axes.get_legend().get_texts()] for axes in figure_of(compare()).axes[:1]
    )
    assert texts == ["a.pcap: 4", "b.pcap: none"]
    assert artists["distance-a"].get_width() == 2.0
    assert artists["distance-a"].get_facecolor() != artists["distance-b"].get_facecolor()


def test_a_plan_has_a_bar_for_each_stage(drawn):
    """The length of a bar is the cost of its stage, and the title has their sum."""
    artists = drawn(plan())
    assert artists["stage-cast, near"].get_width() == 0.3
    assert artists["stage-pack"].get_width() == 0.1
    assert "0.40 core seconds" in figure_of(plan()).get_suptitle()


def test_a_forest_has_stems_by_size_crowns_path_and_relief(drawn):
    """Marks are at the stems and grow with the DBH; crowns have their width, contours their heights, and
    the profile holds near trees only."""
    artists = drawn(FOREST)
    birch, spruce = artists["stems-silver_birch"], artists["stems-norway_spruce"]
    assert birch.get_offsets().tolist() == [[2.0, 1.0]]
    assert spruce.get_sizes()[0] == 2 * birch.get_sizes()[0]
    assert artists["crowns"].get_widths().tolist() == [3.0, 5.0]
    assert artists["path"].get_xydata().tolist() == [[0, 0], [5, 0], [10, 0]]
    assert set(artists["relief"].levels) <= {0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0}
    assert artists["profile-sensor"].get_ydata().tolist() == [2, 2.5, 3]
    (stem,) = artists["profile-stems"].get_segments()
    assert stem.tolist() == [[2.0, 0.5], [2.0, 18.5]]


def test_stems_that_the_path_hardly_sees_are_hollow(drawn):
    """With the share of seen bark, a stem under a half is white, and the others keep their colour."""
    artists = drawn({**FOREST, "stems": {**STEMS, "bark_seen": [0.4, 0.6]}})
    assert artists["stems-silver_birch"].get_facecolor().tolist() == [[1.0, 1.0, 1.0, 1.0]]
    assert artists["stems-norway_spruce"].get_facecolor().tolist() != [[1.0, 1.0, 1.0, 1.0]]


def test_a_hall_has_walls_things_and_the_sensor(drawn):
    """Walls and things are rectangles of their sizes, and the sensor is at its place."""
    crate = {"name": "crate", "kind": "other", "place_m": [2.0, 1.0, 0.5], "size_m": [2.0, 1.0, 1.0]}
    report = {
        "report": "forest",
        "scene": "hall",
        "title": "A hall",
        "named": [crate],
        "hall_m": [10.0, 6.0, 3.0],
    }
    artists = drawn(
        {**report, "path": {"start_m": [0.5, 0.0, 1.5], "end_m": [0.5, 0.0, 1.5], "length_m": 0.0}}
    )
    assert artists["walls"].get_bbox().bounds == (-5.0, -3.0, 10.0, 6.0)
    assert artists["thing-crate"].get_bbox().bounds == (1.0, 0.5, 2.0, 1.0)
    assert artists["sensor"].get_xydata().tolist() == [[0.5, 0.0]]


@pytest.mark.parametrize("verb", REPORTS)
def test_files_are_the_same_again_and_without_a_date(verb):
    """A report has the same bytes each time in all formats; SVG has its text as text and ids, PDF and SVG
    have no date."""
    report = REPORTS[verb]()
    png, svg, pdf = (picture_of(report, suffix) for suffix in (".png", ".svg", ".PDF"))
    assert [picture_of(report, suffix) for suffix in (".png", ".svg")] == [png, svg]
    with Image.open(io.BytesIO(png)) as image:
        assert min(image.size) >= 500
    texts = "".join(ET.fromstring(svg).itertext())
    figure = figure_of(report)
    assert figure.get_suptitle().splitlines()[0] in texts
    assert 'id="' + next(artist.get_gid() for artist in figure.findobj() if artist.get_gid()) in svg.decode()
    assert pdf.startswith(b"%PDF")
    assert not re.search(rb"20\d\d-\d\d-\d\dT|CreationDate|<dc:date>", svg + pdf)


def test_a_user_style_changes_nothing(monkeypatch):
    """Settings of matplotlib that a user has made do not reach a picture, and stay as they are."""
    import matplotlib as mpl

    had_windows = "matplotlib.pyplot" in sys.modules
    expected = picture_of(plan(), ".svg")
    monkeypatch.setitem(mpl.rcParams, "font.size", 33.0)
    monkeypatch.setitem(mpl.rcParams, "svg.hashsalt", "other")
    assert picture_of(plan(), ".svg") == expected
    assert mpl.rcParams["font.size"] == 33.0
    assert ("matplotlib.pyplot" in sys.modules) is had_windows


def test_a_page_needs_nothing_else():
    """A page has each score with its meaning, what was scored and against what, the version, and the
    picture inside; text is escaped."""
    page = page_of(score())
    assert re.findall(r"(?:src|href)=\"([^:\"]*):", page) == ["data"]
    assert "http" not in page.replace(re.search(r"base64,[^\"]*", page)[0], "")
    assert "<td>ate_m</td><td class=n>0.129</td><td>RMSE of positions, m</td>" in page
    assert "<td>chamfer_m</td><td>not known</td>" in page
    assert "A &lt;wood&gt;, seed 7" in page
    assert "vlp16emu 0" in page
    assert '<p class="missed">missed: ate_m is 1</p>' in page
    assert page.count("<td>missed</td>") == 1
    assert "<img" not in page_of({**score(), "path": None, "trees": []})


def test_every_score_has_a_meaning():
    """No score that the measures give is without a text on the page."""
    from vlp16emu.extras.plot.page import _meaning
    from vlp16emu.extras.score import measures

    one = np.ones((1, 2, 3))
    names = {
        *measures.cloud_distances(one[0], one[0], (0.05,)),
        *measures.stem_scores([], [], []),
        *measures.leaf_wood_scores(np.ones(1, int), np.ones(1, int)),
        *measures.instance_scores(np.ones(1, int), np.ones(1, int)),
        *measures.box_scores(one, np.ones(1, int), one),
    }
    assert [name for name in names if not _meaning(name)] == []


def test_an_earlier_plot_stays_until_the_new_one_is_complete(tmp_path):
    """A report that cannot be drawn leaves the file of before, and nothing beside it."""
    path = tmp_path / "a.svg"
    path.write_text("earlier")
    with pytest.raises(InputError), plotting(path) as draw:
        draw({"report": "plan"})
    assert [(one.name, one.read_text()) for one in tmp_path.iterdir()] == [("a.svg", "earlier")]
    with plotting(path) as draw:
        draw(json.loads(json.dumps(plan())))
    assert path.read_bytes() == picture_of(plan(), ".svg")
