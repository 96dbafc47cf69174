"""Compilation of kernels for a fixed processor.

Numba's extras for functions that may be called from anywhere are left out. Modules with kernels import
`numba` from here, as it is configured before the first kernel is made.

A kernel that is compiled because another one calls it is code for that one only: it gets no entry from Python
or C, no machine code of its own and no file. If Python calls it later, it is compiled again in full.

A table lists the kernels that Python calls in runs of each group, hall and forest, with their argument types,
the costliest first. It may be outdated: a kernel that it lacks is compiled when it is first called.
"""

import json
import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TypedDict, TypeVar

import numba
from llvmlite import binding
from numba import types

from vlp16emu.cores import usable_cores
from vlp16emu.kernels.cache import KernelCache, NumbaObject, user_kernels

Kernel = TypeVar("Kernel", bound=Callable[..., object])


class Row(TypedDict):
    """A kernel of the table."""

    kernel: str  # module:name, in this package
    types: list[object]  # of its arguments, as `decode_type` reads them
    groups: list[str]  # of runs that call it


_TARGETS = {  # targets of the x86-64 psABI and the features they require, in LLVM's names, the fastest first
    "x86-64-v3": ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe"),
    "x86-64-v2": ("popcnt", "sse4.1", "sse4.2", "ssse3"),
}
_TABLE = Path(__file__).with_name("table.json")
_KNOWN = (0, 68)  # latest version of numba whose private interfaces are known


def target_for(features: Mapping[str, bool]) -> str:
    """Return the best target for a processor with some features, in LLVM's names."""
    fit = (name for name, needs in _TARGETS.items() if all(map(features.get, needs)))
    return next(fit, "generic")


def _target() -> tuple[str, str]:
    """Return the target processor and its extra features.

    `VLP16EMU_TARGET` selects another one, for tests; `host` is the present processor.
    """
    chosen = os.environ.get("VLP16EMU_TARGET")
    features = binding.get_host_cpu_features()
    if chosen == "host":
        return binding.get_host_cpu_name(), features.flatten()
    return chosen or target_for(features), ""


def _prepare() -> None:
    """Set the target of all kernels, and take over this package's kernels."""
    # In the environment: numba reads it again when one of its variables changes.
    os.environ["NUMBA_CPU_NAME"], os.environ["NUMBA_CPU_FEATURES"] = _target()
    numba.config.reload_config()
    if is_plain():
        return
    from vlp16emu.kernels.numba_private import take_over_kernels

    take_over_kernels()


@cache
def is_plain() -> bool:
    """Return True if numba compiles and keeps kernels in its own way: longer, with the same bytes.

    So it is with versions of numba whose private interfaces are not known, unless a kernel that is compiled
    through them works; or if `VLP16EMU_NUMBA` is `plain`.
    """
    if os.environ.get("VLP16EMU_NUMBA") == "plain":
        return True
    if tuple(map(int, numba.__version__.split(".")[:2])) <= _KNOWN:
        return False
    try:
        from vlp16emu.kernels.numba_private import check_interfaces

        check_interfaces()
    except Exception as error:  # noqa: BLE001 - whatever has changed
        text = (
            "numba %s: its private interfaces are not those of %d.%d (%s); "
            "kernels are compiled in its own way"
        )
        logging.getLogger(__name__).warning(text, numba.__version__, *_KNOWN, error)
        return True
    return False


_prepare()


def kernel(function: Kernel) -> Kernel:
    """Compile a kernel that allocates no arrays.

    Numba need not count references then, which saves a sixth of the time.
    """
    return _njit(function, _nrt=False)


def array_kernel(function: Kernel) -> Kernel:
    """Compile a kernel that allocates arrays."""
    return _njit(function)


def inline_kernel(function: Kernel) -> Kernel:
    """Compile a kernel that becomes part of each kernel that calls it; it allocates no arrays."""
    return _njit(function, _nrt=False, forceinline=True)


def inner_kernel(function: Kernel, *, inlined: bool) -> Kernel:
    """Compile a kernel for callers alone: it has no entry from Python or C.

    It keeps its order of operations even if the caller uses `fastmath`.
    """
    options = {"fastmath": False, "no_cfunc_wrapper": True, "no_cpython_wrapper": True}
    return _njit(function, _nrt=False, forceinline=inlined, **options)


def _njit(function: Kernel, **options: bool) -> Kernel:
    """Compile a kernel with numba; kernels release the GIL, and divide by 0 as numpy does."""
    if is_plain():
        options = {name: value for name, value in options.items() if name not in _PRIVATE}
    compiled: Kernel = numba.njit(cache=True, nogil=True, error_model="numpy", **options)(function)
    return compiled


_PRIVATE = frozenset({"_nrt", "no_cfunc_wrapper", "no_cpython_wrapper"})
"""Options that numba does not document."""
_ENDINGS = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
_POLL_S = 1.0  # interval at which children are looked after


def table(group: str | None = None) -> list[Row]:
    """Return the table, or its part for a group of runs."""
    rows: list[Row] = json.loads(_TABLE.read_text(encoding="utf-8"))
    return [row for row in rows if group is None or group in row["groups"]]


def compile_kernels(group: str | None = None) -> Iterator[tuple[int, int]]:
    """Compile the table's kernels for a group of runs, or for all, that are not on disk.

    Yields the number of finished kernels, from 0, and their total; nothing if all are on disk.
    """
    if is_plain():
        return
    missing = [row for row in table(group) if not _is_kept(row)]
    if not missing:
        return
    yield 0, len(missing)
    import multiprocessing  # here: usually all are on disk

    # Children are forks, so that they need not load numba again; with other threads forks would not be safe.
    if user_kernels().usable_folder is None or threading.active_count() > 1:
        return
    # Kernels of one file share most of what they call: a process compiles that once.
    files: dict[str, list[Row]] = {}
    for row in missing:
        files.setdefault(row["kernel"].partition(":")[0], []).append(row)
    # A child that a signal meets before `_ignore_signals` would end as this process does.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDINGS)
    children_before = multiprocessing.active_children()
    try:
        pool = multiprocessing.get_context("fork").Pool(min(usable_cores(), len(files)), _ignore_signals)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    children = [child for child in multiprocessing.active_children() if child not in children_before]
    with pool:
        done = 0
        counts = pool.imap_unordered(_compile, files.values())
        while done < len(missing):
            try:
                done += counts.next(_POLL_S)
            except multiprocessing.TimeoutError:
                # The result of a child that the system killed, for its memory, never comes: the run compiles
                # the rest.
                if not all(child.is_alive() for child in children):
                    return
            else:
                yield done, len(missing)


def decode_type(text: object) -> NumbaObject:
    """Read a numba type from JSON; fails if the program no longer has the type."""
    if isinstance(text, str):
        return getattr(types, text)
    assert isinstance(text, list)
    first, *rest = text
    if first == "array":
        dtype, ndim, layout, readonly = rest
        return types.Array(getattr(types, dtype), ndim, layout, readonly=readonly)
    if first == "tuple":
        return types.Tuple([*map(decode_type, rest)])
    if first == "omitted":
        return types.Omitted(*rest)
    module, _, name = first.partition(":")
    return types.BaseTuple.from_types([*map(decode_type, rest)], getattr(import_module(module), name))


def _signature(row: Row) -> tuple[NumbaObject, tuple[NumbaObject, ...]]:
    module, _, name = row["kernel"].partition(":")
    return getattr(import_module(f"vlp16emu.{module}"), name), tuple(map(decode_type, row["types"]))


def _is_kept(row: Row) -> bool:
    with suppress(ImportError, AttributeError, TypeError, ValueError):
        kernel, arguments = _signature(row)
        return KernelCache(kernel.py_func).has(arguments)
    return True


def _compile(rows: list[Row]) -> int:
    """Compile the kernels of some rows in a separate process, and count them.

    The run reports their errors.
    """
    for row in rows:
        kernel, arguments = _signature(row)
        try:
            kernel.compile(arguments)
        except Exception:  # noqa: BLE001 - numba raises all kinds
            KernelCache(kernel.py_func).give_up(arguments)
    return len(rows)


def _ignore_signals() -> None:
    """Ignore signals in a child.

    Ctrl-C in a terminal reaches all processes, and the parent ends the children.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # without the parent, results are not read
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDINGS)
