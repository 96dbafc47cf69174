"""The files that a scenario names."""

from vlp16emu.scenario import load
from vlp16emu.scenario.find import named_files

KITTI = """\
schema = 1
title = "Every file"
[motion]
kind = "recorded"
format = "kitti"
file = "poses.txt"
times_file = "times.txt"
[world]
kind = "plot"
stem_list = "stems.csv"
species_file = "species.toml"
dem = { file = "ground.asc" }
[[world.meshes]]
file = "hut.obj"
unit = "m"
up = "z"
places = [{ x_m = 1, y_m = 2 }]
[[world.meshes]]
file = "/srv/well.obj"
unit = "m"
up = "z"
places = [{ x_m = 3, y_m = 4 }]
"""
WALK = """\
schema = 1
title = "way.csv"
[motion]
kind = "walk"
way_points_file = "way.csv"
[world]
kind = "hall"
length_m = 20
width_m = 20
height_m = 5
"""


def test_all_files_of_a_scene_are_named(tmp_path):
    """Poses and their times, waypoints, stems, species, heights and each mesh are found, and no other text."""
    scene = tmp_path / "scene.toml"
    scene.write_text(KITTI)
    names = ("poses.txt", "times.txt", "stems.csv", "species.toml", "ground.asc", "hut.obj", "/srv/well.obj")
    assert set(named_files(load(str(scene)))) == {tmp_path / name for name in names}
    scene.write_text(WALK)
    assert named_files(load(str(scene))) == [tmp_path / "way.csv"]
