"""The server of the page: viser on one port, behind a check of Host, Origin and messages, without its public tunnel.

viser itself listens on all interfaces, answers any page that a browser has open, asks for a public address when a page wants one,
and lets a message set any attribute of a control.
"""

import logging
import socketserver
from asyncio import all_tasks
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from http import HTTPStatus
from io import StringIO
from typing import Any
from urllib.parse import urlsplit

import viser
from websockets.asyncio.server import Server, ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from vlp16emu.errors import OutputError

LOOPBACK = frozenset({"127.0.0.1", "localhost"})
_LONGEST_BYTES = 1 << 16  # limit of a message of the page: a drag or a value takes some hundred bytes


def is_ours(headers: Headers, names: frozenset[str]) -> bool:
    """Return whether a request is for one of our names and comes from no page but our own.

    A page of another origin sends its own in `Origin` (RFC 6454, section 7); a name that was made to resolve to this machine is in `Host`.
    """
    hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
    with suppress(ValueError):  # of an address that is none
        if len(hosts) == 1 and urlsplit(f"//{hosts[0]}").hostname in names:
            return not origins or origins == [f"http://{hosts[0]}"]
    return False


@contextmanager
def guarded_server(host: str, port: int, label: str) -> Iterator[viser.ViserServer]:
    """Serve the page until the end of the context; OutputError if the address is not of this machine, or the port is in use.

    Parameters
    ----------
    host : address to listen on; beside loopback the only name that requests may use
    port : 0 for any that is free
    label : title of the panel
    """
    try:  # viser would try the next thousand ports, and wait for ever if there is no such address
        with socketserver.TCPServer((host, port), socketserver.BaseRequestHandler):
            pass
    except OSError as error:
        found = (error.strerror or "cannot be used").lower()
        raise OutputError(f"{host}:{port}", found, "an address of this machine with a free port") from None
    with redirect_stdout(StringIO()):
        server = viser.ViserServer(host=host, port=port, label=label, verbose=False)
    try:
        _check_messages(server)
        _check_requests(server, LOOPBACK | {host})
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        yield server
    finally:
        with redirect_stdout(StringIO()):
            server.stop()


def _check_messages(server: viser.ViserServer) -> None:
    """Drop messages that set more than a control's value, and those that viser fails at; let none ask for a tunnel."""
    server.request_share_url = lambda verbose=True: None  # noqa: ARG005
    messages = server._websock_server  # noqa: SLF001  # viser has no hook for messages
    handle = messages._handle_incoming_message  # noqa: SLF001

    async def checked(client: Any, message: Any) -> None:
        if set(getattr(message, "updates", ())) <= {"value"}:
            with suppress(Exception):  # it is the sender's fault whatever it is
                await handle(client, message)

    messages._handle_incoming_message = checked  # noqa: SLF001


def _check_requests(server: viser.ViserServer, names: frozenset[str]) -> None:
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL + 1)  # strangers write no line of ours
    loop = server.get_event_loop()
    # viser's server of websockets is a local of a task of its own.
    values = (value for task in all_tasks(loop) for frame in task.get_stack() for value in frame.f_locals.values())
    web = next(value for value in values if isinstance(value, Server))
    answer = web.process_request
    assert answer is not None

    def checked(connection: ServerConnection, request: Request) -> Response | None:
        if not is_ours(request.headers, names):
            return Response(HTTPStatus.FORBIDDEN, "Forbidden", Headers({"Content-Length": "0"}))
        connection.protocol.max_message_size = _LONGEST_BYTES
        return answer(connection, request)  # type: ignore[return-value]  # viser's is no coroutine

    def drop_unchecked() -> None:
        for connection in web.handlers:
            connection.transport.abort()

    web.process_request = checked
    loop.call_soon_threadsafe(drop_unchecked)  # who came before the check was there
