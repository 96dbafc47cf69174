"""Sections of what the user brings: files, and where a person goes."""

import pytest

from vlp16emu.errors import ScenarioError
from vlp16emu.scenario import load

MOWER = "lawn_mower = { length_m = 30, width_m = 20 }"
POINTS = "way_points_m = [[0, 0], [9, 1]]"
EITHER = "exactly one of way_points_m, way_points_file and lawn_mower in it"
KITTI = 'kind = "recorded"\nfile = "p"\nformat = "kitti"'
TIMES = "exactly one of times_file and rate_hz with format kitti, and neither with others"
SCENE = """\
schema = 1
title = "A plot"
[motion]
kind = "static"
[world]
kind = "plot"
stem_list = "lists/plot.csv"
dem = { file = "/srv/ground.npy", cell_m = 2, corner_m = [0, 0] }
[[world.meshes]]
file = "hut.obj"
unit = "m"
up = "z"
parts = [{ name = "roof", reflectance = 0.2 }]
places = [{ x_m = 1, y_m = 2 }]
"""


@pytest.fixture
def scene(tmp_path):
    def write(old="", new=""):
        assert old in SCENE
        path = tmp_path / "scene.toml"
        path.write_text(SCENE.replace(old, new, 1) if old else SCENE)
        return str(path)

    return write


def test_files_lie_beside_the_scene(scene, tmp_path, monkeypatch):
    """A relative path is from the folder of the scene, in a setting from the current one; an absolute one stays as it is."""
    world = load(scene()).world
    assert (world.stem_list, world.dem.file) == (str(tmp_path / "lists/plot.csv"), "/srv/ground.npy")
    monkeypatch.chdir("/")
    assert load(scene(), ["world.stem_list=other.csv"]).world.stem_list == "/other.csv"
    mesh = "{ file = 'a.obj', unit = 'm', up = 'z', places = [{ x_m = 1, y_m = 2 }] }"
    assert load(scene(), [f"world.meshes=[{mesh}]"]).world.meshes[0].file == "/a.obj"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('unit = "m"\n', "", 'world.meshes[0].unit: missing; expected "m", "cm", "mm", "in" or "ft"'),
        ('up = "z"', 'up = "x"', 'world.meshes[0].up: found "x"; expected "z" or "y"'),
        ("places = [{ x_m = 1, y_m = 2 }]", "places = []", "world.meshes[0].places: found a list of 0; expected a list of at least 1"),
        ("y_m = 2", "y_m = 2, z_m = true", "world.meshes[0].places[0].z_m: found true; expected a number"),
        ("cell_m = 2", 'cell_m = "2"', 'world.dem.cell_m: found "2"; expected a number above 0'),
        ("corner_m = [0, 0]", "corner_m = [0]", "world.dem.corner_m[1]: missing; expected a number"),
        ('"lists/plot.csv"', '""', 'world.stem_list: found ""; expected a text in quotes'),
        ("[world]", "[world]\nstems_per_ha = 600", "world.stems_per_ha: unknown key"),
        *(('kind = "static"', motion, f"motion{message}") for motion, message in [
            ('kind = "walk"', f": found a table; expected {EITHER}"),
            (f'kind = "walk"\n{POINTS}\n{MOWER}', f": found a table; expected {EITHER}"),
            (f'kind = "walk"\n{POINTS}\nspeed_m_s = 1.0\nrun_time_s = 9.0', ": found a table; expected one of speed_m_s and run_time_s in it, not both"),
            (f'kind = "walk"\n{POINTS}\nstops = [{{ pause_s = 3 }}]', ".stops[0]: found a table; expected exactly one of way_point and at_m in it"),
            (f'kind = "walk"\n{MOWER}\nstops = [{{ way_point = 2, pause_s = 3 }}]', ": found a table; expected stops given by at_m where lawn_mower makes the waypoints"),
            (KITTI, f": found a table; expected {TIMES}"),
            ('kind = "recorded"\nfile = "p"\nformat = "tum"\nrate_hz = 10', f": found a table; expected {TIMES}"),
            *((f"{KITTI}\nrate_hz = {hz}", f".rate_hz: found {hz}; expected a number from 0.001 to 1000000") for hz in ("1e-300", "1e+300")),
        ]),
    ],
)  # fmt: skip
def test_a_wrong_key_is_named(scene, old, new, message):
    """What is wrong, missing or given twice is reported by its key path, also in a section that may be left out."""
    with pytest.raises(ScenarioError) as caught:
        load(scene(old, new))
    assert f": {message}" in str(caught.value)
