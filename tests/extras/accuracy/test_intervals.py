"""Confidence intervals of the errors of a sample."""

import numpy as np
import pytest

from vlp16emu.extras.accuracy.audit import Comparison, errors_of
from vlp16emu.extras.accuracy.intervals import intervals_of

PULSES = 128


def groups_of(draw, number, *, lost=0.02, sigma=1.0):
    """Groups of pulses whose errors are lognormal with a scale of their own for each group."""
    found = []
    for _ in range(number):
        missing = int(draw.binomial(PULSES, lost))
        error_m = 0.01 * np.exp(sigma * draw.normal()) * draw.normal(size=PULSES - missing)
        found.append(
            Comparison(PULSES, PULSES, missing, 0, 1, 2, error_m, draw.normal(size=PULSES - missing))
        )
    return found


def joined(groups):
    """All groups as one comparison."""
    counts = (sum(getattr(group, name) for group in groups) for name in Comparison._fields[:6])
    return Comparison(
        *counts,
        *(np.concatenate([getattr(group, name) for group in groups]) for name in Comparison._fields[6:]),
    )


def test_intervals_contain_the_truth_as_often_as_they_say():
    """For each error, at least 88 % of the intervals of 150 heavy-tailed samples of 32 groups contain the
    error of all."""
    draw = np.random.default_rng(4)
    everything = groups_of(draw, 2000, sigma=0.6)
    truth = errors_of(joined(everything), 1.0)
    kept = dict.fromkeys(
        ("range_rmse_m", "range_bias_m", "range_p95_m", "mean_error_m", "reflectivity_rmse", "lost"), 0
    )
    for _ in range(150):
        found = intervals_of([everything[i] for i in draw.integers(len(everything), size=32)], 1.0)
        for name in kept:
            low, high = found[name] or (0.0, np.inf)
            kept[name] += low <= getattr(truth, name) <= high
    assert {name: number for name, number in kept.items() if number < 0.88 * 150} == {}


def test_four_times_the_pulses_halve_an_interval():
    """The length of intervals of the same errors falls with the root of the number of groups."""
    groups = groups_of(np.random.default_rng(5), 64, sigma=0.3)
    few, many = (intervals_of(groups * times, 1.0) for times in (1, 4))
    for name in ("range_rmse_m", "range_bias_m", "lost", "mean_error_m"):
        assert np.ptp(many[name]) == pytest.approx(np.ptp(few[name]) / 2, rel=0.15)


def test_an_error_that_was_not_seen_has_an_upper_limit():
    """With none of n pulses lost, the share is at most about 3.7 / n (the exact binomial limit), and not
    0."""
    low, high = intervals_of(groups_of(np.random.default_rng(6), 64, lost=0.0), 1.0)["invented"]
    assert low == 0.0
    assert high == pytest.approx(3.69 / (64 * PULSES), rel=0.1)


def test_too_few_groups_and_too_heavy_tails_have_none():
    """From seven groups nothing is concluded; and if one group has nearly all errors, not the order of
    magnitude."""
    groups = groups_of(np.random.default_rng(7), 8, sigma=0.3)
    assert set(intervals_of(groups[:7], 1.0).values()) == {None}
    assert intervals_of(groups, 1.0)["range_rmse_m"] is not None
    groups[0] = groups[0]._replace(error_m=100 * groups[0].error_m)
    assert intervals_of(groups, 1.0)["range_rmse_m"] is None
