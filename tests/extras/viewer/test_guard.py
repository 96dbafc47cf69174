"""The server of the page: who may ask, and what strangers get."""

import http.client
import socket
from contextlib import closing, suppress

import numpy as np
import pytest

pytest.importorskip("viser", reason="the extra viewer is not installed")

from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.sync.client import connect

from vlp16emu.errors import OutputError
from vlp16emu.extras.viewer.guard import LOOPBACK, guarded_server, is_ours


@pytest.fixture(scope="module")
def port():
    with guarded_server("127.0.0.1", 0, "test") as server:
        server.gui.add_slider("time", 0.0, 1.0, 0.1, 0.0)
        yield server.get_port()


def status(port, path="/", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    with closing(connection):
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
    """The page loads; paths that lead elsewhere, written in any way, find nothing."""
    assert status(port) == 200
    for path in ("/../../../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "/..%5c..%5cetc/passwd", "//etc/passwd"):
        assert status(port, path) == 404, path
    assert status(port, Host="evil.example") == 403
    assert status(port, Origin="http://evil.example") == 403


def test_a_socket_of_another_page_is_refused(port):
    """The browser of a user who visits another page opens no socket of ours for it."""
    with pytest.raises(WebSocketException, match="403"):
        connect(f"ws://127.0.0.1:{port}/", origin="http://evil.example")


def test_hostile_messages_change_nothing(port, monkeypatch):
    """After noise, wrong types and a wish for a public tunnel the server answers as before, and no tunnel is made."""
    import msgspec
    import viser
    from viser import _viser

    made = []
    monkeypatch.setattr(_viser, "ViserTunnel", lambda *arguments: made.append(arguments))
    named = [
        [1, 2],
        {"type": "NoSuchMessage"},
        {"type": "GuiUpdateMessage", "uuid": "../../etc/passwd", "updates": {"value": float("nan")}},
        {"type": "FileTransferStartUpload", "source_component_uuid": 7, "filename": "/etc/passwd"},
        {"type": "ShareUrlRequest"},
    ]
    messages = [b"", b"\x00\xff" * 500, "text", *map(msgspec.msgpack.encode, named), bytes(1 << 17)]
    for message in messages:
        address, kind = f"ws://127.0.0.1:{port}/", f"viser-v{viser.__version__}"
        with suppress(ConnectionClosed), connect(address, subprotocols=[kind], max_size=None) as client:
            client.recv(timeout=20)
            client.send(message)
            client.ping().wait(timeout=5)
    assert status(port) == 200
    assert made == []


def test_a_long_message_ends_its_connection(port):
    """No message of the page is as long as 64 KiB: one that is longer is not read."""
    import viser

    address, kind = f"ws://127.0.0.1:{port}/", f"viser-v{viser.__version__}"
    with connect(address, subprotocols=[kind], max_size=None) as client:
        client.send(bytes(1 << 17))
        with suppress(ConnectionClosed):
            while client.recv(timeout=20):
                pass
    assert client.close_code == 1009


KEYS = (
    *("name", "uuid", "updates", "filename", "source_component_uuid"),
    *("transfer_uuid", "value", "position", "wxyz", "part_index"),
)
"""Of messages of the library."""


def test_random_messages_change_nothing(port, tmp_path):
    """Hundreds of random bytes and of random MessagePack that names messages of the library leave the server as it is; no file is read or made."""
    import msgspec
    import viser
    from viser import _messages

    rng = np.random.default_rng(16)
    kinds = sorted(name for name in vars(_messages) if name.endswith("Message"))
    secret = tmp_path / "secret"
    secret.write_text("nobody reads this")
    values = (None, -1, 1e308, float("nan"), True, [], {}, b"\xff" * 40, str(secret), "../../etc/passwd", [[1.0]])
    address, kind = f"ws://127.0.0.1:{port}/", f"viser-v{viser.__version__}"
    for round_ in range(100):  # what is wrong ends its connection: few messages each, and many of them
        with suppress(ConnectionClosed), connect(address, subprotocols=[kind], max_size=None) as client:
            assert secret.read_bytes() not in client.recv(timeout=20)
            for _ in range(5):
                if round_ % 4 == 0:
                    client.send(rng.bytes(int(rng.integers(1, 300))))
                    continue
                message = {key: values[rng.integers(len(values))] for key in rng.choice(KEYS, 4, replace=False)}
                client.send(msgspec.msgpack.encode(message | {"type": kinds[rng.integers(len(kinds))]}))
    assert status(port) == 200
    assert [path.name for path in tmp_path.iterdir()] == ["secret"]


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
