"""Clients that do what drivers and configuration scripts do, on every key."""

import json
import shutil
import socket
import subprocess
import threading
import time
import urllib.request
from dataclasses import replace

import pytest

from vlp16emu.extras.bench.device import DeviceSettings
from vlp16emu.types import ReturnMode

WANTED = {
    "config.returns": "Dual",
    "config.rpm": "1200",
    "config.fov.start": "90",
    "config.fov.end": "270",
    "config.host.addr": "127.0.0.1",
    "config.host.dport": "3000",
    "config.host.tport": "3001",
}
PATHS = {
    "config.returns": "/cgi/setting",
    "config.rpm": "/cgi/setting",
    "config.fov": "/cgi/setting/fov",
    "config.host": "/cgi/setting/host",
}
LONGEST_S = 10.0


class Nebula:
    """The client of tier4/nebula (http_client.hpp, velodyne_hw_interface.cpp): made by hand, with its ways.

    Of its limits only the time is another, 10 s in place of 500 ms: the machine may be busy.
    """

    def __init__(self, address):
        self._address, self.asked = address, []

    def request(self, method, endpoint, body=""):
        """Ask up to three times, 100 ms apart, for `LONGEST_S` each; the status is not looked at."""
        self.asked.append((endpoint, body))
        for _ in range(3):
            if (answer := self._once(method, endpoint, body)) is not None:
                return answer
            time.sleep(0.1)
        raise AssertionError(f"{method} {endpoint} {body}: no answer")

    def _once(self, method, endpoint, body):
        form = f"Content-Type: application/x-www-form-urlencoded\r\nContent-Length: {len(body)}\r\n"
        head = f"{method} {endpoint} HTTP/1.1\r\nHost: {self._address[0]}\r\n{form if method == 'POST' else ''}"
        text = ""
        with socket.create_connection(self._address, timeout=LONGEST_S) as line:
            line.sendall(f"{head}Connection: close\r\n\r\n{body}".encode())
            end_s = time.perf_counter() + LONGEST_S
            while (left_s := end_s - time.perf_counter()) > 0:
                line.settimeout(left_s)
                try:
                    text += line.recv(65_536).decode()
                except TimeoutError:
                    return None
                head_end = text.find("\r\n\r\n")
                if head_end < 0:
                    continue
                found = text.find("Content-Length: ")  # no other spelling is known; without it the body is lost
                length = int(text[found + 16 : text.find("\r\n", found)]) if found >= 0 else 0
                if len(text) >= head_end + 4 + length:
                    return text[head_end + 4 :]
        return None

    def configure(self, wanted):
        """Read the snapshot, and send one form of one key for each item that differs, in the order of the items."""
        tree = json.loads(self.request("GET", "/cgi/snapshot.hdl"))
        for key, value in wanted.items():
            if self.item(tree, key) != value:
                group, _, name = key.rpartition(".")
                path = PATHS[key] if key in PATHS else PATHS[group]
                assert self.request("POST", path, f"{name}={value}") == ""

    def item(self, tree, key):
        """Take an item of a property tree, where numbers are texts."""
        for name in key.split("."):
            tree = tree[name]
        return str(tree)


def test_nebula_configures_every_item(web):
    """One form per item that differs, in its order; read back they are all set; a second time there is nothing to set."""
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
        rpm=1200, return_mode=ReturnMode.DUAL, fov_deg=(90, 270), host="127.0.0.1", data_port=3000, position_port=3001
    )
    assert len(web.engine.changes) == 7
    nebula.configure(WANTED)
    assert len(web.engine.changes) == 7


def test_nebula_loses_what_comes_in_two_pieces():
    """The client above is as strict as the real one: a header in lower case, with the body after it, gives no body."""

    def answer(listener):
        line, _ = listener.accept()
        with line:
            line.recv(65_536)
            line.sendall(b"HTTP/1.1 200 OK\r\ncontent-length: 2\r\n\r\n")
            line.recv(65_536)  # until the client has gone

    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=answer, args=[listener])
        thread.start()
        assert Nebula(listener.getsockname()).request("GET", "/cgi/snapshot.hdl") == ""
        thread.join()


def test_a_monitor_reads_numbers_and_texts(web):
    """velodyne_monitor of Autoware: 200 and application/json exactly, numbers for speeds, texts for model and serial."""
    trees = {}
    for name in ("info", "diag", "status", "settings"):
        with urllib.request.urlopen(f"http://{web.address[0]}:{web.address[1]}/cgi/{name}.json") as answer:
            assert (answer.status, answer.headers["Content-Type"]) == (200, "application/json")
            trees[name] = json.load(answer)
    assert isinstance(trees["status"]["motor"]["rpm"], int)
    assert isinstance(trees["settings"]["rpm"], int)
    assert trees["info"]["model"] == "VLP-16"
    assert isinstance(trees["info"]["serial"], str)
    assert {type(count) for board in trees["diag"]["volt_temp"].values() for count in board.values()} == {int}


FORMS = {
    "setting rpm=1200&returns=Dual&laser=off": {"rpm": 1200, "return_mode": ReturnMode.DUAL, "laser_on": False},
    "setting laser=on": {},
    "setting/fov start=350&end=10": {"fov_deg": (350, 10)},
    "setting/host addr=10.0.0.7&dport=4000&tport=4001": {"host": "10.0.0.7", "data_port": 4000, "position_port": 4001},
    "setting/net addr=127.0.0.2&mask=255.0.0.0": {"address": "127.0.0.2", "mask": "255.0.0.0"},
    "setting/net gateway=127.0.0.1&dhcp=on": {"gateway": "127.0.0.1", "dhcp": True},
    "setting/phaselock enabled=on&offset=12345": {"phase_lock_on": True, "phase_lock_cdeg": 12_345},
}
"""Values of each key by itself are in `test_web_fuzz.py`."""


def by_urllib(web, path, body):
    """Python scripts."""
    url = "http://{}:{}{}".format(*web.address, path)
    with urllib.request.urlopen(urllib.request.Request(url, body.encode(), method="POST")) as answer:
        return answer.status, answer.read()


def by_curl(web, path, body):
    """The manual's own way, which pycurl and the ROS configuration node share."""
    data = [word for item in body.split("&") for word in ("--data-urlencode", item)]
    curl = ["curl", "--silent", "--show-error", "--noproxy", "*", "--max-time", "5"]
    url = "http://{}:{}{}".format(*web.address, path)
    said = subprocess.check_output([*curl, "--write-out", "%{http_code}", *data, url])
    return int(said[-3:]), said[:-3]


CLIENTS = {
    "http.client": lambda web, path, body: web.client.post(path, body),
    # It does not look at the status.
    "nebula": lambda web, path, body: (204, Nebula(web.address).request("POST", path, body).encode()),
    "urllib": by_urllib,
    "curl": by_curl,
}


@pytest.mark.parametrize("client", CLIENTS)
@pytest.mark.parametrize(("form", "values"), FORMS.items())
def test_a_form_sets_its_values(web, client, form, values):
    """Each is answered 204 without body, changes what it names and nothing else, and the stream hears of it once."""
    if client == "curl" and not shutil.which("curl"):
        pytest.skip("curl is not installed")
    path, body = form.split()
    assert CLIENTS[client](web, f"/cgi/{path}", body) == (204, b"")
    wanted = replace(DeviceSettings(), **values)
    assert web.device.settings == wanted
    assert web.engine.changes == ([wanted] if wanted != DeviceSettings() else [])
