"""Factors between units."""

import math

import pytest

from vlp16emu import Emulator
from vlp16emu.errors import InputError
from vlp16emu.scenario import load
from vlp16emu.units import seconds_to_ns


def test_seconds_are_rounded_to_the_nearest_nanosecond():
    """A tenth of a second, which no binary number is, becomes exactly 100 ms."""
    assert seconds_to_ns(0.1) == 100_000_000
    assert seconds_to_ns(-1.5e-9) == -2


@pytest.mark.parametrize("seconds", [math.nan, math.inf, -math.inf])
def test_a_time_that_is_none_is_refused(seconds):
    """NaN and infinity are turned down in one line, also where an emulator is asked for packets of such a span."""
    with pytest.raises(InputError, match=f"time: found {seconds} s; expected a finite number"):
        seconds_to_ns(seconds)
    emulator = Emulator(load("static_bench"))
    for span_s in ((seconds, 1.0), (0.0, -abs(seconds))):
        with pytest.raises(InputError, match="expected a finite number"):
            emulator.packets(*span_s)
