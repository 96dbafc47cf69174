"""Sleeps that end on time."""

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["prompt_sleeps"]

# Numbers of prctl(2). Source: linux/prctl.h.
_PR_SET_TIMERSLACK = 29
_PR_GET_TIMERSLACK = 30
_FINEST_NS = 1
"""0 would restore the default of 50 us."""


@contextmanager
def prompt_sleeps() -> Iterator[None]:
    """Let sleeps of the calling thread end at their time and not up to 50 us later; as before afterwards.

    The timer slack of Linux joins wake-ups to save power. Elsewhere nothing changes: sleeps are then as
    late as the system makes them, and the report of a stream says so.
    """
    if sys.platform != "linux":
        yield
        return
    prctl = ctypes.CDLL(None).prctl
    # The arguments are unsigned longs, and prctl is variadic: a plain int would leave half a register undefined.
    before_ns = prctl(_PR_GET_TIMERSLACK, *[ctypes.c_ulong(0)] * 4)
    prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(_FINEST_NS), *[ctypes.c_ulong(0)] * 3)
    try:
        yield
    finally:
        prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(max(before_ns, 0)), *[ctypes.c_ulong(0)] * 3)
