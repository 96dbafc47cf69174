"""Files that are whole or as good as none, in folders where nobody but the user writes.

A file is a marker, the SHA-256 of its name and its content, and the content. It is written aside and then renamed, so
that programs may share a folder.
"""

import hashlib
import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import cached_property
from pathlib import Path

import numpy as np

PACKAGE = Path(__file__).parent
_OURS = b"vlp16emu store "
_MAGIC = (_OURS + b"2").ljust(32)
_BEGIN = len(_MAGIC) + 32


class CheckedFolder:
    """Checked files in a folder of the user's own, which is made when it is first needed.

    Parameters
    ----------
    folder : None keeps nothing, as does one in which others can write
    suffix : of the names of the files
    most_bytes : the least recently used files beyond it are removed
    """

    def __init__(self, folder: Path | None, suffix: str, most_bytes: int) -> None:
        self.folder, self.suffix, self.most_bytes = folder, suffix, most_bytes
        self._unlooked = most_bytes

    @cached_property
    def own(self) -> Path | None:
        """The folder, if nobody but the user, or root, can write in it or put another one in its place."""
        if self.folder is None:
            return None
        with suppress(OSError):
            for level in (self.folder.parent, self.folder):
                level.mkdir(0o700, parents=True, exist_ok=True)
            above, state = self.folder.parent.stat().st_mode, self.folder.lstat()
            is_ours = stat.S_ISDIR(state.st_mode) and state.st_uid in (0, os.getuid())
            if is_ours and not state.st_mode & 0o022 and (not above & 0o022 or above & stat.S_ISVTX):
                return self.folder
        return None

    def read(self, name: str) -> memoryview | None:
        """Read a file; None if it is not there or is not what was written."""
        if self.own is None or (content := read_checked(self.own / name)) is None:
            return None
        with suppress(OSError):
            os.utime(self.own / name)  # used now
        return content

    def write(self, name: str, *parts: bytes | memoryview) -> None:
        """Write a file of parts; a full disk, or a folder of root's, is no error."""
        if self.own is None:
            return
        path = self.own / name
        aside = path.with_name(f"{name}.{os.getpid()}.part")
        try:
            with aside.open("wb") as file:
                self._unlooked += sum(map(file.write, (_begin(path, *parts), *parts)))
            aside.replace(path)
        except OSError:
            with suppress(OSError):
                aside.unlink()
        if self._unlooked > self.most_bytes / 16:
            self._unlooked = 0
            files = sorted(self._files(), key=lambda file: file[1].st_mtime, reverse=True)
            totals = np.cumsum([state.st_size for _, state in files])
            _remove(files[np.searchsorted(totals, self.most_bytes, "right") :])

    def kept(self) -> tuple[int, int]:
        """Count files and bytes."""
        sizes = [state.st_size for _, state in self._files()]
        return len(sizes), sum(sizes)

    def clear(self) -> tuple[int, int]:
        """Remove all files, which are known by name and first bytes; say how many and how many bytes went."""
        return _remove(self._files())

    def _files(self) -> Iterator[tuple[Path, os.stat_result]]:
        for path in self.folder.glob(f"*{self.suffix}*") if self.folder else ():
            with suppress(OSError):
                if path.suffix in (self.suffix, ".part") and path.is_file() and not path.is_symlink():
                    with path.open("rb") as file:
                        if file.read(len(_OURS)) == _OURS:  # also one of an earlier version
                            yield path, path.stat()


def read_checked(path: Path) -> memoryview | None:
    """Read the content of a file, which may be written to; None if it is not there or is not what was written."""
    try:
        data = np.fromfile(path, np.uint8)
    except OSError:
        return None
    content = data[_BEGIN:].data
    return content if data[:_BEGIN].tobytes() == _begin(path, content) else None


def _begin(path: Path, *parts: bytes | memoryview) -> bytes:
    digest = hashlib.sha256(path.name.encode())
    for part in parts:
        digest.update(part)
    return _MAGIC + digest.digest()


def _remove(files: Iterable[tuple[Path, os.stat_result]]) -> tuple[int, int]:
    gone = []
    for path, state in files:
        with suppress(OSError):
            path.unlink()
            gone.append(state.st_size)
    return len(gone), sum(gone)


def digest_of(sources: Iterable[str], *more: object) -> str:
    """Name the state of files and folders of the package, whatever their place and time stamps, and of what else decides."""
    digest = hashlib.sha256(repr(more).encode())
    for source in sources:
        path = PACKAGE / source
        for file in [path] if path.is_file() else sorted(path.rglob("*")):
            if file.suffix in (".py", ".toml"):
                content = hashlib.sha256(file.read_bytes()).digest()
                digest.update(f"\n{file.relative_to(PACKAGE).as_posix()} ".encode() + content)
    return digest.hexdigest()
