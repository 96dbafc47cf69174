"""Files that runs write."""

import errno
import fcntl
import logging
import os
import signal
import subprocess
import sys

import pytest

from vlp16emu.errors import OutputError, RunError
from vlp16emu.output import OutputFile

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
    """The second run is refused with the process of the first, whose file is whole; then the place is free."""
    path = tmp_path / "x"
    other = writer(path)
    with pytest.raises(OutputError, match=rf"x: is being written by process {other.pid}; expected another"):
        OutputFile(path)
    other.communicate()
    assert path.read_bytes() == b"of the child"
    write(path)
    assert path.read_bytes() == b"new"


def test_threads_of_one_program_exclude_each_other_too(tmp_path):
    """A file that is open in this process is not opened a second time."""
    with OutputFile(tmp_path / "x"), pytest.raises(OutputError, match=f"is being written by process {os.getpid()}"):
        OutputFile(tmp_path / "x")


def test_a_killed_run_leaves_the_file_before_and_no_lock(writer, tmp_path):
    """After SIGKILL the earlier file stands, what was written is beside it, and the next run replaces both."""
    path, part = tmp_path / "x", tmp_path / "x.part"
    path.write_bytes(b"earlier")
    other = writer(path)
    other.send_signal(signal.SIGKILL)
    other.wait()
    assert (path.read_bytes(), part.read_bytes()) == (b"earlier", b"of the child")
    write(path)
    assert path.read_bytes() == b"new"
    assert not part.exists()


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


def test_a_full_disk_leaves_no_file(tmp_path):
    """What has no room is an error of one line, and nothing is left of it."""
    with pytest.raises(RunError, match=r"x: No space left on device; no file is written"):  # noqa: SIM117
        with OutputFile(tmp_path / "x") as output, output.writing():
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert list(tmp_path.iterdir()) == []


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


def test_a_file_is_written_straight_where_none_can_be_beside_it(tmp_path, monkeypatch):
    """In a folder that takes no new files an existing one is written, by one run at a time."""
    path, opened = tmp_path / "x", os.open

    def refusing(file, *rest):
        if str(file).endswith(".part"):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return opened(file, *rest)

    monkeypatch.setattr(os, "open", refusing)
    with pytest.raises(OutputError, match="Permission denied; expected a file that can be written"):
        OutputFile(path)
    path.write_bytes(b"a longer one from before")
    with OutputFile(path) as output:
        with pytest.raises(OutputError, match="is being written"):
            OutputFile(path)
        with output.writing() as file:
            file.write(b"new")
    assert path.read_bytes() == b"new"


def test_a_file_that_must_not_be_written_is_refused(tmp_path, monkeypatch):
    """Without the right to write it a file is not replaced either."""
    path = tmp_path / "x"
    path.write_bytes(b"earlier")
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(OutputError, match="Permission denied"):
        OutputFile(path)
    assert path.read_bytes() == b"earlier"


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


def test_a_file_that_was_renamed_meanwhile_is_not_emptied(tmp_path, monkeypatch):
    """Between opening and locking the run before may have given its file its name: that file stays whole."""
    path, part, locked = tmp_path / "x", tmp_path / "x.part", fcntl.flock
    part.write_bytes(b"whole")

    def late(*arguments):
        if not path.exists():
            part.rename(path)
        locked(*arguments)

    monkeypatch.setattr(fcntl, "flock", late)
    with OutputFile(path):
        assert path.read_bytes() == b"whole"
        assert part.exists()
    assert path.read_bytes() == b"whole"
