"""A scene with plants of the user's own, from the file to packets, labels and inventory."""

import re
from importlib import resources

import numpy as np
import pytest

from vlp16emu import Emulator
from vlp16emu.scenario import load
from vlp16emu.types import Semantic

pytestmark = pytest.mark.usefixtures("kept_woods")

SCENE = """\
schema = 1
title = "A stand of the user's own species"
seed = 4

[sensor]
max_range_m = 10.0

[motion]
kind = "static"

[world]
kind = "forest"
species_file = "plants.toml"
stems_per_ha = 150
terrain = { relief = "flat" }
species = [{ species = "grey_alder", share = 1.0, dbh_cm = 16.0, height_m = 15.0 }]
regeneration = { stems_per_ha = 200 }
logs = { per_ha = 60 }
shrubs = { per_ha = 200, species = ["willow"] }
"""


def own_plants():
    """Birch and hazel of the shipped table under other names and numbers."""
    shipped = resources.files("vlp16emu.forest").joinpath("species.toml").read_text(encoding="utf-8")
    sections = re.split(r"(?m)^(?=\[(?:tree|shrub)\.\w+\]$)", shipped)
    birch = next(text for text in sections if text.startswith("[tree.silver_birch]"))
    hazel = next(text for text in sections if text.startswith("[shrub.hazel]"))
    text = birch.replace("silver_birch", "grey_alder") + hazel.replace("shrub.hazel", "shrub.willow")
    numbers = iter((1001, 2002))
    return re.sub(r"(?m)^number = \d+", lambda _: f"number = {next(numbers)}", text)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A scene file with the plants beside it."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "plants.toml").write_text(own_plants(), encoding="utf-8")
    (folder / "own.toml").write_text(SCENE, encoding="utf-8")
    return folder / "own.toml"


def test_own_plants_are_scanned_and_labelled(scene):
    """Trees, saplings and shrubs of the user's file give returns under their own numbers."""
    returns = list(Emulator(load(str(scene))).returns(0.0, 0.1, truth=True))
    hit = np.concatenate([r.surfaces[r.surface[..., 0][r.distance_m[..., 0] > 0]] for r in returns])
    assert set(hit["species"][hit["semantic"] == Semantic.TREE].tolist()) == {1001}
    assert set(hit["species"][hit["semantic"] == Semantic.SHRUB].tolist()) == {2002}
