"""What is costly to make of a world, kept on disk from run to run.

A file holds a bundle of arrays under a name, which says all that decides them; the files of the package that make them
are part of every name. Files are plain numbers behind a JSON header, so reading one runs no code. They are written
aside and then renamed, so that programs may share a folder, and one that is damaged is as good as none.
"""

import ast
import hashlib
import json
import math
import os
import re
import stat
import sys
import time
import zlib
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache, lru_cache
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
import scipy
from numpy.typing import NDArray

T = TypeVar("T")

Bundle = Mapping[str, NDArray[np.generic]]
"""Arrays by name."""

_PACKAGE = Path(__file__).parent
_MAKERS = (
    "chain",
    "motion",
    "raycast",
    "world",
    "elementary.py",
    "random.py",
    "store.py",
    "tiles.py",
    "trig.py",
    "types.py",
)
"""Files and folders of the package that decide what is kept."""
_MAGIC = b"vlp16emu store 1"
_NAME = re.compile(r"[0-9a-f]{40}\.world(\.\d+\.part)?")
_ALIGN = 64
_MB = 1_000_000
_DEFAULT_MB = 1_000.0
_TOUCH_S = 60.0
"""The time of last use is this exact."""


class Kept(NamedTuple):
    """What a store holds."""

    files: int
    bytes: int


class Store:
    """Bundles in a folder of the user's own; without a folder nothing is kept.

    Parameters
    ----------
    folder : made when it is first needed
    most_bytes : what was not used for longest goes where there is more
    """

    def __init__(self, folder: Path | None, most_bytes: int) -> None:
        self.folder, self.most_bytes = folder, most_bytes
        self._unlooked = math.inf
        self._writer: ThreadPoolExecutor | None = None

    def get(self, name: str) -> dict[str, NDArray[np.generic]] | None:
        """Read a bundle, as arrays of the caller's own; None where there is none, or none that is whole."""
        if self.folder is None:
            return None
        path = self._path(name)
        try:
            with open(path, "rb", 0, opener=_no_link) as file:
                state = os.fstat(file.fileno())
                data = np.empty(state.st_size, np.uint8)
                if state.st_uid != os.getuid() or file.readinto(data.data) != len(data):
                    return None
            if time.time() - state.st_mtime > _TOUCH_S:
                os.utime(path)
        except OSError:
            return None
        with suppress(ValueError, KeyError, TypeError, SyntaxError):
            return _unpacked(data, name)
        return None

    def put(self, name: str, bundle: Bundle) -> None:
        """Write a bundle, soon: on a thread of its own, so nobody may change the arrays any more."""
        if self.folder is None:
            return
        if self._writer is None:
            self._writer = ThreadPoolExecutor(1, "keep")
        with suppress(RuntimeError):  # the program ends
            self._writer.submit(self._write, name, bundle)

    def flush(self) -> None:
        """Wait until all is written."""
        if self._writer is not None:
            self._writer.submit(int).result()

    def kept(self) -> Kept:
        """Count files and bytes."""
        sizes = [state.st_size for _, state in self._files()]
        return Kept(len(sizes), sum(sizes))

    def clear(self) -> Kept:
        """Remove all files, which are known by name and first bytes; say how many went."""
        gone = []
        for path, state in self._files():
            with suppress(OSError):
                path.unlink()
                gone.append(state.st_size)
        return Kept(len(gone), sum(gone))

    def _path(self, name: str) -> Path:
        assert self.folder is not None
        return self.folder / (hashlib.sha256(f"{_state()}\n{name}".encode()).hexdigest()[:40] + ".world")

    def _write(self, name: str, bundle: Bundle) -> None:
        """Write a bundle aside, and give it its name; where that cannot be done, nothing is kept any more."""
        if self.folder is None:
            return
        path = self._path(name)
        aside = path.with_name(f"{path.name}.{os.getpid()}.part")
        try:
            _make_own(self.folder)
            with open(aside, "wb", opener=_no_link) as file:
                size = sum(file.write(part) for part in _packed(name, bundle))
            aside.replace(path)
            self._unlooked += size
            if self._unlooked > self.most_bytes / 16:
                self._unlooked = 0
                self._make_room()
        except OSError:
            self.folder = None
            with suppress(OSError):
                aside.unlink()

    def _make_room(self) -> None:
        """Remove what was not used for longest, until there is room again."""
        files = sorted(self._files(), key=lambda file: file[1].st_mtime, reverse=True)
        total = 0
        for path, state in files:
            total += state.st_size
            if total > self.most_bytes:
                with suppress(OSError):
                    path.unlink()

    def _files(self) -> list[tuple[Path, os.stat_result]]:
        found = []
        with suppress(OSError):
            for path in self.folder.iterdir() if self.folder is not None else ():
                with suppress(OSError):
                    state = path.lstat()
                    if stat.S_ISREG(state.st_mode) and _NAME.fullmatch(path.name) and _is_ours(path):
                        found.append((path, state))
        return found


@cache
def user_store() -> Store:
    """Store of the user: in `VLP16EMU_CACHE_DIR`, of `VLP16EMU_CACHE_MB`, or else in the user's cache, of 1 GB."""
    try:
        most_mb = float(os.environ.get("VLP16EMU_CACHE_MB", ""))
    except ValueError:
        most_mb = _DEFAULT_MB
    folder: Path | None = None
    if (chosen := os.environ.get("VLP16EMU_CACHE_DIR")) is not None:
        folder = None if chosen in ("", "off") else Path(chosen)
    elif caches := os.environ.get("XDG_CACHE_HOME"):
        folder = Path(caches) / "vlp16emu" / "world"
    elif home := os.environ.get("HOME"):
        folder = Path(home) / ".cache" / "vlp16emu" / "world"
    return Store(folder if most_mb > 0 else None, int(max(most_mb, 0.0) * _MB))


def recalled(
    name: str, make: Callable[[], T], pack: Callable[[T], Bundle], unpack: Callable[[Bundle], T]
) -> T:
    """Take a thing from the user's store, or make it and keep it there.

    Parameters
    ----------
    name : of all that decides it; empty where it is not kept
    make : makes it
    pack, unpack : put it into arrays, and take it out of them
    """
    if not name:
        return make()
    store = user_store()
    if (bundle := store.get(name)) is not None:
        return unpack(bundle)
    thing = make()
    store.put(name, pack(thing))
    return thing


@cache
def _state() -> str:
    """Name the state of the files that decide what is kept, of libraries that draw and round, and of the machine."""
    state = np.__version__, scipy.__version__, os.uname().machine, sys.byteorder
    digest = hashlib.sha256(f"{' '.join(state)}\n".encode())
    for maker in _MAKERS:
        path = _PACKAGE / maker
        for file in [path] if path.is_file() else sorted(path.rglob("*")):
            if file.suffix in (".py", ".toml"):
                digest.update(f"{file.relative_to(_PACKAGE)}\n".encode() + file.read_bytes())
    return digest.hexdigest()


def _packed(name: str, bundle: Bundle) -> list[bytes | memoryview]:
    """Put a bundle into the parts of a file: marker, length of the header, header, arrays."""
    parts, rows, check, at = list[bytes | memoryview](), [], 0, 0
    for key, array in bundle.items():
        # A view of the bytes; arrays without elements have none.
        raw = np.ascontiguousarray(array).reshape(-1).view(np.uint8).data if array.size else b""
        room = -len(raw) % _ALIGN
        kind = repr(np.lib.format.dtype_to_descr(array.dtype))
        rows.append([key, kind, array.shape, at, len(raw)])
        for part in (raw, bytes(room)):
            check = zlib.crc32(part, check)
            parts.append(part)
        at += len(raw) + room
    header = json.dumps({"name": name, "arrays": rows, "bytes": at, "check": check}).encode()
    header += b" " * (-(len(header) + len(_MAGIC) + 16) % _ALIGN)
    return [_MAGIC, b"%8d%8x" % (len(header), zlib.crc32(header)), header, *parts]


def _unpacked(data: NDArray[np.uint8], name: str) -> dict[str, NDArray[np.generic]] | None:
    """Take a bundle out of a file; None where it is not whole, or that of another name."""
    first = len(_MAGIC) + 16
    if data[: len(_MAGIC)].tobytes() != _MAGIC:
        return None
    numbers = data[len(_MAGIC) : first].tobytes()
    begin = first + int(numbers[:8])
    text = data[first:begin].tobytes()
    if zlib.crc32(text) != int(numbers[8:], 16):
        return None
    header, body = json.loads(text), data[begin:]
    if header["name"] != name or header["bytes"] != len(body) or header["check"] != zlib.crc32(body.data):
        return None
    return {
        key: body[at : at + size].view(_dtype(kind)).reshape(shape)
        for key, kind, shape, at, size in header["arrays"]
    }


@lru_cache
def _dtype(text: str) -> np.dtype[np.generic]:
    kind: np.dtype[np.generic] = np.lib.format.descr_to_dtype(ast.literal_eval(text))
    if kind.hasobject:
        raise ValueError(text)
    return kind


def _make_own(folder: Path) -> None:
    """Make a folder that is the user's alone.

    Raises
    ------
    OSError
        where it is a link, somebody else's, or open for others to write
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    state = folder.lstat()
    if not stat.S_ISDIR(state.st_mode) or state.st_uid != os.getuid() or state.st_mode & 0o022:
        raise PermissionError(str(folder))


def _no_link(path: str, flags: int) -> int:
    """Open a file unless it is a link; a new one is the user's alone."""
    return os.open(path, flags | os.O_NOFOLLOW, 0o600)


def _is_ours(path: Path) -> bool:
    with open(path, "rb", opener=_no_link) as file:
        return _MAGIC.startswith(file.read(len(_MAGIC)))
