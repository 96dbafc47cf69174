"""Kernels compiled before a run that needs them, one process per core.

The table names the kernels that Python calls in runs of each group, hall and forest, and the types of their arguments,
the costliest first. It may lag behind the program: a kernel that it lacks is compiled when it is first called.
"""

import json
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from vlp16emu.kernel_cache import KernelCache, kernel_folder

_TABLE = Path(__file__).with_name("kernels.json")


def table(group: str | None = None) -> list[dict[str, Any]]:
    """Return the table, or the part of it that a group of runs needs."""
    rows: list[dict[str, Any]] = json.loads(_TABLE.read_text(encoding="utf-8"))
    return [row for row in rows if group is None or group in row["groups"]]


def compile_kernels(group: str | None = None) -> Iterator[tuple[int, int]]:
    """Compile what the table has for a group of runs, or for all, and is not on disk yet.

    Yields
    ------
    How many kernels are done, none at first, and how many there are; nothing where all are on disk
    """
    missing = [row for row in table(group) if not _is_kept(row)]
    if not missing:
        return
    yield 0, len(missing)
    # Children are forks, so that they need not load numba again; with other threads that would not be safe.
    if kernel_folder() is None or threading.active_count() > 1:
        return
    # Kernels of one file share most of what they call: a process compiles that once.
    files: dict[str, list[dict[str, Any]]] = {}
    for row in missing:
        files.setdefault(row["kernel"].partition(":")[0], []).append(row)
    with get_context("fork").Pool(min(_cores(), len(files)), _leave_signals) as pool:
        done = 0
        for count in pool.imap_unordered(_compile, files.values()):
            done += count
            yield done, len(missing)


def decoded(text: Any) -> Any:
    """Read a type of numba from JSON; errors where the program has no such type any more."""
    from numba import types

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
        kernel, types = _signature(row)
        return KernelCache(kernel.py_func).has(types)
    return True


def _compile(rows: list[dict[str, Any]]) -> int:
    """Compile the kernels of some rows, in a process of its own, and count them; what is wrong with one, the run will say."""
    for row in rows:
        kernel, types = _signature(row)
        try:
            kernel.compile(types)
        except Exception:  # noqa: BLE001 - numba raises all kinds
            KernelCache(kernel.py_func).give_up(types)
    return len(rows)


def _leave_signals() -> None:
    """Let the parent decide when a child ends: Ctrl-C in a terminal reaches all of them."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
