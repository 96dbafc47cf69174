"""Outputs that would take the place of a run's own inputs."""

import pytest

SCENE = """\
schema = 1
title = "A plot"
duration_s = 0.1
[motion]
kind = "static"
[world]
kind = "plot"
stem_list = "stems.csv"
"""
STEMS = "x_m,y_m,species,dbh_cm,height_m\n3,4,silver_birch,20,18\n"


@pytest.fixture
def plot(tmp_path):
    """A scene with a list of stems, and nothing else in its folder."""
    (tmp_path / "plot.toml").write_text(SCENE)
    (tmp_path / "stems.csv").write_text(STEMS)
    return tmp_path / "plot.toml"


@pytest.mark.parametrize("command", ["record SCENE OUT", "points SCENE OUT", "forest SCENE --inventory OUT"])
@pytest.mark.parametrize("name", ["stems.csv", "link.csv", "hard.csv", "plot.toml"])
def test_no_output_is_written_over_an_input(cli, plot, command, name):
    """The scene's own file and one that it names, by whatever name, are refused as output and stay."""
    (plot.parent / "link.csv").symlink_to("stems.csv")
    (plot.parent / "hard.csv").hardlink_to(plot.parent / "stems.csv")
    out = plot.parent / name
    outcome = cli(*({"SCENE": plot, "OUT": out}.get(word, word) for word in command.split()))
    line = f"error: {out}: is read by this run, and would be written over; expected another place\n"
    if command.startswith("points") and name == "plot.toml":  # no format of points has that suffix
        line = f"error: {out}: found the ending '.toml'; expected .csv, .npz, .ply, .pcd, .las, .laz\n"
    assert (outcome.code, outcome.err) == (2, line)
    assert (plot.read_text(), (plot.parent / "stems.csv").read_text()) == (SCENE, STEMS)


def test_other_outputs_are_written(cli, plot):
    """A file beside the inputs is written, and written again."""
    for _ in range(2):
        assert cli("forest", plot, "--inventory", plot.parent / "trees.csv").code == 0
