"""What moves: instances at the time of each pulse, against the slow twin and against themselves."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from raycast import lab
from raycast.reference import ReferenceScene, frozen

from vlp16emu.errors import RunError
from vlp16emu.types import SURFACE, Sway, Window

STEP_NS = 100_000  # so short that a test's few pulses see several knots


def swaying(*, knots=40, lean=0.1, seed=3):
    """Window of soups of which two of three move, and the span of its pulses."""
    window, firings = lab.placed(30), lab.pulses(64)
    moving = np.flatnonzero(np.arange(30) % 3)
    shear = np.random.default_rng(seed).uniform(-lean, lean, (knots, len(moving), 2))
    foot_z_m = window.world_T_shape[moving, 2, 3] - 8.0
    start_ns = int(firings.t_ns.min()) - STEP_NS // 3
    return replace(window, sway=lab.straight(start_ns, STEP_NS, moving, foot_z_m, shear)), firings


def assert_meet_alike(ours, other):
    """Both casts meet the same surfaces, at the same ranges and incidence within rounding of a moving
    edge."""
    same = ours.surface == other.surface
    assert same.mean() > 0.995
    hit = np.isfinite(ours.range_m) & same
    assert hit.mean() > 0.5
    assert np.quantile(np.abs(ours.range_m[hit] - other.range_m[hit]), 0.99) < 2e-5
    assert np.quantile(np.abs(ours.cos_incidence[hit] - other.cos_incidence[hit]), 0.99) < 1e-4


@pytest.mark.parametrize("model", ["none", "fixed", "adaptive"])
def test_each_pulse_meets_what_moves_where_it_is_at_its_time(workers, model):
    """Ranges, surfaces and incidence equal brute force in float64, which writes the window out for every
    instant."""
    window, _ = swaying()
    narrow = {"divergence_mrad": (1.0, 0.5)}  # its neighbours are too far apart to be judged by each other
    beam = lab.beam(model, rays=4 if model == "fixed" else 8, **narrow)
    scenes = lab.opened(workers, window), ReferenceScene(window, lab.soup)
    fast, slow = (one.cast(lab.pulses(8, every=4), lab.NEAR_M[::4], lab.FAR_M, beam) for one in scenes)
    assert (fast.count == slow.count).all()
    assert_meet_alike(fast, slow)


def test_a_moving_window_stands_still_at_an_instant(workers):
    """Pulses of one instant, within the span, before it and after it, meet the window that is frozen
    there."""
    window, firings = swaying()
    scene = lab.opened(workers, window)
    for t_ns in (window.sway.start_ns + STEP_NS * 9 // 4, 0, 2**62):
        at_once = replace(firings, t_ns=np.full_like(firings.t_ns, t_ns))
        moving = scene.cast(at_once, lab.NEAR_M, lab.FAR_M)
        assert_meet_alike(
            moving, lab.opened(workers, frozen(window, t_ns)).cast(at_once, lab.NEAR_M, lab.FAR_M)
        )


def test_a_shear_moves_points_level_by_their_height_over_the_foot():
    """Half-way between knots of shear 0 and 0.4 a point 5 m over the foot is 1 m aside; the foot is where
    it was."""
    still = lab.placed(1)
    foot_z_m = float(lab.UTM_M[2]) - 4.0
    shear = np.array([[[0.0, 0.0]], [[0.4, -0.2]]])
    sway = lab.straight(1000, 100, np.zeros(1, np.int64), np.array([foot_z_m]), shear)
    moved = frozen(replace(still, sway=sway), 1050)
    to_shape = np.linalg.inv(still.world_T_shape[0, :, :3])
    for over_foot_m in (0.0, 5.0):
        point_m = np.array([*lab.UTM_M[:2], foot_z_m + over_foot_m])
        own = to_shape @ (point_m - still.world_T_shape[0, :, 3])
        went_m = moved.world_T_shape[0, :, :3] @ own + moved.world_T_shape[0, :, 3] - point_m
        assert went_m == pytest.approx(np.array([0.2, -0.1, 0.0]) * over_foot_m, abs=1e-9)


def test_pieces_move_as_chords_of_the_curve(workers):
    """A mast of straight pipes on each other, bent as a cylinder under an even load (the closed form of its
    beam): a level ray meets each height where the form has it, less the chord's own error."""
    edges_m = np.linspace(0.0, 16.0, 33)
    share = np.arange(101) / 100
    curve = (share**4 - 4 * share**3 + 6 * share**2) / 3
    shapes = [lab.upright((0.0, -5.0, 5.0, low, high))[1](0) for low, high in pairwise(edges_m)]
    count = len(shapes)
    window = Window(
        np.zeros(3),
        tuple(range(count)),
        np.arange(count, dtype="i4"),
        np.repeat(np.eye(3, 4)[None], count, axis=0),
        np.arange(count, dtype="u4"),
        np.zeros(count, SURFACE),
    )
    moves = np.arange(count), np.zeros(count), np.full(count, 16.0), np.tile(curve, (count, 1))
    window = replace(window, sway=Sway(0, 100, *moves, np.tile([[[0.0, 0.0]], [[2.0, 0.5]]], (1, count, 1))))
    heights_m = np.linspace(0.02, 15.98, 64)
    origin_m = np.column_stack([np.full(64, -8.0), np.zeros(64), heights_m])
    firings = replace(lab.rays(origin_m, np.tile([1.0, 0.0, 0.0], (64, 1))), t_ns=np.full((64, 1), 50))
    hits = lab.opened(workers, window, lambda key: shapes[key]).cast(firings, np.zeros(1), 60.0)
    moved_m = hits.range_m - 8.0
    x = heights_m / 16.0
    form_m = (x**4 - 4 * x**3 + 6 * x**2) / 3  # half of the movement of 2 m
    sharpest = 4.0 / 16.0**2
    assert np.abs(moved_m - form_m).max() < sharpest * 0.5**2 / 8 + 1e-4
    assert moved_m[-1] > 0.98


def test_more_knots_than_embree_takes_are_refused(workers):
    """A window that lasts too long is refused by the number of its knots."""
    long, _ = swaying(knots=130)
    with pytest.raises(RunError, match="wind: found 130 knots in a window, Embree takes 129"):
        lab.opened(workers, long)
