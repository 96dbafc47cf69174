"""The page: who may ask, what strangers get, and what a real browser shows: Chromium without a screen, drawing by software."""

import http.client
import re
import shutil
import socket
import subprocess
import sys
from contextlib import closing, suppress

import imageio.v3 as imageio
import numpy as np
import pytest

pytest.importorskip("viser", reason="the extra viewer is not installed")

import msgspec
import viser
from viser import _messages
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.sync.client import connect

from vlp16emu import Emulator
from vlp16emu.errors import OutputError
from vlp16emu.extras.viewer.page import LOOPBACK, Page, guarded_server, is_ours
from vlp16emu.extras.viewer.sweeps import SceneSweeps


@pytest.fixture(scope="module")
def server():
    with guarded_server("127.0.0.1", 0) as server:
        yield server


@pytest.fixture(scope="module")
def port(server):
    return server.get_port()


def client_of(port):
    kind = f"viser-v{viser.__version__}"
    return connect(f"ws://127.0.0.1:{port}/", subprotocols=[kind], max_size=None)


def status(port, path="/", **headers):
    with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=20)) as connection:
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
    """The page loads; paths that lead elsewhere find nothing, and neither pages nor sockets of others are answered."""
    assert status(port) == 200
    for path in ("/../../../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "/..%5c..%5cetc/passwd", "//etc/passwd"):
        assert status(port, path) == 404, path
    assert status(port, Host="evil.example") == 403
    assert status(port, Origin="http://evil.example") == 403
    with pytest.raises(WebSocketException, match="403"):
        connect(f"ws://127.0.0.1:{port}/", origin="http://evil.example")


KEYS = (
    *("name", "uuid", "updates", "filename", "source_component_uuid"),
    *("transfer_uuid", "value", "position", "wxyz", "part_index"),
)
"""Of messages of the library."""


def test_hostile_messages_change_nothing(port, monkeypatch, tmp_path):
    """After noise, wrong types and a wish for a public tunnel the server is as before: no tunnel, no file read or made."""
    made, rng = [], np.random.default_rng(16)
    monkeypatch.setattr("viser._viser.ViserTunnel", lambda *arguments: made.append(arguments))
    (tmp_path / "secret").write_text("nobody reads this")
    kinds = sorted(name for name in vars(_messages) if name.endswith("Message"))
    values = (None, -1, 1e308, float("nan"), True, [], {}, b"\xff" * 40, str(tmp_path / "secret"), "../../etc/passwd")
    upload = {"type": "FileTransferStartUpload", "source_component_uuid": 7, "filename": "/etc/passwd"}
    named = [*map(msgspec.msgpack.encode, ([1, 2], {"type": "NoSuchMessage"}, upload, {"type": "ShareUrlRequest"}))]
    noise = [rng.bytes(int(rng.integers(1, 300))) for _ in range(25)]
    for _ in range(200):
        message = {key: values[rng.integers(len(values))] for key in rng.choice(KEYS, 4, replace=False)}
        named.append(msgspec.msgpack.encode(message | {"type": kinds[rng.integers(len(kinds))]}))
    messages = [b"", "text", *noise, *named]
    while messages:  # what is wrong ends its connection: few messages each, and many of them
        with suppress(ConnectionClosed), client_of(port) as client:
            assert b"nobody reads this" not in client.recv(timeout=20)
            for _ in range(min(4, len(messages))):
                client.send(messages.pop())
            client.ping().wait(timeout=1)
    assert status(port) == 200
    assert made == []
    assert [path.name for path in tmp_path.iterdir()] == ["secret"]


def test_values_out_of_range_are_drawn_as_the_nearest(server):
    """Numbers and words that no control has, as a client may send them, give a picture of the least or the default."""
    page = Page(server, SceneSweeps(Emulator("static_bench", {"duration_s": 0.5})), {})
    page._slider.value, page._size.value, page._together.value, page._layer.value = float("nan"), -1e9, -3, "no layer"
    page._draw()
    points = server.scene._handle_from_node_name["/sweep"]
    assert len(points.points) > 5_000
    assert points.point_size == pytest.approx(0.01)
    assert "by natural, sweep at 0.0 s" in page._text.content


def test_a_port_in_use_is_one_clear_line():
    """The library would take another port; we say so and end."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        number = taken.getsockname()[1]
        line = f"127.0.0.1:{number}: address already in use"
        with pytest.raises(OutputError, match=line), guarded_server("127.0.0.1", number):
            pass
    with pytest.raises(OutputError, match=r"192\.0\.2\.1"), guarded_server("192.0.2.1", 0):
        pass


CHROMIUM = shutil.which("chromium")
SOFTWARE = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
WAIT_MS = 120_000
SCENE = """schema = 1
duration_s = 2.0
[sensor]
max_range_m = 12.0
[beam]
model = "none"
[motion]
kind = "walk"
way_points_m = [[0, 0], [4, 0], [8, 1]]
speed_m_s = 1.2
[world]
kind = "forest"
stems_per_ha = 150
species = [{ species = "silver_birch", share = 1.0, dbh_cm = 18.0, height_m = 9.0 }]
"""


def seen_by(page, is_there, least):
    """Wait until so many pixels are there."""
    for _ in range(10):
        pixels = imageio.imread(page.screenshot(timeout=WAIT_MS))[..., :3].astype(int)
        if (count := is_there(*np.moveaxis(pixels, -1, 0)).sum()) >= least:
            return
    raise AssertionError(f"{count} pixels, not {least}")


def leaf(r, g, b):
    return (g > r) & (r > b + 60) & (g > 120)


def stem(r, g, b):
    return (abs(r - b) < 12) & (abs(g - r) < 12) & (r > 90) & (r < 190)


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium")
@pytest.mark.usefixtures("kept_woods")
def test_a_browser_shows_the_stand_and_plays_the_sweeps(tmp_path):
    """The page has stems and leaves, and the points of the sweep at the cursor, which goes on as it plays."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    (tmp_path / "birches.toml").write_text(SCENE)
    words = "view", str(tmp_path / "birches.toml"), "--radius", "8", "--port", "0"
    command = [sys.executable, "-m", "vlp16emu", *words]
    with (
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program,
        sync_api.sync_playwright() as playwright,
        playwright.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE) as browser,
    ):
        try:
            page = browser.new_page(viewport={"width": 900, "height": 700})
            page.goto(re.search(r"http\S+", program.stdout.readline())[0])
            page.get_by_text("points by natural, sweep at 0.0 s").wait_for(timeout=WAIT_MS)
            seen_by(page, stem, 1000)
            seen_by(page, leaf, 200)
            page.get_by_label("play").click(timeout=WAIT_MS)
            page.get_by_text(re.compile("points by natural, sweep at 0.[1-9] s")).wait_for(timeout=WAIT_MS)
        finally:
            program.terminate()
