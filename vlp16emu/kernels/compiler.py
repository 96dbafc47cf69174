"""Compilation of kernels: for a fixed processor, without what numba adds for functions that may be called from anywhere.

Modules with kernels take `numba` from here, as it is prepared before the first kernel is made.

A kernel that is compiled because another one calls it is code for that one only: it gets no entry from Python or from C,
no machine code of its own and no file. If Python calls it one day, it is compiled again, as a whole.

A table names the kernels that Python calls in runs of each group, hall and forest, and the types of their arguments, the
costliest first. It may lag behind the program: a kernel that it lacks is compiled when it is first called.
"""

import json
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numba
from llvmlite import binding
from numba import types
from numba.core import sigutils
from numba.core.caching import NullCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher
from numba.core.registry import CPUDispatcher

from vlp16emu.cores import usable_cores
from vlp16emu.kernels.cache import KernelCache, user_kernels

_TARGETS = {  # targets of the x86-64 psABI and what a processor needs for them, by LLVM's names, the fastest first
    "x86-64-v3": ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe"),
    "x86-64-v2": ("popcnt", "sse4.1", "sse4.2", "ssse3"),
}
_TABLE = Path(__file__).with_name("table.json")


class KernelDispatcher(CPUDispatcher):  # type: ignore[misc]
    """Dispatcher of a kernel."""

    depth = 0  # depth of kernels that are being compiled for the sake of others, each for the one before

    @classmethod
    def take_over(cls, dispatcher: CPUDispatcher) -> None:
        """Make a dispatcher of numba one of these, with a cache of ours."""
        dispatcher.__class__ = cls
        dispatcher.kept = KernelCache(dispatcher.py_func)
        dispatcher._compiler.pipeline_class = _KernelCompiler

    @property
    def _cache(self) -> Any:
        """Files, for kernels that Python calls: from others' they would come without code to be linked with."""
        return NullCache() if KernelDispatcher.depth else self.kept

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Compile for a kernel that calls this one, ours or a program's own."""
        with global_compiler_lock:
            KernelDispatcher.depth += 1
            try:
                return super().get_call_template(args, kws)
            finally:
                KernelDispatcher.depth -= 1

    def compile(self, sig: Any) -> Any:
        """Compile for types of arguments, unless that has been done: for Python, or in a way that other kernels can use."""
        with global_compiler_lock:
            args, _ = sigutils.normalize_signature(sig)
            done = self.overloads.get(tuple(args))
            if done and (done.library is None if KernelDispatcher.depth else isinstance(done.entry_point, _Inner)):
                del self.overloads[tuple(args)]
            return super().compile(sig)

    def add_overload(self, cres: Any) -> None:
        """Take a compiled kernel in; only one with an entry can be called from Python."""
        if cres.entry_point is not None:
            super().add_overload(cres)
            return
        inner = cres._replace(entry_point=_Inner())
        self.targetctx.insert_user_function(inner.entry_point, cres.fndesc, [cres.library])
        self.overloads[tuple(cres.signature.args)] = inner


class _Inner:
    """Name of a kernel without entry, for those that call it."""


class _KernelCompiler(Compiler):  # type: ignore[misc]
    """Numba's compiler, which makes for inner kernels what other kernels take of them and nothing else."""

    def __init__(self, *args: Any, **options: Any) -> None:
        if "numba.np.arraymath" not in sys.modules:
            # It would load scipy.linalg for 0.1 s only to see whether that is there; a kernel that takes it asks once more.
            from numba.np import linalg

            ensure_blas = linalg.ensure_blas
            linalg.ensure_blas = lambda: setattr(linalg, "ensure_blas", ensure_blas)
        super().__init__(*args, **options)

    def compile_extra(self, func: Any) -> Any:
        """Compile a function."""
        state = self.state
        state.flags.no_cfunc_wrapper = True
        if KernelDispatcher.depth:
            state.flags.no_cpython_wrapper = state.flags.no_compile = True
            state.library = _InnerLibrary(state.targetctx.codegen(), func.__qualname__)
        return super().compile_extra(func)


class _InnerLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Code that others are linked with; it has no place in the memory of machine code."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True


def _target() -> tuple[str, str]:
    """Name the processor to compile for, and what it has beyond its name.

    `VLP16EMU_TARGET` names another one, for tests; `host` is the one that this runs on.
    """
    chosen, has = os.environ.get("VLP16EMU_TARGET"), binding.get_host_cpu_features()
    if chosen == "host":
        return binding.get_host_cpu_name(), has.flatten()
    best = next((name for name, needs in _TARGETS.items() if all(map(has.get, needs))), "generic")
    return chosen or best, ""


def _prepare() -> None:
    """Set the target of all kernels, and take over those of this package."""
    # In the environment: numba reads it again whenever a variable of its own has changed.
    os.environ["NUMBA_CPU_NAME"], os.environ["NUMBA_CPU_FEATURES"] = _target()
    numba.config.reload_config()
    enable_caching = Dispatcher.enable_caching

    def enable_our_caching(dispatcher: CPUDispatcher) -> None:
        """Take over a kernel of this package; leave those of a program that calls us to numba."""
        if dispatcher.py_func.__module__.partition(".")[0] == "vlp16emu":
            KernelDispatcher.take_over(dispatcher)
        else:
            enable_caching(dispatcher)

    Dispatcher.enable_caching = enable_our_caching  # type: ignore[method-assign, assignment]


_prepare()

_ENDINGS = signal.SIGINT, signal.SIGTERM, signal.SIGHUP


def table(group: str | None = None) -> list[dict[str, Any]]:
    """Return the table, or the part of it that a group of runs needs."""
    rows: list[dict[str, Any]] = json.loads(_TABLE.read_text(encoding="utf-8"))
    return [row for row in rows if group is None or group in row["groups"]]


def compile_kernels(group: str | None = None) -> Iterator[tuple[int, int]]:
    """Compile what the table has for a group of runs, or for all, and is not on disk yet.

    Yields how many kernels are done, none at first, and how many there are; nothing if all are on disk.
    """
    missing = [row for row in table(group) if not _is_kept(row)]
    if not missing:
        return
    yield 0, len(missing)
    from multiprocessing import get_context  # here: most runs find all on disk

    # Children are forks, so that they need not load numba again; with other threads that would not be safe.
    if user_kernels().own is None or threading.active_count() > 1:
        return
    # Kernels of one file share most of what they call: a process compiles that once.
    files: dict[str, list[dict[str, Any]]] = {}
    for row in missing:
        files.setdefault(row["kernel"].partition(":")[0], []).append(row)
    # A child that a signal meets before `_leave_signals` would end as this process does.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDINGS)
    try:
        pool = get_context("fork").Pool(min(usable_cores(), len(files)), _leave_signals)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    with pool:
        done = 0
        for count in pool.imap_unordered(_compile, files.values()):
            done += count
            yield done, len(missing)


def decoded(text: Any) -> Any:
    """Read a type of numba from JSON; errors where the program has no such type any more."""
    if isinstance(text, str):
        return getattr(types, text)
    first, *rest = text
    if first == "array":
        dtype, ndim, layout, readonly = rest
        return types.Array(getattr(types, dtype), ndim, layout, readonly=readonly)
    if first == "tuple":
        return types.Tuple([*map(decoded, rest)])
    if first == "omitted":
        return types.Omitted(*rest)
    module, _, name = first.partition(":")
    return types.BaseTuple.from_types([*map(decoded, rest)], getattr(import_module(module), name))


def _signature(row: dict[str, Any]) -> tuple[Any, tuple[Any, ...]]:
    module, _, name = row["kernel"].partition(":")
    return getattr(import_module(f"vlp16emu.{module}"), name), tuple(map(decoded, row["types"]))


def _is_kept(row: dict[str, Any]) -> bool:
    with suppress(ImportError, AttributeError, TypeError, ValueError):
        kernel, arguments = _signature(row)
        return KernelCache(kernel.py_func).has(arguments)
    return True


def _compile(rows: list[dict[str, Any]]) -> int:
    """Compile the kernels of some rows, in a process of its own, and count them; what is wrong with one, the run will say."""
    for row in rows:
        kernel, arguments = _signature(row)
        try:
            kernel.compile(arguments)
        except Exception:  # noqa: BLE001 - numba raises all kinds
            KernelCache(kernel.py_func).give_up(arguments)
    return len(rows)


def _leave_signals() -> None:
    """Let the parent decide when a child ends, and report it: Ctrl-C in a terminal reaches all of them."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # once the parent is gone, a result has no taker
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDINGS)
