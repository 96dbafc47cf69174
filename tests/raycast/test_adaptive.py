"""How many sub-rays a pulse gets."""

from dataclasses import replace

import numpy as np
import pytest
from raycast import lab

from vlp16emu.raycast.adaptive import RayBudget, enough, worth_of_ray_m
from vlp16emu.raycast.beam import ROUND


def budget(target_m, threshold=0.0):
    """An adaptive beam's, with a receiver of the usual noise."""
    return RayBudget(64, True, worth_of_ray_m(target_m), 1.0, threshold, threshold / 6, 0.0)


def asked(ranges_m, target_m=0.03, threshold=0.0):
    """Whether sub-rays on white surfaces at these ranges (inf: missed) are enough."""
    range_m = np.asarray(ranges_m, np.float32)
    energy = np.float32(1.0) / np.maximum(np.square(range_m), np.float32(1e-12))
    return enough(range_m, energy, budget(target_m, threshold), np.empty((2, len(range_m))))


def test_what_is_agreed_on_is_enough():
    """Eight sub-rays that miss, that meet one surface a centimetre deep, or begin in a wall need no more."""
    assert asked([np.inf] * 8)
    assert asked([0.0] * 8)
    assert asked(20 + 0.01 * np.arange(8))


def test_a_tie_is_not_enough_until_more_rays_would_not_pay():
    """Half here and half 5 m behind needs more than one round, and not more than 64 sub-rays at a target
    of 3 cm."""
    assert not asked([20.0] * 4 + [21.8] * 4)
    assert asked([20.0] * 32 + [21.8] * 32)
    assert not asked([20.0] * 32 + [21.8] * 32, target_m=0.015)


def finest_m(ranges_m):
    """Finest target that sub-rays on white surfaces at these ranges are enough for."""
    low_m, high_m = 1e-4, 0.2
    assert asked(ranges_m, high_m)
    for _ in range(30):
        middle_m = (low_m + high_m) / 2
        low_m, high_m = (low_m, middle_m) if asked(ranges_m, middle_m) else (middle_m, high_m)
    return high_m


def test_what_is_near_the_threshold_needs_more():
    """Two rays of eight whose echo is as strong as the threshold need another round.

    Eight of eight do not, nor two far above or below it, nor two where there is no threshold.
    """
    met = {rays: [40.0] * rays + [np.inf] * (8 - rays) for rays in (2, 8)}
    at_40_m = 40.0**-2
    assert not asked(met[2], 0.05, at_40_m * 2 / 8)
    assert asked(met[8], 0.05, at_40_m)
    for times in (0.2, 5.0):
        assert asked(met[2], 0.05, at_40_m * 2 / 8 * times)
    assert asked(met[2], 0.05)
    assert asked(met[2] * 8, 0.05, at_40_m * 2 / 8)


def test_a_deep_group_needs_more_than_a_shallow_one():
    """The error of one echo's range grows as the spread of its ranges, and falls as one over the root of the
    rays.

    Rays are worth what they buy: their number times the target to the power of 3.5.
    """
    depths_m = 0.1, 0.2, 0.4, 0.8
    worth = [finest_m(20 + depth_m * np.linspace(0, 1, 8)) ** 3.5 for depth_m in depths_m]
    assert np.array(worth) / worth[0] == pytest.approx([1, 2, 4, 8], rel=1e-3)
    again = finest_m(20 + 0.4 * np.tile(np.linspace(0, 1, 8), 4)) ** 3.5
    assert 32 * again / (8 * worth[2]) == pytest.approx(1 / 2, rel=1e-3)


def test_echoes_are_summed_within_the_resolution():
    """Three groups of eight: two of them within 1 m are one echo that leads the third, and 2 m apart none
    leads."""
    one, none = ([20.0] * 8 + [at_m] * 8 + [26.0] * 8 for at_m in (20.9, 22.0))
    assert finest_m(one) < finest_m(none)


def strongest_of(range_m, energy, span_m):
    """Energy, first and last of the strongest interval within a span, among sorted echoes; 0 without any."""
    found = [
        (energy[first : last + 1].sum(), -last, first)
        for first in range(len(range_m))
        for last in range(first, len(range_m))
        if range_m[last] - range_m[first] <= span_m
    ]
    total, last, first = max(found, default=(0.0, 1, 0))
    return total, first, -last


def asked_by_sorting(range_m, energy, of):
    """`enough` by the formulas of its module, with all echoes sorted; None if rounding decides."""
    n = len(range_m)
    order = np.argsort(range_m, kind="stable")
    range_m, energy = range_m[order].astype(float), energy[order].astype(float)
    range_m, energy = range_m[energy > 0], energy[energy > 0]
    if not len(range_m):
        return True
    strongest, first, last = strongest_of(range_m, energy, of.resolution_m / 2)
    variance = 0.27 * np.square(energy[first : last + 1]).sum() / n**2
    total = variance + of.amplitude_noise**2
    doubt = np.sqrt(variance / total) * np.exp(-((strongest / n - of.threshold) ** 2) / (2 * total))
    strongest, first, last = strongest_of(range_m, energy, of.resolution_m)
    own_m, own = range_m[first : last + 1], energy[first : last + 1]
    before = strongest_of(range_m[:first], energy[:first], of.resolution_m)[0]
    second = max(before, strongest_of(range_m[last + 1 :], energy[last + 1 :], of.resolution_m)[0])
    squares = np.square(own).sum()
    spread = (own / strongest * np.square(own_m - (own * own_m).sum() / strongest)).sum()
    lead = (strongest - second) ** 2 / (0.27 * (strongest + second) * squares / strongest)
    error_m = 0.5 * np.exp(-lead / 2) * of.resolution_m + np.sqrt(0.27 * spread * squares) / strongest
    worth_m = n * of.worth_m
    if abs(error_m / worth_m - 1) < 1e-5 or abs(doubt / 0.75 - 1) < 1e-5:
        return None
    return bool((of.threshold == 0 or doubt <= 0.75) and (error_m <= worth_m or worth_m >= 0.65))


@pytest.mark.parametrize("threshold", [0.0, 2e-4])
@pytest.mark.parametrize("rays", [8, 16])
def test_bounds_decide_as_sorted_echoes_do(threshold, rays):
    """One group or two, of any depth and of rays of any brightness, near the threshold and far from it, are
    enough where the formulas say so: bounds, which save the sorting, change no decision."""
    rng = np.random.default_rng(rays)
    found = []
    for _ in range(1500):
        depth_m = 10 ** rng.uniform(-3, 0.5)
        range_m = (
            40 + depth_m * rng.uniform(-0.5, 0.5, rays) + rng.choice([0.0, 2.0]) * (rng.random(rays) < 0.3)
        )
        range_m = np.where(rng.random(rays) < rng.choice([0.0, 0.4]), np.inf, range_m).astype(np.float32)
        cosine = (rng.uniform(0, 1, rays) ** rng.choice([0.1, 1, 6])).astype(np.float32)
        of = budget(rng.choice([0.01, 0.02, 0.03, 0.05]), threshold)
        energy = cosine / np.square(range_m)
        right = asked_by_sorting(range_m, energy, of)
        if right is not None:
            assert enough(range_m, energy, of, np.empty((2, rays))) == right
            found.append(right)
    assert len(found) > 1490
    assert 0.1 < np.mean(found) < 0.9


@pytest.fixture(scope="module")
def walls(workers):
    """A wall at 10 m to the left of y = 0, another at 13 m behind all of it."""
    return lab.opened(workers, *lab.upright((10.0, 0.0, 9.0, -9.0, 9.0), (13.0, -9.0, 9.0, -9.0, 9.0)))


STEP_Y_M = (np.arange(64) - 35.1) * 0.02
"""As far apart as pulses are at 10 m; the step is in the middle of an aligned eight, 2 mm beside pulse 35."""


def test_rays_go_where_the_footprint_is_split(walls):
    """Pulses that meet one wall have a round; the one at a step gets as many as it takes, none more at the
    default target of 5 cm."""
    usual, count = (
        walls.cast(lab.level_pulses(STEP_Y_M), np.zeros(1), 100.0, lab.beam("adaptive", **target)).count[:, 0]
        for target in ({}, {"target_m": 0.02})
    )
    assert (usual == ROUND).all()
    assert count[35] > ROUND
    assert (count % ROUND == 0).all()
    assert (np.delete(count, [34, 35, 36]) == ROUND).all()


def test_a_pulse_beside_an_outline_has_more_rays(workers):
    """Before nothing, a surface ends in pulses with little of it, whose share 24 rays and more measure;
    pulses away from it, and those next to one that is too faint for its edge to be seen, have a round."""
    ends = lab.opened(workers, *lab.upright((10.0, 0.0, 9.0, -9.0, 9.0)))
    y_m = STEP_Y_M + 0.006
    bright, faint = (replace(lab.beam("adaptive"), threshold=light) for light in (1e-5, 1.0))
    hits = ends.cast(lab.level_pulses(y_m), np.zeros(1), 100.0, bright)
    count = hits.count[:, 0].astype(int)
    met = np.array([np.isfinite(of).mean() for of in np.split(hits.range_m, np.cumsum(count)[:-1])])
    beside = np.nonzero(count > ROUND)[0]
    assert set(beside) <= {33, 34, 35, 36}
    assert (count[beside] >= 24).all()
    assert ((met[beside] > 0.0) & (met[beside] < 0.2)).any()
    assert (ends.cast(lab.level_pulses(y_m), np.zeros(1), 100.0, faint).count == ROUND).all()


def test_pulses_at_the_outline_of_a_near_thing_have_all_rays(workers):
    """Before a wall at 4 m a plate at 0.3 m ends: pulses that meet both have all rays, and so have those of
    their eight that seem to meet the plate alone; other eights, and pulses that nothing hides, have a round.
    Without a least range they have fewer."""
    ends = lab.opened(workers, *lab.upright((0.3, 0.0, 9.0, -9.0, 9.0), (4.0, -9.0, 9.0, -9.0, 9.0)))
    pulses = lab.level_pulses((np.arange(64) - 31.5) * 0.001)
    blanked = replace(lab.beam("adaptive"), threshold=1e-5, blank_m=0.5)
    hits = ends.cast(pulses, np.zeros(1), 100.0, blanked)
    count = hits.count[:, 0].astype(int)
    blank = np.array([(of[:ROUND] < 0.5).sum() for of in np.split(hits.range_m, np.cumsum(count)[:-1])])
    at_outline = (blank > 0) & (blank.reshape(8, 8).sum(axis=1) < 64).repeat(8)
    assert 8 <= at_outline.sum() <= 24
    assert (count[at_outline] == 32).all()
    assert (count[~at_outline] < 32).all()
    assert (count[(blank == 0) | (blank == ROUND)] == ROUND).sum() > 32
    usual = ends.cast(pulses, np.zeros(1), 100.0, lab.beam("adaptive")).count[:, 0]
    assert (usual[at_outline] < 32).any()


def test_eights_do_not_depend_on_others(walls):
    """Eight aligned sequences beside a step have the rays and hits that they have among others, bit by
    bit."""
    fine = lab.beam("adaptive", target_m=0.02)
    among = walls.cast(lab.level_pulses(STEP_Y_M), np.zeros(1), 100.0, fine)
    y_m = np.where(np.arange(64) // 8 == 4, STEP_Y_M, 5.0)
    alone = walls.cast(lab.level_pulses(y_m), np.zeros(1), 100.0, fine)
    assert (among.count[32:40] == alone.count[32:40]).all()
    assert among.count[32:40].sum() > 8 * ROUND
    for name in ("range_m", "surface", "cos_incidence"):
        own = []
        for hits in (among, alone):
            begin = int(hits.count[:32].sum())
            own.append(getattr(hits, name)[begin : begin + int(hits.count[32:40].sum())])
        assert own[0].tobytes() == own[1].tobytes()


def test_a_finer_target_takes_more_rays_and_no_target_more_than_it_may(walls):
    """Rays in all grow as the target falls, up to the most that are allowed."""
    firings = lab.level_pulses(np.full(80, 0.001))
    firings.origin_m[::2, 0, 1] = -0.002
    used = [
        int(walls.cast(firings, np.zeros(1), 100.0, lab.beam("adaptive", rays=20, target_m=t)).count.sum())
        for t in (0.2, 0.025, 0.01)
    ]
    assert 80 * ROUND == used[0] < used[1] < used[2] <= 80 * 20


def test_grazing_light_is_followed_by_sub_rays(workers):
    """On a smooth wall a round is enough; met at a grazing angle its footprint is deep, and more are asked
    for."""
    window, shape = lab.upright((10.0, -9.0, 9.0, -9.0, 9.0))
    counts = {}
    for degrees in (0.0, 60.0, 89.7):
        turn = np.radians(degrees)
        placed = window.world_T_shape.copy()
        placed[0, :, :3] = [[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
        placed[0, :, 3] = [10.0 - 10 * np.cos(turn), 10 * np.sin(turn), 0]
        scene = lab.opened(workers, replace(window, world_T_shape=placed), shape)
        firings = lab.level_pulses(np.arange(-8, 8) * 0.02)
        beam = lab.beam("adaptive", target_m=0.01)
        counts[degrees] = int(scene.cast(firings, np.zeros(1), 100.0, beam).count[8, 0])
    assert counts[0.0] == counts[60.0] == ROUND
    assert counts[89.7] > ROUND
