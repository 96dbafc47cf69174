"""Values that follow from an array alone, computed once while the array lives."""

import weakref
from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

from numpy.typing import NDArray

T = TypeVar("T")


def once_per_array(compute: Callable[[NDArray[Any]], T]) -> Callable[[NDArray[Any]], T]:
    """Return `compute` with its values kept as long as their arrays live.

    The table of surfaces of a window has tens of thousands of rows, and steps of a live run last 5 ms. An
    array becomes read-only, so that its value stays true.
    """
    kept = dict[int, T]()

    @wraps(compute)
    def value_of(array: NDArray[Any]) -> T:
        key = id(array)
        if key not in kept:
            kept[key] = compute(array)
            array.flags.writeable = False
            weakref.finalize(array, kept.pop, key, None).atexit = False
        return kept[key]

    return value_of
