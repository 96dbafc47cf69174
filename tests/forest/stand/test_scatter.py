"""What stands and lies under the trees: saplings, shrubs, stones, logs, stumps, grass and other low
plants."""

from itertools import product

import numpy as np
import pytest
import trimesh
from forest.kit import section_diameter_m
from scipy import stats
from scipy.spatial import KDTree

from vlp16emu.errors import GeometryError
from vlp16emu.foliage.polyline import Corridor, distance_m
from vlp16emu.forest import settings
from vlp16emu.forest.plants.prototypes import SAPLING_PARTS, SHRUB_PARTS, SaplingKey, sapling_meshes
from vlp16emu.forest.plants.species import flora
from vlp16emu.forest.stand.floor_shapes import FloorKind, floor_meshes
from vlp16emu.forest.stand.points import Land
from vlp16emu.forest.stand.scatter import Layer
from vlp16emu.forest.stand.stand import REGENERATION
from vlp16emu.types import PlantPart, Semantic

PATH = np.array([[-10.0, 10.0], [120.0, 60.0]])
YOUNG = ["european_beech", "norway_spruce"]
BUSHES = ["hazel", "hawthorn"]

ANYWHERE = settings.Scattered(kind="random")
FAR = np.array([[0.0, 1e5]])
NEAR = np.array([[-10.0, 10.0], [60.0, 30.0]])
ACROSS = np.array([[-10.0, 10.0], [170.0, 60.0]])
NO_TRUNKS = np.zeros((0, 3))
TILES = list(product(range(8), range(8)))


def ground(x, y):
    return 0.2 * x + 0.1 * y + 0.1 * np.sin(x / 3)


def layer(section, *, path=FAR, height_m=ground, seed=6):
    return Layer(section, Land(seed, height_m, Corridor(path, 0.8)))


def things(section, tiles=TILES, *, trunks=NO_TRUNKS, **where):
    """Things on tiles, tile by tile."""
    own = layer(section, **where)
    return [own.place(*tile, trunks) for tile in tiles]


def saplings(*species):
    return settings.Regeneration(
        stems_per_ha=1500.0, species=[*species], height_m=(0.5, 4.0), pattern=ANYWHERE
    )


def shrubs(*species):
    return settings.Shrubs(per_ha=1500.0, species=[*species], pattern=ANYWHERE)


def placed(section):
    where = {"path": PATH, "trunks": np.array([[10.0, 50.0, 3.0]]), "height_m": lambda x, y: 0.1 * x}
    return things(section, product(range(6), repeat=2), **where)


def test_sapling_heights_are_even_and_their_species_as_frequent():
    """Heights are uniform between the limits and half are of either species; feet are on the ground."""
    trees = np.concatenate([tile.trees for tile in placed(saplings(*YOUNG))])
    far = trees[distance_m(np.column_stack([trees["x_m"], trees["y_m"]]), PATH) > 2]
    assert stats.kstest(far["height_m"], stats.uniform(0.5, 3.5).cdf).pvalue > 0.01
    beeches = int((far["species"] == flora().trees["european_beech"].number).sum())
    assert stats.binomtest(beeches, len(far), 0.5).pvalue > 0.01
    assert trees["z_m"] == pytest.approx(0.1 * trees["x_m"])
    assert set(trees["storey"]) == {REGENERATION}


def test_a_placed_sapling_has_the_height_and_diameter_of_its_record():
    """The tip of the placed stem is at the record's height, and its section at 1.3 m has the area of its
    DBH."""
    tile = next(t for t in placed(saplings(*YOUNG)) if (t.trees["height_m"] > 3).any())
    i = int(np.argmax(tile.trees["height_m"]))
    tree, T = tile.trees[i], tile.world_T_shape[i]
    stem = sapling_meshes(6, tile.keys[i])[0]
    body = trimesh.Trimesh(stem.vertices_m @ T[:, :3].T + T[:, 3], stem.faces, process=False)
    assert body.is_watertight
    assert body.bounds[1, 2] == pytest.approx(tree["z_m"] + tree["height_m"], abs=1e-5)
    assert section_diameter_m(body, [0, 0, 1], [0, 0, tree["z_m"] + 1.3]) == pytest.approx(
        tree["dbh_m"], abs=1e-5
    )


def test_shrub_heights_are_those_of_their_kind():
    """Heights of each kind are uniform between its own limits, and instances are stretched from prototypes
    by under a fifth."""
    tiles = placed(shrubs(*BUSHES))
    heights, kinds = [], []
    for tile in tiles:
        scale = np.linalg.norm(tile.world_T_shape[:, :, 2], axis=1)
        assert np.abs(np.log(scale)).max(initial=0) < np.log(1.2)
        heights += (scale * [key.height_m for key in tile.keys]).tolist()
        kinds += [key.species for key in tile.keys]
    for name in BUSHES:
        low, high = flora().shrubs[name].height_m
        own = np.array(heights)[np.array(kinds) == name]
        assert len(own) > 200
        # Large bushes keep farther from the path, so a few of them are missing.
        assert stats.kstest(own, stats.uniform(low, high - low).cdf).statistic < 0.08


def test_plants_keep_away_from_path_and_trunks():
    """Neither crown nor bush reaches nearer to the path than 0.8 m, and no foot is in a trunk.

    From its bark a sapling is 0.15 of its height, half a metre at most, away; near it there are fewer for it.
    """
    nearest_m = []
    for kind in (saplings(*YOUNG), shrubs(*BUSHES)):
        for tile in placed(kind):
            xy = tile.world_T_shape[:, :2, 3]
            scale = np.linalg.norm(tile.world_T_shape[:, :, 0], axis=1)
            widths = [key.height_m / 2 if isinstance(key, SaplingKey) else key.width_m for key in tile.keys]
            width = scale * widths
            assert (distance_m(xy, PATH) - width / 2).min(initial=0.8) >= 0.8 - 1e-9
            gap_m = np.hypot(*(xy - (10, 50)).T) - 3.0
            assert gap_m.min(initial=0.0) >= 0.0
            if len(tile.trees):
                assert (gap_m >= np.minimum(0.15 * tile.trees["height_m"], 0.5)).all()
                nearest_m += gap_m.tolist()
    assert min(nearest_m) < 1.5


def test_unknown_plants_are_named():
    """Unknown saplings and shrubs are refused with the key and the names that exist."""
    for kind, name, key, first in (
        (saplings, "larch", "regeneration", "silver_birch"),
        (shrubs, "broom", "shrubs", "hazel"),
    ):
        with pytest.raises(
            GeometryError, match=f"{key}.species: unknown species '{name}'; expected one of {first}"
        ):
            layer(kind(name))


def some_logs(uprooted=0.0, broken=0.0, decayed=0.0):
    """Logs that are sound, whole and cut if nothing else is said."""
    shares = {"uprooted": uprooted, "broken": broken, "decayed": decayed}
    size = {"diameter_m": (0.2, 0.6), "length_m": (3.0, 12.0)}
    return settings.Logs(per_ha=200.0, species=["norway_spruce", "european_beech"], **size, **shares)


def found_of(section, **where):
    """Transforms and surface rows by kind, on level ground."""
    found = {}
    for tile in things(section, height_m=lambda x, y: 0 * x, **where):
        for i, key in enumerate(tile.keys):
            found.setdefault(key.kind, []).append((tile.world_T_shape[i], tile.surfaces[i, 0]))
    return {kind: tuple(map(np.array, zip(*rows, strict=True))) for kind, rows in found.items()}


STONES = settings.Stones(cover=0.05)
LOGS = some_logs()
STUMPS = settings.Stumps(per_ha=200.0, species=["silver_birch"], diameter_m=(0.2, 0.5))
GRASS = settings.Grass(tufts_per_m2=1.0, height_m=(0.15, 0.5))
FERNS = settings.Ferns(cover=0.3)
ALL = pytest.mark.parametrize(
    "section", [STONES, LOGS, STUMPS, GRASS, FERNS], ids=["stones", "logs", "stumps", "grass", "ferns"]
)


def world_T(section, tiles=TILES, **where):
    return np.concatenate([tile.world_T_shape for tile in things(section, tiles, **where)])


def size_m(world_T):
    return np.linalg.norm(world_T[:, :, :3], axis=1)


def test_stones_cover_the_share_that_was_asked_for():
    """One in twenty vertical rays on 0.6 hectares of flat ground meets a stone, within 12 %, three sigma."""
    at_m = np.random.default_rng(2).uniform(2, [38, 158], (20_000, 2))
    tree, rays = KDTree(at_m), {}
    for placed in things(STONES, TILES[:16], height_m=lambda x, y: np.zeros(np.shape(x))):
        for key, T in zip(placed.keys, placed.world_T_shape, strict=True):
            number = np.array(tree.query_ball_point(T[:2, 3], np.linalg.norm(T[:2, 0])), int)
            own = np.linalg.solve(T[:, :3], np.pad(at_m[number], ((0, 0), (0, 1))).T - T[:, 3:]).T
            rays.setdefault(key, []).append(np.column_stack([own, number]))
    met = set()
    for key, parts in rays.items():
        (stone,), (x, y, ground_z, number) = floor_meshes(6, key), np.concatenate(parts).T
        mesh = trimesh.Trimesh(stone.vertices_m, stone.faces, process=False)
        origin = np.column_stack([x, y, np.full(len(x), 2.0)])
        places, ray, _ = mesh.ray.intersects_location(origin, [[0, 0, -1]] * len(x), multiple_hits=False)
        met |= set(number[ray[places[:, 2] > ground_z[ray]]])
    assert len(met) / len(at_m) == pytest.approx(0.05, rel=0.12)


def test_stone_lengths_are_log_normal_between_their_limits():
    """Lengths pass a Kolmogorov-Smirnov test against the log-normal of median 0.22 m cut at 0.1 m and 1.5
    m."""
    length = size_m(world_T(STONES))[:, 0]
    whole = stats.lognorm(0.6, scale=0.22)
    low, high = whole.cdf(0.1), whole.cdf(1.5)
    assert stats.kstest(length, lambda x: (whole.cdf(x) - low) / (high - low)).pvalue > 0.01
    assert 0.1 <= length.min() < length.max() <= 1.5


def test_stones_lie_a_third_to_two_thirds_in_the_ground():
    """The share of a stone's height that is under the ground at its middle is even between 30 % and 60 %."""
    placed = world_T(STONES)
    height = size_m(placed)[:, 2]
    depth = ground(placed[:, 0, 3], placed[:, 1, 3]) - (placed[:, 2, 3] - height / 2)
    assert stats.kstest(depth / height, stats.uniform(0.3, 0.3).cdf).pvalue > 0.01


def test_logs_lie_along_the_ground():
    """On a plane a log's axis is parallel to it, three quarters of its radius above it; sizes are as asked
    for."""
    placed = world_T(LOGS, height_m=lambda x, y: 0.2 * x + 0.1 * y)
    length, diameter, thick = size_m(placed).T
    axis = placed[:, :, 0] / length[:, None]
    assert axis[:, 2] == pytest.approx(0.2 * axis[:, 0] + 0.1 * axis[:, 1])
    over = placed[:, 2, 3] - 0.2 * placed[:, 0, 3] - 0.1 * placed[:, 1, 3]
    assert over == pytest.approx(0.75 * diameter / 2)
    assert diameter == pytest.approx(thick)
    assert stats.kstest(length, stats.uniform(3, 9).cdf).pvalue > 0.01
    assert stats.kstest(diameter, stats.uniform(0.2, 0.4).cdf).pvalue > 0.01
    turn = np.degrees(np.arctan2(axis[:, 1], axis[:, 0])) % 360
    assert stats.kstest(turn, stats.uniform(0, 360).cdf).pvalue > 0.01


def test_stumps_stand_on_the_ground():
    """A stump's origin is on the ground, upright, with the sizes asked for."""
    placed = world_T(STUMPS)
    assert placed[:, 2, 3] == pytest.approx(ground(placed[:, 0, 3], placed[:, 1, 3]))
    assert np.abs(placed[:, :2, 2]).max() == 0
    wide, _, high = size_m(placed).T
    assert stats.kstest(wide, stats.uniform(0.2, 0.3).cdf).pvalue > 0.01
    assert stats.kstest(high, stats.uniform(0.1, 0.3).cdf).pvalue > 0.01


def test_grass_grows_beside_the_path_alone():
    """Tufts are within 25 m of the path, with their density there, and far tiles have none."""
    placed = world_T(GRASS, path=NEAR)
    gap = distance_m(placed[:, :2, 3], NEAR)
    assert 24 < gap.max() < 25
    near = distance_m(np.random.default_rng(1).uniform(0, 160, (100_000, 2)), NEAR)
    area_m2 = 160**2 * ((near < 25) & (near > 0.95)).mean()
    assert len(placed) == pytest.approx(area_m2, rel=0.06)
    assert [len(tile.keys) > 0 for tile in things(GRASS, [(2, 1), (1, 4)], path=NEAR)] == [True, False]


HIGH = [settings.Herbs(cover=0.2), settings.Ferns(cover=0.1), settings.DwarfShrubs(cover=0.15)]
LOW = [settings.Moss(cover=0.5), settings.Litter(cover=0.3)]


@pytest.mark.parametrize("section", HIGH + LOW, ids=lambda section: type(section).__name__)
def test_plants_cover_the_share_that_was_asked_for(section):
    """Outlines cover the share of the scene of the ground beside the path, up to their reach, within 10 %;
    heights are even in their range."""
    at_m, reach_m = np.random.default_rng(1).uniform(2, 158, (12_000, 2)), 12 if section in LOW else 25
    away = distance_m(at_m, NEAR)
    at_m, shares = at_m[(away > 2.5) & (away < reach_m - 1)], []
    for seed in range(6, 12):
        placed = world_T(section, seed=seed, path=NEAR, height_m=lambda x, y: 0 * x)
        wide, _, high = size_m(placed).T
        assert reach_m - 0.5 < distance_m(placed[:, :2, 3], NEAR).max() < reach_m
        low_m, high_m = section.height_m
        assert stats.kstest(high, stats.uniform(low_m, high_m - low_m).cdf).pvalue > 0.01
        within = KDTree(at_m).query_ball_point(placed[:, :2, 3], wide / 2)
        shares.append(len(set().union(*within)) / len(at_m))
    assert np.mean(shares) == pytest.approx(section.cover, rel=0.1)


def test_plants_stand_in_patches_and_moss_and_litter_do_not():
    """Variance over mean of counts in squares of 2 m: over 3 of herbs, 2 of dwarf shrubs and 1.1 of ferns,
    which are few; 1 of moss and litter.

    Clapham (1936, J. Ecology 24) found more than 1 in 42 of 44 species of prairie, and more where there are
    more plants; how much more under trees is an estimate.
    """
    for section, least in (
        (settings.Herbs(cover=0.1), 3.0),
        (settings.DwarfShrubs(cover=0.04), 2.0),
        (settings.Ferns(cover=0.03), 1.1),
        (settings.Moss(cover=0.3), None),
        (settings.Litter(cover=0.3), None),
    ):
        counts = []
        for seed in range(6, 9):
            pattern = layer(section, seed=seed).pattern
            xy_m = np.concatenate([pattern.points(*tile) for tile in TILES])
            counts.append(np.histogram2d(*xy_m.T, bins=80, range=[(0, 160)] * 2)[0])
            assert (pattern.points(3, 4) == layer(section, seed=seed).pattern.points(3, 4)).all()
        ratio = np.var(counts) / np.mean(counts)
        assert ratio > least if least else ratio == pytest.approx(1.0, abs=0.05), section


def test_no_tile_has_far_more_small_plants_than_others():
    """Of herbs 3 to 6 cm high, as dense as a forest may be, no tile has over 1.5 times the mean: its
    numbers do not run out."""
    pattern = layer(settings.Herbs(cover=0.076, height_m=(0.03, 0.06))).pattern
    assert pattern.per_ha == pytest.approx(120_000, rel=0.05)
    counts = [len(pattern.points(*tile)) for tile in TILES]
    assert np.mean(counts) == pytest.approx(pattern.per_ha / 25, rel=0.1)
    assert max(counts) < 1.5 * np.mean(counts)


def test_moss_and_litter_are_ground_and_lie_along_it():
    """On a slope their axes are across it; they are on the path too, and labelled as ground."""
    for section in (settings.Moss(cover=0.3), settings.Litter(cover=0.3)):
        placed = things(section, path=NEAR, height_m=lambda x, y: 0.2 * x + 0.1 * y)
        world = np.concatenate([one.world_T_shape for one in placed])
        up = world[:, :, 2] / np.linalg.norm(world[:, :, 2], axis=1, keepdims=True)
        np.testing.assert_allclose(
            up, np.tile(np.array([-0.2, -0.1, 1.0]) / np.sqrt(1.05), (len(up), 1)), atol=1e-9
        )
        assert distance_m(world[:, :2, 3], NEAR).min() < 0.3
        assert all(one.is_ground and (one.surfaces["semantic"] == Semantic.GROUND).all() for one in placed)


@ALL
def test_nothing_lies_in_the_way(section):
    """With a path through the tiles things keep their own extent and 0.8 m away; farther ones stay as they
    were."""
    kept, free = world_T(section, path=NEAR), world_T(section, path=NEAR + [0, 0.001])
    assert len(kept) > 50
    ends = np.array([-0.5, 0.0, 0.5]) if section is LOGS else np.zeros(1)
    along = kept[:, None, :2, 3] + ends[:, None] * kept[:, None, :2, 0]
    size = size_m(kept)
    half = size[:, 1 if section is LOGS else 0] / 2
    gap = distance_m(along.reshape(-1, 2), NEAR).reshape(len(kept), -1).min(axis=1)
    assert (gap - half).min() >= 0.8 - 1e-9
    assert abs(len(free) - len(kept)) <= 3


@ALL
def test_nothing_lies_in_a_trunk(section):
    """A trunk of 4 m radius in a tile keeps everything out of it, and changes nothing else."""
    path = np.array([[0.0, -5.0], [20.0, -5.0]])
    before = world_T(section, [(0, 0)], path=path)
    after = world_T(section, [(0, 0)], path=path, trunks=np.array([[10.0, 10.0, 4.0]]))
    inside = np.hypot(before[:, 0, 3] - 10, before[:, 1, 3] - 10) < 4.0
    assert inside.any() or section in (LOGS, STUMPS)
    assert np.hypot(after[:, 0, 3] - 10, after[:, 1, 3] - 10).min(initial=4.0) >= 4.0
    kept = {row.tobytes() for row in before}
    assert all(row.tobytes() in kept for row in after)


@pytest.mark.parametrize(
    ("section", "semantic", "parts", "species"),
    [
        (saplings(*YOUNG), Semantic.TREE, SAPLING_PARTS, YOUNG),
        (shrubs(*BUSHES), Semantic.SHRUB, SHRUB_PARTS, BUSHES),
        (STONES, Semantic.STONE, [PlantPart.NONE], []),
        (LOGS, Semantic.DEADWOOD, [PlantPart.STEM], ["norway_spruce", "european_beech"]),
        (STUMPS, Semantic.DEADWOOD, [PlantPart.STEM], ["silver_birch"]),
        (GRASS, Semantic.GRASS, [PlantPart.LEAF], []),
        (FERNS, Semantic.GRASS, [PlantPart.LEAF], []),
    ],
)
def test_labels_say_what_it_is(section, semantic, parts, species):
    """Each kind has its semantic class, parts and species, and reflectances even within 0.08 of those of
    its plant or material."""
    plants = {one.number: one for one in (*flora().trees.values(), *flora().shrubs.values())}
    rows = np.concatenate([tile.surfaces for tile in things(section, path=NEAR)])
    assert (rows["semantic"] == semantic).all()
    assert (rows["part"] == parts).all()
    assert sorted(plants[n].name if n else "" for n in np.unique(rows["species"])) == sorted(species or [""])
    materials = {Semantic.STONE: 0.30, Semantic.DEADWOOD: 0.40, Semantic.GRASS: 0.45}
    first, last = rows[:, 0], rows[:, -1]
    middle = materials.get(semantic) or np.array([plants[n].bark_reflectance for n in first["species"]])
    assert stats.kstest(first["reflectance"] - middle, stats.uniform(-0.08, 0.16).cdf).pvalue > 0.01
    if len(parts) > 1:
        assert (
            np.abs(last["reflectance"] - [plants[n].leaf_reflectance for n in last["species"]]).max() < 0.08
        )


def test_shares_are_those_that_were_asked_for():
    """Of some 500 logs the shares with plates, in two pieces and flattened are those of the section, as those
    of broken stumps, within 3 sigma.

    Stumps, broken or not, lie where they would if all were sound.
    """
    found = found_of(some_logs(uprooted=0.3, broken=0.25, decayed=0.4))
    kinds = FloorKind.LOG, FloorKind.BROKEN_LOG, FloorKind.ROOT_PLATE
    whole, pieces, plates = (len(found[kind][0]) for kind in kinds)
    count = whole + pieces / 2
    _, wide, high = size_m(found[FloorKind.LOG][0]).T
    for share, expected in (
        (plates / count, 0.3),
        (pieces / 2 / count, 0.25),
        ((high < 0.9 * wide).mean(), 0.7 * 0.4),
    ):
        assert share == pytest.approx(expected, abs=3 * np.sqrt(expected * (1 - expected) / whole))
    section = {"per_ha": 200.0, "species": ["silver_birch"]}
    found, felled = (found_of(settings.Stumps(**section, broken=share)) for share in (0.3, 0.0))
    sound, broken = (found[kind][0] for kind in (FloorKind.STUMP, FloorKind.BROKEN_STUMP))
    n = len(sound) + len(broken)
    assert len(broken) / n == pytest.approx(0.3, abs=3 * np.sqrt(0.21 / n))
    rows = {row.tobytes() for row in np.concatenate([sound, broken])}
    assert rows == {row.tobytes() for row in felled[FloorKind.STUMP][0]}


def test_a_root_plate_stands_at_the_butt_of_a_log_whose_top_lies_on_the_ground():
    """Its origin is the thick end of its log, across which it stands, 0.3 of its width over the ground; it is
    1 m and four diameters wide.

    The axis of the log's thin end is less than its radius over the ground, up to what its straight line
    rises.
    """
    found = found_of(some_logs(uprooted=1.0))
    logs, (plates, rows) = found[FloorKind.LOG][0], found[FloorKind.ROOT_PLATE]
    butt_m = logs[:, :, 3] - logs[:, :, 0] / 2
    assert plates[:, :, 3] == pytest.approx(butt_m)
    length, diameter, _ = size_m(logs).T
    wide = size_m(plates)
    assert wide[:, 1] == pytest.approx(1 + 4 * diameter)
    assert wide[:, 0] == pytest.approx(wide[:, 1] / 4)
    assert butt_m[:, 2] == pytest.approx(0.3 * wide[:, 1], abs=0.05)
    along = (plates[:, :, 0] / wide[:, :1] * logs[:, :, 0] / length[:, None]).sum(axis=1)
    assert along == pytest.approx(1.0)
    assert set(rows["semantic"]) == {Semantic.DEADWOOD}
    assert set(rows["part"]) == {PlantPart.ROOT_FLARE}
    top_m = (logs[:, :, 3] + logs[:, :, 0] / 2)[:, 2]
    assert top_m == pytest.approx(0.75 * size_m(logs)[:, 1] / 2, abs=0.02)


def test_a_rotten_log_is_flat_and_sunk():
    """Up to half as high as it was and a fifth wider, with its upper side 0.3 to 0.75 of its former
    diameter over the ground."""
    logs, sound = (found_of(some_logs(decayed=share))[FloorKind.LOG][0] for share in (1.0, 0.0))
    (_, wide, high), (_, diameter, _) = size_m(logs).T, size_m(sound).T
    assert ((high / diameter < 0.86) & (high / diameter > 0.49)).all()
    assert ((wide / diameter > 1.05) & (wide / diameter < 1.21)).all()
    top = (logs[:, 2, 3] + high / 2) / diameter
    assert ((top > 0.3) & (top < 0.76)).all()


def test_plates_and_pieces_keep_off_the_path_and_trunks():
    """No part of a plate is nearer to the path than 0.8 m, or in a trunk; a log is left out whole if any
    part of it would be."""
    one, trunk = some_logs(uprooted=0.5, broken=0.5), np.array([[50.0, 90.0, 6.0]])
    found = found_of(one, path=ACROSS, trunks=trunk)
    plates = found[FloorKind.ROOT_PLATE][0]
    assert len(plates) > 50
    edges_m = np.concatenate([plates[:, :2, 3] + side * plates[:, :2, 1] for side in (-0.5, 0.0, 0.5)])
    assert distance_m(edges_m, ACROSS).min() >= 0.8
    assert np.hypot(*(edges_m - trunk[0, :2]).T).min() >= 6.0
    assert len(found[FloorKind.BROKEN_LOG][0]) % 2 == 0
    free = found_of(one)
    assert len(free[FloorKind.ROOT_PLATE][0]) > len(plates)
