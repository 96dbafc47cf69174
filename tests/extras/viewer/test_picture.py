"""Pictures of what a sensor sees, without a browser."""

import json

import numpy as np
import pytest

from vlp16emu.cli.app import run
from vlp16emu.emulator import Emulator
from vlp16emu.extras.viewer.picture import Canvas, LaserRows, Oblique

Image = pytest.importorskip("PIL.Image", reason="the extra picture is not installed")
pytest.importorskip("matplotlib", reason="the extra picture is not installed")

SMALL = ["--size", "320x200", "--duration", "0.4", "--set", "beam.model=none"]
HALL = """
schema = 1
title = "Two boxes, ahead and to the left"
seed = 1
duration_s = 1.0
motion = { kind = "static", x_m = 0.0, y_m = 0.0 }
beam = { model = "none" }

[world]
kind = "hall"
length_m = 24.0
width_m = 24.0
height_m = 6.0
wall_reflectance = 0.05
boxes = [
    { name = "ahead", centre_m = [4.5, 0.0, 1.5], size_m = [1.0, 1.0, 3.0], reflectance = 0.9 },
    { name = "left", centre_m = [0.0, 6.5, 1.5], size_m = [1.0, 1.0, 3.0], reflectance = 0.9 },
]
"""
BOX_M = np.array([[-10.0, -10.0, 0.0], [10.0, 10.0, 5.0]])


def test_lengths_are_the_same_all_over_an_oblique_view():
    """From the south, 10 m to the east are as many pixels wherever they lie, and what is nearer to the eye is so by its height and place."""
    view = Oblique(180.0, 30.0, (640, 400), BOX_M)
    for place in ((0.0, 0.0, 0.0), (-5.0, 8.0, 4.0)):
        column, row, _ = view.pixels(np.array([place, np.add(place, (10.0, 0, 0))]))
        assert abs(column[1] - column[0] - 10 * view.px_per_m) <= 1
        assert row[0] == row[1]
    _, row, near_m = view.pixels(np.array([[0.0, -5.0, 0.0], [0.0, 5.0, 0.0], [0.0, 5.0, 5.0]]))
    assert near_m[0] > near_m[1]
    assert row[0] > row[1] > row[2]  # the near one is lower in the picture, the high one higher


def test_what_is_nearer_hides_what_is_behind():
    """Of two points at one pixel the nearer one is seen, in whichever order they come."""
    view = Oblique(180.0, 30.0, (64, 64), BOX_M)
    up = np.array([0.0, -np.cos(np.radians(30)), np.sin(np.radians(30))])  # towards the eye
    points_m, rgb = np.stack([np.zeros(3), 3 * up]), np.array([[255, 0, 0], [0, 255, 0]], np.uint8)
    for order in ([0, 1], [1, 0]):
        canvas = Canvas(view)
        for one in order:
            canvas.add(points_m[[one]], rgb[[one]])
        seen = canvas.image().reshape(-1, 3)
        assert (seen[:, 1] > 100).any()
        assert not (seen[:, 0] > 100).any()


@pytest.mark.parametrize("rings", [8, 16, 300])
def test_each_laser_has_its_row(rings):
    """The highest ring lies above, azimuths go from left to right, and rows fill their space, though there be more of them than pixels."""
    view = LaserRows((640, 200), rings)
    ring = np.arange(rings, dtype=float)
    column, row, _ = view.pixels(np.column_stack([np.full(rings, 90.0), ring, ring]))
    assert (column == view.left + view.width // 4).all()
    assert (np.diff(row) <= 0).all()
    assert row[-1] == view.top
    assert view.top + view.height <= row[0] + view.dot_px[1] <= view.top + view.height + view.dot_px[1]


@pytest.mark.parametrize("view", ["sweep", "image"])
def test_a_view_of_a_revolution_is_of_one(tmp_path, view, capsys):
    """As a picture the first revolution is drawn; as a film each one by itself: its last frame is that revolution's."""
    pytest.importorskip("imageio_ffmpeg", reason="the extra picture is not installed")
    made = {}
    for name in ("a.png", "a.gif"):
        words = ["picture", "static_bench", str(tmp_path / name), "--view", view, "--colour", "range", "--json"]
        assert run([*words, *SMALL]) == 0
        made[name] = json.loads(capsys.readouterr().out)
    assert made["a.png"]["revolutions"] == 1
    assert made["a.gif"]["revolutions"] == 4
    with Image.open(tmp_path / "a.gif") as film:
        shown = []
        for number in (0, 3):
            film.seek(number)
            shown.append((np.array(film.convert("L")) > 60).sum())
    assert shown[0] == pytest.approx(shown[1], rel=0.2)  # nothing adds up


def test_a_sweep_lies_ahead_upwards(tmp_path):
    """From above, a box ahead of the sensor is over its middle and one to its left at the left, both at their ranges."""
    scene = tmp_path / "two.toml"
    scene.write_text(HALL)
    words = ["--view", "sweep", "--size", "400x400", "--duration", "0.3", "--colour", "reflectivity"]
    assert run(["picture", str(scene), str(tmp_path / "a.png"), *words]) == 0
    with Image.open(tmp_path / "a.png") as image:
        rgb = np.array(image.convert("RGB")).astype(int)
    row, column = np.nonzero((rgb[..., 1] > 180) & (rgb[..., 2] < 120))  # of bright points, not of text
    row, column = row[column < 370], column[column < 370]  # where the scale is
    ahead = (np.abs(column - 200) < 40) & (row < 160)
    left = (np.abs(row - 200) < 40) & (column < 160)
    assert ahead.sum() > 20
    assert left.sum() > 20
    assert ahead.sum() + left.sum() > 0.95 * len(row)
    # The boxes are 4 and 6 m away, on one scale.
    assert (200 - row[ahead].max()) / (200 - column[left].max()) == pytest.approx(4 / 6, abs=0.1)


@pytest.mark.parametrize("colour", ["natural", "class", "instance", "range"])
def test_a_scene_becomes_a_picture(tmp_path, colour):
    """The picture has the size that is wanted and many colours, and the same bytes again."""
    for name in ("a.png", "b.png"):
        assert run(["picture", "static_bench", str(tmp_path / name), "--colour", colour, *SMALL]) == 0
    with Image.open(tmp_path / "a.png") as image:
        assert image.size == (320, 200)
        assert len(np.unique(np.array(image.convert("RGB")).reshape(-1, 3), axis=0)) > 20
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_a_film_has_a_frame_for_each_revolution(tmp_path):
    """0.4 s of a hall are four whole revolutions and four frames."""
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="the extra picture is not installed")
    for file in (tmp_path / "a.gif", tmp_path / "a.mp4"):
        assert run(["picture", "static_bench", str(file), *SMALL]) == 0
    with Image.open(tmp_path / "a.gif") as film:
        assert film.n_frames == 4
    assert ffmpeg.count_frames_and_secs(str(tmp_path / "a.mp4"))[0] == 4


def test_a_capture_is_drawn_by_its_trajectory(tmp_path):
    """By its truth a capture gives a picture of all its revolutions, without it of the first one."""
    emulator = Emulator("static_bench", {"beam.model": "none"})
    emulator.record(tmp_path / "a.pcap", duration_s=0.4, truth=tmp_path / "truth")
    pcap, out = str(tmp_path / "a.pcap"), str(tmp_path / "a.png")
    assert run(["picture", pcap, out, "--trajectory", str(tmp_path / "truth"), "--size", "320x200"]) == 0
    assert run(["picture", pcap, out, "--size", "320x200"]) == 0


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["static_bench", "{out}.jpg"], "found the ending .jpg; expected .png, .gif, .mp4"),
        (
            ["static_bench", "{out}.png", "--colour", "blue", "--duration", "0.3"],
            "--colour: found blue; expected natural",
        ),
        (["static_bench", "{out}.png", "--size", "63x64"], "--size: found 63x64"),
        (["static_bench", "{out}.png", "--from", "400"], "--from: found 400"),
        (["static_bench", "{out}.png", "--from", "40", "--view", "sweep"], "--from: found beside --view sweep"),
        (["static_bench", "{out}.png", "--view", "top"], "--view: found top; expected slant, sweep or image"),
        (["static_bench", "{out}.png", "--duration", "0.05"], "no whole revolution"),
        (["static_bench", "{out}.png", "--trajectory", "x.tum"], "--trajectory: found beside a scene"),
    ],
)
def test_what_cannot_be_drawn_is_refused_in_one_line(tmp_path, capsys, words, line):
    """What is wrong is named, and no file is left."""
    assert run(["picture", *(word.format(out=tmp_path / "a") for word in words)]) == 2
    error = capsys.readouterr().err
    assert line in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())
