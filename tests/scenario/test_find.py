"""Scenes by name and by path, and the files that they name."""

from pathlib import Path

import pytest

from vlp16emu.errors import ScenarioError
from vlp16emu.scenario import find, load, named_files, scene_files

CHECKOUT = Path(__file__).resolve().parents[2] / "scenes"


def test_a_name_leads_to_the_scene_of_the_checkout():
    """In a checkout a scene's name, with _ or -, means the file in `scenes/`, never a stale copy in the
    package."""
    assert find("birch_walk") == CHECKOUT / "birch_walk.toml"
    assert find("birch-walk") == find("birch_walk")


def test_an_own_folder_comes_first(tmp_path, monkeypatch):
    """`VLP16EMU_SCENES` adds scenes and takes precedence over those that ship."""
    for name in ("birch_walk", "mine"):
        (tmp_path / f"{name}.toml").touch()
    monkeypatch.setenv("VLP16EMU_SCENES", str(tmp_path))
    known = scene_files()
    assert known["mine"] == tmp_path / "mine.toml"
    assert known["birch_walk"] == tmp_path / "birch_walk.toml"
    assert known["static_bench"] == CHECKOUT / "static_bench.toml"
    assert list(known) == sorted(known)


@pytest.mark.parametrize("path", ["mine.toml", "some/where", "../x.toml"])
def test_what_looks_like_a_path_is_a_path(path):
    """A suffix .toml or a folder makes a path, whatever scenes there are."""
    assert find(path) == Path(path)


NEAREST = "birch_walk, the nearest of `vlp16emu scenes`"


@pytest.mark.parametrize(
    ("names", "expected"),
    [(("meadow", ""), ", ".join(scene_files())), (("birch_wlk", "birch-wlk", "Birch_Walk"), NEAREST)],
)
def test_an_unknown_name_is_answered_with_the_nearest_or_with_all(names, expected):
    """The error names the nearest scene alone, or all scenes if none is near."""
    for name in names:
        with pytest.raises(ScenarioError) as caught:
            find(name)
        assert (
            str(caught.value)
            == f"scene '{name}': unknown name; expected {expected}, or a path ending in .toml"
        )


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
meshes = [
    { file = "hut.obj", unit = "m", up = "z", places = [{ x_m = 1, y_m = 2 }] },
    { file = "/srv/well.obj", unit = "m", up = "z", places = [{ x_m = 3, y_m = 4 }] },
]
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
    """Poses and their times, waypoints, stems, species, heights and each mesh are found, and no other
    text."""
    scene = tmp_path / "scene.toml"
    scene.write_text(KITTI)
    names = ("poses.txt", "times.txt", "stems.csv", "species.toml", "ground.asc", "hut.obj", "/srv/well.obj")
    assert set(named_files(load(str(scene)))) == {tmp_path / name for name in names}
    scene.write_text(WALK)
    assert named_files(load(str(scene))) == [tmp_path / "way.csv"]
