"""The page: who may ask, what strangers get, and what a real browser shows: Chromium without a screen,
drawing by software."""

import http.client
import re
import socket
from contextlib import closing, suppress

import numpy as np
import pytest
from extras.viewer.kit import places_of
from kit import set_words

pytest.importorskip("viser", reason="the extra viewer is not installed")

import msgspec
import viser
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.sync.client import connect

from vlp16emu import Emulator
from vlp16emu.errors import OutputError
from vlp16emu.extras.viewer.page import LOOPBACK, capture_page, guarded_server, is_ours


@pytest.fixture(scope="module")
def port(server):
    return server.get_port()


def client_of(port):
    kind = f"viser-v{viser.__version__}"
    return connect(f"ws://127.0.0.1:{port}/", subprotocols=[kind], max_size=None)


def status(port, path="/", host="127.0.0.1", **headers):
    with closing(http.client.HTTPConnection(host, port, timeout=20)) as connection:
        connection.request("GET", path, headers=headers)
        return connection.getresponse().status


@pytest.mark.parametrize(
    ("host", "origin", "ours"),
    [
        ("127.0.0.1:80", None, True),
        ("localhost:80", "http://localhost:80", True),
        ("localhost:80", "http://localhost:81", False),
        ("localhost:80", "https://evil.example", False),
        ("localhost:80", "null", False),
        ("evil.example:80", None, False),
        ("evil.example:80", "http://evil.example:80", False),
        ("[::1", None, False),
    ],
)
def test_requests_for_others_are_refused(host, origin, ours):
    """Only a request for our name, from our own page or no page at all, is answered."""
    headers = Headers({"Host": host} | ({} if origin is None else {"Origin": origin}))
    assert is_ours(headers, LOOPBACK) is ours


def test_the_page_is_there_and_no_file_beside_it(port):
    """The page loads; paths that lead elsewhere find nothing, and neither pages nor sockets of others are
    answered."""
    assert status(port) == 200
    for path in (
        "/../../../../etc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "/..%5c..%5cetc/passwd",
        "//etc/passwd",
    ):
        assert status(port, path) == 404, path
    assert status(port, Host="evil.example") == 403
    assert status(port, Origin="http://evil.example") == 403
    with pytest.raises(WebSocketException, match="403"):
        connect(f"ws://127.0.0.1:{port}/", origin="http://evil.example")


@pytest.mark.parametrize(("host", "near"), [("::1", "::1"), ("::", "::1"), ("0.0.0.0", "127.0.0.1")])
def test_a_page_on_other_addresses_has_the_same_guard(host, near):
    """By IPv6, or on all addresses, the page answers its own addresses; names that resolve here and pages of
    others stay refused."""
    with guarded_server(host, 0) as server:
        number = server.get_port()
        assert status(number, host=near) == 200
        assert status(number, host=near, Host=f"evil.example:{number}") == 403
        assert status(number, host=near, Origin="http://evil.example") == 403


def test_no_address_is_asked_for_and_no_file_is_taken(port, monkeypatch):
    """A client that wishes for a public tunnel gets none; with that, a file for nobody and noise the page
    stays."""
    made = []
    monkeypatch.setattr("viser._viser.ViserTunnel", lambda *arguments: made.append(arguments))
    upload = {"type": "FileTransferStartUpload", "source_component_uuid": "7", "filename": "/etc/passwd"}
    named = ({"type": "NoSuchMessage"}, upload | {"transfer_uuid": "1"}, {"type": "ShareUrlRequest"})
    for message in (b"", "text", bytes(range(256)), *map(msgspec.msgpack.encode, named)):
        with suppress(ConnectionClosed), client_of(port) as client:  # what is wrong ends its connection
            client.recv(timeout=20)
            client.send(message)
            client.ping().wait(timeout=1)
    assert status(port) == 200
    assert made == []


def test_a_capture_is_shown_whatever_a_client_sets(server, tmp_path):
    """A capture has its points by range; numbers and words that no control has give a picture of the least
    or the default."""
    Emulator("static_bench", {"duration_s": 0.5}).record(tmp_path / "bench.pcap")
    page = capture_page(server, tmp_path / "bench.pcap", None, 1)
    page._slider.value, page._size.value, page._together.value, page._layer.value = (
        float("nan"),
        -1e9,
        -3,
        "no layer",
    )
    page._draw()
    points = server.scene._handle_from_node_name["/sweep"]
    assert len(points.points) > 5_000
    assert len(np.unique(points.colors, axis=0)) > 20
    assert points.point_size == pytest.approx(0.01)
    assert "by range, sweep at 0.0 s" in page._text.content


def test_a_port_in_use_is_one_clear_line():
    """The library would take another port; we say so and end."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        number = taken.getsockname()[1]
        line = f"127.0.0.1:{number}: address already in use"
        with pytest.raises(OutputError, match=line), guarded_server("127.0.0.1", number):
            pass
    with pytest.raises(OutputError, match=r"192\.0\.2\.1"), guarded_server("192.0.2.1", 0):
        pass


BIRCH = '{ species = "silver_birch", share = 1.0, dbh_cm = 18.0, height_m = 9.0 }'
BIRCHES = (
    f'world={{ kind = "forest", stems_per_ha = 150, species = [{BIRCH}] }}',
    *(
        "motion.way_points_m=[[0, 0], [4, 0], [8, 1]]",
        "sensor.max_range_m=12",
        "beam.model=none",
        "duration_s=2",
    ),
)


def leaf(r, g, b):
    return (r > b + 25) & (g > b + 20) & (g > 120)


def stem(r, g, b):
    return (abs(r - b) < 12) & (abs(g - r) < 12) & (r > 90) & (r < 205)


@pytest.mark.usefixtures("kept_woods")
def test_a_browser_shows_the_stand_and_plays_the_sweeps(in_browser):
    """The page has stems and leaves, and the points of the sweep at the cursor, which goes on as it plays."""
    _, page = in_browser("view", "birch_walk", *set_words(BIRCHES), "--radius", "8", "--port", "0")
    page.get_by_text("points by natural, sweep at 0.0 s").wait_for()
    places_of(page, stem, 1000)
    places_of(page, leaf, 200)
    page.get_by_label("play").click()
    page.get_by_text(
        re.compile(r"points by natural, sweep at (0\.[1-9]|1\.[0-9]) s")
    ).wait_for()  # or its end


@pytest.mark.parametrize(
    ("host", "is_taken"),
    [("192.168.7.9:8016", True), ("[fe80::1]:8016", True), ("evil.example:8016", False), ("", False)],
)
def test_on_all_interfaces_a_request_must_name_an_address(host, is_taken):
    """A page on 0.0.0.0 opens by any address of this machine; a foreign name, which may be made to resolve to
    it, stays refused."""
    headers = Headers({"Host": host})
    assert is_ours(headers, LOOPBACK, takes_addresses=True) is is_taken
    assert not is_ours(headers, LOOPBACK)
