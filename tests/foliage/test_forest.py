"""A grown forest through the caster: windows that overlap agree, and far hits show what stands there."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial import cKDTree
from woods import LINES

from vlp16emu.engine import assemble
from vlp16emu.raycast.caster import caster
from vlp16emu.scenario import load
from vlp16emu.types import NO_SURFACE, PlantPart

pytestmark = pytest.mark.usefixtures("kept_woods")

STATIC = "motion={kind='static', x_m=10.0, y_m=3.0, height_m=1.3}"
REACH_M = 27.0


@pytest.fixture(scope="module")
def forest():
    """Parts of a thin birch stand with a sensor that stands still, without noise."""
    settings = [STATIC, *LINES, f"sensor.max_range_m={REACH_M}"]
    return assemble(load("birch_walk", settings, ideal=True))


@pytest.fixture(scope="module")
def stood(forest, workers):
    """Firings of the sensor, its window and its scene."""
    unit = forest.units[0]
    firings = unit.head.aim(0, 960, unit.motion.poses_at, beam_axis=True)
    window = forest.world.window(firings.origin_m[:1, 0])
    return firings, window, caster(forest.world, workers).open(window)


def met(window, hits):
    """Instance of each surface, and its part; 0 and 255 where nothing was met."""
    miss = hits.surface == NO_SURFACE
    row = window.surfaces[np.where(miss, 0, hits.surface)]
    return np.where(miss, 0, row["instance"]), np.where(miss, 255, row["part"])


def test_a_pulse_meets_the_same_in_the_windows_that_hold_it(forest, stood, workers):
    """From windows 4 m apart, of two casters, what is met up to 27 m is the same thing at the same range
    to 0.1 mm."""
    unit, (firings, _, _) = forest.units[0], stood
    at_m = firings.origin_m[:1, 0]
    tracks = [np.concatenate([at_m, at_m + [[dx, 1.0, 0.0]]]) for dx in (8.0, -8.0)]
    windows = [forest.world.window(track) for track in tracks]
    assert np.linalg.norm(windows[0].origin_m - windows[1].origin_m) > 4
    hits = [
        caster(forest.world, workers).open(w).cast(firings, unit.head.beams.near_m, REACH_M) for w in windows
    ]
    (ours, _), (other, part) = (met(*pair) for pair in zip(windows, hits, strict=True))
    hit = np.isfinite(hits[0].range_m) & np.isfinite(hits[1].range_m)
    same = (ours == other) & (np.isfinite(hits[0].range_m) == np.isfinite(hits[1].range_m))
    same[hit] &= np.abs(hits[0].range_m[hit] - hits[1].range_m[hit]) < 1e-4
    beyond = hit & (hits[0].range_m > forest.world.near_m)
    assert beyond.sum() > 300
    assert (part[beyond] == PlantPart.LEAF).sum() > 100
    # What differs is met within rounding of an edge: float32 has another place for it in each window.
    assert same.mean() > 0.998
    assert same[beyond].mean() > 0.995


def test_a_far_hit_shows_what_stands_there(forest, stood):
    """Of hits beyond `near_m` a face that shows their own surface is within 1 m; of surfaces dealt anew it
    mostly is not."""
    world, (firings, window, scene) = forest.world, stood
    hits = scene.cast(firings, forest.units[0].head.beams.near_m, REACH_M)
    far = np.flatnonzero((hits.range_m > world.near_m) & np.isfinite(hits.range_m))[::10]
    place_m = firings.origin_m.reshape(-1, 3) + hits.range_m[:, None] * firings.direction.reshape(-1, 3)
    first, shape = window.first_surface.astype(np.int64), cache(world.shape)

    @cache
    def shown(surface):
        """Corners and middles of all faces of a surface, in the world."""
        points, begin = [], first[first <= surface].max()
        for placement in np.flatnonzero(first == begin):
            mesh = shape(window.shapes[window.shape[placement]])[surface - begin]
            corners = mesh.vertices_m[mesh.faces].astype(np.float64)
            middles = (corners + np.roll(corners, 1, axis=1)) / 2
            around = np.concatenate([corners.reshape(-1, 3), middles.reshape(-1, 3), corners.mean(axis=1)])
            world_T_shape = window.world_T_shape[placement]
            points.append(around @ world_T_shape[:, :3].T + world_T_shape[:, 3])
        return cKDTree(np.concatenate(points), balanced_tree=False)

    def off_m(surfaces):
        pairs = zip(surfaces.tolist(), place_m[far], strict=True)
        return np.array([shown(surface).query(place)[0] for surface, place in pairs])

    assert len(far) > 50
    assert off_m(hits.surface[far]).max() <= 1.0
    assert (off_m(hits.surface[far][::-1]) > 1.0).mean() > 0.5
