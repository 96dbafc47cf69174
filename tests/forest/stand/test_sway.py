"""Gusts, how trees answer them, and windows that the wind blows through."""

import numpy as np
import pytest
from forest.kit import corners, trees_of
from scipy.signal import lsim
from scipy.spatial import cKDTree

from vlp16emu.forest.plants.allometry import taper_radius_m
from vlp16emu.forest.plants.bending import SHARES
from vlp16emu.forest.plants.prototypes import CrownKey
from vlp16emu.forest.plants.species import flora, tapers
from vlp16emu.forest.plants.stem import STEM_LAYERS, StemKey
from vlp16emu.forest.settings import Wind
from vlp16emu.forest.stand.stand import REGENERATION
from vlp16emu.forest.stand.wind import ACROSS, ALONG, KNOT_NS, Trees, TreeSway, gust_lines, mechanics, swings
from vlp16emu.forest.tiles import TileKey
from vlp16emu.types import PlantPart

SPEED_M_S, INTENSITY, LENGTH_M = 6.0, 0.5, 20.0
KAIMAL = Wind(speed_m_s=SPEED_M_S, turbulence_intensity=INTENSITY, gust_length_m=LENGTH_M)


def gusts(lines, speed_m_s, downwind_m, aside_m, t_s):
    """Speed (k,) of a component in m/s, beyond the mean, at a place and times (k,): a rigid tree follows
    at once."""
    rigid = Trees(np.array([np.inf]), 1.0, np.array([downwind_m]), np.array([aside_m]))
    return swings(lines, speed_m_s, rigid, t_s)[:, 0]


@pytest.mark.parametrize(("component", "share"), [(ALONG, 1.0), (ACROSS, 0.8)])
def test_gusts_have_the_turbulence_that_was_asked_for(component, share):
    """Their variance is (intensity x speed)^2, of the lines to rounding and of three hours of gusts to 3
    %."""
    lines = gust_lines(KAIMAL, 1, component)
    wanted = (share * INTENSITY * SPEED_M_S) ** 2
    assert np.sum(lines.speed_m_s**2) / 2 == pytest.approx(wanted, rel=1e-12)
    u_m_s = gusts(lines, SPEED_M_S, 12.0, -7.0, np.arange(0.0, 10_800.0, 0.5))
    assert u_m_s.var() == pytest.approx(wanted, rel=0.03)
    assert abs(u_m_s.mean()) < 0.02


def test_energy_lies_where_kaimal_has_it():
    """In every octave from 0.02 Hz to 4 Hz the lines hold the integral of Kaimal's spectrum, to a line of
    eighteen at either edge."""
    lines = gust_lines(KAIMAL, 2, ALONG)
    hz, energy = lines.omega_rad_s / (2 * np.pi), lines.speed_m_s**2 / 2
    f = np.geomspace(0.02, 4.0, 20_001)
    n = f * LENGTH_M / SPEED_M_S
    density = 4 * n / (1 + 6 * n) ** (5 / 3) / f * (INTENSITY * SPEED_M_S) ** 2
    for low in 0.02 * 2.0 ** np.arange(7):
        octave = (f >= low) & (f <= 2 * low)
        wanted = np.trapezoid(density[octave], f[octave])
        assert energy[(hz >= low) & (hz < 2 * low)].sum() == pytest.approx(wanted, rel=0.12)


def test_gusts_travel_with_the_wind():
    """What is felt 30 m downwind was felt here 30 m / speed ago."""
    lines, t_s = gust_lines(KAIMAL, 3, ALONG), np.arange(0.0, 60.0, 0.1)
    there = gusts(lines, SPEED_M_S, 35.0, 4.0, t_s)
    assert np.abs(there - gusts(lines, SPEED_M_S, 5.0, 4.0, t_s - 30.0 / SPEED_M_S)).max() < 1e-9


def test_gusts_part_across_the_wind():
    """Beside each other lines agree by Davenport's exp(-10 f d / speed), over all lines of sixty winds to
    0.03."""
    apart_m, waves, phases = 4.0, [], []
    for seed in range(60):
        lines = gust_lines(KAIMAL, seed, ALONG)
        waves.append(lines.omega_rad_s / (2 * np.pi))
        phases.append(lines.aside_rad_m * apart_m)
    hz, phase = np.concatenate(waves), np.concatenate(phases)
    for low, high in ((0.01, 0.03), (0.1, 0.2), (0.2, 0.4)):
        band = (hz >= low) & (hz < high)
        wanted = np.exp(-10 * hz[band] * apart_m / SPEED_M_S).mean()
        assert np.cos(phase[band]).mean() == pytest.approx(wanted, abs=0.03)


@pytest.mark.parametrize(("hz", "damping"), [(0.15, 0.05), (0.3, 0.1), (1.2, 0.3)])
def test_trees_follow_as_a_general_solver_has_it(hz, damping):
    """From any state on, once that is forgotten, scipy's lsim of the same oscillator gives the same swing
    to 0.02 %."""
    lines, omega = gust_lines(KAIMAL, 4, ALONG), 2 * np.pi * hz
    t_s = np.arange(0.0, 10.0 / (damping * omega) + 15.0, 0.005)
    u_m_s = gusts(lines, SPEED_M_S, 3.0, 2.0, t_s)
    system = ([omega**2], [1.0, 2 * damping * omega, omega**2])
    _, solved, _ = lsim(system, u_m_s, t_s)
    tree = Trees(np.array([omega]), damping, np.array([3.0]), np.array([2.0]))
    late = t_s > t_s[-1] - 15.0
    ours = swings(lines, SPEED_M_S, tree, t_s[late])[:, 0]
    assert np.abs(ours - solved[late]).max() < 2e-4 * INTENSITY * SPEED_M_S + 1e-4


START_NS = 1_789_000_000_000_000_000


@pytest.fixture(scope="module")
def make_wind(full_forest):
    def make(**changed):
        section = Wind(**{"speed_m_s": 8.0, "towards_deg": 30.0, "turbulence_intensity": 0.5, **changed})
        return TreeSway(section, forest=full_forest, start_ns=START_NS)

    return make


def tree(species):
    return trees_of([species], dbh_m=0.24, height_m=21.0, crown_base_m=9.0, crown_width_m=4.0)


def test_frequencies_are_those_of_the_paper():
    """A spruce of 24 cm and 21 m swings at 0.0766 + 3.1219 x 24 / 21^2 Hz, a bare birch as well, one in
    leaf slower."""
    wanted = 0.0766 + 3.1219 * 24 / 21**2
    found = {
        (name, season): mechanics(tree(name), flora(), season)[0][0]
        for name in ("norway_spruce", "silver_birch")
        for season in ("leaf_on", "leaf_off")
    }
    assert found["norway_spruce", "leaf_on"] == found["norway_spruce", "leaf_off"] == pytest.approx(wanted)
    assert found["silver_birch", "leaf_off"] == pytest.approx(wanted)
    assert found["silver_birch", "leaf_on"] == pytest.approx(0.8 * wanted)


def test_sitka_spruce_sways_as_measured():
    """Six trees of 14.5 cm and 14.2 m on average swayed at 0.35 Hz (Milne, Tree Physiol 9, 1991), to 15 %."""
    measured = trees_of(["norway_spruce"], dbh_m=0.145, height_m=14.2, crown_base_m=5.0, crown_width_m=2.5)
    assert mechanics(measured, flora(), "leaf_on").frequency_hz[0] == pytest.approx(0.35, rel=0.15)


@pytest.mark.parametrize("dbh_m", [0.16, 0.24, 0.4])
def test_stems_are_as_stiff_as_green_wood(dbh_m):
    """The tip of a spruce moves under the drag on its crown as that of a beam of its taper with a modulus of
    3 to 9 GPa, as green softwood has, though its stiffness comes from frequency and mass alone."""
    height_m = 21.0 * (dbh_m / 0.24) ** 0.5
    one = trees_of(
        ["norway_spruce"], dbh_m=dbh_m, height_m=height_m, crown_base_m=9.0, crown_width_m=12.0 * dbh_m
    )
    _, top_m_per_pa, (curve,) = mechanics(one, flora(), "leaf_on")
    at_m = height_m * SHARES
    taper = tapers(one)
    radius_m = taper_radius_m(taper, one["dbh_m"], one["height_m"], at_m[None])[0].clip(0.05 * dbh_m)
    load = np.where(at_m >= 9.0, 1.0 - SHARES, 0.0)
    load *= np.pi / 4 * one["crown_width_m"][0] ** 2 / np.trapezoid(load, at_m)
    arm_m = np.maximum(at_m[:, None] - at_m, 0.0)  # of each load about each height
    moment = np.trapezoid(arm_m.T * load, at_m, axis=1)
    curvature = moment / (np.pi / 4 * radius_m**4)
    tip_times_modulus = np.trapezoid(curvature * (height_m - at_m), at_m)
    assert 3e9 < tip_times_modulus / top_m_per_pa[0] < 9e9
    assert curve[0] == 0.0
    assert curve[-1] == 1.0


def test_layers_of_a_stem_are_the_stem(full_forest, track_m):
    """Layers of loose stems are the faces of the stem in the tile's own shape, each once, at the same place
    to 1 um, and with its surfaces; each layer is between two rings."""
    still = full_forest.window(track_m)
    ids = full_forest.trees(track_m)["id"][:60].astype(np.int64)
    loose = full_forest.with_loose_stems(still, ids)
    own = {
        (key.ix, key.iy): (full_forest.shape(key), still.world_T_shape[i, :, 3], int(still.first_surface[i]))
        for i, which in enumerate(still.shape)
        if isinstance(key := still.shapes[which], TileKey)
    }
    faces = {}
    for i, which in enumerate(loose.shape):
        if isinstance(key := loose.shapes[which], StemKey):
            for j, mesh in enumerate(full_forest.shape(key)):
                at_m = corners(mesh) + loose.world_T_shape[i, :, 3]
                faces.setdefault(int(loose.first_surface[i]) + j, []).append(at_m)
    assert len(faces) > 50
    assert not any(isinstance(key, TileKey) for key in loose.shapes)
    whole = {
        first + j: corners(mesh) + origin_m
        for meshes, origin_m, first in own.values()
        for j, mesh in enumerate(meshes)
    }
    for row, layers in faces.items():
        found = np.concatenate(layers)
        assert still.surfaces["instance"][row] in ids
        assert len(found) == len(whole[row])
        middles_m = [each.mean(axis=1) for each in (found, whole[row])]
        away_m, nearest = cKDTree(middles_m[0]).query(middles_m[1])
        assert away_m.max() < 1e-6
        assert len(np.unique(nearest)) == len(found)


def test_wind_moves_stems_and_crowns_and_nothing_else(make_wind, full_forest, track_m):
    """Each tree of the stand sways as one, about its foot; saplings, ground and things are not among what
    moves."""
    window = full_forest.window(track_m)
    blown = make_wind().with_sway(window, track_m, START_NS, START_NS + 3 * KNOT_NS)
    trees = {row["id"]: row for row in full_forest.trees(track_m)}
    keys = [blown.shapes[which] for which in blown.shape]
    instance = blown.surfaces["instance"][blown.first_surface]
    part = blown.surfaces["part"][blown.first_surface]
    moves = np.zeros(len(instance), np.bool_)
    moves[blown.sway.placement] = True
    for i, number in enumerate(instance):
        grown = number in trees and trees[number]["storey"] != REGENERATION
        assert moves[i] == grown == isinstance(keys[i], StemKey | CrownKey)
    assert set(part[moves].tolist()) == {PlantPart.ROOT_FLARE, PlantPart.BRANCH_FIRST_ORDER}
    own = instance[blown.sway.placement]
    assert blown.sway.foot_z_m.tolist() == [trees[number]["z_m"] for number in own]
    for number in np.unique(own)[:20]:
        of_tree = blown.sway.top_m[:, own == number]
        assert of_tree.shape[1] == 1 + STEM_LAYERS
        assert (of_tree == of_tree[:, :1]).all()


def test_a_tree_is_at_one_place_whatever_window_it_is_in(make_wind, full_forest, track_m):
    """Windows of other stretches of way and time have the same knots, and trees the same movement at them, to
    the bit."""
    wind, aside_m = make_wind(), np.array([6.0, -3.0, 0.0])
    first = wind.with_sway(full_forest.window(track_m), track_m, START_NS, START_NS + 6_795_000_000)
    there_m = track_m + aside_m
    second = wind.with_sway(
        full_forest.window(there_m), there_m, START_NS + 5_012_345_678, START_NS + 11_000_000_000
    )
    shift = (second.sway.start_ns - first.sway.start_ns) // KNOT_NS
    assert first.sway.start_ns <= START_NS
    assert first.sway.start_ns + KNOT_NS * (len(first.sway.top_m) - 1) >= START_NS + 6_795_000_000
    own, other = (
        dict(
            zip(
                w.surfaces["instance"][w.first_surface[w.sway.placement]],
                w.sway.top_m.swapaxes(0, 1),
                strict=True,
            )
        )
        for w in (first, second)
    )
    both = own.keys() & other.keys()
    assert len(both) > 50
    for number in both:
        common = own[number][shift:]
        assert common.tobytes() == other[number][: len(common)].tobytes()


def test_stands_lean_with_the_wind(make_wind, full_forest, track_m):
    """Over ten minutes the mean movement is downwind and that of the stress; the spread across is smaller."""
    trees = full_forest.trees(track_m)[:40]
    trees = trees[trees["storey"] != REGENERATION]
    t_ns = START_NS + 500_000_000 * np.arange(1200)
    top_m = make_wind(speed_m_s=1.0, gust_length_m=2.5).top_m(trees, t_ns)
    down = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6)])
    along, across = top_m @ down, top_m @ [-down[1], down[0]]
    wanted = 1.2 * (0.3 * 1.0) ** 2 * mechanics(trees, full_forest.plants, "leaf_on")[1]
    assert np.abs(along.mean(axis=0) / wanted - 1).max() < 0.1
    assert np.abs(across.mean(axis=0) / wanted).max() < 0.1
    assert (across.std(axis=0) < along.std(axis=0)).all()


def test_neighbours_hold_a_crown(make_wind, full_forest, track_m):
    """In a strong wind no top moves by more than half the width of its crown, and thin trees come near it."""
    trees = full_forest.trees(track_m)
    trees = trees[trees["storey"] != REGENERATION]
    top_m = make_wind(speed_m_s=12.0).top_m(trees, START_NS + 500_000_000 * np.arange(200))
    share = np.hypot(top_m[..., 0], top_m[..., 1]).max(axis=0) / (trees["crown_width_m"] / 2)
    assert 0.9 < share.max() < 1.0
