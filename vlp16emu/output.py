"""Outputs of runs: written under temporary names, renamed when complete, by one run at a time.

Whatever waits for the outside world while it is opened or written, as a pipe for its reader, ends with
`is_ending`.
"""

import errno
import fcntl
import json
import logging
import os
import re
import select
import shutil
import stat
import sys
import time
import weakref
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager, suppress
from io import BufferedWriter, FileIO
from math import inf
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, BinaryIO, Self, TypeVar, cast

from vlp16emu.errors import OutputError, RunError
from vlp16emu.trees import Table

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

T = TypeVar("T")

_POLL_S = 0.05  # interval at which what waits checks if the run ends


class SignalEvent(Event):
    """An event that a signal handler may set.

    `Event.set` takes a lock: in a handler that interrupts a `wait` of its thread it may wait for ever.
    """

    def __init__(self) -> None:
        super().__init__()
        self._has_come = False

    def is_set(self) -> bool:
        """Return whether it has been set."""
        return self._has_come

    def set(self) -> None:
        """Set it; what waits for it goes on within 50 ms."""
        self._has_come = True

    def clear(self) -> None:
        """Make it as new."""
        self._has_come = False

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until it is set, or for a time in s; return whether it is set."""
        end_s = inf if timeout is None else time.monotonic() + timeout
        while not self._has_come and (left_s := end_s - time.monotonic()) > 0:
            time.sleep(min(left_s, _POLL_S))  # resumed after a signal (PEP 475)
        return self._has_come


is_ending = SignalEvent()
"""Set by the first signal that ends the run: Python resumes calls that a signal interrupts (PEP 475)."""

STDOUT = Path("-")  # stands for standard output, as for tcpdump and tshark

_LONGEST_NAME_BYTES = 240  # 255 bytes (NAME_MAX of Linux) minus the longest suffix
_RIGHTS = 0o777
# Arguments of renameat2(2). Source: linux/fcntl.h and linux/fs.h.
_AT_FDCWD = -100
_RENAME_EXCHANGE = 2
_PATIENCE_S = 0.4  # time that a reader has, once the run ends, to take what is written last

_log = logging.getLogger(__name__)


class Staged:
    """A new file or folder under a temporary name, which takes its final name in one step.

    It is NAME.xxxxxxxx.part, beside NAME, and locked until it is kept, left or discarded. An earlier output
    is unchanged until `keep`, even if the run fails, and is then replaced as a whole by one with its
    permissions. A link stays a link.

    Parameters
    ----------
    path : final name
    where : name of the output in error lines
    check : refuses, by its error, an existing output that must not be replaced; called here and in `keep`
    is_folder : True to make a folder

    Raises OSError if it cannot be made; OutputError if another run writes the same output, or a folder cannot
    be replaced.
    """

    def __init__(
        self, path: Path, where: str, check: Callable[[Path], None], *, is_folder: bool = False
    ) -> None:
        self._final = final_name(path)
        self._where = where
        self._check = check
        if is_folder and (self._final.is_mount() or self._final == Path.cwd()):
            raise OutputError(where, "is a mount point or the working folder", "a folder in it")
        check(self._final)
        self.path = part_beside(self._final)
        if is_folder:
            self.path.mkdir()
            self.descriptor = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        else:  # a new file: none is truncated, and no link is followed
            self.descriptor = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        self._close = weakref.finalize(self, os.close, self.descriptor)
        try:
            _claim(self.descriptor, self.path, self._final, where)
        except (OutputError, OSError):  # the latter in a folder that cannot be listed
            self.discard()
            raise
        if self._final.exists() and self._final.is_dir() == is_folder:
            _take_rights(self.descriptor, self._final.stat())

    def keep(self, made: Path | None = None) -> None:
        """Give the final name to the output, or to `made`, a file or folder in it.

        An earlier output is removed, and so is what remains in the output beside `made`. Raises RunError if
        that fails, and the output is left.
        """
        made = made or self.path
        try:
            self._check(self._final)
            if self._final.exists():
                _flush(made)
                _take_rights(made, self._final.stat())
            if made.is_dir() and self._final.is_dir():
                _exchange(made, self._final)
            else:
                made.replace(self._final)
        except (OSError, OutputError) as error:
            found = error.strerror if isinstance(error, OSError) else error.found
            raise RunError(f"{self._where}: {found}; it is left as {self.path}") from error
        finally:
            self._close()  # not before: it ends the lock
        self._remove()

    def leave(self) -> None:
        """Keep an incomplete output under its temporary name."""
        self._close()

    def discard(self) -> None:
        """Remove an output that is neither kept nor left."""
        if self._close.alive:
            self._remove()
            self._close()

    def _remove(self) -> None:
        if self.path.is_dir():
            shutil.rmtree(self.path, ignore_errors=True)
        else:
            with suppress(OSError):
                self.path.unlink(missing_ok=True)


class OutputFile:
    """A file to be written; a context manager.

    It is `Staged`, and gets its name when it is kept. Standard output, a pipe or a device is written
    directly. Raises OutputError if it cannot be opened, is one of the inputs, or is being written by another
    run.

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
        self._staged: Staged | None = None
        spare(inputs, path)
        with opening(self._where, "a file that can be written"):
            self.file: BinaryIO
            if path == STDOUT:
                self.file = _pipe_file(path, os.dup(sys.stdout.fileno()), buffering)
            elif path.exists() and not path.is_file():  # opening a folder fails, with the system's reason
                self.file = _pipe_file(path, _open_pipe(path), buffering)
            else:
                self._staged = staged = Staged(path, self._where, _check_writable)
                self.file = open(  # noqa: SIM115  # `Path.open` takes no opener
                    staged.path, "wb", buffering, opener=lambda *_: os.dup(staged.descriptor)
                )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.discard()

    @property
    def place(self) -> str:
        """Name of the file until it is kept."""
        return self._where if self._staged is None else str(self._staged.path)

    @contextmanager
    def writing(self) -> Iterator[BinaryIO]:
        """Write the whole file and keep it; raises RunError if it cannot be written completely."""
        try:
            yield self.file
            self.keep()
        except OSError as error:
            left = "the file is not complete" if self._staged is None else "no file is written"
            raise RunError(f"{self._where}: {error.strerror or error}; {left}") from error

    def keep(self) -> None:
        """Close the file and give it its final name.

        Raises OSError if buffered data cannot be written; RunError if it cannot be renamed.
        """
        self.file.flush()
        try:
            if self._staged is not None:
                self._staged.keep()
        finally:
            self.file.close()

    def leave(self) -> None:
        """Close an incomplete file that is worth keeping; it stays at `place`."""
        with suppress(OSError):  # disk full; already reported
            self.file.close()
        if self._staged is not None:
            self._staged.leave()

    def discard(self) -> None:
        """Close and remove a file that is neither kept nor left."""
        if self._staged is not None:
            self._staged.discard()
        self.leave()


class _Pipe(FileIO):
    """A pipe or a device, written in pieces for which there is room, so that a signal ends the wait."""

    def write(self, data: "ReadableBuffer") -> int:
        """Write some bytes; raises CancelledError if the run ends and nobody reads."""
        while not select.select([], [self], [], _POLL_S)[1]:
            if is_ending.is_set() and not select.select([], [self], [], _PATIENCE_S)[1]:
                raise CancelledError
        return super().write(memoryview(data).cast("B")[: select.PIPE_BUF])


def _pipe_file(path: Path, opened: int, buffering: int) -> BinaryIO:
    """Return a file for standard output, a pipe or a device, by its descriptor."""
    raw = _Pipe(opened, "wb")
    raw.name = str(path)  # a zip archive takes it
    return cast(BinaryIO, BufferedWriter(raw) if buffering else raw)


def _open_pipe(path: Path) -> int:
    """Open a file that is not regular for writing, and wait for the reader of a FIFO.

    Raises CancelledError if the run ends before; OSError if it cannot be opened.
    """
    while True:
        try:
            opened = os.open(path, os.O_WRONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY)
        except OSError as error:
            if error.errno != errno.ENXIO or not stat.S_ISFIFO(path.stat().st_mode):
                raise
        else:
            os.set_blocking(opened, True)
            return opened
        if is_ending.wait(_POLL_S):
            raise CancelledError


def unless_ending(call: Callable[[], T]) -> T:
    """Return the result of a call that waits for the outside world, as for a name or a connection.

    It has a thread of its own, which is abandoned if the run ends. Raises its errors; CancelledError then.
    """
    result = Future[T]()

    def run() -> None:
        """Call the function, and keep its result or its error."""
        try:
            result.set_result(call())
        except BaseException as error:  # noqa: BLE001  # raised where it is waited for
            result.set_exception(error)

    Thread(target=run, name="outside", daemon=True).start()
    while not is_ending.is_set():
        with suppress(TimeoutError):
            return result.result(_POLL_S)
    raise CancelledError


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


def _check_writable(final: Path) -> None:
    """Raise PermissionError for an existing file that must not be written."""
    if final.exists() and not os.access(final, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))


def _take_rights(made: int | Path, before: os.stat_result) -> None:
    """Copy owner, group and mode from the file or folder that is replaced, as far as allowed."""
    for owner, group in ((-1, before.st_gid), (before.st_uid, -1)):
        with suppress(OSError):  # only root may change the owner
            os.chown(made, owner, group)
    with suppress(OSError):
        os.chmod(made, before.st_mode & _RIGHTS)  # noqa: PTH101  # also of a descriptor


def _flush(made: Path) -> None:
    """Write a file, or the files of a folder, to the disk: a power failure must not cost the earlier ones."""
    for path in made.rglob("*") if made.is_dir() else (made,):
        if path.is_file():
            with path.open("ab") as file:  # may be read by nobody, as the earlier one
                os.fsync(file.fileno())


def _exchange(one: Path, other: Path) -> None:
    """Swap the names of two folders in one step, or in three on a file system that cannot."""
    import ctypes  # here: few runs replace a folder

    swap = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if swap and swap(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE) == 0:
        return
    aside = part_beside(other)
    other.rename(aside)
    try:
        one.rename(other)
    except OSError:
        aside.rename(other)
        raise
    aside.rename(one)


def _claim(opened: int, part: Path, final: Path, where: str) -> None:
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
