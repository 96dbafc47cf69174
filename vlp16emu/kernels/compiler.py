"""Compilation of kernels: for a fixed processor, without numba's extras for functions that may be called from anywhere.

Modules with kernels import `numba` from here, as it is configured before the first kernel is made.

A kernel that is compiled because another one calls it is code for that one only: it gets no entry from Python or C,
no machine code of its own and no file. If Python calls it later, it is compiled again in full.

A table lists the kernels that Python calls in runs of each group, hall and forest, with their argument types, the
costliest first. It may be outdated: a kernel that it lacks is compiled when it is first called.
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

_TARGETS = {  # targets of the x86-64 psABI and the features they require, in LLVM's names, the fastest first
    "x86-64-v3": ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe"),
    "x86-64-v2": ("popcnt", "sse4.1", "sse4.2", "ssse3"),
}
_TABLE = Path(__file__).with_name("table.json")


class KernelDispatcher(CPUDispatcher):  # type: ignore[misc]
    """Dispatcher of a kernel."""

    depth = 0  # nesting depth of kernels that are compiled for a calling kernel

    @classmethod
    def take_over(cls, dispatcher: CPUDispatcher) -> None:
        """Convert numba's dispatcher into this class, with our cache."""
        dispatcher.__class__ = cls
        dispatcher.kept = KernelCache(dispatcher.py_func)
        dispatcher._compiler.pipeline_class = _KernelCompiler

    @property
    def _cache(self) -> Any:
        """Cache for kernels that Python calls; for inner kernels None, as files lack code for linking."""
        return NullCache() if KernelDispatcher.depth else self.kept

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Compile for a kernel that calls this one, ours or a user program's."""
        with global_compiler_lock:
            KernelDispatcher.depth += 1
            try:
                return super().get_call_template(args, kws)
            finally:
                KernelDispatcher.depth -= 1

    def compile(self, sig: Any) -> Any:
        """Compile for argument types unless already done: for Python, or as an inner kernel."""
        with global_compiler_lock:
            args, _ = sigutils.normalize_signature(sig)
            done = self.overloads.get(tuple(args))
            if done and (done.library is None if KernelDispatcher.depth else isinstance(done.entry_point, _Inner)):
                del self.overloads[tuple(args)]
            return super().compile(sig)

    def add_overload(self, cres: Any) -> None:
        """Add a compiled kernel; only one with an entry can be called from Python."""
        if cres.entry_point is not None:
            super().add_overload(cres)
            return
        inner = cres._replace(entry_point=_Inner())
        self.targetctx.insert_user_function(inner.entry_point, cres.fndesc, [cres.library])
        self.overloads[tuple(cres.signature.args)] = inner


class _Inner:
    """Name of a kernel without entry, for its callers."""


class _KernelCompiler(Compiler):  # type: ignore[misc]
    """Numba's compiler, limited for inner kernels to the parts that calling kernels use."""

    def __init__(self, *args: Any, **options: Any) -> None:
        if "numba.np.arraymath" not in sys.modules:
            # It would load scipy.linalg (0.1 s) only to check that it exists; a kernel that uses it checks again.
            from numba.np import linalg

            ensure_blas = linalg.ensure_blas
            linalg.ensure_blas = lambda: setattr(linalg, "ensure_blas", ensure_blas)
        super().__init__(*args, **options)

    def compile_extra(self, func: Any) -> Any:
        state = self.state
        state.flags.no_cfunc_wrapper = True
        if KernelDispatcher.depth:
            state.flags.no_cpython_wrapper = state.flags.no_compile = True
            state.library = _InnerLibrary(state.targetctx.codegen(), func.__qualname__)
        return super().compile_extra(func)


class _InnerLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Code that is linked into callers; it has no machine code of its own in memory."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True


def _target() -> tuple[str, str]:
    """Return the target processor and its extra features.

    `VLP16EMU_TARGET` selects another one, for tests; `host` is the present processor.
    """
    chosen, has = os.environ.get("VLP16EMU_TARGET"), binding.get_host_cpu_features()
    if chosen == "host":
        return binding.get_host_cpu_name(), has.flatten()
    best = next((name for name, needs in _TARGETS.items() if all(map(has.get, needs))), "generic")
    return chosen or best, ""


def _prepare() -> None:
    """Set the target of all kernels, and take over this package's kernels."""
    # In the environment: numba reads it again when one of its variables changes.
    os.environ["NUMBA_CPU_NAME"], os.environ["NUMBA_CPU_FEATURES"] = _target()
    numba.config.reload_config()
    enable_caching = Dispatcher.enable_caching

    def enable_our_caching(dispatcher: CPUDispatcher) -> None:
        """Take over a kernel of this package; kernels of other programs stay with numba."""
        if dispatcher.py_func.__module__.partition(".")[0] == "vlp16emu":
            KernelDispatcher.take_over(dispatcher)
        else:
            enable_caching(dispatcher)

    Dispatcher.enable_caching = enable_our_caching  # type: ignore[method-assign, assignment]


_prepare()

_ENDINGS = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
_POLL_S = 1.0  # interval at which children are looked after


def table(group: str | None = None) -> list[dict[str, Any]]:
    """Return the table, or its part for a group of runs."""
    rows: list[dict[str, Any]] = json.loads(_TABLE.read_text(encoding="utf-8"))
    return [row for row in rows if group is None or group in row["groups"]]


def compile_kernels(group: str | None = None) -> Iterator[tuple[int, int]]:
    """Compile the table's kernels for a group of runs, or for all, that are not on disk.

    Yields the number of finished kernels, from 0, and their total; nothing if all are on disk.
    """
    missing = [row for row in table(group) if not _is_kept(row)]
    if not missing:
        return
    yield 0, len(missing)
    import multiprocessing  # here: usually all are on disk

    # Children are forks, so that they need not load numba again; with other threads forks would not be safe.
    if user_kernels().own is None or threading.active_count() > 1:
        return
    # Kernels of one file share most of what they call: a process compiles that once.
    files: dict[str, list[dict[str, Any]]] = {}
    for row in missing:
        files.setdefault(row["kernel"].partition(":")[0], []).append(row)
    # A child that a signal meets before `_ignore_signals` would end as this process does.
    before, others = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDINGS), multiprocessing.active_children()
    try:
        pool = multiprocessing.get_context("fork").Pool(min(usable_cores(), len(files)), _ignore_signals)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    children = [child for child in multiprocessing.active_children() if child not in others]
    with pool:
        done, counts = 0, pool.imap_unordered(_compile, files.values())
        while done < len(missing):
            try:
                done += counts.next(_POLL_S)
            except multiprocessing.TimeoutError:
                # The result of a child that the system killed, for its memory, never comes: the run compiles the rest.
                if not all(child.is_alive() for child in children):
                    return
            else:
                yield done, len(missing)


def decoded(text: Any) -> Any:
    """Read a numba type from JSON; fails if the program no longer has the type."""
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
    """Compile the kernels of some rows in a separate process, and count them; the run reports their errors."""
    for row in rows:
        kernel, arguments = _signature(row)
        try:
            kernel.compile(arguments)
        except Exception:  # noqa: BLE001 - numba raises all kinds
            KernelCache(kernel.py_func).give_up(arguments)
    return len(rows)


def _ignore_signals() -> None:
    """Ignore signals in a child: Ctrl-C in a terminal reaches all processes, and the parent ends the children."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # without the parent, results are not read
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDINGS)
