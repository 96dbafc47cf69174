"""One way in for files of users: regular files of bounded size, and pipes where they make sense.

A file that cannot be read, a special file, and whatever a library raises while it reads one, is an input
error of the caller's class, in one line.
"""

import json
import os
import select
import stat
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader, FileIO, RawIOBase
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any

from vlp16emu.errors import InputError, Vlp16emuError

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

LARGEST_BYTES = 1_000_000_000  # largest mesh or grid of heights: some 20 million triangles, 250 million cells
LARGEST_TEXT_BYTES = 100_000_000  # largest scene, list or table: a million lines
_KINDS = {
    stat.S_IFDIR: "is a directory",
    stat.S_IFIFO: "is a FIFO",
    stat.S_IFSOCK: "is a socket",
    stat.S_IFCHR: "is a device",
    stat.S_IFBLK: "is a device",
}
_BUFFER_BYTES = 1 << 18  # captures of hours are read in pieces of this size
_PIECE_BYTES = 1 << 22  # of a file that is read whole
_HEAD_BYTES = 512
_POLL_S = 0.1


def read_bytes(
    path: Path, expected: str, error: type[InputError], *, most_bytes: int = LARGEST_TEXT_BYTES
) -> bytes:
    """Read a regular file of a user.

    Parameters
    ----------
    expected : description of the file, for messages
    error : class of error for a file that cannot be read, is special, or is longer than `most_bytes`
    """
    with open_input(path, expected, error, most_bytes=most_bytes) as file:
        content = bytearray()
        while len(content) <= most_bytes and (piece := file.read(min(_PIECE_BYTES, most_bytes + 1))):
            content += piece
    if len(content) > most_bytes:
        raise _too_long(path, len(content), most_bytes, expected, error)
    return bytes(content)


def read_text(
    path: Path, expected: str, error: type[InputError], *, most_bytes: int = LARGEST_TEXT_BYTES
) -> str:
    """Read a regular file of UTF-8 text, with or without a byte order mark, as `read_bytes`.

    Lines end with a line feed only.
    """
    content = read_bytes(path, expected, error, most_bytes=most_bytes)
    with parsing(path, expected, error):
        text = content.decode("utf-8-sig")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def parse_json(text: str) -> Any:
    r"""Return the tree of JSON types in a text.

    Raises ValueError for text that is no JSON, that has lists or objects too deep in one another, or that
    escapes half a character (a lone surrogate), as `\ud800`: no file has such a name, and no output takes it.
    """
    try:
        tree = json.loads(text)
        if "\\ud" in text.lower():
            json.dumps(tree, ensure_ascii=False).encode()
    except RecursionError as error:
        raise ValueError(str(error)) from None
    except UnicodeEncodeError as error:
        raise ValueError(f"{error.object[error.start]!a} is half a character") from None
    return tree


@contextmanager
def open_input(
    path: Path,
    expected: str,
    error: type[InputError],
    *,
    most_bytes: int | None = LARGEST_TEXT_BYTES,
    takes_pipes: bool = False,
    takes_all: bool = False,
    stop: Event | None = None,
) -> Iterator["BufferedReader[RawIOBase]"]:
    """Open a file of a user for reading; what cannot be opened or read is an error of class `error`.

    So is a file that came in the place of another one (`what_is`). Opening waits for a pipe only. Kind and
    size are checked once more when the file is open, as its name may have changed.

    Parameters
    ----------
    expected : description of the file, for messages
    most_bytes : a longer file is refused; None for one that is read in pieces
    takes_pipes : True to read also a FIFO
    takes_all : True for a file that is not parsed, and may be empty or a page of HTML
    stop : ends the wait for a pipe, as if it had ended
    """
    with _system_errors(path, expected, error):
        opened = _open(path, expected, error, most_bytes, takes_pipes=takes_pipes)
        is_pipe = stat.S_ISFIFO(os.fstat(opened).st_mode)
        raw: RawIOBase = _Pipe(opened, stop or Event()) if is_pipe else FileIO(opened)
        with BufferedReader(raw, _BUFFER_BYTES) as file:
            found = None if takes_all else what_is(file.peek(_HEAD_BYTES))
            if found and not (stop and stop.is_set()):
                raise error(str(path), found, expected)
            yield file


@contextmanager
def readable(
    path: Path, expected: str, error: type[InputError], *, most_bytes: int | None = LARGEST_TEXT_BYTES
) -> Iterator[None]:
    """Check a file for a library that opens it by its name, and report what it raises as `parsing` does.

    A path that is not a regular file, or a file longer than `most_bytes`, is refused.
    """
    with open_input(path, expected, error, most_bytes=most_bytes), parsing(path, expected, error):
        yield


@contextmanager
def parsing(path: Path, expected: str, error: type[InputError]) -> Iterator[None]:
    """Report whatever a library raises while it reads a user's file as an error of class `error`.

    Its warnings are not shown.
    """
    try:
        with _system_errors(path, expected, error), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except Vlp16emuError:
        raise
    except UnicodeDecodeError as fault:
        raise error(str(path), f"no UTF-8 text at byte {fault.start}", expected) from None
    except MemoryError:
        raise error(str(path), "needs more memory than there is", expected) from None
    except Exception as fault:  # a damaged file may lead a library anywhere
        reason = next(iter(str(fault).splitlines()), "") or type(fault).__name__
        raise error(str(path), f"cannot be read: {reason}", expected) from fault


@contextmanager
def _system_errors(path: Path, expected: str, error: type[InputError]) -> Iterator[None]:
    try:
        yield
    except OSError as fault:
        found = fault.strerror.lower() if fault.strerror else str(fault)
        raise error(str(path), found or "cannot be read", expected) from None


def _open(
    path: Path, expected: str, error: type[InputError], most_bytes: int | None, *, takes_pipes: bool
) -> int:
    """Return the descriptor of a file that may be read."""

    def check(state: os.stat_result) -> None:
        """Refuse what is no regular file, or is too large."""
        kind = stat.S_IFMT(state.st_mode)
        if kind != stat.S_IFREG and not (takes_pipes and kind == stat.S_IFIFO):
            raise error(str(path), _KINDS[kind], expected)
        if most_bytes is not None and state.st_size > most_bytes:
            raise _too_long(path, state.st_size, most_bytes, expected, error)

    try:
        check(path.stat())  # before opening, as that alone may start a device
        opened = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY)
    except ValueError:  # a NUL, or half a character
        raise error(str(path), "no name of a file", expected) from None
    try:
        check(os.fstat(opened))
    except InputError:
        os.close(opened)
        raise
    return opened


def _too_long(path: Path, found: int, most_bytes: int, expected: str, error: type[InputError]) -> InputError:
    return error(str(path), f"found {found} bytes", f"{expected} of at most {most_bytes} bytes")


def what_is(head: bytes) -> str | None:
    """Say what a file is that came in the place of another one, from its first bytes, and what to do.

    Parameters
    ----------
    head : some hundred bytes, or all of a shorter file

    Returns
    -------
    None for a file of any other kind
    """
    if not head:
        return "an empty file: copy or download it again"
    if head.startswith(b"version https://git-lfs.github.com/spec/"):  # Git LFS, docs/spec.md, "The Pointer"
        return "a pointer of Git LFS in place of the file: `git lfs pull` fetches it"
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip().lower()
    if text.startswith((b"<!doctype html", b"<html")):
        return "a page of HTML in place of the file: download the file itself"
    return None


class _Pipe(RawIOBase):
    """A pipe that ends when an event is set: Python's own read resumes its wait after a signal (PEP 475)."""

    def __init__(self, opened: int, stop: Event) -> None:
        self._opened = opened
        self._stop = stop

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: "WriteableBuffer") -> int:
        while not self._stop.is_set():
            if select.select([self._opened], [], [], _POLL_S)[0]:
                return os.readv(self._opened, [buffer])
        return 0

    def close(self) -> None:
        if not self.closed:
            os.close(self._opened)
        super().close()
