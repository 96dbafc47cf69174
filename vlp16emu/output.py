"""Outputs of runs: written beside their names, which they take when they are whole, by one run at a time."""

import errno
import fcntl
import json
import logging
import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO, Self

from vlp16emu.errors import OutputError, RunError

STDOUT = Path("-")  # stands for standard output, as for tcpdump and tshark

_LONGEST_NAME_BYTES = 240  # of the 255 bytes of a name (NAME_MAX of Linux), 14 are for what is added
_RIGHTS = 0o777

_log = logging.getLogger(__name__)


class OutputFile:
    """A file to be written; a context manager.

    It is written as NAME.xxxxxxxx.part, a new file beside its name, and takes the name when it is kept. Until then the
    earlier file stays, whatever ends the run. It gets the rights of the file that it replaces, and a link stays a
    link. A pipe or a device is written straight. Raises OutputError if it cannot be opened, is one of the inputs, or another
    run writes it.

    Parameters
    ----------
    path : the file, or `STDOUT`
    where : its name in error lines; `path` if left out
    buffering : as for `open`
    inputs : files that the run reads, and that may not be replaced
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
        """Name under which the bytes stand until the file is kept."""
        return self._where if self._final is None else str(self.file.name)

    @contextmanager
    def writing(self) -> Iterator[BinaryIO]:
        """Write the whole file, which is then kept; raises RunError if it cannot be written to its end."""
        try:
            yield self.file
            self.keep()
        except OSError as error:
            left = "the file is not complete" if self._final is None else "no file is written"
            raise RunError(f"{self._where}: {error.strerror or error}; {left}") from error

    def keep(self) -> None:
        """Close the file and give it its name.

        Raises OSError if the buffered rest cannot be written; RunError if it cannot take its name.
        """
        self.file.flush()
        try:
            if self._final is not None:
                Path(self.file.name).replace(self._final)  # before it is closed, which ends the lock
        except OSError as error:
            raise RunError(f"{self._where}: {error.strerror}; it is left as {self.file.name}") from error
        finally:
            self.file.close()

    def leave(self) -> None:
        """Close an incomplete file that is worth keeping; it stays without its final name, at `place`."""
        with suppress(OSError):  # a full disk, which has been reported
            self.file.close()

    def discard(self) -> None:
        """Close and remove a file that is neither kept nor left."""
        if self.file.closed:
            return
        with suppress(OSError):
            if self._final is not None:
                Path(self.file.name).unlink()
        self.leave()


def write_json(path: Path, tree: Mapping[str, Any]) -> None:
    """Write a file of one JSON object, in place of an earlier one; errors as for `OutputFile`."""
    with OutputFile(path) as output, output.writing() as file:
        file.write(f"{json.dumps(tree, indent=2, ensure_ascii=False)}\n".encode())


def final_name(path: Path) -> Path:
    """Return the name that an output takes, behind all links; `OSError` for links in a circle."""
    final = Path(os.path.realpath(path))
    if final.is_symlink():
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))
    return final


def spare(inputs: Iterable[Path], output: Path) -> None:
    """Raise OutputError if `output` is one of the files that are read, by device and inode, whatever its name."""
    for file in inputs:
        with suppress(OSError):  # one of them does not exist
            if file.samefile(output):
                raise OutputError(str(output), "is read by this run, and would be written over", "another place")


def lock(opened: int, where: str) -> None:
    """Keep other runs off a file or folder, by its descriptor, until it is closed; warn if its file system has no locks.

    Raises OutputError, in the name of `where`, if another run has locked it.
    """
    try:
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        found = f"is being written by {_holder(opened)}"
        raise OutputError(where, found, "another place, or an end of that run") from None
    except OSError as error:
        _log.warning("%s: cannot be locked (%s); no other run should write it", where, error.strerror)


def _holder(opened: int) -> str:
    """Name the process that has locked a file, if the system says so."""
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
    """Raise OutputError in the name of `where` if the block cannot open something."""
    try:
        yield
    except (OSError, ValueError) as error:  # a name with a NUL or half a character is a ValueError
        found = error.strerror if isinstance(error, OSError) else "no name of a file"
        raise OutputError(where, str(found), expected) from error


def _stem(final: Path) -> str:
    name = os.fsencode(final.name)
    if len(name) <= _LONGEST_NAME_BYTES:
        return final.name
    from hashlib import sha256  # here: it loads OpenSSL, which no help needs

    return sha256(name).hexdigest()


def part_beside(final: Path) -> Path:
    """Return a new name beside `final` for what is not whole yet."""
    return final.with_name(f"{_stem(final)}.{os.urandom(4).hex()}.part")


def _new_file(final: Path, where: str, buffering: int) -> BinaryIO:
    """Open a new file beside `final`, with the rights of the one that is there."""
    before = final.stat() if final.exists() else None
    if before and not os.access(final, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    part = part_beside(final)
    file = part.open("xb", buffering)  # which neither empties a file nor follows a link
    try:
        claim(file.fileno(), part, final, where)
    except OutputError:
        part.unlink()
        file.close()
        raise
    if before:
        take_rights(file.fileno(), before)
    return file


def take_rights(opened: int, before: os.stat_result) -> None:
    """Give a new file or folder owner, group and mode of the one that it replaces, as far as that is allowed."""
    for owner, group in ((-1, before.st_gid), (before.st_uid, -1)):
        with suppress(OSError):  # only root may give files away
            os.fchown(opened, owner, group)
    with suppress(OSError):
        os.fchmod(opened, before.st_mode & _RIGHTS)


def claim(opened: int, part: Path, final: Path, where: str) -> None:
    """Lock a new file or folder, and refuse it if another run is writing one of the same final name."""
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
