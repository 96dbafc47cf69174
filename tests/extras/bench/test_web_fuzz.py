"""Any request against the web interface: an answer that is right, in time, and a server that lives on.

200 examples of each kind; with `pytest --hypothesis-profile=long` 10 000 of each.
"""

import http.client
import ipaddress
import json
import re
import socket
import time

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

LONGEST_S = 60.0
"""Far more than the 5 s after which the server hangs up, on a machine that may be busy."""
MANY = settings(
    max_examples=max(200, settings.default.max_examples),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
"""The sensor is one for all examples, as on a bench: what is set stays set."""


def is_whole(text, low, high, step):
    return re.fullmatch("[0-9]{1,5}", text) and low <= int(text) <= high and int(text) % step == 0


def is_host(text, *, broadcast=False, unspecified=False):
    try:
        address = ipaddress.IPv4Address(text)
    except ValueError:
        return False
    if str(address) == "255.255.255.255":
        return broadcast
    return (unspecified or str(address) != "0.0.0.0") and int(address) < 0xE000_0000


def is_mask(text):
    masks = {str(ipaddress.ip_network(f"0.0.0.0/{length}").netmask) for length in range(1, 33)}
    return text in masks


def whole(low, high, step=1):
    return lambda text: is_whole(text, low, high, step)


PORT, SWITCH = (whole(1, 65_535), lambda text: str(int(text))), (("on", "off").__contains__, str.capitalize)
KEYS = {
    # where it is set: whether a value is taken, and how settings.json shows it
    ("/cgi/setting", "rpm"): (whole(300, 1200, 60), int),
    ("/cgi/setting", "returns"): (("Strongest", "Last", "Dual").__contains__, str),
    ("/cgi/setting", "laser"): SWITCH,
    ("/cgi/setting/fov", "start"): (whole(0, 359), int),
    ("/cgi/setting/fov", "end"): (whole(0, 359), int),
    ("/cgi/setting/host", "addr"): (lambda text: is_host(text, broadcast=True), str),
    ("/cgi/setting/host", "dport"): PORT,
    ("/cgi/setting/host", "tport"): PORT,
    ("/cgi/setting/net", "addr"): (is_host, str),
    ("/cgi/setting/net", "mask"): (is_mask, str),
    ("/cgi/setting/net", "gateway"): (lambda text: is_host(text, unspecified=True), str),
    ("/cgi/setting/net", "dhcp"): SWITCH,
    ("/cgi/setting/phaselock", "enabled"): SWITCH,
    ("/cgi/setting/phaselock", "offset"): (whole(0, 35_999), lambda text: str(int(text))),
}
DOCUMENTS = [f"/cgi/{name}" for name in ("settings.json", "status.json", "diag.json", "info.json", "snapshot.hdl")]
FORMS = sorted({path for path, _ in KEYS})
PLAIN = st.text(st.characters(min_codepoint=33, max_codepoint=126, exclude_characters="&=+%"), max_size=12)
VALUES = st.one_of(
    st.sampled_from(["on", "off", "On", "Strongest", "Last", "Dual", "dual", "600", "0600", "-1", "1e3", "", "nan"]),
    st.integers(0, 70_000).map(str),
    st.integers(5, 20).map(lambda number: str(60 * number)),
    st.ip_addresses(v=4).map(str),
    st.integers(0, 32).map(lambda length: str(ipaddress.ip_network(f"0.0.0.0/{length}").netmask)),
    PLAIN,
)


@pytest.fixture
def ask(web):
    """Ask in time."""

    def call(method, path, body=None, headers=None):
        line = http.client.HTTPConnection(*web.address, timeout=LONGEST_S)
        line.request(method, path, body, {"Connection": "close"} | (headers or {}))
        answer = line.getresponse()
        said = answer.read()
        line.close()
        assert method == "HEAD" or int(answer.headers["Content-Length"]) == len(said)
        return answer.status, said

    return call


def shown(config, path, key):
    """Take a value from settings.json."""
    group = path.removeprefix("/cgi/setting").strip("/")
    return (config[group] if group else config)[key]


@MANY
@given(
    path=st.sampled_from(FORMS), pairs=st.lists(st.tuples(st.sampled_from(sorted(KEYS)), VALUES), max_size=3), odd=PLAIN
)
def test_any_form_sets_what_it_may_and_nothing_else(web, ask, path, pairs, odd):
    """A form of good keys and values is answered 204 and read back; another one 200, and all is as before."""
    pairs = [(key, value) for (_, key), value in pairs] + ([(odd, "1")] if odd == "!" else [])
    before = json.loads(ask("GET", "/cgi/settings.json")[1])
    status, said = ask("POST", path, "&".join(f"{key}={value}" for key, value in pairs))
    after = json.loads(ask("GET", "/cgi/settings.json")[1])
    good = bool(pairs) and all((path, key) in KEYS and KEYS[path, key][0](value) for key, value in pairs)
    assert status == (204 if good else 200), (pairs, said)
    assert list(json.loads(said)) == ["ignored"] if status == 200 else said == b""
    for place, key in KEYS:
        given_ = [value for name, value in pairs if (place, name) == (path, key)]
        wanted = KEYS[path, key][1](given_[-1]) if good and given_ else shown(before, place, key)
        assert shown(after, place, key) == wanted


TOKENS = st.sampled_from(
    [b"GET ", b"POST ", b"/cgi/setting", b"/cgi/settings.json", b" HTTP/1.1", b" HTTP/1.0", b" HTTP/9", b"\r\n", b"\n",
     b"Host: 127.0.0.1\r\n", b"Host: evil\r\n", b"Content-Length: 7\r\n", b"Content-Length: 99999999999\r\n",
     b"Transfer-Encoding: chunked\r\n", b"Connection: close\r\n", b"Expect: 100-continue\r\n", b"\r\n\r\n", b"rpm=300",
     b"5\r\n", b"0\r\n\r\n", b"\x00", b"\xff\xfe", b": ", b"Upgrade: websocket\r\n", b"a" * 9000]
)  # fmt: skip


@MANY
@given(sent=st.one_of(st.binary(max_size=300), st.lists(TOKENS, max_size=12).map(b"".join)))
def test_any_bytes_are_answered_or_hung_up_on(web, ask, sent):
    """Whatever comes, the line is closed in time, what is said are whole answers, and the next client is served."""
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
    assert ask("GET", "/cgi/info.json")[0] == 200
    assert time.perf_counter() - begin_s < LONGEST_S
