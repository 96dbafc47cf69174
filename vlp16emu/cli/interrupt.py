"""Ctrl-C or a request to end between two packets, never inside one."""

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["INTERRUPTED", "stop_on_ctrl_c"]

INTERRUPTED = 130
"""Exit code after Ctrl-C: 128 + SIGINT, as shells count (POSIX.1-2024, Shell, section 2.8.2)."""

_STDERR = 2


@contextmanager
def stop_on_ctrl_c() -> Iterator[threading.Event]:
    """Event that Ctrl-C and SIGTERM set; a second one interrupts at once.

    An exception could come between a packet's write and its count, so that report and file would differ.
    """
    stop = threading.Event()
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def restore() -> None:
        """Let both do what they did before."""
        for number, handler in before.items():
            signal.signal(number, handler)

    def note(_signal: int, _frame: object) -> None:
        """Remember the first, and let the second do what it did before."""
        stop.set()
        restore()
        if os.isatty(_STDERR):  # print is not to be called in the midst of a print
            os.write(_STDERR, b"\nfinishing what is under way; Ctrl-C again stops at once\n")

    for number in before:
        signal.signal(number, note)
    try:
        yield stop
    finally:
        restore()
