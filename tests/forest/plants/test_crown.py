"""Crown prototypes."""

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from forest.kit import areas_m2, corners, normals, zeniths

from vlp16emu.forest.plants.allometry import taper_radius_m
from vlp16emu.forest.plants.branches import Branches, bole_branches
from vlp16emu.forest.plants.foliage import foliage_mesh
from vlp16emu.forest.plants.prototypes import CROWN_PARTS, CrownKey, crown_meshes, crown_wood_m3
from vlp16emu.forest.plants.species import flora
from vlp16emu.types import PlantPart


def tree_of(species):
    """Crown of a tree of 24 cm and 21 m by the species' own equations."""
    dbh_cm, height_m = np.array([24.0]), np.array([21.0])
    base_m = float(species.crown_base_m(dbh_cm, height_m, (np.array([15.0]), np.array([200.0])))[0])
    width_m = float(species.crown_width_m(dbh_cm)[0])
    leaf_area_m2 = species.leaf_area_index * np.pi / 4 * width_m**2
    return CrownKey(species.name, 0, 0.24, 21.0, base_m, width_m, leaf_area_m2)


KEYS = {name: tree_of(species) for name, species in flora().trees.items()}
LIVING = {name: key for name, key in KEYS.items() if key.leaf_area_m2}
BROAD = {name: key for name, key in LIVING.items() if flora().trees[name].foliage.kind == "leaf"}
BIRCH, BEECH, SPRUCE = KEYS["silver_birch"], KEYS["european_beech"], KEYS["norway_spruce"]


@cache
def grown(key):
    return crown_meshes(4, key)


def test_leaves_are_planar_and_as_large_as_in_nature():
    """Corners of a quad lie in one plane to a micrometre, and a mean blade or shoot has its species'
    length."""
    for name, key in LIVING.items():
        leaves = corners(grown(key)[2])
        a, b, c, d = np.moveaxis(leaves, 1, 0)
        normal = normals(leaves) / 2 / areas_m2(leaves)[:, None]
        assert np.abs(((b - a) * normal).sum(axis=1)).max() < 2e-6, name
        length = np.linalg.norm(c - a, axis=1) if key in BROAD.values() else np.linalg.norm(d - a, axis=1)
        assert length.mean() == pytest.approx(flora().trees[key.species].foliage.length_m, rel=0.03), name


@pytest.mark.parametrize(
    ("name", "mean_deg"),
    [("silver_birch", 55.6), ("european_beech", 18.1), ("english_oak", 34.8), ("black_walnut", 50.1)],
)
def test_mean_inclination_is_that_of_the_measured_leaves(name, mean_deg):
    """The mean angle of leaves is the published one within a degree."""
    assert np.degrees(zeniths(corners(grown(KEYS[name])[2])).mean()) == pytest.approx(mean_deg, abs=1.0)


def test_crown_fills_its_width_and_length():
    """Foliage spans the crown width or up to a third more, and reaches from about the crown base to about
    the tip."""
    for name, key in LIVING.items():
        vertices = grown(key)[2].vertices_m
        width = np.ptp(vertices[:, :2], axis=0)
        assert width / key.crown_width_m == pytest.approx([1.1, 1.1], abs=0.25), name
        assert vertices[:, 2].min() < 0.6, name
        assert (vertices[:, 2] < -1.4).mean() < 0.12, name
        assert vertices[:, 2].max() == pytest.approx(key.crown_length_m + 0.4, abs=0.8), name


def first_rings(key):
    """Rings (n, 6, 3) with which first-order tubes of a crown begin."""
    return grown(key)[0].vertices_m.reshape(-1, 49, 3)[:, :6].astype(np.float64)


def stem_radius_m(key, heights_m):
    taper = flora().trees[key.species].taper_rows(np.array([key.dbh_m]))
    return taper_radius_m(taper, np.array([key.dbh_m]), np.array([key.height_m]), np.array([heights_m]))[0]


def test_branches_begin_on_the_axis_inside_the_stem():
    """Each first-order tube begins with a ring around the axis that is narrower than the stem there; few
    are below the base."""
    for name, key in LIVING.items():
        ring = first_rings(key)
        middle = ring.mean(axis=1)
        assert np.abs(middle[:, :2]).max() < 1e-6, name
        stem = stem_radius_m(key, key.crown_base_m + middle[:, 2])
        branch = np.linalg.norm(ring - middle[:, None], axis=2).max(axis=1)
        assert (branch < np.maximum(0.65 * stem, 0.0011)).all(), name
        assert (middle[:, 2] >= 0).mean() > 0.75, name


def test_branches_are_together_as_thick_as_their_species_says():
    """First-order sections add up to `branch_area` times that of the stem at the crown base, or to 70 % if
    some are as thick as the stem."""
    for name, key in LIVING.items():
        ring = first_rings(key)
        ring = ring[ring[:, :, 2].mean(axis=1) >= 0]
        corner = np.linalg.norm(ring - ring.mean(axis=1, keepdims=True), axis=2).mean(axis=1)
        radius = corner * np.sin(np.pi / 6) / (np.pi / 6)
        area_m2 = (
            flora().trees[key.species].crown.branch_area * stem_radius_m(key, [key.crown_base_m])[0] ** 2
        )
        assert 0.7 < (radius**2).sum() / area_m2 < 1.05, name


def bole(name):
    """Living and dead branches below 40 crowns of a tree of 24 cm and 21 m, and twigs of the dead ones."""
    habit, key = flora().trees[name].crown, KEYS[name]
    size = key.crown_base_m, habit.base_fraction * key.crown_width_m / 2, np.array([0.08, 0.12])
    return [bole_branches(np.random.default_rng(n), habit, *size) for n in range(40)]


def test_dead_branches_sit_below_the_crown_and_only_when_wanted():
    """Off, they are missing and all else is the same to the byte; on, they start on the axis below the
    crown base. A snag has no others."""
    assert [len(mesh.faces) > 0 for mesh in grown(KEYS["snag"])] == [False, False, False, True]
    for name, key in KEYS.items():
        assert CROWN_PARTS[3] == PlantPart.DEAD_BRANCH, name
        living, bare = grown(key), grown(replace(key, dead_branches=True))
        assert [m.vertices_m.tobytes() for m in bare[:3]] == [m.vertices_m.tobytes() for m in living[:3]], (
            name
        )
        assert len(bare[3].faces) > len(living[3].faces) or key in BROAD.values(), name
        assert (len(living[3].faces) == 0) == (key.species != "snag"), name
    for _, dead, _ in bole("norway_spruce"):
        assert np.abs(dead.nodes_m[:, 0, :2]).max() == 0
        assert (dead.nodes_m[:, 0, 2] <= 0).all()


def test_spruce_keeps_dead_branches_down_to_a_foot_as_free_as_measured():
    """The lowest branches of 40 spruces begin 0.3 m above the ground or on average 0.2 m higher; of pines
    above 5 m."""

    def lowest_m(name):
        parts = ([part.nodes_m[:, 0, 2].min(initial=0.0) for part in one[:2]] for one in bole(name))
        return KEYS[name].crown_base_m + np.array([min(both) for both in parts])

    assert lowest_m("norway_spruce").min() > 0.29
    assert lowest_m("norway_spruce").mean() == pytest.approx(0.5, abs=0.2)
    assert lowest_m("scots_pine").min() > 5.0


def test_branches_below_the_crown_die_and_fall_with_depth():
    """Within one `living_depth_m` 1 - 1/e live, in the next 1/e of that; the lower half bears fewer; dead
    ones have twigs."""
    habit = flora().trees["norway_spruce"].crown
    all_parts = zip(*bole("norway_spruce"), strict=True)
    living, dead, twigs = ([-part.nodes_m[:, 0, 2] for part in parts] for parts in all_parts)
    alive, all_m = np.concatenate(living), np.concatenate([*living, *dead])
    for stretch in (0, 1):
        limits = habit.living_depth_m * np.array([stretch, stretch + 1])
        share = np.histogram(alive, limits)[0].sum() / np.histogram(all_m, limits)[0].sum()
        assert share == pytest.approx((1 - np.exp(-1)) * np.exp(-stretch), abs=0.08), stretch
    half_m = (KEYS["norway_spruce"].crown_base_m - 0.3) / 2
    assert 0.6 < (all_m > half_m).sum() / (all_m <= half_m).sum() < 0.85
    assert len(np.concatenate(twigs)) > 1.5 * len(np.concatenate(dead))


def test_needles_of_pine_sit_in_tufts_at_the_ends_of_twigs():
    """No shoot of a pine leaves the first half of its twig, and those of a spruce leave all of it."""
    nodes_m = np.linspace([0.0, 0, 0], [1, 0, 0], 3)[None].repeat(50, 0)
    twigs = Branches(nodes_m, np.zeros(50), np.ones(50), np.full(50, 0.01))
    for name, bare in (("scots_pine", 0.55), ("norway_spruce", 0.0)):
        mesh = foliage_mesh(np.random.default_rng(1), flora().trees[name].foliage, twigs, 5.0)
        base_m = corners(mesh)[:, :2].mean(axis=1)[:, 0]
        assert base_m.min() == pytest.approx(bare, abs=0.02), name
        assert base_m.max() == pytest.approx(1.0, abs=0.02), name


@pytest.mark.parametrize("key", [BIRCH, SPRUCE], ids=["birch", "spruce"])
def test_wood_volume_is_read_off_the_tubes(key):
    """Frusta between the rings of the finest tubes, as thick as their girth says, have the crown's wood
    volume."""
    total = 0.0
    for mesh, sides, nodes in zip(grown(key)[:2], (6, 4), (9, 5), strict=True):
        tubes = mesh.vertices_m.astype(np.float64).reshape(-1, sides * (nodes - 1) + 1, 3)
        rings = tubes[:, :-1].reshape(len(tubes), nodes - 1, sides, 3)
        middle = np.concatenate([rings.mean(axis=2), tubes[:, -1:]], axis=1)
        corner = np.linalg.norm(rings - rings.mean(axis=2, keepdims=True), axis=3).mean(axis=2)
        radius = np.pad(corner * np.sin(np.pi / sides) / (np.pi / sides), ((0, 0), (0, 1)))
        step = np.linalg.norm(np.diff(middle, axis=1), axis=2)
        low, high = radius[:, :-1], radius[:, 1:]
        total += (np.pi / 3 * step * (low**2 + low * high + high**2)).sum()
    assert crown_wood_m3(4, key) == pytest.approx(total, rel=1e-3)


def test_a_crown_of_a_giant_stays_within_memory():
    """However large the crown, it has at most 120 000 quads, and still all its leaf area."""
    key = replace(BEECH, dbh_m=1.2, height_m=40.0, crown_base_m=15.0, crown_width_m=20.0, leaf_area_m2=1500.0)
    leaves = crown_meshes(4, key)[2]
    assert len(leaves.faces) == 120_000
    assert areas_m2(corners(leaves)).sum() == pytest.approx(1500.0, rel=1e-3)


TRAITS = {  # Purves et al. (2007), table S3, by FIA code: 531, 802, 318, 316, 602
    "european_beech": 0.626,  # American beech
    "english_oak": 0.543,  # white oak
    "white_oak": 0.543,
    "sugar_maple": 0.560,
    "red_maple": 0.536,
    "black_walnut": 0.653,
}


def mean_profile(name, **fields):
    """Radius (20,) of crowns of 45 and 60 cm by relative height, over the greatest: mean of 12 sectors."""
    rows = []
    for seed, (dbh_m, height_m) in product(range(4), ((0.45, 31.0), (0.6, 35.0))):
        width_m = float(flora().trees[name].crown_width_m(np.array([100 * dbh_m]))[0])
        key = CrownKey(name, seed % 3, dbh_m, height_m, 0.45 * height_m, width_m, 3 * width_m**2, **fields)
        x_m, y_m, z_m = crown_meshes(seed, key)[2].vertices_m.T
        level = np.floor(20 * z_m / key.crown_length_m).astype(int)
        sector = np.floor(6 * (np.arctan2(y_m, x_m) / np.pi + 1)).astype(int) % 12
        within = (level >= 0) & (level < 20)
        radius_m = np.zeros((20, 12))
        np.maximum.at(radius_m, (level[within], sector[within]), np.hypot(x_m, y_m)[within])
        rows.append(radius_m.mean(axis=1) / radius_m.mean(axis=1).max())
    return np.mean(rows, axis=0)


@pytest.mark.parametrize("name", TRAITS)
def test_broadleaves_have_the_published_domes(name):
    """The radius grows with the depth below the top to the published power, within 0.1 of the greatest
    radius on average, and is greatest between 0.35 and 0.65 of the crown, as of measured oaks (0.42) and
    beeches (0.50 to 0.56)."""
    habit = flora().trees[name].crown
    assert habit.dome == pytest.approx(0.196 * (1 - TRAITS[name]) + 0.511 * TRAITS[name], abs=0.001)
    radius = mean_profile(name)
    at = (np.arange(20) + 0.5) / 20
    above = at > habit.widest_at
    dome = ((1 - at[above]) / (1 - habit.widest_at)) ** habit.dome
    assert np.abs(radius[above] - dome).mean() < 0.1
    assert 0.35 < at[radius.argmax()] < 0.65


def test_trees_without_neighbours_are_wide_from_low_down():
    """An open-grown oak has at a fifth of its crown a radius over 0.8 of the greatest, and more than one of a
    closed stand."""
    alone, closed = (mean_profile("english_oak", openness=openness)[3:5].mean() for openness in (1.0, 0.0))
    assert alone > 0.8
    assert alone > closed + 0.05


def test_crowns_of_equal_size_are_as_lopsided_as_measured():
    """Radii of beeches towards four directions differ by about 0.2 of their mean, one sigma (0.06 to 0.7 in
    the stands Cloture20 and Bechefa), and no two crowns are the same."""
    spreads = []
    for seed in range(12):
        x_m, y_m, _ = crown_meshes(seed, BEECH)[2].vertices_m.astype(np.float64).T
        quarter = np.floor(2 * (np.arctan2(y_m, x_m) / np.pi + 1.25)).astype(int) % 4
        radii_m = [np.quantile(np.hypot(x_m, y_m)[quarter == side], 0.99) for side in range(4)]
        spreads.append(np.std(radii_m, ddof=1) / np.mean(radii_m))
    assert 0.08 < np.mean(spreads) < 0.25
    assert np.ptp(spreads) > 0.05
