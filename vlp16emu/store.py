"""Cache files, compiled kernels and parts of worlds.

Each is complete or ignored, in a folder that only the user can write.

The name of a file is a digest of all inputs of its content, with the package's files and the libraries that
made it. A file is a marker, the SHA-256 of its name and its content, and the content: a pickle, which runs
code when it is read. So a folder or file that others can write is not used; both are checked when they are
open.
"""

import hashlib
import os
import pickle
import stat
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache, cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import numpy as np
from platformdirs import user_cache_path

T = TypeVar("T")
PACKAGE = Path(__file__).parent
MAKERS = (  # files and folders of the package that determine the content of worlds
    "elementary.py",
    "engine",
    "extras/meshes",
    "extras/splines.py",
    "extras/walk",
    "foliage",
    "forest",
    "motion",
    "random.py",
    "raycast",
    "store.py",
    "tables.py",
    "trig.py",
    "types.py",
    "world",
)
_OURS = b"vlp16emu store "
_MAGIC = (_OURS + b"2").ljust(32)
_BEGIN = len(_MAGIC) + 32
_DEFAULT_BYTES = 1_000_000_000


class Store:
    """Files in a folder of the user, which is made when it is first needed.

    Parameters
    ----------
    folder : None disables the store, as does a folder in which others can write
    suffix : suffix of file names
    most_bytes : size limit; the least recently used files beyond it are removed
    """

    def __init__(self, folder: Path | None, suffix: str, most_bytes: int) -> None:
        self.folder = folder
        self.suffix = suffix
        self.most_bytes = most_bytes
        # bytes written since sizes were last summed; starts at the limit because of other runs
        self._unsummed_bytes = most_bytes
        self._writer: ThreadPoolExecutor | None = None

    @cached_property
    def usable_folder(self) -> Path | None:
        """The folder, if only the user or root can write in it or replace it."""
        return None if self._opened is None else self.folder

    @cached_property
    def _opened(self) -> int | None:
        """Descriptor of the folder; None if it is not safe.

        All files are reached by it, as a user who owns a folder above could put another in its place.
        """
        if self.folder is None:
            return None
        with suppress(OSError):
            for level in (self.folder.parent, self.folder):
                level.mkdir(0o700, parents=True, exist_ok=True)
            opened = os.open(self.folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
            above = os.stat("..", dir_fd=opened)
            if _is_ours(os.fstat(opened)) and (_is_ours(above) or above.st_mode & stat.S_ISVTX):
                return opened
            os.close(opened)
        return None

    def read(self, name: str) -> memoryview | None:
        """Read a file; None if it is missing, damaged, or others can write it."""
        if self._opened is None:
            return None
        try:
            with _open(name, self._opened) as file:
                content = content_of(memoryview(file.read()), name)
                with suppress(OSError):  # on a file system that is read-only
                    os.utime(file.fileno())  # used now
                return content
        except OSError:
            return None

    def has(self, name: str) -> bool:
        """Return whether a file exists, complete or not."""
        with suppress(OSError):
            return self._opened is not None and bool(os.stat(name, dir_fd=self._opened))
        return False

    def names(self) -> list[str]:
        """List the names of all files of the folder."""
        if self._opened is None:
            return []
        with os.scandir(self._opened) as entries:
            return [entry.name for entry in entries]

    def write(self, name: str, content: bytes) -> None:
        """Write a file; a full disk, or a read-only folder, is not an error."""
        if self._opened is None:
            return
        aside = f"{name}.{os.getpid()}.part"  # programs may share the folder
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC
        try:
            with open(os.open(aside, flags, 0o600, dir_fd=self._opened), "wb") as file:  # noqa: PTH123
                file.writelines((_begin(name, content), content))
            os.replace(aside, name, src_dir_fd=self._opened, dst_dir_fd=self._opened)
        except OSError:
            with suppress(OSError):
                os.unlink(aside, dir_fd=self._opened)
        self._unsummed_bytes += len(content)
        if self._unsummed_bytes > self.most_bytes / 16:
            self._unsummed_bytes = 0
            files = sorted(self._files(), key=lambda file: file[1].st_mtime, reverse=True)
            totals = np.cumsum([state.st_size for _, state in files])
            self._remove(files[np.searchsorted(totals, self.most_bytes, "right") :])

    def keep(self, name: str, thing: object) -> None:
        """Pickle an object into a file on a separate thread; the object must not be changed any more."""
        self._writer = self._writer or ThreadPoolExecutor(1, "keep")
        with suppress(RuntimeError):  # the program ends
            self._writer.submit(lambda: self.write(name, pickle.dumps(thing, protocol=5)))

    def flush(self) -> None:
        """Wait until all files are written."""
        if self._writer is not None:
            self._writer.submit(int).result()

    def kept(self) -> tuple[int, int]:
        """Count files and bytes."""
        sizes = [state.st_size for _, state in self._files()]
        return len(sizes), sum(sizes)

    def clear(self) -> tuple[int, int]:
        """Remove all files, identified by name and first bytes; return their number and total size."""
        return self._remove(list(self._files()))

    def _files(self) -> Iterator[tuple[str, os.stat_result]]:
        for name in self.names():
            if Path(name).suffix in (self.suffix, ".part") and self.suffix in name:
                with suppress(OSError), _open(name, self._opened) as file:
                    if file.read(len(_OURS)) == _OURS:  # also one of an earlier version
                        yield name, os.fstat(file.fileno())

    def _remove(self, files: Iterable[tuple[str, os.stat_result]]) -> tuple[int, int]:
        gone = []
        for name, state in files:
            with suppress(OSError):
                os.unlink(name, dir_fd=self._opened)
                gone.append(state.st_size)
        return len(gone), sum(gone)


def content_of(data: memoryview, name: str) -> memoryview | None:
    """Return the content of the data of a file; None if it is damaged."""
    return data[_BEGIN:] if data[:_BEGIN] == _begin(name, data[_BEGIN:]) else None


def _open(name: str, folder: int | None) -> BinaryIO:
    """Open a regular file that only the user or root can write; OSError for any other."""
    opened = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=folder)
    state = os.fstat(opened)
    if stat.S_ISREG(state.st_mode) and _is_ours(state):
        return open(opened, "rb")  # noqa: PTH123  # by descriptor
    os.close(opened)
    raise PermissionError(name)


def _is_ours(state: os.stat_result) -> bool:
    """Return True for a file or folder in which only the user or root can write."""
    return state.st_uid in (0, os.getuid()) and not state.st_mode & 0o022


def _begin(name: str, content: bytes | memoryview) -> bytes:
    digest = hashlib.sha256(name.encode())
    digest.update(content)
    return _MAGIC + digest.digest()


def digest_of(sources: Iterable[str], *more: object) -> str:
    """Return a digest of files and folders of the package, and of further values.

    It is independent of their path and time stamps.
    """
    digest = hashlib.sha256(repr(more).encode())
    for source in sources:
        path = PACKAGE / source
        for file in [path] if path.is_file() else sorted(path.rglob("*")):
            if file.suffix in (".py", ".toml"):
                content = hashlib.sha256(file.read_bytes()).digest()
                digest.update(f"\n{file.relative_to(PACKAGE).as_posix()} ".encode() + content)
    return digest.hexdigest()


def user_folder(name: str) -> Path | None:
    """Return a folder in the user's cache, at the system's location; None for a user without a home."""
    try:
        return user_cache_path("vlp16emu", appauthor=False) / name
    except RuntimeError:  # no HOME, and a user whom the system does not know, as in containers
        return None


@cache
def user_store() -> Store:
    """Return the store of parts of worlds, up to `VLP16EMU_CACHE_MB` or 1 GB.

    It is in `VLP16EMU_CACHE_DIR` or the user's cache.
    """
    try:
        most_bytes = max(int(float(os.environ.get("VLP16EMU_CACHE_MB", "")) * 1e6), 0)
    except (ValueError, OverflowError):  # not a finite number
        most_bytes = _DEFAULT_BYTES
    chosen = os.environ.get("VLP16EMU_CACHE_DIR")
    folder = Path(chosen) if chosen else user_folder("world")
    return Store(None if chosen in ("", "off") or not most_bytes else folder, ".world", most_bytes)


def recall(
    name: str,
    make: Callable[[], T],
    pack: Callable[[T], Any] = lambda thing: thing,
    unpack: Callable[[Any], T] = lambda thing: thing,
) -> T:
    """Return an object from the user's store, or make it and keep it there.

    Parameters
    ----------
    name : text with all its inputs; empty if it is not kept
    make : function that makes it
    pack, unpack : convert it into an object that can be pickled, and back
    """
    if not name or (store := user_store()).folder is None:
        return make()
    file = hashlib.sha256(f"{_state()}\n{name}".encode()).hexdigest()[:40] + ".world"
    if (kept := store.read(file)) is not None:
        return unpack(pickle.loads(kept))  # noqa: S301  # ours, by its folder and sum
    thing = make()
    store.keep(file, pack(thing))
    return thing


@cache
def _state() -> str:
    """Return a digest of the files that determine worlds, of numerical libraries, and of the machine."""
    return digest_of(
        MAKERS,
        np.__version__,
        version("scipy"),
        os.uname().machine,
        sys.byteorder,
        sys.implementation.cache_tag,
    )
