"""How many sub-rays a pulse gets."""

import math

import numpy as np
import pytest

from vlp16emu.raycast.adaptive import enough, first_round
from vlp16emu.raycast.embree import EmbreeCaster
from vlp16emu.raycast.footprint import ROUND
from vlp16emu.types import NO_SURFACE, Semantic

WHITE = np.ones(1, np.float32)


def asked(ranges_m, target_m=0.05):
    """Whether sub-rays on white surfaces at these ranges (inf: missed) are enough."""
    range_m = np.asarray(ranges_m, np.float32)
    surface = np.where(np.isfinite(range_m), 0, NO_SURFACE).astype(np.uint32)
    room = np.empty((2, len(range_m)))
    return enough(range_m, surface, np.ones_like(range_m), WHITE, target_m, 1.0, room)


def test_what_is_agreed_on_is_enough():
    """Eight sub-rays that miss, or that meet one surface a centimetre deep, need no more."""
    assert asked([np.inf] * 8)
    assert asked(20 + 0.01 * np.arange(8))


def test_a_tie_is_not_enough_until_more_rays_would_not_pay():
    """Half here and half 5 m behind needs more than one round, and not more than 64 sub-rays at the usual target."""
    assert not asked([20.0] * 4 + [21.8] * 4)
    assert asked([20.0] * 32 + [21.8] * 32)
    assert not asked([20.0] * 32 + [21.8] * 32, target_m=0.02)


def test_a_deep_group_needs_more_than_a_shallow_one():
    """The wider the ranges of one echo are spread, the finer a target they fail."""
    for depth_m in (0.1, 0.4, 0.9):
        ranges_m = 20 + depth_m * np.linspace(0, 1, 8)
        doubt_m = 0.5 * math.exp(-8 / 0.27 / 2)  # eight of eight agree
        finest_m = ((math.sqrt(0.27 * ranges_m.var() / 8) + doubt_m) / 8 / 1075) ** (1 / 3.5)
        assert not asked(ranges_m, finest_m * 0.9)
        assert asked(ranges_m, finest_m * 1.1)


def by_hand(range_m, energy, target_m, resolution_m):
    """Do the same in the obvious way: every stretch that begins at an echo, and the best one apart from it."""
    n, met = len(range_m), energy > 0
    r, e = range_m[met], energy[met]
    if not met.any():
        return True

    def best(r, e):
        sums = [e[(r >= a) & (r - a <= resolution_m)].sum() for a in r]
        return r[int(np.argmax(sums))], max(sums)

    start, first = best(r, e)
    inside = (r >= start) & (r - start <= resolution_m)
    rest = [best(r[side], e[side])[1] for side in (r < start, r > r[inside].max()) if side.any()]
    second = max(rest, default=0.0)
    weight = e[inside] / first
    mean_m = (weight * r[inside]).sum()
    error_m = math.sqrt(0.27 * (weight * (r[inside] - mean_m) ** 2).sum() * (weight**2).sum())
    lead = (first - second) ** 2 / (0.27 * (first + second) * (weight**2).sum() * first)
    return 0.5 * math.exp(-lead / 2) * resolution_m + error_m <= n * 1075.0 * target_m**3.5


def test_the_rule_is_that_of_its_slow_twin():
    """Over random echoes of random strength, the kernel and the obvious way agree."""
    rng = np.random.default_rng(3)
    verdicts = []
    for _ in range(800):
        n = int(rng.choice([8, 16, 32]))
        range_m = (20 + rng.choice([0.1, 1.0, 4.0]) * rng.random(n)).astype(np.float32)
        surface = rng.integers(0, 50, n).astype(np.uint32)
        surface[rng.random(n) < 0.2] = NO_SURFACE
        cosine, reflectance = rng.random(n).astype(np.float32), rng.uniform(0.2, 0.8, 50).astype(np.float32)
        hit = surface != NO_SURFACE
        energy = (
            np.where(hit, reflectance[np.where(hit, surface, 0)] * cosine, 0) / range_m.astype(float) ** 2
        )
        target_m = float(rng.choice([0.02, 0.05, 0.08]))
        ours = enough(range_m, surface, cosine, reflectance, target_m, 1.0, np.empty((2, n)))
        assert ours == by_hand(range_m.astype(float), energy, target_m, 1.0)
        verdicts.append(ours)
    assert 0.2 < np.mean(verdicts) < 0.8


@pytest.fixture(scope="module")
def walls(lab, workers):
    """A wall at 10 m to the left of y = 0, another at 13 m behind all of it."""
    window, shape = lab.upright((10.0, 0.0, 9.0, -9.0, 9.0), (13.0, -9.0, 9.0, -9.0, 9.0))
    return EmbreeCaster(shape, workers).open(window)


def test_rays_go_where_the_footprint_is_split(lab, walls):
    """At a step only the pulses beside it get sub-rays; the first of every pulse is the ray along its middle, bit by bit."""
    firings = lab.level_pulses(np.arange(-32, 32) * 0.035 + 0.01)
    line = walls.cast(firings, np.zeros(1), 100.0)
    hits = walls.cast(firings, np.zeros(1), 100.0, lab.beam("adaptive"))
    one = hits.count[:, 0] == 1
    assert (np.flatnonzero(~one) == [31, 32]).all()
    assert (hits.count[~one] >= ROUND).all()
    first = np.cumsum(hits.count) - hits.count.reshape(-1)
    assert (hits.range_m[first] == line.range_m.reshape(-1)).all()


@pytest.mark.parametrize("reach_m", [20.0, 100.0])
def test_among_plants_pulses_are_judged_to_40_m(lab, workers, reach_m):
    """A wall gets one ray per pulse, but a round beyond 40 m where a shrub stands; its first is the middle, bit by bit."""
    firings, beam = lab.level_pulses(np.arange(-16, 16) * 0.035), lab.beam("adaptive")
    for semantic, wall_m, most in (
        (Semantic.OTHER, 45.0, 1),
        (Semantic.SHRUB, 39.0, 1),
        (Semantic.SHRUB, 45.0, 8),
    ):
        window, shape = lab.upright((wall_m, -9.0, 9.0, -9.0, 9.0))
        window.surfaces["semantic"] = semantic
        scene = EmbreeCaster(shape, workers).open(window)
        line = scene.cast(firings, np.zeros(1), reach_m)
        hits = scene.cast(firings, np.zeros(1), reach_m, beam)
        if wall_m < reach_m:
            assert (hits.count == most).all()
            assert (hits.range_m[::most] == line.range_m).all()
        else:
            assert np.isinf(hits.range_m).all()


def test_neighbours_are_those_of_the_block_and_of_the_laser_that_turns(lab):
    """How far neighbours are follows from each block's own pace, and not from a laser that looks along the axis."""
    paces_rad, k = (0.0035, 0.00055), 32
    firings = lab.level_pulses(np.zeros(2 * k), lasers=2)
    for block, pace_rad in enumerate(paces_rad):
        angle = np.arange(k) * pace_rad
        firings.direction[block * k : (block + 1) * k, 1] = np.stack(
            [np.cos(angle), np.sin(angle), 0 * angle], axis=1
        )
    firings.direction[:, 0] = [0.0, 0.0, 1.0]
    firings.direction[::2, 0, 0] = 1e-5
    range_m = np.full((2 * k, 2), 10.0, np.float32)
    for block in range(2):  # a step in the middle of each
        range_m[block * k + k // 2 : (block + 1) * k] = 12.0
    both = first_round(firings, range_m, np.ones_like(range_m), lab.beam("adaptive"), k)
    for block, within in enumerate((1, 3)):  # half of 3 mrad, in steps
        assert (
            np.flatnonzero(both[block * k : (block + 1) * k, 1] > 1) == np.arange(16 - within, 16 + within)
        ).all()


def test_what_lies_in_the_lens_is_judged_too():
    """A sensor that stands in a wall has ranges of 0, which are an answer like any other."""
    assert asked([0.0] * 8)


def test_a_finer_target_takes_more_rays_and_no_target_more_than_it_may(lab, walls):
    """Rays in all grow as the target falls, up to the most that are allowed."""
    firings = lab.level_pulses(np.full(80, 0.001))
    firings.origin_m[::2, 0, 1] = -0.002
    used = [
        int(walls.cast(firings, np.zeros(1), 100.0, lab.beam("adaptive", rays=20, target_m=t)).count.sum())
        for t in (0.2, 0.05, 0.01)
    ]
    assert 80 * ROUND == used[0] < used[1] < used[2] <= 80 * 20


def test_grazing_light_is_followed_by_sub_rays(lab, workers):
    """On a floor met at a grazing angle the footprint is deep, and one ray would hide it."""
    window, shape = lab.upright((10.0, -9.0, 9.0, -9.0, 9.0))
    counts = {}
    for degrees in (0.0, 60.0, 89.7):
        turn = np.radians(degrees)
        placed = window.world_T_shape.copy()
        placed[0, :, :3] = [
            [np.cos(turn), np.sin(turn), 0],
            [-np.sin(turn), np.cos(turn), 0],
            [0, 0, 1],
        ]
        placed[0, :, 3] = [10.0 - 10 * np.cos(turn), 10 * np.sin(turn), 0]
        turned = type(window)(
            window.origin_m, window.shapes, window.shape, placed, window.first_surface, window.surfaces
        )
        scene = EmbreeCaster(shape, workers).open(turned)
        firings = lab.level_pulses(np.arange(-8, 8) * 1e-4)
        counts[degrees] = int(scene.cast(firings, np.zeros(1), 100.0, lab.beam("adaptive")).count[8, 0])
    assert counts[0.0] == counts[60.0] == 1
    assert counts[89.7] > 1
