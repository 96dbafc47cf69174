"""Pictures of what a sensor sees, without a browser."""

import json
import sys

import numpy as np
import pytest

from vlp16emu import Emulator
from vlp16emu.cli.app import run
from vlp16emu.extras.camera import Orthographic
from vlp16emu.extras.clouds.scan import decode
from vlp16emu.extras.viewer.picture import Drawing, View, laser_rows

Image = pytest.importorskip("PIL.Image", reason="the extra picture is not installed")
pytest.importorskip("matplotlib", reason="the extra picture is not installed")

SMALL = ["--size", "320x200", "--duration", "0.4", "--set", "beam.model=none"]
BOXES = ", ".join(
    f'{{ name = "{name}", centre_m = [{x_m}, {y_m}, 1.5], size_m = [1.0, 1.0, 3.0], reflectance = 0.9 }}'
    for name, x_m, y_m in (("ahead", 4.5, 0.0), ("left", 0.0, 6.5))
)
HALL = (
    f'{{ kind = "hall", length_m = 24.0, width_m = 24.0, height_m = 6.0, wall_reflectance = 0.05, boxes = [{BOXES}] }}'
)
BOX_M = np.array([[-10.0, -10.0, 0.0], [10.0, 10.0, 5.0]])


def test_lengths_are_the_same_all_over_an_oblique_view():
    """From the south, 10 m to the east are as many pixels wherever they lie, and what is nearer to the eye is so by its height and place."""
    view = Orthographic.around(BOX_M, 180.0, 30.0, (640, 400))
    for place in ((0.0, 0.0, 0.0), (-5.0, 8.0, 4.0)):
        column, row, _ = view.pixels(np.array([place, np.add(place, (10.0, 0, 0))]))
        assert abs(column[1] - column[0] - 10 * view.px_per_m) <= 1
        assert row[0] == row[1]
    _, row, near_m = view.pixels(np.array([[0.0, -5.0, 0.0], [0.0, 5.0, 0.0], [0.0, 5.0, 5.0]]))
    assert near_m[0] > near_m[1]
    assert row[0] > row[1] > row[2]  # the near one is lower in the picture, the high one higher


def test_what_is_nearer_hides_what_is_behind():
    """Of two points at one pixel the nearer one is seen, in whichever order they come."""
    view = Orthographic.around(BOX_M, 180.0, 30.0, (64, 64))
    up = np.array([0.0, -np.cos(np.radians(30)), np.sin(np.radians(30))])  # towards the eye
    points_m, rgb = np.stack([np.zeros(3), 3 * up]), np.array([[255, 0, 0], [0, 255, 0]], np.uint8)
    for order in ([0, 1], [1, 0]):
        canvas = Drawing(View(view.size, view.pixels, lambda sweep: sweep.world_m), "range", {})
        for one in order:
            canvas.add(view.pixels(points_m[[one]]), rgb[[one]])
        seen = canvas.image().reshape(-1, 3)
        assert (seen[:, 1] > 100).any()
        assert not (seen[:, 0] > 100).any()


@pytest.mark.parametrize("rings", [8, 16, 300])
def test_each_laser_has_its_row(rings):
    """The highest ring lies above, azimuths go from left to right, and rows fill their space, though there be more of them than pixels."""
    view = laser_rows((640, 200), rings)
    left, wide, top, tall = round(0.06 * 640), round(0.85 * 640), 20, 160
    ring = np.arange(rings, dtype=float)
    column, row, _ = view.pixels(np.column_stack([np.full(rings, 90.0), ring, ring]))
    assert (column == left + wide // 4).all()
    assert (np.diff(row) <= 0).all()
    assert row[-1] == top
    assert top + tall <= row[0] + view.dot_px[1] <= top + tall + view.dot_px[1]


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
    words = ["--view", "sweep", "--size", "400x400", "--duration", "0.3", "--colour", "reflectivity"]
    words += ["--set", f"world={HALL}"]
    assert run(["picture", "static_bench", str(tmp_path / "a.png"), *words]) == 0
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


def test_a_scene_becomes_a_picture(tmp_path):
    """The picture has the size that is wanted and many colours, and the same bytes again."""
    for name in ("a.png", "b.png"):
        assert run(["picture", "static_bench", str(tmp_path / name), *SMALL]) == 0
    with Image.open(tmp_path / "a.png") as image:
        assert image.size == (320, 200)
        assert len(np.unique(np.array(image.convert("RGB")).reshape(-1, 3), axis=0)) > 20
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


@pytest.mark.parametrize(("name", "library"), [("a.png", "matplotlib"), ("a.gif", "PIL"), ("a.mp4", "imageio_ffmpeg")])
def test_a_missing_library_is_named_before_anything_is_simulated(tmp_path, monkeypatch, capsys, name, library):
    """Without the library of a suffix one line names it, and no emulator has been made."""
    monkeypatch.setitem(sys.modules, library, None)
    monkeypatch.setattr("vlp16emu.cli.write.make_emulator", None)
    assert run(["picture", "static_bench", str(tmp_path / name)]) == 2
    assert "pip install 'vlp16emu[picture]'" in capsys.readouterr().err


def test_a_film_has_a_frame_for_each_revolution(tmp_path):
    """0.4 s of a hall are four whole revolutions and four frames."""
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="the extra picture is not installed")
    assert run(["picture", "static_bench", str(tmp_path / "a.mp4"), *SMALL]) == 0
    assert ffmpeg.count_frames_and_secs(str(tmp_path / "a.mp4"))[0] == 4


def test_a_capture_is_drawn_by_its_trajectory(tmp_path, capsys):
    """By its truth a capture gives a picture of all its revolutions, without it of the first one."""
    emulator = Emulator("static_bench", {"beam.model": "none"})
    emulator.record(tmp_path / "a.pcap", duration_s=0.4, truth=tmp_path / "truth")
    words = ["picture", str(tmp_path / "a.pcap"), str(tmp_path / "a.png"), "--size", "320x200", "--json"]
    drawn = []
    for more in (["--trajectory", str(tmp_path / "truth")], []):
        assert run([*words, *more]) == 0
        drawn.append(json.loads(capsys.readouterr().out)["revolutions"])
    assert drawn == [len(list(decode(tmp_path / "a.pcap"))), 1]
    assert drawn[0] > 1


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["static_bench", "{out}.jpg"], "found the ending .jpg; expected .png, .gif, .mp4"),
        (["static_bench", "{out}.png", "--colour", "blue", *SMALL], "--colour: found blue; expected natural"),
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
