"""Stiff and extreme cases, as `tools/stability` prints them."""

import math
from pathlib import Path

import pytest
from stability_cases import CASES, Row, check
from stability_cases.row import refused

from vlp16emu.errors import InputError

FOLDER = Path(__file__).resolve().parents[2] / "tools" / "stability_cases"


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_every_row_is_within_its_bound_or_refused(case):
    """What can be held is held, and the rest is turned down in one clear line."""
    rows = list(case())
    assert rows
    assert [row for row in rows if not row.held] == []


def test_no_case_is_left_out():
    """Every public function of the cases that gives rows stands in the list."""
    known = {case.__name__ for case in CASES}
    written = {
        line.split()[1].partition("(")[0]
        for path in FOLDER.glob("*.py")
        for line in path.read_text(encoding="utf-8").splitlines()
        if line.startswith("def ") and line.endswith("() -> Iterator[Row]:")
    }
    assert known == {name for name in written if not name.startswith("_")}


@pytest.mark.parametrize(
    ("row", "verdict"),
    [
        (Row("", "", 1.0, 1.0), "held"),
        (Row("", "", 1.1, 1.0), "failed"),
        (Row("", "", math.nan, 1.0), "failed"),
        (Row("", "", math.inf, 1.0), "failed"),
        (Row("", "", 0.0, 0.0, "no"), "refused"),
        (Row("", "", 1.0, 0.0, "no"), "failed"),
    ],
)
def test_a_verdict_follows_from_error_and_bound(row, verdict):
    """An error above its bound fails, and so does one that is not a number, refused or not."""
    assert row.verdict == verdict
    assert list(check([lambda: [row]])) == [row]


def fail(error):
    raise error


@pytest.mark.parametrize(
    ("act", "verdict"),
    [
        (lambda: fail(InputError("here", "bad", "good")), "refused"),
        (lambda: fail(InputError("here", "something else")), "failed"),
        (lambda: None, "failed"),
    ],
)
def test_a_refusal_is_one_line_with_the_right_words(act, verdict):
    """What is carried out, or turned down for another reason, is not refused as it should be."""
    assert refused("case", act, "expected good").verdict == verdict


def test_a_refusal_is_an_error_of_input():
    """Any other exception is no refusal but a fault, and goes on."""
    with pytest.raises(ZeroDivisionError):
        refused("case", lambda: 1 / 0, "")
