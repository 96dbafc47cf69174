"""Truth beside a run, from the command line."""

import signal

import pytest
from kit import set_words

pytestmark = pytest.mark.usefixtures("kept_woods")


def rows(path):
    """Lines that are no comment."""
    return [line for line in path.read_text().splitlines() if not line.startswith("#")]


@pytest.mark.parametrize("start", [[], ["--start", "0.3"]])
def test_truth_repeats_the_run_that_was_made(cli, each_unit, tmp_path, start):
    """Recorded without --duration, scenario.json makes the same bytes, settings and all, and is as long as
    the run was; a --start is named in it."""
    options, folder = ["--json", *start], tmp_path / "t"
    settings = "--set", "seed=9", "--set", "sensor.return_mode=dual"
    run = "record", each_unit, tmp_path / "a.pcap", *options, *settings, "--duration", "0.2"
    first = cli(*run, "--truth", folder).tree
    again = cli("record", folder / "scenario.json", tmp_path / "b.pcap", *options).tree
    assert (again["sha256"], again["bytes"]) == (first["sha256"], first["bytes"])
    assert ("--start 0.3" in (folder / "scenario.json").read_text()) is bool(start)


def test_the_truth_alone_is_that_of_a_recording(cli, tmp_path):
    """`truth` writes the files of `record --truth`, whose recording is as without, for each unit of a rig,
    and names them in its report."""
    sets = (
        "imu.preset=consumer",
        "rig=[{return_mode='dual'}]",
        "start_utc=2026-05-20T09:00:00.25Z",
        "gps.connected=true",
    )
    run = ["--start", "0.7", "--duration", "0.3", "--json", *set_words(sets)]
    options = [*run, "--truth-rate", "50", "--truth-packets"]
    made = cli("record", "static_bench", tmp_path / "x.pcap", *options, "--truth", tmp_path / "a").tree
    assert len(rows(tmp_path / "a" / "trajectory.tum")) in {16, 17}
    assert len(rows(tmp_path / "a" / "packets_2.tum")) == made["units"][1]["packets"]
    report = cli("truth", "static_bench", tmp_path / "b", *options).tree
    assert (report["simulated_s"], report["interrupted"]) == (pytest.approx(0.3), False)
    plain = cli("record", "static_bench", tmp_path / "y.pcap", *run).tree
    assert plain["sha256"] == made["sha256"]
    for path in (tmp_path / "a").iterdir():
        assert (tmp_path / "b" / path.name).read_bytes() == path.read_bytes(), path.name
        assert report["files"].pop(path.name) == path.stat().st_size
    assert report["files"] == {}
    assert (
        "\n  packets_2.tum " in cli("truth", "static_bench", tmp_path / "b", *options[:4], *options[5:]).out
    )


def test_ctrl_c_ends_the_truth_alone(cli, signal_at, tmp_path):
    """Ctrl-C exits with 130 within a tenth of a simulated second, and the files end where the report says."""
    signal_at((20.0, signal.SIGINT))
    outcome = cli("truth", "static_bench", tmp_path / "t", "--duration", "600000", "--json")
    assert (outcome.code, outcome.tree["interrupted"]) == (130, True)
    assert 20 <= outcome.tree["simulated_s"] < 20.1
    assert abs(len(rows(tmp_path / "t" / "trajectory.tum")) - 200 * outcome.tree["simulated_s"]) <= 3


@pytest.mark.parametrize("verb", ["record", "stream"])
def test_truth_does_not_replace_its_own_scene(cli, tmp_path, verb):
    """A scenario.json of an earlier run is not recorded or streamed with its truth into its own folder."""
    folder, out = tmp_path / "t", [tmp_path / "a.pcap"]
    cli("record", "static_bench", *out, "--duration", "0.1", "--truth", folder)
    scene = folder / "scenario.json"
    before = scene.read_bytes()
    options = ["--duration", "0.1", "--set", "seed=9", "--truth", folder]
    outcome = cli(verb, scene, *(out if verb == "record" else []), *options)
    assert outcome.code == 2
    assert outcome.err.startswith(f"error: {scene}: is read by this run")
    assert scene.read_bytes() == before
