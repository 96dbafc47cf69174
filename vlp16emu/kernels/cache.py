"""Compiled kernels, kept on disk by content.

A file's name is a digest of the sources of a kernel, regardless of their path and time stamps: its module,
the modules of its argument types, which order their fields, and all their imports; also of the compiling
libraries, the target processor, the kernel and its types.
"""

import hashlib
import logging
import os
import pickle
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from vlp16emu.store import PACKAGE, Store, content_of, user_folder

NumbaObject = Any
"""An object of numba or llvmlite, which ship no types.

It is a kernel, the type of an argument, or a value in LLVM's code.
"""
_log = logging.getLogger(__name__)  # at DEBUG it names each kernel that a process loads or compiles
_IMPORT = re.compile(r"^ *from vlp16emu([.\w]*) import (\([^)]*\)|.*)$", re.MULTILINE)
_SUFFIX = ".kernel"
_LAYOUT = 3  # version of the file format
_MOST_BYTES = 200_000_000
_PACKAGED = PACKAGE / "_kernels"  # kernels that a wheel carries


class KernelCache:
    """Cache of one kernel, with the interface of numba's dispatcher.

    Parameters
    ----------
    function : Python function that is compiled
    packaged : folder of kernels that are read, and never written or replaced
    """

    def __init__(self, function: Callable[..., object], packaged: Path = _PACKAGED) -> None:
        code = function.__code__
        self._packaged = packaged
        self._module = function.__module__
        self._title = f"{self._module.partition('.')[2]}.{code.co_qualname}"
        self._name = f"{self._title}-{code.co_firstlineno}"
        self._is_kept = function.__closure__ is None  # the variables of a closure are not part of the name

    @property
    def cache_path(self) -> str:
        """Folder of the user's compiled kernels."""
        return str(user_kernels().folder)

    def has(self, signature: object) -> bool:
        """Return whether the file of a kernel exists, complete or not."""
        name = self._file(signature)
        return (self._packaged / name).exists() or user_kernels().has(name)

    def load_overload(self, signature: object, context: NumbaObject) -> object:
        """Load a kernel; None without a complete file."""
        if not self._is_kept:
            return None
        name = self._file(signature)
        content = _read_packaged(self._packaged / name) or user_kernels().read(name)
        if not content:
            return None
        from vlp16emu.kernels.numba_private import load_kernel

        _log.debug("loads kernel %s", self._title)
        return load_kernel(context, *pickle.loads(content))  # noqa: S301 - from a safe folder

    def save_overload(self, signature: object, result: NumbaObject) -> None:
        """Store a kernel, unless it contains addresses of this process."""
        from vlp16emu.kernels.numba_private import kernel_bytes

        _log.debug("compiled kernel %s", self._title)
        if self._is_kept and not result.library.has_dynamic_globals:
            user_kernels().write(self._file(signature), kernel_bytes(result))

    def give_up(self, signature: object) -> None:
        """Store an empty file for a kernel that cannot be compiled, so that it is not tried at each start."""
        user_kernels().write(self._file(signature), b"")

    def _file(self, signature: object) -> str:
        args = getattr(signature, "args", signature)
        types_digest = hashlib.sha256(str(args).encode()).hexdigest()[:20]
        sources = source_digest(frozenset({self._module, *modules_of(args)}))
        return f"{_state()}-{self._name}-{types_digest}-{sources}{_SUFFIX}"


def _read_packaged(path: Path) -> memoryview | None:
    """Return a kernel that the package carries; None if it is missing or damaged."""
    return content_of(memoryview(path.read_bytes()), path.name) if path.is_file() else None


@cache
def user_kernels() -> Store:
    """Return the store of the user's compiled kernels: in `NUMBA_CACHE_DIR`, or else in the user's cache."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(chosen).absolute() / "vlp16emu-kernels" if chosen else user_folder("kernels")
    return Store(folder, _SUFFIX, _MOST_BYTES)


def kernel_names() -> list[str]:
    """List the compiled kernels for this processor and these libraries, once per signature.

    Names are `room.module.kernel`.
    """
    files = [*user_kernels().names(), *(path.name for path in _PACKAGED.glob(f"*{_SUFFIX}"))]
    ours = {name for name in files if name.startswith(f"{_state()}-") and name.endswith(_SUFFIX)}
    return [name.split("-")[1] for name in {name.rpartition("-")[0] for name in ours}]


@cache
def source_digest(modules: frozenset[str], package: Path = PACKAGE) -> str:
    """Return the digest of the sources of modules, regardless of their folder and time stamps.

    A file of the package is read once in a process.
    """
    sources = [(file, _digest_and_imports(package / file)[0]) for file in sources_of(modules, package)]
    return hashlib.sha256(repr(sources).encode()).hexdigest()[:16]


def sources_of(modules: frozenset[str], package: Path = PACKAGE) -> list[str]:
    """Return the package's files for modules: their own and all their imports, except this room."""
    left = set(modules)
    found = set[str]()
    while left:
        for file in _files_of(left.pop(), package):
            if file not in found:
                found.add(file)
                left.update(_digest_and_imports(package / file)[1])
    return sorted(found)


@cache
def _files_of(module: str, package: Path) -> list[str]:
    place = module.partition(".")[2].replace(".", "/")
    files = [] if not place or place.startswith("kernels") else [f"{place}.py", f"{place}/__init__.py"]
    return [file for file in files if (package / file).is_file()]


def modules_of(kind: NumbaObject) -> Iterator[str]:
    """Yield the modules of the named tuples among the types of arguments."""
    if owner := getattr(kind, "instance_class", None):
        yield owner.__module__
    for inner in kind if isinstance(kind, tuple) else getattr(kind, "types", ()):
        yield from modules_of(inner)


@cache
def _digest_and_imports(path: Path) -> tuple[str, list[str]]:
    """Return the digest of a source file and the tables beside it, and the modules that it may import."""
    text = path.read_text(encoding="utf-8")
    imports = list[str]()
    for place, names in _IMPORT.findall(text):
        imports += [f"vlp16emu{place}", *(f"vlp16emu{place}.{name}" for name in re.findall(r"\w+", names))]
    tables = [(table.name, table.read_text(encoding="utf-8")) for table in sorted(path.parent.glob("*.toml"))]
    return hashlib.sha256(repr((text, tables)).encode()).hexdigest(), imports


@cache
def _state() -> str:
    """Return the digest of the present processor, libraries and options, as of the first call."""
    return state_digest(library_versions())


def library_versions() -> dict[str, str]:
    """Return the versions of what decides the code of a kernel: Python and the compiling libraries."""
    import llvmlite
    import numba
    import numpy as np

    libraries = {library.__name__: library.__version__ for library in (numba, llvmlite, np)}
    return {"python": str(sys.implementation.cache_tag), **libraries}


def state_digest(versions: Mapping[str, str]) -> str:
    """Return a digest of the processor, versions of libraries by name, and options for compilation."""
    import numba
    from numba.core.registry import cpu_target

    target = cpu_target.target_context.codegen().magic_tuple()
    options = [getattr(numba.config, name) for name in ("OPT", "LOOP_VECTORIZE", "SLP_VECTORIZE")]
    return hashlib.sha256(repr((_LAYOUT, sorted(versions.items()), target, options)).encode()).hexdigest()[
        :16
    ]
