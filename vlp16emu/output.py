"""Files that runs write: beside their names, which they take when they are whole, and by one run at a time."""

import errno
import fcntl
import json
import logging
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO, Self

from vlp16emu.errors import OutputError, RunError

STDOUT = Path("-")
"""Stands for standard output, as for tcpdump and tshark."""

_NO_NEW_FILE = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENAMETOOLONG)
"""Why a folder with a file that can be written may take no other beside it."""
_RIGHTS = 0o777

_log = logging.getLogger(__name__)


class OutputFile:
    """A file to be written; a context manager.

    It is written beside its name, as NAME.part, and takes its name when it is kept; until then what stood there
    stays, whatever ends the run. It has the rights of the file that it replaces, and a link stays a link. A pipe, a
    device, and a file whose folder takes no new ones are written straight.

    Parameters
    ----------
    path : of the file, or `STDOUT`
    where : what error lines call it, its path if left out
    buffering : as of `open`

    Raises
    ------
    OutputError
        where it cannot be opened, or another run writes it
    """

    def __init__(self, path: Path, *, where: str | None = None, buffering: int = -1) -> None:
        self._where = where or str(path)
        try:
            self.file, self._final = _opened(path, self._where, buffering)
        except OSError as error:
            raise OutputError(self._where, str(error.strerror), "a file that can be written") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.discard()

    @contextmanager
    def writing(self) -> Iterator[BinaryIO]:
        """Write the whole file, which is then kept.

        Raises
        ------
        RunError
            where it cannot be written to its end
        """
        try:
            yield self.file
            self.keep()
        except OSError as error:
            left = "the file is not complete" if self._final is None else "no file is written"
            raise RunError(f"{self._where}: {error.strerror}; {left}") from error

    def keep(self) -> None:
        """Close the file, and give it its name.

        Raises
        ------
        OSError
            where what is left of it cannot be written
        RunError
            where it cannot take its name
        """
        self.file.flush()
        try:
            if self._final is not None:
                Path(self.file.name).replace(self._final)  # before it is closed, which lets go of the lock
        except OSError as error:
            raise RunError(f"{self._where}: {error.strerror}; it is left as {self.file.name}") from error
        finally:
            self.file.close()

    def discard(self) -> None:
        """Close and remove a file that is not kept."""
        if self.file.closed:
            return
        with suppress(OSError):
            if self._final is not None:
                Path(self.file.name).unlink()
        with suppress(OSError):  # what cannot be written is not wanted
            self.file.close()


def lock(opened: int, where: str) -> None:
    """Keep other runs off a file or folder until it is closed; where its file system has no locks, warn.

    Parameters
    ----------
    opened : its descriptor
    where : what error lines call it

    Raises
    ------
    OutputError
        where another run has it
    """
    try:
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        found = f"is being written by {_holder(opened)}"
        raise OutputError(where, found, "another place, or an end of that run") from None
    except OSError as error:
        _log.warning("%s: cannot be locked (%s); no other run should write it", where, error.strerror)


def _holder(opened: int) -> str:
    """Name the process that has locked a file, where the system says so."""
    state = os.fstat(opened)
    file = f"{os.major(state.st_dev):02x}:{os.minor(state.st_dev):02x}:{state.st_ino}"
    with suppress(OSError):
        for line in Path("/proc/locks").read_text(encoding="ascii").splitlines():
            words = line.split()  # number, kind, mode, access, process, file, first and last byte
            if words[1] == "FLOCK" and words[5] == file:
                return f"process {words[4]}"
    return "another run"


def _opened(path: Path, where: str, buffering: int) -> tuple[BinaryIO, Path | None]:
    """Open a file, and give the name that it is to take; None where it is written straight."""
    if path == STDOUT:
        return os.fdopen(os.dup(sys.stdout.fileno()), "wb", buffering), None
    if path.exists() and not path.is_file():  # a folder cannot be opened
        return path.open("wb", buffering), None
    final = path.resolve()
    before = final.stat() if final.exists() else None
    if before and not os.access(final, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    try:
        file = _locked(final.with_name(f"{final.name}.part"), where, buffering)
    except OSError as error:
        if before is None or error.errno not in _NO_NEW_FILE:
            raise
        return _locked(final, where, buffering), None
    if before:
        for owner, group in ((-1, before.st_gid), (before.st_uid, -1)):
            with suppress(OSError):  # only root may give files away
                os.fchown(file.fileno(), owner, group)
        with suppress(OSError):
            os.fchmod(file.fileno(), before.st_mode & _RIGHTS)
    return file, final


def _locked(path: Path, where: str, buffering: int) -> BinaryIO:
    """Open a file that no other run has open, and empty it; one that a killed run has left is nobody's."""
    while True:
        file = open(path, "wb", buffering, opener=_as_it_is)  # noqa: SIM115  # its holder closes it
        try:
            lock(file.fileno(), where)
            if path.exists() and os.path.samestat(
                path.stat(), os.fstat(file.fileno())
            ):  # else the run before has just renamed it
                file.truncate(0)
                return file
        except BaseException:
            file.close()
            raise
        file.close()


def _as_it_is(path: str, flags: int) -> int:
    return os.open(path, flags & ~os.O_TRUNC | os.O_NOFOLLOW, 0o666)


def write_json(path: Path, tree: Mapping[str, Any]) -> None:
    """Write a file of one JSON object, in place of the one that is there.

    Raises
    ------
    OutputError, RunError
        as `OutputFile`
    """
    with OutputFile(path) as output, output.writing() as file:
        file.write(f"{json.dumps(tree, indent=2, ensure_ascii=False)}\n".encode())
