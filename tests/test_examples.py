"""The course in `tools/examples`, worlds, sensors and motions of one's own, and what other packages add by
entry points."""

import json
import os
import re
import runpy
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from vlp16emu import decode

pytestmark = pytest.mark.usefixtures("kept_woods")

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "tools" / "examples"
COURSE = {
    "1_record": ("0.2", "clean True"),
    "2_read": ("bench.pcap", "scan 0: 28"),
    "3_stream": ("0.2", "150 packets of 1206 bytes, the last one at 0.198 s"),
    "4_labels": ("0.2", "trees and saplings seen"),
    "5_trajectory": ("0.2", "points from (0.00, -3.00, 1.00) m"),
    "6_plot": ("0.2", "points in plot.ply"),
    "7_score": ("2.0", "ate_m"),
    "8_dataset": ("0.2", "4 walks: sequences/00, "),
}
"""Argument that keeps a script short, and words that it prints."""


def run_python(folder, *command, code=0):
    """Standard output of a program in a folder whose packages it finds; with what it says on errors if
    `code` is not 0."""
    env = os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)])}
    done = subprocess.run(
        [sys.executable, *command], cwd=folder, env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == code, done.stderr
    return (done.stdout, done.stderr) if code else done.stdout


@pytest.mark.parametrize("name", COURSE)
def test_the_course_runs(name, tmp_path, monkeypatch, capsys):
    """Each numbered script runs as it stands, and prints what it says."""
    monkeypatch.chdir(tmp_path)
    argument, printed = COURSE[name]
    if name == "2_read":
        monkeypatch.setattr(sys, "argv", ["1_record.py", "0.2"])
        runpy.run_path(str(EXAMPLES / "1_record.py"))
    monkeypatch.setattr(sys, "argv", [name, argument])
    with pytest.raises(SystemExit) if name == "7_score" else nullcontext():
        runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    assert printed in capsys.readouterr().out


BUGS = {
    "right": ("", "", None),
    "half_a_block": ("* since_us / (2", "* (since_us % FIRING_US) / (2", "points_lie_where_the_pulses_went"),
    "ring": ("np.argsort(np.argsort(ELEVATION_DEG))", "np.arange(16)", "rings_count_from_below"),
    "dual": ("np.arange(12) % 2 == 0", "np.arange(12) % 2 == 1", "the_last_return_comes_first"),
    "hour": ("self.hours += stamp_us < self.stamp_us", "pass", "time_goes_on_past_the_full_hour"),
}
"""What is right in the driver, what somebody wrote instead, and the test that says so."""


def test_tests_of_a_driver_find_its_bugs(pytester):
    """With the fixture `vlp16` the driver of the examples passes, and each of four bugs fails the test
    that is about it."""
    wanted = []
    driver, tests = (
        (EXAMPLES / "driver_tests" / name).read_text() for name in ("driver.py", "test_driver.py")
    )
    for name, (right, wrong, test) in BUGS.items():
        assert right in driver
        (pytester.path / f"driver_{name}.py").write_text(driver.replace(right, wrong) if right else driver)
        (pytester.path / f"test_{name}.py").write_text(
            tests.replace("from driver import", f"from driver_{name} import")
        )
        wanted.append(f"test_{name}.py" + f"::test_{test}" * bool(test))
    done = pytester.runpytest_inprocess("-p", "vlp16emu.pytest", "-p", "no:cacheprovider", *wanted)
    done.assert_outcomes(passed=5, failed=4)
    failed = set(re.findall(r"^FAILED test_(\w+)\.py::test_(\w+)", str(done.stdout), re.MULTILINE))
    assert failed == {(name, test) for name, (_, _, test) in BUGS.items() if test}


def test_a_session_without_the_fixture_loads_nothing(tmp_path, monkeypatch):
    """The plugin alone brings neither numpy nor the engine, and leaves numba as it is for others."""
    (tmp_path / "test_other.py").write_text(
        "import os, sys\ndef test_it():\n    assert not {'numpy', 'pydantic', 'vlp16emu.run'} & "
        "set(sys.modules)\n"
        "    import numba\n    assert 'NUMBA_CPU_NAME' not in os.environ\n"
        "    import vlp16emu.trig\n    assert 'NUMBA_CPU_NAME' in os.environ\n"
    )
    monkeypatch.delenv("NUMBA_CPU_NAME", raising=False)
    command = "-m", "pytest", "-q", "-W", "error", "-p", "vlp16emu.pytest", "-p", "no:cacheprovider"
    assert "1 passed" in run_python(tmp_path, *command)


def test_every_script_of_the_course_is_run():
    """No numbered script is left out above, and each has at most 40 lines."""
    numbered = sorted(EXAMPLES.glob("[0-9]_*.py"))
    assert [path.stem for path in numbered] == list(COURSE)
    assert max(len(path.read_text().splitlines()) for path in numbered) <= 40


OWN = f"""
import json, runpy, sys, numpy as np
from vlp16emu import Emulator

def script(name, seconds):
    sys.argv[1:] = [seconds]
    return runpy.run_path(f"{EXAMPLES}/own_{{name}}.py", run_name="__main__")

script("world", "0.1")
world = {{"kind": "dunes", "height_m": 3.0}}
scene = {{"schema": 1, "motion": {{"kind": "static"}}, "world": world}}
seen = []
for returns in Emulator(scene, ideal=True).returns(0.0, 0.1):
    hit = returns.distance_m[..., 0] > 0
    ray_m = returns.firings.direction[hit] * returns.distance_m[hit][:, :1]
    x_m, _, z_m = (returns.firings.origin_m[hit] + ray_m).T
    seen.append([len(x_m), np.abs(z_m - 1.5 * np.sin(2 * np.pi * x_m / 40)).max()])
sensor = script("sensor", "0.1")["Dense32"](model="dense-32")
script("motion", "2.0")
print(json.dumps([seen, [*sensor.beam_elevations_deg]]))
"""
"""A program that runs the scripts, looks at the dunes, and prints where returns lie and how high lasers
look."""


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """Folder in which the program has run, and the lines that it prints."""
    folder = tmp_path_factory.mktemp("own")
    return folder, run_python(folder, "-c", OWN).splitlines()


def test_a_world_of_ones_own_is_scanned(own):
    """Returns lie on the sine that the dunes are, but for the chords of 0.5 m: 1.5 m x (2 pi / 40 m)^2 x
    (0.5 m)^2 / 8."""
    _, (said, *_, tree) = own
    assert int(said.split()[0]) > 10_000
    for count, off_m in json.loads(tree)[0]:
        assert count > 100
        assert off_m < 0.0013


def test_a_beam_table_of_ones_own_gives_its_elevations(own):
    """A cloud of the sensor of 32 lasers has 32 rings, at the elevations of its table: a row of a list, no
    formula."""
    folder, lines = own
    assert len(json.loads(lines[-1])[1]) == 32
    head, _, _ = (folder / "dense.ply").read_bytes().partition(b"end_header\n")
    assert b"element vertex 1152" in head  # of 1 000 sequences x 32 pulses in a closed hall none is lost


def test_a_motion_of_ones_own_has_the_derivatives_of_its_poses(own):
    """The true specific force of the swing is that of a pendulum: g + rope x rate^2 along the rope at the
    lowest point."""
    table = np.genfromtxt(own[0] / "swing_truth" / "imu.csv", delimiter=",", names=True)
    along = table["true_fz_m_s2"]
    rate = np.abs(table["true_wy_rad_s"])
    assert along[rate.argmax()] == pytest.approx(9.80665 + 2.0 * rate.max() ** 2, rel=1e-4)
    assert rate.max() == pytest.approx(0.3 * np.sqrt(9.81 / 2.0), rel=1e-4)


LINES = """
import sys, vlp16emu
from vlp16emu.cli.app import run
vlp16emu.load("static_bench")
print(vlp16emu.doors._entry_points.cache_info().currsize, flush=True)
sys.exit(max(run(line.split()) for line in sys.argv[1:]))
"""
"""A program that reads a scene of ours, says how many entry points have been looked up, and carries out
command lines."""


@pytest.fixture(scope="module")
def outside(tmp_path_factory):
    """A folder with a package that adds a world, a scene, a sensor, a verb, and a world and a verb that
    are broken."""
    folder = tmp_path_factory.mktemp("outside")
    for name in ("own_world", "own_sensor"):
        (folder / f"{name}.py").write_text((EXAMPLES / f"{name}.py").read_text())
    (folder / "outside.py").write_text(
        'from pathlib import Path\nSCENES = Path(__file__).parent / "scenes"\n'
        'def greet(name: str) -> None:\n    """Greet somebody."""\n    print("hello", name)\n'
    )
    info = folder / "outside-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: outside\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[vlp16emu.worlds]\ndunes = own_world:Dunes\nruins = nowhere:Ruins\n"
        "[vlp16emu.sensors]\ndense-32 = own_sensor:Dense32\n"
        "[vlp16emu.scenes]\noutside = outside:SCENES\nlost = outside:LOST\n"
        "[vlp16emu.verbs]\ngreet = outside:greet\nmoan = nowhere:moan\n"
    )
    (folder / "scenes").mkdir()
    (folder / "scenes" / "dune_walk.toml").write_text(
        'schema = 1\ntitle = "A walk over dunes"\n[motion]\nkind = "walk"\nway_points_m = [[-9, 0], [9, 0]]\n'
        '[world]\nkind = "dunes"\n'
    )
    return folder


@pytest.fixture(scope="module")
def said(outside):
    """What command lines print beside that package, and on stderr; they are carried out in one process."""
    lines = [
        f"record dune_walk {outside}/dunes.pcap --duration=0.2",
        f"points static_bench {outside}/d.ply --duration=0.1 --set=sensor.model=dense-32",
        "record static_bench - --set=world={kind='ruins'}",
        *("scenes", "schema", "forest dune_walk", "moan", "greet you"),
    ]
    return run_python(outside, "-c", LINES, *lines, code=2)


def test_another_package_adds_a_world_that_is_recorded_and_listed(outside, said):
    """`record` finds the scene of another package and its world, `scenes` lists it, and `schema` has its
    keys."""
    assert sum(len(scan.xyz_m) for scan in decode(outside / "dunes.pcap")) > 5_000
    before, _, tree = said[0].partition("\n{")
    assert "\n  dune_walk " in before
    schema, _ = json.JSONDecoder().raw_decode("{" + tree)
    assert set(schema["properties"]["world"]["discriminator"]["mapping"]) == {
        "dunes",
        "forest",
        "hall",
        "plot",
    }


def test_another_package_adds_a_sensor_and_a_verb(outside, said):
    """A scene names the sensor by its word, and the command line has the verb."""
    assert said[0].endswith("hello you\n")
    assert b"element vertex" in (outside / "d.ply").read_bytes()[:2000]


def test_a_world_of_another_package_has_no_trees_to_report(said):
    """`forest` refuses it by one line, as only worlds of ours say what stands in them."""
    assert "error: world.kind: found dunes; expected forest, plot or hall\n" in said[1]


@pytest.mark.parametrize("entry", ["ruins of vlp16emu.worlds", "moan of vlp16emu.verbs"])
def test_a_broken_entry_point_is_one_line_that_names_it(said, entry):
    """Who asks for what another package has broken is answered with the package, the entry point and the
    reason."""
    word = entry.split()[0]
    assert (
        f"error: outside: entry point {entry}: modulenotfounderror: no module named 'nowhere'; "
        f"expected nowhere:{word}, which can be imported\n"
    ) in said[1].lower()


def test_who_asks_for_nothing_of_another_package_hears_nothing_of_it(said):
    """A scene of ours is read beside broken entry points without a word, and no entry point is looked up
    for it."""
    assert said[0].startswith("0\n")
