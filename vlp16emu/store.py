"""Costly parts of a world, kept on disk from run to run.

A file holds a bundle of arrays under a name, which says all that decides them; the files of the package that make them
are part of every name. Files are plain numbers behind a JSON header: no copy is made, and reading one runs no code.
"""

import hashlib
import json
import os
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from platformdirs import user_cache_path

from vlp16emu.checked import CheckedFolder, digest_of

T = TypeVar("T")

Bundle = Mapping[str, NDArray[np.generic]]
"""Arrays by name."""

MAKERS = (
    "checked.py",
    "elementary.py",
    "engine",
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
"""Files and folders of the package that decide what is kept."""
_MB = 1_000_000
_DEFAULT_MB = 1_000.0
_ALIGN = 64
"""Arrays begin at cache lines."""


class Store(CheckedFolder):
    """Bundles in a folder of the user's own; without a folder nothing is kept."""

    def __init__(self, folder: Path | None, most_bytes: int) -> None:
        super().__init__(folder, ".world", most_bytes)
        self._writer: ThreadPoolExecutor | None = None

    def get(self, name: str) -> dict[str, NDArray[np.generic]] | None:
        """Read a bundle, as arrays of the caller's own; None if there is none that is whole."""
        content = self.read(_file(name)) if self.folder else None
        return None if content is None else _unpacked(content)

    def put(self, name: str, bundle: Bundle) -> None:
        """Write a bundle, soon: on a thread of its own, so nobody may change the arrays any more."""
        if self.folder is None:
            return
        if self._writer is None:
            self._writer = ThreadPoolExecutor(1, "keep")
        with suppress(RuntimeError):  # the program ends
            self._writer.submit(lambda: self.write(_file(name), *_packed(bundle)))

    def flush(self) -> None:
        """Wait until all is written."""
        if self._writer is not None:
            self._writer.submit(int).result()


@cache
def user_store() -> Store:
    """Store of the user: in `VLP16EMU_CACHE_DIR`, of `VLP16EMU_CACHE_MB`, or else in the user's cache, of 1 GB."""
    try:
        most_mb = float(os.environ.get("VLP16EMU_CACHE_MB", ""))
    except ValueError:
        most_mb = _DEFAULT_MB
    chosen = os.environ.get("VLP16EMU_CACHE_DIR")
    if chosen in ("", "off") or most_mb <= 0:
        return Store(None, int(max(most_mb, 0.0) * _MB))
    return Store(Path(chosen) if chosen else user_cache_path("vlp16emu", appauthor=False) / "world", int(most_mb * _MB))


def recalled(name: str, make: Callable[[], T], pack: Callable[[T], Bundle], unpack: Callable[[Bundle], T]) -> T:
    """Take a thing from the user's store, or make it and keep it there.

    Parameters
    ----------
    name : states all that decides it; empty if it is not kept
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


def _file(name: str) -> str:
    return hashlib.sha256(f"{_state()}\n{name}".encode()).hexdigest()[:40] + ".world"


@cache
def _state() -> str:
    """Name the state of the files that decide what is kept, of libraries that draw and round, and of the machine."""
    return digest_of(MAKERS, np.__version__, version("scipy"), os.uname().machine, sys.byteorder)


# Not np.savez: its reader parses Python on several threads at once, which CPython before 3.11.5 cannot (gh-106905).
def _packed(bundle: Bundle) -> list[bytes | memoryview]:
    parts, rows = list[bytes | memoryview](), []
    for key, array in bundle.items():
        # A view of the bytes; arrays without elements have none.
        raw = np.ascontiguousarray(array).reshape(-1).view(np.uint8).data if array.size else b""
        rows.append([key, np.lib.format.dtype_to_descr(array.dtype), array.shape, len(raw)])
        parts += [raw, bytes(-len(raw) % _ALIGN)]
    header = json.dumps(rows).encode()
    header += b" " * (-(len(header) + 8) % _ALIGN)
    return [len(header).to_bytes(8), header, *parts]


def _unpacked(content: memoryview) -> dict[str, NDArray[np.generic]]:
    at = 8 + int.from_bytes(content[:8])
    bundle = {}
    for key, kind, shape, size in json.loads(bytes(content[8:at])):
        bundle[key] = np.frombuffer(content[at : at + size], _dtype(kind)).reshape(shape)
        at += size + -size % _ALIGN
    return bundle


def _dtype(description: Any) -> np.dtype[np.generic]:
    """Return a type of numbers; no file of ours asks for objects, which would run code."""
    if isinstance(description, list):  # fields, whose tuples JSON has as lists
        description = [(name, _dtype(kind), *map(tuple, shape)) for name, kind, *shape in description]
    kind: np.dtype[np.generic] = np.dtype(description)
    if kind.hasobject:
        raise ValueError(description)
    return kind
