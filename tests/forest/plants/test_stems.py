"""Stems, their forms, roots and branches: diameters, sweep, forks, sections and bark, against the species
table and what is published."""

from itertools import product

import numpy as np
import pytest
from forest.kit import feet_m, section_diameter_m, solid_of, trees_of
from scipy import stats
from scipy.spatial import ConvexHull

from vlp16emu.forest.plants.allometry import taper_radius_m
from vlp16emu.forest.plants.prototypes import (
    CROWN_PARTS,
    CrownKey,
    crown_branches,
    crown_meshes,
    crown_placements,
)
from vlp16emu.forest.plants.species import StemForm, flora, tapers
from vlp16emu.forest.plants.stem import (
    ROOT_RINGS,
    ROOT_SIDES,
    STEM_PARTS,
    Stems,
    polygon_m2,
    root_points,
    stem_forms,
    stem_meshes,
    tape_m,
)
from vlp16emu.forest.stand.inventory import branch_circles, far_stems
from vlp16emu.types import PlantPart

TABLE = flora().trees
BREAST_RING = 6


def slope(x, y):
    return 0.2 * x - 0.1 * y


def make_trees(name, count=1, dbh_m=0.35, **fields):
    n, height_m = np.arange(count), 6.0 + 50 * np.array(dbh_m)
    place = {"x_m": 3.0 * n, "z_m": slope(3.0 * n, 0.0), "lean_deg": 2.0, "lean_towards_deg": 40.0 * n}
    size = {
        "dbh_m": dbh_m,
        "height_m": height_m,
        "crown_base_m": 0.5 * height_m,
        "crown_width_m": 16 * np.array(dbh_m),
    }
    return trees_of(
        [name] * count, **{**place, **size, "form": 1 + n, "crown_azimuth_deg": 23.0 * n, **fields}
    )


def sections_m(trees, ring=BREAST_RING, **changes):
    """Corners of sections (n, sides) of trees of one size, some keys of their species changed."""
    table = {
        name: one.model_copy(update={"stem": one.stem.model_copy(update=changes)})
        for name, one in TABLE.items()
    }
    stems = Stems(trees, table=table)
    return stems.outlines(slice(None), int(stems.sides[0]))[:, ring]


def forking(name):
    return next(tree for tree in make_trees(name, 100)[:, None] if stem_forms(tree).forks[0, 0])


@pytest.mark.parametrize("name", TABLE)
def test_area_at_breast_height_is_that_of_the_dbh(name):
    """Cut across the axis as it runs 1.3 m above the foot, a stem has the area of its DBH within 0.1 mm:
    the first straight, two crooked."""
    for dbh_m, lean_deg in product((0.05, 0.2, 0.5, 1.2), (0.0, 8.0)):
        trees = make_trees(name, 3, dbh_m)
        trees["lean_deg"], trees["form"][0] = lean_deg, 0
        meshes = stem_meshes(trees, np.zeros(3), slope)
        at = np.full((3, 1), 1.3)
        low, middle, high = (Stems(trees).axis_m(at + d)[:, 0] for d in (-1e-4, 0.0, 1e-4))
        for i, tree in enumerate(trees):
            normal = (high - low)[i] / np.linalg.norm((high - low)[i])
            at_m = middle[i] + [tree["x_m"], tree["y_m"], tree["z_m"]] + 1e-4 * normal
            solid = solid_of(meshes[2 * i : 2 * i + 2])
            assert section_diameter_m(solid, normal, at_m) == pytest.approx(tree["dbh_m"], abs=1e-4)


@pytest.mark.parametrize("name", ["english_oak", "silver_birch", "european_beech", "snag"])
def test_stems_are_closed_and_buried(name):
    """Forked, crooked or straight, flare and stem are watertight together and show their outside; the
    lowest ring lies under a slope."""
    trees = make_trees(
        name, 14, height_m=23.5, crown_base_m=11.75, crown_width_m=5.6, dbh_m=np.linspace(0.08, 0.9, 14)
    )
    trees["form"][::7] = 0
    meshes = stem_meshes(trees, np.zeros(3), slope)
    sides = Stems(trees).sides
    for flare, stem, count in zip(meshes[::2], meshes[1::2], sides, strict=True):
        solid = solid_of((flare, stem))
        assert solid.is_watertight
        assert solid.is_winding_consistent
        assert all(piece.volume > 0 for piece in solid.split())
        x, y, z = flare.vertices_m[1 : 1 + count].T.astype(np.float64)
        assert (z < slope(x, y)).all()


def test_sections_have_the_area_of_published_tapers():
    """Whatever their outline, the rings of a whole stem have the areas that the taper equation of the
    species gives."""
    for name in ("norway_spruce", "scots_pine", "english_oak"):
        trees = make_trees(name, 20)
        stems = Stems(trees)
        own = np.setdiff1d(np.arange(20), stems.forked)
        taper_m = taper_radius_m(tapers(trees), trees["dbh_m"], trees["height_m"], stems.above_ground_m)
        sides = int(stems.sides[0])
        away_m = stems.outlines(slice(None), sides)
        area_m2 = polygon_m2(away_m, 2 * np.pi / sides)
        assert np.allclose(area_m2[own], np.pi * taper_m[own] ** 2, rtol=1e-9)
        assert np.ptp(away_m[:, BREAST_RING], axis=1).min() > 1e-3


@pytest.mark.parametrize("name", ["norway_spruce", "english_oak", "silver_birch"])
def test_boles_bow_as_far_as_the_table_says(name):
    """Mean bow over the length of the bole is that of the species, all directions are as frequent, no bow
    leaves the stem."""
    trees = make_trees(name, 1500, 0.5, crown_base_m=5.0)
    forms = stem_forms(trees)
    shares = np.linspace(0, 1, 101)
    bow_m = np.hypot(*forms.bends[:, 0].T)
    assert np.mean(bow_m / trees["crown_base_m"]) == pytest.approx(TABLE[name].stem.bow, rel=0.06)
    assert bow_m.max() <= 0.5 * trees["dbh_m"].max() + 1e-9
    assert stats.kstest(np.arctan2(*forms.bends[:, 0].T), stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue > 0.01
    aside_m = forms.aside_m(trees["crown_base_m"][:, None] * shares)
    most_m = np.hypot(aside_m[..., 0], aside_m[..., 1]).max(axis=1)
    assert np.mean(most_m) == pytest.approx(np.mean(bow_m), rel=0.25)
    above = forms.aside_m(np.column_stack([trees["crown_base_m"], trees["height_m"]]))
    assert np.abs(above).max() < 1e-12


def test_butts_sweep_as_the_table_says():
    """The axis leaves the ground at the species' mean angle to the stem above the butt, which is straight
    again at 3 m."""
    trees = make_trees("scots_pine", 1500, 0.4)
    table = {"scots_pine": TABLE["scots_pine"].model_copy(update={"stem": StemForm(butt_sweep_deg=3.0)})}
    forms = stem_forms(trees, table=table)
    z = np.tile([-1e-3, 1e-3, 2.999, 3.001], (len(trees), 1))
    aside_m = forms.aside_m(z)
    ground, above = (np.hypot(*((aside_m[:, i + 1] - aside_m[:, i]) / 2e-3).T) for i in (0, 2))
    assert np.degrees(np.arctan(ground)).mean() == pytest.approx(3.0, rel=0.06)
    assert np.degrees(np.arctan(above)).max() < 1.0


@pytest.mark.parametrize("name", ["norway_spruce", "european_beech"])
def test_sections_are_as_oval_as_the_table_says(name):
    """The longest diameter exceeds the one across it by the ovality of the species on average, in any
    direction."""
    corners_m = sections_m(make_trees(name, 800, 0.5), lobes=0.0, bark_mm_per_cm=0.0)
    across = corners_m.shape[1] // 4
    width_m = corners_m + np.roll(corners_m, 2 * across, axis=1)
    longest = width_m.argmax(axis=1)[:, None]
    long_m = np.take_along_axis(width_m, longest, axis=1)
    short_m = np.take_along_axis(width_m, (longest + across) % width_m.shape[1], axis=1)
    assert np.mean(long_m / short_m - 1) == pytest.approx(TABLE[name].stem.ovality, rel=0.08)
    assert stats.chisquare(np.bincount(longest[:, 0] % (2 * across), minlength=2 * across)).pvalue > 0.001


def test_flutes_are_deepest_at_the_butt():
    """Lobes reach as far as the table says at the ground, and a tenth of that at breast height at most
    (Singleton et al. 2003)."""
    trees = make_trees("european_beech", 400)
    depth = [
        np.ptp(section := sections_m(trees, ring, ovality=0.0, bark_mm_per_cm=0.0), axis=1)
        / section.mean(axis=1)
        / 2
        for ring in (1, BREAST_RING)
    ]
    assert np.mean(depth[0]) == pytest.approx(TABLE["european_beech"].stem.lobes, rel=0.05)
    assert (depth[1] < 0.1 * depth[0]).all()


@pytest.mark.parametrize("name", ["english_oak", "scots_pine", "european_beech"])
def test_bark_is_as_rough_as_the_table_says(name):
    """From furrow to ridge it is 0.8 to 1 of what the species has at that DBH, and grows with the DBH."""
    for dbh_m in (0.2, 0.4, 0.6):
        corners_m = sections_m(make_trees(name, 60, dbh_m), lobes=0.0, ovality=0.0)
        depth_mm = TABLE[name].stem.bark_mm_per_cm * 100 * dbh_m
        assert 0.8 * depth_mm < 1000 * np.ptp(corners_m, axis=1).mean() < 1.01 * depth_mm


def test_furrows_of_oak_do_not_reach_the_wood():
    """Furrows take 0.3 to 0.9 of the bark of 8400 English oaks, whose double thickness is 0.0662 DBH +
    0.498 cm (Sumarski list 3-4/1957)."""
    for dbh_m in (0.2, 0.4, 0.6, 0.8):
        corners_m = sections_m(make_trees("english_oak", 60, dbh_m), lobes=0.0, ovality=0.0)
        bark_m = (0.0662 * dbh_m + 0.00498) / 2
        share = np.ptp(corners_m, axis=1) / bark_m
        assert share.min() > 0.3
        assert share.max() < 0.9


def test_a_tape_shows_too_much_as_it_does_around_real_stems():
    """It is that around the convex hull, and makes sections 0.2 to 2.4 % too large on average, as in 5408
    of poplar (Rodriguez et al.)."""
    for name in ("norway_spruce", "scots_pine", "european_beech", "english_oak", "douglas_fir"):
        trees = make_trees(name, 120)
        corners_m = sections_m(trees)
        tape = tape_m(corners_m)
        angle = np.arange(corners_m.shape[1]) * 2 * np.pi / corners_m.shape[1]
        for corners, shown_m in zip(corners_m[:20], tape, strict=False):
            hull = ConvexHull(corners[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))
            assert shown_m == pytest.approx(hull.area / np.pi, abs=1e-5)  # in the plane its area is the girth
        excess = np.mean((tape / trees["dbh_m"]) ** 2 - 1)
        assert 0.002 < excess < 0.024


def test_far_light_meets_sections_as_wide_as_their_hulls():
    """Halves of mean widths are those by tape, within 0.1 % on average and 1 % in any section; no section is
    narrower than the circle of its area, and butts with lobes are wider than tips."""
    for name in ("norway_spruce", "european_beech", "silver_birch"):
        rings = Stems(make_trees(name, 60))
        for sides in np.unique(rings.sides):
            rows = np.flatnonzero(rings.sides == sides)
            corners_m = rings.outlines(rows, int(sides)).reshape(-1, int(sides))
            ratio = 2 * rings.half_widths_m()[rows].ravel() / tape_m(corners_m)
            assert ratio.mean() == pytest.approx(1, abs=1e-3)
            assert ratio == pytest.approx(1, abs=1e-2)
        wider = rings.half_widths_m() / rings.radius_m
        assert wider.min() > 1.0
        assert wider[:, 0].mean() > wider[:, -1].mean()


def test_as_many_trees_fork_as_the_table_says():
    """Of 10 000 beeches 15 % have a second leader, evenly between the heights of the table."""
    trees = make_trees("european_beech", 10_000)
    rings = Stems(trees)
    assert stats.binomtest(len(rings.forked), 10_000, TABLE["european_beech"].stem.fork_share).pvalue > 0.01
    share = rings.fork_m / trees["height_m"][rings.forked]
    low, high = TABLE["european_beech"].stem.fork_height
    assert stats.kstest(share, stats.uniform(low, high - low).cdf).pvalue > 0.01
    assert (np.diff(rings.above_ground_m, axis=1) > 0).all()


def test_both_leaders_together_are_as_thick_as_one():
    """At a ring above the fork both have the section of an unforked stem, and the second stays within the
    crown."""
    trees = forking("european_beech")
    rings = Stems(trees)
    second_up_m, second_radius_m = rings.leaders(np.linspace(0, 1, 50))
    above = np.flatnonzero(rings.above_ground_m[0] > rings.fork_m[0])[1]
    z = rings.above_ground_m[0, above]
    second_m = np.interp(z, second_up_m[0], second_radius_m[0])
    whole_m = taper_radius_m(tapers(trees), trees["dbh_m"], trees["height_m"], np.array([[z]]))[0, 0]
    assert np.hypot(rings.radius_m[0, above], second_m) == pytest.approx(whole_m, rel=0.01)
    gap_m = np.linalg.norm(rings.leader_axis_m(second_up_m) - rings.axis_m(second_up_m), axis=2)
    assert gap_m[0, 0] < 1e-9
    assert rings.radius_m[0, above] + second_m < gap_m[0, -1] < trees["crown_width_m"][0] / 2


def test_stems_from_afar_run_where_those_of_the_mesh_run():
    """At its knots a far stem has the middle of the ring and half of its mean width, leaders as well, and
    their labels."""
    trees = np.concatenate([make_trees("english_oak", 3), forking("european_beech")])
    far, rings = far_stems(trees, 7), Stems(trees)
    middle_m = far["foot_m"][:, None] + far["along_m"][..., None] * far["axis"][:, None].astype(float)
    middle_m[..., :2] += np.moveaxis(far["aside_m"], 1, 2)
    expected_m = feet_m(trees)[:, None] + rings.axis_m(rings.above_ground_m)
    assert np.abs(middle_m[:4, :-1] - expected_m).max() < 1e-5
    assert np.allclose(far["radius_m"][:4, :-1], rings.half_widths_m())
    forked = rings.forked.tolist()
    assert len(far) == 4 + len(forked)
    assert far["row"].tolist() == [[7 + 2 * i, 8 + 2 * i] for i in [0, 1, 2, 3, *forked]]


def test_without_a_form_stems_are_straight_and_round():
    """Seed 0, and a species whose keys are all 0, give the same stem: all corners of a ring equally far
    from a line."""
    trees = make_trees("english_oak", 5)
    none = {"english_oak": TABLE["english_oak"].model_copy(update={"stem": StemForm()})}
    plain = stem_meshes(trees, np.zeros(3), slope, table=none)
    trees["form"] = 0
    for mine, theirs in zip(stem_meshes(trees, np.zeros(3), slope), plain, strict=True):
        assert mine.vertices_m.tobytes() == theirs.vertices_m.tobytes()
    assert np.abs(stem_forms(trees).aside_m(np.ones((5, 1)))).max() == 0
    assert np.ptp(sections_m(trees), axis=1).max() < 1e-12


@pytest.mark.parametrize(
    ("name", "dbh_m", "height_m"),
    [
        ("silver_birch", 0.07, 0.08),
        ("silver_birch", 0.2, 0.18),
        ("european_beech", 0.5, 0.65),
        ("norway_spruce", 0.3, 0.45),
        ("norway_spruce", 1.2, 1.0),
    ],
)
def test_root_flares_grow_with_the_diameter(name, dbh_m, height_m):
    """A flare ends at its species' share of the DBH above the foot, at a ring that it shares with the stem;
    lobes and swell end with it, and the DBH stays below breast height."""
    trees = make_trees(name, 3, dbh_m, x_m=0.0, z_m=0.0, lean_deg=0.0, form=0)
    meshes = stem_meshes(trees, np.zeros(3), lambda x, y: 0 * x)
    sides = Stems(trees).sides[0]
    for flare, stem in zip(meshes[::2], meshes[1::2], strict=True):
        assert stem.vertices_m[:sides, 2] == pytest.approx(np.full(sides, height_m), abs=5e-6)
        assert flare.vertices_m[: 1 + 5 * sides, 2].max() == pytest.approx(height_m, abs=5e-6)
    assert (np.diff(Stems(trees).above_ground_m, axis=1) > 0).all()


def test_a_root_flare_and_its_stem_share_a_ring_and_a_snag_ends_at_full_width():
    """Flare and stem share the ring at the flare's top; a dead tree's highest ring is over 0.4 of breast
    height, and its tip stands off the axis."""
    assert STEM_PARTS == (PlantPart.ROOT_FLARE, PlantPart.STEM)
    trees = make_trees("snag", 6, np.linspace(0.05, 1.2, 6), x_m=0.0, z_m=0.0, lean_deg=0.0, form=0)
    meshes = [mesh.vertices_m for mesh in stem_meshes(trees, np.zeros(3), lambda x, y: 0 * x)]
    for tree, sides, flare_m, stem_m in zip(
        trees, Stems(trees).sides, meshes[::2], meshes[1::2], strict=True
    ):
        assert np.array_equal(flare_m[-sides:], stem_m[:sides])
        assert stem_m[:sides, 2] == pytest.approx(np.full(sides, stem_m[0, 2]), abs=5e-6)
        width_m = 2 * np.hypot(*stem_m[-1 - sides : -1, :2].T).mean()
        assert width_m > 0.4 * tree["dbh_m"]
        assert np.hypot(*stem_m[-1, :2]) == pytest.approx(0.4 * width_m, rel=0.02)
        assert stem_m[-1, 2] == pytest.approx(tree["height_m"], abs=1e-4)


N_OLD = 400


def steep(x, y):
    """Ground that rises by 30 degrees to the east."""
    return 0.577 * x + 0.0 * y


@pytest.fixture(scope="module")
def old_trees():
    """Beeches and spruces of 0.32 m to 0.8 m on a steep."""
    rng = np.random.default_rng(3)
    x_m, y_m = rng.uniform(-500, 500, (2, N_OLD))
    place = {"x_m": x_m, "y_m": y_m, "z_m": steep(x_m, y_m), "dbh_m": rng.uniform(0.32, 0.8, N_OLD)}
    size = {"height_m": 30.0, "crown_base_m": 12.0, "crown_width_m": 6.0}
    forms = {"form": rng.integers(1, 2**63, N_OLD), "crown_azimuth_deg": rng.uniform(0, 360, N_OLD)}
    return trees_of(["european_beech", "norway_spruce"] * (N_OLD // 2), **place, **size, **forms)


def roots_of(old_trees, height_m=steep):
    return root_points(Stems(old_trees), height_m)


def test_old_spruces_and_beeches_have_roots_and_no_others(old_trees):
    """Of 3 to 6 lobes three quarters have a root on spruces and 55 % on beeches; thin trees, pines and
    straight stems have none."""
    stem, _ = roots_of(old_trees)
    for first, share in ((0, 0.55), (1, 0.75)):
        assert (stem % 2 == first).sum() / (N_OLD / 2) == pytest.approx(4.5 * share, rel=0.1)
    for changes in ({"dbh_m": 0.29}, {"species": flora().trees["scots_pine"].number}, {"form": 0}):
        others = old_trees.copy()
        for name, value in changes.items():
            others[name] = value
        assert len(roots_of(others)[0]) == 0


def test_roots_run_along_the_ground_half_buried_and_dive(old_trees):
    """They reach 0.5 m to 2 m from the butt, rise over the ground by less than half a DBH, 0.3 m over the
    foot at most, and end in it."""
    stem, points_m = roots_of(old_trees)
    rings_m = points_m[:, 1:-1].reshape(len(stem), ROOT_RINGS, ROOT_SIDES, 3)
    away_m = np.hypot(*np.moveaxis(points_m[:, -1, :2], -1, 0)) - 0.8 * Stems(old_trees).radius_m[stem, 1]
    assert (away_m > 0.5).all()
    assert away_m.max() < 2.2
    assert points_m[..., 2].max() <= 0.3 + 1e-12
    x, y, z = np.moveaxis(rings_m, -1, 0)
    foot = old_trees[stem][:, None, None]
    over_m = z + foot["z_m"] - steep(x + foot["x_m"], y + foot["y_m"])
    downhill = points_m[:, -1, 0] < 0
    assert (over_m.max(axis=2)[downhill, :4] > 0).mean() > 0.95
    assert (over_m.min(axis=2) < 0).all()
    assert (over_m.max(axis=(1, 2)) < 0.5 * old_trees["dbh_m"][stem]).all()
    level = roots_of(old_trees, lambda x, y: old_trees["z_m"][stem][:, None] + 0 * x)[1]
    assert (level[:, -1, 2] < 0).all()


THREE = ["norway_spruce", "european_beech", "snag"]
BRANCH_SIDES, BRANCH_RINGS = 6, 8
FIRST, DEAD = PlantPart.BRANCH_FIRST_ORDER, PlantPart.DEAD_BRANCH


@pytest.fixture(scope="module")
def three():
    place = {"id": [70, 71, 72], "x_m": [0.0, 6.0, 12.0], "y_m": -3.0, "z_m": 2.0}
    lean = {"lean_deg": [0.0, 3.0, 2.0], "lean_towards_deg": 70.0, "crown_azimuth_deg": [0.0, 30.0, 100.0]}
    size = {"dbh_m": 0.3, "height_m": [24.0, 22.0, 12.0]}
    crown = {"crown_base_m": [13.0, 11.0, 6.0], "crown_width_m": [4.8, 7.0, 2.0]}
    return trees_of(THREE, **place, **lean, **size, **crown)


@pytest.fixture(scope="module")
def crowns():
    keys = ((0.27, 26.0, 13.0, 4.0, 90.0), (0.33, 20.0, 10.5, 8.0, 120.0), (0.3, 13.0, 6.0, 2.2, 0.0))
    return [CrownKey(name, 1, *key, dead_branches=True) for name, key in zip(THREE, keys, strict=True)]


@pytest.fixture(scope="module")
def circles(three, crowns):
    return branch_circles(three, crowns, seed=6)


def test_circles_are_the_rings_of_the_scanned_branches(three, crowns, circles):
    """Their middles are those of the mesh's rings, to 0.1 mm, and areas across the axis are as of the
    tube, within 0.1 %."""
    half = np.pi / BRANCH_SIDES
    # The tube has the girth of the round branch.
    tube_over_circle = BRANCH_SIDES / 2 * np.sin(2 * half) * (half / np.sin(half)) ** 2 / np.pi
    for i in (0, 1):
        mesh = crown_meshes(6, crowns[i])[CROWN_PARTS.index(FIRST)]
        world_T = crown_placements(three, crowns)[i]
        corners_m = (mesh.vertices_m @ world_T[:, :3].T + world_T[:, 3]).reshape(
            -1, BRANCH_SIDES * BRANCH_RINGS + 1, 3
        )
        ring_m = corners_m[:, :-1].reshape(-1, BRANCH_RINGS, BRANCH_SIDES, 3)
        own = circles[(circles["tree"] == 70 + i) & (circles["part"] == FIRST)].reshape(-1, BRANCH_RINGS + 1)
        middle_m = np.stack([own[f"{axis}_m"] for axis in "xyz"], axis=-1)
        assert middle_m[:, :-1] == pytest.approx(ring_m.mean(axis=2), abs=1e-4)
        assert middle_m[:, -1] == pytest.approx(corners_m[:, -1], abs=1e-4)
        prototype = crown_branches(6, crowns[i])[0]
        along = np.gradient(prototype.nodes_m, axis=1)[:, :-1] @ world_T[:, :3].T
        along /= np.linalg.norm(along, axis=-1, keepdims=True)
        away_m = ring_m - ring_m.mean(axis=2, keepdims=True)
        area_m2 = np.cross(away_m, np.roll(away_m, -1, axis=2)).sum(axis=2) / 2
        across_m2 = np.abs((area_m2 * along).sum(axis=-1))
        thick = own["radius_m"][:, :-1] > 0.005
        ratio = across_m2[thick] / (np.pi * own["radius_m"][:, :-1][thick] ** 2)
        assert ratio == pytest.approx(tube_over_circle, rel=1e-3)


def test_branches_begin_on_the_axis_and_thin_to_a_tip(three, circles):
    """Each branch has a number of its own on the tree, begins on the line from foot to tip and ends with
    radius 0."""
    for tree in three:
        own = circles[circles["tree"] == tree["id"]].reshape(-1, BRANCH_RINGS + 1)
        assert (own["branch"] == 1 + np.arange(len(own))[:, None]).all()
        assert (own["leader"] == 1).all()
        slope = np.tan(np.radians(tree["lean_deg"]))
        towards = np.radians(tree["lean_towards_deg"])
        up_m = own["above_foot_m"][:, 0]
        assert own["x_m"][:, 0] == pytest.approx(tree["x_m"] + slope * np.cos(towards) * up_m, abs=1e-6)
        assert own["y_m"][:, 0] == pytest.approx(tree["y_m"] + slope * np.sin(towards) * up_m, abs=1e-6)
        assert (np.diff(own["radius_m"], axis=1) < 0.002).all()
        assert (own["radius_m"][:, -1] == 0).all()
