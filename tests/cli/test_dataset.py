"""The verb `dataset`: what it prints before and after, and how it ends."""

import signal
import socket
import threading

import pytest

from vlp16emu.extras.dataset import cluster

SPEC = """
schema = 1
layout = "pcap+truth"
seeds = [1, 2]
stands = [{ name = "hall", scene = "static_bench", set = ["duration_s=0.2"] }]
paths = [{ name = "middle" }]
sensors = [{ name = "puck" }]
splits = { train = 1.0, val = 0.0, test = 0.0 }
"""


@pytest.fixture
def spec(tmp_path):
    """Two walks of a fifth of a second."""
    path = tmp_path / "spec.toml"
    path.write_text(SPEC)
    return path


def test_a_dry_run_says_what_is_made_and_makes_nothing(cli, spec, tmp_path):
    """Number, size and hours come before anything is made, as a page and as JSON; they hold for the walks
    made then."""
    out = tmp_path / "out"
    page = cli("dataset", spec, out, "--dry-run", "--workers", "0")
    assert page.out.startswith("2 of 2 walks to be made\n  simulated  0.4 s\n  size       ")
    assert "\nstand and sensor  measured  growth, CPU  CPU per s  MB per s\nhall, puck " in page.out
    tree = cli("dataset", spec, out, "--dry-run", "--json").tree
    assert sorted(path.name for path in tmp_path.iterdir()) == ["spec.toml"]
    made = cli("dataset", spec, out, "--workers", "0", "--json").tree
    assert tree["missing"] == made["made"] == 2
    assert tree["bytes"] == made["bytes"]
    again = cli("dataset", spec, out, "--dry-run")
    assert again.out.startswith("0 of 2 walks to be made\n")


@pytest.mark.parametrize(
    ("scheduler", "said"),
    [
        ("", "error: --scheduler: found an empty text; expected a value, ADDRESS\n"),
        ("127.0.0.1", "error: scheduler: found '127.0.0.1'; expected tcp://HOST:PORT "),
        ("spec.toml", "error: spec.toml: is no scheduler file; expected tcp://HOST:PORT "),
        (
            "foo://127.0.0.1:1",
            "error: foo://127.0.0.1:1: no Dask scheduler answers (unknown address scheme 'foo'",
        ),
        ("tcp://127.0.0.1:9", "error: tcp://127.0.0.1:9: no Dask scheduler answers (Timed out "),
    ],
)
def test_a_scheduler_that_cannot_be_reached_is_one_line(
    refused, spec, tmp_path, monkeypatch, scheduler, said
):
    """A wrong address, a missing scheduler file or a silent scheduler is refused before anything is made."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cluster, "_REACHED_WITHIN_S", 0.1)
    assert refused(["dataset", spec, "out", "--scheduler", scheduler]).startswith(said)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["spec.toml"]


@pytest.fixture
def mute_server():
    """A server on this machine that takes a connection and never answers: its address, and the event of
    the connection."""
    came = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            connection, _ = server.accept()
            came.set()
            with connection:
                while connection.recv(4096):
                    pass

        thread = threading.Thread(target=serve)
        thread.start()
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}", came
        thread.join()


def test_the_wait_for_a_scheduler_ends_with_the_first_signal(cli, spec, tmp_path, mute_server):
    """Ctrl-C while a server does not answer as a scheduler ends the command with 130, and nothing is made."""
    address, came = mute_server
    here, before = threading.get_ident(), signal.signal(signal.SIGINT, signal.default_int_handler)

    def interrupt():
        came.wait()
        signal.pthread_kill(here, signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    outcome = cli("dataset", spec, tmp_path / "out", "--scheduler", address)
    thread.join()
    signal.signal(signal.SIGINT, before)
    assert (outcome.code, outcome.out) == (130, "")
    assert not (tmp_path / "out").exists()
