"""Compiled kernels, kept on disk by content.

A folder belongs to one state of all files that kernels are made of, of the libraries that compile them and of the
processor that they are compiled for, whatever the place and the time stamps of the files. Each compiled kernel is one
file: a SHA-256, then what numba needs to load it.
"""

import hashlib
import os
import pickle
import stat
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

_PACKAGE = Path(__file__).parent
_PREFIX = "kernels-"
_MARKER = "made-by-vlp16emu"
"""Empty file in each folder of ours: others may keep something under such a name."""
_SUFFIX = ".kernel"
_STATES_KEPT = 8
"""Folders of other states are removed where there are more, those that were not used for longest first."""
_WITHOUT_KERNELS = frozenset(
    [
        "__init__",
        "__main__",
        "__pycache__",
        "accuracy",
        "bag",
        "engine",
        "cli",
        "compare",
        "compiled",
        "compiling",
        "control",
        "dataset",
        "deskew",
        "device",
        "emulator",
        "flight",
        "gps_time",
        "images",
        "kernel_cache",
        "kernels",
        "labels",
        "output",
        "points",
        "recording",
        "replay",
        "report",
        "run",
        "scan",
        "scenario",
        "score",
        "sinks",
        "streaming",
        "streams",
        "truth",
        "validator",
        "viewer",
    ]
)
"""Folders and modules of no kernel, and of nothing that a kernel takes."""


class KernelCache:
    """Cache of one kernel, with the methods that a dispatcher of numba calls."""

    def __init__(self, function: Callable[..., object]) -> None:
        code = function.__code__
        self._name = f"{function.__module__.partition('.')[2]}.{code.co_qualname}-{code.co_firstlineno}"
        self._is_kept = function.__closure__ is None  # what it encloses is no part of the name

    @property
    def cache_path(self) -> str:
        """Folder that the folders of all states are in."""
        return str(_base())

    def has(self, signature: object) -> bool:
        """Whether the file of a kernel is there, whole or not."""
        return any(path.exists() for path in self._paths(signature))

    def give_up(self, signature: object) -> None:
        """Put an empty file in the place of a kernel that cannot be compiled, so that it is not tried at each start."""
        folder = _written_to()
        if folder is not None:
            with suppress(OSError):
                (folder / self._file(signature)).touch()

    def load_overload(self, signature: object, context: Any) -> object:
        """Load a kernel; None where there is none that is whole."""
        from numba.core.compiler import CompileResult

        context.refresh()
        for path in self._paths(signature) if self._is_kept else ():
            data = _read_checked(path)
            kept, parts = pickle.loads(data) if data else (None, ())  # noqa: S301 - from a safe folder
            if kept == _types(signature):
                return CompileResult._rebuild(context, *parts)
        return None

    def save_overload(self, signature: object, result: Any) -> None:
        """Keep a kernel, unless only other kernels can call it or it holds addresses of this process."""
        from numba.core.serialize import dumps

        folder = _written_to() if result.entry_point is not None and self._is_kept else None
        if folder is not None and not result.library.has_dynamic_globals:
            data = dumps((_types(signature), result._reduce()))
            with suppress(OSError):  # a full disk, or a folder of root's
                _write_checked(folder / self._file(signature), data)

    def _paths(self, signature: object) -> Iterator[Path]:
        """Files that may hold a kernel; the user's folder is made only if the package has none."""
        for find_folder in (_packaged, _written_to):
            if (folder := find_folder()) is not None:
                yield folder / self._file(signature)

    def _file(self, signature: object) -> str:
        return f"{self._name}-{hashlib.sha256(str(_types(signature)).encode()).hexdigest()[:20]}{_SUFFIX}"


def _types(signature: Any) -> Any:
    return getattr(signature, "args", signature)


def kernel_folder() -> Path | None:
    """Return the folder of this state of the kernels, made if need be; None where none is safe.

    It is in `NUMBA_CACHE_DIR`, or else in the user's cache. What was compiled is code that is run unread: nobody but the
    user, or root, may write in the folder or put another one in its place.
    """
    base = _base()
    folder = base / (_PREFIX + _state())
    try:
        base.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        above = base.parent.stat().st_mode
        if _others_write(above) and not above & stat.S_ISVTX:
            return None
        for level in (base, folder):
            with suppress(OSError):  # it is there, or cannot be made
                level.mkdir(mode=0o700)
            state = level.lstat()
            if not stat.S_ISDIR(state.st_mode) or _others_write(state.st_mode):
                return None
            if state.st_uid not in (0, os.getuid()):
                return None
        with suppress(OSError):  # a folder of root's serves as it is
            (folder / _MARKER).touch()
            os.utime(folder)
            _remove_unused(base)
    except OSError:
        return None
    return folder


def kernel_names() -> list[str]:
    """List the compiled kernels of this state, as `room.module.kernel`, each once for each of its types."""
    folders = [folder for folder in (_packaged(), kernel_folder()) if folder is not None]
    return [path.name.partition("-")[0] for folder in folders for path in folder.glob("*" + _SUFFIX)]


def compiled_files() -> dict[Path, list[Path]]:
    """List the compiled kernels on disk, of any state, by folder."""
    return {folder: list(_files_in(folder)) for folder in _folders_in(_base())}


def remove_compiled(folder: Path) -> None:
    """Remove the compiled kernels in a folder of ours, and the folder if nothing else is in it."""
    for path in [*_files_in(folder)]:
        with suppress(OSError):
            path.unlink()
    if [path.name for path in folder.iterdir()] == [_MARKER]:
        (folder / _MARKER).unlink()
        folder.rmdir()


@cache
def _written_to() -> Path | None:
    return kernel_folder()


@cache
def _packaged() -> Path:
    return _PACKAGE / "_kernels" / (_PREFIX + _state())


def _read_checked(path: Path) -> bytes | None:
    """Read a file of ours; None where it is not there or is not what was written."""
    try:
        data = path.read_bytes()
    except OSError:
        return None
    return data[32:] if data[:32] == _digest(path, data[32:]) else None


def _write_checked(path: Path, data: bytes) -> None:
    """Write a file of ours aside, and give it its name: others may read it at any time."""
    aside = path.with_name(f"{path.name}.{os.getpid()}.part")
    aside.write_bytes(_digest(path, data) + data)
    aside.replace(path)


def _digest(path: Path, data: bytes) -> bytes:
    return hashlib.sha256(path.name.encode() + data).digest()


@cache
def _state() -> str:
    """Name the state of all that decides what is compiled, as it is when this is first asked."""
    import llvmlite
    import numba
    import numpy as np
    from numba.core.registry import cpu_target

    versions = numba.__version__, llvmlite.__version__, np.__version__, sys.implementation.cache_tag
    target = cpu_target.target_context.codegen().magic_tuple()
    options = [getattr(numba.config, name) for name in ("OPT", "LOOP_VECTORIZE", "SLP_VECTORIZE")]
    digest = hashlib.sha256(f"{versions} {target} {options}".encode())
    for name, path in sorted(_sources()):
        digest.update(f"\n{name} ".encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:16]


def _sources() -> Iterator[tuple[str, Path]]:
    """Files that kernels are made of: the name in the package, and the path."""
    for top in _PACKAGE.iterdir():
        if top.stem not in _WITHOUT_KERNELS:
            for path in top.rglob("*.py") if top.is_dir() else [top]:
                if path.suffix == ".py":
                    yield path.relative_to(_PACKAGE).as_posix(), path


def _base() -> Path:
    from platformdirs import user_cache_path

    chosen = os.environ.get("NUMBA_CACHE_DIR")
    return Path(chosen).absolute() if chosen else user_cache_path("vlp16emu", appauthor=False)


def _others_write(mode: int) -> bool:
    return bool(mode & (stat.S_IWGRP | stat.S_IWOTH))


def _folders_in(base: Path) -> list[Path]:
    """Folders of ours below a base, known by their names and by what marks them."""
    return [
        folder
        for folder in base.glob(_PREFIX + "*")
        if (folder / _MARKER).is_file() and not folder.is_symlink() and folder.stat().st_uid == os.getuid()
    ]


def _files_in(folder: Path) -> Iterator[Path]:
    for path in folder.iterdir():
        if path.suffix in (_SUFFIX, ".part") and path.is_file() and not path.is_symlink():
            yield path


def _remove_unused(base: Path) -> None:
    folders = sorted(_folders_in(base), key=lambda folder: folder.stat().st_mtime, reverse=True)
    for folder in folders[_STATES_KEPT:]:
        remove_compiled(folder)
