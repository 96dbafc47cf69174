"""Settings that come from the web interface while a stream is sent."""

import json
import urllib.error
import urllib.request
from threading import Event

import numpy as np
import pytest
from listening import Listener

import vlp16emu
from vlp16emu import Emulator
from vlp16emu.errors import RunError
from vlp16emu.packets.layout import DATA_PAYLOAD
from vlp16emu.run.options import Http, StreamOptions
from vlp16emu.run.part import StreamPart
from vlp16emu.run.scene_stream import SceneStream
from vlp16emu.scenario import load
from vlp16emu.types import PacketKind

HALL = {"gps.connected": True, "duration_s": 3600.0}  # longer than any of these tests on the busiest machine


def streaming(events=(), scene="static_bench", **options):
    return vlp16emu.stream(scene, HALL | {"events": list(events)}, look_ahead=256, truth=False, **options)


def get(http, path):
    """Read a document of a web interface."""
    with urllib.request.urlopen(f"{http}cgi/{path}.json", timeout=30) as answer:
        return json.load(answer)


def post(http, path, body):
    """Set something, which is answered with 204."""
    request = urllib.request.Request(f"{http}cgi/{path}", body.encode(), method="POST")
    with urllib.request.urlopen(request, timeout=30) as answer:
        assert answer.status == 204


def until(live, wanted):
    """Read data packets until one is wanted, and return it."""
    return next(payload for (payload,) in iter(lambda: live.packets(1), None) if wanted(payload))


def assert_silent(live):
    """Read the packets that are on their way until none comes for 0.4 s."""
    with pytest.raises(RunError, match="have left within"):
        until(live, lambda _: live.packets(1, timeout_s=0.4) is None)


def stamp_us(payload):
    return int.from_bytes(payload[1200:1204], "little")


def azimuths(payload):
    """Azimuths of a data packet, in 0.01 degrees."""
    return np.frombuffer(payload, DATA_PAYLOAD)["blocks"]["azimuth_cdeg"][0].astype(int)


def test_a_return_mode_is_followed_without_a_gap(each_unit, tmp_path):
    """Packets are of the new mode from an instant on; stamps go on, and the run repeats byte for byte from
    its truth."""
    data, stop, steps = Listener(), Event(), []
    ports = {"sensor.data_port": data.port, "sensor.position_port": 9}
    emulator = Emulator(each_unit, HALL | ports, threads=1)
    stream = SceneStream(emulator, StreamOptions(http=Http("127.0.0.1:0"), truth=tmp_path / "t"), stop=stop)

    class Steering(StreamPart):
        def sent(self, packet):
            done_s = (packet.due_ns - emulator.scenario.start_ns) / 1e9
            if not steps and done_s > 0.2:
                (host, port), *_ = stream.web.places
                post(f"http://{host}:{port}/", "setting", "returns=Dual")
                steps.append(get(f"http://{host}:{port}/", "settings")["returns"])
            if done_s > 1.2:
                stop.set()

    stream.add(Steering())
    report = stream.run()
    payloads = data.end()
    assert steps == ["Dual"]
    assert {payloads[0][1204], payloads[-1][1204]} == {0x37, 0x39}
    assert set(np.diff([stamp_us(payload) for payload in payloads]).tolist()) <= {663, 664, 1327, 1328}
    scenario = load(str(tmp_path / "t" / "scenario.json"))
    assert [event.kind for event in scenario.events] == ["setting"]
    again = [p.payload for p in Emulator(scenario).packets() if p.kind is PacketKind.DATA]
    assert again[: len(payloads)] == payloads[: len(again)]
    assert not report.skipped["data"]


def test_speed_laser_and_field_of_view_are_followed():
    """The rotor runs up, azimuths stay in the field of view, and without laser data packets cease and
    position packets do not."""
    with streaming() as live:
        post(live.http, "setting", "rpm=1200")
        until(live, lambda payload: 50 < np.median(np.diff(azimuths(payload))) < 100)
        assert get(live.http, "status")["motor"]["rpm"] > 700
        post(live.http, "setting/fov", "start=100&end=200")
        inside = 0
        while inside < 100:  # packets, some seven turns of what is left of them
            degrees = azimuths(live.packets(1)[0]) // 100
            inside = inside + 1 if ((degrees >= 100) & (degrees <= 200)).all() else 0
        post(live.http, "setting", "laser=off")
        assert_silent(live)
        live.packets(5, kind="position")
        post(live.http, "setting", "laser=on")
        live.packets(1)


def test_another_receiver_gets_the_packets():
    """Packets go to the host and ports that are set."""
    data, position = Listener(), Listener()
    with streaming() as live:
        post(live.http, "setting/host", f"dport={data.port}&tport={position.port}")
        assert data.came.wait(30)
        assert position.came.wait(30)
    assert [len(listener.end()[0]) for listener in (data, position)] == [1206, 512]


def test_events_of_the_scene_show_in_the_web_interface(each_unit):
    """What an event has set is among the settings, and an error of the web interface is the answer while
    it lasts."""
    events = [
        {"kind": "setting", "at_s": 0.5, "return_mode": "dual", "phase_lock_deg": 90.0},
        {"kind": "http_error", "at_s": 1.5, "status": 503},
        {"kind": "http_delay", "at_s": 1.5, "by_s": 0.01},
    ]
    with streaming(events, each_unit) as live:
        first_us = stamp_us(until(live, lambda payload: payload[1204] == 0x39))
        settings = get(live.http, "settings")
        assert settings["returns"] == "Dual"
        assert settings["phaselock"] == {"enabled": "On", "offset": "9000"}
        until(live, lambda payload: stamp_us(payload) > first_us + 1_200_000)
        with pytest.raises(urllib.error.HTTPError, match="503"):
            get(live.http, "status")


def test_a_stream_to_this_machine_is_sent_to_no_other():
    """The web interface refuses a receiver on another machine, and the packets stay here."""
    with streaming() as live:
        with pytest.raises(urllib.error.HTTPError, match="500"):
            post(live.http, "setting/host", "addr=192.0.2.77")
        assert get(live.http, "settings")["host"]["addr"] == "127.0.0.1"
        live.packets(400)


def test_a_reset_loses_what_was_not_saved(default_unit, tmp_path):
    """After a reset all is silent, the web too; then the saved settings hold, the clock begins anew, and
    they hold in the next run."""
    http = Http("127.0.0.1:0", tmp_path / "saved.json")
    with streaming(scene=default_unit, http=http) as live:
        post(live.http, "setting", "returns=Last")
        post(live.http, "save", "data=submit")
        post(live.http, "setting", "returns=Dual")
        until(live, lambda payload: payload[1204] == 0x39)
        post(live.http, "reset", "data=reset_system")
        assert_silent(live)
        with pytest.raises((OSError, ValueError)):
            get(live.http, "status")
        (payload,) = live.packets(1)
        assert payload[1204] == 0x38
        assert stamp_us(payload) < 100_000
        assert get(live.http, "settings")["returns"] == "Last"
    with streaming(http=http) as live:
        until(live, lambda payload: payload[1204] == 0x38)
        assert get(live.http, "settings")["returns"] == "Last"
