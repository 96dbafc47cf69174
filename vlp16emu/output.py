"""Outputs of runs: written under temporary names, renamed when complete, by one run at a time."""

import errno
import fcntl
import json
import logging
import os
import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Self

from vlp16emu.errors import OutputError, RunError
from vlp16emu.trees import Table

STDOUT = Path("-")  # stands for standard output, as for tcpdump and tshark

_LONGEST_NAME_BYTES = 240  # 255 bytes (NAME_MAX of Linux) minus the longest suffix
_RIGHTS = 0o777

_log = logging.getLogger(__name__)


class OutputFile:
    """A file to be written; a context manager.

    It is written as NAME.xxxxxxxx.part, a new file in the same folder, and renamed when it is kept. Until
    then an earlier file stays, even if the run fails. It gets the permissions of the file that it replaces,
    and a link stays a link. A pipe or a device is written directly. Raises OutputError if it cannot be
    opened, is one of the inputs, or is being written by another run.

    Parameters
    ----------
    path : the file, or `STDOUT`
    where : its name in error lines; by default `path`
    buffering : as for `open`
    inputs : files that the run reads, which must not be replaced
    """

    def __init__(
        self, path: Path, *, where: str | None = None, buffering: int = -1, inputs: Iterable[Path] = ()
    ) -> None:
        self._where = where or str(path)
        self._final: Path | None = None
        spare(inputs, path)
        with opening(self._where, "a file that can be written"):
            if path == STDOUT:
                self.file: BinaryIO = os.fdopen(os.dup(sys.stdout.fileno()), "wb", buffering)
            elif path.exists() and not path.is_file():  # opening a folder fails, with the system's reason
                self.file = path.open("wb", buffering)
            else:
                self._final = final_name(path)
                self.file = _new_file(self._final, self._where, buffering)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.discard()

    @property
    def place(self) -> str:
        """Name of the file until it is kept."""
        return self._where if self._final is None else str(self.file.name)

    @contextmanager
    def writing(self) -> Iterator[BinaryIO]:
        """Write the whole file and keep it; raises RunError if it cannot be written completely."""
        try:
            yield self.file
            self.keep()
        except OSError as error:
            left = "the file is not complete" if self._final is None else "no file is written"
            raise RunError(f"{self._where}: {error.strerror or error}; {left}") from error

    def keep(self) -> None:
        """Close the file and rename it to its final name.

        Raises OSError if buffered data cannot be written; RunError if it cannot be renamed.
        """
        self.file.flush()
        try:
            if self._final is not None:
                Path(self.file.name).replace(self._final)  # before closing, which ends the lock
        except OSError as error:
            raise RunError(f"{self._where}: {error.strerror}; it is left as {self.file.name}") from error
        finally:
            self.file.close()

    def leave(self) -> None:
        """Close an incomplete file that is worth keeping; it stays at `place`."""
        with suppress(OSError):  # disk full; already reported
            self.file.close()

    def discard(self) -> None:
        """Close and remove a file that is not kept."""
        if self.file.closed:
            return
        with suppress(OSError):
            if self._final is not None:
                Path(self.file.name).unlink()
        self.leave()


def write_json(path: Path, tree: Table) -> None:
    """Write a file of one JSON object, in place of an earlier one; raises the errors of `OutputFile`."""
    with OutputFile(path) as output, output.writing() as file:
        file.write(f"{json.dumps(tree, indent=2, ensure_ascii=False)}\n".encode())


def final_name(path: Path) -> Path:
    """Return the final name of an output with all links resolved; `OSError` for a loop of links."""
    final = Path(os.path.realpath(path))
    if final.is_symlink():
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))
    return final


def spare(inputs: Iterable[Path], output: Path) -> None:
    """Raise OutputError if `output` is one of the input files, compared by device and inode."""
    for file in inputs:
        with suppress(OSError):  # one of them does not exist
            if file.samefile(output):
                raise OutputError(
                    str(output), "is read by this run, and would be written over", "another place"
                )


def lock(opened: int, where: str) -> None:
    """Lock a file or folder, by its descriptor, until it is closed; warn if its file system has no locks.

    Raises OutputError for `where` if another run has locked it.
    """
    try:
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        found = f"is being written by {_holder(opened)}"
        raise OutputError(where, found, "another place, or an end of that run") from None
    except OSError as error:
        _log.warning("%s: cannot be locked (%s); no other run should write it", where, error.strerror)


def _holder(opened: int) -> str:
    """Return the process that has locked a file, if the system reports it."""
    state = os.fstat(opened)
    file = f"{os.major(state.st_dev):02x}:{os.minor(state.st_dev):02x}:{state.st_ino}"
    with suppress(OSError):
        for line in Path("/proc/locks").read_text(encoding="ascii").splitlines():
            words = line.split()  # number, kind, mode, access, process, file, first and last byte
            if words[1] == "FLOCK" and words[5] == file:
                return f"process {words[4]}"
    return "another run"


@contextmanager
def opening(where: str, expected: str) -> Iterator[None]:
    """Raise OutputError for `where` if the block cannot open a file."""
    try:
        yield
    except (OSError, ValueError) as error:  # a name with a NUL or half a character is a ValueError
        found = error.strerror if isinstance(error, OSError) else "no name of a file"
        raise OutputError(where, str(found), expected) from error


def _stem(final: Path) -> str:
    name = os.fsencode(final.name)
    if len(name) <= _LONGEST_NAME_BYTES:
        return final.name
    from hashlib import sha256  # here: it loads OpenSSL, which `--help` does not need

    return sha256(name).hexdigest()


def part_beside(final: Path) -> Path:
    """Return a new temporary name beside `final` for an incomplete output."""
    return final.with_name(f"{_stem(final)}.{os.urandom(4).hex()}.part")


def _new_file(final: Path, where: str, buffering: int) -> BinaryIO:
    """Open a new file beside `final`, with the permissions of the existing one."""
    before = final.stat() if final.exists() else None
    if before and not os.access(final, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    part = part_beside(final)
    file = part.open("xb", buffering)  # never truncates a file or follows a link
    try:
        claim(file.fileno(), part, final, where)
    except (OutputError, OSError):  # the latter in a folder that cannot be listed
        part.unlink()
        file.close()
        raise
    if before:
        take_rights(file.fileno(), before)
    return file


def take_rights(opened: int, before: os.stat_result) -> None:
    """Copy owner, group and mode from the file or folder that is replaced, as far as allowed."""
    for owner, group in ((-1, before.st_gid), (before.st_uid, -1)):
        with suppress(OSError):  # only root may change the owner
            os.fchown(opened, owner, group)
    with suppress(OSError):
        os.fchmod(opened, before.st_mode & _RIGHTS)


def claim(opened: int, part: Path, final: Path, where: str) -> None:
    """Lock a new file or folder; refuse it if another run is writing the same final name."""
    lock(opened, where)
    ours = re.compile(rf"{re.escape(_stem(final))}\.[0-9a-f]{{8}}\.part")
    for path in final.parent.iterdir():
        if path == part or not ours.fullmatch(path.name):
            continue
        with suppress(OSError):  # it is gone, or a link
            other = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
            try:
                lock(other, where)
            finally:
                os.close(other)
