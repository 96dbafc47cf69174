"""Who stands where, and how large."""

from functools import cache

import numpy as np
import pytest
from forest.kit import feet_m, grown
from scipy import stats
from scipy.spatial import cKDTree

from vlp16emu.errors import GeometryError
from vlp16emu.foliage.polyline import Corridor, distance_m
from vlp16emu.forest.ground.terrain import Trails
from vlp16emu.forest.plants.allometry import taper_radius_m
from vlp16emu.forest.plants.species import flora, tapers
from vlp16emu.forest.plants.stem import lean_rotation
from vlp16emu.forest.purpose import Growth
from vlp16emu.forest.settings import Clusters, Forest, Plantation, Scattered, SpeciesShare, Storey, Terrain
from vlp16emu.forest.stand.points import Land, poisson_pattern
from vlp16emu.forest.stand.stand import Stand, density_per_ha, foot_discs

FAR_XY_M = np.array([[0.0, 1e5]])
BIRCH = SpeciesShare(species="silver_birch", share=0.25, dbh_cm=18.0, height_m=19.0)
SPRUCE = SpeciesShare(species="norway_spruce", share=0.75, dbh_cm=24.0, height_m=21.0)
PINE = SpeciesShare(species="scots_pine", share=1.0, dbh_cm=26.0, height_m=21.0)


def make_stand(
    *,
    stems_per_ha=800.0,
    species=(BIRCH, SPRUCE),
    path_xy_m=FAR_XY_M,
    clearance_m=0.8,
    trails=None,
    **section,
):
    whole = sum(one.share for one in species)
    species = [one.model_copy(update={"share": one.share / whole}) for one in species]
    return Stand(
        Forest(
            kind="forest", stems_per_ha=stems_per_ha, species=species, path_clearance_m=clearance_m, **section
        ),
        Land(14, lambda x, y: 0.01 * x + 0.02 * y, Corridor(path_xy_m, clearance_m), trails=trails),
    )


@pytest.fixture(scope="module")
def trees():
    return grown(make_stand(), 14)


@pytest.fixture(scope="module")
def spruces():
    return grown(make_stand(species=(SPRUCE,), stems_per_ha=700.0), 12)


@pytest.mark.parametrize("mix", [BIRCH, SPRUCE])
def test_diameters_follow_their_truncated_weibull(trees, mix):
    """Diameters pass a Kolmogorov-Smirnov test against scipy's truncated Weibull, scaled to the wanted
    mean."""
    species = flora().trees[mix.species]
    a0, a1, c0, c1, c2 = species.diameters
    weibull = stats.weibull_min(c0 + c1 * mix.dbh_cm + c2 * 1.6 * mix.dbh_cm, scale=a0 + a1 * mix.dbh_cm)
    cut = weibull.cdf(6.9)
    raw = weibull.ppf(cut + (1 - cut) * (np.arange(20000) + 0.5) / 20000)
    scale = mix.dbh_cm / np.sqrt((raw**2).mean())
    dbh_cm = 100 * trees["dbh_m"][trees["species"] == species.number]
    assert np.sqrt((dbh_cm**2).mean()) == pytest.approx(mix.dbh_cm, rel=0.02)
    assert stats.kstest(dbh_cm / scale, lambda d: (weibull.cdf(d) - cut) / (1 - cut)).pvalue > 0.01


def test_shares_and_sizes_must_be_plausible():
    """Shares that do not sum to 1 are refused, three thirds pass; and so are diameters in millimetres."""
    with pytest.raises(ValueError, match="shares that sum to 1"):
        Storey(stems_per_ha=100, species=[BIRCH, BIRCH])
    third = {"share": 0.33, "dbh_cm": 18.0, "height_m": 19.0}
    Storey(stems_per_ha=100, species=[SpeciesShare(species=one, **third) for one in ("a", "b", "c")])
    with pytest.raises(ValueError, match=r"is dbh_cm in mm\?"):
        SpeciesShare(species="silver_birch", share=1.0, dbh_cm=110.0, height_m=12.0)


def test_chance_has_the_distributions_that_it_should(trees):
    """A quarter of the stems is birch, lean is Rayleigh with 1.5 degrees per axis in any direction, bark
    spreads evenly over 0.08 either way.

    Feet are on the ground; crowns begin over it and end under the tip.
    """
    assert trees["z_m"] == pytest.approx(0.01 * trees["x_m"] + 0.02 * trees["y_m"])
    assert ((trees["crown_base_m"] > 0) & (trees["crown_base_m"] < trees["height_m"])).all()
    birch = trees[trees["species"] == 1]
    assert stats.binomtest(len(birch), len(trees), 0.25).pvalue > 0.01
    assert stats.kstest(trees["lean_deg"], stats.rayleigh(scale=1.5).cdf).pvalue > 0.01
    assert stats.kstest(trees["lean_towards_deg"], stats.uniform(0, 360).cdf).pvalue > 0.01
    assert stats.kstest(birch["bark_reflectance"], stats.uniform(0.38, 0.16).cdf).pvalue > 0.01


@pytest.mark.parametrize(
    ("stems_per_ha", "log_a", "b"),
    [(4.0, -0.3973, 0.7328), (4.0, 0.2662, 0.6072)],  # Hasenauer (1997): oaks, beech
)
def test_crowns_without_neighbours_are_as_wide_as_open_grown_ones(stems_per_ha, log_a, b):
    """Lone trees have the published width of open-grown ones at their DBH, those of a closed stand that of
    forest-grown ones, both on average within the spread of the mean."""
    name = "english_oak" if log_a < 0 else "european_beech"
    mix = (SpeciesShare(species=name, share=1.0, dbh_cm=45.0, height_m=20.0),)
    alone, closed = (
        grown(make_stand(species=mix, stems_per_ha=per_ha), across)
        for per_ha, across in ((stems_per_ha, 30), (400.0, 8))
    )
    open_m = np.exp(log_a + b * np.log(100 * alone["dbh_m"]))
    assert (alone["crown_width_m"] / open_m).mean() == pytest.approx(1.0, abs=0.06)
    forest_m = flora().trees[name].crown_width_m(100 * closed["dbh_m"])
    assert (closed["crown_width_m"] / forest_m).mean() == pytest.approx(1.0, abs=0.04)


def of_classes(trees, columns):
    """Columns of trees about their means in classes of 5 cm of the DBH."""
    classes = np.round(20 * trees["dbh_m"])
    rows = np.array(columns)
    for one in np.unique(classes):
        own = classes == one
        rows[:, own] -= rows[:, own].mean(axis=1, keepdims=True)
    return rows


@pytest.mark.parametrize(
    ("mix", "published"),
    [
        (SPRUCE, (0.066, 0.30, 0.12)),  # Burger 1953, Kantola and Makela 2004: 122 trees thicker than 10 cm
        (PINE, (0.061, 0.23, 0.19)),  # Vanninen; Hasenauer
        (BIRCH, (0.056, 0.26, 0.16)),  # Ilomaki; Hasenauer
    ],
    ids=["spruce", "pine", "birch"],
)
def test_trees_of_one_size_vary_as_measured(spruces, mix, published):
    """In classes of 5 cm, ln height, logit of crown ratio and ln crown width spread as published within 25 %,
    and correlate alike.

    Tall trees have narrow crowns, and long crowns are wide: -0.20 and 0.23 in 290 trees of the Biomass and
    Allometry Database and SamsaRaLight.
    """
    trees = spruces if mix is SPRUCE else grown(make_stand(species=(mix,), stems_per_ha=700.0), 12)
    size = np.log(trees["dbh_m"])
    ratio = 1 - trees["crown_base_m"] / trees["height_m"]
    logs = np.log(trees["height_m"]), np.log(ratio / (1 - ratio)), np.log(trees["crown_width_m"])
    rest = np.array([one - np.polyval(np.polyfit(size, one, 2), size) for one in logs])
    spread = of_classes(trees, rest)
    assert spread.std(axis=1) == pytest.approx(published, rel=0.25)
    by_height, by_ratio = np.corrcoef(spread)[2, :2]
    assert by_height == pytest.approx(-0.2, abs=0.08)
    assert by_ratio == pytest.approx(0.23, abs=0.1)


def test_neighbours_shorten_crowns(spruces):
    """Of spruces of one size those with more neighbours within 10 m have shorter crowns."""
    places = feet_m(spruces)[:, :2]
    near = cKDTree(places).query_ball_point(places, 10.0, return_length=True)
    ratio = 1 - spruces["crown_base_m"] / spruces["height_m"]
    rest = ratio - np.polyval(np.polyfit(spruces["dbh_m"], ratio, 2), spruces["dbh_m"])
    inner = (places > 10).all(axis=1) & (places < 230).all(axis=1)
    assert stats.spearmanr(near[inner], rest[inner])[0] < -0.15


@pytest.mark.parametrize("name", ["european_beech", "english_oak", "sycamore"])
def test_crown_ratios_of_broadleaves_do_not_dip_between_30_and_60_cm(name):
    """The mean crown ratio of closed stands does not fall from 30 over 45 to 60 cm of mean DBH."""
    ratios = []
    for dbh_cm, height_m, stems_per_ha in ((30.0, 25.0, 500.0), (45.0, 31.0, 280.0), (60.0, 35.0, 160.0)):
        share = SpeciesShare(species=name, share=1.0, dbh_cm=dbh_cm, height_m=height_m)
        trees = grown(make_stand(species=(share,), stems_per_ha=stems_per_ha), 14)
        ratios.append(np.mean(1 - trees["crown_base_m"] / trees["height_m"]))
    assert sorted(ratios) == ratios


def leaf_area_m2(stand, trees):
    """Leaf area that crowns have by their prototypes, scaled by crown projection."""
    crown = cache(stand.crown)
    crowns = [crown(*kind, 0) for kind in trees[["cohort", "crown_class"]].tolist()]
    wide = trees["crown_width_m"] / [one.crown_width_m for one in crowns]
    return (wide**2 * [one.leaf_area_m2 for one in crowns]).sum()


def test_leaf_area_of_a_closed_stand_is_its_leaf_area_index(trees):
    """Leaves that the prototypes' crowns would carry cover 3/4 x 6 + 1/4 x 3 by share; a lone tree bears
    1.5 times its index at most."""
    by_crown = [(trees["crown_width_m"][trees["species"] == n] ** 2).sum() for n in (1, 2)]
    expected = np.average([3.0, 6.0], weights=by_crown)
    assert leaf_area_m2(make_stand(), trees) / (14 * 20.0) ** 2 == pytest.approx(expected, rel=0.03)
    crown = make_stand(stems_per_ha=5.0).crown(1, 0, 0)
    assert crown.leaf_area_m2 == pytest.approx(6.0 * 1.5 * np.pi / 4 * crown.crown_width_m**2)


def test_storeys_share_the_ground_and_have_their_own_density():
    """Under the canopy a second storey stands in clumps with its own density, and both bear one leaf area
    index together."""
    clumps = Clusters(kind="clusters", per_cluster=6.0, sigma_m=3.0)
    young = SpeciesShare(species="silver_birch", share=1.0, dbh_cm=8.0, height_m=9.0)
    lower = Storey(stems_per_ha=300.0, species=[young], pattern=clumps)
    stand = make_stand(stems_per_ha=700.0, species=[SPRUCE], storeys=[lower])
    trees, ground_m2 = grown(stand, 8), (8 * 20.0) ** 2
    for storey, per_ha, wide in ((0, 700.0, 0.1), (1, 300.0, 0.2)):
        assert (trees["storey"] == storey).sum() / ground_m2 * 1e4 == pytest.approx(per_ha, rel=wide)
    by_crown = [(trees["crown_width_m"][trees["storey"] == n] ** 2).sum() for n in (0, 1)]
    expected = np.average([6.0, 3.0], weights=by_crown)
    assert leaf_area_m2(stand, trees) / ground_m2 == pytest.approx(expected, rel=0.05)


def test_basal_area_is_as_asked_for(trees):
    """Stems of a stand as it grows, as many as follow from 30 m2 of basal area, have 30 m2 within 4 %."""
    per_ha = density_per_ha(Storey(basal_area_m2_per_ha=30.0, species=[BIRCH, SPRUCE]))
    assert per_ha * np.mean(np.pi / 4 * trees["dbh_m"] ** 2) == pytest.approx(30.0, rel=0.04)


def test_no_stem_stands_in_another():
    """Where stems are scattered, those whose feet would meet give way to the thicker, also across tiles;
    few do."""
    anywhere = poisson_pattern(seed=14, purpose=Growth.STAND, per_ha=1500.0)
    stand = make_stand(stems_per_ha=1500.0, species=[SPRUCE], pattern=Scattered(kind="random"))
    tiles = [(ix, iy) for ix in range(-3, 3) for iy in range(6)]
    discs = foot_discs(np.concatenate([stand.trees(*tile) for tile in tiles]))
    away = np.hypot(*(discs[:, None, :2] - discs[:, :2]).transpose(2, 0, 1)) + 9 * np.eye(len(discs))
    assert (away >= discs[:, None, 2] + discs[:, 2] + 0.05).all()
    sown = sum(len(anywhere.points(*tile)) for tile in tiles)
    assert 0.9 * sown < len(discs) < sown


def test_trees_in_the_open_keep_their_lower_branches():
    """A lone spruce has branches down to an eighth of its height, in an open stand to half, in a very
    dense one to two thirds at most."""
    closed, open_, half = (make_stand(stems_per_ha=n, species=(SPRUCE,)) for n in (2000.0, 1e-6, 400.0))
    base_m = [stand.crown(0, 0, 1).crown_base_m for stand in (closed, half, open_)]
    assert base_m[2] < 21.0 / 8 < base_m[1] < 21.0 / 2 < base_m[0] < 21.0 * 2 / 3
    trees = np.concatenate([half.trees(ix, 0) for ix in range(20)])
    middle = np.abs(trees["dbh_m"] - 0.24) < 0.01
    assert trees["crown_base_m"][middle].mean() == pytest.approx(base_m[1], rel=0.1)


def test_two_storeys_of_one_species_keep_apart():
    """Old and young trees of one species in a mixture have the sizes and the crowns of their own line."""
    stand = make_stand(species=(BIRCH, BIRCH.model_copy(update={"dbh_cm": 8.0, "height_m": 9.0})))
    trees = grown(stand, 6)
    for cohort, (dbh_m, height_m) in enumerate([(0.18, 19.0), (0.08, 9.0)]):
        own = trees[trees["cohort"] == cohort]
        assert np.sqrt((own["dbh_m"] ** 2).mean()) == pytest.approx(dbh_m, rel=0.05)
        assert stand.crown(cohort, 0, 0).height_m == pytest.approx(height_m)


def test_path_is_kept_clear_of_stems():
    """With clearance no stem surface is nearer than set, and all trees that are farther stay as they were."""
    path = np.array([[3.0, 3.0], [60.0, 20.0], [60.0, 80.0]])
    free, kept = make_stand(path_xy_m=path, clearance_m=2.0), make_stand()
    tiles = [(ix, iy) for ix in range(4) for iy in range(5)]
    all_trees = np.concatenate([kept.trees(*t) for t in tiles])
    trees = np.concatenate([free.trees(*t) for t in tiles])
    radius = taper_radius_m(tapers(trees), trees["dbh_m"], trees["height_m"], np.zeros((len(trees), 1)))
    axis = lean_rotation(trees["lean_deg"], trees["lean_towards_deg"])[:, :, 2]
    for above_m in (0.0, 1.0, 2.5):
        x, y = (trees[name] + above_m * axis[:, i] / axis[:, 2] for i, name in enumerate(("x_m", "y_m")))
        assert (distance_m(np.column_stack([x, y]), path) - radius[:, 0]).min() >= 2.0
    assert len(trees) < len(all_trees)
    gone = all_trees[~np.isin(all_trees["x_m"], trees["x_m"])]
    assert distance_m(feet_m(gone)[:, :2], path).max() < 2.8
    assert np.array_equal(all_trees[np.isin(all_trees["x_m"], trees["x_m"])], trees)


@pytest.mark.parametrize(
    "pattern",
    [Scattered(kind="hard_core"), Plantation(kind="plantation", row_spacing_m=3.0, tree_spacing_m=1.6)],
    ids=["hard core", "rows"],
)
def test_no_stem_stands_on_a_trail_and_the_density_is_as_set(pattern):
    """With trails every 20 m all stems are 2 m off their middles, and there are as many on the whole as
    without."""
    trails = Trails(Terrain(trail_spacing_m=20.0, trail_towards_deg=15.0), seed=14)
    stand = make_stand(stems_per_ha=900.0, pattern=pattern, trails=trails)
    assert stand.per_ha == pytest.approx(900.0)
    trees = grown(stand, 10)
    assert trails.are_free(feet_m(trees)[:, :2]).all()
    expected = 900.0 * (10 * 0.2) ** 2
    assert len(trees) == pytest.approx(expected, abs=3 * np.sqrt(expected) + 0.02 * expected)


GIANTS = SpeciesShare(species="norway_spruce", share=1.0, dbh_cm=120.0, height_m=50.0)
ROWS = Plantation(kind="plantation", row_spacing_m=2.5, tree_spacing_m=2.0)


@pytest.mark.parametrize(
    ("section", "message"),
    [
        (
            {"species": (BIRCH.model_copy(update={"species": "larch"}),)},
            "unknown species 'larch'; expected one of silver_birch, norway_spruce",
        ),
        (
            {"stems_per_ha": 5000.0, "species": [GIANTS]},
            ("found a basal area of 5655 m2 per ha; expected at most 350"),
        ),
        (
            {"stems_per_ha": 1800.0, "pattern": ROWS},
            ("found 1800; expected at most 1600, which rows of .* off the trails"),
        ),
    ],
)
def test_a_stand_that_cannot_be_is_refused(section, message):
    """Unknown species, more wood than the densest coast redwoods have, and more stems than rows hold off
    trails, which take four of twenty metres."""
    assert make_stand(stems_per_ha=300.0, species=[GIANTS]).per_ha == 300.0
    with pytest.raises(GeometryError, match=message):
        make_stand(**section, trails=Trails(Terrain(trail_spacing_m=20.0), seed=14))
