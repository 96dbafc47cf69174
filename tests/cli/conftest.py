"""Command lines carried out in this process, and one short recording for all to read."""

import gc
import json
import logging
import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from kit import refusals, set_words

from vlp16emu.cli.app import main, run
from vlp16emu.cli.terminal import ENDINGS, Progress
from vlp16emu.kernels.compiler import _is_kept, table

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session", autouse=True)
def _kernels():
    """Compile what is not on disk: a run that does it says so on stderr."""
    if not all(map(_is_kept, table())):
        subprocess.run(
            [sys.executable, "-m", "vlp16emu", "cache", "--compile"], capture_output=True, check=True
        )


@dataclass
class Outcome:
    """What a command line left behind."""

    code: int
    out: str
    err: str

    @property
    def tree(self):
        """The JSON object on stdout."""
        return json.loads(self.out)


@pytest.fixture
def cli(capsys):
    """Carry out a command line here."""

    def call(*arguments):
        capsys.readouterr()
        code = run([str(argument) for argument in arguments])
        return Outcome(code, *capsys.readouterr())

    return call


@pytest.fixture
def main_here(monkeypatch, capsys):
    """Carry out the whole program here, its standard output a file; gives the exit code and what is said
    on stderr."""

    def call(*arguments, stdout):
        before = {number: signal.getsignal(number) for number in ENDINGS}
        try:
            with monkeypatch.context() as patch:
                patch.setattr(sys, "argv", ["vlp16emu", *map(str, arguments)])
                patch.setattr(sys, "stdout", stdout)
                patch.setattr(gc, "freeze", gc.collect)
                patch.setattr(logging.getLogger(), "handlers", [])
                with pytest.raises(SystemExit) as end:
                    main()
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
            gc.set_threshold(700)
        return end.value.code or 0, capsys.readouterr().err

    return call


@pytest.fixture
def signal_at(monkeypatch):
    """Raise signals, each once the run that goes on here has come to a simulated second."""

    def plan(*signals):
        left, show = list(signals), Progress.show

        def noted(bar, task, done_s):
            show(bar, task, done_s)
            if left and done_s >= left[0][0]:
                signal.raise_signal(left.pop(0)[1])

        monkeypatch.setattr(Progress, "show", noted)

    return plan


@pytest.fixture
def heeds_signals():
    """Let a child heed Ctrl-C and hangups where the tests run in the background, or under nohup, and
    ignore them."""

    def reset():
        for number in (signal.SIGINT, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)

    return reset


@pytest.fixture
def program(heeds_signals):
    """Start the program as a process of its own, with pipes; what it is to carry out before is code."""
    running = []

    def start(*arguments, before="", **options):
        code = f"{before}\nfrom vlp16emu.cli import main\nmain()"
        command = [sys.executable, *(("-c", code) if before else ("-m", "vlp16emu")), *map(str, arguments)]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        options = {**pipes, "cwd": ROOT, "text": True, "preexec_fn": heeds_signals} | options
        running.append(subprocess.Popen(command, **options))
        return running[-1]

    yield start
    for process in running:
        process.kill()
        process.communicate()


@pytest.fixture(scope="session")
def bench(tmp_path_factory):
    """Half a second of the hall, without noise and without GPS."""
    path = tmp_path_factory.mktemp("bench") / "bench.pcap"
    assert run(["record", "static_bench", str(path), "--duration", "0.5", "--json"]) == 0
    return path


@pytest.fixture(scope="session")
def dual(tmp_path_factory):
    """A third of a second in dual return with GPS, over the full hour."""
    path = tmp_path_factory.mktemp("dual") / "dual.pcap"
    settings = ["sensor.return_mode=dual", "gps.connected=true", "start_utc=2026-05-20T08:59:59.9Z"]
    assert (
        run(["record", "static_bench", str(path), "--duration", "0.3", "--json", *set_words(settings)]) == 0
    )
    return path


RIG = "rig=[{}, {return_mode='dual', address='10.0.0.7', data_port=2368, position_port=8308}]"
MADE = (
    ("record", "static_bench", "bench.pcap"),
    ("record", "static_bench", "rig.pcap", "--set", RIG),
    ("truth", "static_bench", "truth"),
)


@pytest.fixture(scope="session")
def inputs(tmp_path_factory):
    """A folder with captures, ground truth and files of `refusals.toml`, which no test changes."""
    folder = tmp_path_factory.mktemp("inputs")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for words in MADE:
            assert run([*words, "--duration", "0.2", "--json"]) == 0
        for name, text in refusals()["files"].items():
            Path(name).parent.mkdir(exist_ok=True)
            Path(name).write_text(text, encoding="utf-8")
        with Path("forest.json").open("w") as report:
            patch.setattr("sys.stdout", report)
            assert run(["forest", "static_bench", "--json"]) == 0
    (folder / "empty.pcap").write_bytes((folder / "bench.pcap").read_bytes()[:24])
    os.mkfifo(folder / "pipe")
    for ending in ("csv", "laz", "npz", "ply"):
        (folder / f"full.{ending}").symlink_to("/dev/full")
    return folder
