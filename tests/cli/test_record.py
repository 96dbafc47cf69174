"""Scenes into files."""

import hashlib
import json
import os
import signal
import threading

import pytest
from kit import set_words
from woods import LINES

from vlp16emu import Emulator
from vlp16emu.output import OutputFile

pytestmark = pytest.mark.usefixtures("kept_woods")

KEYS = [
    *("file", "about", "units", "bytes", "sha256", "simulated_s", "walk_share", "wall_s", "audit"),
    *("interrupted", "messages", "returns", "real_time_factor", "packets", "position_packets"),
]


def test_the_report_tells_the_truth_about_the_file(cli, tmp_path):
    """Size, digest and counts in the report are those of the file."""
    path = tmp_path / "x.pcap"
    report = cli("record", "static_bench", path, "--duration", "0.2", "--json").tree
    assert list(report) == KEYS
    content = path.read_bytes()
    assert (report["bytes"], report["sha256"]) == (len(content), hashlib.sha256(content).hexdigest())
    read = cli("decode", path, "--json").tree
    assert (report["packets"], report["position_packets"]) == (read["packets"], read["position_packets"])
    assert report["returns"] == read["points"]
    assert report["packets"] == int(0.2e9 // 1_327_104)
    assert report["simulated_s"] == 0.2
    assert report["walk_share"] is None
    assert report["real_time_factor"] == pytest.approx(0.2 / report["wall_s"])


def test_people_get_a_summary(cli, tmp_path):
    """Without --json the same stands in a few lines, models as they are after presets, `--set` and
    `--ideal`; nothing is on stderr."""
    sets = "noise.preset=datasheet", "beam.model=adaptive", "weather={visibility_m=60.0,rain_mm_h=10.0}"
    run = "record", "static_bench", tmp_path / "x.pcap", "--duration", "0.1"
    out, ideal = cli(*run, *set_words(sets)).out, cli(*run, "--ideal")
    assert out.startswith(
        f"wrote {tmp_path}/x.pcap\n  scene             static_bench\n  seed              1\n"
    )
    for line in (
        "beam              adaptive: at most 64 sub-rays, error of ",
        "noise             datasheet: 11 mm white, 10 mm bias per laser, ",
        "weather           visibility 60 m, rain of 10 mm/h\n",
        "data packets      75\n",
    ):
        assert f"\n  {line}" in out
    assert (
        "\n  beam              none: one ray, without width\n  noise             ideal: 0 mm white"
        in ideal.out
    )
    assert ("\n  weather " in ideal.out, ideal.err) == (False, "")


def test_a_walk_that_is_cut_off_says_how_much_of_it_there_is(cli, tmp_path):
    """The report has the share of the walk's time that was recorded, and its line names it."""
    settings = "beam.model=none", *LINES
    run_s = Emulator("birch_walk", settings).parts.motion.run_time_s
    out = cli("record", "birch_walk", tmp_path / "x.pcap", "--duration", "0.8", *set_words(settings)).out
    assert f"\n  of the walk       {80 / run_s:.0f} %\n" in out


def test_a_recording_goes_through_a_pipe(main_here, cli, tmp_path):
    """To - the file's bytes go to standard output, nothing else does, and the report goes to stderr, also
    by its other name."""
    options = "--duration", "0.1", "--json"
    with (tmp_path / "report").open("w") as stdout:
        assert main_here("record", "static_bench", "/dev/stdout", *options, stdout=stdout)[1].startswith("{")
    assert not (tmp_path / "report").read_bytes()
    with (tmp_path / "out").open("w") as stdout:
        code, err = main_here("record", "static_bench", "-", *options, stdout=stdout)
    out, report = (tmp_path / "out").read_bytes(), json.loads(err)
    assert (code, report["sha256"], report["bytes"]) == (0, hashlib.sha256(out).hexdigest(), len(out))
    assert report["sha256"] == cli("record", "static_bench", tmp_path / "x.pcap", *options).tree["sha256"]
    assert not (tmp_path / "-").exists()


@pytest.mark.parametrize("name", ["x", "x.PCAP", "x.cap", "x.dump", "x.dmp"])
def test_a_capture_may_have_its_usual_endings(cli, tmp_path, name):
    """Names of classic pcap files, in any case, and names without an ending are written."""
    assert cli("record", "static_bench", tmp_path / name, "--duration", "0.01").code == 0
    assert (tmp_path / name).read_bytes()[:4] == bytes.fromhex("d4c3b2a1")


def test_two_recordings_into_one_file_are_refused(cli, tmp_path):
    """The second names the process of the first, before it touches its own folder of truth."""
    path, truth = tmp_path / "x.pcap", tmp_path / "t"
    assert cli("truth", "static_bench", truth, "--duration", "0.1").code == 0
    before = {file.name: file.read_bytes() for file in truth.iterdir()}
    with OutputFile(path):
        outcome = cli("record", "static_bench", path, "--duration", "0.1", "--truth", truth)
    found = f"error: {path}: is being written by process {os.getpid()}; "
    found += "expected another place, or an end of that run\n"
    assert (outcome.code, outcome.err) == (2, found)
    assert {file.name: file.read_bytes() for file in truth.iterdir()} == before


def test_a_signal_leaves_a_recording_as_far_as_it_got(cli, signal_at, tmp_path):
    """After SIGTERM the file holds what the report says, and its truth ends with a whole line."""
    path, truth = tmp_path / "x.pcap", tmp_path / "t"
    signal_at((0.5, signal.SIGTERM))
    outcome = cli("record", "static_bench", path, "--duration", "3600", "--truth", truth, "--json")
    report = outcome.tree
    assert (outcome.code, outcome.err, report["interrupted"]) == (130, "", True)
    assert report["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert 0.5 <= report["simulated_s"] < 3600
    assert cli("verify", path, "--json").tree["packets"] == report["packets"]
    poses = (truth / "trajectory.tum").read_text()
    assert poses.endswith("\n")
    assert {len(line.split()) for line in poses.splitlines() if not line.startswith("#")} == {8}


def test_what_ignores_hangups_goes_on(cli, signal_at, tmp_path):
    """Under nohup the end of the terminal is not that of the run."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal_at((0.2, signal.SIGHUP), (0.6, signal.SIGINT))
    outcome = cli("record", "static_bench", tmp_path / "x.pcap", "--duration", "3600", "--json")
    signal.signal(signal.SIGHUP, before)
    assert outcome.code == 130
    assert outcome.tree["simulated_s"] >= 0.6


CASTS_AND_WRITES_FOR_EVER = """
import os, sys
from threading import Event
from vlp16emu.engine import Engine
from vlp16emu.sinks import PcapSink

scan = Engine._scan
def _scan(engine, job, opened):
    return scan(engine, job, opened) if job.blocks.start == 0 else Event().wait()

def send(_sink, _packet):
    print("writing", file=sys.stderr, flush=True)
    Event().wait()

os.isatty = lambda _: True
Engine._scan, PcapSink.send = _scan, send
"""


def until(process, line):
    """Read what a process says until it says a line."""
    for said in process.stderr:
        if said.strip() == line:
            return
    raise AssertionError(f"never said {line}")


def test_ctrl_c_does_not_wait_for_the_world(cli, monkeypatch, tmp_path):
    """Ctrl-C while the world grows ends the run at once; an earlier recording and its ground truth stay."""
    path, truth, end = tmp_path / "x.pcap", tmp_path / "truth", threading.Event()
    cli("record", "static_bench", path, "--truth", truth, "--duration", "0.1")
    before = [file.read_bytes() for file in (path, *sorted(truth.iterdir()))]

    def grow(*_):
        signal.raise_signal(signal.SIGINT)
        end.wait()

    monkeypatch.setattr("vlp16emu.engine.windows.window_of", grow)
    outcome = cli("record", "static_bench", path, "--truth", truth, "--json")
    end.set()
    assert (outcome.code, outcome.out, outcome.err, sorted(tmp_path.iterdir())) == (
        130,
        "",
        "",
        [truth, path],
    )
    assert [file.read_bytes() for file in (path, *sorted(truth.iterdir()))] == before


def test_a_second_ctrl_c_waits_for_nothing(program, tmp_path):
    """Where the first Ctrl-C cannot end the run, the second does, whatever the threads do; a capture
    without a packet is not kept."""
    path = tmp_path / "x.pcap"
    process = program("record", "static_bench", path, "--json", before=CASTS_AND_WRITES_FOR_EVER)
    until(process, "writing")
    process.send_signal(signal.SIGINT)
    until(process, "finishing what is under way; Ctrl-C again stops at once")
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=100)
    assert (process.returncode, out, list(tmp_path.iterdir())) == (130, "", [])


TURNED = "revolutions", "azimuth_steps"


def test_a_recording_tells_revolutions_and_azimuth_steps(cli, tmp_path):
    """A fifth of a second at 600 rpm is 2 turns of 1808.4 firing sequences, and 3616 sequences fit whole;
    each unit of a rig counts its own."""
    arguments = "record", "static_bench", tmp_path / "x.pcap", "--duration", "0.2"
    unit = cli(*arguments, "--json").tree["units"][0]["turn"]
    assert [unit[key] for key in TURNED] == [2.0, 3616]
    assert unit["sequences_per_revolution"] == pytest.approx(1e8 / 55_296)
    assert unit["azimuth_step_deg"] == pytest.approx(0.1990656)
    assert "; 2 revolutions of 1 808 firing sequences, 0.1991 deg apart\n" in cli(*arguments).out
    rig = "rig=[{rpm=600,address='192.168.1.202'},{rpm=1200,address='192.168.1.203'}]"
    units = cli(*arguments, "--set", rig, "--json").tree["units"]
    assert [[unit["turn"][key] for key in TURNED] for unit in units] == [
        [2.0, 3616],
        [2.0, 3616],
        [4.0, 3616],
    ]
