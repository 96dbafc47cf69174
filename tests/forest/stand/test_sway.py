"""Gusts, how trees answer them, and windows that the wind blows through."""

import numpy as np
import pytest
from forest.kit import trees_of
from scipy.signal import lsim

from vlp16emu.forest.plants.prototypes import CrownKey
from vlp16emu.forest.plants.species import flora
from vlp16emu.forest.plants.stem import StemKey
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
def loose(make_forest):
    return make_forest(with_layers=True, loose_stems=True)


@pytest.fixture(scope="module")
def make_wind(loose):
    def make(**changed):
        section = Wind(**{"speed_m_s": 8.0, "towards_deg": 30.0, "turbulence_intensity": 0.5, **changed})
        return TreeSway(section, forest=loose, start_ns=START_NS)

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


def test_stiffness_is_that_of_the_mass_at_its_frequency():
    """The lean of a stem, a cone by and large, is torque over (2 pi f)^2 J, with J within 40 % of that of
    a cone."""
    one = tree("norway_spruce")
    frequency_hz, lean_per_stress = mechanics(one, flora(), "leaf_on")
    stem_kg = 900 * np.pi / 4 * 0.24**2 * 21 / 3
    cone_kg_m2 = stem_kg * 21**2 / 10 + 0.3 * stem_kg * 15.0**2
    torque_n_m = np.pi / 4 * 4.0**2 * 15.0
    inertia_kg_m2 = torque_n_m / lean_per_stress[0] / (2 * np.pi * frequency_hz[0]) ** 2
    assert 1.0 < inertia_kg_m2 / cone_kg_m2 < 1.8


def test_stems_of_their_own_are_the_stems_of_the_tile(full_forest, loose, track_m):
    """Loose stems have the meshes, places, surfaces and numbers that they have in the shapes of tiles."""
    found = []
    for forest, kind, first in ((loose, StemKey, 0), (full_forest, TileKey, 1)):
        window, stems = forest.window(track_m), {}
        for i, which in enumerate(window.shape):
            if isinstance(key := window.shapes[which], kind):
                meshes = forest.shape(key)[first:]
                rows = window.surfaces[window.first_surface[i] + first :][: len(meshes)]
                for n in range(0, len(meshes), 2):
                    own = [mesh.vertices_m.tobytes() + mesh.faces.tobytes() for mesh in meshes[n : n + 2]]
                    place = window.world_T_shape[i].tobytes()
                    stems[int(rows["instance"][n])] = place, rows[n : n + 2].tobytes(), own
        found.append(stems)
    assert found[0] == found[1]
    assert len(found[0]) > 50


def test_wind_moves_stems_and_crowns_and_nothing_else(make_wind, loose, track_m):
    """Each tree of the stand sways as one, about its foot; saplings, ground and things are not among what
    moves."""
    window = loose.window(track_m)
    blown = make_wind().with_sway(window, track_m, START_NS, START_NS + 3 * KNOT_NS)
    trees = {row["id"]: row for row in loose.trees(track_m)}
    keys = [window.shapes[which] for which in window.shape]
    instance = window.surfaces["instance"][window.first_surface]
    part = window.surfaces["part"][window.first_surface]
    moves = np.zeros(len(instance), np.bool_)
    moves[blown.sway.placement] = True
    for i, number in enumerate(instance):
        grown = number in trees and trees[number]["storey"] != REGENERATION
        assert moves[i] == grown == isinstance(keys[i], StemKey | CrownKey)
    assert set(part[moves].tolist()) == {PlantPart.ROOT_FLARE, PlantPart.BRANCH_FIRST_ORDER}
    own = instance[blown.sway.placement]
    assert blown.sway.foot_z_m.tolist() == [trees[number]["z_m"] for number in own]
    for number in np.unique(own)[:20]:
        both = blown.sway.shear[:, own == number]
        assert both.shape[1] == 2
        assert (both[:, 0] == both[:, 1]).all()


def test_a_tree_is_at_one_place_whatever_window_it_is_in(make_wind, loose, track_m):
    """Windows of other stretches of way and time have the same knots, and trees the same lean at them, to
    the bit."""
    wind, aside_m = make_wind(), np.array([6.0, -3.0, 0.0])
    first = wind.with_sway(loose.window(track_m), track_m, START_NS, START_NS + 6_795_000_000)
    there_m = track_m + aside_m
    second = wind.with_sway(
        loose.window(there_m), there_m, START_NS + 5_012_345_678, START_NS + 11_000_000_000
    )
    shift = (second.sway.start_ns - first.sway.start_ns) // KNOT_NS
    assert first.sway.start_ns <= START_NS
    assert first.sway.start_ns + KNOT_NS * (len(first.sway.shear) - 1) >= START_NS + 6_795_000_000
    own, other = (
        dict(
            zip(
                w.surfaces["instance"][w.first_surface[w.sway.placement]],
                w.sway.shear.swapaxes(0, 1),
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


def test_stands_lean_with_the_wind(make_wind, loose, track_m):
    """Over ten minutes the mean lean is downwind and that of the stress; the spread across is the smaller."""
    trees = loose.trees(track_m)[:40]
    trees = trees[trees["storey"] != REGENERATION]
    t_ns = START_NS + 500_000_000 * np.arange(1200)
    shear = make_wind(gust_length_m=5.0).shear(trees, t_ns)
    down = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6)])
    along, across = shear @ down, shear @ [-down[1], down[0]]
    wanted = 1.2 * (0.3 * 8.0) ** 2 * mechanics(trees, loose.plants, "leaf_on")[1]
    assert np.abs(along.mean(axis=0) / wanted - 1).max() < 0.1
    assert np.abs(across.mean(axis=0) / wanted).max() < 0.1
    assert (across.std(axis=0) < along.std(axis=0)).all()
