"""A sensor without packets, whose rotor takes a step at each look, behind its web interface."""

import http.client
import json
import socket
from dataclasses import replace
from types import SimpleNamespace

import pytest
from hypothesis import settings

from vlp16emu.extras.bench.device import Device, DeviceInfo, DeviceSettings, DeviceStatus
from vlp16emu.extras.bench.web import WebServer
from vlp16emu.hosts import bound
from vlp16emu.types import PpsState, SensorModel
from vlp16emu.units import S_NS

settings.register_profile("long", max_examples=10_000)  # pytest --hypothesis-profile=long tests/extras/bench

INFO = DeviceInfo("11001000000001", SensorModel.VLP_16, bytes.fromhex("607688380001"))


class Engine:
    """Stands for the stream: keeps what it is given, and turns its rotor by 20 rpm towards it at each
    look."""

    def __init__(self):
        self.settings, self.changes, self.resets = DeviceSettings(), [], []
        self.is_up = True
        self.now = DeviceStatus(
            t_ns=1_779_267_600 * S_NS,
            pps=PpsState.LOCKED,
            position="49 00.00N 200 .00W",
            motor_rpm=600.0,
            motor_on=True,
            phase_locked=False,
            phase_cdeg=30_755,
            laser_on=True,
            powered_for_s=3600.0,
        )

    def changed(self, _before, after, *, restarts):
        self.settings = after
        (self.resets if restarts else self.changes).append(after)

    def status(self):
        """Turn the rotor by a step, and look."""
        missing_rpm = self.settings.rpm - self.now.motor_rpm
        self.now = replace(
            self.now,
            motor_rpm=self.now.motor_rpm + max(min(missing_rpm, 20.0), -20.0),
            laser_on=self.settings.laser,
        )
        return self.now


@pytest.fixture
def make(tmp_path):
    def made(*, saved=None, factory=None):
        engine = Engine()
        what = {
            "status": engine.status,
            "is_up": lambda: engine.is_up,
            "on_change": engine.changed,
            "info": INFO,
        }
        device = Device(factory or DeviceSettings(), saved=saved, **what)
        engine.settings = device.settings
        return engine, device

    return made


class Client:
    """Asks as Python's own client does, on one connection that is kept."""

    def __init__(self, address):
        self._line = http.client.HTTPConnection(*address, timeout=60)

    def ask(self, method, path, body=None, headers=None):
        self._line.request(method, path, body, headers or {})
        answer = self._line.getresponse()
        return answer.status, answer.headers, answer.read()

    def get(self, path):
        status, _, body = self.ask("GET", path)
        assert status == 200
        return json.loads(body)

    def post(self, path, body):
        status, _, body = self.ask("POST", path, body)
        return status, body

    def close(self):
        self._line.close()


@pytest.fixture
def web(make, tmp_path):
    """Serve a sensor whose web interface can be made faulty."""
    engine, device = make(saved=tmp_path / "saved.json")
    bench = SimpleNamespace(
        engine=engine, device=device, fault=None, delay_s=0.0, file=tmp_path / "saved.json"
    )
    faults = {"fault": lambda: bench.fault, "delay_s": lambda: bench.delay_s}
    with WebServer(device, bound(socket.SOCK_STREAM, "127.0.0.1", 0, "--http"), **faults) as server:
        bench.server, bench.address = server, server.address
        bench.client = Client(server.address)
        yield bench
        bench.client.close()


def _spoken(address, sent, *, shut=False):
    """Send bytes, and receive all that comes until the line is closed; the segments as they arrive."""
    with socket.create_connection(address, timeout=60) as line:
        line.sendall(sent)
        if shut:
            line.shutdown(socket.SHUT_WR)
        segments = []
        try:
            while segment := line.recv(1 << 20):
                segments.append(segment)
        except ConnectionResetError:
            pass
        return segments


@pytest.fixture
def speak(web):
    return lambda sent, **how: _spoken(web.address, sent, **how)
