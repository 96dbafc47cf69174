"""Errors, how sure they are, and what follows from them."""

import io
from dataclasses import replace

import numpy as np
import pytest

from vlp16emu.extras.accuracy.audit import Detections, Tally, compare, errors_of
from vlp16emu.extras.accuracy.sweep import Accuracy, Kind, Row, choices, draw_accuracy, front, joined

RESOLUTION_M = 1.0


def detections_of(*distance_m, reflectivity=50):
    """One pulse per given distance or (strongest, last)."""
    rows = [(d, d) if np.isscalar(d) else d for d in distance_m]
    distance = np.array([(*row, 0.0) for row in rows], np.float32)
    return Detections(distance, np.where(distance > 0, reflectivity, 0).astype(np.uint8))


def errors(answer, got):
    return errors_of(compare(answer, got, RESOLUTION_M), RESOLUTION_M)


def row(name, us, error_m, kind=Kind.FIXED, in_use=False):
    some = replace(errors(detections_of(10.0), detections_of(10.1)), mean_error_m=error_m, range_rmse_m=error_m)
    return Row(kind, name, in_use, some, us, 0.1 * us, 1.0)


def test_each_pulse_counts_in_one_way():
    """Right, lost, invented, of another echo, and nothing in both: each is counted as what it is."""
    answer = detections_of(10.0, 10.0, 0.0, 10.0, 0.0)
    found = errors(answer, detections_of(10.3, 0.0, 10.0, 12.0, 0.0))
    assert (found.pulses, found.returns) == (5, 3)
    assert (found.lost, found.invented, found.wrong_strongest) == (1 / 3, 1 / 3, 1 / 3)
    assert found.range_rmse_m == pytest.approx(0.3, rel=1e-5)
    assert found.mean_error_m == pytest.approx((0.3 + 2 * RESOLUTION_M) / 3, rel=1e-5)


def test_statistics_are_those_of_the_right_echoes():
    """RMSE, bias and 95 % are those of known errors, and reflectivity is judged alike."""
    rng = np.random.default_rng(1)
    off_m = rng.normal(0.02, 0.05, 20_000).clip(-0.4, 0.4)
    found = errors(detections_of(*[50.0] * 20_000), detections_of(*(50.0 + off_m), reflectivity=53))
    assert found.range_bias_m == pytest.approx(off_m.mean(), abs=1e-5)
    assert found.range_rmse_m == pytest.approx(np.sqrt((off_m**2).mean()), rel=1e-3)
    assert found.range_p95_m == pytest.approx(np.quantile(np.abs(off_m), 0.95), rel=1e-3)
    assert found.reflectivity_rmse == 3.0


def test_last_returns_and_nothing_are_judged_as_such():
    """The last return is judged by itself; where the answer has no return, errors are NaN, not zero."""
    found = errors(detections_of((10.0, 20.0), (10.0, 20.0)), detections_of((10.0, 10.0), (20.0, 20.0)))
    assert (found.wrong_strongest, found.wrong_last) == (0.5, 0.5)
    found = errors(detections_of(0.0, 0.0), detections_of(0.0, 5.0))
    assert np.isnan([found.range_rmse_m, found.mean_error_m, found.lost, found.invented]).all()


@pytest.mark.parametrize(("sigma", "least"), [(0.5, 0.90), (0.8, 0.86)])
def test_the_interval_holds_the_true_rmse_as_often_as_it_says(sigma, least):
    """Of errors alike within clusters some 95 % of intervals hold the RMSE, 92 % where tails are heavy; here 3 sigma less."""
    rng = np.random.default_rng(2)
    held, trials, size, clusters = 0, 100, 12, 60
    true_m = np.sqrt(np.exp(2 * -4.0 + 2 * sigma**2) / 2)  # E[x^2] of lognormal scale times half of uniform's
    answer = detections_of(*[30.0] * size)
    for _ in range(trials):
        tally = Tally()
        for scale_m in np.exp(rng.normal(-4.0, sigma, clusters)):
            off_m = scale_m * rng.choice([0.0, 1.0], size)
            tally.add(compare(answer, detections_of(*(30.0 + off_m)), RESOLUTION_M))
        interval = tally.range_rmse_interval_m
        held += interval[0] <= true_m <= interval[1]
    assert least <= held / trials <= 0.99


def test_a_tally_says_what_errors_of_all_pulses_say():
    """Clusters summed up one by one, in any order, give RMSE and shares of all pulses at once."""
    rng = np.random.default_rng(3)
    answers = [detections_of(*rng.choice([0.0, 20.0, 40.0], 16)) for _ in range(30)]
    off_m = [rng.choice([-20.0, 0.0, 0.1, 0.2], 16) for _ in answers]
    tolds = [detections_of(*np.maximum(a.distance_m[:, 0] + b, 0.0)) for a, b in zip(answers, off_m, strict=True)]
    tally, turned = Tally(), Tally()
    clusters = [compare(answer, got, RESOLUTION_M) for answer, got in zip(answers, tolds, strict=True)]
    for one, other in zip(clusters, clusters[::-1], strict=True):
        tally.add(one)
        turned.add(other)
    assert tally == turned
    found = errors(joined(answers), joined(tolds))
    assert tally.range_rmse_m == pytest.approx(found.range_rmse_m, rel=1e-4)
    counts = tally.lost, tally.invented, tally.wrong_strongest
    assert np.allclose(np.divide(counts, tally.returns), (found.lost, found.invented, found.wrong_strongest))
    assert min(counts) > 0


def test_of_too_few_clusters_nothing_is_said():
    """Seven clusters with errors are not enough for an interval."""
    tally, right, wrong = Tally(), detections_of(30.0, 30.0), detections_of(30.1, 30.0)
    for got in [wrong] * 7 + [right] * 13:
        tally.add(compare(right, got, RESOLUTION_M))
    assert tally.range_rmse_interval_m is None
    tally.add(compare(right, wrong, RESOLUTION_M))
    assert tally.range_rmse_interval_m is not None


def test_clusters_that_err_alike_leave_no_doubt():
    """Where all clusters have the same mean square the interval is that square's root alone, however it is rounded."""
    for off_m in np.arange(1, 33) / 64:
        tally, answer, got = Tally(), detections_of(*[30.0] * 7), detections_of(*[30.0 + off_m] * 7)
        for _ in range(8):
            tally.add(compare(answer, got, RESOLUTION_M))
        assert tally.range_rmse_m == pytest.approx(off_m, abs=1e-6), off_m
        interval = tally.range_rmse_interval_m
        assert interval == pytest.approx((off_m, off_m), abs=1e-6), off_m


def test_the_front_keeps_what_nothing_beats():
    """A setting that another one beats in both error and run time is not on the front, whatever the order; nor is a beam error."""
    errant = row("errant", 0.5, 0.02, Kind.BEAM_ERROR)
    rows = [errant, row("c", 4.0, 0.01), row("a", 1.0, 0.1), row("worse", 5.0, 0.02), row("b", 2.0, 0.05)]
    assert [one.name for one in front(rows)] == ["a", "b", "c"]


def test_choices_name_the_quickest_that_is_good_enough():
    """For each wanted error the quickest setting within it is named, once, with the least error it is good for."""
    rows = [row("one", 1.0, 0.15), row("eight", 4.0, 0.06), row("many", 20.0, 0.009)]
    assert choices(rows) == {"one": 0.2, "eight": 0.1, "many": 0.01}


def test_the_picture_is_drawn():
    """A picture is a PNG below 150 kB that has every setting in it, also where an error is nothing."""
    pytest.importorskip("matplotlib")
    rows = (row("model=none", 1.0, 0.2, Kind.ONE_RAY, True), *(row(f"rays={n}", n, 0.5 / n) for n in (4, 8, 16)))
    drawn = io.BytesIO()
    draw_accuracy(drawn, Accuracy("wood", 1, 4096, 1e-4, rows, ()))
    assert drawn.getvalue()[:4] == b"\x89PNG"
    assert len(drawn.getvalue()) < 150_000
