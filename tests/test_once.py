"""Values that follow from an array, computed once."""

import gc
from weakref import WeakSet

import numpy as np
import pytest

from vlp16emu.once import once_per_array


def test_a_value_is_computed_once_for_each_array():
    """Each array has its own value, computed at the first call; the array cannot change any more."""
    seen = []

    @once_per_array
    def total(array):
        seen.append(id(array))
        return int(array.sum())

    a, b = np.arange(3), np.arange(3)
    assert [total(a), total(b), total(a), total(b)] == [3, 3, 3, 3]
    assert seen == [id(a), id(b)]
    with pytest.raises(ValueError, match="read-only"):
        a[0] = 1


def test_a_value_goes_with_its_array():
    """The value of an array that is gone is freed, and a new array at its place has its own."""
    values = WeakSet()

    class Value:
        """Something that can be watched."""

    @once_per_array
    def value_of(array):
        value = Value()
        value.total = int(array.sum())
        values.add(value)
        return value

    for number in range(200):
        assert value_of(np.full(4, number)).total == 4 * number
    gc.collect()
    assert not values
