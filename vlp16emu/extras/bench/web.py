"""The web interface of the sensor, in a thread of its own.

Some hand-written clients accept only this spelling of `Content-Length`, no chunks, and perhaps only the first
segment. So each answer has that header, and leaves in one piece.
"""

import asyncio
import json
import re
import socket
from asyncio import StreamReader, StreamWriter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from http.client import responses
from ipaddress import ip_address
from pathlib import Path
from threading import Event, Thread
from typing import Self
from urllib.parse import urlsplit

from vlp16emu.errors import Vlp16emuError
from vlp16emu.extras.bench.device import PATHS, Device, FormError, document, submit

MOST_CONNECTIONS = 32  # at a time; more connections are closed
MOST_BODY_BYTES = 4096
MOST_HEADER_BYTES = 8192
LONGEST_S = 5.0  # greatest time for a request and its answer, waiting included

_TOKEN = rb"[!#-'*+.0-9A-Z^-z|~-]+"
_HEAD = re.compile(rb"(%b) ([!-~]+) HTTP/1\.([01])\r?\n((?:%b:[^\x00\r\n]*\r?\n)*)\r?\n" % (_TOKEN, _TOKEN))
"""Method, target, minor version and header lines (RFC 9112, sections 3 and 5)."""
_ONCE = ("host", "content-length", "transfer-encoding")
_CHUNK = re.compile(rb"([0-9A-Fa-f]{1,8})[ \t]*(?:;[^\r\n]*)?\r?\n")
_JSON = "application/json"
_HTML = "text/html; charset=utf-8"
_PAGE_POLICY = (
    "default-src 'none'; connect-src 'self'; img-src data:; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; form-action 'none'; frame-ancestors 'none'"
)


@dataclass(frozen=True, slots=True)
class _Request:
    method: str
    path: str  # without the query
    headers: dict[str, str]  # by names in lower case
    body: bytes  # `MOST_BODY_BYTES` + 1 bytes if it is too long
    is_last: bool  # True if the connection ends with its answer


@dataclass(frozen=True, slots=True)
class _Answer:
    status: int
    body: bytes = b""
    kind: str = _JSON
    header: tuple[str, str] = ("Cache-Control", "no-store")  # in addition to type and length

    def to_bytes(self, *, bare: bool = False, is_last: bool) -> bytes:
        """Return the answer in one piece; `bare` leaves out the body, for a HEAD request."""
        lines = (
            f"HTTP/1.1 {self.status} {responses.get(self.status, '')}",
            f"Content-Type: {self.kind}",
            f"Content-Length: {len(self.body)}",
            "{}: {}".format(*self.header),
            *(["Connection: close"] if is_last else []),
        )
        return "\r\n".join((*lines, "", "")).encode("ascii") + (b"" if bare else self.body)


class _BadRequestError(Exception):
    """A request that is malformed or too long; its arguments are the status and the reason."""


class WebServer:
    """The web interface of one sensor; a context manager, inside which it answers.

    Parameters
    ----------
    device : settings and status of the sensor
    listener : socket that listens, see `hosts.bound`
    fault : returns the present fault: HTTP status of all answers, 0 for no answer, None for no fault
    delay_s : returns the present delay of all answers, in seconds, which `LONGEST_S` does not include

    `fault` and `delay_s` are called from the server's thread, and must not wait.
    """

    def __init__(
        self,
        device: Device,
        listener: socket.socket,
        *,
        fault: Callable[[], int | None] = lambda: None,
        delay_s: Callable[[], float] = lambda: 0.0,
    ) -> None:
        self.device = device
        self.fault = fault
        self.delay_s = delay_s
        self.page = Path(__file__).with_name("page.html").read_bytes()
        self._connections = dict[StreamWriter, asyncio.Task[None] | None]()
        self._has_begun = Event()
        self._thread = Thread(target=lambda: asyncio.run(self._run()), name="web interface", daemon=True)
        self._socket = listener
        self.is_private = ip_address(self.address[0]).is_loopback

    @property
    def address(self) -> tuple[str, int]:
        """Address and port where it listens."""
        host, port, *_ = self._socket.getsockname()
        return host, port

    def __enter__(self) -> Self:
        self._thread.start()
        self._has_begun.wait()
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._end.set)
        self._thread.join()

    async def _run(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._end = asyncio.Event()
        self._loop.set_exception_handler(lambda *_: None)  # a broken connection is no message for people
        server = await asyncio.start_server(
            self._serve_connection, sock=self._socket, limit=MOST_HEADER_BYTES
        )
        self._has_begun.set()
        await self._end.wait()
        server.close()
        for writer in self._connections:
            writer.transport.abort()
        await asyncio.gather(*filter(None, self._connections.values()), return_exceptions=True)

    async def _serve_connection(self, reader: StreamReader, writer: StreamWriter) -> None:
        """Answer the requests of one connection in order, each within its time limit.

        A connection above `MOST_CONNECTIONS` is closed.
        """
        if len(self._connections) >= MOST_CONNECTIONS:
            writer.transport.abort()
            return
        self._connections[writer] = asyncio.current_task()
        try:
            while self.device.is_up():
                async with asyncio.timeout(LONGEST_S) as limit:
                    if not await self._answer_request(reader, writer, limit):
                        break
                await asyncio.sleep(0)  # other connections get their turn, even if many requests wait here
            writer.close()
        except BaseException as error:
            writer.transport.abort()
            if not isinstance(error, OSError):  # the client is gone or too slow
                raise
        finally:
            del self._connections[writer]

    async def _answer_request(
        self, reader: StreamReader, writer: StreamWriter, limit: asyncio.Timeout
    ) -> bool:
        """Answer a request, and return True if another one may follow."""
        try:
            request = await _read_request(reader)
        except _BadRequestError as error:
            status, text = error.args
            writer.write(_message(status, "error", text).to_bytes(is_last=True))
            await _read_rest(reader, writer)
            return False
        if request is None or not self.device.is_up():
            return False
        delay_s = self.delay_s()
        limit.reschedule(self._loop.time() + LONGEST_S + delay_s)
        if delay_s and await self._is_over_within(delay_s):
            return False
        if (status := self.fault()) == 0:
            await self._end.wait()
            return False
        answer = (
            _message(status, "error", responses.get(status, "fault")) if status else _answer(request, self)
        )
        writer.write(answer.to_bytes(bare=request.method == "HEAD", is_last=request.is_last))
        if len(request.body) > MOST_BODY_BYTES:
            await _read_rest(reader, writer)
            return False
        await writer.drain()
        return not request.is_last

    async def _is_over_within(self, delay_s: float) -> bool:
        """Wait for the end of the server for some time, and return True if it has come."""
        with suppress(TimeoutError):
            async with asyncio.timeout(delay_s):
                await self._end.wait()
        return self._end.is_set()


async def _read_rest(reader: StreamReader, writer: StreamWriter) -> None:
    """Read the rest of a request: unread bytes would reset the connection before the answer arrives."""
    writer.write_eof()
    while await reader.read(MOST_HEADER_BYTES):
        pass


def _answer(request: _Request, server: WebServer) -> _Answer:
    if len(request.body) > MOST_BODY_BYTES:
        return _message(413, "error", f"more than {MOST_BODY_BYTES} bytes")
    if _is_foreign(request, is_private=server.is_private):
        return _message(403, "error", "a request that a page of another site has sent")
    if request.path in PATHS:
        if request.method != "POST":
            return _method_not_allowed("POST")
        try:
            submit(request.path, request.body, server.device)
        except FormError as error:
            return _message(200, "ignored", str(error))
        except Vlp16emuError as error:
            return _message(500, "error", str(error))
        return _Answer(204)
    if request.path == "/":
        answer = _Answer(200, server.page, _HTML, ("Content-Security-Policy", _PAGE_POLICY))
    elif (tree := document(request.path, server.device)) is not None:
        answer = _Answer(200, _json(tree))
    else:
        return _message(404, "error", "no such path")
    return answer if request.method in ("GET", "HEAD") else _method_not_allowed("GET, HEAD")


def _is_foreign(request: _Request, *, is_private: bool) -> bool:
    """Return True if a browser sends a request for the page of another site.

    Pages of other sites can send forms to any host, and their names may resolve to this machine. So the
    origin of a form must be the requested host, and on an interface of this machine alone the host must be an
    address.
    """
    host = request.headers.get("host")
    origin = request.headers.get("origin")
    if request.method == "POST" and origin not in (None, f"http://{host}"):
        return True
    if not is_private or host is None:
        return False
    try:  # an address, or localhost
        name = urlsplit(f"//{host}").hostname or ""
        ip_address("127.0.0.1" if name == "localhost" else name)
    except ValueError:
        return True
    return False


async def _read_request(reader: StreamReader) -> _Request | None:
    """Read a request, and its body up to the limit of length; None if there is no other request."""
    head = await reader.read(1)
    if not head:
        return None
    while head[0] > ord(" ") and not head.endswith((b"\n\r\n", b"\n\n")):
        part = await _read_line(reader)
        head += part
        if len(head) > MOST_HEADER_BYTES:
            raise _BadRequestError(431, f"a head of more than {MOST_HEADER_BYTES} bytes")
        if not part:
            break
    if not (match := _HEAD.fullmatch(head)):
        raise _BadRequestError(400, "no request of HTTP/1.1")
    method, target, minor = (part.decode("ascii") for part in match.groups()[:3])
    parts = [text.partition(":") for text in match[4].decode("latin-1").split("\n")[:-1]]
    headers = {name.lower(): value.strip() for name, _, value in parts}
    names = [name.lower() for name, *_ in parts]
    for name in _ONCE:
        if names.count(name) > 1:
            raise _BadRequestError(400, f"more than one {name} header")
    if minor == "1" and "host" not in headers:
        raise _BadRequestError(400, "no host header")
    body = await _read_body(reader, headers)
    is_closing = "close" in re.split(r"[ \t,]+", headers.get("connection", "").lower())
    is_last = minor == "0" or is_closing or len(body) > MOST_BODY_BYTES
    return _Request(method, target.partition("?")[0], headers, body, is_last)


async def _read_line(reader: StreamReader) -> bytes:
    """Return a line, or more bytes than the limit of a head."""
    try:
        return await reader.readline()
    except ValueError:  # the limit of the reader
        return bytes(MOST_HEADER_BYTES + 1)


async def _read_body(reader: StreamReader, headers: dict[str, str]) -> bytes:
    """Return a body; for one that is too long, one byte more than the limit."""
    coding = headers.get("transfer-encoding")
    length = headers.get("content-length", "0")
    if coding is None:
        if not re.fullmatch(r"[0-9]{1,20}", length, re.ASCII):
            raise _BadRequestError(400, "a content-length that is no number")
        return await _read_exactly(reader, min(int(length), MOST_BODY_BYTES + 1))
    if coding.lower() != "chunked":
        raise _BadRequestError(501, "a transfer-encoding other than chunked")
    body = b""
    while match := _CHUNK.fullmatch(await _read_line(reader)):
        size = int(match[1], 16)
        body += await _read_exactly(reader, min(size, MOST_BODY_BYTES + 1 - len(body)))
        if len(body) > MOST_BODY_BYTES:
            return body
        if size == 0:
            while await _read_line(reader) not in (b"\r\n", b"\n", b""):
                pass  # trailers
            return body
        if await _read_line(reader) not in (b"\r\n", b"\n"):
            break
    raise _BadRequestError(400, "a chunk without its size or its end")


async def _read_exactly(reader: StreamReader, count: int) -> bytes:
    try:
        return await reader.readexactly(count)
    except asyncio.IncompleteReadError:
        raise _BadRequestError(400, "a body that is cut") from None


def _message(status: int, key: str, text: str) -> _Answer:
    return _Answer(status, _json({key: text}))


def _method_not_allowed(methods: str) -> _Answer:
    return _Answer(405, _json({"error": f"expected {methods}"}), header=("Allow", methods))


def _json(value: object) -> bytes:
    return json.dumps(value, separators=(",", ":")).encode()
