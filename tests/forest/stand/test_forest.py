"""Windows on the forest."""

from functools import cache
from itertools import product

import numpy as np
import pytest
from forest.kit import REACH_M, feet_m

from vlp16emu.errors import GeometryError
from vlp16emu.foliage.polyline import distance_m
from vlp16emu.forest.make import ForestSite
from vlp16emu.forest.plants.prototypes import CROWN_PARTS
from vlp16emu.forest.settings import SpeciesShare
from vlp16emu.forest.stand.floor_shapes import FloorKey, is_ground
from vlp16emu.forest.stand.forest import Region
from vlp16emu.forest.stand.stand import REGENERATION
from vlp16emu.forest.tiles import TileKey
from vlp16emu.types import PlantPart, Semantic

THIN = SpeciesShare(species="silver_birch", share=1.0, dbh_cm=5.0, height_m=6.0)


def placed(window):
    """Everything of a window, by the instance of its first surface: a list of (key, transform, surface
    row)."""
    found = {}
    for shape, transform, first in zip(window.shape, window.world_T_shape, window.first_surface, strict=True):
        key = window.shapes[shape]
        name = key if isinstance(key, TileKey) else int(window.surfaces[first]["instance"])
        found[name] = (key, transform.tobytes())
    return found


@pytest.fixture(scope="module")
def shape(forest):
    """Meshes of the trees alone, which take long to make."""
    return cache(forest.shape)


def test_surfaces_belong_to_the_meshes_they_show(forest, shape, track_m):
    """Each tile's rows are its ground and the stems of its trees in order; each crown's are the parts of
    one tree."""
    window, trees = forest.window(track_m), forest.trees(track_m)
    used = np.zeros(len(window.surfaces), int)
    meshes = {key: len(shape(key)) for key in window.shapes}
    stems = []
    for which, first in zip(window.shape, window.first_surface, strict=True):
        key = window.shapes[which]
        rows = window.surfaces[first : first + meshes[key]]
        used[first : first + len(rows)] += 1
        if isinstance(key, TileKey):
            assert rows["semantic"].tolist() == [Semantic.GROUND] + [Semantic.TREE] * (len(rows) - 1)
            assert set(rows["part"][1:].tolist()) <= {PlantPart.STEM, PlantPart.ROOT_FLARE}
            stems += rows["instance"][1:][rows["part"][1:] == PlantPart.STEM].tolist()
        else:
            assert rows["part"].tolist() == list(CROWN_PARTS)
            tree = trees[trees["id"] == rows["instance"][0]][0]
            assert (rows["instance"] == tree["id"]).all()
            assert (rows["species"] == tree["species"]).all()
            leaf = rows["part"] == PlantPart.LEAF
            assert (
                rows["reflectance"] == np.where(leaf, tree["leaf_reflectance"], tree["bark_reflectance"])
            ).all()
            names = [forest.materials[m] for m in rows["material"]]
            assert names == [f"{key.species} {'leaf' if is_leaf else 'bark'}" for is_leaf in leaf]
    assert (used == 1).all()
    assert stems == trees["id"].tolist()


def test_leaves_have_the_coat_of_the_scene_and_nothing_else_has(make_forest, track_m):
    """`leaf_roughness` is that of all leaves, wood and ground are matt; leaves have no texture."""
    rows = make_forest(leaf_roughness=0.1, texture=0.2).window(track_m).surfaces
    is_leaf = rows["part"] == PlantPart.LEAF
    assert is_leaf.any()
    assert rows["roughness"] == pytest.approx(0.1 * is_leaf)
    assert rows["texture"] == pytest.approx(0.2 * ~is_leaf)


def test_stems_and_crowns_are_where_the_records_say(forest, shape, track_m):
    """The tip of a stem's mesh, the top of its crown's axis and the tree record agree to a millimetre.

    A crown's placement stretches its prototype's width to the tree's, and turns it by a proper rotation.
    """
    window, trees = forest.window(track_m), forest.trees(track_m)
    tips, tops, widths = {}, {}, {}
    for which, T, first in zip(window.shape, window.world_T_shape, window.first_surface, strict=True):
        key = window.shapes[which]
        if isinstance(key, TileKey):
            for j, stem in enumerate(shape(key)[1:], start=1):
                tips[int(window.surfaces[first + j]["instance"])] = T[:, :3] @ stem.vertices_m[-1] + T[:, 3]
        else:
            instance, gram = int(window.surfaces[first]["instance"]), T[:, :3].T @ T[:, :3]
            assert np.abs(gram - np.diag(np.diag(gram))).max() < 1e-12
            assert np.linalg.det(T[:, :3]) > 0
            tops[instance] = T @ [0, 0, key.crown_length_m, 1]
            widths[instance] = np.sqrt(gram[0, 0]) * key.crown_width_m
    for tree in trees:
        i = int(tree["id"])
        assert widths[i] == pytest.approx(tree["crown_width_m"])
        assert tips[i][2] == pytest.approx(tree["z_m"] + tree["height_m"], abs=1e-4)
        assert np.abs(tips[i] - tops[i]).max() < 1e-3


@pytest.mark.parametrize("with_layers", [False, True])
def test_everything_is_the_same_from_either_end(make_forest, with_layers):
    """Windows of a walk and of the walk back, tiles last to first, agree on every thing that they share:
    key, place and bytes."""
    path = np.array([[0.0, 0.0], [30.0, 4.0], [45.0, -3.0]])
    there, back = (make_forest(path_xy_m=way, with_layers=with_layers) for way in (path, path[::-1]))
    tracks = [np.column_stack([x + np.linspace(0, 10, 5), np.zeros(5), np.full(5, 2.0)]) for x in (0, 15)]
    first = [there.window(track) for track in tracks]
    second = [back.window(track[::-1]) for track in tracks[::-1]][::-1]
    shapes = set()
    for a, b in zip(first, second, strict=True):
        assert placed(a) == placed(b)
        shapes |= set(a.shapes)
    near, far = placed(first[0]), placed(first[1])
    shared = (near.keys() & far.keys()) - {0}  # moss and litter have no number
    assert len(shared) > 50
    assert all(near[name] == far[name] for name in shared)
    for key in sorted(shapes, key=str)[::-20]:
        for one, other in zip(there.shape(key), back.shape(key), strict=True):
            assert (one.vertices_m.tobytes(), one.faces.tobytes()) == (
                other.vertices_m.tobytes(),
                other.faces.tobytes(),
            )


def test_trees_have_numbers_of_their_own_and_a_window_holds_all_in_reach(forest, track_m):
    """Along the path no two trees share a number, none has 0, and those with their foot within reach of a
    track are in its window."""
    everything = forest.trees(np.column_stack([np.linspace(-8, 60, 30), np.zeros(30), np.zeros(30)]))
    assert len(np.unique(everything["id"])) == len(everything) > 200
    assert everything["id"].min() > 0
    gap = np.hypot(everything["x_m"] - track_m[:, :1], everything["y_m"] - track_m[:, 1:2]).min(axis=0)
    assert set(everything["id"][gap < REACH_M]) <= set(forest.trees(track_m)["id"])


def is_low(key):
    return isinstance(key, FloorKey) and is_ground(key.kind)


def test_everything_has_one_number_and_its_own_class(full_forest, track_m):
    """Trees, saplings, shrubs, stones, logs, stumps and low plants have numbers of their own, a semantic
    class, and its material."""
    window = full_forest.window(track_m)
    no_ground = ~np.array([isinstance(key, TileKey) or is_low(key) for key in window.shapes])[window.shape]
    rows = window.surfaces[window.first_surface[no_ground]]
    assert len(np.unique(rows["instance"])) == len(rows)
    assert rows["instance"].min() > 0
    counts = {kind: int((rows["semantic"] == kind).sum()) for kind in Semantic}
    assert counts[Semantic.TREE] == len(full_forest.trees(track_m))
    assert min(counts[k] for k in (Semantic.SHRUB, Semantic.STONE, Semantic.DEADWOOD, Semantic.GRASS)) > 10
    for row in rows:
        name = full_forest.materials[row["material"]]
        dead = "litter" if row["part"] == PlantPart.ROOT_FLARE else "dead wood"
        grass = ("grass", "herb", "fern", "dwarf shrub")
        fixed = {Semantic.STONE: ("stone",), Semantic.DEADWOOD: (dead,), Semantic.GRASS: grass}
        assert name in fixed.get(Semantic(int(row["semantic"])), (name,) if " bark" in name else ())


def test_moss_and_litter_are_no_part_of_the_medium(full_forest, track_m):
    """They are near geometry, without a number; herbs and all else are in the far medium too."""
    window = full_forest.window(track_m)
    low = np.array([is_low(key) for key in window.shapes])[window.shape]
    assert low.sum() > 50
    assert (window.far == ~low).all()
    assert (window.low == low).all()
    assert (window.surfaces["instance"][window.first_surface[low]] == 0).all()


def test_saplings_are_trees_with_a_flag(full_forest, forest, track_m):
    """Records hold the canopy, unchanged by what grows under it, and saplings marked as such with a true
    diameter."""
    trees = full_forest.trees(track_m)
    young = trees[trees["storey"] == REGENERATION]
    old = trees[trees["storey"] != REGENERATION]
    assert len(young) > 50
    assert np.array_equal(old[["x_m", "y_m", "dbh_m"]], forest.trees(track_m)[["x_m", "y_m", "dbh_m"]])
    assert (young["dbh_m"] < 0.05).all()
    assert ((young["dbh_m"] > 0) == (young["height_m"] > 1.3)).all()


def test_bare_ground(make_forest, track_m):
    """A forest of no stems is ground and nothing else."""
    window = make_forest(stems_per_ha=0.0).window(track_m)
    assert all(isinstance(key, TileKey) for key in window.shapes)
    assert (window.surfaces["semantic"] == Semantic.GROUND).all()
    assert len(window.surfaces) == len(window.shape)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"path_xy_m": np.array([[0.0, 0.0], [np.nan, 1.0]])}, (r"path_xy_m\[1\]: found \[nan, 1.0\]; "
                                                               r"expected finite")),
        ({"path_xy_m": np.array([[0.0, 0.0], [9e4, 9e4]])}, "path_xy_m: spans 90 km x 90 km"),
        ({"stems_per_ha": 1.5e5, "species": [THIN]}, ("found 150000 trees and things per hectare; "
                                                     "expected at most 125000")),
    ],
)  # fmt: skip
def test_a_forest_that_cannot_be_is_refused(make_forest, changes, message):
    """Paths that are not finite or too long and stands too dense to number are named in one line."""
    with pytest.raises(GeometryError, match=message):
        make_forest(**changes)


def test_a_track_may_leave_the_region_of_the_path(make_forest, forest, track_m):
    """200 m off the path there is forest too, with numbers of its own, the same after any other window."""
    off_m = track_m + np.array([0.0, 200.0, 0.0])
    window = forest.window(off_m)
    assert placed(make_forest().window(off_m)) == placed(window)
    numbers = np.unique(window.surfaces["instance"])
    assert len(numbers) == 1 + len(forest.trees(off_m)) > 50
    near_path = set(forest.trees(track_m)["id"].tolist())
    assert near_path.isdisjoint(numbers.tolist())


@pytest.mark.parametrize("across", [(1, 1), (4, 2), (2, 5)])
def test_tiles_have_numbers_without_gaps(across):
    """A region that grows by three rings has all numbers from 0; its rectangle has the first, by columns."""
    region = Region((-2, 7), across)
    tiles = product(range(-5, across[0] + 1), range(4, across[1] + 10))
    numbers = [region.number(*tile) for tile in tiles]
    assert sorted(numbers) == list(range((across[0] + 6) * (across[1] + 6)))
    inside = product(range(-2, across[0] - 2), range(7, across[1] + 7))
    assert [region.number(*tile) for tile in inside] == list(range(across[0] * across[1]))
    for ring in range(4):
        first_numbers = {number for number in numbers if number < region.tiles_up_to(ring)}
        tiles = product(range(-5, across[0] + 1), range(4, across[1] + 10))
        assert first_numbers == {region.number(*tile) for tile in tiles if region.ring(*tile) <= ring}


def test_a_track_beyond_all_numbers_is_refused(forest, track_m):
    """Things 10 km off the path have no numbers below those of the user's objects, and that is one line."""
    with pytest.raises(
        GeometryError, match=r"track: reaches tile \(.*; expected at most 209 km2 around the path"
    ):
        forest.window(track_m + np.array([0.0, 1e4, 0.0]))
    begin_m = track_m[0]
    assert forest.reaches(begin_m + np.array([0.0, 6e3, 0.0]), 100.0)
    assert not forest.reaches(begin_m + np.array([0.0, 1e4, 0.0]), 100.0)
    assert not forest.reaches(begin_m - np.array([35e3, 0.0, 0.0]), 100.0)


@pytest.mark.parametrize("aside_m", [(-35, 0), (0, -35), (42, 0), (0, 35)])
def test_a_track_may_stray_from_the_path(make_forest, aside_m):
    """From 35 m off either end or side of the path all of a window's tiles have numbers, and the tiles
    around them."""
    bare = make_forest(stems_per_ha=0.0, path_xy_m=np.array([[0.0, 0.0], [7.0, 0.0]]))
    tiles = np.array([tile[:2] for tile in bare.window(np.array([[*aside_m, 2.0]])).tiles])
    for ix, iy in product(
        *((low - 1, high + 1) for low, high in zip(tiles.min(axis=0), tiles.max(axis=0), strict=True))
    ):
        assert bare.far_tile(int(ix), int(iy)).ground_m.shape == (85, 85)


def test_a_path_that_keeps_all_trees_out_of_sight_is_refused(forest, track_m):
    """A clearance of the range of the sensor would leave no stem that it sees; half of it leaves some."""
    sites = [
        ForestSite(forest.section.model_copy(update={"path_clearance_m": clearance_m}), 5)
        for clearance_m in (10.0, 20.0)
    ]
    view = {"reach_m": 20.0, "farthest_m": 20.0, "wind": None, "start_ns": 0}
    world, _ = sites[0].world(track_m[:, :2], **view)
    assert distance_m(feet_m(world.trees(track_m))[:, :2], track_m[:, :2]).min() < 20.0
    with pytest.raises(
        GeometryError, match=r"world\.path_clearance_m: found 20; expected less than the 20 m"
    ):
        sites[1].world(track_m[:, :2], **view)
