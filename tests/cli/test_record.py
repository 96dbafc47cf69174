"""Scenes into files."""

import hashlib
import json
import os
import pty
import signal
import time
from pathlib import Path

import pytest

KEYS = [
    "file",
    "scene",
    "seed",
    "beam",
    "noise",
    "weather",
    "packets",
    "position_packets",
    "returns",
    "units",
    "bytes",
    "sha256",
    "simulated_s",
    "wall_s",
    "real_time_factor",
    "audit",
    "interrupted",
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
    assert report["real_time_factor"] == pytest.approx(0.2 / report["wall_s"])


def test_a_recording_goes_through_a_pipe(program, cli, tmp_path):
    """To - the file's bytes go to standard output, nothing else does, and the report goes to stderr."""
    options = "--duration", "0.1", "--json"
    out, err = program("record", "static_bench", "-", *options, text=False).communicate(timeout=100)
    report = json.loads(err)
    assert (report["sha256"], report["bytes"]) == (hashlib.sha256(out).hexdigest(), len(out))
    assert report["sha256"] == cli("record", "static_bench", tmp_path / "x.pcap", *options).tree["sha256"]
    assert not (tmp_path / "-").exists()


def test_a_pipe_that_ends_early_is_told_once(program):
    """Where standard output takes no more, the run ends with 1 and one line."""
    with Path("/dev/full").open("wb") as full:
        run = program("record", "static_bench", "-", "--duration", "0.1", stdout=full)
        _, err = run.communicate(timeout=100)
    assert run.returncode == 1
    message = (
        "error: standard output: No space left on device at packet 1; the 0 packets before it are kept\n"
    )
    assert err == message


def test_people_get_a_summary(cli, tmp_path):
    """Without --json the same stands in a few lines, and nothing on stderr where that is no terminal."""
    outcome = cli("record", "static_bench", tmp_path / "x.pcap", "--duration", "0.1")
    assert outcome.out.startswith(f"wrote {tmp_path}/x.pcap\n  scene             static_bench, seed 1\n")
    assert "\n  data packets      75\n" in outcome.out
    assert outcome.err == ""


def test_the_report_names_the_active_beam_and_noise(cli, tmp_path):
    """Beam and noise stand in the summary as they are after presets, `--set` and `--ideal`."""
    run = "record", "birch_walk", tmp_path / "x.pcap", "--duration", "0.01", "--set", "world.stems_per_ha=50"
    real = cli(*run, "--set", "noise.preset=datasheet").out
    assert "\n  beam              adaptive: at most 64 sub-rays, error of " in real
    assert "\n  noise             datasheet: 11 mm white, 10 mm bias per laser, " in real
    ideal = cli(*run, "--ideal", "--json").tree
    assert ideal["beam"] == "none: one ray, without width"
    assert ideal["noise"].startswith("ideal: 0 mm white, 0 mm bias per laser, 0 deg, ")


def test_weather_is_told_where_it_is_on(cli, tmp_path):
    """Fog and rain stand in the summary, clear air does not, and `--ideal` clears the air of the scene."""
    scene = tmp_path / "wet.toml"
    bench = (Path(__file__).resolve().parents[2] / "scenes" / "static_bench.toml").read_text()
    scene.write_text(f"{bench}\n[weather]\nvisibility_m = 60.0\nrain_mm_h = 10.0\n")
    run = "record", scene, tmp_path / "x.pcap", "--duration", "0.01"
    assert "\n  weather           visibility 60 m, rain of 10 mm/h\n" in cli(*run).out
    assert "\n  weather " not in cli(*run, "--ideal").out
    assert cli(*run, "--ideal", "--json").tree["weather"] is None


def test_threads_change_no_byte(cli, tmp_path):
    """One thread or three make the same file."""
    reports = [
        cli("record", "static_bench", tmp_path / "x.pcap", "--duration", "0.3", "--threads", n, "--json").tree
        for n in (1, 3)
    ]
    assert reports[0]["sha256"] == reports[1]["sha256"]


def test_pieces_make_the_whole(cli, tmp_path):
    """A run recorded in two pieces has the same records as in one go."""
    spans = {"whole": ("0", "0.5"), "first": ("0", "0.2"), "second": ("0.2", "0.3")}
    for name, (start, duration) in spans.items():
        cli("record", "static_bench", tmp_path / name, "--start", start, "--duration", duration, "--json")
    whole, first, second = ((tmp_path / name).read_bytes() for name in spans)
    assert whole == first + second[24:]  # 24 bytes of file header


def test_a_setting_changes_the_run(cli, tmp_path):
    """`--set sensor.return_mode=dual` doubles the packets."""
    path = tmp_path / "x.pcap"
    options = "--duration", "0.2", "--json"
    report = cli("record", "static_bench", path, *options, "--set", "sensor.return_mode=dual").tree
    assert report["packets"] == int(0.2e9 // 663_552)


def test_a_walk_that_is_too_short_leaves_the_old_file_alone(cli, tmp_path):
    """Where the walk ends before the recording would, nothing is overwritten."""
    path = tmp_path / "x.pcap"
    path.write_text("precious")
    outcome = cli("record", "birch_walk", path, "--duration", "1000")
    assert (outcome.code, path.read_text()) == (2, "precious")
    assert outcome.err.startswith("error: duration: found 1000 s; expected at most ")


def wait_for(path, size):
    """Until a file has grown."""
    for _ in range(600):
        if path.exists() and path.stat().st_size > size:
            return
        time.sleep(0.05)
    raise AssertionError(f"{path} never had {size} bytes")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_leaves_a_valid_file(cli, program, tmp_path, number):
    """Ctrl-C or SIGTERM in the middle exits with 130, without a traceback, and the file holds what the report says."""
    path = tmp_path / "x.pcap"
    process = program("record", "static_bench", path, "--duration", "3600", "--json")
    wait_for(tmp_path / "x.pcap.part", 500_000)
    assert not path.exists()
    process.send_signal(number)
    out, err = process.communicate(timeout=30)
    assert (process.returncode, err) == (130, "")
    report = json.loads(out)
    assert report["interrupted"] is True
    assert report["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert 0 < report["simulated_s"] < 3600
    assert cli("verify", path, "--json").tree["packets"] == report["packets"]


def test_two_recordings_into_one_file_are_refused(cli, program, tmp_path):
    """The second names the process of the first and exits with 2, before it touches its own folder of truth."""
    path, truth = tmp_path / "x.pcap", tmp_path / "t"
    assert cli("truth", "static_bench", truth, "--duration", "0.1").code == 0
    before = {file.name: file.read_bytes() for file in truth.iterdir()}
    process = program("record", "static_bench", path, "--duration", "3600", "--json")
    wait_for(tmp_path / "x.pcap.part", 100_000)
    outcome = cli("record", "static_bench", path, "--duration", "0.1", "--truth", truth)
    found = f"error: {path}: is being written by process {process.pid}; expected another place, or an end of that run\n"
    assert (outcome.code, outcome.err) == (2, found)
    assert {file.name: file.read_bytes() for file in truth.iterdir()} == before
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=30)
    assert json.loads(out)["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()


def test_a_killed_recording_is_kept_beside_its_name(cli, program, tmp_path):
    """After SIGKILL the earlier file stands, and OUT.pcap.part is decoded to its last whole packet."""
    path = tmp_path / "x.pcap"
    path.write_text("earlier")
    process = program("record", "static_bench", path, "--duration", "3600")
    wait_for(tmp_path / "x.pcap.part", 100_000)
    process.kill()
    process.communicate()
    assert path.read_text() == "earlier"
    assert cli("decode", tmp_path / "x.pcap.part", "--json").tree["packets"] > 50


def test_a_terminal_gets_a_bar_with_the_time_left(program, tmp_path):
    """With a terminal on stderr there is a progress bar; stdout keeps to the JSON object."""
    ours, theirs = pty.openpty()
    process = program(
        "record", "static_bench", tmp_path / "x.pcap", "--duration", "1", "--json", stderr=theirs
    )
    out, _ = process.communicate(timeout=60)
    os.close(theirs)
    drawn = os.read(ours, 100_000).decode()
    os.close(ours)
    assert "of 1.0 s" in drawn
    assert "left" in drawn
    assert json.loads(out)["packets"] == int(1e9 // 1_327_104)
