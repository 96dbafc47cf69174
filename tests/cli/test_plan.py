"""What a run needs, leaves out, and how fast it is."""

import pytest
from woods import THIN, WORDS

from vlp16emu.engine import Engine, assemble
from vlp16emu.engine.windows import Batching
from vlp16emu.extras.plan import needs
from vlp16emu.scenario import load

pytestmark = pytest.mark.usefixtures("kept_woods")


SHORTLY = "--sample", "0.2", "--repeats", "1"


def on(scene, *settings):
    """Names of what is on."""
    return {
        need.name for need in needs(Engine.of(load(scene, settings), threads=1), audited=False) if need.on
    }


def test_the_audit_is_named_where_it_looks(cli):
    """A beam with a width is audited unless that is not wanted; one ray leaves nothing to look at. The stages
    are in the order of the chain, each with its cost, and a sensor that stands still opens no window."""
    wide = "--set", "beam.model=adaptive"
    for options, is_on in ((wide, True), ((*wide, "--no-audit"), False), ((), False)):
        tree = cli("plan", "static_bench", *options, *SHORTLY, "--json").tree
        assert {need["name"]: need["on"] for need in tree["features"]}["audit"] is is_on
        stages = {stage["name"]: stage["cpu_s_per_s"] for stage in tree["stages"]}
        chain = ["poses of pulses", "aim", "cast, near", "cast, far", "audit", "texture", "detect", "pack"]
        assert list(stages) == [name for name in chain if name != "audit" or "--no-audit" not in options]
        assert all(cost >= 0 for cost in stages.values())
        assert not is_on or stages["cast, near"] > stages["pack"]


def test_the_hall_needs_nothing():
    """The static hall, with rays for beams and an ideal sensor, leaves everything out."""
    assert on("static_bench") == set()


@pytest.mark.parametrize(
    ("setting", "name"),
    [
        ("beam.model=adaptive", "beam width"),
        ("noise.range_noise_m=0.01", "range and reflectivity noise"),
        ("noise.weak_echoes_lost=true", "detection threshold"),
        ("weather.rain_mm_h=5", "weather"),
        ("sensor.return_mode=dual", "last and second return"),
        ("gps.connected=true", "satellites"),
        ("imu={}", "inertial unit"),
        ("rig=[{}]", "rig"),
    ],
)
def test_each_thing_is_reported(setting, name):
    """A setting switches on the one thing it asks for."""
    assert on("static_bench", setting) == {name}


def test_a_walk_moves_and_swings():
    """A person who walks has motion and gait, and no gait where that is switched off."""
    assert {"motion", "gait"} <= on("birch_walk")
    assert "gait" not in on("birch_walk", "motion.gait={ preset = 'none' }")
    assert "harness" in on("birch_walk", "motion.harness={}")


def test_a_walk_is_counted_and_measured(cli):
    """Trees in reach are as many as the world itself names, a span is measured, and its speed decides."""
    tree = cli("plan", "birch_walk", *WORDS, *SHORTLY, "--threads", "1", "--json").tree
    scenario = load("birch_walk", THIN)
    parts = assemble(scenario)
    edges_ns = scenario.start_ns + Batching(16, 55_296).edges_ns(0)
    trees = parts.world.trees(parts.motion.poses_at(edges_ns).world_p_body_m)
    assert tree["world"]["placed"]["trees"] == len(trees) > 0
    assert tree["world"]["species"] == ["silver_birch"]
    measured, stream = tree["measured"], tree["stream"]
    assert measured["simulated_s"] == 0.2
    assert measured["real_time_factor"] == pytest.approx(0.2 / measured["wall_s"])
    assert measured["started_s"] > 0
    assert stream["keeps_up"] is (measured["real_time_factor"] >= 1)
    assert bool(stream["keeps_up_with"]) is not stream["keeps_up"]


def test_people_get_a_page(cli):
    """Without --json the plan is a page; a scene shorter than what is measured is run to its end."""
    outcome = cli(
        "plan", "static_bench", "--set", "noise.preset=typical", "--set", "duration_s=0.1", "--repeats", "1"
    )
    assert outcome.out.startswith("static_bench has\n  range and reflectivity noise  ")
    assert "\nstatic_bench leaves out\n  beam width" in outcome.out
    assert "\ncost by stage, seconds of one core per simulated second\n  poses of pulses  0." in outcome.out
    assert "\nmeasured now, on " in outcome.out
    assert "\n  verdict" in outcome.out
    assert outcome.err == ""


def test_a_recording_is_estimated(cli):
    """Size and run time grow with the duration."""
    short, long = (
        cli("plan", "static_bench", "--duration", s, *SHORTLY, "--json").tree["recording"] for s in (1, 10)
    )
    assert long["bytes"] == pytest.approx(10 * short["bytes"], rel=0.01)
    assert long["bytes"] == pytest.approx(753.5 * 10 * (1206 + 58) + 146 * 10 * (512 + 58), rel=0.01)
    assert long["wall_s"] > short["wall_s"] > 0
