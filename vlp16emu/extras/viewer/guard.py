"""The server of the page: viser behind a check of Host and Origin, on one port, without its public tunnel.

viser itself listens on all interfaces, answers any page that a browser has open, and asks for a public address when a page wants one.
"""

import asyncio
import logging
import socketserver
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from http import HTTPStatus
from io import StringIO
from urllib.parse import urlsplit

import viser
from websockets.asyncio.server import Server, ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from vlp16emu.errors import OutputError

LOOPBACK = frozenset({"127.0.0.1", "localhost"})
_LONGEST_BYTES = 1 << 16
"""Of a message of the page: a drag or a value takes some hundred bytes."""


def is_ours(headers: Headers, names: frozenset[str]) -> bool:
    """Whether a request is for one of our names, and comes from no page but our own.

    A page of another origin sends its own in `Origin` (RFC 6454, section 7); one whose name was made to lead here sends that in `Host`.
    """
    hosts = headers.get_all("Host")
    if len(hosts) != 1 or _name(f"//{hosts[0]}") not in names:
        return False
    origins = headers.get_all("Origin")
    return not origins or origins == [f"http://{hosts[0]}"]


def _name(url: str) -> str | None:
    """Host name of an address; None of what is none."""
    try:
        return urlsplit(url).hostname
    except ValueError:
        return None


@contextmanager
def guarded_server(host: str, port: int, label: str) -> Iterator[viser.ViserServer]:
    """Serve the page until the end of the context; OutputError where the address is not of this machine, or the port in use.

    `host` is beside loopback the only name that requests may use; port 0 is any that is free; the panel's title is `label`.
    """
    try:  # viser would try the next thousand ports, and wait for ever where there is no such address
        with socketserver.TCPServer((host, port), socketserver.BaseRequestHandler):
            pass
    except OSError as error:
        found = (error.strerror or "cannot be used").lower()
        raise OutputError(f"{host}:{port}", found, "an address of this machine with a free port") from None
    with redirect_stdout(StringIO()):
        server = viser.ViserServer(host=host, port=port, label=label, verbose=False)
    try:
        _guard(server, LOOPBACK | {host})
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        yield server
    finally:
        with redirect_stdout(StringIO()):
            server.stop()


def _guard(server: viser.ViserServer, names: frozenset[str]) -> None:
    """Check each request before viser sees it, and let no page ask for a public tunnel."""
    server.request_share_url = lambda verbose=True: None  # noqa: ARG005
    # Of what a stranger sends no line is written.
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL + 1)
    loop = server.get_event_loop()
    web = _web_server(loop)
    answer = web.process_request
    assert answer is not None

    def checked(connection: ServerConnection, request: Request) -> Response | None:
        if not is_ours(request.headers, names):
            return Response(HTTPStatus.FORBIDDEN, "Forbidden", Headers({"Content-Length": "0"}))
        connection.protocol.max_message_size = _LONGEST_BYTES
        return answer(connection, request)  # type: ignore[return-value]  # viser's is no coroutine

    web.process_request = checked

    def drop_unchecked() -> None:
        for connection in web.handlers:
            connection.transport.abort()

    loop.call_soon_threadsafe(drop_unchecked)  # who came before the check was there


def _web_server(loop: asyncio.AbstractEventLoop) -> Server:
    """Return the server of websockets that viser runs: it lives in viser's task alone."""
    frames = (frame for task in asyncio.all_tasks(loop) for frame in task.get_stack())
    return next(one for frame in frames for one in frame.f_locals.values() if isinstance(one, Server))
