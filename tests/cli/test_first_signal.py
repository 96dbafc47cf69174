"""The first signal ends the program where it waits for the outside world: for a reader, the answer of a name
server, or that of a server which has taken the connection."""

import json
import os
import shutil
import signal
import stat
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest
from cli.lines import GOOD, HOSTS, SPEC, WAITING_OUT, ending_of, with_path

PROGRAM = Path(__file__).with_name("forks.py")
NAME = "a-name-that-no-server-answers.example"


class Forks:
    """The program in forks of one process."""

    def __init__(self, process):
        self._process = process

    def end(self, words, folder, number, file=None):
        """Carry out a command in a folder, and return how the signal ended it."""
        (folder / "spec.toml").write_text(SPEC)
        command = {"words": words, "folder": str(folder), "signal": number, "file": file and str(file)}
        self._process.stdin.write(f"{json.dumps(command)}\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())


@contextmanager
def loaded(command):
    """Start the process, and end it."""
    pipes = dict.fromkeys(("stdin", "stdout"), subprocess.PIPE)
    with subprocess.Popen(command, text=True, **pipes) as process:
        yield Forks(process)
        process.stdin.close()


@pytest.fixture(scope="module")
def forks():
    """The program on this machine."""
    with loaded([sys.executable, str(PROGRAM)]) as ready:
        yield ready


@pytest.fixture(scope="module")
def without_names(tmp_path_factory):
    """The program in a network of its own, whose name server never answers."""
    if os.geteuid() != 0 or not all(map(shutil.which, ("ip", "unshare", "mount"))):
        pytest.skip("a private network needs root")
    if subprocess.run(["unshare", "--net", "--mount", "true"], capture_output=True, check=False).returncode:
        pytest.skip("this machine allows no private network")
    resolver = tmp_path_factory.mktemp("names") / "resolv.conf"
    resolver.write_text("nameserver 127.0.0.1\noptions timeout:30 attempts:5\n")  # the most: resolv.conf(5)
    script = 'ip link set lo up && mount --bind "$0" /etc/resolv.conf && exec "$@"'
    ours = ["sh", "-c", script, str(resolver), sys.executable, str(PROGRAM), "names"]
    with loaded(["unshare", "--net", "--mount", *ours]) as ready:
        yield ready


def words_of(verb, name, at, value, inputs):
    """Words of a good run of a verb with a value for one of its arguments or options."""
    words = [verb, *GOOD[verb].format(inputs=inputs).split()]
    return with_path(words, name, at, value)


@pytest.mark.parametrize(
    ("verb", "name", "at"), WAITING_OUT, ids=[f"{verb} {name}" for verb, name, _ in WAITING_OUT]
)
def test_an_output_without_a_reader_ends_with_sigterm(forks, inputs, tmp_path, verb, name, at):
    """A FIFO that nobody reads, as any output of any verb: it is refused, or SIGTERM ends the wait with 130
    and without a word; the FIFO stays."""
    pipe = tmp_path / f"pipe{ending_of(verb, name)}"
    os.mkfifo(pipe)
    end = forks.end(words_of(verb, name, at, pipe, inputs), tmp_path, signal.SIGTERM, pipe)
    assert end["code"] in ((130,) if end["waited"] else (0, 1, 2)), end
    assert not end["waited"] or "error" not in end["said"]
    assert "Traceback" not in end["said"]
    assert stat.S_ISFIFO(pipe.stat().st_mode)


@pytest.mark.parametrize(("verb", "name"), HOSTS, ids=map(" ".join, HOSTS))
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_name_server_that_does_not_answer_keeps_no_verb(
    without_names, inputs, tmp_path, verb, name, number
):
    """Wherever a verb takes the name of a host, the first signal ends the look-up with 130 and without a
    word."""
    value = HOSTS[verb, name].format(host=NAME)
    end = without_names.end(words_of(verb, name, None, value, inputs), tmp_path, number)
    assert end == {"code": 130, "waited": True, "said": ""}


SILENT = [
    ("stream", "--gps-out", "socket://127.0.0.1:{port}"),
    ("stream", "--gps-out", "rfc2217://127.0.0.1:{port}"),
    ("stream", "--gps-in", "socket://127.0.0.1:{port}"),
    ("stream", "--gps-in", "rfc2217://127.0.0.1:{port}"),
    ("dataset", "--scheduler", "tcp://127.0.0.1:{port}"),
]


@pytest.mark.parametrize(("verb", "name", "value"), SILENT, ids=[f"{one[1]} {one[2][:6]}" for one in SILENT])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_server_that_takes_a_connection_and_is_silent_keeps_no_verb(
    forks, inputs, tmp_path, verb, name, value, number
):
    """A server that takes connections and never says a word: the first signal ends the verb with 130."""
    words = words_of(verb, name, None, value, inputs)
    end = forks.end([word for word in words if word not in ("--duration", "0.02")], tmp_path, number)
    assert (end["code"], end["waited"]) == (130, True), end
    assert "Traceback" not in end["said"]
