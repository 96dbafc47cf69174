"""Ctrl-C between two packets, never inside one."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["INTERRUPTED", "stop_on_ctrl_c"]

INTERRUPTED = 130
"""Exit code after Ctrl-C: 128 + SIGINT, as shells count (POSIX.1-2024, Shell, section 2.8.2)."""


@contextmanager
def stop_on_ctrl_c() -> Iterator[threading.Event]:
    """Event that Ctrl-C sets; a second Ctrl-C interrupts at once.

    An exception could come between a packet's write and its count, so that report and file would differ.
    """
    stop = threading.Event()
    before = signal.getsignal(signal.SIGINT)

    def note(_signal: int, _frame: object) -> None:
        """Remember the first Ctrl-C, and let the second do what it did before."""
        stop.set()
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, note)
    try:
        yield stop
    finally:
        signal.signal(signal.SIGINT, before)
