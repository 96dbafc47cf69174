"""`tools/stability`: its table and its exit code."""

import math

import pytest
from stability_cases import Row

HELD, FAILED = Row("a wall", "error, m", 0.001, 0.002), Row("a pole", "error, m", math.inf, 0.0)
REFUSED = Row("a hole", "not refused", 0.0, 0.0, "hole: found | none")


@pytest.fixture
def tool(tool_named, monkeypatch):
    """The tool, with cases and a command line as given."""
    module = tool_named("stability")

    def start(rows, *arguments):
        monkeypatch.setattr(module, "QUICK", (lambda: rows,))
        monkeypatch.setattr(module, "SLOW", ())
        monkeypatch.setattr("sys.argv", ["stability", *arguments])
        return module.main()

    return start


def test_table_has_a_line_for_each_row(tool, capsys):
    """Case, quantity, error, bound and verdict stand in one line each, and bars in refusals break no table."""
    assert tool([HELD, REFUSED]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[2] == "| a wall | error, m | 0.001 | 0.002 | held |"
    assert lines[3] == r"| a hole | not refused | 0 | 0 | refused: hole: found \| none |"
    assert lines[-1] == "2 rows, none failed"


@pytest.mark.parametrize("arguments", [(), ("--quick",)])
def test_a_row_that_failed_is_an_exit_code(tool, capsys, arguments):
    """One row out of its bound makes the exit code 1, whatever is printed."""
    assert tool([HELD, FAILED], *arguments) == 1
    assert "failed" in capsys.readouterr().out
