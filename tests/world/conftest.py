"""A small mixed forest that the tests of this room share."""

import numpy as np
import pytest

from vlp16emu.world import Forest, SpeciesMix, Terrain

PATH_XY_M = np.array([[0.0, 0.0], [18.0, 4.0], [34.0, -3.0], [52.0, 2.0]])
MIX = (SpeciesMix("silver_birch", 0.4, 18.0, 19.0), SpeciesMix("norway_spruce", 0.6, 24.0, 21.0))


@pytest.fixture(scope="session")
def terrain():
    return Terrain(seed=5, hill_rms_m=1.5, rough_rms_m=0.08, slope_deg=6.0, slope_towards_deg=60.0)


@pytest.fixture(scope="session")
def make_forest(terrain):
    def make(**changes):
        values = {
            "seed": 5,
            "terrain": terrain,
            "stems_per_ha": 700.0,
            "species": MIX,
            "path_clearance_m": 0.8,
            "path_xy_m": PATH_XY_M,
            "reach_m": 40.0,
        }
        return Forest(**(values | changes))

    return make


@pytest.fixture(scope="session")
def forest(make_forest):
    return make_forest()


@pytest.fixture(scope="session")
def track_m():
    """Sensor positions along the first ten metres."""
    return np.column_stack([np.linspace(0, 10, 11), np.linspace(0, 2, 11), np.full(11, 2.0)])
