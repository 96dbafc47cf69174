"""Accuracy measured on small scenes."""

import numpy as np
import pytest

from vlp16emu.engine import Engine
from vlp16emu.errors import RunError
from vlp16emu.extras.accuracy.sweep import (
    Kind,
    beam_settings,
    departures,
    is_two,
    measure_accuracy,
    measure_foliage,
    pose_rates,
)
from vlp16emu.scenario import load

pytestmark = pytest.mark.usefixtures("kept_woods")


def measured(*settings, pulses=256):
    return measure_accuracy(load("static_bench", settings), "hall", pulses=pulses)


def test_errors_are_the_same_each_time():
    """Two measurements of one scene differ in run time alone, and a static sensor has no poses to judge."""
    first, second = measured(pulses=128), measured(pulses=128)
    assert [row.errors for row in first.rows] == [row.errors for row in second.rows]
    assert first.answer_rmse_m == second.answer_rmse_m
    assert first.poses == ()
    assert all(row.us_per_pulse > 0 for row in first.rows)


def test_settings_that_cast_the_same_rays_are_one_row():
    """A beam casts eight sub-rays at any coarse target: of these the row in use is left, and no two rows are equal."""
    rows = [row for row in measured("beam.model='adaptive'", pulses=128).rows if row.kind is Kind.ADAPTIVE]
    assert len({(row.errors, row.rays_per_pulse) for row in rows}) == len(rows)
    assert [row.name for row in rows if row.rays_per_pulse == 8.0] == ["beam.model=adaptive beam.target_m=0.05"]
    assert [row.in_use for row in rows].count(True) == 1


def test_sub_rays_converge_to_the_answer():
    """More sub-rays, less error; and the answer is surer than all of them."""
    found = measured(pulses=1024)
    fixed = [row for row in found.rows if row.kind is Kind.FIXED]
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


def test_a_held_pose_is_that_of_the_first_pulse():
    """Held over a packet of 24 sequences, all pulses have the pose of the packet's first one."""
    unit = Engine.of(load("birch_walk", ["world.stems_per_ha=50"])).parts.units[0]
    t_ns = unit.head.times_ns(1920, 48)
    _, per_sequence, per_packet = (hold.poses_at(t_ns.reshape(-1)).world_p_body_m for hold in pose_rates(unit))
    first_m = unit.motion.poses_at(t_ns[:, 0].copy()).world_p_body_m
    assert (per_sequence.reshape(48, 16, 3) == first_m[:, None]).all()
    assert (per_packet.reshape(2, 24 * 16, 3) == first_m[::24, None]).all()


def test_where_nothing_is_met_that_is_said():
    """A scene in which no pulse has a return is an error, not a report of no errors."""
    with pytest.raises(RunError, match="none of 128 pulses has a return"):
        measured("sensor.max_range_m=1.0", pulses=128)


SMALL = (
    "motion={kind='static',x_m=0.0,y_m=0.0}",
    "seed=5",
    "world.stems_per_ha=150",
    "sensor.max_range_m=25",
    "sensor.eccentricity_deg=0.0",
    "sensor.azimuth_noise_deg=0.0",
    "duration_s=1",
)


def test_worlds_are_compared_by_means():
    """Each distance, that of the scene among them, is a setting; beyond the reach nothing departs, and the explicit one is last."""
    found = measure_foliage(load("birch_walk", [*SMALL, "world.near_m=12.5"]), pulses=512)
    names = [f"world.near_m={near_m}" for near_m in ("10", "12.5", "15", "20", "30", "inf")]
    assert [level.name for level in found] == names
    assert [level.name for level in found if level.in_use] == ["world.near_m=12.5"]
    assert load("birch_walk", [names[1]]).world.near_m == 12.5
    assert all(level.us_per_pulse > 0 for level in found)
    assert found[4].means == found[5].means
    seen = found[5].means["with a return, %"]
    assert 0 < seen.value < 100
    assert (seen.off, seen.half, seen.departs) == (0, 0, False)
    assert any(mean.off != 0 for mean in found[0].means.values())
    assert measure_foliage(load("static_bench"), pulses=512) == ()


def test_two_returns_are_known():
    """A strongest return that is not the last makes two, as does a second strongest behind one that is."""
    distance_m = np.array([[0, 0, 0], [9, 9, 0], [9, 12, 0], [12, 12, 9]], np.float32)
    assert is_two(distance_m).tolist() == [False, False, True, True]


@pytest.mark.parametrize(("leaves_off", "departs"), [(0.0, False), (3.0, True)])
def test_a_departure_is_seen_and_chance_is_not(leaves_off, departs):
    """Means whose difference is beyond the chance between groups depart; of what chance alone moves few do."""
    rng = np.random.default_rng(5)
    found = 0
    for _ in range(100):
        plain = rng.normal(40, 8, 50)
        other = plain + rng.normal(leaves_off, 4, 50)
        of = [[{"leaf": value} for value in values.tolist()] for values in (other, plain)]
        found += departures(*of)["leaf"].departs
    assert (found > 95) if departs else (found < 15)
