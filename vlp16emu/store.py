"""Cache files, compiled kernels and parts of worlds.

Each is complete or ignored, in a folder that only the user can write.

The name of a file is a digest of all inputs of its content, with the package's files and the libraries that
made it. A file is a marker, the SHA-256 of its name and its content, and the content: a pickle, which runs
code when it is read. So a folder that others can write in is not used.
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
from typing import Any, TypeVar

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
    def own(self) -> Path | None:
        """The folder, if only the user or root can write in it or replace it."""
        if self.folder is None:
            return None
        with suppress(OSError):
            for level in (self.folder.parent, self.folder):
                level.mkdir(0o700, parents=True, exist_ok=True)
            above = self.folder.parent.stat().st_mode
            state = self.folder.lstat()
            is_ours = stat.S_ISDIR(state.st_mode) and state.st_uid in (0, os.getuid())
            if is_ours and not state.st_mode & 0o022 and (not above & 0o022 or above & stat.S_ISVTX):
                return self.folder
        return None

    def read(self, name: str) -> memoryview | None:
        """Read a file; None if it is missing or damaged."""
        if self.own is None or (content := read_checked(self.own / name)) is None:
            return None
        with suppress(OSError):
            os.utime(self.own / name)  # used now
        return content

    def write(self, name: str, content: bytes) -> None:
        """Write a file; a full disk, or a read-only folder, is not an error."""
        if self.own is None:
            return
        aside = self.own / f"{name}.{os.getpid()}.part"  # programs may share the folder
        try:
            with aside.open("wb") as file:
                file.writelines((_begin(name, content), content))
            aside.replace(self.own / name)
        except OSError:
            with suppress(OSError):
                aside.unlink()
        self._unsummed_bytes += len(content)
        if self._unsummed_bytes > self.most_bytes / 16:
            self._unsummed_bytes = 0
            files = sorted(self._files(), key=lambda file: file[1].st_mtime, reverse=True)
            totals = np.cumsum([state.st_size for _, state in files])
            _remove(files[np.searchsorted(totals, self.most_bytes, "right") :])

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
        return _remove(self._files())

    def _files(self) -> Iterator[tuple[Path, os.stat_result]]:
        for path in self.folder.glob(f"*{self.suffix}*") if self.folder else ():
            with suppress(OSError):
                if path.suffix in (self.suffix, ".part") and path.is_file() and not path.is_symlink():
                    with path.open("rb") as file:
                        if file.read(len(_OURS)) == _OURS:  # also one of an earlier version
                            yield path, path.stat()


def read_checked(path: Path) -> memoryview | None:
    """Read the content of a file; None if it is missing or damaged."""
    try:
        data = memoryview(path.read_bytes() if path.is_file() else b"")  # a FIFO or a device may have no end
    except OSError:
        return None
    return data[_BEGIN:] if data[:_BEGIN] == _begin(path.name, data[_BEGIN:]) else None


def _begin(name: str, content: bytes | memoryview) -> bytes:
    digest = hashlib.sha256(name.encode())
    digest.update(content)
    return _MAGIC + digest.digest()


def _remove(files: Iterable[tuple[Path, os.stat_result]]) -> tuple[int, int]:
    gone = []
    for path, state in files:
        with suppress(OSError):
            path.unlink()
            gone.append(state.st_size)
    return len(gone), sum(gone)


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
