"""Pictures of what a sensor sees, without a browser."""

import json
import sys

import numpy as np
import pytest

from vlp16emu import Emulator
from vlp16emu.cli.app import run
from vlp16emu.extras.clouds.scan import decode
from vlp16emu.extras.viewer.picture import Canvas

Image = pytest.importorskip("PIL.Image", reason="the extra picture is not installed")

SMALL = ["--size", "320x200", "--duration", "0.4", "--set", "beam.model=none"]
BOXES = ", ".join(
    f'{{ name = "{name}", centre_m = [{x_m}, {y_m}, 1.5], size_m = [1.0, 1.0, 3.0], reflectance = 0.9 }}'
    for name, x_m, y_m in (("ahead", 4.5, 0.0), ("left", 0.0, 6.5))
)
HALL = (
    '{ kind = "hall", length_m = 24.0, width_m = 24.0, height_m = 6.0, wall_reflectance = 0.05, '
    f"boxes = [{BOXES}] }}"
)
BOX_M = np.array([[-10.0, -10.0, 0.0], [10.0, 10.0, 5.0]])


def test_lengths_are_the_same_all_over_an_oblique_view():
    """From the south, 10 m to the east are as many pixels wherever they lie, and what is nearer to the eye
    is so by its height and place."""
    canvas = Canvas(BOX_M, 180.0, 30.0, (640, 400))
    for place in ((0.0, 0.0, 0.0), (-5.0, 8.0, 4.0)):
        column, row, _ = canvas.pixels(np.array([place, np.add(place, (10.0, 0, 0))]))
        assert abs(column[1] - column[0] - 10 * canvas.px_per_m) <= 1
        assert row[0] == row[1]
    _, row, near_m = canvas.pixels(np.array([[0.0, -5.0, 0.0], [0.0, 5.0, 0.0], [0.0, 5.0, 5.0]]))
    assert near_m[0] > near_m[1]
    assert row[0] > row[1] > row[2]  # the near one is lower in the picture, the high one higher


def test_what_is_nearer_hides_what_is_behind():
    """Of two points at one pixel the nearer one is seen, in whichever order they come."""
    up = np.array([0.0, -np.cos(np.radians(30)), np.sin(np.radians(30))])  # towards the eye
    points_m, rgb = np.stack([np.zeros(3), 3 * up]), np.array([[255, 0, 0], [0, 255, 0]], np.uint8)
    for order in ([0, 1], [1, 0]):
        canvas = Canvas(BOX_M, 180.0, 30.0, (64, 64))
        assert [canvas.add(points_m[[one]], rgb[[one]]) for one in order] == [1, 1]
        seen = canvas.image().reshape(-1, 3)
        assert (seen[:, 1] > 100).any()
        assert not (seen[:, 0] > 100).any()


def test_a_sweep_lies_ahead_upwards(tmp_path, capsys):
    """From above, a box ahead of the sensor is over its middle and one to its left at the left, both at
    their ranges, of one revolution."""
    words = ["--view", "sweep", "--size", "400x400", "--duration", "0.3", "--colour", "reflectivity"]
    words += ["--set", f"world={HALL}", "--json"]
    assert run(["picture", "static_bench", str(tmp_path / "a.png"), *words]) == 0
    assert json.loads(capsys.readouterr().out)["revolutions"] == 1
    with Image.open(tmp_path / "a.png") as image:
        rgb = np.array(image.convert("RGB")).astype(int)
    row, column = np.nonzero((rgb[..., 1] > 180) & (rgb[..., 2] < 120))  # of bright points, not of text
    row, column = row[column < 350], column[column < 350]  # to the left of the scale
    ahead = (np.abs(column - 200) < 40) & (row < 160)
    left = (np.abs(row - 200) < 40) & (column < 160)
    assert ahead.sum() > 20
    assert left.sum() > 20
    assert ahead.sum() + left.sum() > 0.95 * len(row)
    # The boxes are 4 and 6 m away, on one scale.
    assert (200 - row[ahead].max()) / (200 - column[left].max()) == pytest.approx(4 / 6, abs=0.1)


def test_an_image_has_azimuths_across_and_rings_upwards(tmp_path):
    """Of two bright boxes the one ahead is at both edges, the one to the left at three quarters."""
    words = ["--view", "image", "--size", "400x160", "--duration", "0.3", "--colour", "reflectivity"]
    words += ["--set", f"world={HALL}"]
    assert run(["picture", "static_bench", str(tmp_path / "a.png"), *words]) == 0
    with Image.open(tmp_path / "a.png") as image:
        rgb = np.array(image.convert("RGB")).astype(int)
    is_bright = (rgb[..., 1] > 180) & (rgb[..., 2] < 120)
    column = np.nonzero(is_bright[75:85].all(axis=0))[0]  # the ring next to the horizon
    ahead = (column < 30) | (column > 370)
    left = np.abs(column - 300) < 30
    assert ahead.sum() > 5
    assert left.sum() > 5
    assert (ahead | left).all()
    assert not is_bright[:10, 200:330].any()  # below text and scale, at 15 degrees


def test_a_film_has_a_frame_for_each_revolution(tmp_path, capsys):
    """Ten frames per second end with the picture of all revolutions; a film of a capture shows each alone."""
    words = [*SMALL, "--json"]
    assert run(["picture", "static_bench", str(tmp_path / "a.gif"), *words]) == 0
    made = json.loads(capsys.readouterr().out)
    with Image.open(tmp_path / "a.gif") as film:
        assert film.n_frames == made["revolutions"] >= 3
        assert film.info["duration"] == 100
        film.seek(film.n_frames - 1)
        last = np.array(film.convert("RGB")).astype(int)
    assert run(["picture", "static_bench", str(tmp_path / "a.png"), *words]) == 0
    still = json.loads(capsys.readouterr().out)
    assert (made["points"], made["revolutions"]) == (still["points"], still["revolutions"])
    with Image.open(tmp_path / "a.png") as image:
        apart = np.abs(last - np.array(image.convert("RGB")).astype(int)).sum(axis=2)
    assert (apart[40:] < 60).mean() > 0.98  # below the captions, whose times differ
    Emulator("static_bench").record(tmp_path / "a.pcap", duration_s=0.4)
    words = ["--view", "image", "--size", "320x160", "--json"]
    assert run(["picture", str(tmp_path / "a.pcap"), str(tmp_path / "b.gif"), *words]) == 0
    made = json.loads(capsys.readouterr().out)
    with Image.open(tmp_path / "b.gif") as film:
        assert film.n_frames == made["revolutions"] >= 3
    assert 20_000 < made["points"] < 30_000  # of one revolution


def test_a_scene_becomes_a_picture(tmp_path):
    """The picture has the size that is asked for and many colours, and the same bytes again."""
    for name in ("a.png", "b.png"):
        assert run(["picture", "static_bench", str(tmp_path / name), *SMALL]) == 0
    with Image.open(tmp_path / "a.png") as image:
        assert image.size == (320, 200)
        assert len(np.unique(np.array(image.convert("RGB")).reshape(-1, 3), axis=0)) > 20
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_a_bar_of_ten_metres_and_a_scale_stand_beside_the_points(tmp_path):
    """The bar is as long as 10 m are in the view, and the scale of ranges goes from violet at 0 to yellow
    at 40 m."""
    words = [*SMALL, "--from", "180", "--colour", "range", "--set", f"world={HALL}"]
    assert run(["picture", "static_bench", str(tmp_path / "a.png"), *words]) == 0
    with Image.open(tmp_path / "a.png") as image:
        rgb = np.array(image.convert("RGB"))
    across_m = 44.0  # the path, a point, with 22 m around it; height fills the picture first
    tall_m = across_m * np.sin(np.radians(32)) + 26.0 * np.cos(np.radians(32))
    bar = (rgb[200 - 23] == (215, 219, 224)).all(axis=1).sum()
    assert bar == pytest.approx(10 * min(320 / across_m, 200 / tall_m), abs=1.5)
    scale = rgb[50:150, 320 - 4 * 11 + 5]
    assert (scale[0].tolist(), scale[-1].tolist()) == ([253, 231, 37], [68, 1, 84])


def test_title_and_legend_name_what_is_drawn(tmp_path, monkeypatch):
    """The title has scene and time, the scale its quantity and unit, a capture its file and UTC; a long
    title is cut before the legend."""
    from PIL import ImageDraw

    written, write = [], ImageDraw.ImageDraw.text
    monkeypatch.setattr(
        ImageDraw.ImageDraw,
        "text",
        lambda draw, place, words, *more: (written.append(words), write(draw, place, words, *more)),
    )
    assert run(["picture", "static_bench", str(tmp_path / "a.png"), *SMALL, "--colour", "range"]) == 0
    assert {"range, m", "10 m"} <= set(written)
    assert any(words.startswith("static_bench: A static sensor") for words in written)
    assert any(words.startswith("0 to 0.4 s; ") for words in written)
    written.clear()
    assert run(["picture", "static_bench", str(tmp_path / "a.png"), *SMALL, "--colour", "class"]) == 0
    assert {"Ground", "Other"} & set(written)
    assert any(words.endswith("...") for words in written)
    Emulator("static_bench").record(tmp_path / "a.pcap", duration_s=0.3)
    written.clear()
    assert run(["picture", str(tmp_path / "a.pcap"), str(tmp_path / "a.png")]) == 0
    assert "a.pcap" in written
    assert "reflectivity, code" in written
    assert any(" UTC; " in words for words in written)


def test_natural_colours_are_named_by_leaf_and_stem():
    """The legend of natural colours has two colours for each species of trees that is seen, and one for
    shrubs and ground, whatever their species."""
    from vlp16emu.extras.colours import colour_of_kind, colours_of_plant
    from vlp16emu.extras.viewer.layers import _natural_legend
    from vlp16emu.types import Labels

    fields = {
        name: np.zeros(4, kind)
        for name, kind in (("instance", np.uint32), ("part", np.uint8), ("range_m", np.float32))
    }
    semantic, species = np.array([2, 2, 3, 1], np.uint8), np.array([1, 1, 5, 0], np.uint16)
    labels = Labels(semantic=semantic, species=species, **fields)
    legend = _natural_legend(labels, {1: "silver_birch", 5: "hazel"})
    assert legend == {
        "Silver birch": colours_of_plant("silver_birch"),
        "Shrubs": (colour_of_kind("shrub"),),
        "Ground": (colour_of_kind("ground"),),
    }


def test_a_missing_pillow_is_named_before_anything_is_simulated(tmp_path, monkeypatch, refused):
    """Without pillow one line names it and the extra, and no emulator has been made."""
    monkeypatch.setitem(sys.modules, "PIL", None)
    monkeypatch.setattr("vlp16emu.cli.write.make_emulator", None)
    assert "pip install 'vlp16emu[picture]'" in refused(["picture", "static_bench", tmp_path / "a.png"])


def test_a_capture_is_drawn_by_its_trajectory(tmp_path, capsys):
    """A capture with its trajectory gives a picture of all revolutions of its first sensor, without it one
    of the first revolution."""
    second = {"name": "b", "address": "192.168.1.202", "data_port": 2369, "position_port": 8309}
    emulator = Emulator("static_bench", {"beam.model": "none", "rig": [second]})
    emulator.record(tmp_path / "a.pcap", duration_s=0.4, truth=tmp_path / "truth")
    words = ["picture", str(tmp_path / "a.pcap"), str(tmp_path / "a.png"), "--size", "320x200", "--json"]
    drawn = []
    for more in (["--trajectory", str(tmp_path / "truth")], []):
        assert run([*words, *more]) == 0
        drawn.append(json.loads(capsys.readouterr().out)["revolutions"])
    assert drawn == [len(list(decode(tmp_path / "a.pcap", 1))), 1]
    assert drawn[0] > 1


def test_captions_without_room_are_left_out(tmp_path):
    """The smallest picture, which has no room for a letter beside its legend, is drawn."""
    path = tmp_path / "small.png"
    words = ["--duration", "0.2", "--size", "64x64", "--view", "sweep", "--colour", "class"]
    assert run(["picture", "static_bench", str(path), *words]) == 0
    with Image.open(path) as image:
        assert image.size == (64, 64)
