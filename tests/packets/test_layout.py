"""Sizes of both packets; `tests/protocol` holds their fields against the tables of the contract."""

import doctest

from vlp16emu.packets import layout


def test_doctest():
    """The sizes that the docstring shows are true."""
    failed, tried = doctest.testmod(layout)
    assert (failed, tried) == (0, 3)
