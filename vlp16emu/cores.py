"""The cores that this process may use; a container or `taskset` can limit them."""

import os

from vlp16emu.errors import InputError


def usable_cores() -> int:
    """Return the number of cores that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def check_numba_threads() -> None:
    """Raise InputError for a number of threads in `NUMBA_NUM_THREADS` with which numba cannot be imported."""
    name = "NUMBA_NUM_THREADS"
    text = os.environ.get(name, "").strip()
    if text.removeprefix("-").isdecimal() and int(text) < 1:
        raise InputError(name, f"found {text}", "1 or more, or no such variable")
