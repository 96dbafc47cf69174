"""Folders as outputs: written beside their names, which they take when they are whole, by one run at a time."""

import ctypes
import os
import shutil
import weakref
from collections.abc import Callable, Iterable
from contextlib import suppress
from operator import attrgetter
from pathlib import Path
from typing import Self

from vlp16emu.errors import OutputError, RunError
from vlp16emu.output import claim, final_name, opening, part_beside, spare, take_rights

_AT_FDCWD, _RENAME_EXCHANGE = -100, 2  # arguments of renameat2(2). Source: linux/fcntl.h and linux/fs.h.

_NAME_OF = attrgetter("name")


class OutputFolder:
    """A folder to be written; a context manager that keeps it unless an error leaves the block.

    It is made as NAME.xxxxxxxx.part and takes its name as `OutputFile` does, in one step: what stood under the name until
    then is as it was, or all of it is replaced.

    Parameters
    ----------
    path : the folder; missing parents are made
    stranger : name of the first entry of a folder of that name that is not of an earlier run, None if there is none; by
        default a folder that has any entry is refused
    expected : what error lines call a folder that may be written
    inputs : files that the run reads, and that may not be in the folder

    Raises OutputError if it cannot be made, holds something else or one of the inputs, or another run writes it.
    """

    def __init__(
        self,
        path: Path,
        *,
        stranger: Callable[[Path], str | None] = lambda folder: min(map(_NAME_OF, folder.iterdir()), default=None),
        expected: str = "a new or empty folder",
        inputs: Iterable[Path] = (),
    ) -> None:
        self._where, self._stranger, self._expected = str(path), stranger, expected
        with opening(self._where, "a folder that can be written"):
            self._final = final_name(path)
            if self._final.is_mount() or self._final == Path.cwd():  # which cannot be renamed, or not under our feet
                raise OutputError(self._where, "is a mount point or the working folder", "a folder in it")
            self._check()
            for file in self._final.iterdir() if self._final.exists() else ():
                spare(inputs, file)
            self._final.parent.mkdir(parents=True, exist_ok=True)
            self.path = part_beside(self._final)
            self.path.mkdir()
            opened = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            self._close = weakref.finalize(self, os.close, opened)
            try:
                claim(opened, self.path, self._final, self._where)
            except OutputError:
                self.discard()
                raise
            if self._final.exists():
                take_rights(opened, self._final.stat())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is None:
            self.keep()
        self.discard()

    def keep(self) -> None:
        """Give the folder its name; `RunError` if it cannot take it."""
        try:
            self._check()
            if self._final.exists():
                _exchange(self.path, self._final)
                with suppress(OSError):  # what cannot be removed of the earlier run stays beside the new one
                    for file in self.path.iterdir():
                        file.unlink()
                    self.path.rmdir()
            else:
                self.path.rename(self._final)
        except (OSError, OutputError) as error:
            found = error.strerror if isinstance(error, OSError) else error.found
            raise RunError(f"{self._where}: {found}; it is left as {self.path}") from error
        finally:
            self._close()

    def leave(self) -> None:
        """Let an incomplete folder stay, without its final name, at `path`."""
        self._close()

    def discard(self) -> None:
        """Remove a folder that is neither kept nor left."""
        if self._close.alive:
            shutil.rmtree(self.path, ignore_errors=True)
            self._close()

    def _check(self) -> None:
        if self._final.exists() and (found := self._stranger(self._final)) is not None:
            raise OutputError(self._where, f"holds {found}", self._expected)


def _exchange(one: Path, other: Path) -> None:
    """Swap two names in one step, or in three on a file system that cannot."""
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
