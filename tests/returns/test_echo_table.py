"""The tool that prints what is reported of a step edge."""

import pytest


@pytest.fixture(scope="module")
def echo_table(tool_named):
    return tool_named("echo_table")


@pytest.mark.parametrize(("step_m", "returns"), [(0.3, 1), (0.7, 1), (1.3, 1), (1.5, 2), (5.0, 2)])
def test_the_table_tells_one_return_from_two(echo_table, step_m, returns):
    """Each cell has one range up to the resolution of 1.4 m and two from 1.5 m on, whatever the plates' reflectances."""
    for pair in echo_table.REFLECTANCES:
        assert len(echo_table.cell(step_m, pair).split(", ")) == returns
