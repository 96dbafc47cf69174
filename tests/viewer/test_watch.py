"""Streams that are looked on: nothing waits for the page, and nothing of the packets changes."""

import multiprocessing
import os
import signal
import socket
import struct
import urllib.request
from contextlib import suppress

import numpy as np
import pytest

pytest.importorskip("viser", reason="the extra viewer is not installed")

from vlp16emu import Emulator
from vlp16emu.cli.app import run
from vlp16emu.packets import DATA_BYTES
from vlp16emu.sinks import Channel, Pacer, PacketSink
from vlp16emu.types import PacketKind
from vlp16emu.viewer.stroll import Stroll, gamepad_on
from vlp16emu.viewer.watch import Glimpse, WatchedSink, backdrop_of, watching


class Listed(PacketSink):
    """Keeps packets."""

    def __init__(self):
        self.packets = []

    def send(self, packet):
        """Keep one."""
        self.packets.append(packet)


@pytest.fixture(scope="module")
def emulator():
    return Emulator("static_bench", {"duration_s": 0.3})


@pytest.fixture
def ends():
    both = Channel.pair()
    yield both
    for end in both:
        end.close()


def test_a_reader_that_hangs_costs_messages_and_no_time(ends):
    """Once the way is full, messages are lost; those before come whole and in order, then the end."""
    ours, theirs = ends
    sent = [number for number in range(5_000) if ours.offer((number, bytes(1_000)))]
    assert 10 < len(sent) < 1_000
    ours.close()
    assert [number for number, _ in until_the_end(theirs)] == sent


def test_a_page_that_is_gone_takes_nothing(ends):
    """To offer to a closed end is no error."""
    ours, theirs = ends
    theirs.close()
    assert not ours.offer("anything")


def until_the_end(channel):
    """Take all messages."""
    with suppress(EOFError):
        while True:
            yield channel.take()


def test_packets_pass_as_they_are(emulator, ends):
    """With somebody who looks on, the same packets come in the same order; glimpses hold data packets and their poses."""
    ours, theirs = ends
    plain = list(emulator.packets())
    listed = Listed()
    watched = WatchedSink(listed, Pacer(1.0), emulator, ours)
    for packet in plain:
        watched.send(packet)
    assert [id(packet) for packet in listed.packets] == [id(packet) for packet in plain]
    ours.close()
    glimpses = list(until_the_end(theirs))
    data = [packet for packet in plain if packet.kind is PacketKind.DATA]
    seen = b"".join(glimpse.payloads for glimpse in glimpses)
    assert len(seen) > 100 * DATA_BYTES
    assert b"".join(packet.payload for packet in data).startswith(seen)
    for glimpse in glimpses:
        assert isinstance(glimpse, Glimpse)
        assert len(glimpse.world_T_sensor) == len(glimpse.since_ns) == len(glimpse.payloads) // DATA_BYTES
    assert glimpses[0].since_ns[0] == 0


def test_the_page_is_served_and_ends_with_the_stream(emulator, ends):
    """It answers while the context is open, nothing waits when its process is killed, and no process is left."""
    with watching(emulator, backdrop_of(emulator, 0.3)) as watch:
        with urllib.request.urlopen(watch.url) as answer:
            assert answer.status == 200
        page = next(one for one in multiprocessing.active_children() if one.name == "page")
        page.kill()
        page.join()
        listed, packets = Listed(), list(emulator.packets())
        sink = watch.sink(listed, Pacer(1.0))
        for packet in packets:
            sink.send(packet)
        assert len(listed.packets) == len(packets) > 200
    assert "page" not in [one.name for one in multiprocessing.active_children()]


def test_a_page_that_is_stopped_costs_no_packet():
    """While the process of the page is stopped (SIGSTOP), every packet of a stream leaves, and the stream ends."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as data,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        for one in (data, other):
            one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
            one.bind(("127.0.0.1", 0))
        ports = {"data_port": data.getsockname()[1], "position_port": other.getsockname()[1]}
        emulator = Emulator(
            "static_bench", {"duration_s": 0.6} | {f"sensor.{key}": port for key, port in ports.items()}
        )
        with watching(emulator, backdrop_of(emulator, 0.6)) as watch:
            page = next(one for one in multiprocessing.active_children() if one.name == "page")
            os.kill(page.pid, signal.SIGSTOP)
            streamed = emulator.stream(watched=watch.sink)
        assert not page.is_alive()
    assert streamed.packets == sum(packet.kind is PacketKind.DATA for packet in emulator.packets())
    assert not streamed.interrupted


def walked(*keys, seconds=5.0, slope=0.0):
    """Place and heading after keys and some seconds of walking."""
    stroll = Stroll(np.array([[0.0, 0.0], [50.0, 0.0]]), lambda x, y: slope * x, 5)
    for key in keys:
        stroll.press(key)
    for _ in range(round(seconds * 100)):
        stroll.step(0.01)
    return stroll.pose()


def test_keys_walk_where_they_say():
    """Three keys ahead are 1.2 m/s to the east, six to the left then lead north; without a key nobody moves; the pack stays 2 m over the ground."""
    place_m, _ = walked("faster", "faster", "faster", slope=0.1)
    assert place_m[0] == pytest.approx(1.2 * 5 - 1.2**2 / 2 / 1.2, abs=0.15)
    assert abs(place_m[1]) < 0.1
    assert place_m[2] == pytest.approx(2.0 + 0.1 * place_m[0], abs=0.1)
    north_m, turn = walked(*["left"] * 6, "faster", "faster", "faster", seconds=8.0)
    assert north_m[1] > 6
    assert 2 * np.degrees(np.arctan2(turn[2], turn[3])) == pytest.approx(90, abs=5)
    still_m, _ = walked("faster", "stop")
    assert np.hypot(*still_m[:2]) < 0.05


def test_a_stick_leads_as_it_is_pushed():
    """Pushed ahead it walks 2 m/s to the east, half aside it turns until it is let go, at rest nobody moves, though it be a little off."""
    stroll = Stroll(np.array([[0.0, 0.0], [50.0, 0.0]]), lambda x, y: 0.0 * x, 5)

    def walk(ahead, left, seconds):
        before_m, _ = stroll.pose()
        stroll.push(ahead, left)
        for _ in range(round(seconds * 100)):
            stroll.step(0.01)
        after_m, turn = stroll.pose()
        return np.subtract(after_m, before_m), np.degrees(2 * np.arctan2(turn[2], turn[3]))

    way_m, _ = walk(1.0, 0.0, 5.0)
    assert way_m[0] == pytest.approx(2.0 * 5 - 2.0**2 / 2 / 1.2, abs=0.2)
    _, turned_deg = walk(0.0, 0.5, 2.0)
    assert turned_deg == pytest.approx(np.degrees(0.75 * 2.0), abs=12)
    _, later_deg = walk(0.1, 0.1, 3.0)
    assert later_deg == pytest.approx(turned_deg, abs=20)
    way_m, latest_deg = walk(0.1, 0.1, 3.0)
    assert np.hypot(*way_m[:2]) < 0.05
    assert latest_deg == pytest.approx(later_deg, abs=3)


def test_a_gamepad_is_read_as_linux_writes_it(tmp_path):
    """Axes 0 and 1 are the stick, of what is so at first too; another axis is none, a button stops, and so does the end of the device."""
    led = []

    class Led(Stroll):
        def push(self, ahead, left):
            led.append((round(ahead, 2), round(left, 2)))

        def press(self, what):
            led.append(what)

    events = [(0, 0x81, 0), (-32_767, 2, 1), (16_384, 2, 0), (9_000, 2, 3), (1, 1, 5), (0, 1, 5)]
    device = tmp_path / "js0"
    device.write_bytes(b"".join(struct.pack("<IhBB", 7, *event) for event in events) + b"cut")
    gamepad_on(Led(np.zeros((1, 2)), lambda x, y: 0.0 * x, 5), device)
    assert led == [(1.0, 0.0), (1.0, -0.5), "stop", (0.0, 0.0)]
    led.clear()
    gamepad_on(Led(np.zeros((1, 2)), lambda x, y: 0.0 * x, 5), tmp_path / "gone")
    assert led == [(0.0, 0.0)]


@pytest.mark.parametrize(
    ("more", "found"),
    [
        ([], "--gamepad: found without --view"),
        (["--view"], '--gamepad: found with motion.kind = "static"'),
        (["--view", "--set", 'motion={kind="live"}'], "js99: No such file or directory; expected a joystick"),
    ],
)
def test_a_gamepad_that_leads_nothing_is_refused(capsys, tmp_path, more, found):
    """Without the page, in a scene whose path is known, or where there is none: one line, exit code 2."""
    device = str(tmp_path / "js99")
    assert run(["stream", "static_bench", "--duration", "0.1", "--gamepad", device, *more]) == 2
    assert found in capsys.readouterr().err


def test_nobody_walks_out_of_the_world():
    """A walker who goes on for ever stops 30 m from where the scene expects one."""
    place_m, _ = walked(*["faster"] * 5, seconds=60.0)
    assert place_m[0] == pytest.approx(80.0, abs=0.2)


def test_without_the_extra_one_line_names_it(capsys, monkeypatch):
    """Where viser is missing, `--view` ends with exit code 2 and the extra to install."""
    monkeypatch.setattr("vlp16emu.cli.live.find_spec", lambda _: None)
    assert run(["stream", "static_bench", "--view", "--duration", "0.1"]) == 2
    assert "viewer" in capsys.readouterr().err


def test_a_live_scene_wants_poses_or_a_page(capsys):
    """Without either a stream is refused in one line that names both."""
    assert run(["stream", "static_bench", "--set", 'motion={kind="live"}', "--duration", "1"]) == 2
    found = capsys.readouterr().err
    assert "--pose-in" in found
    assert "--view" in found
