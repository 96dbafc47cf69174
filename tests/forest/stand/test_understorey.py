"""Saplings and shrubs."""

from itertools import product

import numpy as np
import pytest
import trimesh
from scipy import stats
from trimesh.intersections import mesh_plane

from vlp16emu.errors import GeometryError
from vlp16emu.forest.plants.flora import shrub_table, species_table
from vlp16emu.forest.plants.undergrowth import SAPLING_PARTS, SHRUB_PARTS, SaplingKey, sapling_meshes
from vlp16emu.forest.stand.placed import Site
from vlp16emu.forest.stand.scatter import layer_of
from vlp16emu.forest.stand.settings import Regeneration, Scattered, Shrubs
from vlp16emu.forest.stand.stand import REGENERATION
from vlp16emu.types import PlantPart, Semantic
from vlp16emu.world.polyline import Corridor, distance_m

PATH = np.array([[-10.0, 10.0], [120.0, 60.0]])
YOUNG = ["european_beech", "norway_spruce"]
BUSHES = ["hazel", "hawthorn"]
KEYS = [SaplingKey(name, 0, height_m, "leaf_on") for name in YOUNG for height_m in (0.6, 3.6)]


ANYWHERE = Scattered(kind="random")


def saplings(*species):
    section = Regeneration(stems_per_ha=1500.0, species=[*species], height_m=(0.5, 4.0), pattern=ANYWHERE)
    return layer_of(section, seed=6, season="leaf_on")


def shrubs(*species):
    section = Shrubs(per_ha=1500.0, species=[*species], pattern=ANYWHERE)
    return layer_of(section, seed=6, season="leaf_on")


def placed(layer):
    plots = (
        Site(
            seed=6,
            ix=ix,
            iy=iy,
            height_m=lambda x, y: 0.1 * x,
            path=Corridor(PATH, 0.8),
            trunks=np.array([[10.0, 50.0, 3.0]]),
        )
        for ix, iy in product(range(6), range(6))
    )
    return [layer.place(plot) for plot in plots]


def test_sapling_heights_are_even_and_their_species_as_frequent():
    """Heights are uniform between the limits and half are of either species; feet are on the ground."""
    trees = np.concatenate([tile.trees for tile in placed(saplings(*YOUNG))])
    far = trees[distance_m(np.column_stack([trees["x_m"], trees["y_m"]]), PATH) > 2]
    assert stats.kstest(far["height_m"], stats.uniform(0.5, 3.5).cdf).pvalue > 0.01
    beeches = int((far["species"] == species_table()["european_beech"].number).sum())
    assert stats.binomtest(beeches, len(far), 0.5).pvalue > 0.01
    assert trees["z_m"] == pytest.approx(0.1 * trees["x_m"])
    assert set(trees["storey"]) == {REGENERATION}


def test_a_placed_sapling_has_the_height_and_diameter_of_its_record():
    """The tip of the placed stem is at the record's height, and its section at 1.3 m has the area of its DBH."""
    tile = next(t for t in placed(saplings(*YOUNG)) if (t.trees["height_m"] > 3).any())
    i = int(np.argmax(tile.trees["height_m"]))
    tree, T = tile.trees[i], tile.world_T_shape[i]
    stem = sapling_meshes(6, tile.keys[tile.shape[i]])[0]
    body = trimesh.Trimesh(stem.vertices_m @ T[:, :3].T + T[:, 3], stem.faces, process=False)
    assert body.is_watertight
    assert body.bounds[1, 2] == pytest.approx(tree["z_m"] + tree["height_m"], abs=1e-5)
    cut = mesh_plane(body, plane_normal=[0, 0, 1], plane_origin=[0, 0, tree["z_m"] + 1.3])
    a, b = np.moveaxis(cut[..., :2] - cut[..., :2].mean(axis=(0, 1)), 1, 0)
    area_m2 = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2
    assert 2 * np.sqrt(area_m2 / np.pi) == pytest.approx(tree["dbh_m"], abs=1e-5)


def test_saplings_are_no_symmetric_stars():
    """Their tips are up to 0.15 of the height aside, and their leaves reach further to one side, differently each."""
    tips, middles = [], []
    for variant in range(4):
        stem, _, _, leaves = sapling_meshes(6, SaplingKey("european_beech", variant, 3.0, "leaf_on"))
        tips.append(stem.vertices_m[stem.vertices_m[:, 2].argmax(), :2])
        middles.append(leaves.vertices_m[:, :2].mean(axis=0))
    aside_m = np.linalg.norm(tips, axis=1)
    assert 0.05 < aside_m.max() <= 0.15 * 3.0 + 1e-6
    assert np.ptp(middles, axis=0).min() > 0.05


def test_a_sapling_fills_its_crown():
    """Branches and leaves begin above the ground and stay within about the height and half of it in width."""
    for key in KEYS:
        _, first, second, leaves = sapling_meshes(6, key)
        vertices = np.concatenate([mesh.vertices_m for mesh in (first, second, leaves)])
        assert vertices[:, 2].min() > -0.25, key
        assert vertices[:, 2].max() == pytest.approx(key.height_m, rel=0.25), key
        width = np.quantile(np.abs(leaves.vertices_m[:, :2]), 0.99)
        assert 0.15 * key.height_m < width < 0.35 * key.height_m + 0.12, key


def test_shrub_heights_are_those_of_their_kind():
    """Heights of each kind are uniform between its own limits, and instances are stretched from prototypes by under a fifth."""
    tiles = placed(shrubs(*BUSHES))
    heights, kinds = [], []
    for tile in tiles:
        scale = np.linalg.norm(tile.world_T_shape[:, :, 2], axis=1)
        assert np.abs(np.log(scale)).max(initial=0) < np.log(1.2)
        heights += (scale * [tile.keys[i].height_m for i in tile.shape]).tolist()
        kinds += [tile.keys[i].species for i in tile.shape]
    for name in BUSHES:
        low, high = shrub_table()[name].height_m
        own = np.array(heights)[np.array(kinds) == name]
        assert len(own) > 200
        # Large bushes keep farther from the path, so a few of them are missing.
        assert stats.kstest(own, stats.uniform(low, high - low).cdf).statistic < 0.08


def test_plants_keep_away_from_path_and_trunks():
    """Neither crown nor bush reaches nearer to the path than 0.8 m, and no foot is in a trunk."""
    for kind in (saplings(*YOUNG), shrubs(*BUSHES)):
        for tile in placed(kind):
            xy = tile.world_T_shape[:, :2, 3]
            scale = np.linalg.norm(tile.world_T_shape[:, :, 0], axis=1)
            keys = [tile.keys[i] for i in tile.shape]
            width = scale * [key.height_m / 2 if isinstance(key, SaplingKey) else key.width_m for key in keys]
            assert (distance_m(xy, PATH) - width / 2).min(initial=0.8) >= 0.8 - 1e-9
            assert np.hypot(*(xy - (10, 50)).T).min(initial=3.0) >= 3.0


def test_saplings_leave_room_to_trees():
    """From the bark of a trunk a sapling is 0.15 of its height, half a metre at most, away; near one there are fewer for it."""
    nearest_m = []
    for tile in placed(saplings(*YOUNG)):
        gap_m = np.hypot(*(tile.world_T_shape[:, :2, 3] - (10, 50)).T) - 3.0
        room_m = np.minimum(0.15 * tile.trees["height_m"], 0.5)
        assert (gap_m >= room_m).all()
        nearest_m += gap_m.tolist()
    assert min(nearest_m) < 1.5


@pytest.mark.parametrize(
    ("kind", "semantic", "parts"),
    [(saplings(*YOUNG), Semantic.TREE, SAPLING_PARTS), (shrubs(*BUSHES), Semantic.SHRUB, SHRUB_PARTS)],
)
def test_labels_name_class_parts_and_species(kind, semantic, parts):
    """Rows have the parts in order, and leaf and bark of a plant have reflectances near those of its species."""
    for tile in placed(kind):
        assert (tile.surfaces["semantic"] == semantic).all()
        assert (tile.surfaces["part"] == parts).all()
        for i, rows in zip(tile.shape, tile.surfaces, strict=True):
            plant = {**species_table(), **shrub_table()}[tile.keys[i].species]
            assert (rows["species"] == plant.number).all()
            middle = np.where(rows["part"] == PlantPart.LEAF, plant.leaf_reflectance, plant.bark_reflectance)
            assert np.abs(rows["reflectance"] - middle).max() < 0.08 + 1e-6


def test_unknown_plants_are_named():
    """Unknown saplings and shrubs are refused with the key and the names that exist."""
    with pytest.raises(
        GeometryError, match=r"regeneration.species: unknown species 'larch'; expected one of silver_birch"
    ):
        saplings("larch")
    with pytest.raises(GeometryError, match=r"shrubs.species: unknown species 'broom'; expected one of hazel"):
        shrubs("broom")
