"""Which skips continuous integration takes."""

from pathlib import Path

SKIPS = """
import pytest

def test_without_a_program():
    pytest.skip("no such program")

def test_without_captures():
    pytest.skip("no real captures beside the repository")

@pytest.mark.xfail(reason="known")
def test_known():
    assert False
"""


def test_a_skip_fails_with_ci_unless_it_is_on_the_list(pytester, monkeypatch):
    """With CI=true a test that lacks a program fails; one whose captures are not there is skipped, and an
    expected failure stays one."""
    pytester.makeconftest(Path(__file__).with_name("conftest.py").read_text())
    pytester.makepyfile(SKIPS)
    monkeypatch.setenv("CI", "true")
    done = pytester.runpytest_inprocess("-p", "no:cacheprovider")
    done.assert_outcomes(failed=1, skipped=1, xfailed=1)
