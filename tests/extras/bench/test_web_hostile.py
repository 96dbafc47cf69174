"""What the web interface does with requests that are wrong, too long, too slow, too many, from elsewhere, or
any bytes at all.

200 examples of random bytes; with `pytest --hypothesis-profile=long` 10 000.
"""

import contextlib
import http.client
import json
import socket
import threading
import time

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vlp16emu.extras.bench.device import DeviceSettings
from vlp16emu.extras.bench.web import MOST_BODY_BYTES, MOST_CONNECTIONS, MOST_HEADER_BYTES, WebServer
from vlp16emu.hosts import bound

DOCUMENTS = [
    f"/cgi/{name}" for name in ("settings.json", "status.json", "diag.json", "info.json", "snapshot.hdl")
]
FORM = b"POST /cgi/setting HTTP/1.1\r\nHost: 127.0.0.1\r\n"


def lives(web):
    return web.client.get("/cgi/status.json")["motor"]["rpm"] > 0


def status_of(segments):
    return int(b"".join(segments).split(b" ", 2)[1])


@pytest.mark.parametrize(
    "path",
    [
        *("/../../../../etc/passwd", "/..%2f..%2f..%2fetc/passwd", "/cgi/../page.html"),
        *("/cgi/settings.json/../../../state.py", "//etc/passwd", "/etc/passwd", "etc/passwd", "/page.html"),
        *("/web.py", "/saved.json", "/cgi/", "/./", "/%00", "/index.html", "file:///etc/passwd"),
        *("http://127.0.0.1/etc/passwd", "/cgi/settings.json%00.html", "\\..\\..\\etc\\passwd"),
    ],
)
def test_no_file_can_be_reached(web, speak, path):
    """Whatever a path says, it names one of the documents or nothing: no file of this machine, and none of
    the program."""
    web.device.save()
    said = b"".join(speak(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n".encode()))
    assert b"HTTP/1.1 404 " in said
    assert json.loads(said.partition(b"\r\n\r\n")[2]) == {"error": "no such path"}


@pytest.mark.parametrize(
    ("sent", "status"),
    [
        (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n", 400),
        (b"GET / HTTP/1.1\r\n\r\n", 400),
        (b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n", 400),
        (b"GET  / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n", 400),
        (FORM + b"Content-Length: -1\r\n\r\n", 400),
        (FORM + b"Content-Length: 7\r\nContent-Length: 8\r\n\r\nrpm=300", 400),
        (FORM + b"Content-Length: 7\r\nTransfer-Encoding: gzip\r\n\r\nrpm=300", 501),
        (FORM + b"Transfer-Encoding: chunked\r\n\r\nzz\r\n", 400),
        (b"GET /" + b"a" * 3 * MOST_HEADER_BYTES + b" HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n", 431),
        (b"GET / HTTP/1.1\r\n" + b"a: b\r\n" * MOST_HEADER_BYTES + b"\r\n", 431),
        (FORM + b"Content-Length: %d\r\n\r\n" % (MOST_BODY_BYTES + 1) + b"a" * (MOST_BODY_BYTES + 1), 413),
        (FORM + b"Content-Length: 5000000\r\n\r\n" + b"a" * 5_000_000, 413),
        (FORM + b"Transfer-Encoding: chunked\r\n\r\n1000\r\n%b\r\n1\r\na\r\n0\r\n\r\n" % (b"a" * 4096), 413),
        (FORM + b"Host: 127.0.0.1\r\n\r\n", 400),
        (FORM + b"Content-Length: 7\r\n\r\nrpm", 400),
        (FORM + b"Content-Length : 7\r\n\r\nrpm=300", 400),
        (b"GET /\r\n", 400),
    ],
)
def test_what_is_no_request_is_refused(web, speak, sent, status):
    """Bytes that are no HTTP, heads and bodies that are too long or ambiguous: one answer that arrives,
    and the line is closed."""
    assert status_of(speak(sent, shut=True)) == status
    assert web.device.settings == DeviceSettings()
    assert lives(web)


def test_a_body_of_the_greatest_length_is_read(web, speak):
    """The bound is the last length that is taken; chunks are put together."""
    body = b"rpm=300&laser=on&" + b"&" * (MOST_BODY_BYTES - 17)
    assert status_of(speak(FORM + b"Connection: close\r\nContent-Length: 4096\r\n\r\n" + body)) == 200
    chunks = b"Transfer-Encoding: chunked\r\nConnection: close\r\n\r\n4\r\nrpm=\r\n3\r\n300\r\n0\r\n\r\n"
    assert status_of(speak(FORM + chunks)) == 204
    assert web.device.settings.rpm == 300


@pytest.mark.parametrize("begin", [b"", b"GET / HT", FORM, FORM + b"Content-Length: 7\r\n\r\nrpm"])
def test_a_slow_client_is_hung_up_on(web, monkeypatch, begin):
    """A request that is not there in time closes its line, also where a byte comes now and then; others
    are answered meanwhile."""
    monkeypatch.setattr("vlp16emu.extras.bench.web.LONGEST_S", 0.3)
    begin_s = time.perf_counter()
    with socket.create_connection(web.address, timeout=0.02) as line:
        line.sendall(begin)
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            while True:  # until it is closed
                try:
                    if not line.recv(100):
                        break
                except TimeoutError:
                    line.sendall(b"a" if begin else b"")
        assert time.perf_counter() - begin_s > 0.25
    assert lives(web)
    assert web.device.settings == DeviceSettings()


MANY_AT_ONCE = b"GET /cgi/snapshot.hdl HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n" * 100_000


def test_a_client_that_reads_nothing_is_hung_up_on(web, monkeypatch):
    """Requests without end, whose answers nobody takes, fill the line and no more: the server leaves it in
    time."""
    monkeypatch.setattr("vlp16emu.extras.bench.web.LONGEST_S", 0.3)
    with socket.socket() as line:
        line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        line.settimeout(60)
        line.connect(web.address)
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            line.sendall(MANY_AT_ONCE * 5)
            pytest.fail("all has been taken")
    assert lives(web)


def test_a_client_that_asks_without_waiting_keeps_nobody_waiting(web):
    """While a line has more requests than have been answered, others are served."""
    answers = 0
    with socket.create_connection(web.address, timeout=60) as line:

        def send():
            with contextlib.suppress(OSError):  # ended below
                line.sendall(MANY_AT_ONCE)

        sender = threading.Thread(target=send)
        sender.start()
        for _ in range(20):
            answers += line.recv(1 << 20).count(b"HTTP/1.1 200 OK")
            assert lives(web)
        assert 0 < answers < 100_000
        line.shutdown(socket.SHUT_RDWR)
        sender.join()


def test_connections_are_bounded(make, monkeypatch):
    """One more than there may be is closed at once; when one ends, another has its place."""
    monkeypatch.setattr("vlp16emu.extras.bench.web.LONGEST_S", 600.0)
    _, device = make()
    get = b"GET /cgi/info.json HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
    with (
        WebServer(device, bound(socket.SOCK_STREAM, "127.0.0.1", 0, "--http")) as server,
        contextlib.ExitStack() as stack,
    ):

        def call():
            line = stack.enter_context(socket.create_connection(server.address, timeout=60))
            try:
                line.sendall(get)
                return line, line.recv(4096)
            except ConnectionError:
                return line, b""

        lines = [call() for _ in range(MOST_CONNECTIONS)]
        assert all(said for _, said in lines)
        assert call()[1] == b""
        lines[0][0].close()
        while not call()[1]:  # until the server has seen that
            pass


@pytest.mark.parametrize(
    ("lines", "status"),
    [
        *(
            ([f"Host: {host}"], 403)
            for host in ("sensor.example", "sensor.example:8080", "localhost.example", "", "[")
        ),
        *(([f"Host: {host}"], 204) for host in ("localhost:1", "192.168.1.201", "[::1]:80")),
        (["Host: 127.0.0.1:80", "Origin: http://127.0.0.1:80"], 204),
        *(
            (["Host: 127.0.0.1:80", f"Origin: {page}"], 403)
            for page in ("http://127.0.0.1:81", "http://site.example", "null")
        ),
        (["Host: site.example", "Origin: http://site.example"], 403),
    ],
)
def test_pages_of_other_sites_set_nothing(web, speak, lines, status):
    """A form of another origin, or to a name that leads here, is refused; tools, which send no origin, and
    addresses are not."""
    head = "\r\n".join(
        ["POST /cgi/setting HTTP/1.1", *lines, "Content-Length: 7", "Connection: close", "", "rpm=300"]
    )
    assert status_of(speak(head.encode())) == status
    assert web.device.settings.rpm == (300 if status == 204 else 600)


def test_names_are_taken_where_others_may_come(web, speak):
    """On an interface that is not this machine's alone the sensor may have a name; forms of other origins
    are refused there too."""
    web.server.is_private = False
    form = (
        b"POST /cgi/setting HTTP/1.1\r\nHost: sensor\r\n%sContent-Length: 7\r\n"
        b"Connection: close\r\n\r\nrpm=300"
    )
    assert status_of(speak(form % b"Origin: http://site.example\r\n")) == 403
    assert status_of(speak(form % b"")) == 204


def test_every_origin_may_read_only_as_a_tool(web):
    """No answer allows pages of other origins to read it, and the page itself loads from nowhere and is
    framed by none."""
    for path in ("/", *DOCUMENTS):
        _, headers, body = web.client.ask("GET", path, headers={"Origin": "http://site.example"})
        assert not [name for name in headers if name.lower().startswith("access-control")]
        assert body
    _, headers, body = web.client.ask("GET", "/")
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
    assert b"://" not in body


LONGEST_S = 60.0  # far more than the 5 s after which the server hangs up, on a machine that may be busy
MANY = settings(
    max_examples=max(200, settings.default.max_examples),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
"""The sensor is one for all examples, as on a bench: what is set stays set."""


TOKENS = st.sampled_from(
    [
        *(b"GET ", b"POST ", b"/cgi/setting", b"/cgi/settings.json"),
        *(b" HTTP/1.1", b" HTTP/1.0", b" HTTP/9", b"\r\n", b"\n"),
        *(b"Host: 127.0.0.1\r\n", b"Host: evil\r\n"),
        *(b"Content-Length: 7\r\n", b"Content-Length: 99999999999\r\n", b"Transfer-Encoding: chunked\r\n"),
        *(b"Connection: close\r\n", b"Expect: 100-continue\r\n", b"Upgrade: websocket\r\n"),
        *(b"\r\n\r\n", b"rpm=300", b"5\r\n", b"0\r\n\r\n", b"\x00", b"\xff\xfe", b": ", b"a" * 9000),
    ]
)


@MANY
@given(sent=st.one_of(st.binary(max_size=300), st.lists(TOKENS, max_size=12).map(b"".join)))
def test_any_bytes_are_answered_or_hung_up_on(web, sent):
    """Whatever comes, the line is closed in time, what is said are whole answers, and the next client is
    served."""
    begin_s = time.perf_counter()
    said = b""
    with socket.create_connection(web.address, timeout=LONGEST_S) as line:
        try:
            line.sendall(sent)
            line.shutdown(socket.SHUT_WR)
            while part := line.recv(65_536):
                said += part
        except OSError as error:
            if isinstance(error, TimeoutError):  # hung
                raise
    while said:
        head, found, rest = said.partition(b"\r\n\r\n")
        assert found
        assert head.startswith(b"HTTP/1.1 ")
        (length,) = (int(text[16:]) for text in head.split(b"\r\n") if text.startswith(b"Content-Length: "))
        assert len(rest) >= length
        said = rest[length:]
    with contextlib.closing(http.client.HTTPConnection(*web.address, timeout=LONGEST_S)) as line:
        line.request("GET", "/cgi/info.json")
        assert line.getresponse().status == 200
    assert time.perf_counter() - begin_s < LONGEST_S
