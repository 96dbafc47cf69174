"""Streams that are looked on: nothing waits for the page, and nothing of the packets changes."""

import multiprocessing
import os
import signal
import socket
import urllib.request
from contextlib import ExitStack, nullcontext, suppress
from types import SimpleNamespace

import numpy as np
import pytest
from listening import MemorySink, opened, port_of

pytest.importorskip("viser", reason="the extra viewer is not installed")

from vlp16emu import Emulator
from vlp16emu.cli.app import run
from vlp16emu.extras.viewer.guard import guarded_server
from vlp16emu.extras.viewer.live import Glimpse, LivePage, WatchedSink, backdrop_of, offer, take, watching
from vlp16emu.packets import DATA_BYTES
from vlp16emu.sinks import Pacer
from vlp16emu.types import PacketKind


@pytest.fixture(scope="module")
def emulator():
    return Emulator("static_bench", {"duration_s": 0.3})


@pytest.fixture
def ends():
    both = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    yield both
    for end in both:
        end.close()


def test_a_reader_that_hangs_costs_messages_and_no_time(ends):
    """Once the way is full, messages are lost; those before come whole and in order, then the end; to offer then is no error."""
    ours, theirs = ends
    for number in range(5_000):
        offer(ours, (number, bytes(1_000)))
    ours.close()
    came = [number for number, _ in until_the_end(theirs)]
    assert came == list(range(len(came)))
    assert 10 < len(came) < 1_000
    offer(theirs, "anything")


def until_the_end(end):
    with suppress(EOFError):
        while True:
            yield take(end)


def test_packets_pass_as_they_are(emulator, ends):
    """With somebody who looks on, the same packets come in the same order; glimpses hold data packets and their poses."""
    ours, theirs = ends
    plain = list(emulator.packets())
    listed = MemorySink()
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


def test_points_are_drawn_by_their_range_above_the_stand(emulator, ends, monkeypatch):
    """Once somebody looks on, the page has the hall, and the points of the last turn in the colours of their range."""
    ours, theirs = ends
    watched = WatchedSink(MemorySink(), Pacer(1.0), emulator, ours)
    for packet in emulator.packets():
        watched.send(packet)
    ours.close()
    camera = SimpleNamespace(position=np.zeros(3), look_at=np.ones(3))
    with guarded_server("127.0.0.1", 0, "test") as server:
        client = SimpleNamespace(camera=camera, atomic=nullcontext)
        monkeypatch.setattr(server, "get_clients", lambda: {0: client})
        monkeypatch.setattr("vlp16emu.extras.viewer.live._DRAW_S", 1e-3)
        LivePage(server, backdrop_of(emulator, 0.3)).run(theirs)
        drawn = server.scene._handle_from_node_name
        assert any(name.startswith("/stand/") for name in drawn)
        points = drawn["/sweep"]
        assert len(points.points) > 5_000
        assert len(np.unique(points.colors, axis=0)) > 20
    np.testing.assert_allclose(
        camera.look_at, emulator.world_T_sensor(np.array([emulator.scenario.start_ns]))[0, :3, 3]
    )


def test_a_page_that_is_stopped_or_killed_costs_no_packet():
    """The page answers; while its process is stopped, and once it is killed, every packet leaves, and the stream ends."""
    with ExitStack() as stack:
        data, position = (port_of(stack.enter_context(opened())) for _ in range(2))
        ports = {"sensor.data_port": data, "sensor.position_port": position}
        emulator = Emulator("static_bench", {"duration_s": 0.6} | ports)
        packets = list(emulator.packets())
        with watching(emulator, backdrop_of(emulator, 0.6)) as watch:
            with urllib.request.urlopen(watch.url) as answer:
                assert answer.status == 200
            page = next(one for one in multiprocessing.active_children() if one.name == "page")
            os.kill(page.pid, signal.SIGSTOP)
            streamed = emulator.stream(watched=watch.sink)
            page.kill()
            page.join()
            sink = watch.sink(listed := MemorySink(), Pacer(1.0))
            for packet in packets:
                sink.send(packet)
        assert "page" not in [one.name for one in multiprocessing.active_children()]
    assert streamed.packets == sum(packet.kind is PacketKind.DATA for packet in packets)
    assert not streamed.interrupted
    assert len(listed.packets) == len(packets) > 400


def test_without_the_extra_one_line_names_it(capsys, monkeypatch):
    """Where viser is missing, `--view` ends with exit code 2 and the extra to install."""
    monkeypatch.setattr("vlp16emu.cli.stream.find_spec", lambda _: None)
    assert run(["stream", "static_bench", "--view", "--duration", "0.1"]) == 2
    assert "viewer" in capsys.readouterr().err


def test_a_live_scene_wants_poses(capsys):
    """Without them a stream with a page is refused in one line."""
    assert run(["stream", "static_bench", "--set", 'motion={kind="live"}', "--duration", "1", "--view"]) == 2
    assert '--pose-in: found motion.kind = "live" without it' in capsys.readouterr().err
