"""Stiff and extreme cases: the fast ones are held here, all of them by `tools/stability`."""

import math
import re
import subprocess
import sys
from pathlib import Path

import pytest
from stability_cases import CASES, Row, carry_out
from stability_cases.case import refusal, worst

from vlp16emu.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
FAST = {case.name: case for case in CASES if not case.is_slow}


@pytest.mark.parametrize("name", FAST)
def test_bounds_hold(name):
    """Each quantity of a stiff or extreme case is within its bound."""
    (result,) = carry_out([FAST[name]])
    assert [row for row in result.rows if not row.holds()] == []
    assert result.holds()


def test_every_case_says_what_is_extreme():
    """Names differ, and each case has a sentence that says what is extreme, and an authority."""
    assert len({case.name for case in CASES}) == len(CASES)
    assert all(case.extreme.endswith(".") and case.authority for case in CASES)


def test_the_tool_prints_error_bound_and_authority():
    """The shortest run names case, authority, error, bound and seconds, and ends with exit code 0."""
    command = [sys.executable, str(ROOT / "tools/stability"), "--fast", "globe"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    out = done.stdout
    assert "globe: Places on earth" in out
    assert "authority: mpmath, 50 digits" in out
    assert re.search(r"held +the date line: to degrees, m: +\S+, bound 1e-07", out)
    assert re.search(r"(?m)^    \d+\.\d\d s$", out)
    assert out.endswith("broken: none\n")


def test_a_broken_bound_fails(tool_named, capsys):
    """With bounds over a million the errors are above them: the lines say so, and the exit code is 1."""
    assert tool_named("stability").main(["--fast", "globe", "--tighten", "1e6"]) == 1
    out = capsys.readouterr().out
    assert "BROKEN the date line: to degrees, m:" in out
    assert out.endswith("broken: globe\n")


def test_a_name_of_no_case_is_refused(tool_named, capsys):
    """A name that no case contains ends with exit code 2 and the names there are."""
    assert tool_named("stability").main(["no-such-case"]) == 2
    out = capsys.readouterr().out
    assert out.startswith("error: no case has no-such-case in its name; expected a-day, ")
    assert out.count("\n") == 1


@pytest.mark.parametrize("error", [math.nan, math.inf, 1.1])
def test_what_is_no_number_is_no_small_error(error):
    """NaN, infinity and errors above the bound do not hold, also among rows that do, in any order."""
    rows = [Row("range, m", 0.5, 1.0), Row("range, m", error, 1.0), Row("range, m", 0.1, 1.0)]
    for order in (rows, rows[::-1]):
        (row,) = worst(order)
        assert not row.holds()


def test_a_refusal_must_come_and_say_why():
    """Input that is accepted, or refused with other words, breaks its bound."""

    def refuse():
        raise InputError("time", "found nan s", "a finite number")

    assert refusal("NaN", refuse, "a finite number").holds()
    assert not refusal("NaN", refuse, "at most 5").holds()
    assert not refusal("NaN", lambda: None, "a finite number").holds()


def test_the_page_has_every_case():
    """`tools/results/stability.md` begins with its command and lists all cases in order, none broken."""
    page = (ROOT / "tools/results/stability.md").read_text(encoding="utf-8")
    assert page.startswith("# Stability\n\n    tools/stability --markdown tools/results/stability.md")
    assert re.findall(r"(?m)^\| ([a-z][a-z0-9-]+) \|", page) == [case.name for case in CASES]
    assert "all of them held" in page
