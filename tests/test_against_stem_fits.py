"""Diameters that a forester would fit to the points of a walk, against those that the stems were made
with."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from vlp16emu import Emulator
from vlp16emu.forest.plants.allometry import BREAST_HEIGHT_M
from vlp16emu.scenario import load
from vlp16emu.types import PlantPart, Semantic

pytestmark = pytest.mark.usefixtures("kept_woods")

SPRUCE = ["sensor.max_range_m=12.0", "world.terrain.rough_rms_m=0", "sensor.return_mode=strongest", "seed=3"]
WALK_S = 3.0


@pytest.fixture(scope="module", params=["false", "true"], ids=["round", "crooked"])
def seen(request):
    """Points of stems about breast height, by tree, the trees' records, and whether they are straight and
    round."""
    scenario = load("spruce_walk", [*SPRUCE, f"world.crooked_stems={request.param}"], ideal=True)
    emulator = Emulator(scenario)
    points_m, instance = [], []
    for returns in emulator.returns(0.0, WALK_S, truth=True):
        distance_m = returns.distance_m[..., 0]
        hit = distance_m > 0
        row = returns.surfaces[returns.surface[..., 0][hit]]
        stem = (row["semantic"] == Semantic.TREE) & (row["part"] == PlantPart.STEM)
        f = returns.firings
        points_m.append((f.origin_m[hit] + distance_m[hit][:, None] * f.direction[hit])[stem])
        instance.append(row["instance"][stem])
    points_m, instance = np.concatenate(points_m), np.concatenate(instance)
    trees = emulator.parts.world.trees(emulator.parts.motion.poses_at(f.t_ns[0]).world_p_body_m)
    return points_m, instance, trees, request.param == "false"


def across(tree, points_m):
    """Put points into the frame of a leaning stem: two coordinates across its axis, and the height along
    it."""
    lean, towards = np.radians([tree["lean_deg"], tree["lean_towards_deg"]])
    axis = np.array([np.sin(lean) * np.cos(towards), np.sin(lean) * np.sin(towards), np.cos(lean)])
    east = np.cross([0.0, 1.0, 0.0], axis)
    east /= np.linalg.norm(east)
    local_m = points_m - [tree["x_m"], tree["y_m"], tree["z_m"]]
    return np.stack([local_m @ east, local_m @ np.cross(axis, east), local_m @ axis], axis=1)


def fitted_diameter_m(xy_m):
    """Diameter of the circle that lies nearest to the points in the geometric sense."""

    def gaps(circle):
        return np.hypot(*(xy_m - circle[:2]).T) - circle[2]

    return 2 * least_squares(gaps, [*xy_m.mean(axis=0), 0.1], method="lm").x[2]


def test_circles_through_noise_free_returns_give_dbh(seen):
    """On every round stem seen well at breast height the fitted diameter is within 3 mm of DBH, on average
    within 1 mm.

    Crooked spruces are oval, with lobes and bark: what is seen of one fits a circle up to 15 mm off, on
    average within 1 mm.
    """
    points_m, instance, trees, is_round = seen
    errors_m = []
    for tree in trees:
        local_m = across(tree, points_m[instance == tree["id"]])
        slab = np.abs(local_m[:, 2] - BREAST_HEIGHT_M) < 0.1
        if slab.sum() >= 40:
            errors_m.append(fitted_diameter_m(local_m[slab, :2]) - tree["dbh_m"])
    assert len(errors_m) >= 12
    assert np.abs(errors_m).max() < (0.003 if is_round else 0.015)
    assert abs(np.mean(errors_m)) < 0.001
