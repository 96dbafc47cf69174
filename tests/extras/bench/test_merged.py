"""Clients that ask for more than can be done: what comes together is one, and the engine works on."""

import socket
import threading
from dataclasses import replace
from types import SimpleNamespace

import pytest

from vlp16emu import Emulator
from vlp16emu.extras.bench import control as module
from vlp16emu.extras.bench.control import Control
from vlp16emu.extras.bench.gps_in import GpsReader
from vlp16emu.extras.live.flight import PoseReceiver
from vlp16emu.extras.live.pose_packet import pack_pose
from vlp16emu.units import S_NS

LEVEL = (0.0, 0.0, 0.0, 1.0)


class Stream:
    """A stream at its first packet, whose engine makes packets as far ahead as is said."""

    def __init__(self, engine):
        self.start_ns = engine.scenario.start_ns
        self.made_until_ns, self.changes, self.changed = self.start_ns, [], threading.Semaphore(0)

    def due_in_ns(self, ahead_ns):
        return self.start_ns + ahead_ns

    def redo(self, due_ns, restart):
        restart(due_ns)
        self.changes.append(due_ns)
        self.changed.release()


@pytest.fixture
def bench(each_unit, monkeypatch):
    """Settings of a sensor, its stream, and the engines that have been begun again with."""
    monkeypatch.setattr(module, "_MERGE_WAIT_S", 3600.0)
    monkeypatch.setattr(module, "_PROMPT_CHANGES", 1)
    engine = Emulator(each_unit, ["gps.connected=true"]).engine
    feed = SimpleNamespace(
        engine=engine, begun=[], begin_again=lambda _due_ns, again: feed.begun.append(again)
    )
    stream, sink = Stream(engine), SimpleNamespace(address="127.0.0.1", redirect=lambda *_: None)
    control = Control(feed, sink, stream, None)
    with control.follow_settings():
        yield SimpleNamespace(device=control.devices[0], stream=stream, feed=feed)


def test_a_hundred_settings_are_two_changes(bench):
    """The first is followed at once; the 99 that come before its packets are made ahead are one change,
    where those packets end."""
    bench.device.change(lambda settings: replace(settings, rpm=300))
    assert bench.stream.changed.acquire(timeout=60)
    for number in range(99):
        bench.device.change(
            lambda settings, n=number: replace(settings, rpm=300 + 60 * (n % 10 + 1), fov_deg=(n, 350))
        )
    bench.device.change(lambda settings: replace(settings, return_mode="dual"))
    assert len(bench.stream.changes) == 1
    bench.stream.made_until_ns += 2 * S_NS
    assert bench.stream.changed.acquire(timeout=60)
    first, second = bench.feed.begun[-1].scenario.events
    assert (first.kind, first.rpm, second.kind) == ("setting", 300, "setting")
    assert (second.rpm, second.fov_deg, second.return_mode, second.laser) == (840, (98, 350), "dual", None)
    assert bench.stream.changes[1:] == [bench.stream.made_until_ns]


def test_a_restart_among_settings_loses_those_before_it(bench):
    """Settings before and after a restart, in one change: power is lost once, and what was set since holds
    from power-up."""
    bench.device.change(lambda settings: replace(settings, rpm=300))
    assert bench.stream.changed.acquire(timeout=60)
    bench.device.change(lambda settings: replace(settings, rpm=1200))
    bench.device.restart()
    bench.device.change(lambda settings: replace(settings, laser=False))
    bench.stream.made_until_ns += 2 * S_NS
    assert bench.stream.changed.acquire(timeout=60)
    _, lost, setting = bench.feed.begun[-1].scenario.events
    assert (lost.kind, setting.kind, setting.at_s) == ("power_cycle", "setting", lost.at_s + lost.off_s)
    assert (setting.laser, setting.rpm) == (False, None)


def test_a_flood_of_poses_is_one_pose():
    """If 100 datagrams wait, every second of them noise, only the last pose is handed on, and the noise is
    counted."""
    put, there = [], threading.Event()

    def take(*pose):
        put.append(pose)
        there.set()

    receiver = PoseReceiver("udp://127.0.0.1:0", take)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for number in range(50):
            for payload in (pack_pose((number, 0.0, 0.0), LEVEL, number), b"noise"):
                sender.sendto(payload, ("127.0.0.1", int(receiver.where.rpartition(":")[2])))
    with receiver:
        assert there.wait(60)
    assert put == [((49.0, 0.0, 0.0), LEVEL, 49)]
    assert receiver.malformed == 50


def test_characters_that_come_one_by_one_are_taken_together(monkeypatch):
    """A receiver that sends byte by byte is listened to once in a while; each time all that has come is
    read at once."""
    reader, waited = object.__new__(GpsReader), []
    looks = iter([(b"$GP", False, 1), (b"RMC", False, 2), None])
    heard = []

    def use(_look):
        if (found := next(looks)) is None:
            reader._over.set()
        return found

    reader._pulse, reader._over = None, threading.Event()
    reader._port = SimpleNamespace(use=use, close=lambda: None)
    reader.line = SimpleNamespace(receive=lambda data, at_ns: heard.append((data, at_ns)))
    monkeypatch.setattr(reader._over, "wait", waited.append)
    reader._run()
    assert heard == [(b"$GP", 1), (b"RMC", 2)]
    assert len(waited) == 3
    port = SimpleNamespace(in_waiting=5, read=lambda count: b"123456"[:count])
    assert reader._poll(port)[0] == b"1" + b"12345"
