"""The simulated receiver and the inertial unit, live beside the packets; gpsd reads the receiver."""

import json
import os
import select
import shutil
import signal
import socket
import subprocess
import threading
import time
import tty
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from kit import set_words
from listening import opened, parse_rmc, port_of

from vlp16emu import Emulator
from vlp16emu.extras.bench.imu_frame import decode_imu
from vlp16emu.extras.free_ports import free_ports
from vlp16emu.motion.gnss import to_geodetic
from vlp16emu.packets import decode_position
from vlp16emu.units import S_NS

WALK = {
    "gps.connected": "true",
    "gps.canopy_loss": "false",
    "motion": '{ kind = "walk", way_points_m = [[-8.0, 5.0], [8.0, 6.0]], back_and_forth = true, laps = 50 }',
    "start_utc": "2026-06-12T08:59:58.5Z",
}
OPTIONS = set_words(WALK)
SILENT = ["--data-port", "9", "--position-port", "10"]


@pytest.fixture
def receiver():
    """A socket of the loopback."""
    with opened(240.0) as socket_of_ours:
        yield socket_of_ours


@pytest.fixture
def cable():
    """Two pseudo-terminals with all that is written to the first coming out of the second, and what
    passed."""
    masters, slaves = zip(os.openpty(), os.openpty(), strict=True)
    for slave in slaves:
        tty.setraw(slave)
        Path(os.ttyname(slave)).chmod(0o666)  # gpsd drops its rights
    passed, end, ended = bytearray(), *os.pipe()

    def carry():
        while end not in (ready := select.select([masters[0], end], [], [])[0]):
            if ready:
                passed.extend(some := os.read(masters[0], 4096))
                os.write(masters[1], some)

    thread = threading.Thread(target=carry)
    thread.start()
    yield (*map(os.ttyname, slaves), passed)
    os.close(ended)
    thread.join()
    for each in (*masters, *slaves, end):
        os.close(each)


def test_samples_leave_at_their_time(cli, receiver):
    """With --now samples arrive when they say that they were taken, by the clock of this machine, and none
    is missing."""
    arrived_ns, frames = [], []
    to = f"udp://127.0.0.1:{port_of(receiver)}"

    def listen():
        with suppress(TimeoutError):
            while len(frames) < 300:
                frames.append(decode_imu(receiver.recv(100)))
                arrived_ns.append(time.time_ns())

    thread = threading.Thread(target=listen)
    thread.start()
    outcome = cli(
        "stream", "static_bench", *SILENT, *OPTIONS, "--set", "imu.preset=consumer", "--duration", "1.5",
        "--now", "--imu-out", to, "--json",
    )  # fmt: skip
    thread.join()
    assert [int(frame["sequence"]) for frame in frames] == list(range(300))
    age_ns = np.array(arrived_ns) - [int(frame["t_ns"]) for frame in frames]
    delay_ns = outcome.tree["sent"]["delay_s"] * S_NS  # of a machine that stood still
    assert age_ns.min() > -1_000_000
    assert np.median(age_ns) < 20_000_000 + delay_ns
    moved_ns = outcome.tree["sent"]["moved_s"] * S_NS
    emulator = Emulator("static_bench", [f"{k}={v}" for k, v in WALK.items()] + ["imu.preset=consumer"])
    read = emulator.parts.imu.read(0, 300)
    assert [int(frame["t_ns"]) - moved_ns for frame in frames] == read.t_ns.tolist()
    np.testing.assert_array_equal(
        [frame["specific_force_m_s2"] for frame in frames], read.specific_force_m_s2
    )
    row = {"to": to, "messages": 300, "bytes": 21600, "dropped": 0, "away": [], "line": None, "pulses": None}
    assert (outcome.tree["imu_out"], outcome.tree["gps_out"]) == (row, None)


def test_sentences_are_those_of_the_position_packets(cli, receiver, cable):
    """Live and moved into the present, the port gives the bytes that position packets echo; the report has
    a row for it."""
    port, _, passed = cable
    position = ["--data-port", "9", "--position-port", port_of(receiver)]
    outcome = cli(
        "stream", "static_bench", *position, *OPTIONS, "--duration", "2", "--now", "--gps-out", port
    )
    assert outcome.code == 0
    assert f"sentences         2 to {port}; no pulses, as it has no line DTR" in outcome.out
    echoed, last_ns = [], 0
    receiver.settimeout(0.2)
    with suppress(TimeoutError):
        while True:
            echoed.append(decode_position(receiver.recv(1000)).sentence)
    sentences = bytes(passed).splitlines(keepends=True)
    assert list(dict.fromkeys(echoed))[-2:] == sentences
    last_ns = parse_rmc(sentences[-1]).t_ns
    assert abs(time.time_ns() - last_ns) < 10 * S_NS


def watched(port, seconds):
    """Reports of place and time that gpsd gives to its clients."""
    end_s, buffer = time.monotonic() + seconds, b""
    while time.monotonic() < end_s:
        with suppress(ConnectionRefusedError), socket.create_connection(("127.0.0.1", port), 1.0) as client:
            client.sendall(b'?WATCH={"enable":true,"json":true};\n')
            client.settimeout(0.2)
            while time.monotonic() < end_s:
                with suppress(TimeoutError):
                    buffer += client.recv(4096)
                *lines, buffer = buffer.split(b"\n")
                for report in map(json.loads, lines):
                    if report["class"] == "TPV" and report.get("mode", 0) >= 2:
                        yield report
        time.sleep(0.05)


@pytest.mark.skipif(shutil.which("gpsd") is None, reason="gpsd is not installed")
def test_gpsd_follows_the_walk(program, cable, tmp_path):
    """gpsd, on the other end of a serial cable, reports the walk's place within the receiver's errors, and
    the present time."""
    port, other_end, _ = cable
    with free_ports(1) as (tcp,):
        pass
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen([shutil.which("gpsd"), "-N", "-n", "-S", str(tcp), other_end], **quiet) as gpsd:
        try:
            running = program(
                "stream",
                "static_bench",
                *SILENT,
                *OPTIONS,
                "--duration",
                "600",
                "--now",
                "--gps-out",
                port,
                "--json",
            )
            reports = {}
            for report in watched(tcp, 300.0):
                reports[report["time"]] = report, time.time()
                if len(reports) == 2:
                    break
            running.send_signal(signal.SIGINT)
            out, _ = running.communicate()
        finally:
            gpsd.terminate()
    moved_s = json.loads(out)["sent"]["moved_s"]
    assert len(reports) == 2
    emulator = Emulator("static_bench", [f"{key}={value}" for key, value in WALK.items()])
    gps = emulator.scenario.gps
    for at, (report, heard_s) in reports.items():
        second = np.datetime64(at.removesuffix("Z"), "ns").astype(int) // S_NS
        assert 0.3 < heard_s - second < 300.0  # of the present, however late a busy machine reads it
        truth = emulator.engine.receiver.reading(int(second - moved_s) * S_NS)
        latitude_deg, longitude_deg, _ = to_geodetic(truth.measured_m[None], gps)[0]
        assert report["lat"] == pytest.approx(latitude_deg, abs=2e-8)  # 2 mm
        assert report["lon"] == pytest.approx(longitude_deg, abs=2e-8)
        assert np.linalg.norm(truth.measured_m - truth.antenna_m) < 10.0
