"""Settings that come from the web interface while a stream is sent."""

import json
import threading
import urllib.error
import urllib.request

import numpy as np
import pytest
from listening import opened, port_of

from vlp16emu import Emulator
from vlp16emu.extras.bench.options import Http
from vlp16emu.scenario import load
from vlp16emu.types import PacketKind

pytestmark = pytest.mark.usefixtures("kept_woods")

HALL = {"kind": "hall", "length_m": 20.0, "width_m": 16.0, "height_m": 5.0}
TABLES = {
    "schema": 1,
    "seed": 5,
    "duration_s": 30.0,
    "beam": {"model": "none"},
    "motion": {"kind": "static"},
    "world": HALL,
}


class Receiver:
    """Two sockets that a stream is sent to; payloads in order of arrival, by kind."""

    def __init__(self):
        self.sockets = [opened(), opened()]
        self.ports = [port_of(one) for one in self.sockets]

    def data(self, wanted):
        """Receive data packets until one is wanted; give all of them."""
        payloads = []
        while not payloads or not wanted(payloads[-1]):
            payloads.append(self.sockets[0].recv(2048))
        return payloads

    def rest(self):
        """Receive what is there."""
        payloads = []
        self.sockets[0].settimeout(0.3)
        try:
            while True:
                payloads.append(self.sockets[0].recv(2048))
        except TimeoutError:
            return payloads

    def close(self):
        """Close both."""
        for one in self.sockets:
            one.close()


class Live:
    """A stream in a thread of its own with its web interface, until it is left."""

    def __init__(self, receiver, tables=TABLES, **options):
        data_port, position_port = receiver.ports
        sensor = {**tables.get("sensor", {}), "data_port": data_port, "position_port": position_port}
        self.emulator = Emulator(load({**tables, "sensor": sensor}), threads=1)
        self.stop, self.up, self.places = threading.Event(), threading.Event(), []
        self.streamed = None
        self.thread = threading.Thread(target=self._run, kwargs=options)

    def _run(self, saved=None, **options):
        http = Http("127.0.0.1:0", saved, self._serving)
        self.streamed = self.emulator.stream(http=http, stop=self.stop, **options)

    def _serving(self, places):
        self.places = places
        self.up.set()

    def __enter__(self):
        self.thread.start()
        assert self.up.wait(240)
        return self

    def __exit__(self, *_error):
        self.stop.set()
        self.thread.join(30)

    def get(self, path):
        """Read a document."""
        host, port = self.places[0]
        with urllib.request.urlopen(f"http://{host}:{port}{path}", timeout=30) as answer:
            return json.load(answer)

    def post(self, path, body):
        """Set something; give the status of the answer."""
        host, port = self.places[0]
        request = urllib.request.Request(f"http://{host}:{port}{path}", body.encode(), method="POST")
        with urllib.request.urlopen(request, timeout=30) as answer:
            return answer.status


@pytest.fixture
def receiver():
    """Somebody who listens."""
    both = Receiver()
    yield both
    both.close()


def stamps_us(payloads):
    """Time stamps of data packets."""
    return np.array([int.from_bytes(payload[1200:1204], "little") for payload in payloads])


def test_a_return_mode_is_followed_without_a_gap(receiver, tmp_path):
    """Packets are of the new mode from an instant on; stamps go on, and the run repeats byte for byte from its truth."""
    with Live(receiver, truth=tmp_path / "t") as live:
        before = receiver.data(lambda payload: True)
        assert live.post("/cgi/setting", "returns=Dual") == 204
        payloads = before + receiver.data(lambda payload: payload[1204] == 0x39)
        assert live.get("/cgi/settings.json")["returns"] == "Dual"
        payloads += [receiver.sockets[0].recv(2048) for _ in range(500)]
    payloads += receiver.rest()
    assert set(np.diff(stamps_us(payloads)).tolist()) <= {663, 664, 1327, 1328}
    scenario = load(str(tmp_path / "t" / "scenario.json"))
    assert [event.kind for event in scenario.events] == ["setting"]
    again = [p.payload for p in Emulator(scenario).packets() if p.kind is PacketKind.DATA]
    assert again[: len(payloads)] == payloads[: len(again)]
    assert not live.streamed.sent.skipped["data"]


def azimuths(payload):
    """Azimuths of a data packet, in 0.01 degrees."""
    blocks = np.frombuffer(payload[:1200], np.uint8).reshape(12, 100).astype(int)
    return blocks[:, 2] + 256 * blocks[:, 3]


def test_speed_laser_and_field_of_view_are_followed(receiver):
    """The rotor runs up, packets cease without laser, and azimuths stay in the field of view."""
    with Live(receiver) as live:
        live.post("/cgi/setting", "rpm=1200")
        receiver.data(lambda payload: 50 < np.median(np.diff(azimuths(payload))) < 100)
        assert live.get("/cgi/status.json")["motor"]["rpm"] > 700
        live.post("/cgi/setting/fov", "start=100&end=200")
        inside = 0
        while inside < 100:  # packets, some seven turns of what is left of them
            degrees = azimuths(receiver.sockets[0].recv(2048)) // 100
            inside = inside + 1 if ((degrees >= 100) & (degrees <= 200)).all() else 0
        live.post("/cgi/setting", "laser=off")
        receiver.rest()
        receiver.sockets[1].settimeout(30.0)
        receiver.sockets[1].recv(2048)
        with pytest.raises(TimeoutError):
            receiver.sockets[0].recv(2048)
        live.post("/cgi/setting", "laser=on")
        receiver.sockets[0].settimeout(30.0)
        receiver.data(lambda payload: True)


def test_another_receiver_gets_the_packets(receiver):
    """Packets go to the host and ports that are set, and no more to those before."""
    other = Receiver()
    with Live(receiver) as live:
        receiver.data(lambda payload: True)
        live.post("/cgi/setting/host", f"dport={other.ports[0]}&tport={other.ports[1]}")
        other.data(lambda payload: True)
        receiver.rest()
        assert len(other.sockets[0].recv(2048)) == 1206
        other.sockets[1].settimeout(30.0)
        assert len(other.sockets[1].recv(2048)) == 512
    other.close()


def test_events_of_the_scene_show_in_the_web_interface(receiver):
    """What an event has set is among the settings, and an error of the web interface is the answer while it lasts."""
    events = [
        {"kind": "setting", "at_s": 0.5, "return_mode": "dual", "phase_lock_deg": 90.0},
        {"kind": "http_error", "at_s": 1.5, "status": 503},
    ]
    with Live(receiver, {**TABLES, "events": events}) as live:
        receiver.data(lambda payload: payload[1204] == 0x39)
        live.get("/cgi/status.json")
        settings = live.get("/cgi/settings.json")
        assert settings["returns"] == "Dual"
        assert settings["phaselock"] == {"enabled": "On", "offset": "9000"}
        first_us = stamps_us(receiver.data(lambda payload: True))[-1]
        receiver.data(lambda payload: int.from_bytes(payload[1200:1204], "little") > first_us + 1_200_000)
        with pytest.raises(urllib.error.HTTPError, match="503"):
            live.get("/cgi/status.json")


def test_a_stream_to_this_machine_is_sent_to_no_other(receiver):
    """The web interface refuses a receiver on another machine, and the packets stay here."""
    with Live(receiver) as live:
        with pytest.raises(urllib.error.HTTPError, match="500"):
            live.post("/cgi/setting/host", "addr=192.0.2.77")
        assert live.get("/cgi/settings.json")["host"]["addr"] == "127.0.0.1"
        now_us = stamps_us(receiver.data(lambda payload: True))[-1]
        receiver.data(lambda payload: int.from_bytes(payload[1200:1204], "little") > now_us + 500_000)


def test_a_reset_loses_what_was_not_saved(receiver, tmp_path):
    """After a reset all is silent, the web too; then the saved settings hold, the clock begins anew, and they hold in the next run."""
    with Live(receiver, saved=tmp_path / "saved.json") as live:
        live.post("/cgi/setting", "returns=Last")
        live.post("/cgi/save", "data=submit")
        live.post("/cgi/setting", "returns=Dual")
        receiver.data(lambda payload: payload[1204] == 0x39)
        live.post("/cgi/reset", "data=reset_system")
        receiver.rest()
        with pytest.raises((OSError, ValueError)):
            live.get("/cgi/status.json")
        receiver.sockets[0].settimeout(30.0)
        payload = receiver.sockets[0].recv(2048)
        assert payload[1204] == 0x38
        assert int.from_bytes(payload[1200:1204], "little") < 100_000
        assert live.get("/cgi/settings.json")["returns"] == "Last"
    with Live(receiver, saved=tmp_path / "saved.json") as live:
        receiver.data(lambda payload: payload[1204] == 0x38)
        assert live.get("/cgi/settings.json")["returns"] == "Last"
