"""The map of a stand and what of its stems can be seen."""

import numpy as np
import pytest
from kit import set_words
from woods import LINES, THIN

from vlp16emu.extras.stand_map import bark_seen, map_of
from vlp16emu.extras.survey import survey
from vlp16emu.forest.stand.inventory import INVENTORY
from vlp16emu.scenario import load

FIELD_DEG = (-15.0, 15.0)


def test_places_along_and_aside_are_those_of_the_path():
    """A tree beside a bent path is at the length walked to its nearest point; ground and profile have the
    heights of the ground."""
    path_m = np.array([[x, 0.0, 3.0] for x in range(11)] + [[10.0, y, 3.0] for y in range(1, 6)], float)
    trees = np.zeros(2, INVENTORY)
    trees["x_m"], trees["y_m"], trees["species"] = (4.0, 13.0), (-2.0, 4.0), (1, 1)
    bounds_m = np.array([-1.0, -3.0]), np.array([14.0, 6.0])
    found = map_of(path_m, trees, {1: "silver_birch"}, bounds_m, lambda x, y: 0.5 * x + 0.0 * y)
    assert (found["stems"]["along_m"], found["stems"]["aside_m"]) == ([4.0, 14.0], [2.0, 3.0])
    assert found["profile"]["distance_m"] == list(range(16))
    assert found["profile"]["ground_m"] == [0.5 * x for x in found["profile"]["x_m"]]
    heights_m = np.array(found["ground"]["heights_m"])
    assert heights_m.shape == (10, 16)
    assert (heights_m[:, 0] == -0.5).all()
    assert heights_m[0, -1] == 7.0


def test_a_long_path_has_a_map_of_bounded_size():
    """Two kilometres of path give at most 500 places and 82 cells along an edge."""
    path_m = np.column_stack([np.linspace(0, 2000, 20_000), np.zeros((20_000, 2))])
    bounds_m = np.array([-30.0, -30.0]), np.array([2030.0, 30.0])
    found = map_of(path_m, np.zeros(0, INVENTORY), {}, bounds_m, lambda x, y: x - y)
    assert len(found["profile"]["distance_m"]) == 500
    assert found["profile"]["distance_m"][-1] == 2000.0
    assert max(np.shape(found["ground"]["heights_m"])) <= 82


@pytest.mark.usefixtures("kept_woods")
def test_one_place_sees_half_of_a_stem_and_a_walk_more():
    """From where a sensor stands at most half of the bark is seen, and of some stem nearly that; a walk
    past sees no less of any stem, and more in all."""
    walk = load("birch_walk", {**THIN, "duration_s": 6.0})
    seen = survey(walk, 12.0)
    trees = seen.inventory(seen.near)
    sight = {"reach_m": 15.0, "field_deg": FIELD_DEG}
    every = bark_seen(seen.path_m, trees, seen.world, seen.window, walk.start_ns, **sight)
    first = bark_seen(seen.path_m[:1], trees, seen.world, seen.window, walk.start_ns, **sight)
    assert len(trees) > 5
    assert (first <= 0.5).all()
    assert (every >= first).all()
    assert every.sum() > 1.1 * first.sum()
    assert first.max() > 0.4


@pytest.mark.usefixtures("kept_woods")
def test_the_command_reports_what_is_seen(capsys):
    """`forest --seen` counts the stems by the share of bark that is seen, each once."""
    from vlp16emu.cli.app import run

    words = set_words([*LINES, "duration_s=3.0"])
    assert run(["forest", "birch_walk", "--seen", "--radius", "12", *words]) == 0
    lines = capsys.readouterr().out.splitlines()
    (at,) = [i for i, line in enumerate(lines) if line.startswith("stems within the radius, by the share")]
    counts = [int(line.split()[-1]) for line in lines[at + 1 : at + 5]]
    stems = next(line for line in lines if line.startswith("silver_birch")).split()[1]
    assert sum(counts) == int(stems) > 0
