"""A small mixed forest that the tests of this room share."""

import numpy as np
import pytest

from vlp16emu.random import Purpose
from vlp16emu.world import (
    Clusters,
    Forest,
    Grass,
    HardCore,
    Logs,
    Polyline,
    Saplings,
    Scattered,
    Shrubs,
    SpeciesMix,
    Stand,
    Stones,
    Storey,
    Stumps,
    Terrain,
    stones_per_ha,
)

PATH_XY_M = np.array([[0.0, 0.0], [18.0, 4.0], [34.0, -3.0], [52.0, 2.0]])
MIX = (SpeciesMix("silver_birch", 0.4, 18.0, 19.0), SpeciesMix("norway_spruce", 0.6, 24.0, 21.0))


def layers(seed):
    """One of each kind of thing that grows or lies under the trees."""

    def scattered(purpose, per_ha):
        return Scattered(seed=seed, purpose=purpose, per_ha=per_ha)

    young = Clusters(seed=seed, purpose=Purpose.REGENERATION, per_ha=900.0, per_cluster=12.0, sigma_m=3.0)
    return [
        Saplings(
            pattern=young, species=["silver_birch", "norway_spruce"], height_m=(0.5, 4.0), season="leaf_on"
        ),
        Shrubs(pattern=scattered(Purpose.SHRUBS, 200.0), species=["hazel", "elder"], season="leaf_on"),
        Stones(scattered(Purpose.STONES, stones_per_ha(0.05))),
        Logs(scattered(Purpose.LOGS, 150.0), ["norway_spruce"], (0.2, 0.5), (3.0, 12.0)),
        Stumps(scattered(Purpose.STUMPS, 150.0), ["silver_birch"], (0.2, 0.5), (0.1, 0.4)),
        Grass(scattered(Purpose.GRASS, 5000.0), (0.15, 0.5)),
    ]


@pytest.fixture(scope="session")
def terrain():
    return Terrain(
        seed=5, hill_rms_m=1.5, rough_rms_m=0.08, mounds_per_ha=0.0, slope_deg=6.0, slope_towards_deg=60.0
    )


@pytest.fixture(scope="session")
def make_forest(terrain):
    def make(
        *,
        stems_per_ha=700.0,
        path_xy_m=PATH_XY_M,
        species=MIX,
        with_layers=False,
        reach_m=40.0,
        loose_stems=False,
    ):
        path = Polyline(path_xy_m)
        pattern = HardCore(seed=5, purpose=Purpose.STAND, per_ha=stems_per_ha)
        stand = Stand(
            seed=5,
            height_m=terrain.height_m,
            storeys=[Storey(pattern, species)],
            path=path,
            path_clearance_m=0.8,
            season="leaf_on",
            dead_branches=False,
        )
        return Forest(
            seed=5,
            height_m=terrain.height_m,
            stems=stand,
            layers=layers(5) if with_layers else [],
            path=path,
            path_clearance_m=0.8,
            reach_m=reach_m,
            loose_stems=loose_stems,
        )

    return make


@pytest.fixture(scope="session")
def forest(make_forest):
    """Stand alone."""
    return make_forest()


@pytest.fixture(scope="session")
def full_forest(make_forest):
    """Stand with all that grows and lies under it."""
    return make_forest(with_layers=True)


@pytest.fixture(scope="session")
def track_m():
    """Sensor positions along the first ten metres."""
    return np.column_stack([np.linspace(0, 10, 11), np.linspace(0, 2, 11), np.full(11, 2.0)])
