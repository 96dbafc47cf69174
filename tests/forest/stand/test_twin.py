"""What stands near a way, pieces cut out of a window, and the digital twin, read back by trimesh."""

import io
import json
import struct

import numpy as np
import pytest
from forest.kit import feet_m
from scipy.spatial.distance import pdist

from vlp16emu.foliage.polyline import Polyline
from vlp16emu.forest.plants.species import flora
from vlp16emu.forest.stand.stand import REGENERATION
from vlp16emu.forest.stand.twin import cut_out, things_near, write_glb
from vlp16emu.forest.tiles import TileKey
from vlp16emu.types import NO_SURFACE, PlantPart, Semantic

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
    """Things are exactly the placed instances within the radius that are neither ground nor trees of the stand."""
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


def test_a_piece_holds_what_is_wanted_and_ground_inside(full_forest, window, trees):
    """In a cut-out every face belongs to a wanted instance, or to ground inside the place; all else is as before."""
    wanted = trees["id"][:5]

    def inside(xy_m):
        return np.hypot(*(xy_m - [5.0, 1.0]).T) < 9.0

    piece, grow = cut_out(window, full_forest.shape, instances=wanted, inside=inside)
    assert piece.surfaces is window.surfaces
    seen, parts = set(), set()
    ground_m2 = 0.0
    for which, first, T in zip(piece.shape, piece.first_surface, piece.world_T_shape, strict=True):
        key, shape = piece.shapes[which], full_forest.shape(piece.shapes[which])
        for number, mesh in enumerate(grow(key)):
            row = piece.surfaces[int(first) + number]
            if not len(mesh.faces):
                continue
            if isinstance(key, TileKey) and row["semantic"] == Semantic.GROUND:
                corners = mesh.vertices_m[mesh.faces].astype(np.float64)
                assert inside(corners.mean(axis=1)[:, :2] + T[:2, 3]).all()
                ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
                ground_m2 += abs(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]).sum() / 2
            else:
                seen.add(int(row["instance"]))
                parts.add(int(row["part"]))
                assert mesh.faces.tobytes() == shape[number].faces.tobytes()
    assert ground_m2 == pytest.approx(np.pi * 81, rel=0.02)
    assert seen == {int(i) for i in wanted if np.isin(i, window.surfaces["instance"][window.first_surface])}
    assert PlantPart.STEM in parts


def test_a_piece_can_be_without_any_thing(full_forest, window):
    """With nothing wanted only ground is left, and no surface number is the one that means nothing."""
    place = {"instances": np.zeros(0, np.uint32), "inside": lambda xy_m: np.ones(len(xy_m), np.bool_)}
    piece, grow = cut_out(window, full_forest.shape, **place)
    assert all(isinstance(key, TileKey) for key in piece.shapes)
    assert (piece.first_surface != NO_SURFACE).all()
    assert all(not len(mesh.faces) for mesh in grow(piece.shapes[0])[1:])


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
    place = {"instances": np.array(list(places_m), np.uint32), "inside": lambda xy_m: way.distance_m(xy_m) <= RADIUS_M}
    piece, grow = cut_out(window, full_forest.shape, **place)
    file, colours = io.BytesIO(), np.full((len(window.surfaces), 3), 128, np.uint8)
    write_glb(file, piece, grow, places_m=places_m, species=SPECIES, colours=colours)
    return file.getvalue()


@pytest.fixture(scope="module")
def header(glb):
    length = struct.unpack_from("<I", glb, 12)[0]
    return json.loads(glb[20 : 20 + length])


def test_every_instance_is_one_node_with_its_labels(header, near, things):
    """There is one node for each tree and thing, named by class, number and species, and no other instance."""
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
    assert extras == {"semantic": Semantic.TREE, "part": PlantPart.STEM, "instance": int(name.removeprefix("tree_"))}
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
