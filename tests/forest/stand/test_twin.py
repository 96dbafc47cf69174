"""Objects near a path, and the digital twin, read back by trimesh."""

import io
import json
import struct
from collections import Counter

import numpy as np
import pytest
import trimesh
from forest.kit import feet_m
from scipy.spatial.distance import pdist

from vlp16emu.foliage.polyline import Polyline
from vlp16emu.forest.plants.species import flora
from vlp16emu.forest.stand.stand import REGENERATION
from vlp16emu.forest.stand.twin import things_near, write_glb
from vlp16emu.forest.tiles import TileKey
from vlp16emu.types import PlantPart, Semantic

RADIUS_M = 9.0


@pytest.fixture(scope="module")
def window(full_forest, track_m):
    return full_forest.window(track_m)


@pytest.fixture(scope="module")
def trees(full_forest, track_m):
    trees = full_forest.trees(track_m)
    return trees[trees["storey"] != REGENERATION]


@pytest.fixture(scope="module")
def way(track_m):
    return Polyline(track_m[:, :2])


@pytest.fixture(scope="module")
def things(full_forest, window, trees, way):
    return things_near(window, full_forest.shape, trees=trees["id"], path=way, radius_m=RADIUS_M)


def test_things_are_all_that_is_near_and_no_tree(window, things, trees, way):
    """Things are exactly the placed instances within the radius that are neither ground nor trees of the
    stand."""
    first = window.surfaces[window.first_surface]
    gap_m = way.distance_m(window.world_T_shape[:, :2, 3])
    is_thing = (first["semantic"] != Semantic.GROUND) & ~np.isin(first["instance"], trees["id"])
    assert {one.instance for one in things} == set(first["instance"][is_thing & (gap_m <= RADIUS_M)].tolist())
    assert {one.kind for one in things} >= {"sapling", "shrub", "stone", "log", "stump", "tuft"}


def test_sizes_are_those_of_the_thing(full_forest, window, things):
    """A log is as long as its mesh reaches, and no stone is longer than stones can be."""
    for log in (one for one in things if one.kind == "log"):
        (i,) = np.flatnonzero(window.surfaces["instance"][window.first_surface] == log.instance)
        (mesh,) = full_forest.shape(window.shapes[window.shape[i]])
        corners_m = mesh.vertices_m @ window.world_T_shape[i, :, :3].T
        assert pdist(corners_m).max() == pytest.approx(log.size_m[0], rel=0.15)
        assert 0.2 <= log.size_m[1] <= 0.5
    assert all(0.1 <= one.size_m[0] <= 1.5 for one in things if one.kind == "stone")


SPECIES = flora().names


@pytest.fixture(scope="module")
def near(trees, way):
    """Trees within the radius of a twin."""
    return trees[way.distance_m(feet_m(trees)[:, :2]) <= RADIUS_M]


@pytest.fixture(scope="module")
def glb(full_forest, window, near, things, way):
    """The bytes of a twin."""
    places_m = {one.instance: one.place_m for one in things}
    places_m |= dict(zip(near["id"].tolist(), feet_m(near), strict=True))
    file, look = (
        io.BytesIO(),
        {"species": SPECIES, "colours": np.full((len(window.surfaces), 3), 128, np.uint8)},
    )
    inside = lambda xy_m: way.distance_m(xy_m) <= RADIUS_M  # noqa: E731
    write_glb(file, window, full_forest.shape, places_m=places_m, inside=inside, **look)
    return file.getvalue()


@pytest.fixture(scope="module")
def header(glb):
    length = struct.unpack_from("<I", glb, 12)[0]
    return json.loads(glb[20 : 20 + length])


def test_every_instance_is_one_node_with_its_labels(header, near, things):
    """There is one node for each tree and thing, named by class, number and species, and no other
    instance."""
    names = {node["name"] for node in header["nodes"]}
    wanted = {f"tree_{t['id']:06d}/{SPECIES[int(t['species'])]}" for t in near}
    for one in things:
        grass = dict.fromkeys(("tuft", "herb", "fern", "dwarf_shrub"), "grass")
        dead = dict.fromkeys(("log", "broken_log", "stump", "broken_stump", "root_plate"), "deadwood")
        kind = {"sapling": "tree", **dead, **grass}.get(one.kind, one.kind)
        wanted.add(f"{kind}_{one.instance:06d}" + (f"/{SPECIES[one.species]}" if one.species else ""))
    assert wanted <= names
    children = {name.split("/")[0] for name in names if "_" in name}
    assert children == {name.split("/")[0] for name in wanted}


def test_parts_say_in_numbers_what_their_names_say_and_share_meshes(header):
    """The extras of a part's node are the numbers of its class, part, instance and species.

    Stones, tufts and crowns of one prototype share its mesh: there are fewer meshes than nodes that show one.
    """
    node = next(n for n in header["nodes"] if n["name"].endswith("/stem") and n["name"].startswith("tree_"))
    name, species, _ = node["name"].split("/")
    extras = node["extras"]
    assert SPECIES[extras.pop("species")] == species
    assert extras == {
        "semantic": Semantic.TREE,
        "part": PlantPart.STEM,
        "instance": int(name.removeprefix("tree_")),
    }
    shown = [node["mesh"] for node in header["nodes"] if "mesh" in node]
    assert sorted(set(shown)) == list(range(len(header["meshes"])))
    assert len(shown) > 2 * len(header["meshes"])
    stones = {n["mesh"] for n in header["nodes"] if n["name"].startswith("stone_") and "mesh" in n}
    assert 1 <= len(stones) <= 2 * 6  # small and large ones, and variants


def test_materials_are_few_and_seen_from_both_sides(header):
    """One material for each part of a species or class, double-sided, of linear base colour."""
    names = [material["name"] for material in header["materials"]]
    assert len(names) == len(set(names))
    assert {"ground", "stone", "silver_birch leaf", "silver_birch stem"} <= set(names)
    for material in header["materials"]:
        assert material["doubleSided"]
        red = material["pbrMetallicRoughness"]["baseColorFactor"][0]
        assert red == pytest.approx(((128 / 255 + 0.055) / 1.055) ** 2.4, abs=1 / 255)


def test_ground_is_that_of_the_place_and_stems_are_whole(glb, full_forest, window, near):
    """The area of the ground is that of two half discs and a rectangle along the path; stems of near trees
    have all their faces."""
    scene, wanted = trimesh.load_scene(io.BytesIO(glb), file_type="glb"), Counter()
    shown_m2, faces = 0.0, Counter()
    for node in scene.graph.nodes_geometry:
        mesh, labels = scene.geometry[scene.graph[node][1]], node.split("/")
        faces[labels[0]] += len(mesh.faces) if labels[-1] == "stem" else 0
        if labels[0].startswith("ground"):
            ab, ac = (
                mesh.triangles[:, i, :2] - mesh.triangles[:, 0, :2] for i in (1, 2)
            )  # z is still up in meshes
            shown_m2 += np.abs(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]).sum() / 2
    assert shown_m2 == pytest.approx(np.pi * RADIUS_M**2 + 2 * RADIUS_M * np.hypot(4, 0.9), rel=0.02)
    for key, first in zip(
        (window.shapes[i] for i in window.shape), window.first_surface.tolist(), strict=True
    ):
        meshes = full_forest.shape(key) if isinstance(key, TileKey) else ()
        for mesh, row in zip(meshes, window.surfaces[first:], strict=False):
            if row["part"] == PlantPart.STEM:
                wanted[f"tree_{row['instance']:06d}"] += len(mesh.faces) * (mesh.faces.shape[1] - 2)
    trees = [f"tree_{number:06d}" for number in near["id"]]
    assert {tree: faces[tree] for tree in trees} == {tree: wanted[tree] for tree in trees}
