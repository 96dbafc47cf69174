"""Sections of what the user brings."""

import pytest

from vlp16emu.errors import ScenarioError
from vlp16emu.scenario import load

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
    ],
)  # fmt: skip
def test_a_wrong_key_is_named(scene, old, new, message):
    """What is wrong in a section of the user's files is reported by its key path, also where the section may be left out."""
    with pytest.raises(ScenarioError) as caught:
        load(scene(old, new))
    assert f": {message}" in str(caught.value)
