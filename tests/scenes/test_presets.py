"""Kinds of forest by name."""

from functools import cache

import numpy as np
import pytest

from vlp16emu.engine import assemble
from vlp16emu.forest.settings import presets
from vlp16emu.forest.stand.stand import REGENERATION
from vlp16emu.scenario import load
from vlp16emu.types import Semantic

pytestmark = pytest.mark.usefixtures("kept_woods")

EACH = pytest.mark.parametrize("name", [*presets(), "reference_forest"])
SCENE = """
schema = 1
title = "A preset with changes"
motion = { kind = "walk", way_points_m = [[0, 0], [40, 0]] }

[world]
kind = "forest"
"""


def scene(tmp_path, world):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE + world, encoding="utf-8")
    return load(str(path)).world


@cache
def grown(name, reach_m=45.0):
    """Give the window, trees and ground area of a scene around one place of its path."""
    forest = assemble(load(name, [f"sensor.max_range_m={reach_m}"])).world
    at = np.array([[40.0, 4.0, 2.0]])
    window = forest.window(at)
    tiles = sum(not hasattr(key, "species") and hasattr(key, "ix") for key in window.shapes)
    return window, forest.trees(at), tiles * 400.0


@EACH
def test_a_scene_has_the_density_and_basal_area_of_its_table(name):
    """Around the walk stems per hectare and basal area are those that the scene asks for, as far as a
    hectare can show."""
    section = load(name).world
    _, trees, ground_m2 = grown(name)
    canopy = trees[trees["storey"] == 0]
    clumps = section.pattern.per_cluster if section.pattern.kind == "clusters" else 0
    expected = section.stems_per_ha * ground_m2 / 1e4
    # The path keeps a strip free, and stems that would grow into others give way: a few percent.
    assert abs(len(canopy) - expected) < 3 * np.sqrt(expected * (1 + clumps)) + 0.06 * expected
    share = [line.share for line in section.species]
    mean_m2 = np.average([np.pi / 4 * (line.dbh_cm / 100) ** 2 for line in section.species], weights=share)
    assert np.mean(np.pi / 4 * canopy["dbh_m"] ** 2) == pytest.approx(mean_m2, rel=0.15)


@EACH
def test_a_scene_has_all_that_its_table_names(name):
    """Each kind of thing whose density is not zero is there, and none else."""
    section = load(name).world
    window, trees, _ = grown(name)
    found = set(window.surfaces["semantic"].tolist())
    wanted = {
        Semantic.SHRUB: section.shrubs.per_ha,
        Semantic.STONE: section.stones.cover,
        Semantic.DEADWOOD: section.logs.per_ha + section.stumps.per_ha,
        Semantic.GRASS: section.grass.tufts_per_m2
        + section.herbs.cover
        + section.ferns.cover
        + section.dwarf_shrubs.cover,
    }
    assert found == {Semantic.GROUND, Semantic.TREE, *(kind for kind, amount in wanted.items() if amount)}
    assert (trees["storey"] == REGENERATION).any() == (section.regeneration.stems_per_ha > 0)
    assert set(trees["storey"]) >= set(range(1 + len(section.storeys)))


def test_the_reference_forest_has_a_leaf_area_index_of_about_four():
    """Crowns around the benchmark's walk carry 4.0 +- 0.3 m2 of leaves per m2 of ground, from 600 stems per
    hectare.

    On 2.5 ha: among the trees of 2 ha it goes from 4.1 to 4.3 from place to place.
    """
    window, trees, ground_m2 = grown("reference_forest", 70.0)
    area_m2 = 0.0
    for shape, T in zip(window.shape, window.world_T_shape, strict=True):
        key = window.shapes[shape]
        if hasattr(key, "leaf_area_m2"):
            area_m2 += key.leaf_area_m2 * np.linalg.norm(T[:, 0]) ** 2
    assert area_m2 / ground_m2 == pytest.approx(4.0, abs=0.3)
    assert (trees["storey"] == 0).sum() / ground_m2 * 1e4 == pytest.approx(600, rel=0.08)


def test_any_number_beside_a_preset_takes_its_place(tmp_path):
    """Keys of the scene replace those of the preset, in tables one by one, and leave the others."""
    world = scene(
        tmp_path,
        "preset = 'old_growth'\nseason = 'leaf_off'\nshrubs = { per_ha = 7 }\nregeneration.height_m = "
        "[1.0, 2.0]",
    )
    base = presets()["old_growth"]
    assert world.season == "leaf_off"
    assert world.shrubs.per_ha == 7
    assert world.shrubs.species == base["shrubs"]["species"]
    assert world.regeneration.height_m == (1.0, 2.0)
    assert world.regeneration.stems_per_ha == base["regeneration"]["stems_per_ha"]
    assert world.stems_per_ha == base["stems_per_ha"]


def test_a_basal_area_beside_a_preset_takes_the_place_of_its_density(tmp_path):
    """Whoever asks for a basal area over a preset gets it; the preset's stems per hectare are gone."""
    world = scene(tmp_path, "preset = 'managed_mixed'\nbasal_area_m2_per_ha = 24.0")
    assert (world.basal_area_m2_per_ha, world.stems_per_ha) == (24.0, 0.0)


def test_another_pattern_beside_a_preset_replaces_it_whole(tmp_path):
    """A pattern of another kind brings nothing of the preset's pattern along; of the same kind it changes
    single keys."""
    assert scene(tmp_path, "preset = 'plantation'\npattern = { kind = 'random' }").pattern.kind == "random"
    rows = scene(tmp_path, "preset = 'plantation'\npattern = { azimuth_deg = 90.0 }").pattern
    assert (rows.kind, rows.azimuth_deg, rows.tree_spacing_m) == ("plantation", 90.0, 1.6)
