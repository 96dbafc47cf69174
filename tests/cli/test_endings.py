"""How runs end from outside, and what becomes of errors that no verb expects."""

import fcntl
import os
import pty
import signal
import struct
import subprocess
import sys
import termios
import threading
import time

import numpy as np
import pytest

from vlp16emu import load, replay
from vlp16emu.cli import app

GAP_S = 5 * 3600  # a clock that was set while a capture was written: shared report ouster-sdk#176


@pytest.fixture(scope="session")
def gap(bench, tmp_path_factory):
    """The bench capture, whose second half is stamped five hours later (a pcap record begins with its
    seconds)."""
    content, at, frames = bytearray(bench.read_bytes()), 24, 0
    while at < len(content):
        seconds, _, length = struct.unpack_from("<III", content, at)
        if frames > 200:
            struct.pack_into("<I", content, at, seconds + GAP_S)
        at, frames = at + 16 + length, frames + 1
    path = tmp_path_factory.mktemp("gap") / "gap.pcap"
    path.write_bytes(content)
    return path


def test_a_gap_is_reported_and_shortened(gap):
    """A replay goes on a second or two after a gap of hours, whose length it reports; all packets leave."""
    began_s = time.monotonic()
    replayed = replay(gap, data_port=9, position_port=10)
    assert replayed.gaps_s == (pytest.approx(GAP_S, abs=1),)
    assert 1 <= time.monotonic() - began_s < GAP_S
    assert 1.3 < replayed.sent.simulated_s < 2.6
    whole = replay(gap, data_port=9, position_port=10, speed=1e5, keep_gaps=True)
    assert (whole.gaps_s, round(whole.sent.simulated_s)) == ((), GAP_S)
    assert (whole.packets, whole.position_packets) == (replayed.packets, replayed.position_packets)


REPLAY = "replay {gap} --keep-gaps --data-port 9 --position-port 10"
LIVE = (
    "stream static_bench --set motion={{kind='live'}} --pose-in udp://127.0.0.1:0"
    " --data-port 9 --position-port 10"
)


@pytest.mark.parametrize(("line", "number"), [(REPLAY, signal.SIGHUP), (LIVE, signal.SIGTERM)])
def test_what_waits_ends_with_the_first_signal(cli, gap, line, number):
    """A replay in a gap of hours, and a stream that no pose has come to, end with 130 after one signal,
    and with a report."""
    before, done, here = signal.signal(number, lambda *_: None), threading.Event(), threading.get_ident()

    def knock():
        while not done.wait(0.3):  # the run takes the first one that comes while it waits
            signal.pthread_kill(here, number)

    knocking = threading.Thread(target=knock)
    knocking.start()
    outcome = cli(*line.format(gap=gap).split())
    done.set()
    knocking.join()
    signal.signal(number, before)
    assert outcome.code == 130
    assert "\ninterrupted: " in f"\n{outcome.out}"


@pytest.mark.parametrize("most_bytes", [0, None])
def test_the_wait_for_a_pipe_ends_with_the_first_signal(cli, bench, tmp_path, most_bytes):
    """Decoding ends with 130 while a pipe stays open without bytes (PEP 475 retries reads); points that
    came through are kept."""
    pipe, out, here, done = tmp_path / "x.pcap", tmp_path / "x.csv", threading.get_ident(), threading.Event()
    os.mkfifo(pipe)

    def feed():
        with pipe.open("wb") as file:
            file.write(bench.read_bytes()[:most_bytes])
            file.flush()
            signal.pthread_kill(here, signal.SIGTERM)
            done.wait()

    feeding = threading.Thread(target=feed)
    feeding.start()
    outcome = cli("decode", pipe, "--clock", "host", "--out", out, "--json")
    done.set()
    feeding.join()
    assert outcome.code == 130
    assert out.exists() == (most_bytes is None)
    if out.exists():
        assert 0 < outcome.tree["points"] == len(out.read_text().splitlines()) - 1


def test_a_terminal_that_goes_ends_a_run_as_ctrl_c(program, heeds_signals):
    """A run that reports to a terminal which is closed ends with 130, and without a word on it that nobody
    can read."""
    ours, theirs = pty.openpty()
    process = program(
        *["stream", "static_bench", "--data-port", "9", "--duration", "3600"],
        **dict.fromkeys(("stdin", "stdout", "stderr"), theirs),
        start_new_session=True,
        preexec_fn=lambda: (heeds_signals(), fcntl.ioctl(0, termios.TIOCSCTTY, 0)),
    )
    os.close(theirs)
    drawn = b""
    while b" of 3600.0 s" not in drawn or b"growing" in drawn.split(b"\r")[-1]:
        drawn += os.read(ours, 10_000)
    os.close(ours)
    assert process.wait(timeout=100) == 130


INTERRUPTED_IMPORT = """
import os, signal
import vlp16emu.scenario as scenario

class Noted:
    def __set_name__(self, owner, name):
        os.kill(os.getpid(), signal.SIGTERM)

def load(*_, **__):
    class Made:
        here = Noted()

scenario.load = load
"""
INTERRUPTED_CHECK = """
import os, signal
import vlp16emu.scenario as scenario
from vlp16emu.errors import InputError

def load(*_, **__):
    try:
        os.kill(os.getpid(), signal.SIGTERM)
    except BaseException:
        raise InputError("a", found="b", expected="c")

scenario.load = load
"""


@pytest.mark.parametrize("before", [INTERRUPTED_IMPORT, INTERRUPTED_CHECK])
def test_a_signal_from_which_a_library_makes_another_error_ends_the_run(program, before):
    """Python up to 3.11 wraps what a signal raises in `__set_name__`, as in imports, into a RuntimeError;
    a check that it meets fails: still 130 and no line."""
    process = program("record", "static_bench", "x.pcap", before=before)
    assert process.communicate(timeout=100) == ("", "")
    assert process.returncode == 130


def test_warnings_of_numpy_stay_away_from_the_line_of_an_error(main_here, monkeypatch, tmp_path):
    """Warnings of numpy while a scene is read are not printed; the error is one line."""

    def noisy(*arguments, **options):
        np.array(1.0) / np.array(0.0)
        return load(*arguments, **options)

    monkeypatch.setattr("vlp16emu.scenario.load", noisy)
    with (tmp_path / "out").open("w") as stdout:
        code, said = main_here("record", "nope", "x.pcap", stdout=stdout)
    assert (code, said.count("\n")) == (2, 1)
    assert said.startswith("error: scene 'nope': unknown name; expected ")


@pytest.mark.parametrize(("code", "where"), [(24, "the system"), (2, "the current folder")])
def test_an_error_without_a_file_is_not_one_of_standard_output(main_here, monkeypatch, tmp_path, code, where):
    """The error line names the limit of open files when the system has no more, or the current folder when
    it is gone."""

    def load(*_, **__):
        raise OSError(code, "No")

    monkeypatch.setattr("vlp16emu.scenario.load", load)
    with (tmp_path / "out").open("w") as stdout:
        assert main_here("record", "nope", "x.pcap", stdout=stdout) == (1, f"error: {where}: No\n")


def test_a_closed_standard_output_takes_no_capture():
    """`record -` into a closed standard output is refused in one line."""
    command = f"exec {sys.executable} -m vlp16emu record static_bench - --duration 0.1 >&-"
    done = subprocess.run(["sh", "-c", command], stderr=subprocess.PIPE, text=True, check=False)
    said = "error: standard output: closed; expected a file or a pipe\n"
    assert (done.returncode, done.stderr) == (2, said)


def test_a_file_does_not_take_the_place_of_a_closed_output(cli, tmp_path):
    """A capture that is written while standard output is closed holds its packets and nothing else."""
    path = tmp_path / "x.pcap"
    command = (
        f"exec {sys.executable} -m vlp16emu record static_bench {path} --duration 0.1 --json 2>/dev/null >&-"
    )
    assert subprocess.run(["sh", "-c", command], check=False).returncode == 0
    assert cli("verify", path, "--json").tree["clean"]


def test_a_signal_that_meets_a_library_is_not_printed(monkeypatch, capsys):
    """A signal during a `__del__` makes Python print a traceback, but not once the command is
    interrupted."""

    class Held:
        def __del__(self):
            raise KeyboardInterrupt

    monkeypatch.setattr("sys.unraisablehook", app._hide_interrupt)
    interrupted, printed = threading.Event(), []
    monkeypatch.setattr(app, "_was_interrupted", interrupted)
    for _ in range(2):
        Held()
        printed.append("KeyboardInterrupt" in capsys.readouterr().err)
        interrupted.set()
    assert printed == [True, False]
