"""Scenes over UDP."""

import contextlib
import json
import signal
import socket
import threading
import time

import pytest

from vlp16emu.packets import Capture


@pytest.fixture
def listening():
    """Two sockets on free ports of the loopback, and what they receive, in lists by port."""
    stop = threading.Event()
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2)]
        for each in sockets:
            each.bind(("127.0.0.1", 0))
            each.settimeout(0.1)
        received = {each.getsockname()[1]: [] for each in sockets}

        def listen(way):
            while not stop.is_set():
                with contextlib.suppress(TimeoutError):
                    received[way.getsockname()[1]].append(way.recv(2048))

        threads = [threading.Thread(target=listen, args=(each,)) for each in sockets]
        for thread in threads:
            thread.start()
        yield received
        stop.set()
        for thread in threads:
            thread.join()


def settled(received):
    """What has been received once nothing more comes."""
    before = -1
    while (now := sum(map(len, received.values()))) != before:
        before = now
        time.sleep(0.3)
    return received.values()


def test_a_stream_is_a_recording_on_the_wire(cli, bench, listening):
    """The payloads that arrive are those of the recording: all of them, in order, each on its port."""
    data_port, position_port = listening
    ports = "--data-port", data_port, "--position-port", position_port
    report = cli("stream", "static_bench", "--duration", "0.5", *ports, "--json").tree
    data, position = settled(listening)
    with Capture(bench) as capture:
        recorded = [datagram.payload for datagram in capture]
    assert data == [payload for payload in recorded if len(payload) == 1206]
    assert position == [payload for payload in recorded if len(payload) == 512]
    assert (report["packets"], report["position_packets"]) == (len(data), len(position))
    assert (report["to"], report["interrupted"]) == ("127.0.0.1", False)


def test_speed_is_kept(cli, listening):
    """At --speed 4 a simulated second takes a quarter, and lateness is told."""
    data_port, position_port = listening
    ports = "--data-port", data_port, "--position-port", position_port
    report = cli("stream", "static_bench", "--duration", "1", "--speed", "4", *ports, "--json").tree
    assert report["simulated_s"] == pytest.approx(1.0, abs=0.01)
    assert report["wall_s"] >= 0.249
    assert 0 <= report["late_median_us"] <= report["late_p99_us"] <= report["late_max_us"]


def test_people_are_told_where_it_goes_and_how_it_went(cli, listening):
    """The first line names receiver and ports, the last ones lateness and whether the engine kept up."""
    data_port, position_port = listening
    ports = "--data-port", data_port, "--position-port", position_port
    lines = cli("stream", "static_bench", "--duration", "0.1", "--speed", "10", *ports).out.splitlines()
    assert lines[0] == f"streaming static_bench to 127.0.0.1, ports {data_port} and {position_port}"
    assert lines[1] == "done: static_bench to 127.0.0.1"
    assert [line.split("  ")[1] for line in lines[2:]] == [
        "beam",
        "noise",
        "data packets",
        "position packets",
        "simulated",
        "revolutions",
        "lateness",
        "fell behind",
        "range error",
    ]


def test_ctrl_c_ends_a_stream(program, listening):
    """Ctrl-C exits with 130 and reports what was sent."""
    data_port, position_port = listening
    ports = "--data-port", data_port, "--position-port", position_port
    process = program("stream", "static_bench", "--duration", "3600", *ports, "--json")
    for _ in range(600):
        if listening[data_port]:
            break
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert (process.returncode, err) == (130, "")
    report = json.loads(out)
    assert report["interrupted"] is True
    assert report["packets"] == len(next(iter(settled(listening))))


def test_an_address_that_is_not_ours_is_refused(cli):
    """--as-sensor on a machine without the sensor's address is one line, before any forest is grown."""
    outcome = cli("stream", "birch_walk", "--as-sensor")
    assert outcome.code == 2
    assert outcome.err.startswith("error: 192.168.1.201:")


def test_an_unknown_host_is_refused(cli):
    """A name that cannot be resolved is one line (RFC 6761, section 6.4: .invalid never exists)."""
    outcome = cli("stream", "static_bench", "--to", "nobody.invalid")
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)
