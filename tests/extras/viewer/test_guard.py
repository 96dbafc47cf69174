"""The server of the page: who may ask, and what strangers get."""

import http.client
import socket
from contextlib import closing, suppress

import numpy as np
import pytest

pytest.importorskip("viser", reason="the extra viewer is not installed")

import msgspec
import viser
from viser import _messages
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.sync.client import connect

from vlp16emu.errors import OutputError
from vlp16emu.extras.viewer.guard import LOOPBACK, guarded_server, is_ours


@pytest.fixture(scope="module")
def server():
    with guarded_server("127.0.0.1", 0, "test") as server:
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


def test_a_message_sets_values_and_nothing_else(server, port):
    """Messages that set the insides of a control, or a value of another type, change nothing; an honest one does."""
    slider = server.gui.add_slider("time", 0.0, 1.0, 0.1, 0.0)
    inner = [slider._impl.update_cb, slider._impl.sync_cb, slider._impl.is_button]
    inside = [{"removed": True}, {"update_cb": 5}, {"sync_cb": None}, {"is_button": 1}, {"value": 0.9, "uuid": "x"}]
    with client_of(port) as client:
        for updates in (*inside, {"value": "far"}, {"value": [1]}, {"value": 0.5}):
            message = {"type": "GuiUpdateMessage", "uuid": slider._impl.uuid, "updates": updates}
            client.send(msgspec.msgpack.encode(message))
        for _ in range(200):
            if slider.value == 0.5:
                break
            client.ping().wait(timeout=5)
    assert slider.value == 0.5
    assert [slider._impl.update_cb, slider._impl.sync_cb, slider._impl.is_button] == inner
    assert not slider._impl.removed


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


def test_a_long_message_ends_its_connection(port):
    """No message of the page is as long as 64 KiB: one that is longer is not read."""
    with client_of(port) as client:
        client.send(bytes(1 << 17))
        with suppress(ConnectionClosed):
            while client.recv(timeout=20):
                pass
    assert client.close_code == 1009


def test_a_port_in_use_is_one_clear_line():
    """The library would take another port; we say so and end."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        number = taken.getsockname()[1]
        with (
            pytest.raises(OutputError, match=f"127.0.0.1:{number}: address already in use"),
            guarded_server("127.0.0.1", number, "test"),
        ):
            pass
    with pytest.raises(OutputError, match=r"192\.0\.2\.1"), guarded_server("192.0.2.1", 0, "test"):
        pass
