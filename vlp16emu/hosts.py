"""One way to hosts: names are looked up here, and a name server that does not answer keeps no run."""

import socket
from contextlib import ExitStack, suppress
from ipaddress import ip_address

from vlp16emu.errors import InputError, OutputError
from vlp16emu.output import unless_ending

LOOPBACK = "127.0.0.1"  # this machine
LAST_PORT = 65_535
_NEAR = {"0.0.0.0": LOOPBACK, "::": "::1"}  # noqa: S104  # for all addresses of a family, the one nearest
_BACKLOG = 128  # connections that wait until they are served

Address = tuple[str, int] | tuple[str, int, int, int]
"""Address and port; for IPv6 also flow and scope, as the module `socket` has them."""


def host_and_port(text: str, option: str, expected: str, scheme: str = "") -> tuple[str, int]:
    """Return host and port of HOST:PORT after a scheme, IPv6 addresses in brackets.

    Without a scheme the host may be empty.

    Raises InputError with `option` in front if it is malformed.
    """
    host, _, port = text.removeprefix(scheme).rpartition(":")
    is_place = text.startswith(scheme) and (host or not scheme)
    bare = host[1:-1] if host.startswith("[") and host.endswith("]") else host
    is_place = is_place and is_ipv6(bare) == (bare != host)
    if not (is_place and port.isascii() and port.isdecimal() and int(port) <= LAST_PORT):
        raise InputError(option, f"found {text}", expected)
    return bare, int(port)


def resolve(host: str, where: str = "destination") -> str:
    """Return the IPv4 address of a host; a VLP-16 does not support IPv6.

    Raises OutputError for `where` if the host is unknown, or its address is that of no host.
    """
    expected = "the IPv4 address or the name of a host"
    if not host or host.isspace():
        raise OutputError(where, "nothing", expected)
    if is_ipv6(host):
        raise OutputError(where, f"{host}, an IPv6 address", expected)
    try:
        address, _ = look_up(host, 0, socket.AF_INET)[:2]
    except (OSError, UnicodeError) as error:
        raise OutputError(where, f"{host!r}, which is unknown", expected) from error
    if is_wildcard(address):
        raise OutputError(where, f"{address}, which is no host", expected)
    return address


def look_up(host: str, port: int, family: int) -> Address:
    """Return the first address of a host in a family, AF_INET or AF_INET6, with a port.

    Raises OSError or UnicodeError if the name is unknown; CancelledError if the run ends before the answer.
    """
    found = unless_ending(lambda: socket.getaddrinfo(host, port, family, socket.SOCK_DGRAM))
    return found[0][4]  # type: ignore[return-value]  # other tuples are of other families


def bound(kind: socket.SocketKind, host: str, port: int, where: str) -> socket.socket:
    """Return a socket that is bound to an address of this machine, port 0 for any that is free.

    Parameters
    ----------
    kind : SOCK_STREAM for one that listens, which may have an IPv6 address; or SOCK_DGRAM
    host : address or name
    where : place in error lines

    Raises OutputError if the address is not of this machine, or the port is in use.
    """
    listens = kind is socket.SOCK_STREAM
    expected = f"an {'' if listens else 'IPv4 '}address of this machine and a free port"
    if not host.strip():
        raise OutputError(where, f"found '{host}'", expected)
    if is_ipv6(host) and not listens:
        raise OutputError(where, "an IPv6 address", expected)
    family = socket.AF_INET6 if listens and is_ipv6(host) else socket.AF_INET
    with ExitStack() as stack:
        opened = stack.enter_context(socket.socket(family, kind))
        try:
            if listens:  # again at once after a run
                opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            opened.bind(look_up(host, port, family))
            if listens:
                opened.listen(_BACKLOG)
        except (OSError, UnicodeError) as error:
            found = getattr(error, "strerror", None) or "no name of a host"
            raise OutputError(where, found.lower(), expected) from error
        stack.pop_all()
    return opened


def free_address(host: str, port: int, where: str) -> str:
    """Return the address of a host of this machine on which a library can listen; errors as `bound`."""
    with bound(socket.SOCK_STREAM, host, port, where) as tried:
        numeric = socket.NI_NUMERICHOST | socket.NI_NUMERICSERV
        address, _ = socket.getnameinfo(tried.getsockname(), numeric)
    return address


def url_of(host: str, port: int) -> str:
    """Return the URL of a page by which a browser on this machine opens it.

    For all addresses of this machine there is the nearest one.
    """
    return f"http://{place_of(_NEAR.get(host, host), port)}/"


def place_of(host: str, port: int) -> str:
    """Return host and port as a text, IPv6 addresses in brackets (RFC 3986, section 3.2.2)."""
    return f"[{host}]:{port}" if is_ipv6(host) else f"{host}:{port}"


def is_ipv6(host: str) -> bool:
    """Return True for an IPv6 address."""
    with suppress(ValueError):
        return ip_address(host).version == 6
    return False


def is_wildcard(host: str) -> bool:
    """Return True for an address that stands for all addresses of this machine."""
    with suppress(ValueError):
        return ip_address(host).is_unspecified
    return False


def is_address(host: str) -> bool:
    """Return True for an address, and False for a name."""
    with suppress(ValueError):
        ip_address(host)
        return True
    return False
