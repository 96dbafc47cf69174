"""Numbers as text, against Python's own formatting."""

from decimal import Decimal

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from vlp16emu.extras.clouds.text import csv_lines

LARGEST = 2**63 - 1


@settings(deadline=None)  # the first call compiles
@given(
    st.integers(1, 4).flatmap(
        lambda columns: st.tuples(
            st.lists(st.lists(st.integers(-LARGEST, LARGEST), min_size=columns, max_size=columns), max_size=5),
            st.lists(st.integers(0, 9), min_size=columns, max_size=columns),
        )
    )
)
def test_numbers_are_written_as_decimals(table):
    """Every whole number comes out as its exact decimal fraction, with all digits asked for behind the point."""
    rows, decimals = table
    lines = csv_lines(np.array(rows, np.int64).reshape(len(rows), len(decimals)), np.array(decimals))
    expected = [
        ",".join(f"{Decimal(number).scaleb(-places):.{places}f}" for number, places in zip(row, decimals, strict=True))
        for row in rows
    ]
    assert lines.decode().splitlines() == [line.replace("-0,", "0,") for line in expected]


def test_lines_go_on_over_many_at_once():
    """More lines than are formatted at once come out whole and in order."""
    numbers = np.arange(40_000).reshape(-1, 2) - 5_000
    lines = csv_lines(numbers, np.array([1, 0])).decode().splitlines()
    assert lines == [f"{a / 10:.1f},{b}" for a, b in numbers.tolist()]
