"""What a run needs, leaves out, and will take."""

import subprocess
import sys

import pytest

from vlp16emu.cli import plan
from vlp16emu.engine import Engine, assemble
from vlp16emu.report import Spent
from vlp16emu.report.plan.geometry import GeometrySize
from vlp16emu.report.plan.needs import needs
from vlp16emu.report.plan.run import Measured, StreamOutlook
from vlp16emu.report.plan.trial import peak_bytes
from vlp16emu.scenario import load

pytestmark = pytest.mark.usefixtures("kept_woods")

THIN = "sensor.max_range_m=20", "world.stems_per_ha=150", "seed=5"
SMALL = (*(word for setting in THIN for word in ("--set", setting)), "--threads", "1")


def on(scene, *settings):
    """Names of what is on."""
    return {
        need.name for need in needs(Engine.of(load(scene, settings), threads=1), audited=False) if need.on
    }


def test_the_audit_is_named_where_it_looks(cli):
    """A beam with a width is audited unless that is not wanted; one ray leaves nothing to look at."""
    wide = "--set", "beam.model=adaptive"
    for options, is_on in ((wide, True), ((*wide, "--no-audit"), False), ((), False)):
        features = cli("plan", "static_bench", "--duration", "1", *options, "--json").tree["features"]
        assert {need["name"]: need["on"] for need in features}["audit"] is is_on


@pytest.fixture(scope="module")
def birch(cli_once):
    """Plan of a walk that needs two windows, in a thin wood."""
    return cli_once("plan", "birch_walk", "--duration", "8", *SMALL, "--json")


@pytest.fixture(scope="module")
def cli_once():
    """Carry out a command line in this process, for a whole module."""
    import contextlib
    import io
    import json

    from vlp16emu.cli.app import run

    def call(*arguments):
        out = io.StringIO()
        with contextlib.redirect_stdout(out):
            assert run(arguments) == 0
        return json.loads(out.getvalue())

    return call


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


def test_what_is_in_reach_is_counted(birch):
    """Trees of the first window are as many as the world itself names."""
    scenario = load("birch_walk", THIN)
    parts = assemble(scenario)
    from vlp16emu.engine.windows import Batching

    edges_ns = scenario.start_ns + Batching(16, 55_296).edges_ns(0)
    trees = parts.world.trees(parts.motion.poses_at(edges_ns).world_p_body_m)
    world = birch["world"]
    assert world["first_window"]["trees"] == len(trees)
    assert world["species"] == ["silver_birch"]
    assert world["windows"] == world["windows_looked_at"] == 2
    geometry = world["geometry"]
    assert 0 < geometry["faces"] <= geometry["placed"]
    assert geometry["near_m"] == scenario.world.near_m
    assert 0 < geometry["tiles"] < 100
    assert geometry["medium_bytes"] > 4 * geometry["voxels"] > 0


def test_the_forecast_is_of_what_was_measured(birch):
    """Pieces lie in both windows, and the whole takes longer than its start."""
    forecast, measured = birch["forecast"], birch["measured"]
    assert measured["simulated_s"] == pytest.approx(sum(p["simulated_s"] for p in measured["pieces"]))
    assert len(measured["pieces"]) >= 4
    assert measured["second_window"]["wall_s"] > 0
    assert forecast["wall_s"] > forecast["first_packet_s"]
    assert forecast["real_time_factor"] == pytest.approx(8 / forecast["wall_s"])
    assert forecast["real_time_factor"] < forecast["steady_factor"]
    assert forecast["peak_memory_bytes"] <= 1.01 * peak_bytes()


def test_whether_a_stream_keeps_up_is_reported(birch):
    """The engine's speed beside the sender is that of the forecast, or a little less, and decides."""
    stream = birch["stream"]
    assert 0 < stream["sender_share"] < 1
    assert 0 < stream["real_time_factor"] <= birch["forecast"]["steady_factor"]
    assert stream["keeps_up"] is (stream["real_time_factor"] >= 1)
    assert bool(stream["keeps_up_with"]) is not stream["keeps_up"]


def test_people_read_what_is_faces_and_what_is_voxels(birch):
    """The page says up to which range there are faces and from where voxels, or that all are faces."""
    rows = plan._geometry(GeometrySize(**birch["world"]["geometry"]))
    assert rows["faces"].endswith(", within 15 m")
    assert rows["voxels"].endswith(" tiles, beyond 15 m")


@pytest.mark.parametrize(
    ("factor", "line"),
    [
        (3.1, "yes, 3.1 x real time"),
        (1.1, "yes, 1.10 x real time, with next to nothing left for other programs"),
        (0.9, "no, 0.90 x real time: packets will be late"),
    ],
)
def test_people_read_whether_a_stream_keeps_up(factor, line):
    """The page says yes or no, and the speed; a speed that leaves nothing to spare is called that."""
    found = StreamOutlook(factor >= 1, factor, 0.05, ())
    assert plan._stream_rows(found)["keeps up"] == line


def test_the_page_says_what_its_figures_are_from():
    """The page has how much was simulated in how many pieces, and the time of the second window where there is one."""
    pieces = (Spent(1.0, 2.0, 0.5),) * 3
    assert "1.5 s of the run in 3 pieces; " in plan._how(
        Measured(1.5, pieces, Spent(0.0, 0.0)), keeps_up=True
    )
    assert ", the second window in 0.25 s; " in plan._how(
        Measured(1.5, pieces, Spent(0.25, 0.3)), keeps_up=True
    )


def test_what_is_too_slow_to_stream_gets_an_advice():
    """A plan says what makes a run faster where a stream cannot keep up, and only there."""
    measured = Measured(1.5, (Spent(1.0, 2.0, 0.5),) * 3, Spent(0.0, 0.0))
    assert "world.near_m" in plan._how(measured, keeps_up=False)
    assert "world.near_m" not in plan._how(measured, keeps_up=True)


def test_a_static_sensor_has_one_window(cli):
    """Where nothing moves no second window is opened, whatever the duration."""
    outcome = cli("plan", "static_bench", "--duration", "3600", "--json")
    assert outcome.tree["world"]["windows"] == 1
    assert outcome.tree["measured"]["second_window"]["wall_s"] == 0
    assert outcome.tree["duration_s"] == 3600


def test_people_get_a_page(cli):
    """Without --json the plan is a page that says how its figures were got."""
    outcome = cli("plan", "static_bench", "--set", "noise.preset=typical", "--duration", "1")
    assert "\n  beam width" in outcome.out
    assert ", at any range\n" in outcome.out
    assert "voxels" not in outcome.out
    assert "`record` of 1 s on " in outcome.out
    assert "\n  keeps up  " in outcome.out
    assert "\nMeasured now on this machine: " in outcome.out
    assert outcome.err == ""


def test_a_walk_that_is_too_short_is_refused(cli):
    """A duration beyond the end of the walk is refused as in `record`."""
    outcome = cli("plan", "birch_walk", "--duration", "1000")
    assert outcome.code == 2
    assert outcome.err.startswith("error: duration: found 1000 s; expected at most ")


@pytest.mark.skipif(sys.platform != "linux", reason="/proc is Linux's")
def test_the_peak_grows_with_what_is_held():
    """Memory that is touched raises the peak."""
    code = (  # in a process of its own, which has held little yet
        "import numpy as np\n"
        "from vlp16emu.report.plan.trial import peak_bytes\n"
        "before = peak_bytes()\n"
        "held = np.ones(before // 8 + 10**7)\n"
        "print(before, held.nbytes, peak_bytes())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    before, held, after = map(int, done.stdout.split())
    assert held < after - before // 2


def test_more_threads_than_can_be_measured_on_are_refused(cli):
    """A run on very many threads is over a window before it runs steadily; the limit is told in one line."""
    outcome = cli("plan", "static_bench", "--threads", "500")
    assert outcome.code == 2
    assert outcome.err == "error: --threads: found 500; expected at most 426 to measure on\n"
