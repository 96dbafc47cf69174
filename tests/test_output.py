"""Files that runs write."""

import errno
import fcntl
import logging
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from vlp16emu.errors import OutputError, RunError
from vlp16emu.extras.bag.bag_file import BagFile
from vlp16emu.extras.camera.folder import ImageFolder
from vlp16emu.extras.truth.folder import TruthFolder
from vlp16emu.output import OutputFile, write_json

SIGNALS = """
import signal
import sys
from vlp16emu.output import SignalEvent

event = SignalEvent()
signal.signal(signal.SIGUSR1, lambda *_: event.set())
count = 0

def trace(frame, what, _):
    global count
    if what == "line" and frame.f_code.co_name == "wait":
        count += 1
        if count == line:
            signal.raise_signal(signal.SIGUSR1)
    return trace

for line in range(1, 12):
    event.clear()
    count = 0
    sys.settrace(trace)
    event.wait(0.01)
    sys.settrace(None)
    print(line, event.is_set(), flush=True)
"""
CHILD = """
import sys
from pathlib import Path
from vlp16emu.output import OutputFile

output = OutputFile(Path(sys.argv[1]))
output.file.write(b"of the child")
output.file.flush()
print("open", flush=True)
sys.stdin.read()
output.keep()
"""


@pytest.fixture
def writer():
    """Start a process that has a file open, and keeps it when its standard input is closed."""
    running = []

    def start(path):
        command = [sys.executable, "-c", CHILD, path]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        running.append(process)
        assert process.stdout.readline() == b"open\n"
        return process

    yield start
    for process in running:
        process.kill()
        process.communicate()


def write(path, content=b"new"):
    """Write a whole file."""
    with OutputFile(path) as output, output.writing() as file:
        file.write(content)


def test_two_runs_into_one_file_are_refused(writer, tmp_path):
    """The second run is refused with the process of the first, whose file is whole; then the place is
    free."""
    path = tmp_path / "x"
    other = writer(path)
    with pytest.raises(OutputError, match=rf"x: is being written by process {other.pid}; expected another"):
        OutputFile(path)
    other.communicate()
    assert path.read_bytes() == b"of the child"
    write(path)
    assert path.read_bytes() == b"new"


def test_a_killed_run_leaves_the_file_before_and_no_lock(writer, tmp_path):
    """After SIGKILL the earlier file stands, what was written is beside it, and the next run is not held
    up."""
    path = tmp_path / "x"
    path.write_bytes(b"earlier")
    other = writer(path)
    other.send_signal(signal.SIGKILL)
    other.wait()
    (part,) = tmp_path.glob("x.*.part")
    assert (path.read_bytes(), part.read_bytes()) == (b"earlier", b"of the child")
    write(path)
    assert (path.read_bytes(), part.read_bytes()) == (b"new", b"of the child")


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_an_error_leaves_what_was_there(tmp_path, error):
    """Where writing ends with an error the earlier file stands, or none, and nothing beside it."""
    path = tmp_path / "x"
    for before in (None, b"earlier"):
        if before:
            path.write_bytes(before)
        with pytest.raises(error):  # noqa: PT012, SIM117
            with OutputFile(path) as output, output.writing() as file:
                file.write(b"half")
                raise error
        assert [other.read_bytes() for other in tmp_path.iterdir()] == ([before] if before else [])


def test_a_replaced_file_keeps_its_rights(tmp_path):
    """A file that only its group may read stays so; a new one has the rights of any new file."""
    path, usual = tmp_path / "x", tmp_path / "usual"
    write(path)
    usual.touch()
    assert path.stat().st_mode == usual.stat().st_mode
    path.chmod(0o640)
    write(path)
    assert path.stat().st_mode & 0o777 == 0o640


def test_a_link_stays_a_link(tmp_path):
    """The file that a link leads to is replaced, or made, in its own folder."""
    (tmp_path / "data").mkdir()
    link, target = tmp_path / "x", tmp_path / "data" / "y"
    link.symlink_to(target)
    for content in (b"first", b"second"):
        write(link, content)
        assert link.is_symlink()
        assert target.read_bytes() == content
    assert [path.name for path in target.parent.iterdir()] == ["y"]


def refusing(*_, **__):
    raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))


@pytest.mark.parametrize(
    ("owner", "name", "stand_in"),
    [(os, "open", refusing), (Path, "iterdir", refusing), (os, "access", lambda *_: False)],
)
def test_without_the_right_to_write_the_earlier_file_stays(tmp_path, monkeypatch, owner, name, stand_in):
    """A folder that takes no new file, and a file that must not be written, are refused in one line:
    written straight, the earlier would be lost."""
    path = tmp_path / "x"
    path.write_bytes(b"earlier")
    with monkeypatch.context() as patch:
        patch.setattr(owner, name, stand_in)
        with pytest.raises(OutputError, match="Permission denied; expected a file that can be written"):
            OutputFile(path)
    assert (path.read_bytes(), list(tmp_path.iterdir())) == (b"earlier", [path])


def test_a_file_system_without_locks_is_reported(tmp_path, monkeypatch, caplog):
    """Where files cannot be locked a warning says so, and the run goes on."""

    def none(*_):
        raise OSError(errno.ENOTSUP, "Operation not supported")

    monkeypatch.setattr(fcntl, "flock", none)
    with caplog.at_level(logging.WARNING):
        write(tmp_path / "x")
    assert (tmp_path / "x").read_bytes() == b"new"
    line = f"{tmp_path}/x: cannot be locked (Operation not supported); no other run should write it"
    assert caplog.messages == [line]


@pytest.mark.parametrize("make", [lambda path: path.write_bytes(b"mine"), os.mkfifo, os.mkdir])
@pytest.mark.parametrize("name", ["x.part", "x.0123abcd.part"])
def test_what_others_named_like_our_parts_stays(tmp_path, make, name):
    """A file, a pipe or a folder whose name looks like that of an unfinished file is neither opened for
    writing nor lost."""
    make(tmp_path / name)
    before = (tmp_path / name).lstat()
    write(tmp_path / "x")
    after = (tmp_path / name).lstat()
    assert (after.st_ino, after.st_mode, after.st_size) == (before.st_ino, before.st_mode, before.st_size)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(["x", name])


KINDS = {
    "x": OutputFile,
    "truth": TruthFolder,
    "images": lambda path: ImageFolder(path, "mm"),
    "x.mcap": BagFile,
    "x.bag": BagFile,
    "bag": BagFile,
}
"""Names of outputs, and what stages them."""


@pytest.mark.parametrize(("name", "kind"), KINDS.items())
def test_outputs_of_all_kinds_are_locked(tmp_path, name, kind):
    """While a file, a folder or a bag is being written, a second run is refused, and the first is not
    disturbed."""
    with kind(tmp_path / name):
        (part,) = tmp_path.glob(f"{name}.*.part")
        with pytest.raises(
            OutputError, match=rf"{name}: is being written by process {os.getpid()}; expected"
        ):
            kind(tmp_path / name)
        assert list(tmp_path.iterdir()) == [part]


@pytest.mark.parametrize(("name", "kind"), KINDS.items())
def test_what_takes_the_name_meanwhile_stays(tmp_path, name, kind):
    """A folder that somebody gives the name of an output during the run is not replaced.

    The output is left beside it.
    """

    def meanwhile():
        with kind(tmp_path / name) as output:
            (tmp_path / name).mkdir()
            (tmp_path / name / "mine").write_text("mine")
            if isinstance(output, OutputFile):
                output.keep()

    with pytest.raises(RunError, match=rf"{name}: .*; it is left as .*{name}\.[0-9a-f]{{8}}\.part"):
        meanwhile()
    assert (tmp_path / name / "mine").read_text() == "mine"
    assert len(list(tmp_path.glob(f"{name}.*.part"))) == 1


def test_what_replaces_an_earlier_output_is_on_the_disk(tmp_path, monkeypatch):
    """Content is on the disk before it takes the place of an earlier output; a new one does not wait."""
    flushed, flush = [], os.fsync

    def noted(descriptor):
        flushed.append(os.path.realpath(f"/proc/self/fd/{descriptor}").rpartition("/")[2].partition(".")[0])
        flush(descriptor)

    monkeypatch.setattr(os, "fsync", noted)
    for expected in ([], ["x", "scenario", "imu"]):
        write(tmp_path / "x")
        with TruthFolder(tmp_path / "truth") as folder:
            write_json(folder.path / "scenario.json", {"written_by": "vlp16emu"})
            folder.append("imu.csv", "one\n")
        assert sorted(flushed) == sorted(expected)


def test_links_in_a_circle_are_refused(tmp_path):
    """A link that leads to itself is one line of the system's words (ELOOP of POSIX)."""
    (tmp_path / "x").symlink_to("y")
    (tmp_path / "y").symlink_to("x")
    for output in (OutputFile, TruthFolder):
        with pytest.raises(OutputError, match="Too many levels of symbolic links"):
            output(tmp_path / "x")


def test_a_name_as_long_as_the_system_allows(tmp_path):
    """A name of 255 bytes (NAME_MAX of Linux) is written."""
    write(tmp_path / ("x" * 255))
    assert (tmp_path / ("x" * 255)).read_bytes() == b"new"


def test_a_file_that_is_left_has_no_final_name(tmp_path):
    """What is incomplete stays at its own place beside the earlier file."""
    (tmp_path / "x").write_bytes(b"earlier")
    with OutputFile(tmp_path / "x") as output:
        output.file.write(b"half")
        output.leave()
    assert (tmp_path / "x").read_bytes() == b"earlier"
    assert Path(output.place).read_bytes() == b"half"


def test_a_signal_handler_may_set_what_its_thread_waits_for():
    """A signal at any line of a wait sets the event, and the wait ends; `threading.Event` waits for ever at
    some."""
    done = subprocess.run(
        [sys.executable, "-c", SIGNALS], capture_output=True, text=True, timeout=120, check=True
    )
    lines = done.stdout.splitlines()
    assert len(lines) == 11
    assert lines[:3] == ["1 True", "2 True", "3 True"]
