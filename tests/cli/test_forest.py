"""What stands along a way, on stdout and in files."""

import csv
import json
import re
import sys

import numpy as np
import pytest
import trimesh

from vlp16emu.forest.ground.dem import read_grid

pytestmark = pytest.mark.usefixtures("kept_woods")

RADIUS_M = 9
SMALL = ("--set", "duration_s=3.0", "--set", "sensor.max_range_m=10.0", "--radius", str(RADIUS_M))


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """One look at a small piece of a preset, with all its files."""
    from vlp16emu.cli.app import run

    folder = tmp_path_factory.mktemp("forest")
    files = {
        "--inventory": "trees.csv",
        "--stems": "stems.csv",
        "--ground": "ground.asc",
        "--glb": "twin.glb",
    }
    options = [word for option, name in files.items() for word in (option, str(folder / name))]
    with pytest.MonkeyPatch.context() as patch, (folder / "out.json").open("w") as out:
        patch.setattr(sys, "stdout", out)
        assert run(["forest", "managed_mixed", "--json", *SMALL, *options]) == 0
    return folder, json.loads((folder / "out.json").read_text())


@pytest.fixture(scope="module")
def rows(written):
    """Lines of the inventory."""
    with (written[0] / "trees.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_the_inventory_has_every_tree_in_reach_once(written, rows):
    """One line per tree of the sensor's reach, its units in the header, and no tree twice."""
    assert len(rows) == written[1]["trees_in_reach"]
    assert len({row["id"] for row in rows}) == len(rows)
    assert {"species", "x_m", "dbh_m", "height_m", "top_m", "stem_m3", "leaf_m2", "biomass_kg"} <= set(
        rows[0]
    )


def test_stems_are_circles_with_the_diameter_of_the_inventory(written, rows):
    """Each tree's first leader goes from the ground to its height; at 1.3 m the circle has its DBH and is
    where the inventory says."""
    circles = np.genfromtxt(written[0] / "stems.csv", delimiter=",", names=True)
    assert set(circles["tree"]) == {int(row["id"]) for row in rows}
    for row in rows[::10]:
        is_own = (circles["tree"] == int(row["id"])) & (circles["leader"] == 1) & (circles["branch"] == 0)
        own = circles[is_own]
        assert (own["above_foot_m"][0], own["above_foot_m"][-1]) == (0, pytest.approx(float(row["height_m"])))
        (breast,) = own[own["above_foot_m"] == 1.3]
        assert 2 * breast["radius_m"] == pytest.approx(float(row["dbh_m"]), abs=2e-4)
        where = [float(row[name]) for name in ("x_breast_m", "y_breast_m")]
        assert [breast["x_m"], breast["y_m"]] == pytest.approx(where, abs=2e-4)


def test_the_table_sums_up_the_inventory_near_the_way(written, rows):
    """Stems, basal area and leaf area of the report are those of the lines within the radius of the way."""
    report = written[1]
    # The way of the first four seconds is straight within centimetres.
    start, end = (np.array(report["path"][name][:2]) for name in ("start_m", "end_m"))
    xy_m = np.array([(float(row["x_m"]), float(row["y_m"])) for row in rows])
    along = np.clip((xy_m - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
    near = np.linalg.norm(xy_m - start - along[:, None] * (end - start), axis=1) <= RADIUS_M
    dbh_m = np.array([float(row["dbh_m"]) for row in rows])[near]
    all_trees = report["trees"][-1]
    assert all_trees["stems"] == near.sum()
    assert all_trees["basal_area_m2_per_ha"] == pytest.approx(
        (np.pi / 4 * dbh_m**2).sum() / report["area_ha"], rel=1e-3
    )
    leaf_m2 = sum(float(row["leaf_m2"]) for row, is_near in zip(rows, near, strict=True) if is_near)
    assert all_trees["leaf_area_index"] == pytest.approx(leaf_m2 / report["area_ha"] / 1e4, rel=1e-3)
    assert sum(row["stems"] for row in report["trees"][:-1]) == all_trees["stems"]


def test_the_ground_lies_where_trees_stand(written, rows):
    """The grid holds all ground within the radius of the way, and its cells have the height of the feet in
    them: 2 cm in the median."""
    grid = read_grid(written[0] / "ground.asc", cell_m=None, corner_m=None)
    way_m = np.array([written[1]["path"][name][:2] for name in ("start_m", "end_m")])
    lines, columns = grid.heights_m.shape
    cell_m = np.array(grid.cell_m)
    low_m = np.array([grid.west_m, grid.north_m - (lines - 1) * cell_m[1]]) - cell_m / 2
    high_m = low_m + np.array([columns, lines]) * cell_m
    assert (low_m <= way_m.min(axis=0) - RADIUS_M).all()
    assert (high_m >= way_m.max(axis=0) + RADIUS_M).all()
    feet_m = np.array([[float(row[name]) for name in ("x_m", "y_m", "z_m")] for row in rows])
    feet_m = feet_m[((feet_m[:, :2] > low_m) & (feet_m[:, :2] < high_m)).all(axis=1)]
    column = np.round((feet_m[:, 0] - grid.west_m) / cell_m[0]).astype(int)
    row = np.round((grid.north_m - feet_m[:, 1]) / cell_m[1]).astype(int)
    assert len(feet_m) > 10
    assert np.median(np.abs(grid.heights_m[row, column] - feet_m[:, 2])) < 0.02


def test_tops_are_those_of_the_twin(written, rows):
    """The highest vertex of each tree of the twin is `top_m` of the inventory over its foot, to 0.2 mm;
    others are saplings."""
    scene = trimesh.load_scene(written[0] / "twin.glb")
    tops_m = {}
    for node in scene.graph.nodes_geometry:
        tree = node.split("/")[0]
        scene_T_mesh, name = scene.graph[node]
        up_m = scene.geometry[name].vertices @ scene_T_mesh[1, :3] + scene_T_mesh[1, 3]  # glTF has y up
        tops_m[tree] = max(tops_m.get(tree, -np.inf), up_m.max())
    told_m = {f"tree_{int(row['id']):06d}": float(row["z_m"]) + float(row["top_m"]) for row in rows}
    saplings = {tree for tree in tops_m if tree.startswith("tree_")} - told_m.keys()
    assert len(saplings) == written[1]["things"]["sapling"]["count"] > 0
    seen_m = {tree: top_m for tree, top_m in tops_m.items() if tree in told_m}
    assert len(seen_m) == written[1]["trees"][-1]["stems"]
    assert seen_m == pytest.approx({tree: told_m[tree] for tree in seen_m}, abs=2e-4)


def test_a_table_is_printed_for_people(cli):
    """Species, sums, relief and what lies on the ground are told in lines."""
    out = cli("forest", "managed_mixed", *SMALL).out
    lines = out.splitlines()
    assert lines[0].startswith("managed_mixed: A walk through a managed stand")
    header = next(line for line in lines if line.startswith("species ") and "stems per ha" in line)
    assert " ".join(header.split()) == (
        "species stems stems per ha dbh mean cm dbh min cm dbh max cm height mean m height max m "
        "basal area m2 per ha stem m3 per ha leaf area index"
    )
    assert any(line.startswith("all ") for line in lines)
    assert "\n  clark evans " in out
    assert "on the ground" in lines
    assert re.search(r"\n  sapling +count \d+, density [\d.]+ per ha, measure height", out)


def test_a_hall_tells_its_things(cli):
    """In a hall each thing is named with its place and size, and there is no talk of trees."""
    answer = cli("forest", "static_bench", "--json").tree
    assert "trees" not in answer
    things = {one["name"]: one for one in answer["named"]}
    assert things["crate"]["place_m"] == [-6.0, -5.0, 0.5]
    assert things["crate"]["size_m"] == pytest.approx([2, 1, 1])
    assert "place 0, 7, 0 m, size 0.35, 0.35, 6 m" in cli("forest", "static_bench").out


def test_files_take_their_names_together(cli, tmp_path):
    """A full disk for the last of several files leaves all earlier ones as they were, and nothing beside
    them."""
    (tmp_path / "trees.csv").write_text("earlier")
    (tmp_path / "ground.asc").symlink_to("/dev/full")
    outcome = cli(
        "forest", "static_bench", "--inventory", tmp_path / "trees.csv", "--ground", tmp_path / "ground.asc"
    )
    assert outcome.code == 1
    assert "ground.asc: No space left on device" in outcome.err
    assert (tmp_path / "trees.csv").read_text() == "earlier"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ground.asc", "trees.csv"]
