"""The web interface as bytes on the line, its documents against their schemas, its forms, and clients as
drivers and scripts are."""

import json
import re
import shutil
import socket
import subprocess
from dataclasses import replace
from pathlib import Path

import jsonschema
import pytest
from referencing import Registry, Resource

from vlp16emu.errors import InputError, OutputError
from vlp16emu.extras.bench.device import DeviceInfo, DeviceSettings, document
from vlp16emu.extras.bench.web import WebServer
from vlp16emu.hosts import bound
from vlp16emu.run.options import Http
from vlp16emu.types import PpsState, SensorModel

FOLDER = Path(__file__).parents[3] / "protocol" / "web"
SCHEMAS = {path.name: json.loads(path.read_text(encoding="utf-8")) for path in FOLDER.glob("*.schema.json")}
REGISTRY = Registry().with_resources((name, Resource.from_contents(tree)) for name, tree in SCHEMAS.items())
DOCUMENTS = ("settings.json", "status.json", "diag.json", "info.json", "snapshot.hdl")
OTHERS = {"laser": False, "phase_lock_deg": 0.0, "dhcp": True, "return_mode": "dual", "fov_deg": (90, 9)}


def check(tree, name):
    kind = jsonschema.Draft202012Validator
    kind.check_schema(SCHEMAS[name])
    kind(SCHEMAS[name], registry=REGISTRY, format_checker=kind.FORMAT_CHECKER).validate(tree)


def get(path, *lines):
    return "\r\n".join([f"GET {path} HTTP/1.1", "Host: 127.0.0.1", *lines, "", ""]).encode()


@pytest.mark.parametrize("name", DOCUMENTS)
def test_a_document_is_as_its_schema_says(web, name):
    """Each document has all keys of its schema, no other, with their types; also with other settings and
    another state."""
    schema = f"{name.partition('.')[0]}.schema.json"
    check(web.client.get(f"/cgi/{name}"), schema)
    web.device.adopt(lambda settings: replace(settings, **OTHERS))
    check(web.client.get(f"/cgi/{name}"), schema)
    web.engine.now = replace(web.engine.now, pps=PpsState.ABSENT, position="", phase_locked=True)
    check(web.client.get(f"/cgi/{name}"), schema)


def test_settings_are_written_as_units_do(web):
    """Numbers of speed and field of view, texts of ports and phase, words with a capital: the factory's
    settings."""
    assert web.client.get("/cgi/settings.json") == {
        "laser": "On",
        "returns": "Strongest",
        "rpm": 600,
        "fov": {"start": 0, "end": 359},
        "phaselock": {"enabled": "Off", "offset": "0"},
        "host": {"addr": "255.255.255.255", "dport": "2368", "tport": "8308"},
        "net": {"addr": "192.168.1.201", "mask": "255.255.255.0", "gateway": "192.168.1.1", "dhcp": "Off"},
    }


def test_the_status_follows_the_sensor(web):
    """Pulse, position, motor and laser are as the engine says; a speed that is set is reached in steps."""
    assert web.client.get("/cgi/status.json") == {
        "gps": {"pps_state": "Locked", "position": "49 00.00N 200 .00W"},
        "motor": {"state": "On", "rpm": 600, "lock": "Off", "phase": 30755},
        "laser": {"state": "On"},
    }
    web.client.post("/cgi/setting", "rpm=1200&laser=off")
    seen = [web.client.get("/cgi/status.json") for _ in range(40)]
    speeds = [tree["motor"]["rpm"] for tree in seen]
    assert 600 < speeds[0] < 1200 == speeds[-1]
    assert speeds == sorted(speeds)
    assert seen[0]["laser"] == {"state": "Off"}


def test_the_info_is_the_units_own(make):
    """Model, serial number and MAC are those of the unit; its image is made for the board that it runs on."""
    _, device = make()
    device.info = DeviceInfo("7", SensorModel.PUCK_HI_RES, bytes.fromhex("60768810AB01"))
    info = document("/cgi/info.json", device)
    assert (info["model"], info["serial"], info["mac_addr"]) == ("Puck Hi-Res", "7", "60-76-88-10-ab-01")
    application = info["image"]["application"]
    assert {"id": application["res1"], "timestamp": application["res2"]} == info["sysid"]["bot"]
    assert application["version"] == info["appid"]["bot"]["version"] == info["appid"]["top"]["version"]


@pytest.mark.parametrize(
    ("form", "words"),
    [
        ("setting rpm=310", "rpm: found 310, expected a whole number from 300 to 1200 in steps of 60"),
        *(
            ("setting rpm=" + text, f"rpm: found {shown}")
            for text, shown in (("0", 0), ("-600", "'-600'"), ("", "''"))
        ),
        ("setting rpm=600.0", "rpm: found '600.0', expected a whole number"),
        ("setting rpm=%D9%A6%D9%A0%D9%A0", "expected a whole number"),
        ("setting returns=Strongets", "expected Strongest or Last or Dual"),
        ("setting laser=1", "expected on or off"),
        ("setting rpm=600&laser=maybe", "laser: found 'maybe'"),
        ("setting start=3", "'start': unknown key, expected rpm or returns or laser"),
        *((f"setting {body}", "expected key=value") for body in ("rpm", "", "&".join(["rpm=300"] * 17))),
        ("setting/fov start=360", "start: found 360, expected a whole number from 0 to 359"),
        *(
            (f"setting/host addr={host}", ("the IPv4 address of a host, or 255.255.255.255"))
            for host in ("0.0.0.0", "a.org")
        ),
        ("setting/host dport=0", "dport: found 0"),
        ("setting/host tport=65536", "tport: found 65536"),
        ("setting/net mask=255.0.255.0", "a network mask"),
        ("setting/net addr=255.255.255.255", "the IPv4 address of a host"),
        ("setting/phaselock offset=36000", "from 0 to 35999"),
        ("save ", "expected submit"),
        ("save save", "expected submit"),
        ("reset submit", "expected reset_system"),
    ],
)
def test_a_bad_value_is_ignored(web, form, words):
    """As real units do: 200, and nothing changes, also of the good keys beside it; the answer says why."""
    path, _, body = form.partition(" ")
    status, answer = web.client.post(f"/cgi/{path}", body)
    tree = json.loads(answer)
    check(tree, "refusal.schema.json")
    assert status == 200
    assert words in tree["ignored"]
    assert (web.device.settings, web.engine.changes, web.engine.resets) == (DeviceSettings(), [], [])
    assert not web.file.exists()


@pytest.mark.parametrize(
    ("save", "reset"), [("submit", "reset_system"), ("data=submit", "data=reset_system")]
)
def test_save_and_reset(web, save, reset):
    """Bare words and form data do the same: what is saved is there after a reset, in a file too, what is
    not is lost."""
    web.client.post("/cgi/setting", "rpm=300")
    assert web.client.post("/cgi/save", save) == (204, b"")
    web.client.post("/cgi/setting", "rpm=1200")
    assert web.client.post("/cgi/reset", reset) == (204, b"")
    assert [settings.rpm for settings in web.engine.resets] == [300]
    assert web.client.get("/cgi/settings.json")["rpm"] == 300
    assert json.loads(web.file.read_text())["rpm"] == 300


def test_what_the_stream_cannot_follow_is_an_error(web):
    """A receiver that is out of reach gives 500 with the reason, and is not set; a reset that cannot be
    followed sets nothing either."""

    def refused(_before, settings, **_):
        raise OutputError(f"destination {settings.host}", "out of reach", "an address in reach")

    web.device._on_change = refused
    status, answer = web.client.post("/cgi/setting/host", "addr=10.0.0.7")
    assert (status, json.loads(answer)) == (
        500,
        {"error": "destination 10.0.0.7: out of reach; expected an address in reach"},
    )
    assert web.client.get("/cgi/settings.json")["host"]["addr"] == "255.255.255.255"
    web.device.adopt(lambda settings: replace(settings, rpm=300))
    assert web.client.post("/cgi/reset", "reset_system")[0] == 500
    assert web.device.settings.rpm == 300


def test_what_cannot_be_saved_is_an_error(web):
    """A disk that takes no file gives 500 and the reason, and the interface lives on."""
    web.file.mkdir()
    web.device.adopt(lambda settings: replace(settings, rpm=300))
    status, answer = web.client.post("/cgi/save", "submit")
    check(json.loads(answer), "refusal.schema.json")
    assert status == 500
    assert "saved.json" in json.loads(answer)["error"]
    assert web.client.get("/cgi/settings.json")["rpm"] == 300
    assert web.device.power_up == DeviceSettings()


@pytest.mark.parametrize(
    "sent",
    [
        *(get(f"/cgi/{name}", "Connection: close") for name in DOCUMENTS),
        get("/", "Connection: close"),
        get("/nothing", "Connection: close"),
        b"POST /cgi/setting HTTP/1.1\r\nHost: x\r\nContent-Length: 7\r\nConnection: close\r\n\r\nrpm=300",
        (
            b"POST /cgi/setting HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 7\r\nConnection: "
            b"close\r\n\r\nrpm=300"
        ),
        (
            b"POST /cgi/setting HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 7\r\nConnection: "
            b"close\r\n\r\nrpm=abc"
        ),
        b"PUT / HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n",
        b"\x00\x01\r\n\r\n",
        b"GET / HTTP/1.0\r\n\r\n",
    ],
)
def test_every_answer_has_its_length_and_leaves_in_one_piece(speak, sent):
    """HTTP/1.1, `Content-Length: ` in this spelling with the true length, a type, no chunks; one segment;
    then the line is closed."""
    (segment,) = speak(sent)
    head, _, body = segment.partition(b"\r\n\r\n")
    lines = head.decode().split("\r\n")
    assert lines[0].startswith("HTTP/1.1 ")
    assert f"Content-Length: {len(body)}" in lines
    assert "Connection: close" in lines
    assert "transfer-encoding" not in head.decode().lower()
    page = sent.startswith(b"GET / ")
    assert ("Content-Type: text/html; charset=utf-8" if page else "Content-Type: application/json") in lines
    assert page or b"204" in head or json.loads(body)


def test_an_answer_to_head_has_no_body(speak):
    """HEAD gives the header lines of GET, the length among them."""
    (segment,) = speak(b"HEAD /cgi/info.json HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n")
    whole = b"".join(speak(get("/cgi/info.json", "Connection: close")))
    assert segment == whole.partition(b"\r\n\r\n")[0] + b"\r\n\r\n"


@pytest.mark.parametrize(
    ("method", "path", "status", "allow"),
    [
        ("POST", "/", 405, "GET, HEAD"),
        ("POST", "/cgi/status.json", 405, "GET, HEAD"),
        ("GET", "/cgi/setting", 405, "POST"),
        ("GET", "/cgi/reset", 405, "POST"),
        ("DELETE", "/cgi/save", 405, "POST"),
        ("OPTIONS", "/cgi/setting", 405, "POST"),
        ("GET", "/cgi", 404, None),
        ("GET", "/cgi/settings.json/", 404, None),
        ("POST", "/cgi/setting/rpm", 404, None),
        ("GET", "/favicon.ico", 404, None),
    ],
)
def test_paths_and_methods_that_are_none(web, method, path, status, allow):
    """An unknown path is 404, another method 405 with those that there are; nothing happens."""
    found, headers, body = web.client.ask(method, path, "reset_system" if method == "POST" else None)
    assert (found, headers["Allow"]) == (status, allow)
    check(json.loads(body), "refusal.schema.json")
    assert web.engine.resets == []


def test_a_sensor_that_starts_answers_nothing(web, speak):
    """After a reset, until it is up, lines are closed without a byte, those that were open too; then it
    answers again."""
    web.client.get("/cgi/info.json")
    assert web.client.post("/cgi/reset", "reset_system")[0] == 204
    web.engine.is_up = False
    assert speak(get("/cgi/info.json")) == []
    with pytest.raises(ConnectionError):
        web.client.get("/cgi/info.json")
    web.engine.is_up = True
    assert speak(get("/cgi/info.json", "Connection: close"))


def test_a_fault_of_the_web_interface(web, speak, monkeypatch):
    """A fault gives every request one status, and sets nothing; or no answer until the line is closed."""
    web.fault = 503
    status, answer = web.client.post("/cgi/setting", "rpm=300")
    assert (status, json.loads(answer)) == (503, {"error": "Service Unavailable"})
    assert web.device.settings.rpm == 600
    monkeypatch.setattr("vlp16emu.extras.bench.web.LONGEST_S", 0.2)
    web.fault = 0
    assert speak(get("/cgi/info.json")) == []
    web.fault = None
    assert speak(get("/cgi/info.json", "Connection: close"))[0].startswith(b"HTTP/1.1 200 OK")


def test_a_slow_web_interface(web, speak, monkeypatch):
    """A delay comes before each answer, is not part of the time limit of a request, and does not delay the
    end of the server."""
    monkeypatch.setattr("vlp16emu.extras.bench.web.LONGEST_S", 0.2)
    web.delay_s = 0.3
    assert speak(get("/cgi/snapshot.hdl", "Connection: close"))[0].startswith(b"HTTP/1.1 200 OK")
    web.delay_s = 60.0
    with socket.create_connection(web.address, timeout=0.3) as line:
        line.sendall(get("/cgi/snapshot.hdl"))
        with pytest.raises(TimeoutError):
            line.recv(1)


def test_a_connection_that_is_kept_open_does_not_disturb_the_end(make, caplog):
    """A client that still has its connection when the sensor goes is cut off without a word in the log."""
    _, device = make()
    with socket.socket() as line:
        with WebServer(device, bound(socket.SOCK_STREAM, "127.0.0.1", 0, "--http")) as server:
            line.connect(server.address)
            line.sendall(get("/cgi/info.json"))
            assert line.recv(65_536).startswith(b"HTTP/1.1 200 OK")
        assert line.recv(65_536) == b""
    assert caplog.records == []


def test_where_it_listens():
    """A host and a port, or a port of this machine alone; other texts are refused with an example."""
    assert Http("127.0.0.1:8080").address == ("127.0.0.1", 8080)
    assert Http("8080").address == Http(":8080").address == ("127.0.0.1", 8080)
    assert Http("0.0.0.0:80").address == ("0.0.0.0", 80)
    assert Http("[::1]:80").address == ("::1", 80)
    for text in ("host", "host:", "1.2.3.4:65536", "1.2.3.4:-1", "1.2.3.4:٨٠", "http://127.0.0.1"):
        with pytest.raises(
            InputError, match=r"--http: found .* expected HOST:PORT, such as 127\.0\.0\.1:8080"
        ):
            Http(text)


def test_a_port_that_is_taken_is_named(web):
    """A place where it cannot listen is an error of the command line."""
    host, port = web.address
    for place in (host, "192.0.2.1", "a..b"):
        with pytest.raises(
            OutputError, match=f"--http {place}:{port}: .*expected an address of this machine"
        ):
            bound(socket.SOCK_STREAM, place, port, f"--http {place}:{port}")


WANTED = {
    "config.returns": "Dual",
    "config.rpm": "1200",
    "config.fov.start": "90",
    "config.fov.end": "270",
    "config.host.addr": "127.0.0.1",
    "config.host.dport": "3000",
    "config.host.tport": "3001",
}
LONGEST_S = 10.0


class Nebula:
    """The client of tier4/nebula (http_client.hpp, velodyne_hw_interface.cpp): made by hand, with its ways.

    Of its limits only the time is another, 10 s in place of three times 500 ms: the machine may be busy.
    """

    def __init__(self, address):
        self._address, self.asked = address, []

    def request(self, method, endpoint, body=""):
        """Ask, and return as much of a body as `Content-Length: ` says, in no other spelling; the status
        is not looked at."""
        self.asked.append((endpoint, body))
        form = f"Content-Type: application/x-www-form-urlencoded\r\nContent-Length: {len(body)}\r\n"
        head = (
            f"{method} {endpoint} HTTP/1.1\r\nHost: {self._address[0]}\r\n{form if method == 'POST' else ''}"
        )
        answer, wanted = "", 1
        with socket.create_connection(self._address, timeout=LONGEST_S) as line:
            line.sendall(f"{head}Connection: close\r\n\r\n{body}".encode())
            while len(answer) < wanted:
                part = line.recv(65_536).decode()
                assert part, f"{method} {endpoint} {body}: no answer"
                answer += part
                length = re.search(r"Content-Length: (\d+)\r\n(?:.+\r\n)*\r\n", answer)
                wanted = length.end() + int(length[1]) if length else len(answer) + 1
        return answer[length.end() :]

    def configure(self, wanted):
        """Read the snapshot, and send one form of one key for each item that differs, in the order of the
        items."""
        tree = json.loads(self.request("GET", "/cgi/snapshot.hdl"))
        for key, value in wanted.items():
            if self.item(tree, key) != value:
                _, *group, name = key.split(".")
                assert self.request("POST", "/".join(["/cgi/setting", *group]), f"{name}={value}") == ""

    def item(self, tree, key):
        for name in key.split("."):
            tree = tree[name]
        return str(tree)


def test_nebula_configures_every_item(web):
    """One form per item that differs, in its order; read back they are all set; a second time there is
    nothing to set."""
    nebula = Nebula(web.address)
    nebula.configure(WANTED)
    assert nebula.asked == [
        ("/cgi/snapshot.hdl", ""),
        ("/cgi/setting", "returns=Dual"),
        ("/cgi/setting", "rpm=1200"),
        ("/cgi/setting/fov", "start=90"),
        ("/cgi/setting/fov", "end=270"),
        ("/cgi/setting/host", "addr=127.0.0.1"),
        ("/cgi/setting/host", "dport=3000"),
        ("/cgi/setting/host", "tport=3001"),
    ]
    tree = json.loads(nebula.request("GET", "/cgi/snapshot.hdl"))
    assert {key: nebula.item(tree, key) for key in WANTED} == WANTED
    assert web.engine.settings == DeviceSettings(
        rpm=1200, return_mode="dual", fov_deg=(90, 270), host="127.0.0.1", data_port=3000, position_port=3001
    )
    assert len(web.engine.changes) == 7
    nebula.configure(WANTED)
    assert len(web.engine.changes) == 7


FORMS = {
    "setting rpm=1200&returns=Dual&laser=off": {"rpm": 1200, "return_mode": "dual", "laser": False},
    "setting laser=on": {},
    "setting/fov start=350&end=10": {"fov_deg": (350, 10)},
    "setting/host addr=10.0.0.7&dport=4000&tport=4001": {
        "host": "10.0.0.7",
        "data_port": 4000,
        "position_port": 4001,
    },
    "setting/net addr=127.0.0.2&mask=255.0.0.0": {"address": "127.0.0.2", "mask": "255.0.0.0"},
    "setting/net gateway=127.0.0.1&dhcp=on": {"gateway": "127.0.0.1", "dhcp": True},
    "setting/phaselock enabled=on&offset=12345": {"phase_lock_deg": 123.45, "phase_lock_cdeg": 12_345},
}


def by_curl(web, path, body):
    """The manual's own way, which pycurl and the ROS configuration node share."""
    data = [word for item in body.split("&") for word in ("--data-urlencode", item)]
    curl = ["curl", "--silent", "--show-error", "--noproxy", "*", "--max-time", "5"]
    url = "http://{}:{}{}".format(*web.address, path)
    said = subprocess.check_output([*curl, "--write-out", "%{http_code}", *data, url])
    return int(said[-3:]), said[:-3]


CLIENTS = {"http.client": lambda web, path, body: web.client.post(path, body), "curl": by_curl}


@pytest.mark.parametrize("client", CLIENTS)
@pytest.mark.parametrize(("form", "values"), FORMS.items())
def test_a_form_sets_its_values(web, client, form, values):
    """Each is answered 204 without body, changes what it names and nothing else, and the stream hears of
    it once."""
    if client == "curl" and not shutil.which("curl"):
        pytest.skip("curl is not installed")
    path, body = form.split()
    assert CLIENTS[client](web, f"/cgi/{path}", body) == (204, b"")
    wanted = replace(DeviceSettings(), **values)
    assert web.device.settings == wanted
    assert web.engine.changes == ([wanted] if wanted != DeviceSettings() else [])
