"""What all verbs have in common: a good run, one JSON object, Ctrl-C, a line for an unknown option, and files
of the user that stay as they are."""

import fcntl
import io
import json
import os
import select
import shutil
import signal
import socket
import stat
import sys
import threading
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from cli.lines import (
    CASES,
    FILES_OUT,
    GOOD,
    HOSTS,
    INPUT_AS_OUTPUT,
    MINE,
    NEVER_ENDING,
    NO_PATHS,
    NO_PORTS,
    OF_MACHINE,
    PLAIN,
    REFUSED,
    SPEC,
    WAITING_OUT,
    ending_of,
    is_path,
    names_host,
    texts_of,
    with_path,
)

from vlp16emu.cli.app import run
from vlp16emu.doors import DOORS


@pytest.fixture
def words(request, inputs, tmp_path, monkeypatch):
    """Words of the good run of a verb, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "spec.toml").write_text(SPEC)
    verb = request.param
    return [verb, *GOOD[verb].format(inputs=inputs).split()]


def each(verbs):
    return pytest.mark.parametrize("words", sorted(verbs), indirect=True)


def test_every_verb_is_here():
    """No verb is without its row."""
    assert GOOD.keys() == DOORS["verbs"].keys()


def test_every_option_is_here():
    """Each text that a verb takes is a path or, as the table says, none, and names a host or none: the tests
    below meet every option that takes a path, also a new one."""
    texts = [(verb, leaf) for verb in GOOD for leaf in texts_of(verb)]
    assert {leaf.name for _, leaf in texts if not is_path(leaf)} == NO_PATHS.keys()
    named = {(verb, leaf.name) for verb, leaf in texts if names_host(leaf)}
    assert named <= HOSTS.keys()


@each(GOOD.keys() - PLAIN)
def test_a_good_run_is_told_to_people_and_programs(cli, words):
    """Exit code 0 and nothing on stderr; with --json, which the help names, standard output is one object
    of strict JSON."""
    for options in ([], ["--json"]):
        shutil.rmtree("images", ignore_errors=True)  # must be new or empty
        outcome = cli(*words, *options)
        assert outcome.err == ""
        assert outcome.code == 0 or words[0] in OF_MACHINE
        assert outcome.out
    assert isinstance(json.loads(outcome.out, parse_constant=pytest.fail), dict)
    assert "  --json " in cli(words[0], "--help").out


@each(PLAIN - {"view"})
def test_a_good_run_without_json_is_told(cli, words):
    """Exit code 0 and nothing on stderr; no --json is in the help."""
    outcome = cli(*words)
    assert (outcome.code, outcome.err) == (0, "")
    assert "\n  --json " not in cli(words[0], "--help").out


class Interrupting(io.StringIO):
    """Standard output whose reader sends Ctrl-C at the first word."""

    def write(self, text):
        """Raise the signal."""
        signal.raise_signal(signal.SIGINT)
        return len(text)


@pytest.fixture
def ctrl_c():
    """Let Ctrl-C interrupt: a shell lets its jobs in the background ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@each(GOOD)
@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_ends_every_verb(words, monkeypatch, capsys):
    """Ctrl-C while a verb has something to say ends it with 130, without a word on stderr."""
    monkeypatch.setattr("sys.stdout", Interrupting())
    assert run(words) == 130
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("verb", GOOD)
def test_an_unknown_option_is_one_line(cli, verb):
    """Exit code 2, and the line names the help of the verb."""
    outcome = cli(verb, "--no-such-option")
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.err == f"error: No such option: --no-such-option; see `vlp16emu {verb} --help`\n"


def content_of(folder):
    """Names, kinds, modes, and contents or targets of all that is in a folder."""
    found = {}
    for path in sorted(folder.rglob("*")):
        state = path.lstat()
        is_file = stat.S_ISREG(state.st_mode)
        content = path.read_bytes() if is_file else path.readlink() if path.is_symlink() else None
        found[str(path.relative_to(folder))] = state.st_mode, content
    return found


def make_target(kind, suffix, folder):
    """Make files of the user in a folder, and return the path among them that a run is given."""
    (folder / "notes").mkdir()
    for file in ("a.txt", "manifest.json", "walk.json", "scenario.json", "trajectory.tum", f"a{suffix}"):
        (folder / "notes" / file).write_bytes(MINE)
    for file in (
        f"mine{suffix}",
        f"mine{suffix}.part",
        f"mine{suffix}.01234567.part",
        "mine.json",
        "mine.tum",
    ):
        (folder / file).write_bytes(MINE)
    (folder / f"link{suffix}").symlink_to(f"notes/a{suffix}")
    return {"file": folder / f"mine{suffix}", "folder": folder / "notes", "link": folder / f"link{suffix}"}[
        kind
    ]


@pytest.mark.usefixtures("ctrl_c")
@pytest.mark.parametrize("kind", ["file", "folder", "link"])
@pytest.mark.parametrize(("verb", "name", "at"), CASES, ids=[f"{verb} {name}" for verb, name, _ in CASES])
def test_no_file_of_the_user_changes(inputs, tmp_path, monkeypatch, capsys, verb, name, at, kind):
    """A file, a folder with files and a link, given as any path of any verb, stay as they are with all around
    them; the one file that the user names as an output is replaced by a whole one if the run succeeds."""
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    Path("spec.toml").write_text(SPEC)
    mine = tmp_path / "mine"
    mine.mkdir()
    target = make_target(kind, ending_of(verb, name), mine)
    before = content_of(mine)
    of_inputs = content_of(inputs)
    words = with_path([verb, *GOOD[verb].format(inputs=inputs).split()], name, at, target)
    if verb == "view" or name in NEVER_ENDING:
        monkeypatch.setattr("sys.stdout", Interrupting())
    code = run(words)
    lines = capsys.readouterr().err.splitlines()
    assert code in (0, 1, 2, 130)
    assert not any(line.startswith("Traceback") for line in lines)
    after = content_of(mine)
    is_output = name in FILES_OUT or (verb, name) in FILES_OUT
    assert code == 0 or kind != "file" or not is_output or name in NEVER_ENDING or (verb, name) in REFUSED, (
        lines
    )
    if is_output and code == 0 and kind != "folder":
        written = str(target.resolve().relative_to(mine))
        mode, content = after.pop(written)
        assert mode == before.pop(written)[0]
        assert content
        assert content != MINE
    assert after == before
    assert content_of(inputs) == of_inputs


@pytest.mark.parametrize(
    ("verb", "name", "at"), INPUT_AS_OUTPUT, ids=[f"{v} {n}" for v, n, _ in INPUT_AS_OUTPUT]
)
def test_an_input_is_no_output(inputs, tmp_path, monkeypatch, capsys, verb, name, at):
    """What a run reads is not written by it: each file that a command names as an input, given as its output
    too, is refused or stays as it is."""
    monkeypatch.chdir(tmp_path)
    Path("spec.toml").write_text(SPEC)
    words = [verb, *GOOD[verb].format(inputs=inputs).split()]
    given = [word for word in words[1:] if Path(word).is_file()]
    before = content_of(tmp_path), content_of(inputs)
    if verb == "view" or name in NEVER_ENDING:
        monkeypatch.setattr("sys.stdout", Interrupting())
    for path in given:
        run(with_path(words, name, at, path))
        assert "Traceback" not in capsys.readouterr().err
        assert (content_of(tmp_path), content_of(inputs)) == before


class Knock:
    """One Ctrl-C for this thread, once an event has come; what waits after it is let go, and noted.

    Parameters
    ----------
    let_go : ends the wait of a run that the signal has not ended
    """

    def __init__(self, let_go):
        self.waits = threading.Event()
        self.over = threading.Event()
        self.ended = True
        self._let_go = let_go
        self._here = threading.get_ident()

    def _run(self):
        while not self.waits.wait(0.01):
            if self.over.is_set():
                return
        if not self.over.is_set():
            signal.pthread_kill(self._here, signal.SIGINT)
        if not self.over.wait(20.0):
            self.ended = False
            self._let_go()

    @contextmanager
    def at_door(self):
        """Knock while the block runs."""
        thread = threading.Thread(target=self._run)
        thread.start()
        try:
            yield
        finally:
            with suppress(KeyboardInterrupt):  # which comes as the run ends by itself
                self.over.set()
                thread.join()


class Opens:
    """Sets events as this process opens files of these paths."""

    def __init__(self):
        self.events = {}
        sys.addaudithook(self._note)  # it cannot be removed

    def _note(self, name, arguments):
        if self.events and name == "open" and (event := self.events.get(str(arguments[0]))):
            event.set()


@pytest.fixture(scope="session")
def opens():
    """The files that this process opens."""
    return Opens()


def drain(path):
    """Read a FIFO on another thread until its writer is gone."""
    threading.Thread(target=path.read_bytes, daemon=True).start()


@pytest.mark.usefixtures("ctrl_c")
@pytest.mark.parametrize(
    ("verb", "name", "at"), WAITING_OUT, ids=[f"{verb} {name}" for verb, name, _ in WAITING_OUT]
)
def test_an_output_without_a_reader_ends_with_ctrl_c(
    inputs, tmp_path, monkeypatch, capsys, opens, verb, name, at
):
    """A FIFO that nobody reads, as any output of any verb: refused, or the first Ctrl-C ends the wait with
    130; the FIFO stays."""
    monkeypatch.chdir(tmp_path)
    Path("spec.toml").write_text(SPEC)
    pipe = tmp_path / f"pipe{ending_of(verb, name)}"
    os.mkfifo(pipe)
    words = [verb, *GOOD[verb].format(inputs=inputs).split()]
    words = with_path(words, name, at, pipe)
    knock = Knock(lambda: drain(pipe))
    opens.events = {str(pipe): knock.waits}
    if verb == "view":
        monkeypatch.setattr("sys.stdout", Interrupting())
    with knock.at_door():
        code = run(words)
    opens.events = {}
    assert knock.ended
    assert code in ((130,) if knock.waits.is_set() else (0, 1, 2, 130))
    assert "Traceback" not in capsys.readouterr().err
    assert stat.S_ISFIFO(pipe.stat().st_mode)


@pytest.mark.usefixtures("ctrl_c")
@pytest.mark.parametrize(
    "line",
    [
        "record static_bench {pipe} --duration 0.5",
        "points static_bench {pipe} --format ply --duration 0.5",
        "decode {inputs}/bench.pcap --out {pipe}",
        "picture static_bench {pipe} --duration 0.2 --view sweep",
    ],
)
def test_a_reader_that_stalls_does_not_keep_a_verb(inputs, tmp_path, line):
    """A FIFO whose reader takes nothing fills; the first Ctrl-C then ends the verb with 130."""
    ending = {"record": ".pcap", "points": ".ply", "decode": ".csv", "picture": ".png"}[line.split()[0]]
    pipe = tmp_path / f"pipe{ending}"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    fcntl.fcntl(reader, fcntl.F_SETPIPE_SZ, 4096)
    room = os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)
    knock = Knock(lambda: drain(pipe))

    def watch():
        while not knock.over.wait(0.01):
            if not select.select([], [room], [], 0)[1]:
                knock.waits.set()
                return

    watching = threading.Thread(target=watch)
    watching.start()
    with knock.at_door():
        code = run(line.format(pipe=pipe, inputs=inputs).replace(" --format ply", "").split())
    watching.join()
    assert knock.ended
    os.close(reader)
    os.close(room)
    assert (code, knock.waits.is_set()) == (130, True)


@pytest.mark.usefixtures("ctrl_c")
@pytest.mark.parametrize("option", ["--gps-out", "--gps-in"])
def test_a_port_elsewhere_that_does_not_answer_ends_with_ctrl_c(option):
    """A host whose queue of connections is full answers none; the first Ctrl-C ends the wait with 130."""
    with socket.socket() as full:
        full.bind(("127.0.0.1", 0))
        full.listen(0)
        waiting = []
        for _ in range(3):
            waiting.append(socket.socket())
            waiting[-1].setblocking(False)
            waiting[-1].connect_ex(full.getsockname())
        port = full.getsockname()[1]
        knock = Knock(full.close)
        sys.addaudithook(
            lambda name, arguments: (
                knock.waits.set() if name == "socket.connect" and arguments[1][1] == port else None
            )
        )
        words = ["stream", "static_bench", "--set", "gps.connected=true", *NO_PORTS.split()]
        with knock.at_door():
            code = run([*words, "--no-keep-up", option, f"socket://127.0.0.1:{port}"])
        for opened in waiting:
            opened.close()
    assert (code, knock.waits.is_set()) == (130, True)
