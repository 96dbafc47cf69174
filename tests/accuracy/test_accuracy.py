"""Accuracy measured on small scenes."""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from vlp16emu.accuracy.curve import Kind
from vlp16emu.accuracy.distributions import RETURNS
from vlp16emu.accuracy.medium import measure_medium
from vlp16emu.accuracy.precision import repeats, rounding_of, strays
from vlp16emu.accuracy.settings import beam_settings, levels_of_detail, pose_rates
from vlp16emu.accuracy.sweep import measure_accuracy
from vlp16emu.engine import Engine, assemble, window_of
from vlp16emu.engine.windows import Batching
from vlp16emu.errors import RunError
from vlp16emu.raycast.caster import caster
from vlp16emu.scenario import load
from vlp16emu.types import Hits

pytestmark = pytest.mark.usefixtures("kept_woods")


def measured(*settings, pulses=256):
    return measure_accuracy(load("static_bench", settings), "hall", pulses=pulses, done=lambda _: None)


def test_errors_are_the_same_each_time():
    """Two measurements of one scene differ in run time alone, and a static sensor has no poses to judge."""
    first, second = measured(pulses=128), measured(pulses=128)
    assert [row.errors for row in first.rows] == [row.errors for row in second.rows]
    assert first.answer_rmse_m == second.answer_rmse_m
    assert first.poses == ()
    assert all(row.us_per_pulse > 0 for row in first.rows)


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


@pytest.mark.parametrize(
    ("near_m", "names"),
    [(12.5, "10 12.5 15 20 30 inf"), (30, "10 15 20 30 inf"), (math.inf, "10 15 20 30 inf")],
)
def test_the_distance_in_use_is_on_the_ladder(near_m, names):
    """Whatever the scene says, its own distance is among those that are looked at, and each can be set."""
    drawn = levels_of_detail(load("birch_walk", [f"world.near_m={near_m}"]))
    assert [one.name for one in drawn] == [f"world.near_m={name}" for name in names.split()]
    assert [one.scenario.world.near_m for one in drawn if one.in_use] == [near_m]
    for one in drawn:
        assert load("birch_walk", [one.name]).world == one.scenario.world


def test_a_held_pose_is_that_of_the_first_pulse():
    """Held over a packet of 24 sequences, all pulses have the pose of the packet's first one."""
    unit = Engine.of(load("birch_walk", ["world.stems_per_ha=50"])).parts.units[0]
    t_ns = unit.head.times_ns(1920, 48)
    _, per_sequence, per_packet = (
        hold.poses_at(t_ns.reshape(-1)).world_p_body_m for hold in pose_rates(unit)
    )
    first_m = unit.motion.poses_at(t_ns[:, 0].copy()).world_p_body_m
    assert (per_sequence.reshape(48, 16, 3) == first_m[:, None]).all()
    assert (per_packet.reshape(2, 24 * 16, 3) == first_m[::24, None]).all()


def test_rounding_is_seen():
    """The hall's float32 ranges are within micrometres; ranges that are 0.1 mm off are found to be so."""
    looked = []
    emulator = Engine.of(load("static_bench"), taps=[lambda *seen: looked.append(seen)])
    list(emulator.returns(0.0, 0.01))
    unit, _, _, scene = looked[0]
    world = emulator.parts.world
    few = unit.head.aim(0, 16, unit.motion.poses_at)
    window = world.window(np.array([[0.0, 0.0, 1.5]]))

    class Off:
        def cast(self, *pulses):
            hits = scene.cast(*pulses)
            return Hits(hits.count, hits.range_m + np.float32(1e-4), hits.surface, hits.cos_incidence)

    limits = unit.head.beams.near_m, 100.0
    true, off = (rounding_of(one, window, world.shape, few, *limits) for one in (scene, Off()))
    assert true.rays == off.rays == 256
    assert true.range_max_m < 1e-5
    assert off.range_rmse_m == pytest.approx(1e-4, rel=0.05)


def test_where_nothing_is_met_that_is_said():
    """A scene in which no pulse has a return is an error, not a report of no errors."""
    with pytest.raises(RunError, match="none of 128 pulses has a return"):
        measured("sensor.max_range_m=1.0", pulses=128)


SMALL = (
    "motion={kind='static',x_m=0.0,y_m=0.0}",
    "sensor.max_range_m=25",
    "sensor.eccentricity_deg=0.0",
    "sensor.azimuth_noise_deg=0.0",
    "duration_s=1",
    "world.near_m=10",
)


@pytest.fixture(scope="module")
def wood():
    """A static sensor in a small wood, its window, two groups of its pulses, and the scene with a medium beyond 10 m."""
    scenario = load("birch_walk", SMALL)
    parts = assemble(scenario)
    batching = Batching(16, parts.head.beams.sequence_ns)
    window = window_of(parts, scenario.start_ns, batching, 0)
    with ThreadPoolExecutor(2) as workers:
        scene = caster(parts.world, workers).open(window)
    firings = parts.head.aim(640, 128, parts.motion.poses_at, beam_axis=True)
    return parts, window, scene, firings, (parts.head.beams.near_m, 25.0)


def test_a_far_hit_shows_what_stands_there(wood):
    """Of each far hit the face of its own surface is within 1 m; of a scene that shows others it is not."""
    parts, window, scene, firings, limits_m = wood
    found = strays(scene, window, parts.world.shape, firings, limits_m, near_m=10.0)
    assert found.far > 100
    assert found.strays == 0
    assert found.farthest_m <= 1.0

    class Elsewhere:
        def cast(self, *pulses):
            hits = scene.cast(*pulses)
            return Hits(hits.count, hits.range_m, hits.surface[::-1].copy(), hits.cos_incidence)

    assert strays(Elsewhere(), window, parts.world.shape, firings, limits_m, near_m=10.0).strays > 0


def test_a_static_sensor_meets_the_same_each_revolution(wood):
    """By one ray, what is met depends on neither the revolution nor its random numbers; a scene that moves is seen to."""
    _, _, scene, firings, limits_m = wood
    assert repeats(scene, firings, *limits_m, 1808)

    class Moves:
        def cast(self, these, *others):
            hits = scene.cast(these, *others)
            return Hits(hits.count, hits.range_m + np.float32(these.index), hits.surface, hits.cos_incidence)

    assert not repeats(Moves(), firings, *limits_m, 1808)


def test_worlds_are_compared_as_distributions():
    """Each distance has a column, the explicit one last; what is 5 m nearer than all media is the same in all."""
    found = measure_medium(load("birch_walk", SMALL), pulses=512, done=lambda _: None)
    assert found.names == tuple(f"world.near_m={near_m}" for near_m in ("10", "15", "20", "30", "inf"))
    assert found.in_use == (True, False, False, False, False)
    assert (found.pulses, found.groups) == (512, 4)
    rows = {(row.section, row.name): row.values for row in found.statistics}
    assert len(set(rows[RETURNS, "0-15 m"][2:])) == 1
    assert measure_medium(load("static_bench"), pulses=512, done=lambda _: None) is None
