"""The page beside a stream, from the command line."""

import json
import os
import re
import signal
import socket
import sys
import urllib.request
from pathlib import Path

import pytest

pytest.importorskip("viser", reason="the extra viewer is not installed")

STREAM = ("stream", "static_bench", "--no-keep-up", "--data-port", "0", "--position-port", "0")


def page_of(process):
    """Process identifier of the page of a stream."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text(encoding="ascii").split()
    (child,) = (
        int(child) for child in children if b"live_page" in Path(f"/proc/{child}/cmdline").read_bytes()
    )
    return child


def test_a_killed_page_is_one_line_and_ctrl_c_ends_both(program):
    """After kill -9 of the page the stream says so and goes on; Ctrl-C ends a stream with exit code 130,
    and its page with it."""
    process = program(*STREAM, "--view", "--view-port", "0", "--duration", "600")
    assert process.stdout.readline().startswith("page at http://127.0.0.1:")
    assert process.stdout.readline().startswith("streaming static_bench")
    assert process.stdout.readline().startswith("web interface at http://127.0.0.1:")
    os.kill(page_of(process), signal.SIGKILL)
    assert process.stderr.readline() == "the page in the browser has ended; the stream goes on\n"
    assert process.poll() is None
    other = program(*STREAM, "--view", "--view-port", "0", "--duration", "600")
    url = re.search(r"http\S+", other.stdout.readline())[0]
    assert urllib.request.urlopen(url).status == 200
    other.stdout.readline()
    for each in (process, other):
        each.send_signal(signal.SIGINT)
        assert each.wait(60) == 130
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(url)


def test_json_stays_one_object_and_a_prepared_run_has_a_page(program):
    """With --json the address of the page is on standard error; a prepared run has a page too, and no web
    interface."""
    process = program(*STREAM, "--view", "--view-port", "0", "--duration", "0.2", "--prepare", "--json")
    out, error = process.communicate()
    assert json.loads(out)["interrupted"] is False
    assert re.fullmatch(r"page at http://127\.0\.0\.1:\d+/\n", error)
    assert process.returncode == 0


def test_a_port_in_use_is_one_line(refused):
    """The stream is refused before its world is grown, with the port and the reason."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        number = taken.getsockname()[1]
        line = refused([*STREAM, "--view", "--view-port", number])
    assert line == (
        f"error: 127.0.0.1:{number}: address already in use; expected an address of this machine and a "
        "free port\n"
    )


def test_without_the_extra_one_line_names_it(refused, monkeypatch):
    """Without viser, --view names the extra to install."""
    monkeypatch.setitem(sys.modules, "viser", None)
    line = refused([*STREAM, "--view"])
    assert line == "error: the page in the browser needs viser: pip install 'vlp16emu[viewer]'\n"
