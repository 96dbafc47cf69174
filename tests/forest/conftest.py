"""A small mixed forest that the tests of this room share."""

import numpy as np
import pytest
from forest.kit import REACH_M

from vlp16emu.foliage.polyline import Corridor
from vlp16emu.forest import settings
from vlp16emu.forest.ground.terrain import TerrainHeights
from vlp16emu.forest.plants.species import flora
from vlp16emu.forest.stand.forest import ForestWorld
from vlp16emu.forest.stand.points import Land
from vlp16emu.forest.stand.stand import Stand

PATH_XY_M = np.array([[0.0, 0.0], [18.0, 4.0], [34.0, -3.0], [52.0, 2.0]])
BIRCH = settings.SpeciesShare(species="silver_birch", share=0.4, dbh_cm=18.0, height_m=19.0)
SPRUCE = settings.SpeciesShare(species="norway_spruce", share=0.6, dbh_cm=24.0, height_m=21.0)
YOUNG = settings.Clusters(kind="clusters", per_cluster=12.0, sigma_m=3.0)
TREES = {"kind": "forest", "stems_per_ha": 700.0, "species": [BIRCH, SPRUCE], "texture": 0.0}
BARE = settings.Forest(**TREES)
FULL = settings.Forest(
    **TREES,
    regeneration=settings.Regeneration(stems_per_ha=900.0, pattern=YOUNG),
    shrubs=settings.Shrubs(
        per_ha=200.0, species=["hazel", "elder"], pattern=settings.Scattered(kind="random")
    ),
    stones=settings.Stones(cover=0.05),
    logs=settings.Logs(per_ha=150.0, species=["norway_spruce"], diameter_m=(0.2, 0.5), length_m=(3.0, 12.0)),
    stumps=settings.Stumps(per_ha=150.0, species=["silver_birch"], diameter_m=(0.2, 0.5)),
    grass=settings.Grass(tufts_per_m2=0.5),
    herbs=settings.Herbs(cover=0.05),
    ferns=settings.Ferns(cover=0.03),
    dwarf_shrubs=settings.DwarfShrubs(cover=0.03),
    moss=settings.Moss(cover=0.1),
    litter=settings.Litter(cover=0.1),
)
"""Trees with one of each kind of thing that grows or lies under them."""


@pytest.fixture(scope="session")
def rootless():
    """Species table of trees without roots on the ground."""
    return {
        name: one.model_copy(update={"stem": one.stem.model_copy(update={"surface_roots": 0.0})})
        for name, one in flora().trees.items()
    }


@pytest.fixture(scope="session")
def terrain():
    return TerrainHeights(
        settings.Terrain(hill_rms_m=1.5, rough_rms_m=0.08, slope_deg=6.0, slope_towards_deg=60.0), seed=5
    )


@pytest.fixture(scope="session")
def make_forest(terrain):
    def make(*, path_xy_m=PATH_XY_M, with_layers=False, **changes):
        section = (FULL if with_layers else BARE).model_copy(update=changes)
        land = Land(5, terrain.height_m, Corridor(path_xy_m, section.path_clearance_m))
        return ForestWorld(section, Stand(section, land), land, reach_m=REACH_M)

    return make


@pytest.fixture(scope="session")
def forest(make_forest):
    """Trees alone."""
    return make_forest()


@pytest.fixture(scope="session")
def full_forest(make_forest):
    """Trees with all that grows and lies under them."""
    return make_forest(with_layers=True)


@pytest.fixture(scope="session")
def track_m():
    """Sensor positions along the first four metres."""
    return np.column_stack([np.linspace(0, 4, 5), np.linspace(0, 0.9, 5), np.full(5, 2.0)])
