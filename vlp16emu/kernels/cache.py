"""Compiled kernels, kept on disk by content.

The name of a file says the state of all files that kernels are made of, of the libraries that compile them and of the
processor that they are compiled for, whatever the place and the time stamps of the files; and kernel and types.
"""

import hashlib
import os
import pickle
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from vlp16emu.store import PACKAGE, Store, digest_of, read_checked

SOURCES = (  # files and folders of kernels, and of what kernels take
    "elementary.py",
    "extras/clouds/place.py",
    "extras/imu",
    "extras/live",
    "extras/recorded",
    "foliage",
    "forest",
    "motion",
    "random.py",
    "raycast",
    "returns",
    "sensor",
    "settings.py",
    "trig.py",
    "types.py",
    "units.py",
    "world",
)
_SUFFIX = ".kernel"
_MOST_BYTES = 100_000_000
_PACKAGED = PACKAGE / "_kernels"  # kernels that a wheel carries


class KernelCache:
    """Cache of one kernel, with the methods that a dispatcher of numba calls."""

    def __init__(self, function: Callable[..., object]) -> None:
        code = function.__code__
        self._name = f"{function.__module__.partition('.')[2]}.{code.co_qualname}-{code.co_firstlineno}"
        self._is_kept = function.__closure__ is None  # what it encloses is no part of the name

    @property
    def cache_path(self) -> str:
        """Folder of the user's compiled kernels."""
        return str(user_kernels().folder)

    def has(self, signature: object) -> bool:
        """Return whether the file of a kernel is there, whole or not."""
        folders = _PACKAGED, user_kernels().own
        return any(folder and (folder / self._file(signature)).exists() for folder in folders)

    def load_overload(self, signature: object, context: Any) -> object:
        """Load a kernel; None if there is none that is whole."""
        from numba.core.compiler import CompileResult

        context.refresh()
        if not self._is_kept:
            return None
        name = self._file(signature)
        content = read_checked(_PACKAGED / name) or user_kernels().read(name)
        return CompileResult._rebuild(context, *pickle.loads(content)) if content else None  # noqa: S301 - from a safe folder

    def save_overload(self, signature: object, result: Any) -> None:
        """Keep a kernel, unless only other kernels can call it or it holds addresses of this process."""
        from numba.core.serialize import dumps

        if self._is_kept and result.entry_point is not None and not result.library.has_dynamic_globals:
            user_kernels().write(self._file(signature), dumps(result._reduce()))

    def give_up(self, signature: object) -> None:
        """Keep nothing in the place of a kernel that cannot be compiled, so that it is not tried at each start."""
        user_kernels().write(self._file(signature), b"")

    def _file(self, signature: object) -> str:
        types = str(getattr(signature, "args", signature))
        return f"{_state()}-{self._name}-{hashlib.sha256(types.encode()).hexdigest()[:20]}{_SUFFIX}"


@cache
def user_kernels() -> Store:
    """Folder of the user's compiled kernels: in `NUMBA_CACHE_DIR`, or else in the user's cache."""
    from platformdirs import user_cache_path

    chosen = os.environ.get("NUMBA_CACHE_DIR")
    ours = user_cache_path("vlp16emu", appauthor=False)
    folder = Path(chosen).absolute() / "vlp16emu-kernels" if chosen else ours / "kernels"
    return Store(folder, _SUFFIX, _MOST_BYTES)


def kernel_names() -> list[str]:
    """List the compiled kernels of this state, as `room.module.kernel`, each once for each of its types."""
    folders = [folder for folder in (_PACKAGED, user_kernels().own) if folder]
    paths = [path for folder in folders for path in folder.glob(f"{_state()}-*{_SUFFIX}")]
    return [path.name.split("-")[1] for path in paths]


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
    return digest_of(SOURCES, versions, target, options)[:16]
