"""The live handle: a stream on a thread, whose program reads packets, point clouds and their ground truth."""

import signal
import socket
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from kit import DEFAULT_UNIT

import vlp16emu
from vlp16emu import Emulator, decode
from vlp16emu.errors import InputError, OutputError, RunError
from vlp16emu.extras.free_ports import free_ports
from vlp16emu.packets.layout import DATA_PAYLOAD
from vlp16emu.sinks import UdpSink
from vlp16emu.types import PacketKind

SCENE = "static_bench"
QUICK = {"look_ahead": 256}
RANGE_ERROR_M = {SCENE: 0.0011, DEFAULT_UNIT: 0.15}  # half a step of 2 mm, and five sigma of a real unit


def azimuths(payloads):
    """First azimuth of each packet, in hundredths of a degree."""
    return np.array(
        [np.frombuffer(one, DATA_PAYLOAD)["blocks"]["azimuth_cdeg"][0, 0] for one in payloads], np.int64
    )


@pytest.fixture(scope="module")
def live(each_unit):
    """A stream of the hall."""
    with vlp16emu.stream(each_unit, {"duration_s": 600.0}, **QUICK) as live:
        yield live


def test_what_is_read_is_what_the_scene_sends(each_unit, live):
    """Packets of data and of position are, from the first one on, those that the engine makes."""
    made = list(Emulator(each_unit).packets(0.0, 0.3))
    for kind in ("data", "position"):
        payloads = [packet.payload for packet in made if packet.kind is PacketKind(kind)]
        halves = live.packets(10, kind=kind), live.packets(len(payloads) - 10, kind=kind)
        assert [*halves[0], *halves[1]] == payloads


def test_a_receiver_gets_them_at_the_port_that_is_reserved(each_unit, live):
    """The ports differ, a socket can bind them, and what it receives is known with its ground truth."""
    assert live.data_port != live.position_port
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as driver:
        driver.bind(("127.0.0.1", live.data_port))
        driver.settimeout(10.0)
        payload = driver.recv(2000)
    truth = live.truth(payload)
    records = np.frombuffer(payload, DATA_PAYLOAD)["blocks"]["records"].reshape(-1)
    is_return = records["distance_lsb"] > 0
    np.testing.assert_allclose(
        truth["range_m"][is_return], records["distance_lsb"][is_return] * 0.002, atol=RANGE_ERROR_M[each_unit]
    )
    assert (truth["echo"][~is_return] == 255).all()
    assert set(truth["semantic"][is_return]) <= {1, 7}
    np.testing.assert_array_equal(truth["world_T_sensor"][:, :3, 3], np.tile([0.0, 0.0, 1.5], (384, 1)))


def test_scans_are_those_of_a_capture_with_labels(each_unit, tmp_path):
    """Revolutions of the stream are those that `decode` finds in a recording, each point with its surface
    and true range."""
    recorded = Emulator(each_unit, {"sensor.return_mode": "dual"}).record(tmp_path / "a.pcap", duration_s=0.4)
    with vlp16emu.stream(each_unit, {"sensor.return_mode": "dual"}, duration_s=0.4) as live:
        for scan, other in zip(live.scans(), decode(tmp_path / "a.pcap", clock="sensor"), strict=True):
            for name in ("xyz_m", "ring", "is_last"):
                np.testing.assert_array_equal(getattr(scan, name), getattr(other, name))
            assert np.abs(scan.t_ns - other.t_ns).max() < 1000  # stamps of a capture are whole microseconds
            np.testing.assert_allclose(scan.labels.range_m, scan.distance_m, atol=RANGE_ERROR_M[each_unit])
            assert scan.world_T_sensor.shape == (4, 4)
    assert live.stop().packets == recorded.packets


def test_settings_and_faults_hold_for_the_packets_that_follow(live):
    """After `set` the rotor goes on to the new speed; after `fault` packets are missing, and are back."""
    live.set(rpm=1200)
    steps = np.diff(azimuths(live.packets(1500))) % 36_000
    assert steps[-1] == pytest.approx(2 * 79.6 * 6, rel=0.02)  # 1327.104 us at 1200 rpm are 9.555 degrees
    live.fault("drop", count=5)
    assert max(np.diff(azimuths(live.packets(100))) % 36_000) < 1000  # they are lost before these
    with pytest.raises(InputError, match=r'event lose\.kind: found "lose"; expected "corrupt", '):
        live.fault("lose")
    with pytest.raises(
        InputError, match=r"event setting\.rpm: found 13; expected a whole number from 300 to 1200"
    ):
        live.set(rpm=13)


def test_packets_of_no_stream_are_errors(live):
    """An unknown stamp, unit, kind or count is one line; so is a wait that is too long."""
    with pytest.raises(InputError, match="packet: found no truth of its time stamp"):
        live.truth(bytes([255]) * 1206)
    with pytest.raises(InputError, match="unit: found 2"):
        live.scans(unit=2)
    with pytest.raises(InputError, match="kind: found imu"):
        live.packets(1, kind="imu")
    with pytest.raises(InputError, match="packets: found 0"):
        live.packets(0)
    with pytest.raises(RunError, match="packets have left within 0 s"):
        live.packets(2000, timeout_s=0.0)


def test_the_end_of_a_stream_is_an_error_for_who_waits_and_no_error_to_stop():
    """Packets that never leave are an error with their count; `stop` gives the report, twice."""
    with (
        vlp16emu.stream(SCENE, duration_s=0.1) as live,
        pytest.raises(RunError, match="75 of 200 packets have left before"),
    ):
        live.packets(200)
    assert live.stop() is live.stop()
    assert live.stop().packets == 75


def test_an_error_of_the_thread_is_raised_in_the_program(monkeypatch):
    """What fails while sending is raised by who reads, and by the end of the block."""

    class Failing(UdpSink):
        def send(self, packet):
            if packet.due_ns > 1779267600_100000000:
                raise RunError("the link is gone")
            super().send(packet)

    monkeypatch.setattr("vlp16emu.run.stream.UdpSink", Failing)
    with vlp16emu.stream(SCENE, **QUICK) as live, pytest.raises(RunError, match="the link is gone"):
        list(live.scans())
    with pytest.raises(RunError, match="the link is gone"), vlp16emu.stream(SCENE, **QUICK) as live:
        live._thread.join()


def test_a_stream_that_cannot_begin_is_an_error_at_once():
    """Settings, options and receivers that are wrong are errors of the call."""
    with pytest.raises(InputError, match=r"sensor\.rpm = 1: found 1"):
        vlp16emu.stream(SCENE, {"sensor.rpm": 1})
    with pytest.raises(OutputError, match="which is unknown"):
        vlp16emu.stream(SCENE, to="255.255.255.256")


def test_nothing_is_left_behind():
    """After a stream there are as many open files and threads of streams as before, and its ports are
    free."""

    def open_now():
        workers = "open_", "build_", "work_"  # they go with the scene, which others may use
        threads = [one.name for one in threading.enumerate() if not one.name.startswith(workers)]
        return len(list(Path("/proc/self/fd").iterdir())), threads

    emulator = vlp16emu.Emulator(SCENE)
    vlp16emu.Live(emulator, **QUICK).stop()
    before = open_now()
    for _ in range(3):
        with vlp16emu.Live(emulator, **QUICK) as live:
            ports = live.ports[0]
    assert open_now() == before
    for port in ports:
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as free:
            free.bind(("127.0.0.1", port))


def test_ports_that_are_held_are_not_given_again():
    """No two searches that overlap find a port twice, from whatever thread; nor one that a receiver has
    bound."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        with free_ports(1) as (port,):
            taken.bind(("127.0.0.1", port))
        all_are_held = threading.Barrier(8)

        def search(_):
            with free_ports(40) as ports:
                all_are_held.wait()
                return ports

        with ThreadPoolExecutor(8) as pool:
            found = [one for ports in pool.map(search, range(8)) for one in ports]
    assert len(set(found)) == len(found) == 320
    assert port not in found


def test_each_sensor_of_a_rig_has_ports_of_its_own():
    """A rig of two has four free ports, and packets of each."""
    with vlp16emu.stream(SCENE, {"rig": [{"mount": {"lever_arm_m": [0.3, 0.0, 0.0]}}]}, **QUICK) as live:
        assert len({port for pair in live.ports for port in pair}) == 4
        assert len(live.packets(5, unit=2)[0]) == 1206
        assert live.truth(live.packets(1, unit=2)[0], unit=2)["world_T_sensor"][0, 0, 3] == pytest.approx(0.3)


INTERRUPTED = """
import os, signal, vlp16emu
signal.signal(signal.SIGINT, signal.default_int_handler)  # shells let what runs in the background ignore it
forgotten = vlp16emu.stream("static_bench", {"duration_s": 900.0}, look_ahead=64)
with vlp16emu.stream("static_bench", look_ahead=64) as live:
    for scan in live.scans():
        os.kill(os.getpid(), signal.SIGINT)
"""


def test_ctrl_c_ends_program_and_streams():
    """An interrupt in the midst of a block is a KeyboardInterrupt of the program, which ends although
    nobody stops another stream."""
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode in (-signal.SIGINT, 130)
    assert done.stderr.rstrip().endswith("KeyboardInterrupt")


def test_a_packet_has_its_truth_as_soon_as_a_receiver_has_it(live, monkeypatch):
    """The truth of a packet is known while its datagram is being sent, as a receiver is sooner than the
    sender's own notice."""
    found, sent = [], UdpSink.send

    def send(sink, packet):
        sent(sink, packet)
        if packet.kind is PacketKind.DATA:
            with suppress(InputError):
                found.append(live.truth(packet.payload).size)
            found.append(0)

    monkeypatch.setattr(UdpSink, "send", send)
    while len(found) < 80:
        live.packets(1)
    assert found[:80] == [384, 0] * 40
