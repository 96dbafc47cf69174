"""The web interface of the sensor, on threads of its own.

Its readers include clients made by hand that know one way of writing `Content-Length`, take no chunks, and may look at no
more than the first segment: so each answer has that header, in this spelling, and leaves in one piece.
"""

import json
import re
import socket
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from http.client import responses
from io import BufferedIOBase
from ipaddress import ip_address
from pathlib import Path
from socketserver import StreamRequestHandler, ThreadingTCPServer
from threading import Event, Lock, Thread
from time import monotonic
from typing import Any, Self
from urllib.parse import urlsplit

from vlp16emu.errors import OutputError, Vlp16emuError
from vlp16emu.extras.bench.documents import document
from vlp16emu.extras.bench.forms import PATHS, FormError, submit
from vlp16emu.extras.bench.state import Device

MOST_CONNECTIONS = 32
"""At a time; further ones are closed."""
MOST_BODY_BYTES = 4096
MOST_HEADER_BYTES = 8192
LONGEST_S = 5.0
"""For a request and its answer, and for the wait between two."""

_POLL_S = 0.1
"""How often the server looks for connections whose time is over."""
_TOKEN = rb"[!#-'*+.0-9A-Z^-z|~-]+"
_HEAD = re.compile(rb"(%b) ([!-~]+) HTTP/1\.([01])\r?\n((?:%b:[^\x00\r\n]*\r?\n)*)\r?\n" % (_TOKEN, _TOKEN))
"""Method, target, minor version and header lines (RFC 9112, sections 3 and 5)."""
_ONCE = ("host", "content-length", "transfer-encoding")
_CHUNK = re.compile(rb"([0-9A-Fa-f]{1,8})[ \t]*(?:;[^\r\n]*)?\r?\n")
_JSON, _HTML = "application/json", "text/html; charset=utf-8"
_PAGE_POLICY = (
    "default-src 'none'; connect-src 'self'; img-src data:; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; form-action 'none'; frame-ancestors 'none'"
)


@dataclass(frozen=True, slots=True)
class HttpFault:
    """What is wrong with the web interface."""

    status: int | None
    """That every request is answered with; None for no answer at all."""


@dataclass(frozen=True, slots=True)
class _Request:
    method: str
    path: str
    """Without the query."""
    headers: dict[str, str]
    """By names in lower case."""
    body: bytes
    """One byte more than there may be where it is too long."""
    is_last: bool
    """Whether the connection ends with its answer."""


@dataclass(frozen=True, slots=True)
class _Answer:
    status: int
    body: bytes = b""
    kind: str = _JSON
    header: tuple[str, str] = ("Cache-Control", "no-store")
    """Beside type and length."""

    def packed(self, *, bare: bool = False, is_last: bool) -> bytes:
        """Write it in one piece, to a HEAD request bare of its body."""
        lines = (
            f"HTTP/1.1 {self.status} {responses.get(self.status, '')}",
            f"Content-Type: {self.kind}",
            f"Content-Length: {len(self.body)}",
            "{}: {}".format(*self.header),
            *(["Connection: close"] if is_last else []),
        )
        return "\r\n".join((*lines, "", "")).encode("ascii") + (b"" if bare else self.body)


class _BadRequestError(Exception):
    """What comes is no request, or too long: the status that says so, and why."""


class WebServer(ThreadingTCPServer):
    """The web interface of one sensor; a context manager, within which it answers.

    Parameters
    ----------
    device : what is asked and set
    host, port : where it listens; port 0 for a free one
    fault : gives what is wrong with it now, None for nothing; called from its threads, and must not wait

    Raises
    ------
    OutputError
        where it cannot listen there
    """

    allow_reuse_address = True
    request_queue_size = 128

    def __init__(
        self, device: Device, host: str, port: int, *, fault: Callable[[], HttpFault | None] = lambda: None
    ) -> None:
        self.device, self.fault = device, fault
        self.page = Path(__file__).with_name("page.html").read_bytes()
        self.is_over = Event()
        self._ends_s = dict[Any, float]()
        """When each connection is cut off."""
        self._lock = Lock()
        self._thread = Thread(target=self.serve_forever, args=[_POLL_S], name="web interface", daemon=True)
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            super().__init__((host, port), _Connection)
        except (OSError, UnicodeError) as error:
            found = getattr(error, "strerror", None) or "no name of a host"
            raise OutputError(
                f"--http {host}:{port}", found.lower(), "an address of this machine and a free port"
            ) from error
        self.is_private = ip_address(self.address[0]).is_loopback

    @property
    def address(self) -> tuple[str, int]:
        """Address and port where it listens."""
        host, port, *_ = self.socket.getsockname()
        return host, port

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.shutdown()
        self.is_over.set()
        self._cut_off(float("inf"))
        self.server_close()

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a connection, or close it where there are too many."""
        if len(self._ends_s) >= MOST_CONNECTIONS:
            self.shutdown_request(request)
        else:
            self.give_time(request)
            super().process_request(request, client_address)

    def give_time(self, line: socket.socket) -> None:
        """Give a connection the time of one request."""
        with self._lock:
            self._ends_s[line] = monotonic() + LONGEST_S

    def service_actions(self) -> None:
        """Cut off the connections whose time is over."""
        self._cut_off(monotonic())

    def shutdown_request(self, request: Any) -> None:
        """Close a connection."""
        with self._lock:
            self._ends_s.pop(request, None)
        super().shutdown_request(request)

    def _cut_off(self, now_s: float) -> None:
        with self._lock:
            for line in [line for line, end_s in self._ends_s.items() if end_s <= now_s]:
                with suppress(OSError):  # it has gone by itself
                    line.shutdown(socket.SHUT_RDWR)


class _Connection(StreamRequestHandler):
    """Answers request after request of one connection; one that takes too long is cut off by the server."""

    server: WebServer
    disable_nagle_algorithm = True

    def handle(self) -> None:
        """Answer until the connection ends."""
        with suppress(OSError):  # the client has gone, or was cut off
            while self.server.device.status().is_up and self._answers():
                self.server.give_time(self.connection)

    def _answers(self) -> bool:
        """Answer a request; returns whether another one may follow."""
        try:
            request = _request(self.rfile)
        except _BadRequestError as error:
            status, text = error.args
            self.connection.sendall(_said(status, "error", text).packed(is_last=True))
            return self._listen_out()
        if request is None or not self.server.device.status().is_up:
            return False
        fault = self.server.fault()
        if fault is None:
            answer = _answer(request, self.server)
        elif fault.status is not None:
            answer = _said(fault.status, "error", responses.get(fault.status, "fault"))
        else:
            self.server.is_over.wait(LONGEST_S)
            return False
        self.connection.sendall(answer.packed(bare=request.method == "HEAD", is_last=request.is_last))
        if len(request.body) > MOST_BODY_BYTES:
            return self._listen_out()
        return not request.is_last

    def _listen_out(self) -> bool:
        """Let an answer arrive: what is left unread of the request would reset the connection before."""
        self.connection.shutdown(socket.SHUT_WR)
        while self.rfile.read1(MOST_HEADER_BYTES):
            pass
        return False


def _answer(request: _Request, server: WebServer) -> _Answer:
    """Answer as a sensor does that is well."""
    if len(request.body) > MOST_BODY_BYTES:
        return _said(413, "error", f"more than {MOST_BODY_BYTES} bytes")
    if _is_foreign(request, is_private=server.is_private):
        return _said(403, "error", "a request that a page of another site has sent")
    if request.path in PATHS:
        return _submitted(request, server.device) if request.method == "POST" else _not_allowed("POST")
    if request.path == "/":
        answer = _Answer(200, server.page, _HTML, ("Content-Security-Policy", _PAGE_POLICY))
    elif (made := document(request.path, server.device)) is not None:
        answer = _Answer(200, _json(made))
    else:
        return _said(404, "error", "no such path")
    return answer if request.method in ("GET", "HEAD") else _not_allowed("GET, HEAD")


def _submitted(request: _Request, device: Device) -> _Answer:
    try:
        submit(request.path, request.body, device)
    except FormError as refused:
        return _said(200, "ignored", str(refused))
    except Vlp16emuError as error:
        return _said(500, "error", str(error))
    return _Answer(204)


def _is_foreign(request: _Request, *, is_private: bool) -> bool:
    """Whether a browser sends it for a page that is not the sensor's own.

    Pages of other sites may send forms anywhere, and a name of theirs may lead to this machine: so the origin of a
    form must be the host that is asked, and on an interface that is for this machine alone a host has no name.
    """
    host, origin = request.headers.get("host"), request.headers.get("origin")
    if request.method == "POST" and origin not in (None, f"http://{host}"):
        return True
    return is_private and host is not None and not _is_unnamed(host)


def _request(line: BufferedIOBase) -> _Request | None:
    """Read a request, and its body as far as it may be long; None where there is no further one."""
    head = line.read(1)
    if not head:
        return None
    while head[0] > ord(" ") and not head.endswith((b"\n\r\n", b"\n\n")):
        part = line.readline(MOST_HEADER_BYTES + 1 - len(head))
        head += part
        if len(head) > MOST_HEADER_BYTES:
            raise _BadRequestError(431, f"a head of more than {MOST_HEADER_BYTES} bytes")
        if not part:
            break
    if not (found := _HEAD.fullmatch(head)):
        raise _BadRequestError(400, "no request of HTTP/1.1")
    method, target, minor = (part.decode("ascii") for part in found.groups()[:3])
    parts = [text.partition(":") for text in found[4].decode("latin-1").split("\n")[:-1]]
    headers = {name.lower(): value.strip() for name, _, value in parts}
    for name in _ONCE:
        if [each.lower() for each, *_ in parts].count(name) > 1:
            raise _BadRequestError(400, f"more than one {name} header")
    if minor == "1" and "host" not in headers:
        raise _BadRequestError(400, "no host header")
    body = _body(line, headers)
    is_closing = "close" in re.split(r"[ \t,]+", headers.get("connection", "").lower())
    is_last = minor == "0" or is_closing or len(body) > MOST_BODY_BYTES
    return _Request(method, target.partition("?")[0], headers, body, is_last)


def _body(line: BufferedIOBase, headers: dict[str, str]) -> bytes:
    """Read a body, of one that is too long a byte more than there may be."""
    coding, length = headers.get("transfer-encoding"), headers.get("content-length", "0")
    if coding is None:
        if not re.fullmatch(r"[0-9]{1,20}", length, re.ASCII):
            raise _BadRequestError(400, "a content-length that is no number")
        return _exactly(line, min(int(length), MOST_BODY_BYTES + 1))
    if coding.lower() != "chunked":
        raise _BadRequestError(501, "a transfer-encoding other than chunked")
    body = b""
    while found := _CHUNK.fullmatch(line.readline(MOST_HEADER_BYTES)):
        size = int(found[1], 16)
        body += _exactly(line, min(size, MOST_BODY_BYTES + 1 - len(body)))
        if len(body) > MOST_BODY_BYTES:
            return body
        if size == 0:
            while line.readline(MOST_HEADER_BYTES) not in (b"\r\n", b"\n", b""):
                pass  # trailers
            return body
        if line.readline(2) not in (b"\r\n", b"\n"):
            break
    raise _BadRequestError(400, "a chunk without its size or its end")


def _exactly(line: BufferedIOBase, count: int) -> bytes:
    part = line.read(count)
    if len(part) < count:
        raise _BadRequestError(400, "a body that is cut")
    return part


def _said(status: int, key: str, text: str) -> _Answer:
    return _Answer(status, _json({key: text}))


def _not_allowed(methods: str) -> _Answer:
    return _Answer(405, _json({"error": f"expected {methods}"}), header=("Allow", methods))


def _json(made: object) -> bytes:
    return json.dumps(made, separators=(",", ":")).encode()


def _is_unnamed(host: str) -> bool:
    """Whether a Host header holds an address, or the name that is this machine's everywhere."""
    try:
        name = urlsplit(f"//{host}").hostname or ""
        ip_address("127.0.0.1" if name == "localhost" else name)
    except ValueError:
        return False
    return True
