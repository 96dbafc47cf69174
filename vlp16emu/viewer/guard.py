"""The server of the page: viser behind a check of Host and Origin, on one port, without its public tunnel.

viser itself listens on all interfaces, answers any page that a browser has open, and asks for a public address when a page wants one.
"""

import logging
import socketserver
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from http import HTTPStatus
from io import StringIO
from typing import Any
from unittest.mock import patch
from urllib.parse import urlsplit

import viser
from websockets.asyncio.server import serve
from websockets.datastructures import Headers
from websockets.http11 import Response

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
    """Serve the page until the end of the context.

    Parameters
    ----------
    host : address of this machine to listen on, and beside loopback the only one that requests may name
    port : to listen on; 0 for any that is free
    label : title of the panel

    Raises
    ------
    OutputError
        where the address is not of this machine, or the port is in use
    """
    try:  # viser would try the next thousand ports, and wait for ever where there is no such address
        with socketserver.TCPServer((host, port), socketserver.BaseRequestHandler):
            pass
    except OSError as error:
        found = (error.strerror or "cannot be used").lower()
        raise OutputError(f"{host}:{port}", found, "an address of this machine with a free port") from None
    with redirect_stdout(StringIO()), patch("websockets.asyncio.server.serve", _guarded(host)):
        server = viser.ViserServer(host=host, port=port, label=label, verbose=False)
    server.request_share_url = lambda verbose=True: None  # noqa: ARG005  # no public tunnel, whoever asks
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    try:
        yield server
    finally:
        with redirect_stdout(StringIO()):
            server.stop()


def _guarded(host: str) -> Callable[..., Any]:
    """Make the function that opens viser's server check each request before viser sees it."""
    names = LOOPBACK | {host}
    silent = logging.getLogger(f"{__name__}.{host}")
    silent.setLevel(logging.CRITICAL + 1)  # of what a stranger sends no line is written

    def checked(*arguments: Any, process_request: Callable[..., Any], **options: Any) -> Any:

        def answer(connection: Any, request: Any) -> Any:
            if is_ours(request.headers, names):
                return process_request(connection, request)
            return Response(HTTPStatus.FORBIDDEN, "Forbidden", Headers({"Content-Length": "0"}))

        options |= {"max_size": _LONGEST_BYTES, "logger": silent}
        return serve(*arguments, process_request=answer, **options)

    return checked
