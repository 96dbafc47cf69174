"""The web interface of the sensor, on a thread of its own.

Its readers include clients made by hand that know one way of writing `Content-Length`, take no chunks, and may look at no
more than the first segment: so each answer has that header, in this spelling, and leaves in one piece. General web servers
write it in lower case and send header and body apart, hence h11 on plain asyncio.
"""

import asyncio
import json
import re
import socket
from collections.abc import Callable
from dataclasses import dataclass
from http.client import responses
from ipaddress import ip_address
from pathlib import Path
from threading import Thread
from types import TracebackType
from typing import TYPE_CHECKING, Self
from urllib.parse import urlsplit

from vlp16emu.device.documents import document
from vlp16emu.device.forms import PATHS, FormError, submit
from vlp16emu.device.state import Device
from vlp16emu.errors import InputError, MissingExtraError, OutputError, Vlp16emuError

if TYPE_CHECKING:
    import h11


MOST_CONNECTIONS = 32
"""At a time; further ones are closed."""
MOST_BODY_BYTES = 4096
MOST_HEADER_BYTES = 8192
LONGEST_S = 5.0
"""For a request and its answer, and for the wait between two."""

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


def parse_http(text: str) -> tuple[str, int]:
    """Read where the web interface shall listen: `HOST:PORT`, or `PORT` alone on 127.0.0.1.

    Raises
    ------
    InputError
        where it is neither
    """
    host, _, port = text.rpartition(":")
    if not re.fullmatch(r"[0-9]{1,5}", port, re.ASCII) or int(port) > 65_535:
        raise InputError("--http", f"found {text!r}", "HOST:PORT, such as 127.0.0.1:8080")
    return host.strip("[]") or "127.0.0.1", int(port)


@dataclass(frozen=True, slots=True)
class _Request:
    method: str
    path: str
    """Without the query."""
    host: str | None
    origin: str | None
    body: bytes


@dataclass(frozen=True, slots=True)
class _Answer:
    status: int
    body: bytes = b""
    kind: str = _JSON
    header: tuple[str, str] = ("Cache-Control", "no-store")
    """Beside type and length."""


class WebServer:
    """The web interface of one sensor; a context manager, within which it answers.

    Parameters
    ----------
    device : what is asked and set
    host, port : where it listens; port 0 for a free one
    fault : gives what is wrong with it now, None for nothing; called from its thread, and must not wait

    Raises
    ------
    MissingExtraError
        where h11 is not installed
    OutputError
        where it cannot listen there
    """

    def __init__(
        self, device: Device, host: str, port: int, *, fault: Callable[[], HttpFault | None] = lambda: None
    ) -> None:
        try:
            import h11
        except ImportError:
            raise MissingExtraError("h11", "bench", "the web interface") from None
        del h11
        self._device, self._fault = device, fault
        self._page = Path(__file__).with_name("page.html").read_bytes()
        self._listener = _listening(host, port)
        self._is_private = ip_address(self.address[0]).is_loopback
        self._connections = 0
        self._runner = asyncio.Runner(loop_factory=asyncio.new_event_loop)
        self._stop = asyncio.Event()
        self._thread = Thread(target=self._run, name="web interface", daemon=True)

    @property
    def address(self) -> tuple[str, int]:
        """Address and port where it listens."""
        host, port, *_ = self._listener.getsockname()
        return host, port

    def __enter__(self) -> Self:
        self._loop = self._runner.get_loop()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join()

    def _run(self) -> None:
        with self._runner:
            self._runner.run(self._serve())

    async def _serve(self) -> None:
        server = await asyncio.start_server(self._connected, sock=self._listener)
        await self._stop.wait()
        server.close()

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer one connection until it ends."""
        self._connections += 1
        try:
            if self._connections <= MOST_CONNECTIONS:
                await self._converse(reader, writer)
                writer.close()
                async with asyncio.timeout(LONGEST_S):
                    await writer.wait_closed()
        except (ConnectionError, TimeoutError, asyncio.CancelledError):
            pass  # the last one at the end of all, which asyncio would log as a failure of this connection
        finally:
            writer.transport.abort()  # with answers that nobody takes
            self._connections -= 1

    async def _converse(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer request after request."""
        import h11

        line = h11.Connection(h11.SERVER, max_incomplete_event_size=MOST_HEADER_BYTES)
        while self._device.status().is_up:
            async with asyncio.timeout(LONGEST_S):
                try:
                    request = await _request(line, reader)
                except h11.RemoteProtocolError as error:
                    writer.write(_packed(line, _said(error.error_status_hint, "error", str(error))))
                else:
                    if request is None or not self._device.status().is_up:
                        return
                    answer = await self._faulty() or self._answer(request)
                    writer.write(_packed(line, answer, bare=request.method == "HEAD"))
                await writer.drain()
                if line.our_state is not h11.DONE:
                    if line.their_state is not h11.DONE:
                        await _listen_out(reader, writer)
                    return
                line.start_next_cycle()
                await asyncio.sleep(0)  # others come in between where requests are sent without waiting

    async def _faulty(self) -> _Answer | None:
        """Answer as a fault makes it; None without one."""
        fault = self._fault()
        if fault is None:
            return None
        if fault.status is None:
            await asyncio.sleep(2 * LONGEST_S)  # until the time is over
        assert fault.status is not None
        return _said(fault.status, "error", responses.get(fault.status, "fault"))

    def _answer(self, request: _Request) -> _Answer:
        """Answer as a sensor does that is well."""
        if len(request.body) > MOST_BODY_BYTES:
            return _said(413, "error", f"more than {MOST_BODY_BYTES} bytes")
        if self._is_foreign(request):
            return _said(403, "error", "a request that a page of another site has sent")
        if request.path in PATHS:
            return self._submitted(request) if request.method == "POST" else _not_allowed("POST")
        if request.path == "/":
            answer = _Answer(200, self._page, _HTML, ("Content-Security-Policy", _PAGE_POLICY))
        elif (made := document(request.path, self._device)) is not None:
            answer = _Answer(200, _json(made))
        else:
            return _said(404, "error", "no such path")
        return answer if request.method in ("GET", "HEAD") else _not_allowed("GET, HEAD")

    def _submitted(self, request: _Request) -> _Answer:
        try:
            submit(request.path, request.body, self._device)
        except FormError as refused:
            return _said(200, "ignored", str(refused))
        except Vlp16emuError as error:
            return _said(500, "error", str(error))
        return _Answer(204)

    def _is_foreign(self, request: _Request) -> bool:
        """Whether a browser sends it for a page that is not the sensor's own.

        Pages of other sites may send forms anywhere, and a name of theirs may lead to this machine: so the origin of a
        form must be the host that is asked, and on an interface that is for this machine alone a host has no name.
        """
        if request.method == "POST" and request.origin not in (None, f"http://{request.host}"):
            return True
        return self._is_private and request.host is not None and not _is_unnamed(request.host)


async def _request(line: "h11.Connection", reader: asyncio.StreamReader) -> _Request | None:
    """Read a request, and its body as far as it may be long; None where there is no further one."""
    import h11

    head: h11.Request | None = None
    body = b""
    while len(body) <= MOST_BODY_BYTES:
        event = line.next_event()
        if event is h11.NEED_DATA:
            line.receive_data(await reader.read(MOST_HEADER_BYTES))
        elif isinstance(event, h11.Request):
            head = event
        elif isinstance(event, h11.Data):
            body += event.data
        elif isinstance(event, h11.EndOfMessage):
            break
        else:
            return None
    assert head is not None
    headers = {name: value.decode("latin-1") for name, value in head.headers}
    target = head.target.decode("latin-1")
    return _Request(
        head.method.decode("ascii"),
        target.partition("?")[0],
        headers.get(b"host"),
        headers.get(b"origin"),
        body,
    )


async def _listen_out(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Let an answer arrive: what is left unread of the request would reset the line before."""
    writer.write_eof()
    while await reader.read(MOST_HEADER_BYTES):
        pass


def _packed(line: "h11.Connection", answer: _Answer, *, bare: bool = False) -> bytes:
    """Write an answer in one piece, to a HEAD request bare of its body."""
    import h11

    headers = [("Content-Type", answer.kind), ("Content-Length", str(len(answer.body))), answer.header]
    if line.their_state is not h11.DONE:
        headers.append(("Connection", "close"))
    reason = responses.get(answer.status, "")
    parts = (
        h11.Response(status_code=answer.status, headers=headers, reason=reason),
        h11.Data(data=b"" if bare else answer.body),
        h11.EndOfMessage(),
    )
    return b"".join(line.send(part) or b"" for part in parts)


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


def _listening(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except (OSError, UnicodeError) as error:
        found = getattr(error, "strerror", None) or "no name of a host"
        raise OutputError(
            f"--http {host}:{port}", found.lower(), "an address of this machine and a free port"
        ) from error
