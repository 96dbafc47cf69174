"""Names, addresses and URLs of hosts: IPv4 for what a sensor has, IPv6 also for pages."""

import socket
from urllib.parse import urlsplit

import pytest

from vlp16emu.errors import InputError, OutputError
from vlp16emu.hosts import bound, host_and_port, is_wildcard, resolve, url_of

NEAR = {
    "127.0.0.1": "http://127.0.0.1:80/",
    "0.0.0.0": "http://127.0.0.1:80/",
    "::1": "http://[::1]:80/",
    "::": "http://[::1]:80/",
    "localhost": "http://localhost:80/",
}


@pytest.mark.parametrize("host", NEAR)
def test_the_url_of_a_page_opens_on_this_machine(host):
    """The URL is one of RFC 3986, as Python's own parser reads it; a wildcard, by which no page opens
    everywhere, is the loopback of its family."""
    url = url_of(host, 80)
    assert url == NEAR[host]
    read = urlsplit(url)
    assert (read.port, is_wildcard(read.hostname)) == (80, False)


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("[::1]:80", ("::1", 80)),
        ("10.0.0.7:80", ("10.0.0.7", 80)),
        ("lidar:0", ("lidar", 0)),
        ("80", ("", 80)),
        (":80", ("", 80)),
        ("::1:80", None),
        (":::80", None),
        ("[10.0.0.7]:80", None),
        ("[]:80", None),
        ("lidar:65536", None),
        ("lidar:-1", None),
    ],
)
def test_an_ipv6_address_with_a_port_stands_in_brackets(text, place):
    """Without them its end could be the port (RFC 3986, section 3.2.2); nothing else has brackets."""
    if place is None:
        with pytest.raises(InputError, match="--http: found "):
            host_and_port(text, "--http", "HOST:PORT")
    else:
        assert host_and_port(text, "--http", "HOST:PORT") == place


@pytest.mark.parametrize("host", ["::1", "::", "fe80::1", "2001:db8::7"])
def test_packets_and_poses_go_by_ipv4(host):
    """A VLP-16 does not support IPv6: an address of it is called so where datagrams leave or arrive."""
    with pytest.raises(OutputError, match=rf"^destination: {host}, an IPv6 address; expected the IPv4 "):
        resolve(host)
    with pytest.raises(OutputError, match=r"^udp://x: an IPv6 address; expected an IPv4 address of this "):
        bound(socket.SOCK_DGRAM, host, 0, "udp://x")


@pytest.mark.parametrize("host", ["", " ", "a..b", "192.0.2.1"])
def test_a_page_is_served_on_an_address_of_this_machine(host):
    """No text, no name and an address of documentation (RFC 5737) are refused: none is all addresses."""
    with pytest.raises(
        OutputError, match=r"^--http: .*; expected an address of this machine and a free port"
    ):
        bound(socket.SOCK_STREAM, host, 0, "--http")


def test_a_page_is_served_by_ipv6():
    """The loopback of IPv6 is listened on, where this machine has it."""
    if not socket.has_ipv6:
        pytest.fail("this Python has no IPv6")
    with bound(socket.SOCK_STREAM, "::1", 0, "--http") as listener:
        port = listener.getsockname()[1]
        with socket.create_connection(("::1", port), timeout=20):
            assert urlsplit(url_of("::1", port)).hostname == "::1"
