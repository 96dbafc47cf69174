"""The species table and its allometry."""

import numpy as np
import pytest

from vlp16emu.world.species import species_table, taper_radius_m

BIRCH, SPRUCE = (species_table()[name] for name in ("silver_birch", "norway_spruce"))


def test_numbers_are_unique_and_never_change():
    """Species numbers stand in recorded labels, so they are fixed for ever."""
    assert {name: species.number for name, species in species_table().items()} == {
        "silver_birch": 1,
        "norway_spruce": 2,
    }


@pytest.mark.parametrize(
    ("species", "heights_m"), [(BIRCH, [17.3, 22.1, 24, 25, 26.1]), (SPRUCE, [12.1, 20.1, 24, 26.2, 28.6])]
)
def test_uniform_height_curve(species, heights_m):
    """Heights of trees of 10 to 60 cm in a stand of 30 cm and 24 m, worked out from the published curves."""
    dbh_cm = np.array([10.0, 20.0, 30.0, 40.0, 60.0])
    assert species.height_m(dbh_cm, 30.0, 24.0) == pytest.approx(heights_m, abs=0.06)


@pytest.mark.parametrize(("species", "width_m", "base_m"), [(BIRCH, 5.5, 12.0), (SPRUCE, 4.5, 14.1)])
def test_crown_of_a_tree_of_30_cm_and_24_m(species, width_m, base_m):
    """Crown width and base, with a top height of 26 m, worked out from the published equations."""
    dbh_cm = np.array([30.0])
    assert species.crown_width_m(dbh_cm)[0] == pytest.approx(width_m, abs=0.06)
    assert species.crown_base_m(dbh_cm, np.array([24.0]), 26.0)[0] == pytest.approx(base_m, abs=0.06)


@pytest.mark.parametrize("species", [BIRCH, SPRUCE])
def test_taper_is_exact_at_breast_height_and_flares_at_the_ground(species):
    """A stem of 30 cm and 24 m has its DBH at 1.3 m, 41.7 to 46.2 cm at the ground, and ends in a point."""
    heights = np.array([[1.3, 0.0, -0.5, 24.0, 12.0]])
    diameter_cm = (
        200 * taper_radius_m(np.array([species.taper]), np.array([0.3]), np.array([24.0]), heights)[0]
    )
    assert diameter_cm[0] == pytest.approx(30.0, abs=1e-9)
    assert 41.7 <= diameter_cm[1] <= 46.21
    assert diameter_cm[2] == diameter_cm[1]
    assert diameter_cm[3] == 0
    assert 15 < diameter_cm[4] < 27


@pytest.mark.parametrize("species", [BIRCH, SPRUCE])
def test_stems_grow_thinner_all_the_way_up(species):
    """No tree from 5 to 120 cm has a bulge above breast height."""
    for dbh_m, height_m in [(0.05, 6.0), (0.18, 19.0), (0.6, 33.0), (1.2, 45.0)]:
        heights = np.linspace(1.3, height_m, 200)[None]
        radius = taper_radius_m(np.array([species.taper]), np.array([dbh_m]), np.array([height_m]), heights)[
            0
        ]
        assert (np.diff(radius) < 0).all()
