"""The scene file with another path: valid, in the user's own form, and recorded along the new path."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("tomlkit", reason="the extra viewer is not installed")

from vlp16emu import Emulator
from vlp16emu.errors import OutputError
from vlp16emu.extras.viewer.scene_file import check_place, write_scene
from vlp16emu.scenario import find, load, named_files

SCENE = """# mine
schema = 1
duration_s = 5.0
[beam]
model = "none"
[motion]
kind = "walk"  # on foot
lawn_mower = { length_m = 4.0, width_m = 2.0, line_spacing_m = 2.0, turn_radius_m = 0.5 }
run_time_s = 40.0
[motion.gait]
preset = "none"  # as a trolley
[world]
kind = "hall"
length_m = 30.0
width_m = 18.0
height_m = 6.0
"""
LINE = [[float(x), 2.5] for x in range(-4, 5)]
PATH = {"motion.way_points_m": LINE, "motion.speed_m_s": 2.0, "duration_s": 0.2}


@pytest.fixture
def scene(tmp_path):
    (tmp_path / "mine.toml").write_text(SCENE)
    return tmp_path / "mine.toml"


def test_the_saved_path_is_recorded(scene, tmp_path):
    """A recording of the saved scene has the new path in its truth; comments stay."""
    to = tmp_path / "new.toml"
    write_scene(to, scene, ["seed=7"], PATH | {"motion.stops": [{"way_point": 3, "pause_s": 5.0}]})
    text = to.read_text()
    assert all(comment in text for comment in ("# mine", "# on foot", "# as a trolley"))
    assert "lawn_mower" not in text
    saved = load(to)
    assert (saved.seed, saved.motion.run_time_s, saved.motion.stops[0].pause_s) == (7, None, 5.0)
    recorded = Emulator(to).record(tmp_path / "walk.pcap", truth=tmp_path / "truth")
    assert recorded.simulated_s == 0.2
    position_m = np.loadtxt(tmp_path / "truth" / "trajectory.tum")[:, 1:4]
    np.testing.assert_allclose(position_m, np.broadcast_to([-4.0, 2.5, 2.0], position_m.shape), atol=0.1)
    assert scene.read_text() == SCENE


def test_an_unchanged_scene_stays_to_the_letter(scene, tmp_path):
    """Nothing is rewritten that is not changed."""
    write_scene(tmp_path / "same.toml", scene, [], {})
    assert (tmp_path / "same.toml").read_text() == SCENE


def test_files_are_found_from_elsewhere(tmp_path):
    """The stem list, heights and mesh of a plot are found from the folder of the new file."""
    (tmp_path / "deep").mkdir()
    write_scene(tmp_path / "deep" / "plot.toml", find("own_plot"), [], PATH)
    files = [file.resolve() for file in named_files(load(tmp_path / "deep" / "plot.toml"))]
    assert files == [file.resolve() for file in named_files(load("own_plot"))]
    assert 'stem_list = "../' in (tmp_path / "deep" / "plot.toml").read_text()


def test_the_scenario_of_a_run_becomes_a_scene(scene, tmp_path):
    """A `scenario.json` of ground truth is saved as TOML with the new path."""
    tree = load(scene).model_dump(mode="json", by_alias=True, exclude_none=True)
    (tmp_path / "scenario.json").write_text(json.dumps({"written_by": "vlp16emu"} | tree))
    write_scene(tmp_path / "new.toml", tmp_path / "scenario.json", [], PATH)
    expected = load(load(scene), PATH)
    assert load(tmp_path / "new.toml") == expected


@pytest.mark.parametrize(
    "motion",
    [
        'motion = { kind = "walk", way_points_m = [[0, 0], [5, 1]], run_time_s = 20 }',
        'motion.kind = "walk"\nmotion.way_points_m = [[0, 0], [5, 1]]',
        (
            '[motion]\nkind = "walk"\nlawn_mower = { length_m = 5.0, width_m = 9.0 }\n[[motion.stops]]\nat_m '
            "= 1\npause_s = 3"
        ),
    ],
)
def test_each_form_of_a_table_is_changed(motion, tmp_path):
    """An inline table, dotted keys and arrays of tables hold the new path."""
    world = 'world = { kind = "hall", length_m = 30.0, width_m = 18.0, height_m = 6.0 }'
    (tmp_path / "mine.toml").write_text(f"schema = 1\n{world}\n{motion}\n")
    write_scene(tmp_path / "new.toml", tmp_path / "mine.toml", [], PATH | {"motion.stops": []})
    walk = load(tmp_path / "new.toml").motion
    assert [list(point) for point in walk.way_points_m] == PATH["motion.way_points_m"]
    assert (walk.speed_m_s, walk.run_time_s, walk.stops) == (2.0, None, [])


def test_a_wrong_place_is_refused(scene, tmp_path):
    """The scene itself, its inputs, another ending and a folder that does not exist are refused."""
    with pytest.raises(OutputError, match="is read by this run"):
        write_scene(scene, scene, [], PATH, inputs=[scene])
    (tmp_path / "link.toml").symlink_to(scene)
    with pytest.raises(OutputError, match="is read by this run"):
        check_place(tmp_path / "link.toml", [scene])
    with pytest.raises(OutputError, match=r"expected a file that ends in \.toml"):
        check_place(tmp_path / "new.json", [])
    with pytest.raises(OutputError, match="no such folder"):
        check_place(Path("nowhere/new.toml"), [])
    assert scene.read_text() == SCENE
