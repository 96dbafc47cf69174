"""Scenes over UDP."""

import json
import re
import resource
import signal
import socket
import struct
import sys
import tempfile
import time

import numpy as np
import pytest
from listening import Listener

from vlp16emu.captures import Capture
from vlp16emu.packets.position import STAMP_LEAD_NS

pytestmark = pytest.mark.usefixtures("kept_woods")

PERIOD_NS = 1_327_104
STOPPED_S = 2.0
SO_TIMESTAMPNS = 35  # source: asm-generic/socket.h


@pytest.fixture
def listeners():
    """Two ports that listen, for data and for positions."""
    both = Listener(), Listener()
    yield both
    for each in both:
        each.end()


@pytest.fixture
def ports(listeners):
    """Options for the ports of `listeners`."""
    data_port, position_port = (each.port for each in listeners)
    return "--data-port", data_port, "--position-port", position_port


def test_the_web_interface_is_where_the_line_says(cli, ports):
    """A stream with --http prints the address of its web interface."""
    lines = cli(
        "stream", "static_bench", "--duration", "0.05", "--http", "127.0.0.1:0", *ports
    ).out.splitlines()
    assert lines[0].startswith("streaming static_bench to 127.0.0.1")
    assert re.fullmatch(r"web interface at http://127\.0\.0\.1:\d+/", lines[1])


def assert_recorded(listeners, capture):
    """What came to both ports is what a capture holds, in its order; give both."""
    came = [each.end() for each in listeners]
    recorded = [datagram.payload for datagram in Capture(capture)]
    assert came == [[payload for payload in recorded if len(payload) == size] for size in (1206, 512)]
    return came


def test_a_stream_is_a_recording_on_the_wire(cli, each_unit, listeners, ports, tmp_path):
    """The payloads that arrive are those of the recording: all of them, in order, each on its port."""
    cli("record", each_unit, tmp_path / "x.pcap", "--duration", "0.5")
    report = cli("stream", each_unit, "--duration", "0.5", *ports, "--json").tree
    data, position = assert_recorded(listeners, tmp_path / "x.pcap")
    assert (report["packets"], report["position_packets"]) == (len(data), len(position))
    assert (report["to"], report["interrupted"]) == ("127.0.0.1", False)
    assert report["units"][0]["turn"]["revolutions"] == pytest.approx(10 * report["sent"]["simulated_s"])


def test_people_read_where_it_goes_and_how_it_went(cli, ports):
    """The first line names receiver and ports, the last ones lateness and whether the engine kept up."""
    lines = cli("stream", "static_bench", "--duration", "0.1", "--speed", "10", *ports).out.splitlines()
    assert lines[0] == f"streaming static_bench to 127.0.0.1, ports {ports[1]} and {ports[3]}"
    assert lines[1] == "done: static_bench to 127.0.0.1"
    names = [line.split("  ")[1] for line in lines[2:]]
    assert [name for name in names if name not in ("delay", "to keep up")] == [
        *(
            "scene",
            "seed",
            "beam",
            "noise",
            "to",
            "speed",
            "late",
            "unit 1",
            "lateness",
            "simulated",
            "run time",
        ),
        *("fell behind", "ran at", "range error", "data packets", "position packets"),
    ]


@pytest.mark.parametrize("verb", ["stream", "replay"])
def test_a_strict_stream_that_was_late_has_failed(cli, bench, ports, monkeypatch, verb):
    """With --strict the exit code is 1 where a packet was late, after the same report; on time, and
    without it, 0."""
    what = ["static_bench", "--duration", "0.1"] if verb == "stream" else [bench]
    line = verb, *what, *ports, "--json"
    monkeypatch.setattr("vlp16emu.run.stream.TOLERANCE_NS", 10**11)  # whatever other programs do to the cores
    assert cli(*line, "--strict").code == 0
    monkeypatch.setattr("vlp16emu.run.stream.TOLERANCE_NS", -1)  # what leaves at its deadline is late
    loose, strict = cli(*line), cli(*line, "--strict")
    assert (loose.code, strict.code) == (0, 1)
    assert strict.tree["sent"]["behind"]
    assert strict.tree["packets"] == loose.tree["packets"]


@pytest.mark.parametrize("how", [[], ["--prepare"]])
def test_clocks_of_packet_0_are_in_report_and_truth(cli, each_unit, listeners, ports, tmp_path, how):
    """With --now the first packet's time by the sensor's clock is that of its stamp, by this machine's the
    same, and by the truth `moved_s` earlier."""
    gps = "--set", "gps.connected=true"
    line = "stream", each_unit, "--duration", "0.1", *gps, *ports, "--now", "--truth", tmp_path / "truth"
    began_ns = time.time_ns()
    report = cli(*line, *how, "--json").tree["sent"]
    ended_ns = time.time_ns()
    position = listeners[1].end()
    times = json.loads((tmp_path / "truth" / "time.json").read_text())
    assert times == {"moved_s": report["moved_s"], "speed": 1.0, "packet_0": report["first"]}
    first = report["first"]
    assert first["sensor_ns"] == pytest.approx(first["truth_ns"] + report["moved_s"] * 10**9, abs=1000)
    stamp_us = int.from_bytes(position[0][198:202], "little")
    assert stamp_us + STAMP_LEAD_NS // 1000 == first["sensor_ns"] // 1000 % (3600 * 10**6)
    assert began_ns < first["sensor_ns"] <= first["host_ns"] < ended_ns
    assert "\n  packet 0 left     " in cli(*line, *how).out


@pytest.mark.parametrize("kept", [True, False])
def test_a_prepared_stream_is_the_same_on_the_wire(cli, bench, listeners, ports, tmp_path, monkeypatch, kept):
    """With --prepare the payloads of the recording arrive in their order; only a file that is named stays."""
    file, temporary = tmp_path / "kept.pcap", tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    how = ("--prepare-to", file) if kept else ("--prepare",)
    report = cli("stream", "static_bench", "--duration", "0.5", *how, *ports, "--json").tree
    data, _ = assert_recorded(listeners, bench)
    assert (report["packets"], report["interrupted"]) == (len(data), False)
    assert (file.exists(), list(temporary.iterdir())) == (kept, [])


def test_a_full_disk_while_packets_are_prepared_names_no_file_that_is_removed(cli, tmp_path, monkeypatch):
    """The line names the folder that is full and the option for another place, and nothing is left."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        outcome = cli("stream", "static_bench", "--prepare", "--duration", "0.1", "--data-port", 9, "--json")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    kept = "nothing is kept; --prepare-to FILE.pcap takes another place"
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.err == f"error: --prepare: File too large in {tmp_path}; {kept}\n"
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def arrivals():
    """A port of the loopback, and a function that waits for n data packets; the kernel stamps arrivals in
    ns."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        receiver.settimeout(120)

        def receive(count):
            stamps_ns = []
            for _ in range(count):
                _, ancillary, _, _ = receiver.recvmsg(2048, 64)
                seconds, nanoseconds = struct.unpack("qq", ancillary[0][2])
                stamps_ns.append(seconds * 10**9 + nanoseconds)
            return stamps_ns

        yield receiver.getsockname()[1], receive


@pytest.mark.skipif(sys.platform != "linux", reason="stamps of arrival as Linux gives them")
@pytest.mark.parametrize("late", ["pace", "skip"])
def test_a_stopped_stream_goes_on_without_a_burst(program, arrivals, late):
    """Stopped for 2 s, the stream goes on at the sensor's pace: n packets take 0.94 of their time less 10 ms,
    or more.

    Another 5 ms may pass between a packet's time and its stamp, where other programs take the processor. It
    says so at once on stderr, stdout stays one JSON object, and the report gives the delay or the packets
    skipped. Where punctuality is a must, it ends with 1.
    """
    port, receive = arrivals
    ports = "--to", f"127.0.0.1:{port}", "--position-port", 9  # discard
    strict = ["--strict"] if late == "skip" else []
    process = program(
        "stream", "static_bench", "--duration", "3600", "--late", late, *ports, *strict, "--json"
    )
    stamps_ns = receive(200)
    process.send_signal(signal.SIGSTOP)
    time.sleep(STOPPED_S)  # the fact to prove is one of real time
    process.send_signal(signal.SIGCONT)
    stamps_ns += receive(800)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=100)
    for n in (20, 100):
        windows_ns = np.array(stamps_ns[n:]) - np.array(stamps_ns[:-n])
        assert windows_ns.min() >= 0.94 * n * PERIOD_NS - 15_000_000
    assert json.loads(out)["interrupted"] is True
    report = json.loads(out)["sent"]
    assert max(time["total_s"] for time in report["behind"]) > 0.9 * STOPPED_S
    assert err.startswith("behind: ")
    assert process.returncode == (1 if strict else 130)
    if late == "pace":
        assert report["delay_s"] > 0.9 * STOPPED_S
        assert report["skipped"] == {}
    else:
        assert report["delay_s"] == 0
        assert report["skipped"]["data"] > 0.9 * STOPPED_S / (PERIOD_NS * 1e-9)
        assert report["skipped"]["position"] > 0


def test_port_0_is_a_free_one(cli):
    """With --data-port 0 and --position-port 0 a free port of each is taken, printed at once, and
    reported."""
    free = "--data-port", "0", "--position-port", "0"
    run = cli("stream", "static_bench", "--duration", "0.05", *free, "--set", "rig=[{}]")
    pairs = [pair.split(" and ") for pair in run.out.splitlines()[0].partition(", ports ")[2].split("; ")]
    assert len({port for pair in pairs for port in pair} - {"2368", "2369", "8308", "8309"}) == 4
    units = cli("stream", "static_bench", "--duration", "0.05", *free, "--json").tree["units"]
    assert 20_000 <= units[0]["data_port"] != units[0]["position_port"] < 32_768
