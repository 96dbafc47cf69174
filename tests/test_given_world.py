"""A world of the user's own files, from the scene to the packets."""

import csv
from contextlib import suppress

import numpy as np
import pytest
import trimesh

from vlp16emu import Emulator
from vlp16emu.cli.app import run
from vlp16emu.errors import GeometryError
from vlp16emu.scenario import load
from vlp16emu.types import FIRST_FREE_INSTANCE, PlantPart, Semantic

EAST_M, NORTH_M, UP_M = 500_000.0, 5_700_000.0, 210.0
SCENE = f"""\
schema = 1
title = "A plot of five trees on a slope, with a box"
seed = 3

[sensor]
max_range_m = 30.0
eccentricity_deg = 0.0
azimuth_noise_deg = 0.0

[beam]
model = "none"

[noise]
preset = "ideal"

[motion]
kind = "static"

[world]
kind = "plot"
stem_list = "plot.csv"
origin_m = [{EAST_M}, {NORTH_M}, {UP_M}]
dem = {{ file = "ground.asc" }}

[[world.meshes]]
file = "box.obj"
unit = "cm"
up = "y"
reflectance = 0.3
places = [{{ x_m = 4.0, y_m = -3.0, above_ground_m = 1.0, yaw_deg = 30.0, scale = 2.0 }}]
"""
TREES_M = [(6.0, 4.0), (-5.0, 3.0), (-4.0, -6.0), (9.0, -9.0), (-8.0, 9.0)]
BOX_M = np.array([0.8, 1.2, 1.0])  # of the box as it stands: along its own east, north and up, scaled by two


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A scene and its files: ground rising 1 in 10 to the east, trees, and a box with y up in centimetres."""
    folder = tmp_path_factory.mktemp("given")
    (folder / "plot.toml").write_text(SCENE)
    nodes = np.arange(-50, 51, 2.0)
    header = f"ncols 51\nnrows 51\nxllcenter {EAST_M - 50}\nyllcenter {NORTH_M - 50}\ncellsize 2\n"
    row = " ".join(f"{UP_M + 0.1 * x:.3f}" for x in nodes)
    (folder / "ground.asc").write_text(header + f"{row}\n" * 51)
    lines = [f"{EAST_M + x},{NORTH_M + y},norway_spruce,{30 + i},24" for i, (x, y) in enumerate(TREES_M)]
    (folder / "plot.csv").write_text("\n".join(["x,y,species,dbh_cm,height_m", *lines]))
    east, north, up = 100 * BOX_M / 2
    (folder / "box.obj").write_text(trimesh.creation.box((east, up, north)).export(file_type="obj"))
    return folder


@pytest.fixture(scope="module")
def seen(folder):
    """Returns of two revolutions: origins, directions, distances and surface rows, each one to a return."""
    emulator = Emulator(load(str(folder / "plot.toml")), threads=1)
    found = []
    for returns in emulator.returns(0.0, 0.2, truth=True):
        hit = returns.distance_m[..., 0] > 0
        rows = returns.surfaces[returns.surface[..., 0][hit]]
        found.append(
            (returns.firings.origin_m[hit], returns.firings.direction[hit], returns.distance_m[hit, 0], rows)
        )
    return [np.concatenate(arrays) for arrays in zip(*found, strict=True)]


def test_everything_that_was_given_is_seen(seen):
    """Ground, the stems of all five trees and the box return light under their own labels."""
    _, _, _, rows = seen
    trees = rows[rows["semantic"] == Semantic.TREE]
    stems = trees[np.isin(trees["part"], [PlantPart.STEM, PlantPart.ROOT_FLARE])]
    assert len(np.unique(stems["instance"])) == 5
    assert np.unique(trees["species"]).size == 1
    assert np.count_nonzero(rows["semantic"] == Semantic.GROUND) > 1000
    box = rows[rows["semantic"] == Semantic.OTHER]
    assert len(box) > 100
    assert set(box["instance"].tolist()) == {FIRST_FREE_INSTANCE}
    assert box["reflectance"] == pytest.approx(0.3)


def test_the_box_is_where_the_scene_puts_it(seen):
    """Every return from the box, and so the nearest, has the distance of the true box to 2 mm."""
    origin, direction, distance, rows = seen
    own = rows["semantic"] == Semantic.OTHER
    yaw = np.radians(30.0)
    world_R_box = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    centre = np.array([4.0, -3.0, 0.1 * 4.0 + 1.0])
    start, along = (origin[own] - centre) @ world_R_box, direction[own] @ world_R_box
    near = np.minimum((-BOX_M / 2 - start) / along, (BOX_M / 2 - start) / along).max(axis=1)
    assert np.abs(distance[own] - near).max() < 0.002
    assert distance[own].min() == pytest.approx(near.min(), abs=0.002)


def test_the_ground_is_the_given_ground(seen):
    """Every return from the ground lies on the plane of the file to a centimetre, far from the map's own
    zero."""
    origin, direction, distance, rows = seen
    own = rows["semantic"] == Semantic.GROUND
    place = origin[own] + direction[own] * distance[own, None]
    assert np.abs(place[:, 2] - 0.1 * place[:, 0]).max() < 0.01


def test_trees_are_joined_with_their_lines_of_the_list(folder, tmp_path):
    """The inventory tells of each tree the line of the list that has its place."""
    assert run(["forest", str(folder / "plot.toml"), "--inventory", str(tmp_path / "trees.csv")]) == 0
    with (tmp_path / "trees.csv").open(newline="") as file:
        trees = list(csv.DictReader(file))
    assert sorted(int(tree["list_line"]) for tree in trees) == [2, 3, 4, 5, 6]
    for tree in trees:
        assert (float(tree["x_m"]), float(tree["y_m"])) == TREES_M[int(tree["list_line"]) - 2]


def test_the_path_of_a_walk_leads_around_the_trees_of_the_list(folder):
    """With `on_conflict = "move_path"` a walk right through a listed stem keeps its clearance from all of
    them."""
    walk = "motion={kind='walk', way_points_m=[[-10, 5.0], [11, 3.2]]}"
    settings = [walk, 'world.on_conflict="move_path"', "world.meshes=[]"]
    carrier = Emulator(load(str(folder / "plot.toml"), settings), threads=1).parts.carrier
    start_ns = load(str(folder / "plot.toml")).start_ns
    at_ns = start_ns + np.arange(0, int(carrier.run_time_s * 1e9), 10**8)
    body_m = carrier.poses_at(at_ns).world_p_body_m[:, :2]
    gap_m = np.linalg.norm(body_m[:, None] - np.array(TREES_M), axis=2).min(axis=0)
    assert gap_m.min() > 0.8  # with 0.15 m of stem, less the sway of a walker
    with pytest.raises(GeometryError, match="1 of 5 trees nearer"):
        Emulator(load(str(folder / "plot.toml"), [walk, "world.meshes=[]"]), threads=1)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("motion.x_m=-51", (r"ground.asc: ends in column 1 at x = -50.0 m, 1.0 m short of the path at "
                           r"\(-51.0, 4.0\) m; expected ground under")),
        ("motion.x_m=5.9", (r"plot.csv: 1 of 5 trees nearer to the path than path_clearance_m = 0.8: line "
                           r"2 at \(6, 4\) m, 0.00 m away; expected none, or on_conflict")),
        ('world.stem_list="absent.csv"', "absent.csv: no such file or directory"),
    ],
)  # fmt: skip
def test_files_that_do_not_fit_the_walk_are_refused(folder, setting, message):
    """Ground that ends before the path, a tree in the way, and a file that is not there are named before
    anything is cast."""
    settings = [setting, "motion.y_m=4.0"] if setting.startswith("motion") else [setting]
    with pytest.raises(GeometryError, match=message):
        Emulator(load(str(folder / "plot.toml"), settings), threads=1)


@pytest.mark.parametrize(
    ("settings", "warning"),
    [
        (["motion.x_m=-5e5", "motion.y_m=-5.7e6"], "motion: recorded poses lie from 211.5 to 211.5 m above"),
        (["motion.x_m=-5e5", "motion.y_m=-5.7e6", "motion.z_m=-212.0"], ("motion: recorded poses lie from "
                                                                        "-0.5")),
        (["motion.x_m=-5e5", "motion.y_m=-5.7e6", "motion.z_m=-210.0"], None),
        ([("world.dem={file='wide.npy', cell_m=1e6, corner_m=[-1e7, "
          "-1e7]}")], "motion: recorded poses begin at (500000.0, 5700000.0, 211.5) m, as if in map"),
    ],
)  # fmt: skip
def test_recorded_poses_that_are_not_in_the_scene_are_reported(
    folder, caplog, monkeypatch, settings, warning
):
    """Poses in map coordinates, below the ground or out of its sight are warned of, with what moves them."""
    poses = [f"{t} {EAST_M} {NORTH_M} {UP_M + 1.5} 0 0 0 1" for t in (0.0, 0.5, 1.0)]
    (folder / "poses.tum").write_text("\n".join(poses))
    np.save(folder / "wide.npy", np.full((20, 20), UP_M))
    monkeypatch.chdir(folder)
    changed = ["motion.kind=recorded", "motion.file=poses.tum", "motion.format=tum", *settings]
    with suppress(GeometryError):  # the ground of the scene, or its trees, may be out of sight as well
        Emulator(load(str(folder / "plot.toml"), changed), threads=1)
    lines = [record.getMessage() for record in caplog.records if record.getMessage().startswith("motion")]
    assert [line[: len(warning)] for line in lines] == [warning] if warning else not lines


def test_a_stem_list_that_nobody_sees_is_refused(folder):
    """A list in map coordinates without an origin is no empty forest: the nearest tree and `origin_m` are
    told."""
    lines = [line for line in SCENE.splitlines() if not line.startswith(("origin_m", "dem"))]
    (folder / "lost.toml").write_text("\n".join(lines))
    x, y = min(((EAST_M + x, NORTH_M + y) for x, y in TREES_M), key=lambda xy_m: np.hypot(*xy_m))
    message = (
        rf"plot.csv: no tree in sight, the nearest at \({x:.1f}, {y:.1f}\) m in the scene, "
        rf"{np.hypot(x, y):.1f} m from"
        r" the path; expected one 31 m from it at most \(a list in map coordinates needs an origin_m\)$"
    )
    with pytest.raises(GeometryError, match=message):
        Emulator(load(str(folder / "lost.toml")), threads=1)


def test_a_mesh_that_nobody_sees_is_reported(folder, caplog, monkeypatch):
    """A mesh at map coordinates is warned of in one line, and one in reach is not; the reach ends at its
    surface."""
    monkeypatch.chdir(folder)
    mesh = '{file="box.obj",unit="cm",up="y",reflectance=0.3,places=[{x_m=%r,y_m=0.0,scale=2.0}]}'
    for x_m, warnings in ((EAST_M, 1), (33.0, 1), (31.5, 0)):
        caplog.clear()
        Emulator(load(str(folder / "plot.toml"), [f"world.meshes=[{mesh % x_m}]"]), threads=1)
        lines = [record.getMessage() for record in caplog.records if "not in sight" in record.getMessage()]
        assert len(lines) == warnings
        if warnings:
            gap_m = x_m - np.linalg.norm(BOX_M) / 2
            assert (
                f"box.obj: not in sight, {gap_m:.1f} m from the path at the nearest; expected a place 31 m"
                in lines[0]
            )
