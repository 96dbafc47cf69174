"""Accuracy measured on small scenes: settings, pulses, errors, how sure they are, and the audit beside a
run."""

import hashlib
import math
from dataclasses import replace

import numpy as np
import pytest

from vlp16emu.engine import Engine
from vlp16emu.engine.windows import Batching
from vlp16emu.errors import RunError
from vlp16emu.extras.accuracy.audit import Audit, Detections, Tally, apart_m, compare, errors_of
from vlp16emu.extras.accuracy.sweep import (
    GROUP,
    Bench,
    Row,
    beam_settings,
    choices,
    departures,
    draw_groups,
    is_two,
    join_detections,
    measure_accuracy,
    measure_foliage,
)
from vlp16emu.scenario import load

pytestmark = pytest.mark.usefixtures("kept_woods")


def measured(*settings, pulses=128):
    return measure_accuracy(load("static_bench", settings), "hall", pulses=pulses)


def test_errors_are_the_same_each_time():
    """Two measurements differ in run time alone, and one of their rows is the setting in use."""
    first, second = (measured("beam.model='adaptive'") for _ in range(2))
    assert [row.errors for row in first.rows] == [row.errors for row in second.rows]
    assert first.answer_rmse_m == second.answer_rmse_m
    assert all(row.us_per_pulse > 0 for row in first.rows)
    assert [row.name for row in first.rows if row.in_use] == ["beam.model=adaptive beam.target_m=0.05"]


def test_sub_rays_converge_to_the_answer():
    """More sub-rays, less error; and the answer is surer than all of them."""
    found = measured(pulses=512)
    fixed = [row for row in found.rows if row.model == "fixed"]
    assert fixed[-1].errors.mean_error_m < 0.4 * fixed[0].errors.mean_error_m
    assert found.answer_rmse_m < fixed[-1].errors.range_rmse_m


@pytest.mark.parametrize(
    ("settings", "name"),
    [
        ((), "beam.model=none"),
        (("beam.model='fixed'", "beam.rays=24"), "beam.model=fixed beam.rays=24"),
        (("beam.model='adaptive'", "beam.target_m=0.07"), "beam.model=adaptive beam.target_m=0.07"),
    ],
)
def test_the_setting_in_use_is_on_the_ladder(settings, name):
    """Whatever the scene says, one setting is that in use, and its light is that of the run."""
    scenario = load("static_bench", settings)
    in_use = [light for light in beam_settings(scenario, scenario.seed) if light.in_use]
    assert [light.name for light in in_use] == [name]
    assert in_use[0].beam == Engine.of(scenario).parts.units[0].beam


def test_names_are_settings():
    """The name of each light, given as settings, makes it the one in use."""
    for light in beam_settings(load("static_bench"), 1):
        again = beam_settings(load("static_bench", light.name.split()), 1)
        assert [one.beam for one in again if one.in_use] == [light.beam]


def test_where_nothing_is_met_that_is_said():
    """A scene in which no pulse has a return is an error, not a report of no errors."""
    with pytest.raises(RunError, match="none of 128 pulses has a return"):
        measured("sensor.max_range_m=1.0")


SMALL = (
    "motion={kind='static',x_m=0.0,y_m=0.0}",
    "seed=5",
    "world.stems_per_ha=100",
    "world.terrain.rough_rms_m=0",
    "sensor.max_range_m=8",
    "sensor.eccentricity_deg=0.0",
    "sensor.azimuth_noise_deg=0.0",
    "duration_s=1",
)


def test_worlds_are_compared_by_means(monkeypatch):
    """Each distance, that of the scene among them, is a setting; beyond the reach nothing departs, and the
    explicit one is last."""
    monkeypatch.setattr("vlp16emu.extras.accuracy.sweep._NEAR_M", (9.0, math.inf))
    found = measure_foliage(load("birch_walk", [*SMALL, "world.near_m=5.5"]), pulses=256)
    names = [f"world.near_m={near_m}" for near_m in ("5.5", "9", "inf")]
    assert [level.name for level in found] == names
    assert [level.name for level in found if level.in_use] == ["world.near_m=5.5"]
    assert load("birch_walk", [names[0]]).world.near_m == 5.5
    assert all(level.us_per_pulse > 0 for level in found)
    assert found[1].means == found[2].means
    seen = found[2].means["with a return, %"]
    assert 0 < seen.value < 100
    assert (seen.off, seen.half, seen.departs) == (0, 0, False)
    assert any(mean.off != 0 for mean in found[0].means.values())
    assert measure_foliage(load("static_bench"), pulses=128) == ()


def test_two_returns_are_known():
    """A strongest return that is not the last makes two, as does a second strongest behind one that is."""
    distance_m = np.array([[0, 0, 0], [9, 9, 0], [9, 12, 0], [12, 12, 9]], np.float32)
    assert is_two(distance_m).tolist() == [False, False, True, True]


@pytest.mark.parametrize(("leaves_off", "departs"), [(0.0, False), (3.0, True)])
def test_a_departure_is_seen_and_chance_is_not(leaves_off, departs):
    """Means whose difference is beyond the chance between groups depart; of what chance alone moves few
    do."""
    rng = np.random.default_rng(5)
    found = 0
    for _ in range(100):
        plain = rng.normal(40, 8, 50)
        other = plain + rng.normal(leaves_off, 4, 50)
        of = [[{"leaf": value} for value in values.tolist()] for values in (other, plain)]
        found += departures(*of)["leaf"].departs
    assert (found > 95) if departs else (found < 15)


BLOCK_S = 1920 * 55_296e-9


@pytest.fixture(scope="module")
def hall():
    """The hall by four sub-rays a pulse."""
    return load("static_bench", ["beam.model='fixed'", "beam.rays=4"])


def digest(packets):
    return hashlib.sha256(b"".join(packet.payload for packet in packets)).hexdigest()


def test_an_audit_changes_no_byte_and_depends_on_no_thread(hall):
    """With an audit, on one thread or three, the packets are those without; and the audits find the same."""
    audits = [Audit(hall), Audit(hall)]
    found = {
        digest(Engine.of(hall, threads=threads, taps=[audit] if audit else []).packets(0.0, 10 * BLOCK_S))
        for threads, audit in ((1, audits[0]), (3, audits[1]), (2, None))
    }
    assert len(found) == 1
    assert audits[0].tally == audits[1].tally
    assert audits[0].tally.pulses == 10 * 16


def test_where_a_pulse_is_one_ray_nothing_is_looked_at():
    """A scene that chose one ray per pulse has no audit answers, and its report calls it exact."""
    scenario = load("static_bench")
    audit = Audit(scenario)
    list(Engine.of(scenario, taps=[audit]).packets(0.0, 0.01))
    assert audit.exact
    assert audit.tally == Tally()
    assert (audit.tally.range_rmse_m, audit.tally.range_rmse_interval_m) == (None, None)


def test_audits_estimate_the_error_that_accuracy_measures(hall):
    """Six audits with different seeds together find the RMSE that is found on pulses of accuracy's own."""
    audits, scenes = [Audit(hall) for _ in range(6)], []

    def look(job, firings, hits, scene):
        scenes.append(scene)
        for seed, audit in enumerate(audits):
            audit(replace(job, unit=replace(job.unit, seed=seed)), firings, hits, scene)

    emulator = Engine.of(hall, taps=[look])
    list(emulator.returns(0.0, 20 * BLOCK_S))
    unit = emulator.parts.units[0]
    bench = Bench(unit, 128)
    ((_, groups),) = draw_groups(Batching(16, 55_296), 20, 8_192, 1, moves=False)
    aimed = [bench.aim(group) for group in groups]
    answer = join_detections([bench.answer(scenes[0], pulses, unit.beam) for pulses in aimed])
    returns = join_detections([bench.detections(scenes[0], pulses, unit.beam) for pulses in aimed])
    measured_m = errors_of(
        compare(answer, returns, apart_m(hall.detector)), apart_m(hall.detector)
    ).range_rmse_m
    squares_um2, matched = (
        sum(getattr(audit.tally, of) for audit in audits) for of in ("squares_um2", "matched")
    )
    assert 1e-6 * np.sqrt(squares_um2 / matched) == pytest.approx(measured_m, rel=0.3)
    assert len({audit.tally.range_rmse_m for audit in audits}) == 6, "audits draw pulses of their own"


RESOLUTION_M = 1.0


def detections_of(*distance_m, reflectivity=50):
    """One pulse per given distance or (strongest, last)."""
    distance = np.zeros((len(distance_m), 3), np.float32)
    distance[:, :2] = np.array(distance_m).reshape(len(distance_m), -1)
    return Detections(distance, np.where(distance > 0, reflectivity, 0).astype(np.uint8))


def errors(answer, got):
    return errors_of(compare(answer, got, RESOLUTION_M), RESOLUTION_M)


def row(name, us, error_m, model="fixed"):
    some = replace(
        errors(detections_of(10.0), detections_of(10.1)), mean_error_m=error_m, range_rmse_m=error_m
    )
    return Row(model, name, False, some, {}, us, 0.1 * us, 1.0)


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


@pytest.mark.parametrize(("sigma", "least"), [(0.5, 0.86), (0.8, 0.80)])
def test_the_interval_holds_the_true_rmse_as_often_as_it_says(sigma, least):
    """Some 95 % of intervals hold the RMSE of errors that are alike within clusters, 92 % where tails are
    heavy; here 3 sigma less."""
    rng = np.random.default_rng(2)
    held, trials, size, clusters = 0, 50, 12, 60
    true_m = np.sqrt(np.exp(2 * -4.0 + 2 * sigma**2) / 2)  # E[x^2] of lognormal scale times half of uniform's
    answer = detections_of(*[30.0] * size)
    for _ in range(trials):
        tally = Tally()
        for scale_m in np.exp(rng.normal(-4.0, sigma, clusters)):
            off_m = scale_m * rng.choice([0.0, 1.0], size)
            tally.add(compare(answer, detections_of(*(30.0 + off_m)), RESOLUTION_M))
        interval = tally.range_rmse_interval_m
        held += interval[0] <= true_m <= interval[1]
    assert least <= held / trials < 1


def test_a_tally_says_what_errors_of_all_pulses_say():
    """Clusters summed up one by one, in any order, give RMSE and shares of all pulses at once."""
    rng = np.random.default_rng(3)
    answers = [detections_of(*rng.choice([0.0, 20.0, 40.0], 16)) for _ in range(30)]
    off_m = [rng.choice([-20.0, 0.0, 0.1, 0.2], 16) for _ in answers]
    tolds = [
        detections_of(*np.maximum(a.distance_m[:, 0] + b, 0.0)) for a, b in zip(answers, off_m, strict=True)
    ]
    tally, turned = Tally(), Tally()
    clusters = [compare(answer, got, RESOLUTION_M) for answer, got in zip(answers, tolds, strict=True)]
    for one, other in zip(clusters, clusters[::-1], strict=True):
        tally.add(one)
        turned.add(other)
    assert tally == turned
    found = errors(join_detections(answers), join_detections(tolds))
    assert tally.range_rmse_m == pytest.approx(found.range_rmse_m, rel=1e-4)
    counts = tally.lost, tally.invented, tally.wrong_strongest
    assert np.allclose(np.divide(counts, tally.returns), (found.lost, found.invented, found.wrong_strongest))
    assert min(counts) > 0


def test_clusters_that_err_alike_leave_no_doubt():
    """Eight clusters of one mean square have an interval that is that square's root, however it is
    rounded; seven have none."""
    for off_m in np.arange(1, 33) / 64:
        tally, answer, got = Tally(), detections_of(*[30.0] * 7), detections_of(*[30.0 + off_m] * 7)
        for _ in range(8):
            assert tally.range_rmse_interval_m is None
            tally.add(compare(answer, got, RESOLUTION_M))
        assert tally.range_rmse_m == pytest.approx(off_m, abs=1e-6), off_m
        interval = tally.range_rmse_interval_m
        assert interval == pytest.approx((off_m, off_m), abs=1e-6), off_m


def test_choices_name_the_quickest_that_is_good_enough():
    """For each wanted error the quickest setting within it is named, once, with the least error it is good
    for; no beam error is."""
    rows = [
        row("errant", 0.5, 0.001, "angle"),
        row("one", 1.0, 0.15),
        row("eight", 4.0, 0.06),
        row("many", 20.0, 0.009),
    ]
    assert choices(rows) == {"one": 0.2, "eight": 0.1, "many": 0.01}


BATCHING = Batching(16, 55_296)


@pytest.mark.parametrize("moves", [False, True])
def test_groups_are_spread_over_the_run(moves):
    """Each of equal spans of time has its group, whatever is drawn, and a group is of the segment it is
    given with."""
    blocks = 4 * BATCHING.segment
    drawn = list(draw_groups(BATCHING, blocks, 4096, 7, moves=moves))
    groups = [group for _, of_segment in drawn for group in of_segment]
    assert len(groups) == 4096 // (GROUP * 16)
    at = np.array([group.start for group in groups]) / (blocks * BATCHING.block)
    assert (np.floor(at * len(groups)) == np.arange(len(groups))).all()
    assert all(len(group) == GROUP and group.start % GROUP == 0 for group in groups), (
        "as a run judges adaptive beams"
    )
    if moves:
        for segment, of_segment in drawn:
            assert {group.start // BATCHING.block // BATCHING.segment for group in of_segment} == {segment}


def test_a_long_walk_opens_few_windows():
    """The audit of an hour's walk samples eight segments, one from each eighth of it."""
    blocks = 530 * BATCHING.segment
    segments = np.array([segment for segment, _ in draw_groups(BATCHING, blocks, 8192, 1, moves=True)])
    assert (segments * 8 // 530 == np.arange(8)).all()
