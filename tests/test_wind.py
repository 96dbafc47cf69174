"""Wind through the whole chain."""

import itertools

import numpy as np
import pytest
from woods import LINES

from vlp16emu import Emulator
from vlp16emu.forest.plants.allometry import BREAST_HEIGHT_M
from vlp16emu.scenario import load
from vlp16emu.types import PlantPart


@pytest.mark.usefixtures("kept_woods")
def test_still_air_changes_nothing():
    """At a speed of 0 the packets are those of the scene without wind."""
    still, calm = (Emulator("birch_walk", [*LINES, *wind]) for wind in ([], ["wind.speed_m_s=0.0"]))
    assert list(still.packets(0.0, 0.1)) == list(calm.packets(0.0, 0.1))


def test_swaying_stems_are_where_the_formula_has_them_at_each_pulse():
    """Points on stems, taken back by the lean at their own time, lie 4 mm from the circle of DBH; left as
    they are, not."""
    settings = ["motion={kind='static', x_m=10.0, y_m=3.0, height_m=1.3}", "seed=5", "sensor.max_range_m=8.0"]
    settings += ["wind={speed_m_s=9.0, towards_deg=70.0}", "world.stems_per_ha=400"]
    settings += ["world.crooked_stems=false", "world.terrain.rough_rms_m=0"]
    scenario = load("birch_walk", settings, ideal=True)
    emulator = Emulator(scenario)
    wind, checked, left_m = emulator.parts.wind, 0, []
    for returns in itertools.chain.from_iterable(
        emulator.returns(s, s + 0.1, truth=True) for s in np.arange(0.0, 6.0, 1.2)
    ):
        f, distance_m = returns.firings, returns.distance_m[..., 0]
        trees = emulator.parts.world.trees(f.origin_m[0, :1])
        row = returns.surfaces[np.where(distance_m > 0, returns.surface[..., 0], 0)]
        stem = (distance_m > 0) & (row["part"] == PlantPart.STEM) & (row["instance"] > 0)
        for tree in trees[np.isin(trees["id"], np.unique(row["instance"][stem]))]:
            own = stem & (row["instance"] == tree["id"])
            points_m = f.origin_m[own] + distance_m[own][:, None] * f.direction[own]
            over_foot_m = points_m[:, 2] - tree["z_m"]
            slab = np.abs(over_foot_m - BREAST_HEIGHT_M) < 0.15
            if not slab.any():
                continue
            shear = wind.shear(np.array([tree]), f.t_ns[own][slab])[:, 0]
            swayed_m = shear * over_foot_m[slab, None]
            lean = np.tan(np.radians(tree["lean_deg"])) * over_foot_m[slab]
            towards = np.radians(tree["lean_towards_deg"])
            axis_m = np.array([tree["x_m"], tree["y_m"]]) + lean[:, None] * [np.cos(towards), np.sin(towards)]
            away_m = points_m[slab, :2] - axis_m
            off_m = np.linalg.norm(away_m - swayed_m, axis=1) - tree["dbh_m"] / 2
            assert np.abs(off_m).max() < 0.004
            left_m.append(np.abs(np.linalg.norm(away_m, axis=1) - tree["dbh_m"] / 2).max())
            checked += int(slab.sum())
    assert checked > 500
    assert max(left_m) > 0.03
